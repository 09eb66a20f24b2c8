"""Routes that were drawn on a map: points without commands, in KML, GPX and GeoJSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

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


def chosen(source: str, routes: Sequence[Drawn], name: str | None) -> Drawn:
    """Return the only route of a file, or the named one; routes of one name are 'NAME #1', 'NAME #2' and so on.

    Raises:
        UsageError: no route has the name, or several have.
    """
    counts, so_far, names = Counter(route.name for route in routes), Counter[str](), []
    for route in routes:
        so_far[route.name] += 1
        many = counts[route.name] > 1
        names.append(f"{route.name} #{so_far[route.name]}".strip() if many else route.name)
    found = [route for route, own in zip(routes, names, strict=True) if name in (None, route.name, own)]
    if not found:
        hint = did_you_mean(str(name), [own for own in names if own])
        raise UsageError(f"{source}: no route is called '{name}'{hint}")
    if len(found) > 1:
        listed = ", ".join(f"'{own}'" for own in names[:MOST_NAMES]) + (", ..." if len(names) > MOST_NAMES else "")
        raise UsageError(f"{source}: has {len(found)} routes; choose one by plan.route: {listed}")
    return found[0]


def drawn_plan(source: str, route: Drawn, options: Options, polygons: Sequence[FencePolygon] = ()) -> Plan:
    """Return the plan of a route.

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
    """Refuse a route or a ring of too many points.

    Raises:
        UsageError: it has.
    """
    if count > MOST_POINTS:
        raise UsageError(f"{source}: {where}: {count} points; allowed: {MOST_POINTS}")


def checked_place(source: str, where: str, latitude: float, longitude: float) -> tuple[float, float]:
    """Return a latitude and longitude [deg] of a file.

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
    """Return an altitude [m] of a file, checked to be plausible.

    Raises:
        UsageError: it is not.
    """
    if not abs(altitude) <= LARGEST_LENGTH:
        raise UsageError(
            f"{source}: {where}: altitude {altitude:g}; allowed: -{LARGEST_LENGTH:g} to {LARGEST_LENGTH:g} m"
        )
    return altitude


def closed_ring(source: str, where: str, corners: list[tuple[float, float]]) -> Corners:
    """Return the corners of a ring without the repeated first one.

    Raises:
        UsageError: it is no simple polygon.
    """
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    for problem in polygon_problems(corners):
        raise UsageError(f"{source}: {where}: {problem}")
    return tuple(corners)
