"""Betaflight's firmware in lock-step: how many times faster than real time, alone and with vehicles of qrsim."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import _common
from qrsim.errors import UsageError

HEADINGS = {
    "what": "what",
    "vehicles": "vehicles",
    "rate_hz": "ticks/s",
    "real_time_factor": "times real time",
    "target": "target",
}
RATE_HZ, TARGET = 400.0, 10.0


def hovering(vehicles: int) -> dict[str, Any]:
    """Return a scenario of multirotors that hold their places, on true states."""
    return {
        "name": "held",
        "description": "Multirotors hold their places.",
        "duration": 60.0,
        "fleets": {
            "quads": {
                "vehicle": {"type": "multirotor", "model": "hummingbird"},
                "controller": {"type": "cascade", "feed": "truth"},
                "vehicles": [{"position_ned": [0.0, 10.0 * i, -20.0]} for i in range(vehicles)],
            }
        },
    }


def alone(seconds: float) -> float:
    """Return the factor of one firmware at rest, without a vehicle."""
    from qrsim.links.autopilot.firmware import Firmware, binary, configured
    from qrsim.links.autopilot.packets import Sensed

    program = binary()
    with Firmware(program, configured(program)) as firmware:
        armed, at_rest = firmware.arm(1.0 / RATE_HZ, Sensed()), Sensed()
        begin = time.perf_counter()
        for tick in range(1, round(seconds * RATE_HZ) + 1):
            firmware.tell(armed + tick / RATE_HZ, at_rest, (1500, 1500, 1000, 1500, 2000, 2000))
            firmware.motors()
        return seconds / (time.perf_counter() - begin)


def flown(content: Any, seconds: float) -> float:
    """Return the factor of a scenario, without recording it."""
    from qrsim.links.autopilot.firmware import binary, configured
    from qrsim.links.autopilot.fleet import prepared
    from qrsim.links.autopilot.flight import Flight
    from qrsim.scenarios.scenario import load_scenario
    from qrsim.simulation.simulation import Simulation

    scenario, fleets = prepared(load_scenario(content, quiet=True), (), "hummingbird", RATE_HZ)
    simulation = Simulation(scenario.world(), seed=1, name=scenario.name, site=scenario.site)
    simulation.reset()
    program = binary()
    with Flight(simulation, fleets, program, configured(program)) as flight:
        flight.advance()  # compiles
        begin = time.perf_counter()
        flight.advance(round(seconds * RATE_HZ))
        return seconds / (time.perf_counter() - begin)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    seconds = 0.5 if chosen.quick else 20.0
    counts = (1,) if chosen.quick else (1, 4)
    rows: list[dict[str, Any]] = []

    def add(what: str, vehicles: int, factor: float, target: float | None) -> None:
        rows.append(
            {
                "what": what,
                "vehicles": vehicles,
                "rate_hz": RATE_HZ,
                "real_time_factor": factor,
                "target": "-" if target is None else f"at least {target:g}",
            }
        )

    try:
        add("firmware at rest, no vehicle", 1, alone(seconds), None)
    except UsageError as error:
        print(f"nothing measured: {error}")
        return
    for count in counts:
        add("hovering, true states", count, flown(hovering(count), seconds), TARGET if count == 1 else None)
    if not chosen.quick:
        add("outdoor_patrol: wind, sensors, Kalman filters", 5, flown("outdoor_patrol", 10.0), None)
    _common.publish("betaflight", "Betaflight in lock-step with multirotors", on, rows, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
