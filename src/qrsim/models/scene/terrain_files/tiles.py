"""Terrain in one or several files with the same cells: one grid, cut to a window."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.errors import UsageError, readable
from qrsim.models.scene.elevation import SUFFIXES
from qrsim.models.scene.terrain_files.ascii_grid import open_ascii_grid, prj_file
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.geotiff import open_geotiff
from qrsim.models.scene.terrain_files.hgt import open_hgt
from qrsim.models.scene.terrain_files.raster import Crs, Grid, Heights, Raster
from qrsim.models.scene.terrain_files.vrt import MOST_SOURCES, Source, read_vrt

Files = str | tuple[str, ...]
# Relative difference of spacings, and offset of two tiles in cells, that are rounding.
SAME_SPACING, SAME_CELLS = 1e-6, 0.05


def sources_of(files: Files) -> tuple[Source, ...]:
    """Return the sources (file names, missing values) of a file, list or folder; a .vrt is replaced by its files.

    Raises:
        UsageError: a file of another kind, a folder without tiles, or too many of them.
    """
    names = _names(files)
    found: list[Source] = []
    for name in names:
        suffix = Path(name).suffix.lower()
        if suffix not in SUFFIXES:
            raise UsageError(f"{name}: expected one of {', '.join(SUFFIXES)}")
        if suffix != ".vrt":
            found.append(Source(name, None))
            continue
        with readable(name):
            inner = read_vrt(name)
        for source in inner:
            kind = Path(source.file).suffix.lower()
            if kind not in SUFFIXES or kind == ".vrt":
                raise UsageError(f"{name}: its source {source.file} is of no kind that is read in a .vrt")
        found += inner
    if len(found) > MOST_SOURCES:
        raise UsageError(f"{called(files)}: {len(found)} files; allowed: {MOST_SOURCES}")
    return tuple(found)


def _names(files: Files) -> tuple[str, ...]:
    """Return the names of the terrain files: those given, or those in the given folder; raise UsageError for none."""
    if not isinstance(files, str):
        return files
    folder = Path(os.path.expanduser(files))
    if not folder.is_dir():
        return (files,)
    with readable(files):
        # A .vrt of a folder is made of its tiles.
        found = [each for each in sorted(folder.iterdir()) if each.suffix.lower() in SUFFIXES[:-1] and each.is_file()]
    if not found:
        raise UsageError(f"{files}: has no terrain in it; expected files {', '.join(SUFFIXES[:-1])}")
    return tuple(map(str, found))


def called(files: Files) -> str:
    """Return the name of several files for messages: the first one's, "and n more"."""
    if isinstance(files, str):
        return files
    return files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"


def stamps(sources: tuple[Source, ...]) -> tuple[tuple[str, int, int], ...]:
    """Return (name, time of change [ns], size [bytes]) of every existing file that the heights depend on."""
    found = []
    for source in sources:
        for name in (source.file, prj_file(source.file) if source.file.lower().endswith(".asc") else None):
            if name is not None and os.path.exists(path := os.path.expanduser(name)):
                status = os.stat(path)
                found.append((name, status.st_mtime_ns, status.st_size))
    return tuple(found)


def open_raster(source: Source, gdal: Gdal, site: tuple[float, float], given: Crs | None) -> Raster:
    """Return a terrain file opened as a raster, by its suffix; raises UsageError if it cannot be read."""
    suffix, nodata = Path(source.file).suffix.lower(), () if source.nodata is None else (source.nodata,)
    with readable(source.file):
        if suffix == ".hgt":
            return open_hgt(source.file)
        if suffix == ".asc":
            return open_ascii_grid(source.file, gdal, site, given)
        return open_geotiff(source.file, gdal, site, given, nodata)


@dataclass(frozen=True)
class _Tile:
    """A raster, with row and column of its first cell in the grid of the first raster."""

    raster: Raster
    row: int
    column: int

    def within(self, rows: range, columns: range, whole: bool) -> tuple[slice, slice, range, range] | None:
        """Return the overlap of tile and window: slices into the window and ranges in the tile; None without one.

        With ``whole``, those for which it has a whole block of cells.
        """
        parts: list[tuple[slice, range]] = []
        grid = self.raster.grid
        for axis, first, count in ((rows, self.row, grid.rows), (columns, self.column, grid.columns)):
            n = axis.step
            low = max(-((axis.start - first) // n), 0)
            last = first + count - (n if whole else 1)
            high = min((last - axis.start) // n + 1, len(axis))
            if high <= low:
                return None
            begin = axis.start + low * n - first
            end = begin + (high - low) * n if whole else begin + (high - low - 1) * n + 1
            parts.append((slice(low, high), range(begin, end, n)))
        return parts[0][0], parts[1][0], parts[0][1], parts[1][1]


@dataclass(frozen=True)
class Mosaic:
    """Tiles on the grid of the first, which may reach beyond it on all sides; the first that has a height counts."""

    tiles: tuple[_Tile, ...]

    @property
    def grid(self) -> Grid:
        """Grid of the first tile; rows and columns of the mosaic are counted from its first cell."""
        return self.tiles[0].raster.grid

    @property
    def extent(self) -> tuple[int, int, int, int]:
        """First row, last row, first column and last column that any of the tiles covers."""
        grids = [(tile, tile.raster.grid) for tile in self.tiles]
        return (
            min(tile.row for tile, _ in grids),
            max(tile.row + grid.rows - 1 for tile, grid in grids),
            min(tile.column for tile, _ in grids),
            max(tile.column + grid.columns - 1 for tile, grid in grids),
        )

    def heights(self, rows: range, columns: range) -> tuple[Heights, Heights]:
        """Return the heights [m] at rows and columns, NaN if missing, and a bool array: a tile covers the place."""
        found = np.full((len(rows), len(columns)), np.nan)
        covered = np.zeros(found.shape, bool)
        for here, there, raster in self._parts(rows, columns, False):
            if np.isnan(found[here]).any():
                found[here] = np.where(np.isnan(found[here]), raster.heights(*there), found[here])
            covered[here] = True
        return found, covered

    def coarse(self, rows: range, columns: range) -> Heights:
        """Return one height [m] per block of cells, float32; NaN unless one tile covers the whole block."""
        found = np.full((len(rows), len(columns)), np.nan, np.float32)
        for here, there, raster in self._parts(rows, columns, True):
            found[here] = np.where(np.isnan(found[here]), raster.coarse(*there), found[here])
        return found

    def _parts(
        self, rows: range, columns: range, whole: bool
    ) -> Iterator[tuple[tuple[slice, slice], tuple[range, range], Raster]]:
        """Yield, for each tile that overlaps a window, its slices into the window, its own ranges and its raster."""
        for tile in self.tiles:
            part = tile.within(rows, columns, whole)
            if part is not None:
                yield part[:2], part[2:], tile.raster


def mosaic(rasters: list[Raster]) -> Mosaic:
    """Return raster tiles joined on one grid, that of the first.

    Raises:
        UsageError: they differ in their coordinates, or in size or place of their cells.
    """
    base = rasters[0]
    tiles = []
    for raster in rasters:
        own, first = raster.grid, base.grid
        if own.crs.wkt != first.crs.wkt:
            raise UsageError(
                f"{raster.file}: has the coordinate reference system {own.crs.name}, {base.file} has {first.crs.name}; "
                "tiles must have one"
            )
        steps = [np.array([grid.transform[k] for k in (0, 1, 3, 4)]) for grid in (own, first)]
        if np.max(np.abs(steps[0] - steps[1])) > SAME_SPACING * max(first.spacing):
            mine, other = (f"{each.spacing[0]:.6g} x {each.spacing[1]:.6g}" for each in (own, first))
            raise UsageError(
                f"{raster.file}: its cells are {mine} {own.crs.unit}, those of {base.file} {other}; tiles must "
                "have one spacing"
            )
        x, y = own.place(np.zeros(()), np.zeros(()))
        if own.crs.geographic:
            x = x - 360.0 * np.round((x - first.transform[2]) / 360.0)
        row, column = map(float, first.cell(x, y))
        if not max(abs(row), abs(column)) < 1e9 or max(abs(row - round(row)), abs(column - round(column))) > SAME_CELLS:
            raise UsageError(
                f"{raster.file}: its cells are shifted against those of {base.file} by part of a cell; tiles must be "
                "cut from one grid"
            )
        tiles.append(_Tile(raster, round(row), round(column)))
    return Mosaic(tuple(tiles))
