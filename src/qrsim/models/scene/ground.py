"""The ground that vehicles stand on, and heights are counted from (docs/explanation/models/scene.md)."""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import computed, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground, upward

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
        """True if the ground is exactly the plane z = 0."""
        return self.height == 0.0

    def down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate [m] of the flat ground below positions of any shape [m]."""
        return jnp.full_like(position_ned.z, 0.0 - self.height)

    def ray_distance(self, origin_ned: Vec3, direction: Vec3, reach: Array) -> Array:
        """Return the distance [m] along rays (...) to the ground plane, infinite beyond ``reach`` [m]."""
        above = -self.height - origin_ned.z
        falls = direction.z > 0.0
        met = above / jnp.where(falls, direction.z, 1.0)
        return jnp.where(above <= 0.0, 0.0, jnp.where(falls & (met <= reach), met, jnp.inf))

    def normal(self, position_ned: Vec3) -> Vec3:
        """Return the ground's unit normal, straight up, for positions of any shape."""
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
        """Return the down coordinate [m] of the ground below positions of any shape [m], bilinear in the grid."""
        (a, b), corners = self._cell(position_ned)
        south, north = (low + b * (high - low) for low, high in corners)
        return south + a * (north - south)

    def line_of_sight(self, position_ned: Vec3, point_ned: Vec3) -> Array:
        """Return (n,) bool: the terrain does not hide a point () [m] from positions (n,) [m], by samples in between."""
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
        """Return the upward unit normal of the bilinear ground below positions of any shape [m]."""
        (a, b), ((sw, se), (nw, ne)) = self._cell(position_ned)
        north = ((nw - sw) + b * ((ne - se) - (nw - sw))) / self.spacing[0]
        east = ((se - sw) + a * ((ne - nw) - (se - sw))) / self.spacing[1]
        return upward(north, east)

    def _cell(self, position_ned: Vec3) -> tuple[tuple[Array, Array], tuple[tuple[Array, Array], tuple[Array, Array]]]:
        """Return positions in their grid cell, 0 to 1, and the cell's down coordinates [m], ((sw, se), (nw, ne))."""
        grid, parts, numbers = jnp.asarray(self.grid), [], []
        for axis, value in enumerate((position_ned.x, position_ned.y)):
            last = grid.shape[axis] - 1
            place = jnp.clip((value - self.corner[axis]) / self.spacing[axis], 0.0, float(last))
            # NaN has no cell, and stays NaN in the position.
            number = jnp.clip(jnp.floor(jnp.where(jnp.isfinite(place), place, 0.0)), 0.0, float(last - 1))
            parts.append(place - number)
            numbers.append(number.astype(jnp.int32))
        i, j = numbers
        south, north = ((grid[i + di, j], grid[i + di, j + 1]) for di in (0, 1))
        return (parts[0], parts[1]), (south, north)

    def horizon_sine(self, position_ned: Vec3, line_of_sight: Vec3) -> Array:
        """Return the sine (S, n) of the terrain horizon's elevation below lines of sight (S, n) from positions (n,).

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
