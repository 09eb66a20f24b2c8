"""A recorded path: position and heading over time from a CSV file, smooth between its rows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.series import interval_at, split_seconds
from qrsim.core.tree import quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.files.time_series import check_covers, read_series

AXES = ("north", "east", "down")
HEADING = "heading_deg"


@record
class PathFile:
    """A path in a CSV file with the columns time [s], north, east, down [m] and, if it turns, heading_deg."""

    file: str | None = setting(
        default=None, doc="CSV file with a header, in which time 0 is the start of the run; none: no path"
    )
    max_gap: float = setting(
        default=10.0, unit="s", doc="longest interval between two rows that is interpolated", above=0.0
    )

    def at(self, duration: float) -> RecordedPath:
        """Return the path for a run of ``duration`` [s], read from the file, in float64.

        Args:
            duration: length of the run [s], which the path must cover from 0 on.

        Raises:
            UsageError: the file is missing, is no such table, has a gap, or does not cover the run.
        """
        times, columns = read_series(Path(str(self.file)), dict.fromkeys(AXES, "m"), self.max_gap, {HEADING: "deg"})
        check_covers(f"{self.file}: the path", times, duration)
        # Imported here, because few flights need it.
        from scipy.interpolate import CubicSpline

        turned = np.unwrap(np.radians(columns.get(HEADING, np.zeros_like(times))))
        values = np.stack([*(columns[axis] for axis in AXES), turned])
        # A spline, so that accelerations are continuous; of two rows it is a straight line.
        slopes = CubicSpline(times, values, axis=1)(times, 1)
        parts: Any = (Vec3(*values[:3]), Vec3(*slopes[:3]), values[3], slopes[3])
        return RecordedPath(*split_seconds(times), *parts)


@record
class Place:
    """A point of a path, each ()."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity")
    heading: Array = quantity(unit="rad", doc="heading")
    turn_rate: Array = quantity(unit="rad/s", doc="rate of the heading")


@record
class RecordedPath:
    """Position and heading at K increasing times: a cubic spline, kept as its values and slopes at the rows.

    Times are whole seconds plus a fraction, because a float32 of a day's seconds would be 8 ms off.
    """

    seconds: Array = quantity(unit="s", doc="(K,) int32, whole seconds since the start of the run")
    fraction: Array = quantity(unit="s", doc="(K,) the rest, in [0, 1)")
    position_ned: Vec3 = quantity(unit="m", doc="(K,) position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="(K,) slope of the position")
    heading: Array = quantity(unit="rad", doc="(K,) heading, turns counted")
    turn_rate: Array = quantity(unit="rad/s", doc="(K,) its slope")

    def carried(self, position_ned: list[float]) -> Iterator[tuple[float, list[float], float]]:
        """Yield time, position and speed of a point fixed to the path's carrier, at each row from time 0 on.

        Args:
            position_ned: of the point at time 0 (3,) [m]; its offset from the path turns with the heading.

        Yields:
            Time [s], position NED (3,) [m] and speed [m/s].
        """
        times = self.seconds + np.asarray(self.fraction)
        values = np.stack([*jax.tree.leaves(self.position_ned), self.heading])
        slopes = np.stack([*jax.tree.leaves(self.velocity_ned), self.turn_rate])
        start = np.array([np.interp(0.0, times, row) for row in values])
        offset = np.asarray(position_ned, np.float64) - start[:3]
        cosine, sine = np.cos(values[3] - start[3]), np.sin(values[3] - start[3])
        turned = np.stack([cosine * offset[0] - sine * offset[1], sine * offset[0] + cosine * offset[1]])
        # v + ω × r, with ω along the down axis.
        velocity = np.stack([slopes[0] - slopes[3] * turned[1], slopes[1] + slopes[3] * turned[0], slopes[2]])
        place = values[:3] + np.stack([*turned, np.full_like(times, offset[2])])
        speeds = np.linalg.norm(velocity, axis=0)
        for i in np.flatnonzero(times >= 0.0):
            yield float(times[i]), place[:, i].tolist(), float(speeds[i])

    def at(self, seconds: Array, fraction: Array) -> Place:
        """Return position, heading and velocity on the path at a time [s]; before and after it, its ends at rest."""
        rows, parts = jnp.asarray(self.seconds), jnp.asarray(self.fraction)
        before, since, interval = interval_at(rows, parts, seconds, fraction)
        along = since / interval
        s = jnp.clip(along, 0.0, 1.0)
        moves = jnp.where((along >= 0.0) & (along <= 1.0), 1.0, 0.0).astype(s.dtype)

        def cubic(values: Array, slopes: Array) -> tuple[Array, Array]:
            """Return value and slope of the Hermite cubic between two samples of the path."""
            values, slopes = jnp.asarray(values), jnp.asarray(slopes)
            start, way = values[before], values[before + 1] - values[before]
            first, second = slopes[before] * interval, slopes[before + 1] * interval
            value = start + s * (first + s * (3.0 * way - 2.0 * first - second + s * (first + second - 2.0 * way)))
            slope = first + s * (2.0 * (3.0 * way - 2.0 * first - second) + s * 3.0 * (first + second - 2.0 * way))
            return value, moves * slope / interval

        found = [cubic(getattr(self.position_ned, axis), getattr(self.velocity_ned, axis)) for axis in "xyz"]
        heading, turn_rate = cubic(self.heading, self.turn_rate)
        return Place(Vec3(*(p for p, _ in found)), Vec3(*(v for _, v in found)), heading, turn_rate)
