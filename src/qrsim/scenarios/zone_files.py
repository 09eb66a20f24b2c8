"""Zones from files: the fences of a QGroundControl plan, and the polygons of KML and GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from qrsim.errors import UsageError, did_you_mean, readable
from qrsim.files.user_files import LARGEST_TABLE, read_text
from qrsim.models.site import Site
from qrsim.scenarios.kml_file import read_polygons
from qrsim.scenarios.local import local_ned, swapped_hint
from qrsim.scenarios.plans.plan import Plan
from qrsim.scenarios.plans.reading import read_plan

SUFFIXES = (".plan", ".kml", ".geojson", ".json")
Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class FileZone:
    """A zone of a file, in latitude and longitude [deg].

    Attributes:
        name: as the file has it, "" without one.
        rings: corners of the outline, then of each hole; empty for a circle.
        centre: of a circle.
        radius: of a circle [m].
        keep: whether the file says to stay in it; None: it does not say.
    """

    name: str
    rings: tuple[Corners, ...] = ()
    centre: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0
    keep: bool | None = None


def zones_of_file(file: str, name: str | None = None) -> tuple[list[FileZone], Plan | None]:
    """Read the zones of a file, and the plan if it comes from one.

    Args:
        file: the file; its suffix says of which kind it is.
        name: only the polygons of this name; None: all.

    Raises:
        UsageError: the file cannot be read, or has no such zone.
    """
    suffix, plan = Path(file).suffix.lower(), None
    if suffix not in SUFFIXES:
        raise UsageError(f"{file}: has no zones; allowed: files that end in {', '.join(SUFFIXES)}")
    if suffix == ".plan":
        plan = read_plan(file)
        found = _of_plan(plan)
        if not found:
            raise UsageError(f"{file}: geoFence has no polygons and no circles")
        if name is not None:
            raise UsageError(f"{file}: the fences of a plan have no names, so none is called '{name}'")
    elif suffix == ".kml":
        polygons = read_polygons(file, name)
        found = [FileZone(each.name, (each.vertices, *each.holes)) for each in polygons]
    else:
        found = [zone for zone in _of_geojson(file) if name in (None, zone.name)]
        if not found:
            names = [zone.name for zone in _of_geojson(file)]
            raise UsageError(f"{file}: no polygon is called '{name}'{did_you_mean(str(name), names)}")
    return found, plan


def in_ned(zone: FileZone, site: Site) -> dict[str, Any]:
    """Return the shape of a zone as a scenario has it, in NED.

    Raises:
        UsageError: it is far from the site.
    """
    if not zone.rings:
        ((north, east),) = corners_ned([zone.centre], site)
        return {"circle_ned": [north, east], "radius": zone.radius}
    outline, *holes = (corners_ned(ring, site) for ring in zone.rings)
    return {"polygon_ned": outline, "holes_ned": holes}


def corners_ned(corners: Sequence[Sequence[float]], site: Site) -> list[list[float]]:
    """Return [north, east] [m] of corners (latitude, longitude) [deg].

    Raises:
        UsageError: one of them is no place, or far from the site.
    """
    for number, (latitude, longitude) in enumerate(corners):
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise UsageError(
                f"corner {number}: latitude {latitude:g} deg, longitude {longitude:g} deg; allowed: within 90 and "
                f"within 180{swapped_hint(latitude, longitude)}"
            )
    return [point[:2] for point in local_ned(site, [(*corner, 0.0) for corner in corners])]  # type: ignore[misc]


def _of_plan(plan: Plan) -> list[FileZone]:
    polygons = [FileZone("", (each.vertices,), keep=each.inclusion) for each in plan.polygons]
    circles = [
        FileZone("", (), (each.latitude_deg, each.longitude_deg), each.radius, each.inclusion) for each in plan.circles
    ]
    return polygons + circles


def _of_geojson(file: str) -> list[FileZone]:
    """Return all polygons of a GeoJSON file (RFC 7946); other geometries are passed over."""
    with readable(file):
        text = read_text(file, LARGEST_TABLE)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{file}: is not JSON: {error}") from None
    found = [
        FileZone(name, tuple(_ring(file, name, ring) for ring in rings))
        for name, geometry in _geometries(content)
        for rings in _polygons(file, name, geometry)
    ]
    if not found:
        raise UsageError(f"{file}: has no Polygon and no MultiPolygon")
    return found


def _geometries(content: object) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and geometry of each feature."""
    if not isinstance(content, dict):
        return
    if content.get("type") == "FeatureCollection" and isinstance(content.get("features"), list):
        for feature in content["features"]:
            yield from _geometries(feature)
    elif content.get("type") == "Feature":
        properties = content.get("properties")
        name = properties.get("name") if isinstance(properties, dict) else None
        if isinstance(content.get("geometry"), dict):
            yield (name if isinstance(name, str) else ""), content["geometry"]
    elif "coordinates" in content:
        yield "", content


def _polygons(file: str, name: str, geometry: Mapping[str, Any]) -> list[list[object]]:
    """Return the rings of each polygon of a geometry."""
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        return []
    parts = [coordinates] if kind == "Polygon" else coordinates
    if not (isinstance(parts, list) and parts and all(isinstance(rings, list) and rings for rings in parts)):
        raise UsageError(f"{file}: {_called(name)}: expected coordinates, a list of rings")
    return parts


def _ring(file: str, name: str, ring: object) -> Corners:
    """Return the corners of a ring, without the last, which repeats the first."""
    corners = []
    for number, place in enumerate(ring if isinstance(ring, list) else ()):
        pair = place[:2] if isinstance(place, list) else []
        if len(pair) != 2 or not all(type(value) in (int, float) and math.isfinite(value) for value in pair):
            raise UsageError(f"{file}: {_called(name)}: corner {number}: expected [longitude, latitude]")
        longitude, latitude = float(pair[0]), float(pair[1])
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise UsageError(
                f"{file}: {_called(name)}: corner {number}: latitude {latitude:g}, longitude {longitude:g}; longitude "
                "comes first, within 180 degrees, then latitude, within 90"
            )
        corners.append((latitude, longitude))
    if len(corners) > 1 and corners[0] == corners[-1]:
        corners.pop()
    if len(corners) < 3:
        raise UsageError(f"{file}: {_called(name)}: has a ring of {len(corners)} corners; allowed: at least 3")
    return tuple(corners)


def _called(name: str) -> str:
    return f"polygon '{name}'" if name else "a polygon without a name"
