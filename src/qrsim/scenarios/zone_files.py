"""Zones from files: the fences of a QGroundControl plan, and the polygons of maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.models.site import Site
from qrsim.scenarios.local import local_ned, swapped_hint
from qrsim.scenarios.plans.plan import FenceCircle, FencePolygon, Plan
from qrsim.scenarios.plans.polygons import MAPS, read_polygons
from qrsim.scenarios.plans.reading import read_plan

FileZone = FencePolygon | FenceCircle


def zones_of_file(file: str, name: str | None = None) -> tuple[list[FileZone], Plan | None]:
    """Read zones from a file, all or those called ``name``; also return the plan, if the file is one.

    Args:
        file: the file; its suffix says of which kind it is.
        name: only the polygons of this name; None: all.

    Raises:
        UsageError: the file cannot be read, or has no such zone.
    """
    suffix = Path(file).suffix.lower()
    if suffix in MAPS:
        return [*read_polygons(file, name)], None
    if suffix != ".plan":
        raise UsageError(f"{file}: has no zones; allowed: files that end in .plan, {', '.join(MAPS)}")
    plan = read_plan(file)
    found: list[FileZone] = [*plan.polygons, *plan.circles]
    if not found:
        raise UsageError(f"{file}: geoFence has no polygons and no circles")
    if name is not None:
        raise UsageError(f"{file}: the fences of a plan have no names, so none is called '{name}'")
    return found, plan


def in_ned(zone: FileZone, site: Site) -> Content:
    """Convert a zone of a file to scenario content in NED [m].

    Raises:
        UsageError: it is far from the site.
    """
    if isinstance(zone, FenceCircle):
        ((north, east),) = corners_ned([(zone.latitude_deg, zone.longitude_deg)], site)
        return {"circle_ned": [north, east], "radius": zone.radius}
    outline, *holes = (corners_ned(ring, site) for ring in (zone.vertices, *zone.holes))
    return {"polygon_ned": outline, "holes_ned": holes}


def corners_ned(corners: Sequence[Sequence[float]], site: Site) -> list[list[float]]:
    """Convert corners (latitude, longitude) [deg] to [north, east] [m].

    Raises:
        UsageError: one of them is no place, or far from the site.
    """
    for number, (latitude, longitude) in enumerate(corners):
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise UsageError(
                f"corner {number}: latitude {latitude:g} deg, longitude {longitude:g} deg; allowed: within 90 and "
                f"within 180{swapped_hint(latitude, longitude)}"
            )
    places = local_ned(site, [(latitude, longitude, 0.0) for latitude, longitude in corners])
    return [[north, east] for north, east, _ in places]
