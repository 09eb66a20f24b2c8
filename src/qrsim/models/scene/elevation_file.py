"""Ground from files of elevations: how a scenario names them, and the grid and horizon that are made of them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tree import record, record_of, setting
from qrsim.errors import UsageError
from qrsim.extras import MissingExtraError
from qrsim.models.geoid import GeoidPlane
from qrsim.models.scene.elevation import EARTH_RADIUS, SUFFIXES, Bounds, Landscape, filled_note, landscape
from qrsim.models.scene.ground import GridGround
from qrsim.models.site import Site

# What a grid may have after it was cut to the area: 16 MB in single precision.
MOST_POINTS = 4_000_000
# The table of the horizon: heights of the eye and bearings, and how far it looks [m], in steps of a part of the way.
EYES, BEARINGS = 8, 180
FARTHEST, STEP = 50_000.0, 0.005


@record
class ElevationFile:
    """Ground from a digital elevation model: GeoTIFF, SRTM (.hgt), ESRI ASCII (.asc), .vrt, NumPy (.npz), or tiles.

    It must cover the area. What it has beyond that makes the horizon, which hides satellites.
    """

    file: str | tuple[str, ...] = setting(doc="a file, a list of tiles, or a folder of tiles")
    frame: Literal["auto", "local", "geodetic"] = setting(
        default="auto",
        doc="coordinates of an .asc or .npz; auto: degrees if its cells are smaller than 0.1",
    )
    origin_north: float = setting(default=0.0, unit="m", doc="frame 'local': northing of the site's origin in the grid")
    origin_east: float = setting(default=0.0, unit="m", doc="frame 'local': easting of the site's origin in the grid")
    height_of_zero: float | None = setting(
        default=None,
        unit="m",
        doc="height in the grid at z = 0; default: the ground at the site's origin",
        minimum=-1000.0,
        maximum=10_000.0,
    )
    zero: Literal["ground", "site"] = setting(
        default="ground", doc="what is at z = 0: the ground at the site's origin, or the site's own height"
    )
    datum: Literal["sea", "ellipsoid"] = setting(
        default="sea", doc="what heights in the grid are above; used with zero 'site'"
    )
    crs: str = setting(default="", doc="coordinate reference system of files that have none, such as EPSG:32630")
    every: int = setting(default=1, unit="1", doc="read every n-th row and column only", minimum=1.0, maximum=1000.0)
    missing: Literal["error", "fill"] = setting(
        default="error", doc="missing heights in the area; fill: that of the nearest cell, at most 5 cells away"
    )

    def at(self, site: Site, box: Bounds | None) -> GridGround:
        """Return the ground that the file gives for a site and an area, in float64.

        Args:
            site: origin of the local frame.
            box: south, north, west, east [m] of the area, None where it has no bounds.

        Raises:
            UsageError: a file cannot be read, it does not cover the area or has no height at a point in it, or it has
                too many points there.
        """
        return self._read(site, box)[0]

    def notes(self, site: Site, box: Bounds | None) -> tuple[str, ...]:
        """Return messages to the user about the file, one sentence each; arguments and errors as of ``at``."""
        return self._read(site, box)[1]

    def _read(self, site: Site, box: Bounds | None) -> tuple[GridGround, tuple[str, ...]]:
        """Return the ground and its messages, read once; a UsageError is raised again at each later call."""
        # A scenario is checked before it is built, and its files are read for both.
        found = _made(self, site, box, self._stamps())
        if isinstance(found, UsageError):
            raise found
        return found

    def _stamps(self) -> tuple[tuple[str, int, int], ...]:
        """Return (name, time of change, size) of each file that exists, as a cache key."""
        # Only who has such files waits for their readers to be imported.
        from qrsim.models.scene.terrain_files.tiles import sources_of, stamps
        from qrsim.models.scene.terrain_files.vrt import Source

        return stamps(sources_of(self.file) if self._surveyed else (Source(str(self.file), None),))

    @property
    def _surveyed(self) -> bool:
        """True if the file's coordinates are those of a map projection, not metres from the site or plain degrees."""
        if not isinstance(self.file, str) or os.path.isdir(os.path.expanduser(self.file)):
            return True
        suffix = Path(self.file).suffix.lower()
        if suffix != ".asc":
            return suffix in SUFFIXES
        # Who says where the site is in a grid takes its north for true north.
        if self.frame != "auto" or self.origin_north != 0.0 or self.origin_east != 0.0:
            return False
        from qrsim.models.scene.terrain_files.ascii_grid import prj_of
        from qrsim.models.scene.terrain_files.crs import is_wgs84

        wkt = prj_of(self.file)
        return self.crs != "" or not (wkt is None or is_wgs84(wkt))

    def _height_of_zero(self, site: Site) -> float | None:
        """Return the height [m] in the grid that becomes z = 0; None for the ground's height at the origin."""
        if self.zero == "ground":
            return self.height_of_zero
        if self.height_of_zero is not None:
            raise UsageError("height_of_zero and zero: site are both given; allowed: one")
        return site.height - (GeoidPlane.at(site).height if self.datum == "sea" else 0.0)

    def _own_notes(self) -> tuple[str, ...]:
        """Return a message to the user if the north of a file in metres may not be true north, in a tuple."""
        moved = self.frame == "auto" and (self.origin_north != 0.0 or self.origin_east != 0.0)
        if moved and str(self.file).lower().endswith(".asc"):
            return (
                f"{self.file}: its north is taken for true north, which that of a map is not (UTM: up to 3 degrees); "
                "leave out origin_north and origin_east and give crs or a .prj file, or say frame: local",
            )
        return ()


@lru_cache(maxsize=2)
def _made(
    item: ElevationFile, site: Site, box: Bounds | None, changed: object
) -> tuple[GridGround, tuple[str, ...]] | UsageError:
    """Return the file's ground and messages, or the UsageError of reading it; ``changed`` is the cache's key."""
    zero = item._height_of_zero(site)
    try:
        if not item._surveyed:
            return _plain(item, str(item.file), site, box, zero)
        return _of_survey(item, site, box, zero)
    except MissingExtraError:
        raise
    except UsageError as error:
        return error


def _plain(
    item: ElevationFile, file: str, site: Site, box: Bounds | None, zero: float | None
) -> tuple[GridGround, tuple[str, ...]]:
    """Return ground and messages of a file with coordinates in metres from the site, or in degrees."""
    if item.crs:
        raise UsageError(f"{file}: crs is for files with coordinates of a map; leave out crs or the frame and origins")
    origin = (item.origin_north, item.origin_east)
    land = landscape(file, item.frame, site, origin, zero, box, item.every, item.missing == "fill")
    rows, columns = _points(file, land, box)
    grid = land.down(rows[:, None], columns[None, :])
    made = _ground(file, grid, rows, columns, land.down, rows[1] - rows[0], columns[1] - columns[0])
    return made, (*item._own_notes(), *((filled_note(file, land.filled),) if land.filled else ()))


def _of_survey(
    item: ElevationFile, site: Site, box: Bounds | None, zero: float | None
) -> tuple[GridGround, tuple[str, ...]]:
    """Return ground and messages of files with coordinates of a map projection."""
    from qrsim.models.scene.terrain_files.gdal import Gdal
    from qrsim.models.scene.terrain_files.survey import Wanted, survey
    from qrsim.models.scene.terrain_files.tiles import called

    if item.frame != "auto" or item.origin_north != 0.0 or item.origin_east != 0.0:
        raise UsageError(
            f"{called(item.file)}: frame, origin_north and origin_east are for .asc and .npz in metres; it has its own "
            "coordinates"
        )
    wanted = Wanted(item.file, item.crs, item.every, item.missing == "fill", zero, FARTHEST)
    with Gdal() as gdal:
        found = survey(wanted, site, box, gdal)
        rows, columns = _even(box, found.spacing)
        grid = found.grid(rows, columns)
        if np.isnan(grid).any() and (gap := found.gap()):
            raise UsageError(f"{found.name}: {gap}")
        made = _ground(found.name, grid, rows, columns, found.down, min(found.spacing))
        return made, tuple(found.notes)


def _ground(
    name: str, grid: Floats, rows: Floats, columns: Floats, down: Callable[[Floats, Floats], Floats], *steps: float
) -> GridGround:
    """Return the ground for a grid of down coordinates, with the terrain horizon around its middle.

    Args:
        name: of the file, for messages.
        grid: (R, C) down coordinate [m], NaN where it is missing.
        rows, columns: north (R,) and east (C,) [m] of the points.
        down: the down coordinate at any place, also beyond the area.
        *steps: sides of a cell [m], the smallest of which the horizon begins with.

    Raises:
        UsageError: a point has no height.
    """
    missing = np.argwhere(~np.isfinite(grid))
    if len(missing):
        i, j = missing[0]
        raise UsageError(
            f"{name}: has no height at {len(missing)} of {grid.size} points in world.area, the first at north "
            f"{rows[i]:.6g} m, east {columns[j]:.6g} m; missing: fill takes the nearest"
        )
    middle = (0.5 * (rows[0] + rows[-1]), 0.5 * (columns[0] + columns[-1]))
    lowest = float(down(*map(np.asarray, middle))) - 1.0
    highest = min(lowest, float(grid.min())) - 200.0
    corner, spacing = (rows[0], columns[0]), (rows[1] - rows[0], columns[1] - columns[0])
    horizon = _horizon(down, middle, np.linspace(lowest, highest, EYES), min(steps))
    return record_of(GridGround, grid, corner, spacing, horizon, (lowest, highest))


def _even(box: Bounds | None, spacing: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return north and east [m] of grid points over a box, two per cell of the file, at most MOST_POINTS in all."""
    assert box is not None
    sides, steps = (box[1] - box[0], box[3] - box[2]), (0.5 * spacing[0], 0.5 * spacing[1])
    counts = [max(2, math.ceil(side / step) + 1) for side, step in zip(sides, steps, strict=True)]
    wider = math.sqrt(max(1.0, counts[0] * counts[1] / MOST_POINTS))
    north, east = (max(2, int(count / wider)) for count in counts)
    return np.linspace(box[0], box[1], north), np.linspace(box[2], box[3], east)


def _points(file: str, land: Landscape, box: Bounds | None) -> tuple[Floats, Floats]:
    """Return north and east [m] of the grid points of the ground in a box, from a file's terrain ``land``.

    Those of a local file are its own, cut to the box; over a grid by latitude, they are half as far apart as its own.
    """
    source = land.elevations
    if source.frame == "local":
        axes = []
        for values, origin, limits in (
            (source.rows, land.origin[0], None if box is None else box[:2]),
            (source.columns, land.origin[1], None if box is None else box[2:]),
        ):
            own = values - origin
            if limits is not None:
                # From the last point that is not inside to the first one beyond; a limit may be a rounding error off.
                slack = 1e-6 * (own[1] - own[0])
                first = max(int(np.searchsorted(own, limits[0] + slack)) - 1, 0)
                own = own[first : int(np.searchsorted(own, limits[1] - slack)) + 1]
            axes.append(own)
        rows, columns = axes
    else:
        if box is None:
            raise UsageError(f"{file}: a grid by latitude and longitude needs a world.area with bounds, box or polygon")
        radius = math.radians(1.0) * EARTH_RADIUS
        steps = (
            0.5 * source.spacing[0] * radius,
            0.5 * source.spacing[1] * radius * math.cos(land.site.latitude_rad),
        )
        counts = [
            max(2, math.ceil((high - low) / step) + 1)
            for (low, high), step in zip((box[:2], box[2:]), steps, strict=True)
        ]
        if counts[0] * counts[1] <= MOST_POINTS:
            rows, columns = (
                np.linspace(low, high, n) for (low, high), n in zip((box[:2], box[2:]), counts, strict=True)
            )
            return rows, columns
        raise _too_many(file, counts[0] * counts[1])
    if len(rows) * len(columns) > MOST_POINTS:
        raise _too_many(file, len(rows) * len(columns))
    return rows, columns


def _too_many(file: str, count: int) -> UsageError:
    """Return the error for a file with ``count`` points in the area, too many."""
    return UsageError(f"{file}: {count} points in world.area; allowed: {MOST_POINTS}, so resample it more coarsely")


def _horizon(
    ground: Callable[[Floats, Floats], Floats], middle: tuple[float, float], eyes: Floats, step: float
) -> Floats:
    """Return the sine (E, B) of the horizon's elevation around ``middle``, seen from down coordinates ``eyes`` [m]."""
    bearing = 2.0 * math.pi * np.arange(BEARINGS) / BEARINGS
    # A quarter of a cell at first, not to step over a ridge.
    even = 0.25 * step * np.arange(1, math.ceil(1.0 / STEP))
    distance = np.concatenate([even, np.exp(np.arange(np.log(even[-1]), np.log(FARTHEST), STEP))])
    north = middle[0] + np.cos(bearing)[:, None] * distance
    east = middle[1] + np.sin(bearing)[:, None] * distance
    # The Earth falls away below a plane.
    down = ground(north, east) + distance**2 / (2.0 * EARTH_RADIUS)
    up = eyes[:, None, None] - down[None]
    sine = up / np.hypot(up, distance)
    return np.max(np.where(np.isfinite(sine), sine, -1.0), axis=2)
