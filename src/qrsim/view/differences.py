"""Lines between the same vehicle of two runs; browsers draw them themselves (differences.js)."""

from __future__ import annotations

from qrsim.view.layers import Layer, Stage

DIFFERENCES = "differences"


class Differences(Layer):
    """Switch of the lines and their lengths."""

    title = DIFFERENCES
    every = 1000.0


def difference_layers(stage: Stage) -> list[Layer]:
    """Return the layer of the differences of several runs."""
    return [Differences(stage)] if pairs_of(stage) else []


def pairs_of(stage: Stage) -> list[tuple[int, int]]:
    """Return the numbers of each vehicle of the first run and of the same one in another run."""
    cast = stage.cast
    if cast.run_of is None:
        return []
    # The letter of the run is in front of each name.
    names = [name.partition(" ")[2] for name in cast.names]
    first = {name: i for i, name in enumerate(names) if cast.run_of[i] == 0}
    return [(first[name], i) for i, name in enumerate(names) if cast.run_of[i] > 0 and name in first]


def differences_of(stage: Stage) -> dict[str, object] | None:
    """Return what browsers draw the lines from: the layer's node, pairs of vehicles and the run of each vehicle."""
    pairs = pairs_of(stage)
    if not pairs or stage.cast.run_of is None:
        return None
    return {"path": "/world/differences", "pairs": pairs, "runOf": stage.cast.run_of.tolist()}
