"""From the waypoints of a plan to the legs of a mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from qrsim.files import Content
from qrsim.scenarios.plans.heights import TOLERANCE, GroundDown, over_ground
from qrsim.scenarios.plans.plan import Condition, Plan, Waypoint
from qrsim.scenarios.plans.splines import NONE, end_tangent, spline_points

# The radius of a circle that a plan leaves to the autopilot [m]: that of ArduCopter's CIRCLE_RADIUS.
CIRCLE_RADIUS = 10.0
# A take-off to a place further away than this [m] flies there after it; and shorter ways have no heading.
ABOVE, SHORTEST = 1.0, 0.01
_SPLINE = "NAV_SPLINE_WAYPOINT"
_DOWN = ("NAV_LAND", "NAV_RETURN_TO_LAUNCH")
# Places to which a spline goes on without a stop.
_ONWARD = ("NAV_WAYPOINT", _SPLINE, "NAV_LOITER_UNLIM", "NAV_LOITER_TIME", "NAV_LOITER_TURNS", "NAV_LOITER_TO_ALT")
_BISECTIONS = 40
Place = list[float]
ToNed = Callable[[tuple[float, float]], Place]


def stands_first(plan: Plan) -> bool:
    """Return whether a plan begins on the ground, with a take-off."""
    return bool(plan.waypoints) and plan.waypoints[0].command == "NAV_TAKEOFF"


def touches_ground(plan: Plan) -> bool:
    """Return whether a plan takes off or lands."""
    return any(w.command in ("NAV_TAKEOFF", *_DOWN) for w in plan.waypoints)


def legs_of(
    plan: Plan,
    start_ned: Place,
    places_ned: Sequence[Place],
    ground_down: GroundDown,
    to_ned: ToNed,
    yaw_deg: float = 0.0,
    terrain_tolerance: float = TOLERANCE,
) -> tuple[list[Content], int | None]:
    """Convert a plan to a vehicle's legs, as scenario content; also return the index to repeat from (None: no repeat).

    Args:
        plan: its waypoints.
        start_ned: where the vehicle starts [m].
        places_ned: of each waypoint [m].
        ground_down: the ground of the scenario.
        to_ned: from latitude and longitude [deg] to a place at z = 0 [m].
        yaw_deg: heading at the start [deg].
        terrain_tolerance: largest difference of the height above the ground on the way between two such heights [m].
    """
    writer = _Writer(plan, start_ned, places_ned, ground_down, to_ned)
    writer.heading, writer.terrain_tolerance = yaw_deg, terrain_tolerance
    again = None
    for i in range(len(plan.waypoints)):
        again = len(writer.legs) if i == plan.again else again
        writer.add(i)
    return writer.legs, again


class _Writer:
    """Writes the legs of one waypoint after the other."""

    def __init__(
        self, plan: Plan, start: Place, places: Sequence[Place], ground_down: GroundDown, to_ned: ToNed
    ) -> None:
        self.plan, self.places, self.ground_down, self.to_ned = plan, places, ground_down, to_ned
        self.here = list(start)
        self.heading, self.terrain_tolerance = 0.0, TOLERANCE
        self.legs: list[Content] = [{"type": "loiter", "time": plan.delay}] if plan.delay > 0.0 else []
        # At the end of the last spline; None: the last way was no spline.
        self._tangent: Sequence[float] | None = None

    def add(self, i: int) -> None:
        """Append the legs that lead to the plan's waypoint ``i`` and carry out its command."""
        waypoint, place = self.plan.waypoints[i], self.places[i]
        way = [self.here, *self._between(i), place]
        yaw = self._yaw(waypoint)
        shared, cut = self._shared(waypoint, yaw), None
        if waypoint.until:
            before = self._shared_until(waypoint, waypoint.until)
            gate = None if waypoint.until.gate is None else self.to_ned(waypoint.until.gate)
            cut = _cut(way, _met(waypoint.until, place, gate))
        for k, point in enumerate(way[1:-1], 1):
            own = before if cut is not None and k <= cut else shared
            self.legs.append({"type": "fly", "to_ned": point, **self._facing(waypoint, way[k - 1], point), **own})
        own = before if cut is not None and cut >= len(way) - 1 else shared
        for leg in _legs_at(waypoint, place, way[-2]):
            # The speed of the whole plan is none of a take-off.
            slow = ("speed",) if leg["type"] == "take_off" and waypoint.speed is None else ()
            rest = {name: value for name, value in own.items() if name not in slow}
            self.legs.append({**leg, **self._facing(waypoint, way[-2], place), **rest})
        self._turned(waypoint, way, yaw)
        self.here = self._after(waypoint, place)

    def _between(self, i: int) -> list[Place]:
        """Return the intermediate points NED [m] on the way to waypoint ``i``, if it is a spline or follows terrain."""
        waypoint, place = self.plan.waypoints[i], self.places[i]
        last = self.plan.waypoints[i - 1] if i else None
        begin_tangent, self._tangent = self._begin_tangent(i), None
        if waypoint.command == _SPLINE:
            after = self.plan.waypoints[i + 1] if i + 1 < len(self.places) else None
            onward = after is not None and after.command in _ONWARD and waypoint.hold == 0.0
            to = self.places[i + 1] if onward else None
            self._tangent = end_tangent(self.here, place, to, after is not None and after.command == _SPLINE)
            return spline_points(self.here, place, begin_tangent, self._tangent)[:-1]
        low = waypoint.command in (*_DOWN, "NAV_TAKEOFF") or (last and last.command in _DOWN)
        if low or last is None or waypoint.above != "ground" or last.above != "ground":
            return []
        return over_ground(self.here, place, self.ground_down, self.terrain_tolerance)

    def _begin_tangent(self, i: int) -> Sequence[float]:
        """Return the tangent (3,) [m] at the start of the spline leg to waypoint ``i``; zero after a stop."""
        last = self.plan.waypoints[i - 1] if i else None
        if last is None or last.hold > 0.0 or last.command not in ("NAV_WAYPOINT", _SPLINE):
            return NONE
        if self._tangent is not None:
            return self._tangent
        if i < 2:
            return NONE
        return [b - a for a, b in zip(self.places[i - 2], self.places[i - 1], strict=True)]

    # ---- speed and heading ----

    def _shared(self, waypoint: Waypoint, yaw_deg: float | None) -> Content:
        """Return the values that all legs of a waypoint share, as scenario content: item, speeds, ``yaw_deg``."""
        speed = self.plan.hover_speed if waypoint.speed is None else waypoint.speed
        return _said(waypoint.item, speed, waypoint.climb, waypoint.sink, yaw_deg)

    def _shared_until(self, waypoint: Waypoint, until: Condition) -> Content:
        """Return the values that the legs before a condition is met share: item number, speeds and yaw."""
        speed = self.plan.hover_speed if until.speed is None else until.speed
        return _said(waypoint.item, speed, until.climb, until.sink, until.yaw_deg)

    def _yaw(self, waypoint: Waypoint) -> float | None:
        """Return the yaw [deg] that a waypoint commands, absolute or as a turn; None if it commands none."""
        if waypoint.turn_deg is not None:
            return math.remainder(self.heading + waypoint.turn_deg, 360.0)
        return waypoint.yaw_deg

    def _facing(self, waypoint: Waypoint, begin: Place, end: Place) -> Content:
        """Return the yaw of a leg with a heading relative to its course, kept on vertical legs; {} for other legs."""
        if waypoint.side_deg is None:
            return {}
        course = _course(begin, end, self.heading - waypoint.side_deg)
        return {"yaw_rad": math.radians(math.remainder(course + waypoint.side_deg, 360.0))}

    def _turned(self, waypoint: Waypoint, way: Sequence[Place], yaw_deg: float | None) -> None:
        """Store the vehicle's heading at the end of a way; ``yaw_deg`` None: it faces along the way."""
        course = self.heading
        for begin, end in pairwise(way):
            course = _course(begin, end, course)
        if waypoint.side_deg is not None:
            course = _course(way[-2], way[-1], self.heading - waypoint.side_deg) + waypoint.side_deg
        self.heading = course if yaw_deg is None else yaw_deg

    def _after(self, waypoint: Waypoint, place: Place) -> Place:
        """Return the vehicle's position NED [m] once a waypoint is done: on the ground after a landing."""
        if waypoint.command in _DOWN:
            return [*place[:2], float(self.ground_down(place[0], place[1]))]
        return place


def _said(item: int, speed: float | None, climb: float | None, sink: float | None, yaw_deg: float | None) -> Content:
    """Return the values of a leg that are not None as scenario content: item, speeds (climb, sink) [m/s] and yaw."""
    said: Content = {"item": item}
    for name, value in (("speed", speed), ("climb_speed", climb), ("sink_speed", sink)):
        if value is not None:
            said[name] = value
    if yaw_deg is not None:
        said["yaw_rad"] = math.radians(yaw_deg)
    return said


def _legs_at(waypoint: Waypoint, place: Place, here: Place) -> list[Content]:
    """Return the legs of a waypoint's command (fly, loiter, take off, land) at ``place``; ``here`` is the vehicle's."""
    name, hold = waypoint.command, waypoint.hold
    fly: Content = {"type": "fly", "to_ned": place, "hold": hold, "stop": True}
    waits: list[Content] = [{"type": "loiter", "time": hold}] if hold > 0.0 else []
    if name == "NAV_LOITER_UNLIM":
        return [{"type": "loiter", "to_ned": place}]
    if name == "NAV_LOITER_TURNS" and waypoint.turns > 0.0:
        radius = waypoint.radius or CIRCLE_RADIUS
        return [{"type": "loiter", "to_ned": place, "turns": waypoint.turns, "radius": radius}, *waits]
    if name == "NAV_TAKEOFF":
        there = math.dist(here[:2], place[:2]) <= ABOVE
        up: list[Content] = [{"type": "take_off", "height": -place[2]}] if place[2] < here[2] else []
        return [*up, *waits] if there and up else [*up, fly]
    if name in _DOWN:
        higher = waypoint.climbs and place[2] < here[2] - SHORTEST
        climb: list[Content] = [{"type": "fly", "to_ned": [*here[:2], place[2]], "stop": True}] if higher else []
        return [*climb, {"type": "land", "at_ned": place[:2], "hold": hold}]
    if name in ("NAV_WAYPOINT", _SPLINE):
        own = {} if waypoint.accept_radius is None else {"accept_radius": waypoint.accept_radius}
        return [{**fly, **own, "stop": hold > 0.0}]
    return [fly]


def _course(begin: Place, end: Place, otherwise: float) -> float:
    """Return the course [deg] from one place to another; ``otherwise`` if one is above the other."""
    north, east = end[0] - begin[0], end[1] - begin[1]
    return math.degrees(math.atan2(east, north)) if math.hypot(north, east) > SHORTEST else otherwise


def _met(until: Condition, place: Place, gate: Place | None) -> Callable[[Place], bool]:
    """Return a function that tells whether a position NED [m] meets a condition on the way to ``place``."""
    if gate is None:
        return lambda here: math.dist(here[:2], place[:2]) <= (until.distance or 0.0)
    north, east = place[0] - gate[0], place[1] - gate[1]
    return lambda here: (here[0] - gate[0]) * north + (here[1] - gate[1]) * east >= 0.0


def _cut(way: list[Place], met: Callable[[Place], bool]) -> int | None:
    """Insert into a way (points NED [m]) the first point that meets a condition; return its index, None for the start.

    Where it is not met before the end, the end is that place.
    """
    if met(way[0]):
        return None
    for k, (begin, end) in enumerate(pairwise(way), 1):
        if not met(end):
            continue
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if met(_at(begin, end, middle)) else (middle, high)
        if high < 1.0:
            way.insert(k, _at(begin, end, high))
        return k
    return len(way) - 1


def _at(begin: Place, end: Place, share: float) -> Place:
    """Interpolate between two places: return the point at ``share``, 0 to 1, of the line."""
    return [a + share * (b - a) for a, b in zip(begin, end, strict=True)]
