"""Coordinate reference systems by EPSG code or WKT, and points from WGS 84 to them and back."""

from __future__ import annotations

import re

import numpy as np

from qrsim.errors import UsageError, shortened
from qrsim.models.scene.terrain_files.gdal import Gdal, GdalError
from qrsim.models.scene.terrain_files.raster import WGS84, Crs, Float64

# Of a .prj of latitude and longitude, by which it is known without PROJ.
_DEGREES = re.compile(r'\s*GEOG(?:CS|CRS|RAPHICCRS)\s*\[\s*"(?:GCS_WGS_1984|WGS 84|WGS_1984)"', re.IGNORECASE)


def is_wgs84(wkt: str) -> bool:
    """Return whether a WKT text means latitude and longitude of WGS 84, decided without PROJ."""
    return _DEGREES.match(wkt) is not None


def from_code(code: str, gdal: Gdal, site: tuple[float, float]) -> Crs:
    """Return the coordinate reference system of a code such as "EPSG:32632", near a site [deg].

    Args:
        code: EPSG:n.
        gdal: to ask.
        site: latitude and longitude [deg] where it will be used.

    Raises:
        UsageError: no such code, or its coordinates are neither in degrees nor on a map.
    """
    if not re.fullmatch(r"EPSG:[0-9]{1,7}", code, re.IGNORECASE):
        raise UsageError(f"crs: {shortened(repr(code), 60)} is no code; expected one such as EPSG:32630")
    try:
        return _checked("crs", gdal.crs("crs", code.upper(), site))
    except GdalError:
        raise UsageError(f"crs: PROJ knows no {code.upper()}; expected a code such as EPSG:32630") from None


def from_wkt(file: str, wkt: str, gdal: Gdal, site: tuple[float, float], *, esri: bool = False) -> Crs:
    """Return the coordinate reference system of a WKT text; ``esri``: in ESRI's dialect; raises as ``from_code``."""
    if is_wgs84(wkt):
        return WGS84
    try:
        return _checked(file, gdal.crs(file, wkt, site, esri))
    except GdalError:
        raise UsageError(
            f"{file}: PROJ does not understand its coordinate reference system, {shortened(repr(wkt), 60)}"
        ) from None


def _checked(file: str, found: dict[str, object]) -> Crs:
    """Return the reference system that GDAL has described in ``found``; raise UsageError for unusable kinds."""
    if found["kind"] not in ("geographic", "projected"):
        raise UsageError(
            f"{file}: its coordinate reference system '{found['name']}' is {found['kind'] or 'of no known kind'}; "
            "expected a geographic or a projected one"
        )
    if found["wgs84"]:
        return WGS84
    accuracy = found["accuracy"]
    return Crs(
        str(found["wkt"]),
        str(found["name"]),
        found["kind"] == "geographic",
        accuracy if isinstance(accuracy, float) else None,
    )


def to_file(file: str, crs: Crs, gdal: Gdal, latitude: Float64, longitude: Float64) -> tuple[Float64, Float64]:
    """Return map coordinates x and y, any shape, of latitudes and longitudes [deg]; infinite beyond the map's area."""
    if crs.is_wgs84:
        return longitude, latitude
    return gdal.transform(file, WGS84.wkt, crs.wkt, np.asarray(longitude), np.asarray(latitude))


def to_degrees(file: str, crs: Crs, gdal: Gdal, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Return latitudes and longitudes [deg], any shape, of map coordinates x and y in a reference system."""
    if crs.is_wgs84:
        return y, x
    longitude, latitude = gdal.transform(file, crs.wkt, WGS84.wkt, np.asarray(x), np.asarray(y))
    return latitude, longitude
