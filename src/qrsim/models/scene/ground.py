"""The ground that vehicles stand on, and heights are counted from (docs/explanation/models/scene.md)."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tree import computed, quantity, record, record_of, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.scene.contracts import Ground, upward
from qrsim.models.scene.elevation import EARTH_RADIUS, Bounds, Landscape, landscape
from qrsim.models.site import Site

# What a grid may have after it was cut to the area: 16 MB in single precision.
MOST_POINTS = 4_000_000
# The table of the horizon: heights of the eye and bearings, and how far it looks [m], in steps of a part of the way.
EYES, BEARINGS = 8, 180
FARTHEST, STEP = 50_000.0, 0.005
# Parts of a way between two points, at whose ends the ground is asked whether it is in between: of the whole way, and
# at least and at most of that over the grid, which it meets cell by cell as long as there are no more.
_LOOKS, _FEWEST_LOOKS, _MOST_LOOKS = 32, 16, 512
# Tolerance [m], so that rounding does not hide a vehicle on the ground.
_SLACK = 0.1


@record
class FlatGround(Ground):
    """A horizontal plane."""

    height: float = setting(default=0.0, unit="m", doc="height over the origin of the local frame, positive up")
    flat: ClassVar[bool] = True

    @computed
    def at_zero(self) -> bool:
        """True if the ground is the plane z = 0."""
        return self.height == 0.0

    def down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate [m] of the ground below positions of any shape."""
        return jnp.full_like(position_ned.z, 0.0 - self.height)

    def ray_distance(self, origin_ned: Vec3, direction: Vec3, reach: Array) -> Array:
        """Return the distance [m] along rays (...) to the plane, infinite beyond their reach."""
        above = -self.height - origin_ned.z
        falls = direction.z > 0.0
        met = above / jnp.where(falls, direction.z, 1.0)
        return jnp.where(above <= 0.0, 0.0, jnp.where(falls & (met <= reach), met, jnp.inf))

    def normal(self, position_ned: Vec3) -> Vec3:
        """Return the normal, straight up."""
        flat = jnp.zeros_like(position_ned.z)
        return Vec3(flat, flat, flat - 1.0)


@record
class GridGround(Ground):
    """Ground by the heights of a grid, bilinear in between; beyond its edges that of the edge.

    ``ElevationFile.at`` makes it.
    """

    grid: Array = quantity(unit="m", doc="(R, C) down coordinate, rows to the north and columns to the east")
    corner: tuple[Array, Array] = quantity(unit="m", doc="north and east of the south-western point")
    spacing: tuple[Array, Array] = quantity(unit="m", doc="distance of two rows and of two columns")
    horizon: Array = quantity(
        unit="1", doc="(E, B) sine of the elevation of the horizon, by the eye's height and bearing"
    )
    eyes: tuple[Array, Array] = quantity(unit="m", doc="down coordinate of the lowest and of the highest eye")

    hides: ClassVar[bool] = True

    def down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate [m] of the ground below positions of any shape."""
        (a, b), corners = self._cell(position_ned)
        south, north = (low + b * (high - low) for low, high in corners)
        return south + a * (north - south)

    def line_of_sight(self, position_ned: Vec3, point_ned: Vec3) -> Array:
        """Return whether a point () [m] is seen from positions (n,) [m], by the ground at places in between."""
        shape, dtype = self.grid.shape, position_ned.x.dtype
        ways = [b - a for a, b in zip(position_ned.axes, point_ned.axes, strict=True)]
        # Which part of the way is over the grid; of ridges there is nothing to be missed beyond.
        enters, leaves = jnp.zeros_like(position_ned.x), jnp.ones_like(position_ned.x)
        for axis, (begin, way) in enumerate(zip(position_ned.axes[:2], ways[:2], strict=True)):
            ends = [self.corner[axis], self.corner[axis] + self.spacing[axis] * (shape[axis] - 1)]
            along = jnp.abs(way) > 1e-6
            first, last = ((end - begin) / jnp.where(along, way, 1.0) for end in ends)
            enters = jnp.maximum(enters, jnp.where(along, jnp.minimum(first, last), 0.0))
            leaves = jnp.minimum(leaves, jnp.where(along, jnp.maximum(first, last), 1.0))
        count = min(max(sum(shape), _FEWEST_LOOKS), _MOST_LOOKS)
        over = (jnp.arange(count, dtype=dtype)[:, None] + 0.5) * (1.0 / count)
        whole = jnp.arange(1, _LOOKS, dtype=dtype)[:, None] * (1.0 / _LOOKS)
        seen = jnp.ones(position_ned.x.shape, bool)
        for part in (whole + 0.0 * enters[None, :], enters[None, :] + (leaves - enters)[None, :] * over):
            inside = jnp.clip(part, 0.0, 1.0)
            places = Vec3(*(a[None, :] + way[None, :] * inside for a, way in zip(position_ned.axes, ways, strict=True)))
            seen = seen & jnp.all(places.z - _SLACK <= self.down(places), axis=0)
        return seen

    def normal(self, position_ned: Vec3) -> Vec3:
        """Return the unit normal, upwards, of the bilinear patch below positions of any shape."""
        (a, b), ((sw, se), (nw, ne)) = self._cell(position_ned)
        north = ((nw - sw) + b * ((ne - se) - (nw - sw))) / self.spacing[0]
        east = ((se - sw) + a * ((ne - nw) - (se - sw))) / self.spacing[1]
        return upward(north, east)

    def _cell(self, position_ned: Vec3) -> tuple[tuple[Array, Array], tuple[tuple[Array, Array], tuple[Array, Array]]]:
        """Return the position in each cell, 0 to 1 north and east, and the cell's corners: ((sw, se), (nw, ne))."""
        grid, parts, numbers = jnp.asarray(self.grid), [], []
        for axis, value in enumerate((position_ned.x, position_ned.y)):
            last = grid.shape[axis] - 1
            place = jnp.clip((value - self.corner[axis]) / self.spacing[axis], 0.0, float(last))
            # NaN has no cell, and stays NaN in the position.
            number = jnp.clip(jnp.floor(jnp.where(jnp.isfinite(place), place, 0.0)), 0.0, float(last - 1))
            parts.append(place - number)
            numbers.append(number.astype(jnp.int32))
        i, j = numbers
        south, north = (tuple(grid[i + di, j + dj] for dj in (0, 1)) for di in (0, 1))
        return (parts[0], parts[1]), (south, north)  # type: ignore[return-value]

    def horizon_sine(self, position_ned: Vec3, line_of_sight: Vec3) -> Array:
        """Return the sine (S, n) of the elevation of the horizon below lines of sight (S, n) from positions (n,).

        It is that seen from above the middle of the area, at the same height as the vehicle.
        """
        table = jnp.asarray(self.horizon)
        eyes, bearings = table.shape
        low, high = self.eyes
        level = jnp.clip((position_ned.z - low) / (high - low), 0.0, 1.0) * (eyes - 1)
        level = jnp.where(jnp.isfinite(level), level, 0.0)
        row = jnp.clip(jnp.floor(level), 0.0, eyes - 2.0)
        turn = jnp.arctan2(line_of_sight.y, line_of_sight.x) * (bearings / (2.0 * math.pi))
        turn = jnp.where(turn < 0.0, turn + bearings, turn)
        turn = jnp.where(jnp.isfinite(turn), turn, 0.0)
        column = jnp.clip(jnp.floor(turn), 0.0, bearings - 1.0)
        a, b = (level - row)[None, :], turn - column
        i, j = jnp.broadcast_to(row.astype(jnp.int32)[None, :], turn.shape), column.astype(jnp.int32)
        beside = jnp.where(j + 1 >= bearings, 0, j + 1)
        lower, upper = ((1.0 - b) * table[k, j] + b * table[k, beside] for k in (i, i + 1))
        return lower + a * (upper - lower)


@record
class ElevationFile:
    """Ground from a digital elevation model: an ESRI ASCII grid (.asc) or a NumPy archive (.npz).

    It must cover the area. What it has beyond that makes the horizon, which hides satellites.
    """

    file: str = setting(doc="the grid, in metres or in degrees of latitude and longitude")
    frame: Literal["auto", "local", "geodetic"] = setting(
        default="auto", doc="kind of its coordinates; auto: degrees if its cells are smaller than 0.1"
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

    def at(self, site: Site, box: Bounds | None) -> GridGround:
        """Read the file for a site and an area, in float64.

        Args:
            site: origin of the local frame.
            box: south, north, west, east [m] of the area, None where it has no bounds.

        Raises:
            UsageError: as ``landscape``, or no height at a point in the area, or too many points there.
        """
        land = landscape(self.file, self.frame, site, (self.origin_north, self.origin_east), self.height_of_zero, box)
        rows, columns = _points(self.file, land, box)
        grid = land.down(rows[:, None], columns[None, :])
        missing = np.argwhere(~np.isfinite(grid))
        if len(missing):
            i, j = missing[0]
            raise UsageError(
                f"{self.file}: has no height at {len(missing)} of {grid.size} points in world.area, the first at north "
                f"{rows[i]:.6g} m, east {columns[j]:.6g} m"
            )
        middle = (0.5 * (rows[0] + rows[-1]), 0.5 * (columns[0] + columns[-1]))
        lowest = float(land.down(*map(np.asarray, middle))) - 1.0
        highest = min(lowest, float(grid.min())) - 200.0
        corner, spacing = (rows[0], columns[0]), (rows[1] - rows[0], columns[1] - columns[0])
        horizon = _horizon(land, middle, np.linspace(lowest, highest, EYES), min(spacing))
        return record_of(GridGround, grid, corner, spacing, horizon, (lowest, highest))


def _points(file: str, land: Landscape, box: Bounds | None) -> tuple[Floats, Floats]:
    """Return north and east [m] of the points of the ground's grid.

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
    return UsageError(f"{file}: {count} points in world.area; allowed: {MOST_POINTS}, so resample it more coarsely")


def _horizon(land: Landscape, middle: tuple[float, float], eyes: Floats, step: float) -> Floats:
    """Return the sine (E, B) of the elevation of the horizon around a place, from eyes (E,) at down coordinates [m]."""
    bearing = 2.0 * math.pi * np.arange(BEARINGS) / BEARINGS
    # A quarter of a cell at first, not to step over a ridge.
    even = 0.25 * step * np.arange(1, math.ceil(1.0 / STEP))
    distance = np.concatenate([even, np.exp(np.arange(np.log(even[-1]), np.log(FARTHEST), STEP))])
    north = middle[0] + np.cos(bearing)[:, None] * distance
    east = middle[1] + np.sin(bearing)[:, None] * distance
    # The Earth falls away below a plane.
    down = land.down(north, east) + distance**2 / (2.0 * EARTH_RADIUS)
    up = eyes[:, None, None] - down[None]
    sine = up / np.hypot(up, distance)
    return np.max(np.where(np.isfinite(sine), sine, -1.0), axis=2)
