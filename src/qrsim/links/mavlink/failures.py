"""Failures that clients ask for by MAV_CMD_INJECT_FAILURE (420), as injected faults of one vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.mavlink.stack.codes import Result
from qrsim.models.sensors.faults import FaultSlot
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# FAILURE_TYPE by number; "ok" ends a failure.
TYPES = ("ok", "off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent", "drift")
BATTERY, MOTOR = 100, 101
# What is wrong with a motor that is: it reaches this part of its speed; a battery: it drops so far below critical.
WEAK, BELOW_CRITICAL = 0.7, 0.01
EVERY, DELAY_S, SHARE = 10, 0.5, 0.5


class _Unit(NamedTuple):
    """A FAILURE_UNIT of sensors.

    Attributes:
        name: as texts call it.
        field: of a reading, by which its sensors are known, and which is wrong, drifts or is garbage.
        wrong: what is added to it; a tenth of it a second is a drift, ten times as much is garbage.
    """

    name: str
    field: str
    wrong: float


UNITS = {
    0: _Unit("gyro", "rates_body", 0.1),
    1: _Unit("accel", "specific_force", 1.0),
    2: _Unit("mag", "field_body", 10.0),
    3: _Unit("baro", "height", 5.0),
    4: _Unit("gps", "position_ned", 20.0),
    5: _Unit("optical flow", "flow_x", 0.1),
    7: _Unit("distance sensor", "range", 2.0),
    8: _Unit("airspeed", "indicated_airspeed", 5.0),
}


class Failures:
    """What clients may let fail of one vehicle.

    Args:
        simulation: that it flies in.
        name: of the vehicle.
        number: of its MAVLink system, for records.
    """

    def __init__(self, simulation: Simulation, name: str, number: int):
        self._simulation, self._name, self._by = simulation, name, f"mavlink:{number}"
        self._fleet = next(fleet for fleet in simulation.world.fleets if name in fleet.vehicle_names)

    def inject(self, unit: int, kind: int, instances: Sequence[int], critical: float) -> tuple[Result, str]:
        """Inject the failure of an INJECT_FAILURE command (``unit``, ``kind``: MAVLink's numbers); return the result
        and a text for the client.

        Args:
            unit: FAILURE_UNIT.
            kind: FAILURE_TYPE.
            instances: numbers from 1; none: all.
            critical: charge at which a battery is critical.
        """
        if not 0 <= kind < len(TYPES) or unit not in (*UNITS, BATTERY, MOTOR):
            return Result.UNSUPPORTED, ""
        word, fleet = TYPES[kind], self._fleet
        if unit == BATTERY:
            if word not in ("ok", "off", "wrong"):
                return Result.UNSUPPORTED, ""
            charge = 0.0 if word == "off" else max(critical - BELOW_CRITICAL, 0.0)
            asked = ("ok", {}) if word == "ok" else ("drop", {"charge": charge})
            targets, what = ["battery"] * (fleet.battery_slot is not None), "battery"
        elif unit == MOTOR:
            if word not in ("ok", "off", "stuck", "wrong"):
                return Result.UNSUPPORTED, ""
            asked = ("weak", {"health": WEAK}) if word == "wrong" else (word, {})
            targets, what = _motors(fleet), "motor"
        else:
            targets, what = [slot.sensor for slot in slots_of(fleet, UNITS[unit].field)], UNITS[unit].name
            asked = _numbers(word, UNITS[unit])
        return self._inject(targets, what, instances, word, asked)

    def _inject(
        self, targets: list[str], what: str, instances: Sequence[int], word: str, asked: tuple[str, dict[str, Any]]
    ) -> tuple[Result, str]:
        """Inject a fault ``asked`` (kind, parameters) into instances (from 1; none: all) of ``targets``; return the
        result and a text."""
        if not targets:
            return Result.DENIED, f"Not injectable: {what}; start qrsim mavlink with --injectable all"
        if any(not 0 < number <= len(targets) for number in instances):
            return Result.DENIED, f"Not injected: {what} has {len(targets)} instance{'s' * (len(targets) > 1)}"
        kind, numbers = asked
        for target in [targets[number - 1] for number in instances] or targets:
            if what == "motor" and kind == "stuck":
                numbers = {"speed": self._speed(target)}
            try:
                self._simulation.inject(target, kind, self._name, asked_by=self._by, **numbers)
            except UsageError as error:
                return Result.DENIED, f"Not injected: {error}"
        which = ", ".join(map(str, instances)) or "all"
        return Result.ACCEPTED, f"Cleared: {what}" if word == "ok" else f"Injected: {what} {word}, instance {which}"

    def _speed(self, target: str) -> float:
        """Return the present speed of a rotor (``target``: "rotor N") as a fraction, 0 to 1, of its maximum."""
        fleets = [fleet.name for fleet in self._simulation.world.fleets]
        speeds: Any = self._simulation.state.fleets[fleets.index(self._fleet.name)].vehicle
        row, rotor = self._fleet.vehicle_names.index(self._name), int(target.split()[1])
        largest: Any = self._fleet.vehicle.speed_max  # type: ignore[attr-defined]
        most = np.broadcast_to(np.asarray(largest), (self._fleet.size,))[row]
        return float(min(max(speeds.rotor_speed[rotor][row] / most, 0.0), 1.0))


def slots_of(fleet: Fleet, field: str) -> Iterator[FaultSlot]:
    """Yield the fleet's slots for injected sensor faults, of the sensors that report a field such as
    ``position_ned``."""
    for slot in fleet.fault_slots:
        if any(name == field or name.startswith(f"{field}.") for name in slot.fields):
            yield slot


def _numbers(word: str, unit: _Unit) -> tuple[str, dict[str, Any]]:
    """Return the fault kind for a FAILURE_TYPE word, and fault parameters for it, since MAVLink defines no
    magnitudes."""
    wrong = unit.wrong
    of_field = {"wrong": ("bias", wrong), "drift": ("rate", 0.1 * wrong), "garbage": ("range", 10.0 * wrong)}
    if word in of_field:
        name, value = of_field[word]
        return word, {"field": unit.field, name: value}
    others: dict[str, dict[str, Any]] = {
        "slow": {"every": EVERY},
        "delayed": {"by": DELAY_S},
        "intermittent": {"share": SHARE},
    }
    return word, others.get(word, {})


def _motors(fleet: Fleet) -> list[str]:
    """Return the names "rotor N" of the fleet's rotors that can fail, those of an X quadrotor in PX4's motor order."""
    rotors = [slot.rotor for slot in fleet.rotor_slots]
    if len(rotors) == 4 and isinstance(fleet.vehicle, Multirotor) and len(fleet.vehicle.rotors) == 4:
        corners = {(True, True): 0, (False, False): 1, (True, False): 2, (False, True): 3}
        places = [fleet.vehicle.rotors[rotor] for rotor in rotors]
        found = [corners[place.position[0] > 0.0, place.position[1] > 0.0] for place in places]
        if sorted(found) == [0, 1, 2, 3]:
            rotors = [rotor for _, rotor in sorted(zip(found, rotors, strict=True))]
    return [f"rotor {rotor}" for rotor in rotors]
