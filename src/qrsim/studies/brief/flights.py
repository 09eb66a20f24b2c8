"""From an operation to the scenario that is flown: site, area, vehicles, reactions, and the length of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.errors import ScenarioError, UsageError
from qrsim.files import Content
from qrsim.models.atmosphere.wind import ROUGHNESS_M
from qrsim.models.site import Site
from qrsim.scenarios.multirotor_checks import thrust_to_weight
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.reading import merged, read_scenario
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.weather import velocity
from qrsim.studies.brief.fleets import Fleet, Place, by_mission, fleet_content, fleets_of, number_each, places_of
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


@dataclass(frozen=True)
class Flights:
    """What is flown.

    Attributes:
        content: the scenario, every place in NED.
        scenario: the same, checked.
        names: of the vehicles, in the order of the scenario: by fleets, in each as the operation lists its missions.
        places: of the vehicles in the scenario.
        missions: of the vehicles.
        wind: forecast at its height, that of a file at the start of the flights included.
        planned_s: time of the path of each vehicle [s], without wind.
        plans: of the vehicles.
        assumed: defaults that count, one sentence each.
        starts: times of the starts over the window, ISO 8601 in UTC; one without a window.
        at_starts: the scenario at each start.
    """

    content: Content
    scenario: Scenario
    names: tuple[str, ...]
    places: tuple[Place, ...]
    missions: tuple[MissionSpec, ...]
    wind: WindSpec
    planned_s: tuple[float, ...]
    plans: tuple[Plan, ...]
    assumed: tuple[str, ...]
    starts: tuple[str, ...]
    at_starts: tuple[Scenario, ...]

    @property
    def settings(self) -> tuple[Content, ...]:
        """One dict per start time: scenario path -> value that this start time sets."""
        keys = ("wind", "turbulence") if self.wind.file is not None else ()
        worlds = [scenario.spec.model_dump(mode="json")["world"] for scenario in self.at_starts if keys]
        return tuple(
            {"start_time": start, **{f"world.{key}": worlds[i][key] for key in keys}}
            for i, start in enumerate(self.starts)
        )


def flights_of(operation: OperationSpec, longest_s: float = LONGEST_S) -> Flights:
    """Plan the flights of an operation: scenario, plans, start times and durations.

    Raises:
        UsageError, ScenarioError: a plan or a vehicle cannot be flown, or takes too long.
    """
    plans = tuple(plan_of(mission) for mission in operation.missions)
    names = names_of(operation)
    assumed: list[str] = []
    _check_homes(operation, plans)
    fleets = fleets_of(operation.missions, names)
    places = places_of(fleets)
    content = _content(operation, plans, (fleets, names), assumed)
    content["duration"] = longest_s
    try:
        scenario = load_scenario(content, quiet=True)
    except ScenarioError as error:
        problems = [by_mission(problem, fleets, names) for problem in error.problems]
        raise ScenarioError(f"operation {operation.operation}", problems) from None
    _check_lift(scenario, operation.uncertain.mass)
    order = [number for fleet in fleets for number in fleet.missions]
    names, plans = tuple(names[number] for number in order), tuple(plans[number] for number in order)
    missions = tuple(operation.missions[number] for number in order)
    planned = tuple(_planned_s(scenario, missions, names))
    wanted = SLACK * max(planned) + SLACK_S
    if max(planned) > longest_s:
        raise UsageError(
            f"{operation.operation}: takes {_time(max(planned))}; allowed: {_time(longest_s)}; see --longest"
        )
    whole = scenario.spec.model_dump(mode="json")
    number_each(fleets, whole)
    for place, mission in zip(places, missions, strict=True):
        if mission.delay:
            legs = whole["fleets"][place.fleet]["vehicles"][place.row]["legs"]
            legs.insert(0, {"type": "loiter", "time": mission.delay})
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
    return Flights(
        whole, at_starts[0], names, places, missions, wind, planned, plans, tuple(assumed), starts, at_starts
    )


def wind_file(file: str) -> Content:
    """Return the wind content for a file: a profile for a table (CSV), else a weather model."""
    return {"type": "profile" if Path(file).suffix.lower() == ".csv" else "weather", "file": file}


def _wind_at_start(wind: WindSpec, scenario: Scenario) -> WindSpec:
    """Return the forecast with speed and bearing from the scenario's wind profile, at the forecast's height."""
    north, east = (float(axis[0, 0]) for axis in velocity(scenario.spec, np.array([wind.height]), [0.0]))
    bearing = math.degrees(math.atan2(-east, -north)) % 360.0
    return wind.model_copy(update={"speed": math.hypot(north, east), "from_deg": bearing})


def plan_of(mission: MissionSpec) -> Plan:
    """Read the flight plan of an operation's mission; raises UsageError if the plan has nothing to fly.

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
    """Return each vehicle's name: that of its mission, or that of its plan's file.

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
    """Return the ratio of the wind speed at 20 ft to that at the forecast's height, by the log profile over grass."""
    return math.log(6.096 / ROUGHNESS_M) / math.log(wind.height / ROUGHNESS_M)


def bearing_deg(wind: WindSpec) -> float:
    """Return the bearing the wind comes from, -180 to 180 [deg], so that its spread stays in the schema's bounds."""
    return ((wind.from_deg or 0.0) + 180.0) % 360.0 - 180.0


def _check_homes(operation: OperationSpec, plans: tuple[Plan, ...]) -> None:
    """Raise UsageError if the homes of two plans are too far apart for one world."""
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
    """Raise UsageError if many masses, drawn within +-``share`` of the nominal one, exceed the available thrust."""
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


def _content(
    operation: OperationSpec,
    plans: tuple[Plan, ...],
    flown: tuple[tuple[Fleet, ...], tuple[str, ...]],
    assumed: list[str],
) -> Content:
    """Return the operation's scenario content; ``flown``: fleets, and names of all missions."""
    fleets, names = flown
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
        "fleets": {fleet.name: fleet_content(fleet, operation, plans, names, assumed) for fleet in fleets},
    }
    assumed.append("Legs without a speed are flown at 5 m/s. Gusts are those of MIL-F-8785C for the mean wind.")
    return merged({key: value for key, value in below.items() if key != "fleets"}, content)


def _planned_s(scenario: Scenario, missions: tuple[MissionSpec, ...], names: tuple[str, ...]) -> Iterator[float]:
    """Yield each vehicle's planned flight time [s] without wind."""
    spec: Any = scenario.spec
    each = zip(missions, names, strict=True)
    for fleet, built in zip(spec.fleets.values(), scenario.world().fleets, strict=True):
        route: Any = built.route
        parts = (route.rise_s, route.cruise_s, route.fall_s, route.turn_s, route.hold_s)
        for row, vehicle in enumerate(fleet.vehicles):
            mission, name = next(each)
            for number, leg in enumerate(vehicle.legs, 1):
                if leg.type == "loiter" and vars(leg).get("time") is None and vars(leg).get("turns") is None:
                    raise UsageError(
                        f"{mission.plan}: leg {number} of {name} loiters for ever; a brief needs one that ends"
                    )
            # Shorter missions are padded with their last leg.
            legs = int(route.count[row])
            yield float(sum(np.sum(np.asarray(part, np.float64)[:legs, row]) for part in parts)) + mission.delay


def _time(seconds: float) -> str:
    """Format a time [s] as text in seconds, minutes or hours."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"
