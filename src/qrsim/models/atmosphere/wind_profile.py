"""Mean wind over height from a table: a weather model's, a forecast's or a mast's (docs/explanation/models/air.md)."""

from __future__ import annotations

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.core.fastmath import log
from qrsim.core.series import interval_at, split_seconds
from qrsim.core.tree import quantity, record, record_of, setting
from qrsim.core.vectors import Vec3
from qrsim.errors import UsageError
from qrsim.models.atmosphere.contracts import Bounds, Wind
from qrsim.models.atmosphere.wind import ROUGHNESS_M

# Of one time, because each costs each tick, and of all times together.
MOST_LEVELS, MOST_ROWS = 64, 10_000
# Up to this multiple of its height the highest level is taken without a word: a logarithmic wind grows by a tenth.
FAR_ABOVE = 2.0


@record
class ProfileTable:
    """Velocities over height at T times: a share of the lowest by the logarithm of height, and a slope in each layer.

    Heights are (1, Z) if they are constant, else (T, Z); shorter rows end with layers of no thickness.
    """

    heights: Array = quantity(unit="m", doc="(1 or T, Z) increasing heights above the ground")
    log_share: Array = quantity(unit="1", doc="(1 or T,) one over ln(lowest height / roughness)")
    lowest: tuple[Array, Array] = quantity(unit="m/s", doc="(T,) velocity to north and east at the lowest height")
    slopes: tuple[Array, Array] = quantity(unit="1/s", doc="(T, Z - 1) its change with height in each layer")

    def at(self, height: Array, logarithm: Array, row: Array | int) -> tuple[Array, Array]:
        """Return north and east wind (n,) [m/s] at heights (n,) [m] in table row ``row``, one time.

        Args:
            height: (n,) above the ground [m].
            logarithm: (n,) of height over roughness, 0 below.
            row: () number of the time.
        """
        north, east = (jnp.asarray(axis)[row] for axis in self.lowest)
        steps = [jnp.asarray(axis)[row] for axis in self.slopes]
        return self._summed(height, logarithm, row, (north, east), steps)

    def between(self, height: Array, logarithm: Array, row: Array, share: Array) -> tuple[Array, Array]:
        """Return north and east wind (n,) [m/s] at heights, ``share`` 0 to 1 of the way from ``row`` to the next."""
        if self.heights.shape[0] > 1:
            ends = self.at(height, logarithm, row), self.at(height, logarithm, row + 1)
            north, east = (before + share * (after - before) for before, after in zip(*ends, strict=True))
            return north, east

        def at(axis: Array) -> Array:
            """Return one wind component (n,), interpolated between rows ``row`` and ``row`` + 1."""
            axis = jnp.asarray(axis)
            return axis[row] + share * (axis[row + 1] - axis[row])

        north, east = (at(axis) for axis in self.lowest)
        return self._summed(height, logarithm, 0, (north, east), [at(axis) for axis in self.slopes])

    def _summed(
        self, height: Array, logarithm: Array, row: object, lowest: tuple[Array, Array], slopes: list[Array]
    ) -> tuple[Array, Array]:
        """Return north and east wind (n,) [m/s]: the lowest layer's plus the change through each layer above."""
        own = row if self.heights.shape[0] > 1 else 0
        heights, share = jnp.asarray(self.heights)[own], jnp.asarray(self.log_share)[own]
        part = jnp.minimum(logarithm * share, 1.0)
        north, east = (part * axis for axis in lowest)
        # A sum over layers needs no search for that of each vehicle, and layers are few.
        for layer in range(heights.shape[0] - 1):
            inside = jnp.clip(height - heights[layer], 0.0, heights[layer + 1] - heights[layer])
            north, east = north + slopes[0][layer] * inside, east + slopes[1][layer] * inside
        return north, east


@record
class WindProfile(Wind):
    """A wind that depends on height and time; ``ProfileRows.at`` makes it."""

    table: ProfileTable = quantity(doc="at each time")
    mean: ProfileTable = quantity(doc="mean over the run, of one row")
    roughness: Array = quantity(unit="m", doc="roughness length of the land")
    seconds: Array = quantity(unit="s", doc="(T,) int32, whole seconds since the start of the run")
    fraction: Array = quantity(unit="s", doc="(T,) the rest, in [0, 1)")

    def velocity_ned(self, height_agl: Array, seconds: Array, fraction: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at heights (n,) [m] above ground and a time; ends extend unchanged.

        It is linear in time, and in height from the lowest to the highest level. Below, its speed is that of the lowest
        level h0 times ln(h/z0)/ln(h0/z0), zero below the roughness z0.
        """
        logarithm = self._logarithm(height_agl)
        if self.seconds.shape[0] == 1:
            north, east = self.table.at(height_agl, logarithm, 0)
        else:
            rows, parts = jnp.asarray(self.seconds), jnp.asarray(self.fraction)
            row, since, interval = interval_at(rows, parts, seconds, fraction)
            north, east = self.table.between(height_agl, logarithm, row, jnp.clip(since / interval, 0.0, 1.0))
        return Vec3(north, east, jnp.zeros_like(north))

    def mean_velocity_ned(self, height_agl: Array) -> Vec3:
        """Return the wind velocity (n,) [m/s] NED at heights (n,) [m], averaged over the run."""
        north, east = self.mean.at(height_agl, self._logarithm(height_agl), 0)
        return Vec3(north, east, jnp.zeros_like(north))

    def _logarithm(self, height: Array) -> Array:
        """Return ln(height/roughness) of heights (n,) [m], at least 0."""
        return log(jnp.maximum(height / self.roughness, 1.0))

    def beyond(self, bounds: Bounds | None, top: float | None) -> list[str]:
        """Return a sentence, in a list, if the area extends far above the highest level of the data."""
        highest = float(np.min(np.max(np.asarray(self.table.heights), axis=1)))
        if top is None or top <= FAR_ABOVE * highest:
            return []
        return [f"the highest level is {highest:.6g} m above the ground; world.area reaches {top:.6g} m"]

    def at_times(self, height: NumpyArray) -> tuple[Floats, Floats]:
        """Return north and east wind (T, ...) [m/s] at heights (...) [m] at each time of the data, by NumPy."""
        height = np.asarray(height, np.float64)
        pairs = [_on_host(self.table, row, height, float(self.roughness)) for row in range(len(self.seconds))]
        return np.stack([north for north, _ in pairs]), np.stack([east for _, east in pairs])


def _on_host(table: ProfileTable, row: int, height: Floats, roughness: float) -> tuple[Floats, Floats]:
    """Return north and east wind [m/s] at heights [m] in table row ``row``, by NumPy in float64."""
    own = row if len(table.heights) > 1 else 0
    heights, share = np.asarray(table.heights, np.float64)[own], float(table.log_share[own])
    part = np.minimum(np.log(np.maximum(height / roughness, 1.0)) * share, 1.0)
    north, east = (part * float(axis[row]) for axis in table.lowest)
    for layer, (low, high) in enumerate(pairwise(heights)):
        inside = np.clip(height - low, 0.0, high - low)
        north, east = (
            sum_ + float(axis[row, layer]) * inside for sum_, axis in zip((north, east), table.slopes, strict=True)
        )
    return north, east


@record
class ProfileRows:
    """A wind over height: rows of heights, speeds and bearings, at one time or several; or a CSV file of them.

    The speed is linear between levels, and logarithmic below the lowest.
    """

    heights: Array = quantity(unit="m", doc="above the ground, of each row")
    speeds: Array = quantity(unit="m/s", doc="of each row")
    wind_from_rad: Array = quantity(unit="rad", doc="bearing the wind comes from, clockwise from north, of each row")
    times: Array = quantity(unit="s", doc="since the start of the run, of each row")
    roughness: float = setting(
        default=ROUGHNESS_M,
        unit="m",
        doc="roughness length of the land, for the wind below the lowest level",
        above=0.0,
        maximum=2.0,
    )
    source: str = setting(default="", doc="where the rows are from, for messages")

    def at(self, duration: float) -> WindProfile:
        """Return the wind profile for a run of ``duration`` [s], in float64.

        Args:
            duration: length of the run [s].

        Raises:
            UsageError: the rows are no profile, or do not cover the run.
        """
        columns = {name: np.asarray(getattr(self, name), np.float64) for name in ("heights", "speeds", "wind_from_rad")}
        count = len(columns["heights"])
        times = np.asarray(self.times, np.float64) if len(self.times) else np.zeros(count)
        for name, values in {**columns, "times": times}.items():
            if len(values) != count:
                raise UsageError(f"{name}: {len(values)} numbers; heights has {count}")
        if not 1 <= count <= MOST_ROWS:
            raise UsageError(f"heights: {count} rows; allowed: 1 to {MOST_ROWS}")
        profiles = [_profile(columns, times == time, float(self.roughness)) for time in np.unique(times)]
        known = np.unique(times)
        if len(known) > 1 and (known[0] > 0.0 or known[-1] < duration):
            raise UsageError(
                f"times: from {known[0]:g} to {known[-1]:g} s, which does not cover the run, 0 to {duration:g} s"
            )
        table = _table(profiles, self.roughness)
        seconds, fraction = split_seconds(known)
        return record_of(
            WindProfile,
            table,
            _mean(table, profiles, known, duration, self.roughness),
            np.float64(self.roughness),
            seconds,
            fraction,
        )


def _profile(columns: dict[str, Floats], rows: NumpyArray, roughness: float) -> Floats:
    """Return one time's profile (3, Z), sorted by height: heights [m], and wind to north and to east [m/s].

    Raises:
        UsageError: too many levels, two of one height, or one at the ground.
    """
    heights, speeds, bearings = (columns[name][rows] for name in ("heights", "speeds", "wind_from_rad"))
    order = np.argsort(heights)
    heights = heights[order]
    if len(heights) > MOST_LEVELS:
        raise UsageError(f"heights: {len(heights)} levels at one time; allowed: {MOST_LEVELS}")
    if heights[0] < 2.0 * roughness:
        raise UsageError(f"heights: {heights[0]:g} m; allowed: from {2.0 * roughness:g}, twice the roughness")
    if (np.diff(heights) <= 0.0).any():
        twice = heights[:-1][np.diff(heights) <= 0.0][0]
        raise UsageError(f"heights: {twice:g} m is there twice at one time")
    speeds, bearings = speeds[order], bearings[order]
    return np.stack([heights, -speeds * np.cos(bearings), -speeds * np.sin(bearings)])


def _table(profiles: list[Floats], roughness: float) -> ProfileTable:
    """Return profiles (3, Z) of different times, perhaps with different Z, as one table."""
    most = max(profile.shape[1] for profile in profiles)
    padded = np.stack([np.pad(each, ((0, 0), (0, most - each.shape[1])), mode="edge") for each in profiles])
    heights, north, east = padded[:, 0], padded[:, 1], padded[:, 2]
    if (heights == heights[0]).all():
        heights = heights[:1]
    thick = np.diff(heights, axis=1)
    slopes = [np.diff(axis, axis=1) / np.where(thick > 0.0, thick, np.inf) for axis in (north, east)]
    share = 1.0 / np.log(heights[:, 0] / roughness)
    lowest = (np.ascontiguousarray(north[:, 0]), np.ascontiguousarray(east[:, 0]))
    return record_of(ProfileTable, heights, share, lowest, tuple(map(np.ascontiguousarray, slopes)))


def _mean(
    table: ProfileTable, profiles: list[Floats], times: Floats, duration: float, roughness: float
) -> ProfileTable:
    """Return the wind averaged over the run as a table, exact at the levels of all times if these are not too many."""
    heights = np.unique(np.concatenate([profile[0] for profile in profiles]))
    if len(heights) > MOST_LEVELS:
        heights = heights[np.unique(np.linspace(0, len(heights) - 1, MOST_LEVELS).astype(int))]
    pairs = [_on_host(table, row, heights, roughness) for row in range(len(times))]
    # The run's own part of the times, by trapezoids, as velocities are linear between two times.
    inside = times[(times > 0.0) & (times < duration)]
    knots = np.unique(np.concatenate([[0.0], inside, [duration]])) if len(times) > 1 else times
    means = []
    for axis in range(2):
        series = np.stack([pair[axis] for pair in pairs])
        at = np.stack([np.interp(knots, times, series[:, level]) for level in range(len(heights))], axis=1)
        means.append(np.trapezoid(at, knots, axis=0) / (knots[-1] - knots[0]) if len(knots) > 1 else at[0])
    return _table([np.stack([heights, *means])], roughness)
