"""ESRI ASCII grids (.asc) with a coordinate reference system, from a .prj file or from the scenario."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError, readable
from qrsim.files.user_files import read_text
from qrsim.models.scene.elevation import read_elevations
from qrsim.models.scene.terrain_files.crs import from_wkt
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.gdal_requests import LARGEST_HEIGHT
from qrsim.models.scene.terrain_files.raster import ArrayRaster, Crs, grid_of

LARGEST_PRJ = 2**16


def prj_file(file: str) -> str | None:
    """Return the path of the .prj file (coordinate reference system) next to a grid file, None without one."""
    path = Path(os.path.expanduser(file))
    return next((str(each) for each in (path.with_suffix(".prj"), path.with_suffix(".PRJ")) if each.is_file()), None)


def prj_of(file: str) -> str | None:
    """Return the WKT text in a grid file's .prj file, None without this file; raises UsageError if it is not text."""
    path = prj_file(file)
    if path is None:
        return None
    with readable(path):
        return read_text(path, LARGEST_PRJ)


def open_ascii_grid(file: str, gdal: Gdal, site: tuple[float, float], given: Crs | None) -> ArrayRaster:
    """Return an ESRI ASCII grid as a raster, in the reference system of its .prj file, or else the given one.

    Raises:
        UsageError: it cannot be read, or has no coordinate reference system.
    """
    wkt = prj_of(file)
    if wkt is None and given is None:
        raise UsageError(f"{file}: has no coordinate reference system: no .prj file; give crs: EPSG:n")
    crs = given
    if wkt is not None:
        crs = from_wkt(str(prj_file(file)), wkt, gdal, site, esri=True)
        if given is not None and given.wkt != crs.wkt:
            raise UsageError(f"{file}: its .prj has {crs.name}, not {given.name}; leave out crs")
    assert crs is not None
    found = read_elevations(file, "geodetic" if crs.geographic else "local")
    dy, dx = found.spacing
    transform = [dx, 0.0, float(found.columns[0]) - 0.5 * dx, 0.0, dy, float(found.rows[0]) - 0.5 * dy]
    heights = np.where(np.abs(found.height) <= LARGEST_HEIGHT, found.height, np.nan)
    return ArrayRaster(file, grid_of(file, heights.shape, transform, crs), heights)
