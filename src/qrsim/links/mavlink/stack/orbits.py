"""Lines and circles of a fixed wing: the orders, how tight a circle may be, and where one fits into the fence."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.fence import Fence
from qrsim.models.scene.zone import Point

# Steady bank of a circle, of which a controller has a little more.
BANK_RAD, GRAVITY = math.radians(40.0), 9.80665
# Largest radius of a circle that is asked for [m].
WIDEST = 10000.0
# A wing rolls into a turn for so long, and is to fly on inside the area for so long after one [s].
ROLLS, AHEAD_S = 1.0, 6.0
# A circle is looked at in so many places, and moved towards the middle of the area in so many steps.
PLACES, STEPS = 16, 10
# Below a ceiling it keeps so far, and a circle that it chooses from the fence [m].
BELOW, BESIDE = 5.0, 20.0


def airspeed(craft: Craft) -> float:
    """Return the commanded airspeed [m/s] of a fixed wing."""
    return craft.facts.airspeed if craft.cruise is None else craft.cruise


def tightest(speed: float) -> float:
    """Return the radius [m] of a turn at an airspeed [m/s] with a bank angle of 40 degrees, in calm air."""
    return speed * speed / (GRAVITY * math.tan(BANK_RAD))


def why_no_radius(radius: float, speed: float) -> str:
    """Return why a circle of a radius [m] cannot be flown at an airspeed [m/s]; "" if it can, and for NaN."""
    least = tightest(speed)
    if abs(radius) < least:
        return f"a radius of {abs(radius):g} m is too tight, at least {math.ceil(least)} m"
    return f"a radius of {abs(radius):g} m is too wide, at most {WIDEST:g} m" if abs(radius) > WIDEST else ""


def usual_radius(craft: Craft) -> float:
    """Return the default loiter radius [m] of a fixed wing, for items without one."""
    return craft.parameters["NAV_LOITER_RAD"]


def circle(craft: Craft, centre: Triple, radius: float) -> Order:
    """Return the order to circle a centre NED [m]; radius [m], below 0 counterclockwise, enlarged if too small to
    fly."""
    wide = math.copysign(max(abs(radius), tightest(airspeed(craft))), radius)
    return Order(craft.facts.name, "track", (*centre, *centre, wide, airspeed(craft), 0.0))


def line(craft: Craft, begin: Triple, end: Triple) -> Order:
    """Return the order to fly along the straight line from ``begin`` to ``end``, NED [m]."""
    return Order(craft.facts.name, "track", (*begin, *end, 0.0, airspeed(craft), 0.0))


def fits(fence: Fence, centre: Triple, radius: float) -> bool:
    """Return whether a level circle (centre NED [m], radius [m]) lies inside a fence, checked at PLACES points."""
    angles = [2.0 * math.pi * number / PLACES for number in range(PLACES)]
    radius = abs(radius)
    return all(
        fence.inside(centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), centre[2])
        for angle in angles
    )


def fitted(craft: Craft, place: Triple, radius: float) -> Triple:
    """Return the centre NED [m] of a circle of ``radius`` [m] inside the fence, near ``place``, moved towards the
    area's middle.

    Where none fits, the middle. The height is below the ceiling.
    """
    radius = max(abs(radius), tightest(airspeed(craft)))
    z = max(place[2], craft.facts.z_min + BELOW)
    corners = _around(craft, place)
    if not corners:
        return place[0], place[1], z
    north, east = (sum(corner[axis] for corner in corners) / len(corners) for axis in (0, 1))
    for step in range(STEPS):
        share = step / STEPS
        centre = (place[0] + share * (north - place[0]), place[1] + share * (east - place[1]), z)
        if fits(craft.fence, centre, radius + BESIDE):
            return centre
    return north, east, z


def _around(craft: Craft, place: Triple) -> tuple[Point, ...]:
    """Return the outline (north, east) [m] of the inclusion zone that contains a position, else of the first zone; ()
    without any."""
    kept = [zone for zone in craft.facts.zones if zone.keep]
    held = [zone for zone in kept if zone.over(place[0], place[1])]
    return (held or kept)[0].outline if kept else ()


def here(craft: Craft) -> tuple[Triple, float]:
    """Return centre NED [m] and radius [m] of a circle to wait in: around the vehicle, or to one side of it near the
    fence."""
    place, usual, (vn, ve, _) = craft.seen.position_ned, usual_radius(craft), craft.seen.velocity_ned
    if fits(craft.fence, place, usual + BESIDE):
        return (place[0], place[1], max(place[2], craft.facts.z_min + BELOW)), usual
    course = math.atan2(ve, vn)
    tight = tightest(airspeed(craft) + math.hypot(*wind(craft)))
    found = fitted(craft, place, tight)
    # The side of the middle first.
    first = 1.0 if math.sin(math.atan2(found[1] - place[1], found[0] - place[0]) - course) >= 0.0 else -1.0
    for radius in (max(usual, tight), tight):
        for side in (first, -first):
            north, east = place[0] - side * radius * math.sin(course), place[1] + side * radius * math.cos(course)
            if fits(craft.fence, (north, east, place[2]), radius + BESIDE):
                return (north, east, found[2]), side * radius
    return found, first * tight


def wind(craft: Craft) -> tuple[float, float]:
    """Return the wind (north, east) [m/s], computed as ground velocity minus airspeed along the heading."""
    yaw, fast, (north, east, _) = craft.seen.attitude[2], airspeed(craft), craft.seen.velocity_ned
    return north - fast * math.cos(yaw), east - fast * math.sin(yaw)


def can_turn(craft: Craft) -> bool:
    """Return whether a fixed wing can still avoid the edge of the flight area, straight on or by a turn to either
    side."""
    return craft.area.empty or any(_turns(craft, side) for side in (1.0, -1.0))


def _turns(craft: Craft, side: float) -> bool:
    """Return whether a turn to one side (1 right, -1 left) and straight flight for ``AHEAD_S`` [s] stay in the flight
    area."""
    seen, fast, (blown_north, blown_east) = craft.seen, airspeed(craft), wind(craft)
    yaw, radius, inside, down = seen.attitude[2], tightest(fast), craft.area.inside, seen.position_ned[2]
    sine, cosine = math.sin(yaw), math.cos(yaw)
    rolls = ROLLS * min(max(1.0 - side * seen.attitude[0] / BANK_RAD, 0.0), 2.0)
    for turned in (math.pi * number / 8.0 for number in range(13)):
        seconds = rolls + radius * turned / fast
        ahead, beside = fast * rolls + radius * math.sin(turned), side * radius * (1.0 - math.cos(turned))
        north = seen.position_ned[0] + cosine * ahead - sine * beside + blown_north * seconds
        east = seen.position_ned[1] + sine * ahead + cosine * beside + blown_east * seconds
        if not inside(north, east, down):
            return False
        vn = fast * math.cos(yaw + side * turned) + blown_north
        ve = fast * math.sin(yaw + side * turned) + blown_east
        ahead_s = (part * AHEAD_S for part in (0.25, 0.5, 0.75, 1.0))
        if all(inside(north + seconds * vn, east + seconds * ve, down) for seconds in ahead_s):
            return True
    return False
