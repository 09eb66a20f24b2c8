"""From the waypoints of a QGroundControl plan to the legs of a mission."""

from __future__ import annotations

import math

from qrsim.files import Content
from qrsim.scenarios.plan import Plan, Waypoint

# The radius of a circle that a plan leaves to the autopilot [m]: that of ArduCopter's CIRCLE_RADIUS.
CIRCLE_RADIUS = 10.0
# A take-off to a place further away than this [m] flies there after it.
ABOVE = 1.0


def stands_first(plan: Plan) -> bool:
    """Return whether a plan begins on the ground."""
    return bool(plan.waypoints) and plan.waypoints[0].command == "NAV_TAKEOFF"


def touches_ground(plan: Plan) -> bool:
    """Return whether a plan takes off or lands."""
    return any(w.command in ("NAV_TAKEOFF", "NAV_LAND", "NAV_RETURN_TO_LAUNCH") for w in plan.waypoints)


def legs_of(
    plan: Plan, start_ned: list[float], places_ned: list[list[float]], home_ned: list[float]
) -> tuple[list[Content], int | None]:
    """Return the legs of a plan as a scenario writes them, and the index of the one that follows the last.

    Args:
        plan: its waypoints.
        start_ned: where the vehicle starts [m].
        places_ned: of each waypoint [m].
        home_ned: of the plan [m].
    """
    legs: list[Content] = [{"type": "loiter", "time": plan.delay}] if plan.delay > 0.0 else []
    here, again = start_ned, None
    for i, (waypoint, place) in enumerate(zip(plan.waypoints, places_ned, strict=True)):
        again = len(legs) if i == plan.again else again
        own = _legs_at(waypoint, place, here, home_ned)
        legs += [{**leg, **_shared(waypoint)} for leg in own]
        here = _after(waypoint, place, here, home_ned)
    return legs, again


def _shared(waypoint: Waypoint) -> Content:
    """Return what every leg says."""
    shared: dict[str, object] = {"item": waypoint.item}
    if waypoint.speed is not None:
        shared["speed"] = waypoint.speed
    if waypoint.yaw_deg is not None:
        shared["yaw_rad"] = math.radians(waypoint.yaw_deg)
    return shared


def _legs_at(waypoint: Waypoint, place: list[float], here: list[float], home: list[float]) -> list[dict[str, object]]:
    name, hold = waypoint.command, waypoint.hold
    fly: dict[str, object] = {"type": "fly", "to_ned": place, "hold": hold, "stop": True}
    waits = [{"type": "loiter", "time": hold}] if hold > 0.0 else []
    if name == "NAV_LOITER_UNLIM":
        return [{"type": "loiter", "to_ned": place}]
    if name == "NAV_LOITER_TURNS" and waypoint.turns > 0.0:
        radius = waypoint.radius or CIRCLE_RADIUS
        return [{"type": "loiter", "to_ned": place, "turns": waypoint.turns, "radius": radius}, *waits]
    if name == "NAV_TAKEOFF":
        there = math.dist(here[:2], place[:2]) <= ABOVE
        up = [{"type": "take_off", "height": -place[2]}] if place[2] < here[2] else []
        return [*up, *waits] if there and up else [*up, fly]
    if name in ("NAV_LAND", "NAV_RETURN_TO_LAUNCH"):
        return [{"type": "land", "at_ned": (place if name == "NAV_LAND" else home)[:2], "hold": hold}]
    if name == "NAV_WAYPOINT":
        own = {} if waypoint.accept_radius is None else {"accept_radius": waypoint.accept_radius}
        return [{**fly, **own, "stop": hold > 0.0}]
    return [fly]


def _after(waypoint: Waypoint, place: list[float], here: list[float], home: list[float]) -> list[float]:
    """Return where a vehicle is after a waypoint; on the ground, whose height is not known here, at that of home."""
    if waypoint.command in ("NAV_LAND", "NAV_RETURN_TO_LAUNCH"):
        north, east = (place if waypoint.command == "NAV_LAND" else home)[:2]
        return [north, east, home[2]]
    return place
