"""Fence and rally plans: what is accepted, and whether a place is inside."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.mavlink.stack.codes import PlanResult
from qrsim.links.mavlink.stack.contracts import Item, Triple
from qrsim.links.mavlink.stack.geodesy import Geodesy

RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = 5000, 5001, 5002, 5003, 5004
RALLY_POINT = 5100
# Frames of latitude and longitude: altitudes above mean sea level, above home, above the ground; the higher number of
# each pair is that of integers.
AMSL, RELATIVE, TERRAIN = (0, 5), (3, 6), (10, 11)
GLOBAL = frozenset((*AMSL, *RELATIVE, *TERRAIN))
MOST_ITEMS = 1000
Point = tuple[float, float]


class Fence:
    """Areas that a vehicle is to stay in and out of, in the site's frame.

    Args:
        area: a polygon (north, east) [m] that is an inclusion from the start.
        guard: another fence that holds as well; None: none.
    """

    def __init__(self, area: Sequence[Point] = (), guard: Fence | None = None):
        self._guard = guard
        self._polygons: list[tuple[bool, tuple[Point, ...]]] = [(True, tuple(area))] if area else []
        self._circles: list[tuple[bool, Point, float]] = []

    @property
    def empty(self) -> bool:
        """Whether there is nothing to stay in or out of."""
        return not (self._polygons or self._circles) and (self._guard is None or self._guard.empty)

    def inside(self, north: float, east: float) -> bool:
        """Return whether a place [m] is in one of the inclusions, if any, in no exclusion, and inside the guard."""
        if self._guard is not None and not self._guard.inside(north, east):
            return False
        included = has = False
        for includes, corners in self._polygons:
            within = in_polygon(corners, north, east)
            if not includes and within:
                return False
            has, included = has or includes, included or (includes and within)
        for includes, centre, radius in self._circles:
            within = math.hypot(north - centre[0], east - centre[1]) <= radius
            if not includes and within:
                return False
            has, included = has or includes, included or (includes and within)
        return included or not has

    def crosses(self, begin: Triple, end: Triple) -> bool:
        """Return whether a straight way between two places leaves the fence, looked at every 2 m at the most."""
        steps = max(1, math.ceil(math.dist(begin[:2], end[:2]) / 2.0))
        return not all(
            self.inside(
                begin[0] + (end[0] - begin[0]) * step / steps,
                begin[1] + (end[1] - begin[1]) * step / steps,
            )
            for step in range(steps + 1)
        )

    @staticmethod
    def of(items: Sequence[Item], geodesy: Geodesy, guard: Fence | None = None) -> tuple[Fence, PlanResult, int]:
        """Return the fence of a plan within a guard, the result, and the seq of the item that is bad, else -1."""
        fence, index = Fence(guard=guard), 0
        if len(items) > MOST_ITEMS:
            return fence, PlanResult.NO_SPACE, MOST_ITEMS
        while index < len(items):
            item = items[index]
            if item.frame not in GLOBAL:
                return fence, PlanResult.UNSUPPORTED_FRAME, index
            bad = bad_place(item)
            if bad is not None:
                return fence, bad, index
            if item.command in (INCLUSION, EXCLUSION):
                count, result, wrong = _corners(items, index)
                if result is not PlanResult.ACCEPTED:
                    return fence, result, wrong
                corners = tuple(_point(corner, geodesy) for corner in items[index : index + count])
                fence._polygons.append((item.command == INCLUSION, corners))
                index += count
                continue
            if item.command in (CIRCLE_INCLUSION, CIRCLE_EXCLUSION):
                radius = item.params[0]
                if not 0.0 <= radius < math.inf:
                    return fence, PlanResult.INVALID_PARAM1, index
                # MAVSDK's way to say that there is no circle: one of radius 0.
                if radius > 0.0:
                    fence._circles.append((item.command == CIRCLE_INCLUSION, _point(item, geodesy), radius))
            elif item.command != RETURN_POINT:
                return fence, PlanResult.UNSUPPORTED, index
            index += 1
        return fence, PlanResult.ACCEPTED, -1


def _corners(items: Sequence[Item], first: int) -> tuple[int, PlanResult, int]:
    """Return how many corners a polygon has that begins at an item, and what is wrong with them."""
    begin = items[first]
    count = begin.params[0]
    if not (math.isfinite(count) and count == int(count) and 3 <= count <= MOST_ITEMS):
        return 0, PlanResult.INVALID_PARAM1, first
    for index in range(first, first + int(count)):
        if index >= len(items):
            return 0, PlanResult.INVALID, first
        item = items[index]
        if item.command != begin.command or item.params[0] != count:
            return 0, PlanResult.INVALID_PARAM1, index
        if item.frame not in GLOBAL:
            return 0, PlanResult.UNSUPPORTED_FRAME, index
        bad = bad_place(item)
        if bad is not None:
            return 0, bad, index
    return int(count), PlanResult.ACCEPTED, -1


def rally_points(items: Sequence[Item]) -> tuple[PlanResult, int]:
    """Return whether a plan is one of rally points: the result, and the seq of the item that is bad, else -1."""
    if len(items) > MOST_ITEMS:
        return PlanResult.NO_SPACE, MOST_ITEMS
    for index, item in enumerate(items):
        if item.command != RALLY_POINT:
            return PlanResult.UNSUPPORTED, index
        if item.frame not in GLOBAL:
            return PlanResult.UNSUPPORTED_FRAME, index
        bad = bad_place(item)
        if bad is not None:
            return bad, index
        if not math.isfinite(item.z):
            return PlanResult.INVALID_PARAM7, index
    return PlanResult.ACCEPTED, -1


def bad_place(item: Item) -> PlanResult | None:
    """Return what is wrong with latitude or longitude of an item, None where nothing is."""
    if abs(item.x) > 900_000_000:
        return PlanResult.INVALID_PARAM5_X
    return PlanResult.INVALID_PARAM6_Y if abs(item.y) > 1_800_000_000 else None


def in_polygon(corners: Sequence[Point], north: float, east: float) -> bool:
    """Return whether a place is inside a polygon (even-odd rule); all in [m]."""
    inside = False
    before = corners[-1]
    for corner in corners:
        if (corner[0] > north) != (before[0] > north):
            share = (north - corner[0]) / (before[0] - corner[0])
            if east < corner[1] + share * (before[1] - corner[1]):
                inside = not inside
        before = corner
    return inside


def _point(item: Item, geodesy: Geodesy) -> Point:
    north, east, _ = geodesy.to_ned(item.x * 1e-7, item.y * 1e-7, geodesy.height)
    return north, east
