"""Ways between two places of a plan that are no straight lines: over relief, and along splines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from qrsim.control.paths import Limits, corner_speed
from qrsim.links.mavlink.stack.contracts import Item, Triple
from qrsim.links.mavlink.stack.craft import Craft
from qrsim.links.mavlink.stack.fence import TERRAIN
from qrsim.links.mavlink.stack.path import braking_way
from qrsim.links.mavlink.stack.plan import place_of
from qrsim.scenarios.plans import commands as known
from qrsim.scenarios.plans.heights import over_ground
from qrsim.scenarios.plans.splines import NONE, end_tangent, spline_points

ORIGIN: Triple = (0.0, 0.0, 0.0)
LIMITS = Limits()
# Nearest to a bend that the next line begins [m].
LEAST_CUT = 0.5
# Items to which a spline goes on without a stop.
_ONWARD = known.PLACES - {known.LAND, known.TAKEOFF}


class Way:
    """Places to pass on the way to a goal, in order; none of a straight line.

    Args:
        begin: NED [m].
        places: NED [m], without the begin and the goal.
        goal: NED [m].
        limits: acceleration and jerk of turns at the places.
        after: the next goal [m]; None: none follows, or its place is not known yet.

    Attributes:
        begin: of the straight line that is flown, NED [m].
    """

    def __init__(
        self,
        begin: Triple = ORIGIN,
        places: Sequence[Triple] = (),
        goal: Triple = ORIGIN,
        limits: Limits = LIMITS,
        after: Triple | None = None,
    ):
        self.begin, self._places, self._goal, self._limits = begin, list(places), goal, limits
        self._after, self._at_goal = after, (-1.0, 0.0)
        # Of the places that are left, with the radius that it holds for.
        self._beyond: tuple[int, float, float] | None = None

    def through(self, here: Triple, radius: float) -> tuple[Triple, float] | None:
        """Return the next waypoint NED [m], passed within ``radius`` [m], and how far [m] the path may run past it;
        None: only the goal is left.

        Args:
            here: where the vehicle is [m].
            radius: distance at which a place counts as passed [m].
        """
        while self._places and self._passed(here, radius):
            self.begin = self._places.pop(0)
        if not self._places:
            return None
        left = len(self._places), radius
        if self._beyond is None or self._beyond[:2] != left:
            self._beyond = *left, self._onward(radius)
        return self._places[0], self._beyond[2]

    def beyond_goal(self, radius: float) -> float:
        """Return the distance [m] that the path may run past its goal, which limits the speed there; within ``radius``
        [m].

        It is half of ``radius``. A turn of more than a right angle would then lead too near to the goal: there it is
        less, so that the turn begins at the speed of the same turn in a plan from a file.

        Args:
            radius: distance from the goal at which the way to the next one begins [m].
        """
        if self._at_goal[0] != radius:
            self._at_goal = radius, self._beyond_goal(radius)
        return self._at_goal[1]

    def _beyond_goal(self, radius: float) -> float:
        """Return the distance [m] that the path may run past its goal: half the radius, less for turns of more than 90
        degrees."""
        if self._after is None:
            return 0.5 * radius
        come, leave = np.subtract(self._goal, self.begin), np.subtract(self._after, self._goal)
        lengths = [max(float(np.linalg.norm(way)), 1e-6) for way in (come, leave)]
        cosine = float(come @ leave) / (lengths[0] * lengths[1])
        if cosine >= 0.0:
            return 0.5 * radius
        cut = min(radius, 0.5 * lengths[0], 0.5 * lengths[1])
        speed = corner_speed(cut, math.acos(max(cosine, -1.0)), self._limits)
        return min(max(braking_way(speed, self._limits.acceleration) - radius, 0.0), 0.5 * radius)

    def _passed(self, here: Triple, radius: float) -> bool:
        """Return whether the vehicle, within ``radius`` [m] of the next waypoint, has passed it or may turn to the line
        after it."""
        place = self._places[0]
        after = self._places[1] if len(self._places) > 1 else self._goal
        away = math.dist(here, place)
        if away >= radius:
            return False
        cut = 0.5 * min(math.dist(self.begin, place), math.dist(place, after))
        behind = sum((h - b) * (b - a) for h, b, a in zip(here, place, self.begin, strict=True)) > 0.0
        return behind or away < max(LEAST_CUT, cut)

    def _onward(self, radius: float) -> float:
        """Return the distance [m] past the next waypoint that limits the speed there, so that all later bends can be
        flown.

        Args:
            radius: largest distance from a place at which the next line begins [m].
        """
        most, ends = self._limits.acceleration, [self.begin, *self._places, self._goal]
        ways = [np.subtract(b, a) for a, b in pairwise(ends)]
        lengths = [max(float(np.linalg.norm(way)), 1e-6) for way in ways]
        found, away = sum(lengths[1:]), 0.0
        for k in range(len(ways) - 1):
            turned = math.acos(min(max(float(ways[k] @ ways[k + 1]) / (lengths[k] * lengths[k + 1]), -1.0), 1.0))
            cut = min(radius, 0.5 * lengths[k], 0.5 * lengths[k + 1])
            found = min(found, away + braking_way(corner_speed(cut, turned, self._limits), most))
            away += lengths[k + 1]
        return found

    def join(self, here: Triple) -> None:
        """Drop the waypoints before the leg that is nearest to the vehicle."""
        ends = [self.begin, *self._places, self._goal]
        nearest = min(range(len(ends) - 1), key=lambda i: _apart(here, ends[i], ends[i + 1]))
        self.begin = ends[nearest]
        del self._places[:nearest]


def way_to(items: Sequence[Item], item: Item, begin: Triple | None, goal: Triple, craft: Craft) -> Way:
    """Return the waypoints and limits of the path that the vehicle flies to an item of a mission, from ``begin`` to
    ``goal``.

    Args:
        items: of the plan.
        item: one of them.
        begin: where the item before it was [m]; None: there was none.
        goal: where the item is [m].
        craft: that flies there.
    """
    here = craft.seen.position_ned
    seq = next(i for i, each in enumerate(items) if each is item)
    before = [each for each in items[:seq] if each.command in known.PLACES]
    places: list[list[float]] = []
    if item.command == known.SPLINE:
        first, last = _tangents(items, seq, before, begin, goal, craft)
        places = spline_points(begin or here, goal, first, last)[:-1]
    elif item.frame in TERRAIN and craft.facts.ground_down and begin and before and before[-1].frame in TERRAIN:
        places = over_ground(begin, goal, craft.facts.ground_down)
    limits = Limits(craft.parameters["MPC_ACC_HOR"], craft.parameters["MPC_JERK_AUTO"])
    passed = [(place[0], place[1], place[2]) for place in places]
    follows = _after(items, seq)
    after = place_of(follows, craft, goal) if follows and follows.command in known.WAYPOINTS else None
    way = Way(begin or craft.path.position, passed, goal, limits, after)
    way.join(here)
    return way


def _after(items: Sequence[Item], seq: int) -> Item | None:
    """Return the first mission item after ``seq`` that has a position or is a return; None without one."""
    leads = (each for each in items[seq + 1 :] if each.command in known.PLACES or each.command == known.RETURN)
    return next(leads, None)


def _tangents(
    items: Sequence[Item], seq: int, before: Sequence[Item], begin: Triple | None, goal: Triple, craft: Craft
) -> tuple[Sequence[float], Sequence[float]]:
    """Return the tangent vectors at start and end of item ``seq``, a spline; zeros where the vehicle stops. ``before``:
    earlier items."""
    first: Sequence[float] = NONE
    if begin and len(before) > 1 and before[-1].command in known.WAYPOINTS and not before[-1].params[0] > 0.0:
        # A take-off without a place was at home.
        origin = place_of(before[-2], craft, craft.home.position_ned if craft.home else begin)
        ahead = goal if before[-1].command == known.SPLINE else begin
        first = [b - a for a, b in zip(origin, ahead, strict=True)]
    after = _after(items, seq)
    onward = after is not None and after.command in _ONWARD and not items[seq].params[0] > 0.0
    if after is None or not onward:
        return first, NONE
    onto = place_of(after, craft, goal)
    return first, end_tangent(begin or craft.seen.position_ned, goal, onto, after.command == known.SPLINE)


def _apart(here: Triple, begin: Triple, end: Triple) -> float:
    """Return the distance [m] of ``here`` from the straight segment ``begin`` to ``end``, NED [m]."""
    way = [b - a for a, b in zip(begin, end, strict=True)]
    length2 = sum(each * each for each in way)
    along = sum((h - a) * each for h, a, each in zip(here, begin, way, strict=True))
    share = min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return math.dist(here, [a + share * each for a, each in zip(begin, way, strict=True)])
