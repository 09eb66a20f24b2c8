"""Quantities of plots that logs do not hold: computed from true states, estimates and set-points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.tree import record_of
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Area

# Names of quantities that events of stops have values for.
FENCE, NEAREST, CHARGE = "derived.fence_distance", "derived.nearest_vehicle", "truth.battery.charge"
# Differences between vehicles that are computed at once; of more, fewer ticks are used.
MOST_PAIRS = 60_000_000
PAIRS_AT_ONCE = 4_000_000

# Returns a logged column (T, n) at the ticks of the true states.
Read = Callable[[str], Floats]


@dataclass(frozen=True)
class Derived:
    """A derived quantity.

    Attributes:
        name: of it.
        unit: SI unit.
        doc: one sentence.
        needs: logged columns, STREAM.COLUMN.
        compute: returns it (T, n) from these.
    """

    name: str
    unit: str
    doc: str
    needs: tuple[str, ...]
    compute: Callable[[Read], Floats]


def axes(name: str) -> tuple[str, ...]:
    """Return the column names of a vector's three components: ``name`` with .x, .y and .z."""
    return tuple(f"{name}.{axis}" for axis in "xyz")


TRUE, ESTIMATE, STD = (
    axes("truth.position_ned"),
    axes("commands.estimate.position_ned"),
    axes("commands.estimate_std.position_ned"),
)
SETPOINT, VELOCITY = axes("commands.setpoint.position_ned"), axes("truth.velocity_body")
MEAN, GUST = axes("wind.mean_ned"), axes("wind.gust_ned")


def vector(read: Read, names: tuple[str, ...]) -> Floats:
    """Return logged columns of these names, stacked as (T, n, k); ``read`` returns the column (T, n) of a name."""
    return np.stack([read(name) for name in names], axis=-1)


def _length(values: Floats) -> Floats:
    """Return the lengths (T, n) of vectors (T, n, k)."""
    return np.asarray(np.sqrt(np.einsum("tnk,tnk->tn", values, values)))


def _beyond(read: Read) -> Floats:
    """Return the position estimate's error (T, n) on its worst axis, in reported standard deviations, or NaN."""
    return in_sigmas(vector(read, ESTIMATE) - vector(read, TRUE), vector(read, STD))


def in_sigmas(error: Floats, std: Floats) -> Floats:
    """Return errors (..., 3) on their worst axis, in standard deviations ``std`` (..., 3); NaN if one is 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(std > 0.0, np.abs(error) / std, np.nan).max(axis=-1))


ALWAYS = (
    Derived("height", "m", "height over the origin, positive up", TRUE[2:], lambda read: -read(TRUE[2])),
    Derived("speed", "m/s", "speed over ground", VELOCITY, lambda read: _length(vector(read, VELOCITY))),
    Derived(
        "estimate_error",
        "m",
        "distance between the estimated and the true position",
        (*ESTIMATE, *TRUE),
        lambda read: _length(vector(read, ESTIMATE) - vector(read, TRUE)),
    ),
    Derived(
        "estimate_error_sigmas",
        "1",
        "error of the estimated position on its worst axis in sigma (standard deviations); the 95 % band ends at 1.96",
        (*ESTIMATE, *STD, *TRUE),
        _beyond,
    ),
    Derived(
        "setpoint_distance",
        "m",
        "distance between the true position and the set-point",
        (*SETPOINT, *TRUE),
        lambda read: _length(vector(read, SETPOINT) - vector(read, TRUE)),
    ),
    Derived(
        "wind_speed",
        "m/s",
        "speed of mean wind and gusts together at the vehicle",
        (*MEAN, *GUST),
        lambda read: _length(vector(read, MEAN) + vector(read, GUST)),
    ),
    Derived(
        "nearest_vehicle",
        "m",
        "separation: distance to the nearest vehicle of the same run, while both fly",
        TRUE,
        lambda read: nearest(vector(read, TRUE)),
    ),
)


def nearest(places: Floats) -> Floats:
    """Return the distance (T, n) [m] to each vehicle's nearest other one, from positions (T, n, 3); NaN if alone."""
    ticks, count, _ = places.shape
    found = np.full((ticks, count), np.nan, np.float32)
    if count < 2 or not ticks:
        return found
    # In between the last one holds.
    stride = _stride(ticks, count)
    apart = np.concatenate([np.sqrt(squared.min(axis=2)) for squared in _squared(places[::stride])])
    apart[~np.isfinite(apart)] = np.nan
    return np.repeat(apart, stride, axis=0)[:ticks]


def closest_pairs(places: Floats, most: int) -> list[tuple[float, int, int, int]]:
    """Return (distance [m], tick, number, number) of the pairs that came closest to each other, at most ``most``.

    Args:
        places: (T, n, 3) positions [m]; NaN: the vehicle does not count.
        most: number of pairs.
    """
    ticks, count, _ = places.shape
    stride, first = _stride(ticks, count), 0
    best, row = np.full((count, count), np.inf, np.float32), np.zeros((count, count), np.int64)
    for squared in _squared(places[::stride]):
        lowest = squared.min(axis=0)
        closer = lowest < best
        row[closer] = first + squared.argmin(axis=0)[closer]
        best[closer] = lowest[closer]
        first += len(squared)
    pairs = np.argwhere(np.isfinite(best) & ~np.tri(count, dtype=bool))
    order = np.argsort(best[tuple(pairs.T)], kind="stable")[:most]
    return [(float(np.sqrt(best[i, j])), int(row[i, j]) * stride, i, j) for i, j in pairs[order].tolist()]


def _stride(ticks: int, count: int) -> int:
    """Return how many ticks apart the distances between all pairs of ``count`` vehicles are computed."""
    return max(1, -(-ticks * count * count // MOST_PAIRS))


def _squared(places: Floats) -> Iterator[Floats]:
    """Yield squared distances (t, n, n) [m^2] of some ticks at once, from positions (T, n, 3) [m].

    They are infinite where a position is unknown, and from a vehicle to itself.
    """
    count = places.shape[1]
    part = max(1, PAIRS_AT_ONCE // max(1, count) ** 2)
    for first in range(0, len(places), part):
        own = places[first : first + part].astype(np.float32)
        squared = sum((own[:, :, None, axis] - own[:, None, :, axis]) ** 2 for axis in range(3))
        squared = np.where(np.isfinite(squared), squared, np.float32(np.inf))
        squared[:, np.arange(count), np.arange(count)] = np.inf
        yield squared


def distance_to(vehicle: str, number: int) -> Derived:
    """Return the quantity "distance to this vehicle" [m] of all others; ``number``: of it among the run's vehicles."""

    def compute(read: Read) -> Floats:
        """Compute the distances (T, n) [m] to the vehicle; NaN to itself."""
        places = vector(read, TRUE)
        found = _length(places - places[:, number, None])
        found[:, number] = np.nan
        return found

    return Derived(
        f"distance_to.{vehicle}",
        "m",
        f"separation: distance to {vehicle} of the same run, while both fly",
        TRUE,
        compute,
    )


def to_fence(area: Area) -> Derived:
    """Return the quantity "distance to the nearest side or the ceiling" [m] of a flight area, negative outside."""

    def compute(read: Read) -> Floats:
        """Compute the smaller of the distances (T, n) [m] to the area's sides and to its ceiling."""
        columns = [read(name) for name in TRUE]
        places = record_of(Vec3, *(np.ravel(column).astype(np.float32) for column in columns))
        sides, ceiling, _ = area.clearances(places)
        return np.asarray(np.minimum(sides, ceiling)).reshape(columns[0].shape)

    return Derived(
        "fence_distance",
        "m",
        "distance to the nearest side or the ceiling of the area, negative outside",
        TRUE,
        compute,
    )


def gnss_error(sensor: str) -> Derived:
    """Return the quantity "horizontal error [m] of the position that this GNSS receiver reports"."""
    names = axes(f"measurements.{sensor}.position_ned")[:2]
    return Derived(
        f"{sensor}_error",
        "m",
        f"horizontal distance between the position that {sensor} reports and the true one",
        (*names, *TRUE[:2]),
        lambda read: _length(vector(read, names) - vector(read, TRUE[:2])),
    )
