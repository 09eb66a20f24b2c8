"""From the legs of vehicles to the mission of a fleet, and what is wrong with them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.control.mission import Mission
from qrsim.control.paths import Leg, Limits, circle_speed, mission_of, plan, ramp_time, renumbered
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.files import Content
from qrsim.models.scene.contracts import down_at
from qrsim.scenarios.checks import outside
from qrsim.scenarios.ground import ON_IT, below, has_floor, stands
from qrsim.scenarios.legs import FlyLeg, LandLeg, LegSpec, LoiterLeg, ReturnLeg, TakeOffLeg
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec, VehicleSpec

MISSION = "mission"
# Closer places are one place.
SAME_PLACE = 0.01


def limits_of(guidance: Any) -> Limits:
    """Return the limits of speed and acceleration of a fleet's mission paths, from its guidance."""
    return Limits(
        acceleration=guidance.acceleration,
        jerk=guidance.jerk,
        climb=guidance.climb_speed,
        sink=guidance.sink_speed,
        descent=guidance.sink_speed,
        touchdown=min(guidance.touchdown_speed, guidance.sink_speed),
        slow_below=guidance.slow_below,
        quintic=guidance.path == "quintic",
        timeout=guidance.leg_timeout,
    )


@dataclass
class _Author:
    """Writes legs one after the other, from where a vehicle is then; keeps what was found wrong."""

    guidance: Any
    ground: object
    can_stand: bool
    start: tuple[float, float, float]
    path: str

    def __post_init__(self) -> None:
        self.limits = limits_of(self.guidance)
        self.place = self.start
        self.landed = self.endless = ""
        self.problems: list[str] = []

    def ground_down(self, north: float, east: float) -> float:
        """Return the ground's z coordinate [m, down] at a place (north, east) [m]."""
        place = record_of(Vec3, *(np.array([value], np.float64) for value in (north, east, 0.0)))
        return float(down_at(self.ground, place)[0])

    def legs(self, specs: Sequence[LegSpec], first: int = 0) -> list[list[Leg]]:
        """Convert a mission's entries from index ``first`` on; return a list of legs for each."""
        return [renumbered(self._parts(spec, j), spec.item or j + 1) for j, spec in enumerate(specs[first:], first)]

    def _parts(self, spec: LegSpec, j: int) -> list[Leg]:
        """Convert entry ``j`` of a mission to legs; record a problem if it cannot follow the entry before."""
        where = f"{self.path}.{j}"
        if self.endless:
            self.problems.append(f"{where}: is never flown, because {self.endless}, a loiter, does not end")
            self.endless = ""
        if self.landed and spec.type not in ("take_off", "land"):
            self.problems.append(f"{where}: {self.landed} has landed; the next leg must be of type take_off")
        self.landed = ""
        parts: list[Leg] = getattr(self, f"_{spec.type}")(spec, where)
        self.place = parts[-1].position_ned
        return parts

    def _own(self, spec: LegSpec) -> Content:
        """Return an entry's speeds, heading and acceptance radius as keyword arguments of ``Leg``."""
        facing = tuple(spec.facing_ned) if spec.facing_ned else None
        speed = spec.speed or self.guidance.speed
        own = {"speed": speed, "yaw": spec.yaw_rad, "facing_ned": facing, "climb": spec.climb_speed}
        return {**own, "sink": spec.sink_speed, "accept_radius": self.guidance.accept_radius}

    def _line(self, place: Sequence[float], spec: LegSpec, **more: object) -> Leg:
        """Return a straight leg to a position NED [m]; ``more`` overrides values of its entry ``spec``."""
        north, east, down = place
        return Leg((north, east, down), **{**self._own(spec), **more})

    def _fly(self, spec: FlyLeg, where: str) -> list[Leg]:
        """Return the leg to a waypoint; a hold time implies a stop; ``where`` is the entry's path for messages."""
        radius = spec.accept_radius or self.guidance.accept_radius
        return [self._line(spec.to_ned, spec, hold=spec.hold, stop=spec.stop or spec.hold > 0.0, accept_radius=radius)]

    def _take_off(self, spec: TakeOffLeg, where: str) -> list[Leg]:
        """Return the vertical leg to a height above z = 0; record a problem if it is not above the vehicle."""
        north, east, down = self.place
        if -spec.height > down + SAME_PLACE:
            self.problems.append(
                f"{where}.height: {spec.height:g} m is not above the vehicle, which is at {-down:g} m then"
            )
        speed = spec.speed or self.guidance.take_off_speed
        return [self._line((north, east, -spec.height), spec, stop=True, speed=speed)]

    def _land(self, spec: LandLeg, where: str) -> list[Leg]:
        """Return the legs of a landing at a place, or below the end of the leg before."""
        north, east = spec.at_ned or self.place[:2]
        return self._down_to(north, east, spec, where, hold=spec.hold)

    def _down_to(
        self, north: float, east: float, spec: LandLeg | ReturnLeg, where: str, hold: float = 0.0
    ) -> list[Leg]:
        """Return the legs to a position above (north, east) [m] and down to the ground; record problems."""
        down = self.ground_down(north, east)
        if not self.can_stand:
            self.problems.append(
                f"{where}: lands, but touching the ground ends the flight of this fleet; "
                f"set {self.path.split('.vehicles')[0]}.ground to parked"
            )
        elif self.place[2] > down:
            self.problems.append(f"{where}: lands from below the ground, whose height is {-down:g} m there")
        self.landed = f"item {spec.item}" if spec.item else _short(where)
        over = (
            []
            if math.dist(self.place[:2], (north, east)) < SAME_PLACE
            else [self._line((north, east, self.place[2]), spec, stop=True)]
        )
        return [*over, self._line((north, east, down), spec, kind="land", hold=hold)]

    def _loiter(self, spec: LoiterLeg, where: str) -> list[Leg]:
        """Return the legs of a circle, or of a hold in place without a radius; note a loiter that does not end."""
        centre = tuple(spec.to_ned or self.place)
        ends = spec.time is not None or spec.turns is not None
        if not ends:
            self.endless = f"item {spec.item}" if spec.item else _short(where)
        if spec.radius == 0.0:
            return [self._line(centre, spec, stop=True, hold=spec.time if ends else math.inf)]
        return self._circle(centre, spec)

    def _circle(self, centre: tuple[float, ...], spec: LoiterLeg) -> list[Leg]:
        """Return the leg to the nearest point of a loiter circle, and the circle itself."""
        north, east = self.place[0] - centre[0], self.place[1] - centre[1]
        first = math.atan2(east, north) if math.hypot(north, east) > SAME_PLACE else 0.0
        radius = abs(spec.radius)
        angle = math.inf if spec.turns is None else 2.0 * math.pi * spec.turns
        if spec.time is not None:
            speed = circle_speed(radius, spec.speed or self.guidance.speed, self.limits)
            angle = speed * max(spec.time - ramp_time(speed, self.limits), 0.0) / radius
        last = first + math.copysign(angle if math.isfinite(angle) else 0.0, spec.radius)
        ends = [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a), centre[2]) for a in (first, last)]
        to_it = self._line(ends[0], spec, stop=True)
        turn = math.copysign(angle, spec.radius)
        return [to_it, self._line(ends[1], spec, kind="circle", centre_ned=(centre[0], centre[1]), angle=turn)]

    def _return(self, spec: ReturnLeg, where: str) -> list[Leg]:
        """Return the legs back to the start, with a climb or a landing if the entry asks for one."""
        parts = []
        if spec.height is not None and -spec.height < self.place[2] - SAME_PLACE:
            parts.append(self._line((*self.place[:2], -spec.height), spec, stop=True))
            self.place = parts[-1].position_ned
        north, east = self.start[:2]
        if spec.land:
            return [*parts, *self._down_to(north, east, spec, where)]
        return [*parts, self._line((north, east, self.place[2]), spec, stop=True)]


def _short(path: str) -> str:
    """Return the last two parts of a dotted path, such as "legs.3", for messages."""
    return ".".join(path.split(".")[-2:])


def _specs(vehicle: VehicleSpec) -> tuple[str, Sequence[LegSpec]]:
    """Return the name of a vehicle's list of places, "legs" or "waypoints_ned", and its entries as leg entries."""
    if vehicle.legs:
        return "legs", vehicle.legs
    return "waypoints_ned", [FlyLeg.model_validate({"to_ned": waypoint}) for waypoint in vehicle.waypoints_ned]


def _again(fleet: FleetSpec, vehicle: VehicleSpec) -> int | None:
    """Return the index of the leg that follows a mission's last one; None if the mission ends."""
    return 0 if vehicle.repeat_from is None and fleet.guidance.repeat else vehicle.repeat_from


def _author(fleet: FleetSpec, vehicle: VehicleSpec, ground: object, path: str) -> _Author:
    """Return the converter of one vehicle's mission entries to legs, which begins at the vehicle's start."""
    north, east, down = vehicle.position_ned
    return _Author(fleet.guidance, ground, stands(fleet), (north, east, down), path)


def mission_problems(path: str, fleet: FleetSpec, scenario: ScenarioSpec, ground: object) -> Iterator[str]:
    """Yield the errors of a fleet's missions; ``ground`` is the world's ground model."""
    if fleet.guidance.type != MISSION:
        for i, vehicle in enumerate(fleet.vehicles):
            if vehicle.legs:
                yield (
                    f"{path}.vehicles.{i}.legs: the guidance '{fleet.guidance.type}' flies no legs; "
                    f"take the controller 'cascade' and the guidance 'mission'"
                )
        return
    if fleet.placement.type != "given":
        yield (
            f"{path}.placement: '{fleet.placement.type}' does not go with the guidance 'mission', whose path begins "
            "where the vehicle starts; allowed: given"
        )
    for i, vehicle in enumerate(fleet.vehicles):
        name, specs = _specs(vehicle)
        author = _author(fleet, vehicle, ground, f"{path}.vehicles.{i}.{name}")
        legs, again = author.legs(specs), _again(fleet, vehicle)
        if again is not None:
            author.legs(specs, again)
        if vehicle.repeat_from is not None and not vehicle.repeat_from < len(vehicle.legs):
            yield (
                f"{path}.vehicles.{i}.repeat_from: is {vehicle.repeat_from}; allowed: below {len(vehicle.legs)}, the "
                "number of legs"
            )
            continue
        yield from dict.fromkeys(author.problems)
        for j, parts in enumerate(legs if name == "legs" else ()):
            for problem in _outside(f"{author.path}.{j}", parts, scenario, author):
                yield problem
                break


def _outside(path: str, parts: list[Leg], scenario: ScenarioSpec, author: _Author) -> Iterator[str]:
    """Yield an error for each leg that leaves the area or enters the ground; landings may touch the area's floor."""
    floor = has_floor(scenario)
    for leg in parts:
        north, east, down = leg.position_ned
        points = [[north, east, down]]
        if leg.kind == "circle":
            middle, radius = leg.centre_ned, math.dist((north, east), leg.centre_ned)
            turns = (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi)
            points = [[middle[0] + radius * math.cos(a), middle[1] + radius * math.sin(a), down] for a in turns]
        for point in points if leg.kind != "land" else ():
            yield from outside(path, point, scenario.world.area, floor)
            down = 0.0 if floor else author.ground_down(*point[:2])
            if not floor and point[2] > down + ON_IT:
                yield below(path, point[2], down)


def ways_of(fleet: FleetSpec, vehicle: VehicleSpec, ground: object) -> Iterator[tuple[str, Leg]]:
    """Yield (path of the mission's entry, leg) for each leg of a vehicle; legs that are repeated come twice."""
    name, specs = _specs(vehicle)
    again = _again(fleet, vehicle)
    author = _author(fleet, vehicle, ground, name)
    for first in (0, again):
        for j, parts in enumerate(author.legs(specs, first) if first is not None else (), first or 0):
            yield from ((f"{name}.{j}", part) for part in parts)


def mission(fleet: FleetSpec, ground: object) -> Mission:
    """Build the missions of a checked fleet's vehicles; a vehicle without legs holds its start."""
    limits = limits_of(fleet.guidance)
    plans, again = [], []
    for vehicle in fleet.vehicles:
        author = _author(fleet, vehicle, ground, "")
        _, specs = _specs(vehicle)
        each, start = author.legs(specs), _again(fleet, vehicle)
        first = [leg for parts in each for leg in parts]
        legs = first or [Leg(author.start, yaw=vehicle.yaw_rad)]
        following = None
        if start is not None and len(first) > 1:
            # From the second time on the first leg begins where the last one ends.
            following = len(legs)
            legs = [*legs, *(leg for parts in author.legs(specs, start) for leg in parts)]
        plans.append(plan(author.start, legs, limits, following))
        again.append(following)
    return mission_of(plans, again, limits)
