"""From an operation to the scenario that is flown: site, area, vehicles, reactions, and the length of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.errors import ScenarioError, UsageError, did_you_mean, warn_user
from qrsim.files import Content
from qrsim.models.atmosphere.wind import ROUGHNESS_M
from qrsim.models.site import Site
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.scenarios.multirotor_checks import thrust_to_weight
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.reading import merged, read_scenario
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.vehicle_file import read_vehicle_file
from qrsim.scenarios.weather import velocity
from qrsim.studies.brief.operation import MissionSpec, OperationSpec, WindSpec
from qrsim.studies.brief.surroundings import area_of, ground_of, site_of
from qrsim.studies.brief.words import spread

# Largest distance between two homes [m].
FARTHEST = 50e3
# Largest length of a run [s], and how much longer than its path a run is.
LONGEST_S, SLACK, SLACK_S = 3600.0, 1.5, 30.0
TIME_STEP = 0.02
# Least thrust to weight of a vehicle that flies in gusts.
LEAST_LIFT = 1.2
# Starts over which a window is spread.
STARTS = 4
# From seconds to the microseconds of PX4's EKF2_NOAID_TOUT.
_NOAID = 1e6
SENSORS: dict[str, Content] = {
    "gnss": {"type": "gnss", "preset": "f9p_single"},
    "imu": {"type": "imu", "preset": "icm42688p"},
    "magnetometer": {"type": "magnetometer"},
    "barometer": {"type": "barometer"},
}
_LOW_BATTERY = {"warn": "warn", "land": "land", "return": "return_or_land"}


@dataclass(frozen=True)
class Flights:
    """What is flown.

    Attributes:
        content: the scenario, every place in NED.
        scenario: the same, checked.
        names: of the vehicles, in the order of the missions.
        wind: forecast at its height, that of a file at the start of the flights included.
        planned_s: time of the path of each vehicle [s], without wind.
        plans: of the missions.
        assumed: defaults that count, one sentence each.
        starts: times of the starts over the window, ISO 8601 in UTC; one without a window.
        at_starts: the scenario at each start.
    """

    content: Content
    scenario: Scenario
    names: tuple[str, ...]
    wind: WindSpec
    planned_s: tuple[float, ...]
    plans: tuple[Plan, ...]
    assumed: tuple[str, ...]
    starts: tuple[str, ...]
    at_starts: tuple[Scenario, ...]

    @property
    def settings(self) -> tuple[Content, ...]:
        """Path -> value that each start time sets in the scenario, one dict per start."""
        keys = ("wind", "turbulence") if self.wind.file is not None else ()
        worlds = [scenario.spec.model_dump(mode="json")["world"] for scenario in self.at_starts if keys]
        return tuple(
            {"start_time": start, **{f"world.{key}": worlds[i][key] for key in keys}}
            for i, start in enumerate(self.starts)
        )


def flights_of(operation: OperationSpec, longest_s: float = LONGEST_S) -> Flights:
    """Return the flights of an operation: scenario, plans, starts and durations.

    Raises:
        UsageError, ScenarioError: a plan or a vehicle cannot be flown, or takes too long.
    """
    plans = tuple(plan_of(mission) for mission in operation.missions)
    names = names_of(operation)
    assumed: list[str] = []
    _check_homes(operation, plans)
    content = _content(operation, plans, names, assumed)
    content["duration"] = longest_s
    try:
        scenario = load_scenario(content, quiet=True)
    except ScenarioError as error:
        raise ScenarioError(f"operation {operation.operation}", error.problems) from None
    _check_lift(scenario, operation.uncertain.mass)
    planned = tuple(_planned_s(scenario, operation))
    wanted = SLACK * max(planned) + SLACK_S
    if max(planned) > longest_s:
        raise UsageError(
            f"{operation.operation}: takes {_time(max(planned))}; allowed: {_time(longest_s)}; see --longest"
        )
    whole = scenario.spec.model_dump(mode="json")
    for name, mission in zip(names, operation.missions, strict=True):
        if mission.delay:
            whole["fleets"][name]["vehicles"][0]["legs"].insert(0, {"type": "loiter", "time": mission.delay})
    whole["duration"] = math.ceil(min(wanted, longest_s))
    wind, file = operation.wind, operation.wind.file
    if file is not None:
        whole["world"]["wind"] = wind_file(file)
    starts = spread(operation.at, operation.window, STARTS if operation.window else 1)
    at_starts = tuple(load_scenario({**whole, "start_time": start}, quiet=i > 0) for i, start in enumerate(starts))
    if len(starts) > 1:
        assumed.append(f"The runs start at {len(starts)} times, spread over the window of {operation.window:g} min.")
    if file is not None:
        # The file's wind of the run alone, in numbers from here on.
        whole = at_starts[0].spec.model_dump(mode="json")
        wind = _wind_at_start(wind, at_starts[0])
        assumed.append(
            f"The wind is that of {Path(file).name} over height and time, without an error of the forecast: "
            f"{wind.speed:.1f} m/s from {wind.from_deg:.0f} deg at {wind.height:g} m at the start."
        )
    return Flights(whole, at_starts[0], names, wind, planned, plans, tuple(assumed), starts, at_starts)


def wind_file(file: str) -> Content:
    """Return the wind content for a file: a profile for a table, else a weather model."""
    return {"type": "profile" if Path(file).suffix.lower() == ".csv" else "weather", "file": file}


def _wind_at_start(wind: WindSpec, scenario: Scenario) -> WindSpec:
    """Return the forecast with the speed and bearing of the scenario's profile at its height."""
    north, east = (float(axis[0, 0]) for axis in velocity(scenario.spec, np.array([wind.height]), [0.0]))
    bearing = math.degrees(math.atan2(-east, -north)) % 360.0
    return wind.model_copy(update={"speed": math.hypot(north, east), "from_deg": bearing})


def plan_of(mission: MissionSpec) -> Plan:
    """Return the plan of a mission; raises UsageError if it has nothing to fly.

    Raises:
        UsageError: it cannot be read, or is empty.
        ScenarioError: it is no plan that can be flown.
    """
    file = mission.plan
    plan = read_plan(file, route=mission.route, height=mission.height)
    if not plan.waypoints:
        raise UsageError(f"{file}: mission.items: is empty; there is nothing to fly")
    if plan.again is not None:
        raise UsageError(f"{file}: repeats for ever; a brief needs a mission that ends: give its DO_JUMP a number")
    return plan


def names_of(operation: OperationSpec) -> tuple[str, ...]:
    """Return the name of each vehicle: its own, or that of its plan's file.

    Raises:
        UsageError: two have the same.
    """
    found = []
    for mission in operation.missions:
        name = mission.name or re.sub(r"[^A-Za-z0-9_-]+", "_", Path(mission.plan).stem).strip("_-") or "vehicle"
        if name in found:
            raise UsageError(f"missions: two are called '{name}'; give each a name")
        found.append(name)
    return tuple(found)


def speed_20ft(wind: WindSpec) -> float:
    """Return the ratio of the wind at 20 ft to the forecast's, by the logarithmic profile over grass."""
    return math.log(6.096 / ROUGHNESS_M) / math.log(wind.height / ROUGHNESS_M)


def bearing_deg(wind: WindSpec) -> float:
    """Return the wind's bearing [deg] from -180 to 180, so that its errors stay within scenario bounds."""
    return ((wind.from_deg or 0.0) + 180.0) % 360.0 - 180.0


def _check_homes(operation: OperationSpec, plans: tuple[Plan, ...]) -> None:
    first = plans[0].home
    site = Site.from_degrees(first.latitude_deg, first.longitude_deg, first.altitude_amsl)
    for mission, plan in zip(operation.missions, plans, strict=True):
        home = plan.home
        place = math.radians(home.latitude_deg), math.radians(home.longitude_deg)
        north, east, _ = site.geodetic_to_ned(*place, first.altitude_amsl)
        if math.hypot(north, east) > FARTHEST:
            raise UsageError(
                f"{mission.plan}: its home is {math.hypot(north, east) / 1000.0:.0f} km from that of "
                f"{operation.missions[0].plan}; allowed: {FARTHEST / 1000.0:.0f}"
            )


def _check_lift(scenario: Scenario, share: float) -> None:
    """Raise UsageError if many draws of the mass, within a relative difference, exceed the available thrust."""
    for name, fleet in scenario.spec.fleets.items():
        ratio = thrust_to_weight(fleet, scenario.spec)
        if ratio is None or ratio >= LEAST_LIFT * (1.0 + share):
            continue
        if ratio <= LEAST_LIFT:
            raise UsageError(
                f"fleets.{name}: its thrust to weight is {ratio:.2f}; allowed: above {LEAST_LIFT:g}, to hold its path "
                "in gusts; lower the mass"
            )
        heavy = (1.0 + share - ratio / LEAST_LIFT) / (2.0 * share)
        raise UsageError(
            f"uncertain.mass: {100.0 * share:g} %: {100.0 * heavy:.0f} % of the draws of {name} have a thrust to "
            f"weight below {LEAST_LIFT:g}; allowed: up to {math.floor(1000.0 * (ratio / LEAST_LIFT - 1.0)) / 10.0:g} %"
        )


def _content(operation: OperationSpec, plans: tuple[Plan, ...], names: tuple[str, ...], assumed: list[str]) -> Content:
    """Return the scenario's content, with places as in the plans."""
    below: Content = {}
    if operation.extends is not None:
        _, below = read_scenario(operation.extends)
    content: Content = {
        "name": operation.operation,
        "duration": LONGEST_S,
        "time_step": TIME_STEP,
        "start_time": operation.at,
        "site": site_of(operation, plans[0], below),
        "world": {
            "area": area_of(operation, plans, below, assumed),
            "wind": {
                "type": "log_shear",
                "speed_20ft": (operation.wind.speed or 0.0) * speed_20ft(operation.wind),
                "wind_from_deg": bearing_deg(operation.wind),
            },
            "turbulence": {"type": "dryden"},
            **ground_of(operation.site),
            **{key: value for key, value in operation.world.items() if key != "area"},
        },
        "fleets": {
            name: _fleet(mission, plan, name, operation, assumed)
            for name, mission, plan in zip(names, operation.missions, plans, strict=True)
        },
    }
    assumed.append("Legs without a speed are flown at 5 m/s. Gusts are those of MIL-F-8785C for the mean wind.")
    return merged({key: value for key, value in below.items() if key != "fleets"}, content)


def _fleet(mission: MissionSpec, plan: Plan, name: str, operation: OperationSpec, assumed: list[str]) -> Content:
    contingency = operation.contingency
    critical = contingency.low_battery.at
    if plan.waypoints[0].command != "NAV_TAKEOFF":
        warn_user(
            f"{mission.plan}: has no take-off: {name} starts in the air at item {plan.waypoints[0].item}, and the "
            "energy of the climb is not counted"
        )
    route = mission.model_dump(include={"route", "height"}, exclude_none=True)
    route = {"file": mission.plan, **route}
    if not operation.energy:
        assumed.append(f"The charge of {name} is not judged, and no failsafe reacts to it.")
    elif not mission.battery:
        assumed.append(f"{name} has a full pack of 4 cells and 5 Ah, that of an X500.")
    return {
        "vehicle": _vehicle(mission, name, assumed),
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
        "vehicles": [{"plan": route, "name": name}],
    }


def _vehicle(mission: MissionSpec, name: str, assumed: list[str]) -> Content:
    """Return a mission's vehicle as scenario content."""
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
    assumed.append(f"{name} is the parameter set '{mission.vehicle}', not identified from flights of this vehicle.")
    return {"type": "multirotor", "model": mission.vehicle}


def _planned_s(scenario: Scenario, operation: OperationSpec) -> Iterator[float]:
    """Yield each vehicle's planned flight time [s] in calm."""
    spec: Any = scenario.spec
    for (name, fleet), built, mission in zip(
        spec.fleets.items(), scenario.world().fleets, operation.missions, strict=True
    ):
        for number, leg in enumerate(fleet.vehicles[0].legs, 1):
            if leg.type == "loiter" and vars(leg).get("time") is None and vars(leg).get("turns") is None:
                raise UsageError(
                    f"{mission.plan}: leg {number} of {name} loiters for ever; a brief needs one that ends"
                )
        route: Any = built.route
        parts = (route.rise_s, route.cruise_s, route.fall_s, route.turn_s, route.hold_s)
        yield float(sum(np.sum(np.asarray(part, np.float64)) for part in parts)) + mission.delay


def _time(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"
