"""Reads the corners of a fence from a map or a QGroundControl plan."""

from __future__ import annotations

import math
from pathlib import Path

from qrsim.errors import UsageError
from qrsim.models.site import Site
from qrsim.scenarios.local import local_ned
from qrsim.scenarios.plans.plan import Corners, Plan
from qrsim.scenarios.plans.polygons import MAPS, read_outline
from qrsim.scenarios.plans.reading import read_plan

# A circle becomes a polygon with this many corners on it: nowhere outside the circle, and inside it by at most 0.4 % of
# its radius.
CIRCLE_CORNERS = 36


def fence_corners(file: str, name: str | None, site: Site) -> tuple[list[list[float]], Plan | None]:
    """Read the corners [north, east] [m] of a fence from a file; also return the plan, if the file is one.

    Args:
        file: a map with a polygon (.kml, .kmz, .geojson), or a .plan file with one polygon or circle to stay in.
        name: of the polygon, where a map has several.
        site: origin of the local frame.

    Raises:
        UsageError: the file cannot be read, or has no such fence.
    """
    suffix = Path(file).suffix.lower()
    if suffix in MAPS:
        return _corners(site, read_outline(file, name)), None
    if suffix != ".plan":
        raise UsageError(f"{file}: is no fence; allowed: files that end in .plan, {', '.join(MAPS)}")
    if name is not None:
        raise UsageError(f"{file}: the fences of a plan have no names, so none is called '{name}'; leave the name out")
    plan = read_plan(file)
    kinds = [fence.inclusion for fence in plan.polygons] + [fence.inclusion for fence in plan.circles]
    if kinds != [True]:
        raise UsageError(
            f"{file}: geoFence has {sum(kinds)} polygons or circles to stay in and {len(kinds) - sum(kinds)} to stay "
            "out of; supported: one to stay in"
        )
    if plan.polygons:
        return _corners(site, plan.polygons[0].vertices), plan
    circle = plan.circles[0]
    ((north, east),) = _corners(site, ((circle.latitude_deg, circle.longitude_deg),))
    angles = [2.0 * math.pi * i / CIRCLE_CORNERS for i in range(CIRCLE_CORNERS)]
    return [[north + circle.radius * math.cos(a), east + circle.radius * math.sin(a)] for a in angles], plan


def _corners(site: Site, vertices: Corners) -> list[list[float]]:
    """Convert geodetic corners (latitude, longitude) [deg] to [north, east] [m] from the site."""
    return [point[:2] for point in local_ned(site, [(*vertex, 0.0) for vertex in vertices])]
