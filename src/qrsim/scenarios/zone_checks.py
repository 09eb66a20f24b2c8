"""Checks of zones: of each alone, and of starts and legs against them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.scene.fence import polygon_problems
from qrsim.models.scene.zone import CIRCLE_CORNERS, TERRAIN_STEP, GroundDown, Point, Triple, Zone, Zones, height_of
from qrsim.scenarios.build import ground_if_any
from qrsim.scenarios.missions import MISSION, ways_of
from qrsim.scenarios.plan_ground import ground_down
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec, VehicleSpec
from qrsim.scenarios.zone_schema import MOST_ZONE_CORNERS, MOST_ZONES, zones_of

# Shorter parts of a leg inside a zone [m] are none: it only touches its edge.
TOUCHES = 0.01
# Places along each side of a zone at which something must be left to fly in.
SAMPLES = 24


def zone_problems(scenario: ScenarioSpec) -> list[str]:
    """Return the errors of a scenario's flight zones; [] for an area of another type."""
    area = scenario.world.area
    if area.type != "zones":
        return []
    found = list(_own_problems(area))
    if found:
        return found
    zones = zones_with_ground(scenario)
    if nothing := _nothing_left(area, zones):
        return [nothing]
    found += _start_problems(scenario, zones)
    if not area.allow_crossing:
        found += _crossings(scenario, zones)
    return found


def zone_warnings(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield a warning for each mission leg through an exclusion zone, if the scenario allows such legs."""
    area = scenario.world.area
    if area.type == "zones" and area.allow_crossing:
        yield from _crossings(scenario, zones_with_ground(scenario))


def zones_with_ground(scenario: ScenarioSpec) -> Zones:
    """Return a scenario's zones in NED, with the ground model if a zone has heights above terrain."""
    zones = zones_of(scenario.world.area)
    ground = ground_if_any(scenario) if any(zone.terrain for zone in zones) else None
    return Zones(zones, None if ground is None else ground_down(ground))


def _own_problems(area: object) -> Iterator[str]:
    """Yield the errors of zones by themselves: their number, corners and holes."""
    zones = zones_of(area)
    if not zones:
        yield "world.area: has no zones; give stay_in, stay_out or both, or leave world.area out"
    corners = sum(len(ring) for zone in zones for ring in zone.rings)
    if len(zones) > MOST_ZONES:
        yield f"world.area: has {len(zones)} zones; allowed: at most {MOST_ZONES}"
    if corners > MOST_ZONE_CORNERS:
        yield f"world.area: its zones have {corners} corners; allowed: at most {MOST_ZONE_CORNERS} in all"
        return
    for key in ("stay_in", "stay_out"):
        for i, spec in enumerate(getattr(area, key)):
            rings = [] if spec.polygon_ned is None else [spec.polygon_ned, *spec.holes_ned]
            for number, ring in enumerate(rings):
                part = "polygon_ned" if number == 0 else f"holes_ned.{number - 1}"
                path = f"world.area.{key}.{i}.{part}"
                problems = polygon_problems(ring)
                yield from (f"{path}: {problem}" for problem in problems)
                if number and not problems and not _within(ring, rings[0]):
                    yield f"{path}: is not inside polygon_ned; allowed: a hole in it"


def _within(hole: list[list[float]], outline: list[list[float]]) -> bool:
    """Return whether all corners of a hole are inside a polygon, or on its edge."""
    zone = Zone(True, (tuple((north, east) for north, east in outline),))
    return all(zone.signed(north, east, 0.0) > -TOUCHES for north, east in hole)


def _nothing_left(area: Any, zones: Zones) -> str:
    """Return an error if none of the sampled points of the inclusion zones may be flown in; else ""."""
    kept = [zone for zone in zones.all if zone.keep]
    top, bottom = -area.z_min, -area.z_max
    for zone in kept:
        south, north, west, east = zone.bounds
        low, high = max(zone.floor, bottom), min(zone.ceiling, top)
        levels = [low + (high - low) * part for part in (0.02, 0.25, 0.5, 0.75, 0.98)]
        parts = [(number + 0.5) / SAMPLES for number in range(SAMPLES)]
        places = [(south + (north - south) * i, west + (east - west) * j) for i in parts for j in parts]
        for (x, y), known in zip(places, _ground_at(zones, places), strict=True):
            ground = height_of(zone, x, y, 0.0, known)
            if any(zones.inside(x, y, ground - level, known) for level in levels):
                return ""
    return "world.area: nothing is left to fly in" if kept else ""


def _ground_at(zones: Zones, places: Sequence[Point]) -> list[GroundDown | None]:
    """Return for each place (north, east) [m] a function of the ground's z coordinate; None without terrain."""
    if zones.ground is None or not places:
        return [None] * len(places)
    return [_always(down) for down in _downs(zones.ground, *np.array(places, np.float64).T).tolist()]


def _downs(ground: Any, norths: Floats, easts: Floats) -> Floats:
    """Return the ground's z coordinates (n,) [m, down] at north and east (n,) [m]."""
    return np.asarray(ground(norths, easts), np.float64)


def _always(down: float) -> GroundDown:
    """Return a ground function, north and east to z coordinate, that is ``down`` [m] everywhere."""
    return lambda north, east: down


def _ground_along(zones: Zones, ways: Sequence[tuple[Triple, Triple]]) -> list[GroundDown | None]:
    """Return for each line (begin, end) NED [m] a function of the ground's z coordinate; None without terrain."""
    if zones.ground is None or not ways:
        return [None] * len(ways)
    counts = [max(1, math.ceil(2.0 * math.dist(begin, end) / TERRAIN_STEP)) for begin, end in ways]
    shares = [np.linspace(0.0, 1.0, count + 1) for count in counts]
    norths, easts = (
        np.concatenate([a[axis] + share * (b[axis] - a[axis]) for (a, b), share in zip(ways, shares, strict=True)])
        for axis in (0, 1)
    )
    own = np.split(_downs(zones.ground, norths, easts), np.cumsum([len(share) for share in shares])[:-1])
    return [_along(*way, share, part) for way, share, part in zip(ways, shares, own, strict=True)]


def _along(begin: Triple, end: Triple, shares: Floats, downs: Floats) -> GroundDown:
    """Return a ground function that interpolates z coordinates ``downs`` [m] at ``shares`` (0 to 1) of a line."""
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    square = dx * dx + dy * dy

    def down(north: float, east: float) -> float:
        """Return the ground's z coordinate [m, down] at the nearest point of the line."""
        share = ((north - begin[0]) * dx + (east - begin[1]) * dy) / square if square else 0.0
        return float(np.interp(share, shares, downs))

    return down


def _start_problems(scenario: ScenarioSpec, zones: Zones) -> Iterator[str]:
    """Yield an error for each vehicle that starts where the zones do not allow it to be."""
    for name, fleet in scenario.fleets.items():
        vehicles = fleet.vehicles if fleet.placement.type == "given" else []
        grounds = _ground_at(zones, [(each.position_ned[0], each.position_ned[1]) for each in vehicles])
        for i, (vehicle, ground) in enumerate(zip(vehicles, grounds, strict=True)):
            north, east, down = vehicle.position_ned
            distance, zone = zones.limit(north, east, down, ground)
            path = f"fleets.{name}.vehicles.{i}.position_ned"
            if zone is None or distance >= 0.0:
                continue
            if zone.keep:
                yield f"{path}: starts {-distance:.4g} m outside the zones to stay in of world.area"
            else:
                yield f"{path}: starts {-distance:.4g} m inside '{zone.name}', to stay out of"


def _crossings(scenario: ScenarioSpec, zones: Zones) -> Iterator[str]:
    """Yield an error for each leg that goes through an exclusion zone or out of all inclusion zones."""
    barred = [zone for zone in zones.all if not zone.keep]
    inside: dict[tuple[str, str], float] = {}
    first: dict[tuple[str, str], Triple] = {}
    ways = list(_ways(scenario))
    grounds = _ground_along(zones, [(begin, end) for _, begin, end in ways])
    for (path, begin, end), ground in zip(ways, grounds, strict=True):
        found = [(f"inside '{zone.name}'", zone.along(begin, end, ground)) for zone in barred]
        found.append(("outside the zones to stay in", zones.outside(begin, end, ground)))
        for words, (length, where) in found:
            if length > TOUCHES and where is not None:
                inside[path, words] = inside.get((path, words), 0.0) + length
                first.setdefault((path, words), where)
    for (path, words), length in inside.items():
        # In decimetres, so that the error of a conversion is 0.
        north, east = (round(axis, 1) + 0.0 for axis in first[path, words][:2])
        yield f"{path}: {length:.4g} m of it are {words}, first at north {north:.4g}, east {east:.4g} m"


def _ways(scenario: ScenarioSpec) -> Iterator[tuple[str, Triple, Triple]]:
    """Yield (path, begin, end) NED [m] of each straight line of all routes and missions; circles become polygons."""
    ground = ground_if_any(scenario)
    for name, fleet in scenario.fleets.items():
        for i, vehicle in enumerate(fleet.vehicles):
            path = f"fleets.{name}.vehicles.{i}"
            if fleet.guidance.type == MISSION and ground is not None and fleet.placement.type == "given":
                yield from _mission_ways(path, fleet, vehicle, ground)
            elif fleet.guidance.type != MISSION:
                yield from _route_ways(path, fleet, vehicle)


def _route_ways(path: str, fleet: FleetSpec, vehicle: VehicleSpec) -> Iterator[tuple[str, Triple, Triple]]:
    """Yield (path, begin, end) NED [m] of each straight line between a vehicle's waypoints."""
    points = [_triple(point) for point in vehicle.waypoints_ned]
    if points and fleet.placement.type == "given":
        yield f"{path}.waypoints_ned.0", _triple(vehicle.position_ned), points[0]
    for j, (begin, end) in enumerate(pairwise(points), 1):
        yield f"{path}.waypoints_ned.{j}", begin, end
    if len(points) > 1 and "repeat" in type(fleet.guidance).model_fields and fleet.guidance.repeat:
        yield f"{path}.waypoints_ned.0", points[-1], points[0]


def _mission_ways(
    path: str, fleet: FleetSpec, vehicle: VehicleSpec, ground: object
) -> Iterator[tuple[str, Triple, Triple]]:
    """Yield (path, begin, end) NED [m] of each straight line of a vehicle's mission."""
    place = _triple(vehicle.position_ned)
    for part, leg in ways_of(fleet, vehicle, ground):
        for end in _corners(place, leg):
            yield f"{path}.{part}", place, end
            place = end


def _corners(place: Triple, leg: Any) -> list[Triple]:
    """Return the points NED [m] that a leg from ``place`` passes; a circle becomes a polygon."""
    if leg.kind != "circle":
        return [leg.position_ned]
    north, east = leg.centre_ned
    radius, first = math.dist(place[:2], leg.centre_ned), math.atan2(place[1] - east, place[0] - north)
    turn = math.copysign(min(abs(leg.angle), 2.0 * math.pi), leg.angle)
    count = max(1, math.ceil(CIRCLE_CORNERS * abs(turn) / (2.0 * math.pi)))
    angles = [first + turn * number / count for number in range(1, count + 1)]
    return [(north + radius * math.cos(a), east + radius * math.sin(a), place[2]) for a in angles]


def _triple(point: list[float]) -> Triple:
    """Convert a list [north, east, down] [m] to a tuple."""
    north, east, down = point
    return north, east, down
