"""How many vehicle-steps a second: the default scenario's world with 1 to 1000 vehicles.

Everything is on: wind, turbulence, all sensors, the controller fed with measurements, collisions.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from typing import Any

import _common

HEADINGS = {
    "vehicles": "vehicles",
    "compile_s": "compile [s]",
    "us_per_step": "step [us]",
    "per_wall_second": "vehicle-steps per wall second",
    "per_cpu_second": "per CPU second",
    "flying": "flying at the end",
}


def measure(count: int, repeats: int, seconds: float) -> dict[str, Any]:
    """Return the row of one number of vehicles.

    Args:
        count: vehicles.
        repeats: timed calls of ``step``, of which the median counts.
        seconds: wall time that one call should take.
    """
    import qrsim

    sim = qrsim.load(_common.patrol(count))
    begun = time.perf_counter()
    sim.reset()
    sim.step(ticks=1)
    compiled = time.perf_counter() - begun
    begun = time.perf_counter()
    sim.step(ticks=50)
    ticks = max(50, round(50 * seconds / (time.perf_counter() - begun)))
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        sim.step(ticks=ticks)
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    wall, cpu = statistics.median(walls), statistics.median(cpus)
    return {
        "vehicles": count,
        "ticks": ticks,
        "compile_s": round(compiled, 2),
        "us_per_step": round(wall / ticks * 1e6, 2),
        "per_wall_second": round(count * ticks / wall),
        "per_cpu_second": round(count * ticks / cpu),
        "flying": int(sim.valid.sum()),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    if not chosen.quick:
        _common.without_cache()
    on = _common.machine()
    counts, repeats, seconds = ((1,), 1, 0.01) if chosen.quick else ((1, 10, 100, 1000), 7, 0.5)
    results = [measure(count, repeats, seconds) for count in counts]
    title = "Throughput: Simulation.step(ticks=...), single precision; compile: the first reset() and step()"
    _common.publish("throughput", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
