"""What changes of a flight cost: injections into a world whose parts may all fail.

A thousand random injections into the scenario mavlink_field, one before every tick: the time of each request and of
the tick after it, and memory. Memory is what Python and NumPy have allocated after a
collection of garbage (tracemalloc), so that a flight without injections is the reference.
"""

from __future__ import annotations

import gc
import random
import time
import tracemalloc
from collections.abc import Sequence
from typing import Any

import _common

MANY, FEW, WARM = 1000, 50, 20
# Sensors of the scenario with a field that can be wrong.
FIELDS = {"gnss": "position_ned", "barometer": "height", "gyroscope": "rates_body", "magnetometer": "field_body"}
HEADINGS = {
    "requests": "requests",
    "median_ms": "request [ms]",
    "most_ms": "largest [ms]",
    "tick_ms": "tick after it [ms]",
    "kept_kb": "memory [kB]",
}


def world() -> Any:
    """Return a simulation whose sensors, rotors and batteries may all fail."""
    import qrsim

    content = qrsim.load_scenario("mavlink_field").spec.model_dump(mode="json")
    content["fleets"]["field"]["injectable"] = "all"
    return qrsim.load(content, seed=1)


def inject(sim: Any, rng: random.Random) -> None:
    """Make a random request."""
    vehicle, target = rng.choice(sim.vehicle_names), rng.choice([*FIELDS, "rotor", "battery"])
    if target == "battery":
        sim.inject(target, "weak", vehicle, health=rng.uniform(0.9, 1.0))
    elif target == "rotor":
        sim.inject(f"rotor {rng.randrange(4)}", "weak", vehicle, health=rng.uniform(0.95, 1.0))
    else:
        kind = rng.choice(["off", "stuck", "wrong", "drift", "ok"])
        numbers = {"wrong": {"bias": 1.0}, "drift": {"rate": 0.1}}.get(kind, {})
        field = {"field": FIELDS[target]} if numbers else {}
        lasts = {} if kind == "ok" else {"duration": rng.uniform(0.1, 5.0)}
        sim.inject(target, kind, vehicle, **lasts, **numbers, **field)


def flown(sim: Any, count: int, injects: bool) -> tuple[list[float], list[float], float]:
    """Fly ticks, each after a request; return times of requests and of ticks [ms], and memory that is kept [kB]."""
    rng, asked, ticks = random.Random(7), list[float](), list[float]()
    sim.reset()
    for _ in range(WARM):
        inject(sim, rng)
        sim.advance()
    gc.collect()
    before, _ = tracemalloc.get_traced_memory()
    for _ in range(count):
        begun = time.perf_counter()
        if injects:
            inject(sim, rng)
        between = time.perf_counter()
        sim.advance()
        asked.append(1e3 * (between - begun))
        ticks.append(1e3 * (time.perf_counter() - between))
    gc.collect()
    after, _ = tracemalloc.get_traced_memory()
    return asked, ticks, (after - before) / 1024.0


def measured(count: int) -> list[dict[str, Any]]:
    """Return a row without and a row with injections."""
    import numpy as np

    sim, rows = world(), []
    for injects in (False, True):
        # Times without the tracing of memory, which slows down every allocation.
        asked, ticks, _ = flown(sim, count, injects)
        tracemalloc.start()
        _, _, kept = flown(sim, count, injects)
        tracemalloc.stop()
        rows.append(
            {
                "requests": count if injects else 0,
                "median_ms": round(float(np.median(asked)), 4),
                "most_ms": round(max(asked), 4),
                "tick_ms": round(float(np.median(ticks)), 4),
                "kept_kb": round(kept, 1),
            }
        )
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    rows = measured(FEW if chosen.quick else MANY)
    title = "Injections into a flight of five vehicles whose parts may all fail, one before each tick"
    _common.publish("injections", title, on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
