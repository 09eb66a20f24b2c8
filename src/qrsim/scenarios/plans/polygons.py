"""Polygons of maps, for fences and zones: KML, KMZ and GeoJSON."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from qrsim.errors import UsageError
from qrsim.scenarios.plans.drawn import DrawnPolygon, chosen, named
from qrsim.scenarios.plans.geojson import geojson_polygons
from qrsim.scenarios.plans.kml import kml_polygons
from qrsim.scenarios.plans.plan import Corners, FencePolygon

MAPS = {".kml": kml_polygons, ".kmz": kml_polygons, ".geojson": geojson_polygons, ".json": geojson_polygons}


def read_polygons(file: str, name: str | None = None) -> list[FencePolygon]:
    """Return all polygons of a KML or GeoJSON file with holes, or those called ``name``; other features are ignored.

    Polygons that share a name are 'NAME #1', 'NAME #2' and so on in the order of the file.

    Args:
        file: its path; the end of its name is one of ``MAPS``.
        name: of the polygons, or of one of those that share it; None: all.

    Raises:
        UsageError: the file cannot be read, has no such polygon, or one that is not simple.
    """
    return [
        replace(each.read(), name=own if each.name else "") for own, each in named(file, "polygon", _all(file), name)
    ]


def read_outline(file: str, name: str | None = None) -> Corners:
    """Return the corners (latitude, longitude) [deg] of the only polygon of a KML or GeoJSON file, or of the named one.

    Raises:
        UsageError: as ``read_polygons``; there are several, or it has a hole.
    """
    found = chosen(file, "polygon", _all(file), name, "its name").read()
    if found.holes:
        words = f"polygon '{found.name}'" if found.name else "its polygon"
        raise UsageError(
            f"{file}: {words} has a hole, and a fence has none; give world.area of type zones with stay_in: "
            "[{file: ...}]"
        )
    return found.vertices


def _all(file: str) -> list[DrawnPolygon]:
    """Read all polygons of a map file; the suffix of its name selects the reader."""
    return MAPS[Path(file).suffix.lower()](file)
