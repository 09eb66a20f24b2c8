"""What a turbulence costs: the field beside the Dryden filter, alone and in the whole tick of ``patrol_published``.

Each row is a world of its own in one process: with still air, with ``dryden`` and with ``dryden_field``. What a
turbulence costs is the difference from still air. Columns: worlds of so many vehicles; ns of CPU of a vehicle-step, and
what of it is the turbulence; both over those of ``dryden``; bytes that a world keeps of its field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import _common
import throughput

KINDS: dict[str, dict[str, Any]] = {
    "still": {"type": "still"},
    "dryden": {"type": "dryden"},
    "dryden_field": {"type": "dryden_field"},
    "frozen": {"type": "dryden_field", "evolution": "frozen"},
    "von_karman": {"type": "dryden_field", "spectrum": "von_karman"},
}
PLACES = ((512, 8), (1, 1000))
HEADINGS = {
    "world": "world",
    "turbulence": "turbulence",
    "worlds": "worlds",
    "vehicles": "of",
    "ns": "tick [ns]",
    "own_ns": "air [ns]",
    "over_dryden": "over dryden",
    "tick_over_dryden": "whole tick",
    "compile_seconds": "compile [s]",
    "field_bytes": "bytes",
}


def world(count: int, kind: str, whole: bool) -> Any:
    """Return a world of ``count`` vehicles: the published patrol, or its vehicles without sensors and process noise."""
    from qrsim import load_scenario

    content = _common.patrol(count)
    content["world"]["turbulence"] = KINDS[kind]
    if not whole:
        fleet = content["fleets"]["pelicans"]
        fleet |= {"sensors": {}, "vehicle": {"type": "pelican", "process_noise": 0.0}}
        fleet |= {"controller": {"type": "attitude", "feed": "truth"}, "guidance": {"type": "attitude"}}
        content["world"]["area"].update(x_min=-1e5, x_max=1e5, y_min=-1e5, y_max=1e5)
    return load_scenario(content, quiet=True).world()


def field_bytes(of: Any) -> int:
    """Return the bytes that a world keeps of its field."""
    import jax
    import jax.numpy as jnp

    from qrsim.core.noise import Key
    from qrsim.world import tick

    shapes = jax.eval_shape(tick.reset, of, Key.root(jnp.array([1, 0], jnp.uint32)))
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes.field))


def measured(
    worlds: int, count: int, whole: bool, seconds: float, repeats: int, kinds: Sequence[str] = tuple(KINDS)
) -> list[dict[str, Any]]:
    """Return a row for each turbulence, the medians of measurements; the first two are still air and ``dryden``."""
    rows: list[dict[str, Any]] = []
    for kind in kinds:
        of = world(count, kind, whole)
        with throughput.no_collisions(off=not whole):
            found = throughput._measured(of, worlds, count, kind, seconds, repeats)
        rows.append(
            {
                "world": "patrol" if whole else "dynamics",
                "turbulence": kind,
                "worlds": worlds,
                "vehicles": count,
                "ns": 1e9 / found["per_cpu_second"],
                "compile_seconds": found["compile_seconds"],
                "field_bytes": field_bytes(of),
            }
        )
    still, dryden = rows[0]["ns"], rows[1]["ns"]
    for row in rows:
        row["own_ns"] = row["ns"] - still
        row["over_dryden"] = row["own_ns"] / (dryden - still) if dryden > still else None
        row["tick_over_dryden"] = row["ns"] / dryden
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    if chosen.quick:
        rows = measured(2, 2, False, 0.01, 1, tuple(KINDS)[:3])
    else:
        rows = [row for place in PLACES for row in measured(*place, False, 0.4, 5)]
        rows += measured(*PLACES[0], True, 0.4, 5)
    title = "Turbulence: single precision; compile: to the end of the first tick, nothing in a cache"
    _common.publish("turbulence", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
