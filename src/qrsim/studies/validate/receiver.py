"""A stationary receiver: the recorded one, and many simulated ones."""

from __future__ import annotations

import math
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from qrsim.core.allan import overlapping_allan_deviation
from qrsim.core.arrays import Floats
from qrsim.core.clock import split_time
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.engine.settings import quick_jit
from qrsim.models.gnss.receivers import GnssReceiver, SharedSky
from qrsim.models.gnss.sp3 import Sp3Ephemeris
from qrsim.models.site import Site, gps_seconds_from_utc
from qrsim.studies.validate.published import MASK_DEG, RANGE_NOISE_STD, RangeErrors
from qrsim.studies.validate.recorded import read_table

# The day of the recording.
SEED = 20110308
PERIOD = 0.2
# Of a satellite's number, which other streams must not share.
LIKE = np.float32


class Recorded(NamedTuple):
    """The recording in the NED frame of its own median.

    Attributes:
        position_ned: (T, 3) [m].
        period: between rows [s].
        site: the median position.
        satellites: fewest and most that were used.
    """

    position_ned: Floats
    period: float
    site: Site
    satellites: tuple[int, int]


def recorded_receiver(path: Path) -> Recorded:
    """Read the public recording of a stationary GNSS receiver."""
    rows = read_table(path, 14)
    latitude, longitude, height = np.radians(rows[:, 3] * 1e-7), np.radians(rows[:, 4] * 1e-7), rows[:, 5] * 1e-3
    at = [float(np.median(column)) for column in (latitude, longitude, height)]
    site = Site(at[0], at[1], at[2])
    used = rows[:, 12].astype(int)
    return Recorded(site.geodetic_to_ned(latitude, longitude, height), 0.4, site, (int(used.min()), int(used.max())))


def sky_over(path: Path, site: Site, start: datetime, duration_s: float, errors: Any) -> SharedSky:
    """Build the sky over a site from ``start`` on, by an SP3 file's orbits and range ``errors``, in float32."""
    ephemeris = Sp3Ephemeris(str(path))
    orbits = ephemeris.at(site, gps_seconds_from_utc(start), LIKE, duration_s)
    return SharedSky(orbits, cast(errors, LIKE), jnp.asarray(ephemeris.satellite_ids), PERIOD)


@partial(quick_jit, static_argnames=("ticks", "seeds"))
def _simulate_fixes(sky: SharedSky, receiver: GnssReceiver, ticks: int, seeds: int) -> tuple[jax.Array, jax.Array]:
    """Simulate GNSS receivers at rest; return positions (T, seeds, 3) NED [m] and satellites used (T, seeds)."""
    like = jnp.zeros((), LIKE)
    still = Vec3.zeros((1,), jnp.dtype(LIKE))

    def one(world: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Simulate the fixes of one world's receiver: positions (T, 3) [m] and satellites used (T,)."""
        key = Key.root(SEED, world)
        names = ("sky start", "receiver start", "sky", "receiver")
        ids = (sky.ids, jnp.zeros(1, jnp.uint32)) * 2
        first_sky, first_fix, later_sky, later_fix = (key.stream(n, i) for n, i in zip(names, ids, strict=True))
        start = sky.init(Draw(first_sky, jnp.uint32(0), like))
        memory, reading = receiver.init(Draw(first_fix, jnp.uint32(0), like), still, still, start)

        def tick(carry: Any, now: jax.Array) -> Any:
            """Advance sky and receiver by one period; return their states, and position and satellites used."""
            state, memory = carry
            seconds, fraction = split_time(now, PERIOD, LIKE)
            state = sky.step(state, Draw(later_sky, now, like), seconds, fraction)
            memory, reading = receiver.step(memory, Draw(later_fix, now, like), still, still, state)
            return (state, memory), (reading.position_ned.stack()[0], reading.satellites[0])

        _, (positions, used) = jax.lax.scan(tick, (start, memory), jnp.arange(1, ticks, dtype=jnp.uint32))
        first = (reading.position_ned.stack(), reading.satellites)
        return jnp.concatenate([first[0], positions]), jnp.concatenate([first[1], used])

    return jax.vmap(one)(jnp.arange(seeds, dtype=jnp.uint32))


def simulated_receivers(sky: SharedSky, rows: int, every: int, seeds: int) -> tuple[Floats, tuple[int, int]]:
    """Simulate receivers at rest; return position errors (rows, seeds, 3) [m], and (least, most) satellites used.

    Args:
        sky: shared by nobody: each seed has one of its own with the same geometry.
        rows: to keep.
        every: keep one fix of so many.
        seeds: how many.
    """
    receiver = cast(GnssReceiver(), LIKE)
    positions, used = _simulate_fixes(sky, receiver, (rows - 1) * every + 1, seeds)
    found = np.asarray(used)
    return np.moveaxis(np.asarray(positions, np.float64)[:, ::every], 0, 1), (int(found.min()), int(found.max()))


def dilution(sky: SharedSky) -> Floats:
    """Return variances (3,) of north, east and down for a range variance of 1, from the geometry at the start."""
    satellites = np.asarray(sky.orbits.positions_ned(jnp.int32(0), jnp.zeros((), LIKE)).stack(), np.float64)
    rays = satellites / np.linalg.norm(satellites, axis=1, keepdims=True)
    seen = rays[-rays[:, 2] > math.sin(math.radians(MASK_DEG))]
    design = np.column_stack([seen, np.ones(len(seen))])
    return np.asarray(np.diag(np.linalg.inv(design.T @ design))[:3])


def sampled_allan_variance(autocovariance: Floats, length: int) -> float:
    """Return the exact Allan variance of a process with this autocovariance, over windows of ``length`` samples.

    Args:
        autocovariance: (at least 2 length,) at lags of 0, 1, 2, ... samples.
        length: of a window, in samples.
    """
    weights = np.repeat([-1.0 / length, 1.0 / length], length)
    return float(0.5 * weights @ scipy.linalg.toeplitz(autocovariance[: 2 * length]) @ weights)


def range_autocovariance(errors: RangeErrors, period: float, count: int) -> Floats:
    """Return the autocovariance (count,) [m^2] of one satellite's range: its errors and receiver noise."""
    found = np.array(errors.autocovariance(period * np.arange(count)))
    found[0] += RANGE_NOISE_STD**2
    return found


def allan_deviations(positions: Floats, period: float, lengths: Floats) -> Floats:
    """Return overlapping Allan deviations (K, ...) of positions (T, ...) over windows of ``lengths`` (K,) rows."""
    return overlapping_allan_deviation(positions, period, lengths)[1]
