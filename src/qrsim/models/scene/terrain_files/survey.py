"""Terrain files in the frame of a site: heights around the area at full resolution, and coarser ones to the horizon."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from qrsim.errors import UsageError
from qrsim.models.scene.elevation import EARTH_RADIUS, MOST_HEIGHTS, Bounds, Elevations, filled, filled_note
from qrsim.models.scene.terrain_files.crs import from_code, to_degrees, to_file
from qrsim.models.scene.terrain_files.gdal import Gdal
from qrsim.models.scene.terrain_files.hgt import tile_name
from qrsim.models.scene.terrain_files.raster import Float64, Heights, Raster
from qrsim.models.scene.terrain_files.tiles import Files, Mosaic, called, mosaic, open_raster, sources_of
from qrsim.models.site import Site

# Cells around the area that are read too, for the bilinear patches at its sides.
MARGIN = 2
# Files are searched for so far from the site [m]; beyond, the site or the files are wrong.
FAR_OFF = 100_000.0
# Between places this far apart [m] coordinates are linear to 1 mm; at most so many of them along a side.
LATTICE, MOST_LATTICE = 100.0, 500
# Heights that are read for the horizon, most of which are left out again: seconds.
MOST_READ = 1e8
# By how much an area may reach beyond the files [cells]: rounding.
SLACK = 1e-6
# Points of the ground's grid that are interpolated at once.
BLOCK = 250_000


@dataclass
class Survey:
    """Heights of terrain files around the area of a site.

    Attributes:
        name: of the files, for messages.
        mosaic: the files.
        site: origin of the frame.
        gdal: to ask for coordinates.
        near: heights at full resolution around the area; its rows and columns are those of the mosaic.
        covered: (R, C) whether a file has the place of each of them.
        needed: first row, last row, first column and last column of the area.
        far: coarser heights to the horizon, or None.
        zero: height that is z = 0 [m].
        spacing: of the cells along north and east, about [m].
        notes: what a user should know.
    """

    name: str
    mosaic: Mosaic
    site: Site
    gdal: Gdal
    near: Elevations
    covered: Heights
    needed: tuple[float, float, float, float]
    far: Elevations | None = None
    zero: float = 0.0
    spacing: tuple[float, float] = (1.0, 1.0)
    notes: list[str] = field(default_factory=list)

    def down(self, north: Float64, east: Float64) -> Float64:
        """Return the down coordinate [m] of the ground at places north and east [m]; NaN beyond the files."""
        rows, columns = cells(self.mosaic, self.site, self.gdal, self.name, north, east)
        found = self.near.at(rows, columns)
        if self.far is not None:
            found = np.where(np.isnan(found), self.far.at(rows, columns), found)
        return self.zero - found

    def grid(self, rows: Float64, columns: Float64) -> Float64:
        """Return the down coordinates (R, C) [m] of the ground on a grid of north (R,) and east (C,) [m]."""
        coarse = [_lattice(axis) for axis in (rows, columns)]
        place = cells(self.mosaic, self.site, self.gdal, self.name, coarse[0][:, None], coarse[1][None, :])
        along = [_spread(each, columns, coarse[1]) for each in (part.T for part in place)]
        found = np.empty((len(rows), len(columns)))
        step = max(1, BLOCK // len(columns))
        for first in range(0, len(rows), step):
            part = slice(first, first + step)
            found[part] = self.near.at(*(_spread(each.T, rows[part], coarse[0]) for each in along))
        return self.zero - found

    def gap(self) -> str | None:
        """Return a text about the part of the area that no file covers, None if all is covered."""
        r0, r1, c0, c1 = self.needed
        inside = ((self.near.rows > r0 - 1.0) & (self.near.rows < r1 + 1.0))[:, None]
        places = np.argwhere(inside & (self.near.columns > c0 - 1.0) & (self.near.columns < c1 + 1.0) & ~self.covered)
        if not len(places):
            return None
        low, high = places.min(axis=0), places.max(axis=0)
        rows, columns = (
            axis[[a, b]] for axis, a, b in zip((self.near.rows, self.near.columns), low, high, strict=True)
        )
        x, y = self.mosaic.grid.place(rows, columns)
        missing = _tile_of(self.mosaic, float(np.mean(y)), float(np.mean(x)))
        return f"nothing between {extent(self.mosaic, rows, columns, 'and')}{missing}"


def _tile_of(files: Mosaic, latitude: float, longitude: float) -> str:
    """Return a text that names the missing SRTM tile at a place [deg]; "" unless all files are SRTM tiles."""
    if not all(tile.raster.file.lower().endswith(".hgt") for tile in files.tiles):
        return ""
    return f"; tile {tile_name(latitude, longitude)} is missing"


def _lattice(axis: Float64) -> Float64:
    """Return even coordinates that span an axis from its first to its last value, LATTICE apart or more."""
    extent = float(axis[-1] - axis[0])
    return np.linspace(axis[0], axis[-1], min(max(2, math.ceil(extent / LATTICE) + 1), MOST_LATTICE))


def _spread(values: Float64, at: Float64, nodes: Float64) -> Float64:
    """Return values interpolated linearly at coordinates ``at`` (K,) from those (N, ...) at even ``nodes`` (N,)."""
    place = np.clip((at - nodes[0]) / (nodes[1] - nodes[0]), 0.0, len(nodes) - 1.0)
    i = np.minimum(place.astype(int), len(nodes) - 2)
    part = (place - i)[:, None]
    return values[i] * (1.0 - part) + values[i + 1] * part


def cells(files: Mosaic, site: Site, gdal: Gdal, name: str, north: Float64, east: Float64) -> tuple[Float64, Float64]:
    """Return row and column, in the files' grid, of places north and east [m]; NaN beyond the map projection."""
    north, east = np.broadcast_arrays(np.asarray(north, np.float64), np.asarray(east, np.float64))
    latitude, longitude, _ = site.ned_to_geodetic(np.stack([north, east, np.zeros_like(north)], axis=-1))
    crs = files.grid.crs
    x, y = to_file(name, crs, gdal, np.degrees(latitude), np.degrees(longitude))
    if crs.geographic:
        low, high = files.extent[2:]
        middle = float(files.grid.place(np.zeros(()), np.asarray(0.5 * (low + high)))[0])
        x = x + 360.0 * np.round((middle - x) / 360.0)
    x, y = (np.where(np.isfinite(each), each, np.nan) for each in (x, y))
    return files.grid.cell(x, y)


def extent(files: Mosaic, rows: Float64, columns: Float64, to: str = "to") -> str:
    """Return the range of coordinates from first to last rows and columns as text for messages."""
    ends = np.array([rows.min(), rows.max()], float), np.array([columns.min(), columns.max()], float)
    x, y = files.grid.place(ends[0][:, None], ends[1][None, :])
    if files.grid.crs.geographic:
        return f"latitude {y.min():.8g} {to} {y.max():.8g}, longitude {x.min():.8g} {to} {x.max():.8g}"
    name = files.grid.crs.name
    return f"northing {y.min():.8g} {to} {y.max():.8g} m, easting {x.min():.8g} {to} {x.max():.8g} m ({name})"


@dataclass(frozen=True)
class Wanted:
    """The terrain that a scenario names, and how to read it.

    Attributes:
        files: a file, a folder or several files.
        crs: EPSG:n of files that have none, "" where they have one.
        every: n-th row and column that is read.
        fill: whether missing heights are those of the nearest cell.
        zero: height that is z = 0 [m]; None: that of the ground at the site's origin.
        reach: largest distance of the horizon [m].
    """

    files: Files
    crs: str
    every: int
    fill: bool
    zero: float | None
    reach: float


def survey(wanted: Wanted, site: Site, box: Bounds | None, gdal: Gdal) -> Survey:
    """Return the terrain around an area, from files that are checked to cover it.

    Args:
        wanted: which files, and how.
        site: origin of the local frame.
        box: south, north, west, east [m] of the area.
        gdal: to read them with; the survey asks it for coordinates.

    Raises:
        UsageError: a file cannot be read, they do not cover the area, or they have too many heights in it.
    """
    name = called(wanted.files)
    if box is None:
        raise UsageError(f"{name}: needs a world.area with bounds, box or polygon")
    place = (math.degrees(site.latitude_rad), math.degrees(site.longitude_rad))
    given = from_code(wanted.crs, gdal, place) if wanted.crs else None
    rasters = [open_raster(source, gdal, place, given) for source in sources_of(wanted.files)]
    files = mosaic(rasters)
    _check_near(name, files, site, gdal)
    needed = _needed(name, files, site, gdal, box)
    near, covered = _read_near(name, files, needed, wanted.every)
    found = Survey(name, files, site, gdal, near, covered, needed, notes=_notes(rasters))
    if wanted.fill:
        heights, count = filled(near.height)
        if count:
            found.notes.append(filled_note(name, count))
        found.near = Elevations("cells", near.rows, near.columns, heights)
    found.spacing = _spacing(found, box, wanted.every)
    found.far = _read_far(found, box, wanted.reach)
    found.zero = _zero(found, wanted.zero)
    return found


def _notes(rasters: list[Raster]) -> list[str]:
    """Return messages to the user about the files' unit, and about an inexact coordinate reference system."""
    notes = [f"{raster.file}: {raster.note}" for raster in rasters[:1] if raster.note]
    crs = rasters[0].grid.crs
    if crs.accuracy is None or crs.accuracy > 1.0:
        off = "an unknown distance" if crs.accuracy is None else f"about {crs.accuracy:g} m"
        notes.append(
            f"{rasters[0].file}: places in {crs.name} may be off by {off}: PROJ's grids for its datum are not used; "
            "warp the file to WGS 84 with them if that matters"
        )
    return notes


def _needed(name: str, files: Mosaic, site: Site, gdal: Gdal, box: Bounds) -> tuple[float, float, float, float]:
    """Return (first row, last row, first column, last column) of an area; raise UsageError if files end inside."""
    south, north, west, east = box
    # A box in metres is none on a map, so points along its sides are looked at.
    along = np.linspace(0.0, 1.0, 33)
    norths = south + (north - south) * np.concatenate([along, along, along * 0.0, along * 0.0 + 1.0])
    easts = west + (east - west) * np.concatenate([along * 0.0, along * 0.0 + 1.0, along, along])
    rows, columns = cells(files, site, gdal, name, norths, easts)
    if not (np.isfinite(rows).all() and np.isfinite(columns).all()):
        raise UsageError(f"{name}: world.area has no coordinates in {files.grid.crs.name}")
    _check_cover(name, files, (rows, columns), np.array(files.extent, float))
    return float(rows.min()), float(rows.max()), float(columns.min()), float(columns.max())


def _check_cover(name: str, files: Mosaic, area: tuple[Float64, Float64], has: Float64) -> None:
    """Raise UsageError if files with the extent ``has``, (rows, columns), end inside an area's rows and columns."""
    rows, columns = area
    if (
        rows.min() < has[0] - SLACK
        or rows.max() > has[1] + SLACK
        or columns.min() < has[2] - SLACK
        or columns.max() > has[3] + SLACK
    ):
        raise UsageError(
            f"{name}: covers {extent(files, has[:2], has[2:])}; world.area needs {extent(files, rows, columns)}; "
            "give a smaller world.area or more files"
        )


def _check_near(name: str, files: Mosaic, site: Site, gdal: Gdal) -> None:
    """Raise UsageError for terrain files that are far from the site."""
    r0, r1, c0, c1 = files.extent
    row, column = (float(each) for each in cells(files, site, gdal, name, np.zeros(()), np.zeros(())))
    if r0 <= row <= r1 and c0 <= column <= c1:
        return
    rows, columns = np.meshgrid(np.linspace(r0, r1, 5), np.linspace(c0, c1, 5))
    latitude, longitude = map(np.radians, to_degrees(name, files.grid.crs, gdal, *files.grid.place(rows, columns)))

    def away(site_latitude: float, site_longitude: float) -> float:
        """Return the distance [m] from a place [rad] to the nearest point that the files cover."""
        half = np.sin(0.5 * (latitude - site_latitude)) ** 2
        half = half + np.cos(latitude) * math.cos(site_latitude) * np.sin(0.5 * (longitude - site_longitude)) ** 2
        return float(np.nanmin(2.0 * EARTH_RADIUS * np.arcsin(np.sqrt(np.clip(half, 0.0, 1.0)))))

    if not np.isfinite(latitude + longitude).any():
        raise UsageError(f"{name}: its grid is beyond the area of {files.grid.crs.name}")
    distance = away(site.latitude_rad, site.longitude_rad)
    if distance <= FAR_OFF:
        return
    others = {
        "is the site's longitude of the right sign?": (site.latitude_rad, -site.longitude_rad),
        "is the site's latitude of the right sign?": (-site.latitude_rad, site.longitude_rad),
        "are the site's latitude and longitude swapped?": (site.longitude_rad, site.latitude_rad),
    }
    hint = next((words for words, place in others.items() if away(*place) <= FAR_OFF), "look at site and crs")
    kilometres = f"{distance / 1000.0:,.0f}".replace(",", " ")
    raise UsageError(f"{name}: the site is {kilometres} km from its grid; {hint}")


def _read_near(
    name: str, files: Mosaic, needed: tuple[float, float, float, float], every: int
) -> tuple[Elevations, Heights]:
    """Return the heights around an area, each ``every``-th cell, and a bool array: a file covers the place."""
    axes = []
    for low, high, first, last in zip(needed[::2], needed[1::2], files.extent[::2], files.extent[1::2], strict=True):
        start = max(math.floor(low) - MARGIN * every, first)
        stop = min(math.ceil(high) + MARGIN * every, last)
        axes.append(range(start, stop + 1, every))
    rows, columns = axes
    count = len(rows) * len(columns)
    if count > MOST_HEIGHTS:
        least = math.ceil(every * math.sqrt(count / MOST_HEIGHTS))
        raise UsageError(
            f"{name}: {count:.2g} heights in world.area; allowed: {MOST_HEIGHTS:.0e}; set every: {least}, or a smaller "
            "area"
        )
    if rows[-1] < needed[1] - SLACK or columns[-1] < needed[3] - SLACK or min(len(rows), len(columns)) < 2:
        raise UsageError(
            f"{name}: every: {every} leaves {len(rows)} x {len(columns)} heights, which do not reach both ends of "
            "world.area; give a smaller number or a smaller area"
        )
    heights, covered = files.heights(rows, columns)
    return Elevations("cells", np.array(rows, float), np.array(columns, float), heights), covered


def _spacing(found: Survey, box: Bounds, every: int) -> tuple[float, float]:
    """Return the distances north and east [m] between the cells that are read, at the middle of a box."""
    north, east = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    step = 10.0
    norths, easts = north + np.array([0.0, step, 0.0]), east + np.array([0.0, 0.0, step])
    rows, columns = cells(found.mosaic, found.site, found.gdal, found.name, norths, easts)
    moved = np.hypot(rows[1:] - rows[0], columns[1:] - columns[0])
    return float(every * step / moved[0]), float(every * step / moved[1])


def _read_far(found: Survey, box: Bounds, reach: float) -> Elevations | None:
    """Return coarser heights up to ``reach`` [m] around a box's middle, None without any; may add a note."""
    middle = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
    whole = reach
    while True:
        rows, columns = _around(found, middle, reach)
        factors = (max((f for f in tile.raster.overviews if f <= rows.step), default=1) for tile in found.mosaic.tiles)
        cost = len(rows) * len(columns) * (rows.step / min(factors)) ** 2
        if cost <= MOST_READ:
            break
        reach *= 0.8
    if reach < whole:
        found.notes.append(
            f"{found.name}: the horizon is that of the nearest {reach / 1000.0:.2g} km: beyond are more heights than "
            "are read; overviews (gdaladdo) allow more"
        )
    if not rows or not columns:
        return None
    heights = _closed(found.mosaic.coarse(rows, columns))
    centre = 0.5 * (rows.step - 1)
    return Elevations("cells", np.array(rows) + centre, np.array(columns) + centre, heights)


def _around(found: Survey, middle: tuple[float, float], reach: float) -> tuple[range, range]:
    """Return the ranges of rows and columns within ``reach`` [m] of a place, at most MOST_HEIGHTS cells."""
    turns = np.linspace(0.0, 2.0 * math.pi, 64)
    north, east = middle[0] + reach * np.cos(turns), middle[1] + reach * np.sin(turns)
    axes = cells(found.mosaic, found.site, found.gdal, found.name, north, east)
    first, last = [], []
    for axis, low, high in zip(axes, found.mosaic.extent[::2], found.mosaic.extent[1::2], strict=True):
        # Beyond the area of a map there are no cells either.
        inside = np.clip(axis[np.isfinite(axis)], low, high)
        first.append(math.floor(inside.min()) if len(inside) else low)
        last.append(math.ceil(inside.max()) + 1 if len(inside) else low)
    sizes = [b - a for a, b in zip(first, last, strict=True)]
    step = max(1, math.ceil(math.sqrt(sizes[0] * sizes[1] / MOST_HEIGHTS)))
    rows, columns = (range(a, a + size // step * step, step) for a, size in zip(first, sizes, strict=True))
    # A single row or column has no patches.
    return (rows, columns) if min(len(rows), len(columns)) > 1 else (range(0), range(0))


def _closed(heights: Heights) -> Heights:
    """Return heights with gaps of one row or column, between tiles, filled from their neighbours."""
    for axis in (0, 1):
        for shift in (1, -1):
            if not np.isnan(heights).any():
                return heights
            heights = np.where(np.isnan(heights), np.roll(heights, shift, axis), heights)
    return heights


def _zero(found: Survey, given: float | None) -> float:
    """Return the height [m] that becomes z = 0: the given one, else the ground's at the site's origin."""
    if given is not None:
        return given
    origin = np.zeros(())
    row, column = (float(each) for each in cells(found.mosaic, found.site, found.gdal, found.name, origin, origin))
    height = float(found.near.at(np.asarray(row), np.asarray(column)))
    if not math.isfinite(height) and math.isfinite(row) and math.isfinite(column):
        # The area may be elsewhere.
        rows, columns = (range(math.floor(each), math.floor(each) + 2) for each in (row, column))
        heights, _ = found.mosaic.heights(rows, columns)
        around = Elevations("cells", np.array(rows, float), np.array(columns, float), heights)
        height = float(around.at(np.asarray(row), np.asarray(column)))
    if not math.isfinite(height):
        raise UsageError(
            f"{found.name}: has no height at the site's origin, which would be z = 0; give height_of_zero, the "
            "height in the file that is z = 0"
        )
    return height
