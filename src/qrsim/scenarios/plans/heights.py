"""From altitudes as plans have them to down coordinates of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError
from qrsim.scenarios.plans.plan import Waypoint

Floats = npt.NDArray[np.float64]
# Of the height above the ground on a line [m], and the part of it that lines may use: corners are cut.
TOLERANCE, OF_LINES = 1.0, 0.8


class GroundDown(Protocol):
    """The ground of a scenario."""

    def __call__(self, north: npt.ArrayLike, east: npt.ArrayLike) -> Floats:
        """Return down coordinates (...) [m] of places (...) [m]."""


@dataclass(frozen=True)
class Levels:
    """The references of the altitudes of a plan in a scenario.

    Attributes:
        home_down: down coordinate of the ground at the plan's home [m].
        home_amsl: altitude of the plan's home above mean sea level [m]; NaN: unknown.
        site_amsl: altitude of the scenario's origin above mean sea level [m]; None: the scenario gives no height, and
            the home of the plan is on the ground.
    """

    home_down: float
    home_amsl: float
    site_amsl: float | None

    def down(self, waypoint: Waypoint, ground_down: float) -> float:
        """Return a waypoint's z coordinate [m, down]; ``ground_down`` is that of the ground below it.

        Raises:
            UsageError: its altitude is above the sea, and nothing says how high the site is.
        """
        if waypoint.above == "home":
            return self.home_down - waypoint.altitude
        if waypoint.above == "ground":
            return ground_down - waypoint.altitude
        if self.site_amsl is not None:
            return self.site_amsl - waypoint.altitude
        if math.isnan(self.home_amsl):
            raise UsageError(
                f"item {waypoint.item} is {waypoint.altitude:g} m above the sea, and the height of the site is not "
                "given; give site.height_amsl, or plan.home with an altitude"
            )
        return self.home_down + self.home_amsl - waypoint.altitude


def over_ground(
    begin: Sequence[float],
    end: Sequence[float],
    ground_down: GroundDown,
    tolerance: float = TOLERANCE,
    step: float = 2.0,
) -> list[list[float]]:
    """Return points NED [m] between ``begin`` and ``end`` at which the height above the ground varies linearly.

    The height above the ground goes over linearly from that of the one to that of the other.

    Args:
        begin, end: places NED [m].
        ground_down: the ground.
        tolerance: largest difference of the height above the ground [m].
        step: distance between the places at which the ground is looked up [m].

    Returns:
        Places NED [m], without the two.
    """
    count = min(max(2, math.ceil(math.dist(begin[:2], end[:2]) / step)), 20_000)
    share = np.linspace(0.0, 1.0, count + 1)
    north, east = (begin[axis] + share * (end[axis] - begin[axis]) for axis in (0, 1))
    ground = np.asarray(ground_down(north, east), np.float64)
    first, last = ground[0] - begin[2], ground[-1] - end[2]
    down = ground - (first + share * (last - first))
    kept, open_spans = [], [(0, count)]
    # Split where a line is farthest off, until none is too far.
    while open_spans:
        left, right = open_spans.pop()
        inner = slice(left + 1, right)
        line = down[left] + (down[right] - down[left]) * (share[inner] - share[left]) / (share[right] - share[left])
        off = np.abs(down[inner] - line)
        if off.size and off.max() > OF_LINES * tolerance:
            middle = left + 1 + int(off.argmax())
            kept.append(middle)
            open_spans += [(left, middle), (middle, right)]
    return [[float(north[i]), float(east[i]), float(down[i])] for i in sorted(kept)]
