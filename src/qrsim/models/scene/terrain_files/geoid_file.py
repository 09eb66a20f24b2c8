"""Heights of a geoid near a site from a file: a raster that GDAL reads, or a grid of GeographicLib (.pgm)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError, readable
from qrsim.files.user_files import open_file
from qrsim.models.geoid import GeoidPlane, lagrange, plane_of
from qrsim.models.scene.terrain_files.crs import to_file
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.geotiff import DRIVERS, LARGEST_FILE, open_geotiff
from qrsim.models.scene.terrain_files.raster import WGS84, Float64, Grid, Heights, Raster, grid_of
from qrsim.models.site import Site

PGM = ".pgm"
SUFFIXES = (*DRIVERS, PGM)
# Points of the grid in each direction that a value is interpolated from, as of the built-in geoid.
POINTS = 8
# Size of the head of a .pgm [bytes], and largest height of a geoid [m].
LARGEST_HEAD, LARGEST_UNDULATION = 4096, 200.0
_SIZES = re.compile(rb"\s*(\d+)\s+(\d+)\s+65535\s")


@dataclass(frozen=True)
class Pgm:
    """A grid of GeographicLib: whole degrees are at points, from the north pole and Greenwich; see ``Raster``.

    Attributes:
        begin: of the numbers in the file [bytes].
        scale, offset: height [m] = scale * number + offset.
    """

    file: str
    grid: Grid
    begin: int
    scale: float
    offset: float
    note: str = ""
    overviews: tuple[int, ...] = ()

    def heights(self, rows: range, columns: range) -> Heights:
        """Return the geoid heights [m] at rows and columns of the file."""
        lines = []
        with open_file(self.file, LARGEST_FILE) as opened:
            for row in rows:
                opened.seek(self.begin + 2 * (row * self.grid.columns + columns.start))
                lines.append(np.frombuffer(opened.read(2 * (columns.stop - columns.start)), ">u2")[:: columns.step])
        return self.scale * np.array(lines, np.float64) + self.offset

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return the geoid height [m] at the first cell of each block of cells, float32."""
        return self.heights(rows, columns).astype(np.float32)


def geoid_of_file(file: str, site: Site) -> GeoidPlane:
    """Return the plane that fits a geoid file near a site, as heights above the WGS-84 ellipsoid.

    Args:
        file: .tif, .tiff, .img, or .pgm.
        site: the place.

    Raises:
        UsageError: the file cannot be read, or has no geoid at the site.
    """
    suffix = Path(file).suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"{file}: is no geoid; allowed: files that end in {', '.join(SUFFIXES)}")
    with readable(file), Gdal() as gdal:
        place = math.degrees(site.latitude_rad), math.degrees(site.longitude_rad)
        raster: Raster = _open_pgm(file) if suffix == PGM else open_geotiff(file, gdal, place, None)
        return plane_of(site, lambda latitude, longitude: _heights(raster, gdal, latitude, longitude))


def _open_pgm(file: str) -> Pgm:
    """Return the geoid in a GeographicLib .pgm file, opened; raise UsageError for other content."""
    with open_file(file, LARGEST_FILE) as opened:
        head = opened.read(LARGEST_HEAD)
        size = opened.seek(0, 2)
    comments = re.match(rb"P5\s(?:\s*#[^\n]*\n)*", head)
    sizes = _SIZES.match(head, comments.end()) if comments else None
    numbers = [re.search(rb"#\s*" + name + rb"\s+(\S+)", head) for name in (b"Scale", b"Offset")]
    try:
        scale, offset = (float(found[1]) if found else math.nan for found in numbers)
    except ValueError:
        scale, offset = math.nan, math.nan
    if sizes is None or not math.isfinite(scale + offset):
        raise UsageError(f"{file}: is no geoid of GeographicLib: expected P5, '# Offset', '# Scale' and 65535")
    columns, rows = int(sizes[1]), int(sizes[2])
    if size - sizes.end() != 2 * rows * columns:
        raise UsageError(
            f"{file}: has {size - sizes.end()} bytes of heights; {columns} x {rows} of them have {2 * rows * columns}"
        )
    dx, dy = 360.0 / max(columns, 1), 180.0 / max(rows - 1, 1)
    grid = grid_of(file, (rows, columns), [dx, 0.0, -0.5 * dx, 0.0, -dy, 90.0 + 0.5 * dy], WGS84)
    return Pgm(file, grid, sizes.end(), scale, offset)


def _heights(raster: Raster, gdal: Gdal, latitude: Float64, longitude: Float64) -> Float64:
    """Return a raster's heights (n,) [m] at places (n,) [deg]; raise UsageError for places beyond it."""
    grid = raster.grid
    x, y = to_file(raster.file, grid.crs, gdal, latitude, longitude)
    round_earth = False
    if grid.crs.geographic:
        first, last = (float(grid.place(np.zeros(()), np.asarray(column))[0]) for column in (0.0, grid.columns - 1.0))
        round_earth = abs(abs(last - first) + grid.spacing[1] - 360.0) < 0.5 * grid.spacing[1]
        x = x + 360.0 * np.round((0.5 * (first + last) - x) / 360.0)
    rows, columns = grid.cell(x, y)
    least, most = (-0.5, grid.columns - 0.5) if round_earth else (0.0, grid.columns - 1.0)
    # NaN fails these comparisons too.
    if not ((rows >= 0.0) & (rows <= grid.rows - 1.0) & (columns >= least) & (columns <= most)).all():
        raise UsageError(f"{raster.file}: does not reach 2.5 km beyond the site on all sides")
    found = np.array(
        [_height(raster, float(row), float(column), round_earth) for row, column in zip(rows, columns, strict=True)]
    )
    if not (np.abs(found) <= LARGEST_UNDULATION).all():
        worst = found[np.argmax(np.nan_to_num(np.abs(found), nan=np.inf))]
        said = "has no height" if math.isnan(worst) else f"has the height {worst:.4g} m"
        raise UsageError(f"{raster.file}: {said} within 2.5 km of the site; a geoid is within {LARGEST_UNDULATION:g} m")
    return found


def _height(raster: Raster, row: float, column: float, round_earth: bool) -> float:
    """Return a raster's height [m] interpolated at (row, column), from fewer points near gaps; else NaN."""
    for points in (POINTS, 2):
        i, high = _window(row, points, raster.grid.rows)
        j, wide = _window(column, points, raster.grid.columns)
        if round_earth:
            j, wide = math.floor(column) - points // 2 + 1, points
        values = _part(raster, range(i, i + high), j, wide)
        found = float(lagrange(row - i, high) @ values @ lagrange(column - j, wide))
        if math.isfinite(found):
            return found
    return math.nan


def _window(place: float, points: int, count: int) -> tuple[int, int]:
    """Return the index of the first of ``points`` grid points around ``place``, and their number, at most ``count``."""
    points = min(points, count)
    return min(max(math.floor(place) - points // 2 + 1, 0), count - points), points


def _part(raster: Raster, rows: range, first: int, count: int) -> Heights:
    """Return the heights [m] at rows and at ``count`` columns from ``first`` on, wrapped around the Earth."""
    size = raster.grid.columns
    start = first % size
    parts = [raster.heights(rows, range(start, min(start + count, size)))]
    if start + count > size:
        parts.append(raster.heights(rows, range(start + count - size)))
    return np.concatenate(parts, axis=1)
