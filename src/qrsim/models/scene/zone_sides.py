"""The sides of zones that are limits: without those beyond which another zone to stay in goes on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.scene.zone import Point, Zone

# A zone without floor or ceiling ends so far away [m].
OPEN = 1e6
# So far beyond an edge [m] another zone to stay in is looked for.
BESIDE = 1e-3


def heights_of(zone: Zone) -> tuple[float, float]:
    """Return top and bottom of a zone as down coordinates [m] relative to its reference level."""
    return -min(zone.ceiling, OPEN), OPEN if zone.floor <= 0.0 else -zone.floor


def sides_of(polygons: Sequence[Zone], zones: Sequence[Zone]) -> Floats:
    """Return the sides (E, 7) of polygon zones, without the parts along which another keep-in zone continues.

    Args:
        polygons: the zones with these sides.
        zones: all of the area.

    Returns:
        North and east of the first corner [m], from it to the last [m], 1 over the squared length [1/m^2], top and
        bottom [m].
    """
    first, last, heights = [], [], []
    for zone in polygons:
        others = [each for each in zones if each is not zone and zone.keep and each.keep and _covers(each, zone)]
        for ring in zone.rings:
            for begin, end in zip(ring, (*ring[1:], ring[0]), strict=True):
                for low, high in _limits(zone, begin, end, others):
                    first.append(low)
                    last.append(high)
                    heights.append(heights_of(zone))
    starts = np.array(first, np.float64).reshape(-1, 2)
    along = np.array(last, np.float64).reshape(-1, 2) - starts
    part = 1.0 / np.maximum(np.sum(along * along, axis=1), np.finfo(np.float64).tiny)
    return np.column_stack([starts, along, part, np.array(heights).reshape(-1, 2)])


def _covers(other: Zone, zone: Zone) -> bool:
    """Return whether the height range of ``other`` contains that of ``zone``, above the same reference level."""
    (top, bottom), (own_top, own_bottom) = heights_of(other), heights_of(zone)
    return other.terrain == zone.terrain and top <= own_top and bottom >= own_bottom


def _limits(zone: Zone, begin: Point, end: Point, others: Sequence[Zone]) -> list[tuple[Point, Point]]:
    """Return the parts (begin, end) of an edge [m] that have no other zone just outside."""
    near = [other for other in others if _meets(other, begin, end)]
    if not near:
        return [(begin, end)]
    way = end[0] - begin[0], end[1] - begin[1]
    length = math.hypot(*way)
    aside = BESIDE * way[1] / length, -BESIDE * way[0] / length
    cuts = {0.0, 1.0, *(cut for other in near for cut in other.cuts((*begin, 0.0), (*end, 0.0)))}
    found = []
    for low, high in pairwise(sorted(cuts)):
        north, east = (a + 0.5 * (low + high) * step for a, step in zip(begin, way, strict=True))
        side = -1.0 if zone.over(north + aside[0], east + aside[1]) else 1.0
        if not any(other.over(north + side * aside[0], east + side * aside[1]) for other in near):
            ends = [(begin[0] + part * way[0], begin[1] + part * way[1]) for part in (low, high)]
            found.append((ends[0], ends[1]))
    return found


def _meets(other: Zone, begin: Point, end: Point) -> bool:
    """Return whether the bounding boxes of an edge and a zone touch."""
    south, north, west, east = other.bounds
    return (
        min(begin[0], end[0]) <= north + BESIDE
        and max(begin[0], end[0]) >= south - BESIDE
        and min(begin[1], end[1]) <= east + BESIDE
        and max(begin[1], end[1]) >= west - BESIDE
    )
