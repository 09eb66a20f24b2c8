"""Routes that were drawn on a map: points without commands, in KML, GPX and GeoJSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from qrsim.errors import UsageError, did_you_mean
from qrsim.models.scene.fence import polygon_problems
from qrsim.scenarios.local import swapped_hint
from qrsim.scenarios.plans.commands import COMMANDS, WAYPOINT
from qrsim.scenarios.plans.parts import LARGEST_LENGTH
from qrsim.scenarios.plans.plan import Above, Corners, FencePolygon, Home, Plan, Waypoint

# Points of one route or ring, and names in one message.
MOST_POINTS = 20_000
MOST_NAMES = 20


@dataclass(frozen=True)
class Point:
    """A point of a route: geodetic [deg], altitude [m], None where the file has none, and its reference."""

    latitude_deg: float
    longitude_deg: float
    altitude: float | None = None
    above: Above = "sea"


@dataclass(frozen=True)
class Drawn:
    """A route of a file.

    Attributes:
        name: of it, "" where it has none.
        points: in the order of flight.
        lacks: why its points have no altitude, for messages.
    """

    name: str
    points: tuple[Point, ...]
    lacks: str


@dataclass(frozen=True)
class Options:
    """Values of a scenario for a plan.

    Attributes:
        route: name of a route; None: the file has one.
        height: of points without an altitude, above the ground [m]; None: every point has one.
        home: of the plan; None: that of the file, else its first point.
    """

    route: str | None = None
    height: float | None = None
    home: Home | None = None


@dataclass(frozen=True)
class DrawnPolygon:
    """A polygon of a file.

    Attributes:
        name: of it, "" where it has none.
        read: returns it with its holes, as a place to stay in; raises UsageError where a corner is wrong.
    """

    name: str
    read: Callable[[], FencePolygon]


Named = TypeVar("Named", Drawn, DrawnPolygon)


def named(source: str, kind: str, items: Sequence[Named], name: str | None) -> list[tuple[str, Named]]:
    """Return (unique name, item) of a file's items called ``name``; items that share a name become 'NAME #1', 'NAME
    #2'.

    Args:
        source: the file, for messages.
        kind: of the items, for messages.
        items: in the order of the file.
        name: of the items, or of one of several that share a name; None: all.

    Raises:
        UsageError: no item has the name.
    """
    counts, so_far, names = Counter(item.name for item in items), Counter[str](), []
    for item in items:
        so_far[item.name] += 1
        names.append(f"{item.name} #{so_far[item.name]}".strip() if counts[item.name] > 1 else item.name)
    found = [(own, item) for own, item in zip(names, items, strict=True) if name in (None, item.name, own)]
    if not found:
        hint = did_you_mean(str(name), [own for own in names if own])
        raise UsageError(f"{source}: no {kind} is called '{name}'{hint}")
    return found


def chosen(source: str, kind: str, items: Sequence[Named], name: str | None, key: str) -> Named:
    """Return a file's only item, or the one called ``name``.

    Args:
        source, kind, items, name: as of ``named``.
        key: where a scenario chooses, for messages.

    Raises:
        UsageError: no item has the name, or several have.
    """
    found = named(source, kind, items, name)
    if len(found) > 1:
        many = f"has {len(found)} {kind}s" if name is None else f"{len(found)} {kind}s are called '{name}'"
        listed = ", ".join(f"'{own}'" if own else "(without a name)" for own, _ in found[:MOST_NAMES])
        raise UsageError(f"{source}: {many}; choose one by {key}: {listed}{', ...' * (len(found) > MOST_NAMES)}")
    return found[0][1]


def drawn_plan(source: str, route: Drawn, options: Options, polygons: Sequence[FencePolygon] = ()) -> Plan:
    """Convert a route drawn in a map file to a plan: waypoints with heights, home, and polygons as its fence.

    Raises:
        UsageError: points have no altitude and ``options`` no height, or no point needs one.
    """
    lacking = [point for point in route.points if point.altitude is None]
    if lacking and options.height is None:
        name = f"'{route.name}'" if route.name else "its route"
        raise UsageError(f"{source}: {name} {route.lacks}; give plan.height")
    if options.height is not None and not lacking:
        raise UsageError(f"{source}: every point has an altitude; leave out plan.height")
    if not route.points:
        raise UsageError(f"{source}: its route has no points")
    first = route.points[0]
    home = options.home or Home(first.latitude_deg, first.longitude_deg)
    waypoints = []
    for number, point in enumerate(route.points, 1):
        lacks = point.altitude is None
        above: Above = "ground" if lacks else point.above
        altitude = (options.height if lacks else point.altitude) or 0.0
        height = altitude - home.altitude_amsl if above == "sea" else altitude
        waypoints.append(
            Waypoint(
                point.latitude_deg,
                point.longitude_deg,
                height,
                number,
                COMMANDS[WAYPOINT].name,
                altitude=altitude,
                above=above,
                drawn=True,
                path=f"point {number}",
            )
        )
    return Plan(home, tuple(waypoints), tuple(polygons))


def check_count(source: str, where: str, count: int) -> None:
    """Raise UsageError for a route or ring with more than MOST_POINTS points; ``where`` is its place in the file.

    Raises:
        UsageError: it has.
    """
    if count > MOST_POINTS:
        raise UsageError(f"{source}: {where}: {count} points; allowed: {MOST_POINTS}")


def checked_place(source: str, where: str, latitude: float, longitude: float) -> tuple[float, float]:
    """Return a latitude and longitude [deg] unchanged; raises UsageError out of range, with the place in the file.

    Raises:
        UsageError: they are not finite or out of range.
    """
    if not (math.isfinite(latitude) and math.isfinite(longitude)):
        raise UsageError(f"{source}: {where}: latitude and longitude are no numbers")
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        hint = "; is it longitude, latitude?" if swapped_hint(latitude, longitude) else ""
        name, value, most = ("latitude", latitude, 90) if abs(latitude) > 90.0 else ("longitude", longitude, 180)
        raise UsageError(f"{source}: {where}: {name} {value:g}; allowed: -{most} to {most} deg{hint}")
    return latitude, longitude


def checked_altitude(source: str, where: str, altitude: float) -> float:
    """Return an altitude [m] unchanged; raises UsageError for an implausible one, with its place in the file.

    Raises:
        UsageError: it is not.
    """
    if not abs(altitude) <= LARGEST_LENGTH:
        raise UsageError(
            f"{source}: {where}: altitude {altitude:g}; allowed: -{LARGEST_LENGTH:g} to {LARGEST_LENGTH:g} m"
        )
    return altitude


def closed_ring(source: str, where: str, corners: list[tuple[float, float]]) -> Corners:
    """Return the corners (latitude, longitude) [deg] of a closed ring without the repeated first corner.

    Raises:
        UsageError: it is no simple polygon.
    """
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    for problem in polygon_problems(corners):
        raise UsageError(f"{source}: {where}: {problem}")
    return tuple(corners)
