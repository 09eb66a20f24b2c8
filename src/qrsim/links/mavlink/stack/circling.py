"""Circles of multirotors: the turns of a mission, and orbits."""

from __future__ import annotations

import math

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack.contracts import NAN, Item, Triple
from qrsim.links.mavlink.stack.craft import Craft

# Limits of PX4's FlightTaskOrbit: radius [m], speed [m/s], acceleration [m/s^2], and how near to the circle and its
# height it counts as on it [m].
RADII, FASTEST, ACCELERATION, ON_CIRCLE, ON_HEIGHT = (1.0, 1000.0), 10.0, 2.0, 1.0, 0.8
# Radius [m] and rate [rad/s] of ArduPilot's CIRCLE, which are its parameters of these names.
CIRCLE_RADIUS, CIRCLE_RATE = 10.0, math.radians(20.0)
# ORBIT_YAW_BEHAVIOUR; 0 looks to the centre.
HOLDS, UNCONTROLLED, TANGENT, BY_PILOT, UNCHANGED = 1, 2, 3, 4, 5


class Circle:
    """A point that goes round a place, and waits for the vehicle that follows it.

    Attributes:
        turned: angle that the point has gone [rad].
    """

    def __init__(self) -> None:
        self.turned = self._entry = 0.0

    def begin(self, craft: Craft, centre: Triple) -> None:
        """Begin a circle around a centre NED [m], at the bearing from there to the vehicle."""
        here = craft.seen.position_ned
        self.turned, self._entry = 0.0, math.atan2(here[1] - centre[1], here[0] - centre[0])

    def tangent(self, radius: float) -> float:
        """Return the heading [rad] of the tangent at the present angle of the circle; a radius below 0 means
        counterclockwise."""
        sign = math.copysign(1.0, radius)
        angle = self._entry + sign * self.turned
        return math.atan2(sign * math.cos(angle), -sign * math.sin(angle))

    def fly(self, craft: Craft, centre: Triple, radius: float, speed: float) -> tuple[Order, bool]:
        """Move the target point along the circle by one tick; return the order to follow it, and whether it moved.

        Args:
            craft: vehicle.
            centre: of the circle, NED [m].
            radius: of it [m], below 0 counterclockwise.
            speed: along it [m/s].
        """
        path, sign, radius = craft.path, math.copysign(1.0, radius), abs(radius)
        angle = self._entry + sign * self.turned
        sine, cosine = math.sin(angle), math.cos(angle)
        place = (centre[0] + radius * cosine, centre[1] + radius * sine, centre[2])
        # The point on the circle waits for the vehicle, as every path does.
        speed *= min(max(1.0 - (math.dist(craft.seen.position_ned, place) - 2.0) / 3.0, 0.0), 1.0)
        if speed == 0.0:
            return craft.go(place), False
        self.turned += speed * craft.facts.time_step / radius
        along, inward = sign * speed, -speed * speed / radius
        path.position = place
        path.velocity = (-along * sine, along * cosine, 0.0)
        path.acceleration = (inward * cosine, inward * sine, 0.0)
        return craft.follow(path.position, path.velocity, path.acceleration), True


class Orbit:
    """MAV_CMD_DO_ORBIT as PX4's FlightTaskOrbit flies it: straight to the circle, then round it.

    Attributes:
        centre: NED [m].
        radius: [m], below 0 counterclockwise.
    """

    def __init__(self) -> None:
        self.centre: Triple = (0.0, 0.0, 0.0)
        self.radius, self._speed, self._looks = RADII[0], 1.0, 0
        self._circle, self._begun, self._now, self._heading = Circle(), False, 0.0, 0.0

    @staticmethod
    def ahead(craft: Craft) -> Orbit:
        """Return an orbit as of ArduPilot's CIRCLE mode, its centre CIRCLE_RADIUS [m] ahead of the vehicle."""
        (north, east, down), yaw = craft.seen.position_ned, craft.seen.attitude[2]
        orbit = Orbit()
        centre = (north + CIRCLE_RADIUS * math.cos(yaw), east + CIRCLE_RADIUS * math.sin(yaw), down)
        orbit.ask(craft, centre, CIRCLE_RADIUS, CIRCLE_RADIUS * CIRCLE_RATE)
        return orbit

    def ask(self, craft: Craft, centre: Triple, radius: float = NAN, speed: float = NAN, looks: float = NAN) -> None:
        """Change the orbit: centre NED [m], radius [m] and speed [m/s], both clipped, ORBIT_YAW_BEHAVIOUR (``looks``);
        NaN keeps a value.

        Args:
            craft: vehicle.
            centre: NED [m].
            radius: [m], below 0 counterclockwise; the nearest in ``RADII``.
            speed: [m/s]; the largest that ``FASTEST`` and ``ACCELERATION`` allow at most.
            looks: ORBIT_YAW_BEHAVIOUR.
        """
        if math.isfinite(radius):
            self.radius = math.copysign(min(max(abs(radius), RADII[0]), RADII[1]), radius)
        if math.isfinite(speed):
            self._speed = abs(speed)
        fastest = min(FASTEST, math.sqrt(ACCELERATION * abs(self.radius)), craft.facts.speed_limit)
        self._speed = min(self._speed, fastest)
        if math.isfinite(looks) and int(looks) != UNCHANGED:
            self._looks = int(looks)
        self.centre, self._heading = centre, craft.seen.attitude[2]
        self._begun, self._now = False, 0.0

    def fly(self, craft: Craft) -> Order:
        """Return the vehicle's order in this tick: fly to the circle, then around it."""
        here, centre, radius = craft.seen.position_ned, self.centre, abs(self.radius)
        north, east = here[0] - centre[0], here[1] - centre[1]
        away = math.hypot(north, east)
        inwards = math.atan2(-east, -north) if away > 0.1 else craft.yaw
        if not self._begun:
            if abs(away - radius) >= ON_CIRCLE or abs(here[2] - centre[2]) >= ON_HEIGHT:
                craft.turn_to(inwards)
                place = (centre[0] - radius * math.cos(inwards), centre[1] - radius * math.sin(inwards), centre[2])
                return craft.go(place)
            self._begun = True
            self._circle.begin(craft, centre)
        if self._looks == HOLDS:
            craft.turn_to(self._heading)
        elif self._looks == TANGENT:
            craft.turn_to(self._circle.tangent(self.radius))
        elif self._looks not in (UNCONTROLLED, BY_PILOT):
            craft.turn_to(inwards)
        self._now = min(self._now + ACCELERATION * craft.facts.time_step, self._speed)
        return self._circle.fly(craft, centre, self.radius, self._now)[0]


def edge(centre: Triple, begin: Triple, radius: float) -> Triple:
    """Return the point NED [m] of a level circle that is nearest to ``begin``; its north point if ``begin`` is the
    centre."""
    north, east = begin[0] - centre[0], begin[1] - centre[1]
    away = math.hypot(north, east)
    share = abs(radius) / away if away > 0.01 else 0.0
    return centre[0] + (north * share if share else abs(radius)), centre[1] + east * share, centre[2]


def turn_radius(item: Item) -> float:
    """Return the radius [m] of a mission's loiter item, negative for counterclockwise; 10 m if the item has none."""
    return item.params[2] if abs(item.params[2]) > 0.1 else 10.0
