"""Gusts against the closed forms of MIL-F-8785C: this project's series, densities, and their comparison."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw, Key
from qrsim.core.tree import cast, record_of
from qrsim.core.vectors import Vec3
from qrsim.files import Content
from qrsim.models.atmosphere.dryden import Dryden, DrydenState
from qrsim.studies.validate.published import dryden_scales
from qrsim.studies.validate.statistics import against

DT = 0.02
SPAN = 2.0
SEVERITY = 3
SEGMENT = 4096
VEHICLES = 16
COMPONENTS = ("u", "v", "w", "q", "r")
# Of third octaves [rad/s], as far as omega T = 1.
LOWEST_OMEGA, BANDS = 0.25, 23


class Case(NamedTuple):
    """Height [m], airspeed [m/s] and wind 20 ft above the ground [m/s]; gusts are small against the airspeed.

    JSBSim's airspeed includes the gusts, so that large ones would move its own time constants about.
    """

    height: float
    airspeed: float
    speed_20ft: float


CASES = {"low": Case(15.24, 20.0, 0.5), "middle": Case(152.4, 30.0, 0.5), "high": Case(914.4, 75.0, 0.5)}

# A body without forces; JSBSim takes the span of the angular gusts from it.


@partial(jax.jit, static_argnums=1)
def _simulate_series(turbulence: Dryden, steps: int, key: Key, height: jax.Array, airspeed: jax.Array) -> jax.Array:
    """Simulate gusts u, v, w and gust rates q, r (steps, 5, vehicles) of the Dryden component."""
    ids, zero = jnp.arange(height.size, dtype=jnp.uint32), jnp.zeros_like(height)
    like = jnp.zeros((), height.dtype)
    stream, still = key.stream("gust", ids), Vec3(zero, zero, zero)

    def tick(state: DrydenState, now: jax.Array) -> tuple[DrydenState, jax.Array]:
        """Advance the turbulence by one tick; return its state, and u, v, w, q, r."""
        state = turbulence.step(state, Draw(stream, now, like), height, Vec3(airspeed, zero, zero), still, DT)
        gust, rates = turbulence.gust_ned(state, height), turbulence.gust_rates_ned(state, height)
        return state, jnp.stack([gust.x, gust.y, gust.z, rates.y, rates.z])

    start = turbulence.init(Draw(key.stream("start", ids), jnp.uint32(0), like))
    return jax.lax.scan(tick, start, jnp.arange(steps, dtype=jnp.uint32))[1]


def our_series(case: Case, steps: int, seed: int) -> Floats:
    """Simulate gusts u, v, w [m/s] and q, r [rad/s] (5, VEHICLES, steps / VEHICLES) by qrsim's float32 Dryden."""
    # With the wind from the south, wind axes are north, east and down.
    turbulence = cast(record_of(Dryden, case.speed_20ft, math.pi, SPAN, SEVERITY), np.float32)
    like = np.ones(VEHICLES, np.float32)
    series = _simulate_series(turbulence, steps // VEHICLES, Key.root(seed), case.height * like, case.airspeed * like)
    return np.moveaxis(np.asarray(series, np.float64), 0, -1)


def scales(case: Case) -> tuple[Floats, Floats]:
    """Return length scales [m] and standard deviations [m/s] of u, v, w, each (3,), by the standard."""
    return dryden_scales(case.height, case.speed_20ft)


def closed_form(case: Case, omega: Floats) -> Floats:
    """Return the two-sided densities (5, k) of MIL-F-8785C at frequencies (k,); over 2 pi they
    integrate to variances."""
    lengths, sigmas = scales(case)
    tau, variance = (lengths / case.airspeed)[:, None], np.square(sigmas)[:, None]
    square = np.square(omega * tau)
    u = 2.0 * variance[0] * tau[0] / (1.0 + square[0])
    v, w = (variance * tau * (1.0 + 3.0 * square) / np.square(1.0 + square))[1:]
    q, r = (
        np.square(omega / case.airspeed) / (1.0 + np.square(omega * spans * SPAN / (math.pi * case.airspeed))) * gust
        for spans, gust in ((4.0, w), (3.0, v))
    )
    return np.stack([u, v, w, q, r])


def sampled_closed_form(case: Case, omega: Floats) -> Floats:
    """Return the densities (5, k) of the closed form sampled every DT: a sum over aliases, the far ones integrated."""
    images, folded = 20, 2.0 * math.pi / DT
    total = sum(closed_form(case, omega + folded * image) for image in range(-images, images + 1))
    edge = folded * (images + 0.5)
    return np.asarray(total + 2.0 * closed_form(case, np.array([edge])) * edge / folded)


def welch(series: Floats) -> tuple[Floats, Floats]:
    """Estimate two-sided densities (5, k) of series (5, ..., steps); return frequencies > 0 [rad/s] and densities."""
    frequency, density = scipy.signal.welch(
        series, 1.0 / DT, nperseg=min(SEGMENT, series.shape[-1]), detrend=False, axis=-1
    )
    density = density.reshape(len(COMPONENTS), -1, frequency.size).mean(axis=1) / 2.0
    return 2.0 * math.pi * frequency[1:-1], density[:, 1:-1]


def band_levels(omega: Floats, density: Floats) -> Floats:
    """Average densities (5, k) over third-octave bands up to omega T = 1; return (5, BANDS)."""
    edges = LOWEST_OMEGA * 10.0 ** (0.1 * np.arange(BANDS + 1))
    inside = [(omega >= low) & (omega < high) for low, high in itertools.pairwise(edges)]
    return np.stack([density[:, band].mean(axis=1) for band in inside], axis=1)


def compare(series: Floats, theory: Callable[[Floats], Floats], case: Case) -> tuple[Content, Floats]:
    """Compare simulated gusts with theory: return statistics, and levels over the closed form [dB] (5, BANDS).

    Args:
        series: (5, ..., steps).
        theory: densities (5, k) of the source at frequencies (k,).
        case: where it was taken.
    """
    circle = 2.0 * math.pi / DT * np.arange(2**16) / 2**16
    signed = (circle + math.pi / DT) % (2.0 * math.pi / DT) - math.pi / DT
    density, target = theory(signed), sampled_closed_form(case, signed)
    omega, estimate = welch(series)
    levels = band_levels(omega, estimate)
    over_theory, over_closed = (
        10.0 * np.log10(levels / band_levels(omega, form(omega))) for form in (theory, partial(closed_form, case))
    )
    results: dict[str, object] = {}
    for i, name in enumerate(COMPONENTS):
        expected, wanted = float(np.mean(density[i]) / DT), float(np.mean(target[i]) / DT)
        # The variance of a mean of squares is 2/n times the sum of squared autocovariances (Parseval).
        error = math.sqrt(2.0 * np.mean(np.square(density[i] / DT)) / series[i].size)
        variance = float(np.mean(np.square(series[i])))
        results[name] = {
            "variance": against(variance, expected, error),
            "over_closed_form": variance / wanted,
            "expected_over_closed_form": expected / wanted,
            "rms_db_from_own_theory": float(np.sqrt(np.mean(np.square(over_theory[i])))),
            "largest_db_from_closed_form": float(np.max(np.abs(over_closed[i]))),
        }
    return results, over_closed
