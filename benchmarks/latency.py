"""How long one call of Simulation.step() takes: one vehicle of ``patrol_published``, everything on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import _common

HEADINGS = {
    "what": "call",
    "calls": "calls",
    "median_us": "median [us]",
    "p95_us": "95 % [us]",
    "p99_us": "99 % [us]",
}


def measure(sim: Any, what: str, command: Any, calls: int, look: Callable[[Any], Any] | None = None) -> dict[str, Any]:
    """Return the row of one kind of call; the first calls, which compile, are not counted.

    Args:
        sim: a Simulation.
        what: the call, in words.
        command: handed to ``step``.
        calls: how many are timed.
        look: what is done with the reading, None for nothing.
    """
    import numpy as np

    sim.reset()
    times = np.empty(calls)
    for _ in range(min(calls, 200)):
        sim.step(command)
    for i in range(calls):
        begun = time.perf_counter()
        reading = sim.step(command)
        if look is not None:
            look(reading)
        times[i] = time.perf_counter() - begun
    median, p95, p99 = np.percentile(1e6 * times, [50, 95, 99])
    return {
        "what": what,
        "calls": calls,
        "median_us": round(float(median), 2),
        "p95_us": round(float(p95), 2),
        "p99_us": round(float(p99), 2),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    import qrsim

    sim = qrsim.load(_common.patrol(1))
    calls = 20 if chosen.quick else 10_000
    results = [measure(sim, "step(): its own guidance", None, calls)]
    if not chosen.quick:
        hover = [[0.0, 0.0, 0.59, 0.0, 12.0]]
        results.append(measure(sim, "step(command): 1 x 5 array", hover, calls))
        results.append(measure(sim, "step() and its GNSS position", None, calls, lambda r: r.gnss.position_ned))
    title = "Latency: one vehicle, one tick per call, state and readings back in NumPy"
    _common.publish("latency", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
