"""Tiles of the Shuttle Radar Topography Mission (.hgt): big-endian 16-bit heights, the place in the name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError
from qrsim.files.user_files import check_file
from qrsim.models.scene.terrain_files.raster import WGS84, ArrayRaster, Grid, Heights, grid_of

# Rows and columns by the size of the file [bytes]; north of 50 degrees some have fewer columns.
SHAPES = {
    2 * rows * columns: (rows, columns) for rows, columns in ((1201, 1201), (3601, 3601), (3601, 1201), (3601, 1801))
}
MISSING = (-32768, -9999)
_NAME = re.compile(r"([NS])(\d{2})([EW])(\d{3})(?![0-9])", re.IGNORECASE)


@dataclass(frozen=True)
class Hgt:
    """A tile of one degree by one degree; see ``Raster``. Heights are read when they are needed."""

    file: str
    grid: Grid
    note: str = ""
    overviews: tuple[int, ...] = ()

    def heights(self, rows: range, columns: range) -> Heights:
        """Return the heights [m] at rows and columns of the tile, NaN where they are missing."""
        return self._all().heights(rows, columns)

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return the height [m] at the middle of each block of cells (the ranges' steps), float32."""
        return self._all().coarse(rows, columns)

    def _all(self) -> ArrayRaster:
        """Return all heights of the tile as a raster, NaN where they are missing."""
        raw = np.fromfile(check_file(self.file), ">i2")
        if raw.size != self.grid.rows * self.grid.columns:
            raise UsageError(f"{self.file}: its size has changed while it was read")
        heights = np.where(np.isin(raw, MISSING), np.nan, raw.astype(np.float32))
        return ArrayRaster(self.file, self.grid, heights.reshape(self.grid.rows, self.grid.columns))


def open_hgt(file: str) -> Hgt:
    """Return an SRTM tile (.hgt file) as a raster, with its name and size checked.

    Raises:
        UsageError: either is not that of a tile.
        OSError: there is no such file.
    """
    path = check_file(file)
    named = _NAME.match(Path(file).name)
    if named is None or int(named[2]) > 90 or int(named[4]) > 180:
        raise UsageError(f"{file}: its name says no place; expected one such as N51W001.hgt")
    size = path.stat().st_size
    if size not in SHAPES:
        usual = " or ".join(f"{2 * side * side} ({side} x {side})" for side in (1201, 3601))
        raise UsageError(f"{file}: has {size} bytes; an .hgt has {usual}")
    rows, columns = SHAPES[size]
    south = int(named[2]) * (1.0 if named[1].upper() == "N" else -1.0)
    west = int(named[4]) * (1.0 if named[3].upper() == "E" else -1.0)
    # The centres of the outer cells are on the whole degrees.
    dx, dy = 1.0 / (columns - 1), 1.0 / (rows - 1)
    return Hgt(
        file, grid_of(file, (rows, columns), [dx, 0.0, west - 0.5 * dx, 0.0, -dy, south + 1.0 + 0.5 * dy], WGS84)
    )


def tile_name(latitude: float, longitude: float) -> str:
    """Return the name of the SRTM tile that contains a place [deg], such as N51W001."""
    south, west = int(np.floor(latitude)), int(np.floor(longitude))
    return f"{'N' if south >= 0 else 'S'}{abs(south):02d}{'E' if west >= 0 else 'W'}{abs(west):03d}"
