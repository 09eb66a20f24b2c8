"""A zone on the host: a polygon with holes or a circle, with floor and ceiling, to stay in or out of.

``ZonesArea`` (zones.py) decides the same in the compiled tick. Scenario checks, the fences of MAVLink, events and
pictures use this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import SupportsFloat

Point = tuple[float, float]
Triple = tuple[float, float, float]
GroundDown = Callable[[float, float], SupportsFloat]
# Ways are cut so finely [m] over terrain, whose height differs along them.
TERRAIN_STEP = 2.0
# Corners of a circle that is drawn, or that becomes a polygon.
CIRCLE_CORNERS = 72


@dataclass(frozen=True)
class Zone:
    """A zone with vertical sides.

    Attributes:
        keep: whether vehicles stay in it; False: out of it.
        rings: corners (north, east) [m] of the outline, then of each hole; empty for a circle.
        centre: of a circle (north, east) [m].
        radius: of a circle [m]; 0 for a polygon.
        floor: height of its bottom [m]; 0 or less: it reaches down without end.
        ceiling: height of its top [m], infinite: it reaches up without end.
        terrain: whether the heights count from the ground below; False: from z = 0.
        name: for messages.
    """

    keep: bool
    rings: tuple[tuple[Point, ...], ...] = ()
    centre: Point = (0.0, 0.0)
    radius: float = 0.0
    floor: float = 0.0
    ceiling: float = math.inf
    terrain: bool = False
    name: str = ""

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """South, north, west and east limit [m] of the zone."""
        if not self.rings:
            (north, east), radius = self.centre, self.radius
            return north - radius, north + radius, east - radius, east + radius
        norths, easts = zip(*self.rings[0], strict=True)
        return min(norths), max(norths), min(easts), max(easts)

    @property
    def outline(self) -> tuple[Point, ...]:
        """Corners (north, east) [m] of the zone for pictures; for a circle, points on it."""
        if self.rings:
            return self.rings[0]
        turns = (2.0 * math.pi * i / CIRCLE_CORNERS for i in range(CIRCLE_CORNERS))
        return tuple(
            (self.centre[0] + self.radius * math.cos(a), self.centre[1] + self.radius * math.sin(a)) for a in turns
        )

    def over(self, north: float, east: float) -> bool:
        """Return whether a place north and east [m] is inside the zone's sides, at any height."""
        south, top, west, right = self.bounds
        if not (south <= north <= top and west <= east <= right):
            return False
        if not self.rings:
            return math.hypot(north - self.centre[0], east - self.centre[1]) <= self.radius
        return in_polygon(self.rings[0], north, east) and not any(
            in_polygon(hole, north, east) for hole in self.rings[1:]
        )

    def level(self, height: float) -> bool:
        """Return whether a height [m] above the zone's reference level is between its floor and ceiling."""
        return (self.floor <= 0.0 or height >= self.floor) and height <= self.ceiling

    def signed(self, north: float, east: float, height: float) -> float:
        """Return the distance [m] of a place inside the zone from its sides, floor and ceiling; negative outside."""
        aside = self._aside(north, east)
        aside = aside if self.over(north, east) else -aside
        below = math.inf if self.floor <= 0.0 else height - self.floor
        gap = min(below, self.ceiling - height)
        return -math.hypot(aside, gap) if aside < 0.0 and gap < 0.0 else min(aside, gap)

    def _aside(self, north: float, east: float) -> float:
        """Return the horizontal distance [m] of a place from the zone's nearest side."""
        if not self.rings:
            return abs(math.hypot(north - self.centre[0], east - self.centre[1]) - self.radius)
        return min(_to_edge(begin, end, north, east) for ring in self.rings for begin, end in _edges(ring))

    def along(self, begin: Triple, end: Triple, ground: GroundDown | None = None) -> tuple[float, Triple | None]:
        """Return the length [m] of the part of a straight path in the zone, and where it begins; None if empty.

        Args:
            begin, end: NED [m].
            ground: down coordinate [m] of the ground at a north and an east [m]; for zones above terrain.
        """
        return _stretch(begin, end, self.cuts(begin, end), lambda x, y, z: self.holds(x, y, z, ground))

    def holds(self, north: float, east: float, down: float, ground: GroundDown | None = None) -> bool:
        """Return whether a place NED [m] is in the zone, heights included."""
        return self.over(north, east) and self.level(height_of(self, north, east, down, ground))

    def cuts(self, begin: Triple, end: Triple) -> list[float]:
        """Return the fractions of a path (0: begin, 1: end) at which it may enter or leave the zone."""
        (x, y, z), (dx, dy, dz) = begin, (end[0] - begin[0], end[1] - begin[1], end[2] - begin[2])
        found = []
        if self.rings:
            for ring in self.rings:
                for (a, b), (c, d) in _edges(ring):
                    across = dx * (d - b) - dy * (c - a)
                    if across:
                        found.append(((a - x) * (d - b) - (b - y) * (c - a)) / across)
        else:
            north, east, square = x - self.centre[0], y - self.centre[1], dx * dx + dy * dy
            half, rest = north * dx + east * dy, north * north + east * east - self.radius * self.radius
            root = half * half - square * rest
            if square and root > 0.0:
                found += [(-half - math.sqrt(root)) / square, (-half + math.sqrt(root)) / square]
        if self.terrain:
            steps = math.ceil(math.hypot(dx, dy, dz) / TERRAIN_STEP)
            found += [i / steps for i in range(1, steps)]
        elif dz:
            found += [(-height - z) / dz for height in (self.floor, self.ceiling) if math.isfinite(height)]
        return [part for part in found if 0.0 < part < 1.0]


class Zones:
    """Zones that hold together: inside one of those to stay in, if any, and outside all to stay out of.

    Methods take another ``ground``, which may know the heights at their places in advance.

    Args:
        zones: all of them.
        ground: down coordinate [m] of the ground at a north and an east [m]; None: z = 0.
    """

    def __init__(self, zones: Sequence[Zone], ground: GroundDown | None = None):
        self.all, self.ground = tuple(zones), ground
        self._kept = [zone for zone in zones if zone.keep]
        self._barred = [zone for zone in zones if not zone.keep]

    def inside(self, north: float, east: float, down: float | None = None, ground: GroundDown | None = None) -> bool:
        """Return whether all zones allow a place NED [m]; without ``down``, heights are ignored."""

        def holds(zone: Zone) -> bool:
            """Return whether the place is in this zone."""
            return zone.over(north, east) if down is None else zone.holds(north, east, down, ground or self.ground)

        if self._kept and not any(map(holds, self._kept)):
            return False
        return not any(map(holds, self._barred))

    def outside(self, begin: Triple, end: Triple, ground: GroundDown | None = None) -> tuple[float, Triple | None]:
        """Return the length [m] of the part of a path outside all keep-in zones, and where that begins, NED [m]."""
        if not self._kept:
            return 0.0, None
        cuts = [cut for zone in self._kept for cut in zone.cuts(begin, end)]

        def is_out(north: float, east: float, down: float) -> bool:
            """Return whether a place NED [m] is outside all keep-in zones."""
            return not any(zone.holds(north, east, down, ground or self.ground) for zone in self._kept)

        return _stretch(begin, end, cuts, is_out)

    def limit(
        self, north: float, east: float, down: float, ground: GroundDown | None = None
    ) -> tuple[float, Zone | None]:
        """Return the distance [m] of a place from the most critical zone limit, negative if broken, and that zone.

        Negative where the place is not allowed. Of the zones to stay in, the one counts that holds the place best.
        """
        found: list[tuple[float, Zone | None]] = []

        def signed(zone: Zone) -> float:
            """Return the distance [m] of the place from this zone's limits, negative outside."""
            return zone.signed(north, east, height_of(zone, north, east, down, ground or self.ground))

        if self._kept:
            found.append(max(((signed(zone), zone) for zone in self._kept), key=lambda item: item[0]))
        found += [(-signed(zone), zone) for zone in self._barred]
        return min(found, key=lambda item: item[0], default=(math.inf, None))


def _stretch(
    begin: Triple, end: Triple, cuts: Sequence[float], counts: Callable[[float, float, float], bool]
) -> tuple[float, Triple | None]:
    """Return the length [m] of a path's parts for which ``counts(north, east, down)``, and where the first begins.

    Args:
        begin, end: of the way, NED [m].
        cuts: where it may begin or cease to count, in parts of the way.
        counts: whether a place does.
    """
    way = [b - a for a, b in zip(begin, end, strict=True)]
    total, first, length = 0.0, None, math.hypot(*way)
    for low, high in pairwise(sorted({0.0, 1.0, *cuts})):
        if counts(*(a + 0.5 * (low + high) * step for a, step in zip(begin, way, strict=True))):
            total += (high - low) * length
            north, east, down = (a + low * step for a, step in zip(begin, way, strict=True))
            first = first or (north, east, down)
    return total, first


def height_of(zone: Zone, north: float, east: float, down: float, ground: GroundDown | None) -> float:
    """Return the height [m] of a place NED [m] above the level from which the zone's heights count."""
    return (float(ground(north, east)) if zone.terrain and ground is not None else 0.0) - down


def in_polygon(corners: Sequence[Point], north: float, east: float) -> bool:
    """Return whether a place is inside a polygon of corners (north, east), by the even-odd rule; all in [m]."""
    inside = False
    before = corners[-1]
    for corner in corners:
        if (corner[0] > north) != (before[0] > north):
            share = (north - corner[0]) / (before[0] - corner[0])
            if east < corner[1] + share * (before[1] - corner[1]):
                inside = not inside
        before = corner
    return inside


def _edges(ring: tuple[Point, ...]) -> list[tuple[Point, Point]]:
    """Return the edges of a closed ring of corners, each as (corner, next corner)."""
    return list(zip(ring, (*ring[1:], ring[0]), strict=True))


def _to_edge(begin: Point, end: Point, north: float, east: float) -> float:
    """Return the distance [m] of a place from an edge (begin, end) [m]."""
    dx, dy, x, y = end[0] - begin[0], end[1] - begin[1], north - begin[0], east - begin[1]
    square = dx * dx + dy * dy
    part = min(max((x * dx + y * dy) / square, 0.0), 1.0) if square else 0.0
    return math.hypot(x - part * dx, y - part * dy)
