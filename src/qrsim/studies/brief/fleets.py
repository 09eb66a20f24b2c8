"""Fleets of an operation: missions with the same vehicle and pack share one, so that they share what is compiled."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from qrsim.errors import UsageError, did_you_mean, warn_user
from qrsim.files import Content
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.vehicle_file import read_vehicle_file
from qrsim.studies.brief.operation import MissionSpec, OperationSpec

# Most vehicles of a fleet: a scenario allows 100 faults in one, and each vehicle has four, at its own times.
MOST = 25
# Numbers of a fleet that differ from vehicle to vehicle.
OWN_NUMBERS = (
    ("battery", "capacity"),
    ("battery", "initial_charge"),
    ("vehicle", "mass"),
    ("vehicle", "drag_x"),
    ("vehicle", "drag_y"),
)
SENSORS: dict[str, Content] = {
    "gnss": {"type": "gnss", "preset": "f9p_single"},
    "imu": {"type": "imu", "preset": "icm42688p"},
    "magnetometer": {"type": "magnetometer"},
    "barometer": {"type": "barometer"},
}
_LOW_BATTERY = {"warn": "warn", "land": "land", "return": "return_or_land"}
# From seconds to the microseconds of PX4's EKF2_NOAID_TOUT.
_NOAID = 1e6


@dataclass(frozen=True)
class Fleet:
    """A fleet of an operation.

    Attributes:
        name: of the mission if it has one, else of the vehicle.
        missions: their numbers in the operation.
    """

    name: str
    missions: tuple[int, ...]


@dataclass(frozen=True)
class Place:
    """Place of a vehicle in the scenario.

    Attributes:
        fleet: its name.
        row: number of the vehicle in it.
        alone: whether the fleet has no other vehicle, so that its numbers are no lists.
    """

    fleet: str
    row: int
    alone: bool

    def path(self, number: str) -> str:
        """Return the scenario path of this vehicle's parameter, such as ``battery.capacity``."""
        return f"fleets.{self.fleet}.{number}" + ("" if self.alone else f".{self.row}")


def fleets_of(missions: Sequence[MissionSpec], names: Sequence[str]) -> tuple[Fleet, ...]:
    """Group missions into fleets, one for each vehicle and battery (at most MOST vehicles), in order of missions."""
    alike: dict[str, list[int]] = {}
    for number, mission in enumerate(missions):
        alike.setdefault(json.dumps([mission.vehicle, mission.battery], sort_keys=True), []).append(number)
    parts = [each[first : first + MOST] for each in alike.values() for first in range(0, len(each), MOST)]
    taken = {names[each[0]] for each in parts if len(each) == 1}
    found = []
    for part in parts:
        name = names[part[0]]
        if len(part) > 1:
            model = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(missions[part[0]].vehicle).stem).strip("_-") or "vehicles"
            free = (each for i in range(len(names) + 1) if (each := f"{model}_{i}" if i else model) not in taken)
            name = next(free)
            taken.add(name)
        found.append(Fleet(name, tuple(part)))
    return tuple(found)


def places_of(fleets: Sequence[Fleet]) -> tuple[Place, ...]:
    """Return the place (fleet and index) of each vehicle in the scenario, fleet by fleet."""
    return tuple(
        Place(fleet.name, row, len(fleet.missions) == 1) for fleet in fleets for row in range(len(fleet.missions))
    )


def fleet_content(
    fleet: Fleet, operation: OperationSpec, plans: Sequence[Plan], names: Sequence[str], assumed: list[str]
) -> Content:
    """Return a fleet as scenario content; adds a sentence to ``assumed`` for each default that it uses.

    Args:
        fleet: which missions it flies.
        operation: with these missions.
        plans, names: of all missions.
        assumed: defaults that count; what this fleet assumes is added.

    Raises:
        UsageError: there is no such vehicle.
    """
    contingency = operation.contingency
    critical = contingency.low_battery.at
    own = [names[number] for number in fleet.missions]
    told = own[0] if len(own) == 1 else f"Each of {', '.join(own[:-1])} and {own[-1]}"
    vehicles = []
    for number in fleet.missions:
        mission, plan = operation.missions[number], plans[number]
        if plan.waypoints[0].command != "NAV_TAKEOFF":
            warn_user(
                f"{mission.plan}: has no take-off: {names[number]} starts in the air at item "
                f"{plan.waypoints[0].item}, and the energy of the climb is not counted"
            )
        route = {"file": mission.plan, **mission.model_dump(include={"route", "height"}, exclude_none=True)}
        vehicles.append({"plan": route, "name": names[number]})
    mission = operation.missions[fleet.missions[0]]
    if not operation.energy:
        assumed.append(f"The charge of {', '.join(own)} is not judged, and no failsafe reacts to it.")
    elif not mission.battery:
        assumed.append(f"{told} has a full pack of 4 cells and 5 Ah, that of an X500.")
    return {
        "vehicle": _vehicle(mission, own[0], told, assumed),
        "controller": {"type": "cascade"},
        "guidance": {"type": "mission"},
        "estimator": {"type": "ekf"},
        "battery": {"type": "lithium_cells", **mission.battery},
        "sensors": {sensor: dict(numbers) for sensor, numbers in SENSORS.items()},
        "failsafes": {
            "COM_LOW_BAT_ACT": _LOW_BATTERY[contingency.low_battery.do if operation.energy else "warn"],
            "BAT_LOW_THR": max(0.15, critical),
            "BAT_CRIT_THR": critical,
            "BAT_EMERGEN_THR": min(0.05, critical),
            "COM_GNSSLOSS_ACT": contingency.gnss_lost.do,
            "EKF2_NOAID_TOUT": _NOAID * contingency.gnss_lost.after,
            "RTL_RETURN_ALT": contingency.return_height,
        },
        "vehicles": vehicles,
    }


def _vehicle(mission: MissionSpec, name: str, told: str, assumed: list[str]) -> Content:
    """Return the vehicle of a mission as scenario content; adds a sentence to ``assumed`` for a default model."""
    if mission.vehicle.endswith((".yaml", ".yml")):
        found = read_vehicle_file(Path(mission.vehicle))
        if found["type"] != "multirotor":
            raise UsageError(
                f"missions.{name}.vehicle: {mission.vehicle}: its type is '{found['type']}'; a brief needs the power "
                "and the rotors of a 'multirotor'"
            )
        return found
    if mission.vehicle not in SETS:
        raise UsageError(
            f"missions.{name}.vehicle: no model is called '{mission.vehicle}'{did_you_mean(mission.vehicle, SETS)} "
            "(or give a .yaml file)"
        )
    assumed.append(f"{told} is the parameter set '{mission.vehicle}', not identified from flights of this vehicle.")
    return {"type": "multirotor", "model": mission.vehicle}


def number_each(fleets: Sequence[Fleet], content: Content) -> None:
    """Replace, in place, numbers that may differ between a fleet's vehicles by lists with one for each."""
    for fleet in fleets:
        if len(fleet.missions) > 1:
            for part, key in OWN_NUMBERS:
                numbers = content["fleets"][fleet.name][part]
                numbers[key] = [numbers[key]] * len(fleet.missions)


def by_mission(problem: str, fleets: Sequence[Fleet], names: Sequence[str]) -> str:
    """Return an error text about the scenario, with paths of vehicles replaced by the names of their missions."""
    for fleet in fleets:
        for row, number in enumerate(fleet.missions):
            path = rf"\bfleets\.{re.escape(fleet.name)}\.vehicles\.{row}(?!\d)"
            problem = re.sub(path, f"missions.{names[number]}", problem)
    return problem
