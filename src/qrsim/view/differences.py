"""Lines between the same vehicle of two runs; browsers draw them themselves (differences.js)."""

from __future__ import annotations

from qrsim.view.layers import Layer, Stage

DIFFERENCES = "differences"


class Differences(Layer):
    """Layer that switches the lines and their lengths on and off."""

    title = DIFFERENCES
    every = 1000.0


def difference_layers(stage: Stage) -> list[Layer]:
    """Return a list with the layer of lines between the same vehicles of runs; [] if none is in two runs."""
    return [Differences(stage)] if pairs_of(stage) else []


def pairs_of(stage: Stage) -> list[tuple[int, int]]:
    """Return (vehicle of the first run, vehicle of the same name in another run), as numbers among all vehicles."""
    cast = stage.cast
    if cast.run_of is None:
        return []
    # The letter of the run is in front of each name.
    names = [name.partition(" ")[2] for name in cast.names]
    first = {name: i for i, name in enumerate(names) if cast.run_of[i] == 0}
    return [(first[name], i) for i, name in enumerate(names) if cast.run_of[i] > 0 and name in first]


def differences_of(stage: Stage) -> dict[str, object] | None:
    """Return for browsers (JSON) the layer's node, the vehicle pairs and each vehicle's run; None without pairs."""
    pairs = pairs_of(stage)
    if not pairs or stage.cast.run_of is None:
        return None
    return {"path": "/world/differences", "pairs": pairs, "runOf": stage.cast.run_of.tolist()}
