"""What the MAVLink flight stack of a vehicle costs a tick, and 50 of them at 50 Hz, by what the vehicles do.

Vehicles are points that are where their last order says, so that nothing but ``tick()`` is measured.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import _common

VEHICLES, RATE_HZ, TICKS = 50, 50.0, 500
HEADINGS = {
    "what": "what they do",
    "microseconds": "tick [us]",
    "core_percent": "50 at 50 Hz [% of a core]",
    "target": "target",
}
# What the stacks of 50 vehicles may take of a core.
TARGET_PERCENT = 20.0
NAN = math.nan


class Vehicle:
    """A stack and the point that follows it."""

    def __init__(self, number: int):
        from qrsim.links.mavlink.stack.contracts import Facts, Seen
        from qrsim.links.mavlink.stack.flight_stack import FlightStack
        from qrsim.models.scene.zone import Zone
        from qrsim.models.site import Site

        area = ((-900.0, -900.0), (-900.0, 900.0), (900.0, 900.0), (900.0, -900.0))
        self.stack = FlightStack(
            Facts(f"v{number}", number + 1, has_battery=True, zones=(Zone(True, (area,)),)), Site()
        )
        self.seen = Seen(charge=0.9, present=0xF, healthy=0xF, latitude=51.7119, longitude=-0.21052)
        self.order: Any = None

    def follow(self) -> None:
        """Put the point where the order says."""
        order, seen = self.order, self.seen
        if order is not None and order.kind == "path":
            seen.position_ned, seen.velocity_ned = order.numbers[:3], order.numbers[3:6]
        elif order is not None and order.kind == "velocity":
            north, east, down = (a + 0.02 * b for a, b in zip(seen.position_ned, order.numbers, strict=False))
            seen.position_ned, seen.velocity_ned = (north, east, down), order.numbers[:3]
        seen.on_ground = seen.position_ned[2] >= 0.0
        seen.altitude = -seen.position_ned[2]
        seen.time += 1.0 / RATE_HZ

    def do(self, id: int, *params: float) -> None:
        """Give a command, which has to be accepted."""
        from qrsim.links.mavlink.stack.contracts import Command

        numbers: Any = (*params, *[NAN] * (7 - len(params)))
        result = self.stack.command(Command(id, numbers)).result
        assert result == 0, (id, result, self.stack.texts())


def _mission(vehicle: Vehicle) -> None:
    from qrsim.links.mavlink.stack.contracts import Item, PlanKind

    places = [(517_119_000 + 4_000 * (i % 2), -2_105_200 + 4_000 * (i // 2 % 2)) for i in range(40)]
    items = [Item(i, 6, 16, (0.0, 0.0, NAN, NAN), x, y, 20.0) for i, (x, y) in enumerate(places)]
    assert vehicle.stack.accept(PlanKind.MISSION, items)[0] == 0
    vehicle.do(300)


def _offboard(vehicle: Vehicle, mask: int) -> None:
    from qrsim.links.mavlink.stack.contracts import LocalTarget

    vehicle.stack.parameters.set("COM_OF_LOSS_T", 60.0)
    assert vehicle.stack.setpoint(LocalTarget(1, mask, (50.0, 20.0, -20.0), (1.0, 0.5, 0.0), yaw=0.0))
    vehicle.do(176, 1, 6)


# What vehicles in the air do then; None: they stay on the ground.
KINDS: dict[str, Callable[[Vehicle], None] | None] = {
    "stand, disarmed": None,
    "hold": lambda vehicle: None,
    "mission": _mission,
    "return": lambda vehicle: vehicle.do(20),
    "set-points, position": lambda vehicle: _offboard(vehicle, 0x9F8),
    "set-points, velocity": lambda vehicle: _offboard(vehicle, 0x9C7),
}


def measured(kind: str, begin: Callable[[Vehicle], None] | None, vehicles: int, ticks: int) -> dict[str, Any]:
    """Return the row of what vehicles do: the median of ticks."""
    flown = [Vehicle(number) for number in range(vehicles)]

    def tick() -> float:
        started = time.process_time()
        for vehicle in flown:
            vehicle.order = vehicle.stack.tick(vehicle.seen) or vehicle.order
        spent = time.process_time() - started
        for vehicle in flown:
            vehicle.follow()
        return spent

    for _ in range(100):
        tick()
    if begin is not None:
        for vehicle in flown:
            vehicle.do(400, 1)
            vehicle.do(22, *[NAN] * 6, 15.0)
        for _ in range(900):
            tick()
        for vehicle in flown:
            begin(vehicle)
    microseconds = 1e6 * statistics.median(tick() for _ in range(ticks)) / vehicles
    return {
        "what": kind,
        "microseconds": round(microseconds, 1),
        "core_percent": round(100.0 * 1e-6 * microseconds * VEHICLES * RATE_HZ, 2),
        "target": TARGET_PERCENT,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    vehicles, ticks = (2, 5) if chosen.quick else (VEHICLES, TICKS)
    results = [measured(kind, begin, vehicles, ticks) for kind, begin in KINDS.items()]
    _common.publish("flight_stack", "The MAVLink flight stack, a vehicle", on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
