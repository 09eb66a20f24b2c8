"""What an exchange of the radio costs, and its part of a flight at 5 Hz: 100, 1 000 and 10 000 vehicles in one world.

Vehicles are spread with one in each square of 100 m by 100 m and look 300 m far, as ``world.radio`` does by default.
Columns: ms of CPU of an exchange, which is what 50 ticks with a radio of five exchanges take more than without one; the
same over the number of vehicles; time of a flight with the radio over that without.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import _common

COUNTS = (100, 1_000, 10_000)
TICKS, EXCHANGES = 50, 5
HEADINGS = {
    "vehicles": "vehicles",
    "tick_ms": "tick [ms]",
    "exchange_ms": "exchange [ms]",
    "us": "of a vehicle [us]",
    "ratio": "flight over that without",
    "heard": "heard by one",
    "compiler": "by",
}


def simulations(count: int) -> list[Any]:
    """Return two simulations of as many vehicles, without a radio and with one."""
    import qrsim

    random, side = np.random.default_rng(1), 100.0 * count**0.5
    places = np.column_stack([random.uniform(0.0, side, (count, 2)), random.uniform(-60.0, -20.0, count)])
    area = {"type": "box", "x_min": -500.0, "x_max": side + 500.0, "y_min": -500.0, "y_max": side + 500.0}
    parts = {"area": {**area, "z_min": -200.0}, "collision_distance": 0.1}
    return [qrsim.Simulation(qrsim.make_world(places.tolist(), **parts, **more)) for more in ({}, {"radio": "sik_915"})]


def measured(count: int, repeats: int) -> dict[str, Any]:
    """Return the row of a number of vehicles: the least of some measurements, taken in turns."""
    pair, seconds = simulations(count), []
    for simulation in pair:
        simulation.reset()
        simulation.advance(ticks=TICKS)
    for _ in range(repeats):
        row = []
        for simulation in pair:
            begun = time.process_time()
            simulation.advance(ticks=TICKS)
            row.append(time.process_time() - begun)
        seconds.append(row)
    plain, radio = np.min(seconds, axis=0)
    counts = pair[1].state.radio.counts
    exchange = (radio - plain) / EXCHANGES
    return {
        "vehicles": count,
        "tick_ms": 1e3 * plain / TICKS,
        "exchange_ms": 1e3 * exchange,
        "us": 1e6 * exchange / count,
        "ratio": radio / plain,
        "heard": float(np.sum(counts.heard) / np.sum(counts.sent)),
        "compiler": pair[1].compiled_by[0],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    rows = [measured(count, 1 if chosen.quick else 9) for count in (COUNTS[:1] if chosen.quick else COUNTS)]
    _common.publish("radio", "Radio: preset sik_915, one core, single precision", on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
