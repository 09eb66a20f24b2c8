"""Where the tick of the default scenario goes: ``outdoor_patrol`` whole, and with one stage replaced by its ideal.

Stages: the Kalman filter (its controller then flies on the truth), the field of gusts, the GNSS receivers, and the IMU.
Each row has its own program. All run in one process and are measured in turns, so that all see the same machine.
Columns: CPU time a vehicle-step in 512 worlds and in one world, the share of the whole that the stage takes, and the
time to compile.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import _common
from throughput import Nothing

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


class Flown:
    """Worlds of the default scenario in flight, one stage of it replaced.

    Args:
        stage: one of STAGES.
        worlds: how many.
    """

    def __init__(self, stage: str, worlds: int):
        from qrsim import load_scenario
        from qrsim.core.noise import Key
        from qrsim.simulation.many_worlds import Flight
        from qrsim.simulation.rollout import setup_of
        from qrsim.world.draws import keys_of

        world = load_scenario("outdoor_patrol", list(STAGES[stage]), quiet=True).world()
        begun = time.process_time()
        setup, fixed, own = setup_of([world], metrics=Nothing())
        keys = keys_of(world, Key.roots(np.zeros(worlds, np.int64), np.arange(worlds)))
        self.stage, self.worlds, self.vehicles = stage, worlds, world.fleets[0].size
        self.flight, self.tick = Flight(setup, fixed, own, keys, self.vehicles, 1), 0
        self.advance(1)
        self.compile_seconds = time.process_time() - begun

    def advance(self, ticks: int) -> float:
        """Fly some ticks and return the CPU time they took [s]."""
        begun = time.process_time()
        self.flight.advance(self.tick, ticks, ((), ()))
        np.asarray(self.flight.get(lambda carry: carry.wrong_tick))
        self.tick += ticks
        return time.process_time() - begun


def measured(worlds: int, seconds: float, repeats: int, stages: Sequence[str] = tuple(STAGES)) -> list[dict[str, Any]]:
    """Return a row for each stage: medians of measurements that were taken in turns.

    Args:
        worlds: flown together.
        seconds: CPU time that one measurement should take.
        repeats: measurements of each stage.
        stages: which, the whole first.
    """
    flown = [Flown(stage, worlds) for stage in stages]
    ticks = [max(10, round(10 * seconds / max(each.advance(10), 1e-6)) // 10 * 10) for each in flown]
    found = [[each.advance(count) / count for each, count in zip(flown, ticks, strict=True)] for _ in range(repeats)]
    medians = np.median(found, axis=0) / worlds
    return [
        {
            "stage": each.stage,
            "worlds": worlds,
            "ns": float(1e9 * median / each.vehicles),
            "tick_us": float(1e6 * median),
            "share": float(1.0 - median / medians[0]) if i else 1.0,
            "compile_seconds": round(each.compile_seconds, 2),
        }
        for i, (each, median) in enumerate(zip(flown, medians, strict=True))
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
