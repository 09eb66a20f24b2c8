"""A mission of a fixed wing: lines from place to place, and circles."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.contracts import Order
from qrsim.links.mavlink.stack import orbits, plan
from qrsim.links.mavlink.stack.codes import PlanResult, Severity
from qrsim.links.mavlink.stack.contracts import FlavourName, Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.mission import Mission
from qrsim.scenarios.plans import commands as known

CIRCLES = frozenset((known.LOITER_FOREVER, known.LOITER_TURNS, known.LOITER_TIME, known.LOITER_TO_ALTITUDE))
NO_RUNWAY = "a fixed wing neither takes off nor lands: there is no runway in this version"
# A line is over so near to its end, that the turn into the next one is not overshot, and a circle begun so near to it;
# a height counts as reached within the second [m].
REACH, HEIGHT_REACH = 40.0, 10.0
# Largest airspeed that may be asked for, over that of cruise.
FASTEST = 1.5


class Tour(Mission):
    """A mission in the air.

    Attributes:
        end: the place that was flown to last, NED [m]; None before there was one.
    """

    def __init__(self, flavour: FlavourName = "px4") -> None:
        super().__init__(flavour)
        self.end: Triple | None = None

    def _forget(self) -> None:
        """Forget the progress within the current mission item."""
        super()._forget()
        self._begin: Triple = (0.0, 0.0, 0.0)
        self._centre: Triple | None = None
        self._angle = self._turned = 0.0

    # ---- the plan ----

    def accept(self, items: Sequence[Item], craft: Craft) -> tuple[PlanResult, int]:
        """Replace the mission, unless an item is invalid; return the result, and the invalid item's sequence number or
        -1."""
        for index, item in enumerate(items):
            result, why = _cannot(item, craft)
            if why:
                craft.say(Severity.WARNING, f"Item {index}: {why}")
                return result, index
        return super().accept(items, craft)

    def restart(self, craft: Craft) -> None:
        """Make the first item the current one, with the mission's state NOT_STARTED."""
        self.end = None
        super().restart(craft)

    def _outside(self, craft: Craft) -> int | None:
        """Return the sequence number of the first item that lies, with its circle, outside the fence; None if all are
        inside."""
        found = plan.outside(self.items, craft)
        for index, item in enumerate(self.items if found is None else self.items[:found]):
            if item.command in CIRCLES and plan.has_place(item) and not craft.fence.empty:
                place = plan.place_of(item, craft, (0.0, 0.0, 0.0))
                if not orbits.fits(craft.fence, place, radius_of(item, craft)):
                    return index
        return found

    # ---- flight ----

    def _stay(self, craft: Craft) -> Order | None:
        """Return the order to circle the last waypoint, or a point near the vehicle; never None, since a wing cannot
        stop."""
        if self._goal is None:
            self._goal = self._from or orbits.fitted(craft, craft.seen.position_ned, orbits.usual_radius(craft))
        return orbits.circle(craft, self._goal, orbits.usual_radius(craft))

    def _go(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Fly a mission item, past its position or around it; return whether it is done, and the order."""
        if self._goal is None:
            self._begin = self._from or craft.seen.position_ned
            self._goal = self.end = plan.place_of(item, craft, self._begin)
        return self._pass(item, craft, self._goal) if item.command not in CIRCLES else self._loiter(item, craft)

    def _pass(self, item: Item, craft: Craft, goal: Triple) -> tuple[bool, Order | None]:
        """Fly along the line to ``goal`` NED [m], then circle until its height is reached; return whether it is done,
        and the order."""
        here = craft.seen.position_ned
        radius = max(item.params[1] if item.params[1] > 0.0 else 0.0, craft.parameters["NAV_ACC_RAD"], REACH)
        north, east = goal[0] - here[0], goal[1] - here[1]
        way = (goal[0] - self._begin[0], goal[1] - self._begin[1])
        passed = math.hypot(*way) > 1.0 and north * way[0] + east * way[1] < 0.0
        if self._arrived is None and (passed or math.hypot(north, east) < radius):
            self._arrived = craft.seen.time
        if self._arrived is None:
            return False, orbits.line(craft, self._begin, goal)
        if abs(goal[2] - here[2]) < HEIGHT_REACH:
            return True, orbits.line(craft, self._begin, goal)
        if self._centre is None:
            # Beside the fence not round the place itself.
            self._centre = orbits.fitted(craft, goal, orbits.usual_radius(craft))
        return False, orbits.circle(craft, self._centre, orbits.usual_radius(craft))

    def _loiter(self, item: Item, craft: Craft) -> tuple[bool, Order | None]:
        """Circle an item's position for its turns, time or height; return whether it is done, and the order."""
        here, now, goal = craft.seen.position_ned, craft.seen.time, self._goal
        assert goal is not None
        radius = radius_of(item, craft)
        order = orbits.circle(craft, goal, radius)
        north, east = here[0] - goal[0], here[1] - goal[1]
        angle = math.atan2(east, north)
        if self._arrived is None:
            near = math.hypot(north, east) < abs(order.numbers[6]) + REACH and abs(goal[2] - here[2]) < HEIGHT_REACH
            if not near:
                return False, order
            self._arrived, self._angle, self._turned = now, angle, 0.0
        self._turned += math.copysign(1.0, radius) * math.remainder(angle - self._angle, 2.0 * math.pi)
        self._angle = angle
        if item.command == known.LOITER_TURNS:
            return self._turned >= 2.0 * math.pi * item.params[0], order
        if item.command == known.LOITER_TIME:
            return now - self._arrived >= (item.params[0] if item.params[0] > 0.0 else 0.0), order
        return item.command == known.LOITER_TO_ALTITUDE, order


def radius_of(item: Item, craft: Craft) -> float:
    """Return the loiter radius [m] of a mission item, negative for counterclockwise; ``NAV_LOITER_RAD`` if it has
    none."""
    radius = item.params[1 if item.command == known.LOITER_TO_ALTITUDE else 2]
    return radius if abs(radius) > 0.1 else orbits.usual_radius(craft)


def why_no_speed(kind: float, speed: float, craft: Craft) -> str:
    """Return why a fixed wing cannot obey a DO_CHANGE_SPEED (``kind``: speed type, speed [m/s]); "" if it can."""
    if kind not in (0.0, 1.0):
        return "a fixed wing changes its airspeed only"
    return why_no_airspeed(speed, craft) if speed >= 0.0 else ""


def why_no_airspeed(speed: float, craft: Craft) -> str:
    """Return why an airspeed [m/s] cannot be flown; "" if it can."""
    least, most = craft.facts.airspeed_min, FASTEST * craft.facts.airspeed
    if speed > most:
        return f"{speed:g} m/s is too fast, at most {most:g} m/s"
    return f"{speed:g} m/s is below the stall at {least:.3g} m/s" if speed < least else ""


def _cannot(item: Item, craft: Craft) -> tuple[PlanResult, str]:
    """Return the result and reason that refuse a mission item which a fixed wing cannot fly; (ACCEPTED, "") if it
    can."""
    if item.command in (known.TAKEOFF, known.LAND):
        return PlanResult.UNSUPPORTED, NO_RUNWAY
    if item.command == known.CHANGE_SPEED:
        return PlanResult.INVALID_PARAM2, why_no_speed(item.params[0], item.params[1], craft)
    if item.command in CIRCLES:
        why = orbits.why_no_radius(radius_of(item, craft), orbits.airspeed(craft))
        if why:
            to_altitude = item.command == known.LOITER_TO_ALTITUDE
            return PlanResult.INVALID_PARAM2 if to_altitude else PlanResult.INVALID_PARAM3, why
    return PlanResult.ACCEPTED, ""
