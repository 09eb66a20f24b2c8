"""Fence and rally plans: what is accepted, and whether a place is inside."""

from __future__ import annotations

import math
from collections.abc import Sequence

from qrsim.links.mavlink.stack.codes import PlanResult
from qrsim.links.mavlink.stack.contracts import Item, Triple
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.models.scene.zone import GroundDown, Point, Zone, Zones

RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = 5000, 5001, 5002, 5003, 5004
RALLY_POINT = 5100
# Frames of latitude and longitude: altitudes above mean sea level, above home, above the ground; the higher number of
# each pair is that of integers.
AMSL, RELATIVE, TERRAIN = (0, 5), (3, 6), (10, 11)
GLOBAL = frozenset((*AMSL, *RELATIVE, *TERRAIN))
MOST_ITEMS = 1000


class Fence:
    """Zones that a vehicle is to stay in and out of, in the site's frame.

    Args:
        zones: inclusions and exclusions.
        guard: another fence that holds as well; None: none.
        ground: down coordinate [m] of the ground, for zones above terrain.
    """

    def __init__(self, zones: Sequence[Zone] = (), guard: Fence | None = None, ground: GroundDown | None = None):
        self._guard, self._zones = guard, Zones(zones, ground)

    @property
    def empty(self) -> bool:
        """Whether the fence has no zones."""
        return not self._zones.all and (self._guard is None or self._guard.empty)

    def inside(self, north: float, east: float, down: float = math.nan) -> bool:
        """Return whether a position NED [m] is allowed: in an inclusion zone if there are any, in no exclusion zone,
        and in ``guard``.

        Without ``down`` the zones reach over all heights.
        """
        if self._guard is not None and not self._guard.inside(north, east, down):
            return False
        return self._zones.inside(north, east, None if math.isnan(down) else down)

    def crosses(self, begin: Triple, end: Triple) -> bool:
        """Return whether the straight line from ``begin`` to ``end``, NED [m], leaves the fence, checked every 2 m."""
        length = math.hypot(*(b - a for a, b in zip(begin, end, strict=True) if math.isfinite(b - a)))
        steps = max(1, math.ceil(length / 2.0))
        return not all(
            self.inside(*(a + (b - a) * step / steps for a, b in zip(begin, end, strict=True)))
            for step in range(steps + 1)
        )

    @staticmethod
    def of(items: Sequence[Item], geodesy: Geodesy, guard: Fence | None = None) -> tuple[Fence, PlanResult, int]:
        """Return the fence of a fence plan within ``guard``, the upload's result, and the invalid item's sequence
        number or -1."""
        zones, result, bad = zones_of(items, geodesy)
        return Fence(zones, guard), result, bad


def zones_of(items: Sequence[Item], geodesy: Geodesy) -> tuple[list[Zone], PlanResult, int]:
    """Return a fence plan's zones up to its first invalid item, the upload's result, and that item's sequence number or
    -1."""
    zones: list[Zone] = []
    index = 0
    if len(items) > MOST_ITEMS:
        return zones, PlanResult.NO_SPACE, MOST_ITEMS
    while index < len(items):
        item = items[index]
        if item.frame not in GLOBAL:
            return zones, PlanResult.UNSUPPORTED_FRAME, index
        bad = bad_place(item)
        if bad is not None:
            return zones, bad, index
        if item.command in (INCLUSION, EXCLUSION):
            count, result, wrong = _corners(items, index)
            if result is not PlanResult.ACCEPTED:
                return zones, result, wrong
            corners = tuple(_point(corner, geodesy) for corner in items[index : index + count])
            zones.append(Zone(item.command == INCLUSION, (corners,)))
            index += count
            continue
        if item.command in (CIRCLE_INCLUSION, CIRCLE_EXCLUSION):
            radius = item.params[0]
            if not 0.0 <= radius < math.inf:
                return zones, PlanResult.INVALID_PARAM1, index
            # MAVSDK's way to say that there is no circle: one of radius 0.
            if radius > 0.0:
                zones.append(Zone(item.command == CIRCLE_INCLUSION, (), _point(item, geodesy), radius))
        elif item.command != RETURN_POINT:
            return zones, PlanResult.UNSUPPORTED, index
        index += 1
    return zones, PlanResult.ACCEPTED, -1


def items_of(zones: Sequence[Zone], geodesy: Geodesy) -> tuple[Item, ...]:
    """Convert zones to the items of a fence plan, which have no heights; holes become exclusion zones."""
    items: list[Item] = []

    def add(command: int, first: float, place: Point) -> None:
        """Append a fence item at (north, east) [m]; ``first``: its radius [m] or number of corners."""
        latitude, longitude, _ = geodesy.to_geodetic((*place, 0.0))
        params = (first, 0.0, 0.0, 0.0)
        items.append(Item(len(items), 5, command, params, round(latitude * 1e7), round(longitude * 1e7)))

    for zone in zones:
        if not zone.rings:
            add(CIRCLE_INCLUSION if zone.keep else CIRCLE_EXCLUSION, zone.radius, zone.centre)
        for number, ring in enumerate(zone.rings):
            for corner in ring:
                add(INCLUSION if zone.keep and number == 0 else EXCLUSION, float(len(ring)), corner)
    return tuple(items)


def _corners(items: Sequence[Item], first: int) -> tuple[int, PlanResult, int]:
    """Return the corner count of the polygon that starts at item ``first``, the result, and the invalid item's index or
    -1."""
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
    """Check the items of a rally plan; return the result, and the first invalid item's sequence number or -1."""
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
    """Return the result that refuses an item with a latitude or longitude out of range; None if both are valid."""
    if abs(item.x) > 900_000_000:
        return PlanResult.INVALID_PARAM5_X
    return PlanResult.INVALID_PARAM6_Y if abs(item.y) > 1_800_000_000 else None


def _point(item: Item, geodesy: Geodesy) -> Point:
    """Return (north, east) [m] of a fence item, given in latitude and longitude."""
    north, east, _ = geodesy.to_ned(item.x * 1e-7, item.y * 1e-7, geodesy.height)
    return north, east
