"""Where the tick of the default scenario goes: ``outdoor_patrol`` whole, and with one stage replaced by its ideal.

Stages: the Kalman filter (its controller then flies on the truth), the field of gusts, the GNSS receivers, and the IMU.
Each row has its own program. All run in one process and are measured in turns, so that all see the same machine.
Columns: CPU time a vehicle-step in 512 worlds and in one world, the share of the whole that the stage takes, and the
time to compile.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import _common

FLEET = "fleets.pelicans"
# What replaces each stage.
STAGES: dict[str, tuple[str, ...]] = {
    "whole": (),
    "without filter": (f"{FLEET}.estimator=null", f"{FLEET}.controller.feed=truth"),
    "without field": ("world.turbulence={type: still}",),
    "without receivers": (f"{FLEET}.sensors.gnss={{type: ideal_gnss}}",),
    "without IMU": (f"{FLEET}.sensors.imu={{type: ideal_imu}}",),
}
PLACES = (512, 1)
HEADINGS = {
    "stage": "outdoor_patrol",
    "worlds": "worlds",
    "ns": "vehicle-step [ns]",
    "tick_us": "tick of a world [us]",
    "share": "share of the whole",
    "compile_seconds": "compile [s]",
}


def measured(worlds: int, seconds: float, repeats: int, stages: Sequence[str] = tuple(STAGES)) -> list[dict[str, Any]]:
    """Return a row for each stage: medians of measurements that were taken in turns.

    Args:
        worlds: flown together.
        seconds: CPU time that one measurement should take.
        repeats: measurements of each stage.
        stages: which, the whole first.
    """
    from qrsim import load_scenario

    flown = [
        _common.Flown(load_scenario("outdoor_patrol", list(STAGES[stage]), quiet=True).world(), worlds)
        for stage in stages
    ]
    ticks = [each.ticks_in(seconds) for each in flown]
    found = [
        [each.advance(count).cpu / count for each, count in zip(flown, ticks, strict=True)] for _ in range(repeats)
    ]
    medians = np.median(found, axis=0) / worlds
    return [
        {
            "stage": stage,
            "worlds": worlds,
            "ns": float(1e9 * median * worlds / each.vehicles),
            "tick_us": float(1e6 * median),
            "share": float(1.0 - median / medians[0]) if i else 1.0,
            "compile_seconds": round(each.compiled.cpu, 2),
        }
        for i, (stage, each, median) in enumerate(zip(stages, flown, medians, strict=True))
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    _common.without_cache()
    on = _common.machine()
    if chosen.quick:
        rows = measured(2, 0.01, 1, tuple(STAGES)[:2])
    else:
        rows = [row for worlds in PLACES for row in measured(worlds, 0.4, 7)]
    title = "The default scenario by stages: single precision, CPU time; compile: to the end of the first tick"
    _common.publish("outdoor", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
