"""What it costs to look at one field of a reading, by how many sensors the fleet has.

Steps of one world of eight vehicles; of each the height of a barometer is looked at and timed alone. Fleets take turns,
so that what else the machine does meets all of them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import _common

COUNTS = (3, 12)
KINDS = (
    "barometer", "attitude_estimator", "gyroscope", "accelerometer", "rangefinder", "optical_flow", "neighbours",
    "airspeed", "concentration", "ideal_barometer", "ideal_gyroscope",
)  # fmt: skip
HEADINGS = {"sensors": "sensors", "median_us": "look [us]", "step_us": "step [us]", "over_first": "over the first"}


def fleet(count: int) -> Any:
    """Return a simulation of eight vehicles with as many sensors."""
    import qrsim

    content = _common.patrol(8)
    chosen = {f"{kind}": {"type": kind} for kind in KINDS[: count - 1]}
    content["fleets"]["pelicans"]["sensors"] = {"gnss": {"type": "gnss_receiver"}, **chosen}
    return qrsim.load(content, seed=1)


def measured(calls: int, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each fleet, medians of rounds of the mean of calls."""
    import numpy as np

    fleets = [fleet(count) for count in COUNTS]
    looks: list[list[float]] = [[] for _ in fleets]
    steps: list[list[float]] = [[] for _ in fleets]
    for sim in fleets:
        sim.reset()
        sim.step()
    for _ in range(rounds):
        for number, sim in enumerate(fleets):
            looked = 0.0
            begun = time.perf_counter()
            for _ in range(calls):
                reading = sim.step()
                before = time.perf_counter()
                _ = reading.barometer.height
                looked += time.perf_counter() - before
            looks[number].append(1e6 * looked / calls)
            steps[number].append(1e6 * (time.perf_counter() - begun) / calls)
    medians = [float(np.median(each)) for each in looks]
    return [
        {
            "sensors": f"{count}",
            "median_us": round(look, 2),
            "step_us": round(float(np.median(step)), 2),
            "over_first": look / medians[0],
        }
        for count, look, step in zip(COUNTS, medians, steps, strict=True)
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    rows = measured(5, 1) if chosen.quick else measured(1000, 15)
    title = "Looking at one field of a reading, of a fleet of eight vehicles, after a step"
    _common.publish("looking", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
