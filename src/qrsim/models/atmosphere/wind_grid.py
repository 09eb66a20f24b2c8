"""Mean wind of a grid of places: the result of a flow solver or of a weather model (docs/explanation/models/air.md)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.series import interval_at, split_seconds
from qrsim.core.tree import quantity, record, record_of, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.files.time_series import check_covers
from qrsim.models.atmosphere.contracts import Bounds, Wind
from qrsim.models.atmosphere.wind_grid_file import Layout, read_grid

# After it was cut to the area: 96 MB in single precision.
MOST_POINTS = 8_000_000


@record
class WindGrid(Wind):
    """The air's velocity at points of a grid, linear in between; beyond its edges that of the edge.

    ``WindGridFile.at`` makes it.
    """

    air_ned: Vec3 = quantity(unit="m/s", doc="(T, Z, Y, X) velocity of the air in NED; X to the east, Y to the north")
    corner: tuple[Array, Array] = quantity(unit="m", doc="north and east of the south-western points")
    spacing: tuple[Array, Array] = quantity(unit="m", doc="distance of two rows to the north and of two to the east")
    levels: Array = quantity(unit="m", doc="(Z,) increasing heights")
    seconds: Array = quantity(unit="s", doc="(T,) int32, whole seconds since the start of the run")
    fraction: Array = quantity(unit="s", doc="(T,) the rest, in [0, 1)")
    heights: Literal["ground", "origin"] = setting(default="ground", doc="reference of the levels")
    file: str = setting(default="", doc="source, for messages")
    mean_ned: Vec3 = quantity(default=None, unit="m/s", doc="(Z,) mean over time and all places of each level")

    reads: ClassVar[tuple[str, ...]] = ("position_ned",)

    def velocity_ned(
        self, height_agl: Array, seconds: Array, fraction: Array, *, position_ned: Vec3, **reads: object
    ) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at positions and a time, interpolated linearly in the grid.

        Args:
            height_agl: (n,) [m] above ground.
            seconds, fraction: () int32 and float, time since the start of the run [s].
            position_ned: (n,) [m].
        """
        height = height_agl if self.heights == "ground" else -position_ned.z
        rows, columns = (
            _cell((value - corner) / step, count)
            for value, corner, step, count in zip(
                (position_ned.x, position_ned.y), self.corner, self.spacing, self.air_ned.x.shape[2:], strict=True
            )
        )
        level, before = self._level(height), self._time(seconds, fraction)
        return self.air_ned.map(lambda axis: _linear(jnp.asarray(axis), (before, level, rows, columns)))

    def mean_velocity_ned(self, height_agl: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at heights (n,) [m], averaged over time and all places."""
        level, share = self._level(height_agl)

        def at(axis: Array) -> Array:
            """Return one component of the mean wind (n,), interpolated linearly between grid levels."""
            axis = jnp.asarray(axis)
            return axis[level] + share * (axis[level + 1] - axis[level])

        return self.mean_ned.map(at)

    def averaged(self) -> WindGrid:
        """Return the grid with its mean winds over time and place computed, in float64."""
        times = np.asarray(self.seconds) + np.asarray(self.fraction, np.float64)
        # By trapezoids, as the velocity is linear between two times.
        weights = np.convolve(np.diff(times), [0.5, 0.5]) if len(times) > 1 else np.ones(1)
        whole = self.air_ned
        means = whole.map(
            lambda axis: weights @ np.mean(np.asarray(axis), axis=(2, 3), dtype=np.float64) / weights.sum()
        )
        return replace(self, mean_ned=means)

    def within(self, bounds: Bounds | None, top: float | None) -> WindGrid:
        """Return the grid cut to the rows and columns that an area needs; all levels stay.

        Raises:
            UsageError: the grid lies entirely outside the area, or is too large there.
        """
        limits = (None, None) if bounds is None else (bounds[:2], bounds[2:])
        rows, columns = (self._needed(axis, each) for axis, each in enumerate(limits))
        whole: Any = self.air_ned
        points = whole.x[:, :, rows, columns].size
        if points > MOST_POINTS:
            raise UsageError(f"{self.file}: {points} points in world.area; allowed: {MOST_POINTS}, so resample it")
        air = whole.map(lambda axis: np.ascontiguousarray(np.asarray(axis)[:, :, rows, columns]))
        begins = tuple(
            low + part.start * step for low, part, step in zip(self.corner, (rows, columns), self.spacing, strict=True)
        )
        return replace(self, air_ned=air, corner=begins).averaged()

    def beyond(self, bounds: Bounds | None, top: float | None) -> list[str]:
        """Return a sentence for each side on which the area extends beyond the grid, where the edge's wind applies."""
        levels, found = np.asarray(self.levels), []
        if top is not None and top > levels[-1] + 1e-6 * (levels[-1] - levels[0]):
            found.append(f"{self.file}: reaches up to {levels[-1]:.6g} m; world.area reaches up to {top:.6g} m")
        for axis, name in enumerate(("north", "east") if bounds is not None else ()):
            assert bounds is not None
            limits = bounds[2 * axis : 2 * axis + 2]
            first, last, count = self._rows(axis, limits)
            if first < 0.0 or last > count - 1:
                low, step = float(self.corner[axis]), float(self.spacing[axis])
                found.append(
                    f"{self.file}: covers {low:.6g} to {low + (count - 1) * step:.6g} m {name}; world.area asks for "
                    f"{limits[0]:.6g} to {limits[1]:.6g} m"
                )
        return found

    def largest_speed(self, height: NumpyArray) -> NumpyArray:
        """Return the largest horizontal wind speed [m/s] over all places and times, at heights [m] of any shape."""
        speed = np.hypot(np.asarray(self.air_ned.x), np.asarray(self.air_ned.y))
        return np.interp(height, np.asarray(self.levels), speed.max(axis=(0, 2, 3)))

    def _needed(self, axis: int, limits: tuple[float, float] | None) -> slice:
        """Return the slice of rows (axis 0) or columns (1) that covers an area; raise UsageError if none does."""
        count = self.air_ned.x.shape[2 + axis]
        if limits is None:
            return slice(0, count)
        first, last, _ = self._rows(axis, limits)
        # An area that only touches the edge of the grid is allowed.
        if last < -1e-5 or first > count - 1 + 1e-5:
            low, step, name = float(self.corner[axis]), float(self.spacing[axis]), ("north", "east")[axis]
            raise UsageError(
                f"{self.file}: covers {low:.6g} to {low + (count - 1) * step:.6g} m {name}, none of world.area, which "
                f"is {limits[0]:.6g} to {limits[1]:.6g} m; see origin_north and origin_east"
            )
        begin = min(max(math.floor(first), 0), count - 2)
        return slice(begin, min(max(math.ceil(last) + 1, begin + 2), count))

    def _rows(self, axis: int, limits: tuple[float, ...]) -> tuple[float, float, int]:
        """Return an area's limits along an axis in grid steps from its first point, and the number of points."""
        low, step = float(self.corner[axis]), float(self.spacing[axis])
        # An edge of the area may be a rounding error beyond that of the grid.
        return (limits[0] - low) / step + 1e-6, (limits[1] - low) / step - 1e-6, self.air_ned.x.shape[2 + axis]

    def _level(self, height: Array) -> tuple[Array, Array]:
        """Return the index (n,) of the grid level below heights (n,) [m], and the share (n,), 0 to 1, of the next."""
        levels = jnp.asarray(self.levels)
        held = jnp.clip(jnp.where(jnp.isfinite(height), height, levels[0]), levels[0], levels[-1])
        # Levels are few and not evenly spaced, so they are counted.
        passed = (levels[1:-1][:, None] <= held[None, :]).astype(jnp.int32)
        number = jnp.sum(passed, axis=0, dtype=jnp.int32)
        low = levels[number]
        return number, (held - low) / (levels[number + 1] - low)

    def _time(self, seconds: Array, fraction: Array) -> tuple[Array, Array] | None:
        """Return the index () of the grid's time before a time, and the share () of the next; None in steady wind."""
        if self.air_ned.x.shape[0] == 1:
            return None
        row, since, interval = interval_at(jnp.asarray(self.seconds), jnp.asarray(self.fraction), seconds, fraction)
        return row, jnp.clip(since / interval, 0.0, 1.0)


def _cell(place: Array, count: int) -> tuple[Array, Array]:
    """Return the cell index (n,) of coordinates on an axis of ``count`` points, and the position in it, 0 to 1."""
    held = jnp.clip(jnp.where(jnp.isfinite(place), place, 0.0), 0.0, float(count - 1))
    number = jnp.clip(jnp.floor(held), 0.0, float(count - 2))
    return number.astype(jnp.int32), held - number


def _linear(values: Array, cells: tuple[tuple[Array, Array] | None, ...]) -> Array:
    """Return grid values (T, Z, Y, X) interpolated in the given cell of each axis, None for an axis of one point."""
    corners: list[tuple[Any, ...]] = [()]
    for cell in cells:
        steps = (0,) if cell is None else (0, 1)
        start = jnp.int32(0) if cell is None else cell[0]
        corners = [(*corner, start + step) for corner in corners for step in steps]
    shape = jnp.broadcast_shapes(*(cell[0].shape for cell in cells if cell is not None))
    found = [values[tuple(jnp.broadcast_to(i, shape) for i in corner)] for corner in corners]
    # The last axis varies fastest in the list, so it is the first to be joined.
    for cell in reversed(cells):
        if cell is not None:
            found = [low + cell[1] * (high - low) for low, high in zip(found[::2], found[1::2], strict=True)]
    return found[0]


@record
class WindGridFile:
    """A wind from a NetCDF file: u to the east, v to the north and w upwards over x, y, z and, optionally, time.

    x (east), y (north) and z (up) are in metres, evenly spaced in x and y; velocities in m/s. All of that stands in the
    file's attributes, as the CF conventions have it; what is missing or something else is refused. The file must cover
    the area and, where it has times, the duration.
    """

    file: str = setting(doc="NetCDF file, classic or 4")
    u: str = setting(default="u", doc="name of the velocity to the east")
    v: str = setting(default="v", doc="name of the velocity to the north")
    w: str = setting(default="w", doc="name of the upward velocity")
    heights: Literal["ground", "origin"] = setting(
        default="ground", doc="reference of z: the ground below, or z = 0 of the local frame"
    )
    origin_north: float = setting(default=0.0, unit="m", doc="y of the file at the site's origin")
    origin_east: float = setting(default=0.0, unit="m", doc="x of the file at the site's origin")
    start: float = setting(default=0.0, unit="s", doc="time at which the run starts, from the first time in the file")
    missing: Literal["refuse", "calm"] = setting(
        default="refuse", doc="points without a velocity, as inside buildings: an error, or calm air"
    )

    def at(self, duration: float) -> WindGrid:
        """Return the wind grid for a run of ``duration`` [s], read from the file, in float64.

        Args:
            duration: length of the run [s].

        Raises:
            UsageError: no such file, no such grid, or it does not cover the run.
        """
        grid = read_grid(self.file, Layout((self.u, self.v, self.w), self.missing == "calm"))
        times = grid.times - self.start
        if len(times) > 1:
            check_covers(f"{self.file}: from start, {self.start:g} s, on it", times, duration)
        u, v, w = grid.air
        seconds, fraction = split_seconds(times)
        measures: Any = {
            "air_ned": record_of(Vec3, v, u, -w),
            "corner": (grid.y[0] - self.origin_north, grid.x[0] - self.origin_east),
            "spacing": (_step(grid.y), _step(grid.x)),
            "levels": grid.z,
        }
        return WindGrid(**measures, seconds=seconds, fraction=fraction, heights=self.heights, file=self.file).averaged()


def _step(values: NumpyArray) -> float:
    """Return the mean step between neighbouring grid coordinates."""
    return float(values[-1] - values[0]) / (len(values) - 1)
