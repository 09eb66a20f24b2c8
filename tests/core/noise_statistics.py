"""How good the random draws and the Ornstein-Uhlenbeck processes are.

Each statistic is compared with its exact expectation and has a two-sided p-value. Over one family of K
statistics the hypothesis "the draws are what they claim to be" is rejected where the smallest p-value is below
(1 - CONFIDENCE)/K (Bonferroni).
"""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from qrsim.core.arrays import Floats
from qrsim.core.noise import Key, Stream, ou_decay, ou_step
from qrsim.studies.validate.statistics import Statistic, against, family_summary

SEED = 20140914

STREAMS = ("process", "gust", "gyroscope", "accelerometer")
WORLDS = (0, 1, 2, 2**31)
SEEDS = (SEED, SEED + 1, SEED + 2**32)


@partial(jax.jit, static_argnames=("ticks", "count"))
def _normals(stream: Stream, ticks: int, count: int) -> jax.Array:
    def at(tick: jax.Array) -> jax.Array:
        return jnp.stack(stream.normals(tick, count, jnp.dtype(jnp.float32)))

    return jax.vmap(at, out_axes=1)(jnp.arange(ticks, dtype=jnp.uint32))


def draw(name: str, shape: tuple[int, int, int], seed: int = SEED, world: int = 0) -> Floats:
    """Return float32 standard normals of shape (draws per tick, ticks, vehicles)."""
    count, ticks, vehicles = shape
    return np.asarray(
        _normals(Key.root(seed, world).stream(name, jnp.arange(vehicles, dtype=jnp.uint32)), ticks, count)
    )


def moments(x: Floats) -> dict[str, Statistic]:
    """Return the first four moments about zero and the mass beyond 3, which are known for a standard normal."""
    x = x.reshape(-1).astype(np.float64)
    n, square = x.size, x * x
    tail = math.erfc(3.0 / math.sqrt(2.0))
    return {
        "mean": against(np.mean(x), 0.0, math.sqrt(1.0 / n)),
        "variance": against(np.mean(square), 1.0, math.sqrt(2.0 / n)),
        "skewness": against(np.mean(square * x), 0.0, math.sqrt(15.0 / n)),
        "kurtosis": against(np.mean(square * square), 3.0, math.sqrt(96.0 / n)),
        "beyond_3": against(np.mean(square > 9.0), tail, math.sqrt(tail * (1.0 - tail) / n)),
    }


def kolmogorov_smirnov(x: Floats) -> Statistic:
    """Return the largest distance of the empirical distribution from N(0, 1), with its asymptotic p-value."""
    found = scipy.stats.kstest(x.reshape(-1).astype(np.float64), "norm", method="asymp")
    return {"value": float(found.statistic), "p": float(found.pvalue)}


def correlation(x: Floats, y: Floats) -> dict[str, Statistic]:
    """Return the correlation of two sets of standard normals, and that of their squares.

    Squares see a shared magnitude that the plain correlation misses. Mean and variance are known, so that the
    mean product has a standard error of exactly 1/sqrt(n).
    """
    x, y = x.astype(np.float64), y.astype(np.float64)
    error = 1.0 / math.sqrt(x.size)
    return {
        "linear": against(np.mean(x * y), 0.0, error),
        "squares": against(np.mean((x * x - 1.0) * (y * y - 1.0)) / 2.0, 0.0, error),
    }


def _pairs(sets: dict[str, Floats]) -> dict[str, dict[str, Statistic]]:
    return {f"{a}_{b}": correlation(sets[a], sets[b]) for a, b in itertools.combinations(sets, 2)}


def normals(shape: tuple[int, int, int]) -> dict[str, Any]:
    """Return the statistics of draws of the given shape (draws per tick, ticks, vehicles)."""
    base = draw(STREAMS[0], shape)
    streams = {STREAMS[0]: base} | {name: draw(name, shape) for name in STREAMS[1:]}
    worlds = {"0": base} | {str(world): draw(STREAMS[0], shape, world=world) for world in WORLDS[1:]}
    seeds = {"first": base} | {
        name: draw(STREAMS[0], shape, seed) for name, seed in zip(("next", "high_word"), SEEDS[1:], strict=True)
    }
    everything = np.concatenate(
        [base, *list(streams.values())[1:], *list(worlds.values())[1:], *list(seeds.values())[1:]]
    )
    tests: dict[str, Any] = {
        "moments": moments(everything),
        "kolmogorov_smirnov": {
            "all": kolmogorov_smirnov(everything),
            "cosine_output": kolmogorov_smirnov(base[0::2]),
            "sine_output": kolmogorov_smirnov(base[1::2]),
        },
        "ticks": {f"lag_{lag}": correlation(base[:, lag:], base[:, :-lag]) for lag in (1, 2, 3, 5, 10, 50)},
        "vehicles": {f"apart_{step}": correlation(base[..., step:], base[..., :-step]) for step in (1, 2, 8, 32)},
        "box_muller": {"same_pair": correlation(base[0::2], base[1::2])},
        "pairs": {"next": correlation(base[:-2], base[2:])},
        "streams": _pairs(streams),
        "worlds": _pairs(worlds),
        "seeds": _pairs(seeds),
    }
    return {"draws": int(everything.size), **family_summary(tests), **tests}


@partial(jax.jit, static_argnames=("steps",))
def _ou_path(stream: Stream, start: jax.Array, steps: int, dt: float, std: float, tau: float) -> jax.Array:
    def tick(value: jax.Array, now: jax.Array) -> tuple[jax.Array, jax.Array]:
        normal = stream.normals(now, 1, value.dtype)[0]
        value = ou_step(value, normal, dt, jnp.asarray(std, value.dtype), jnp.asarray(tau, value.dtype))
        return value, value

    return jax.lax.scan(tick, start, jnp.arange(steps, dtype=jnp.uint32))[1]


def allan_variance(std: float, tau: float, window: float) -> float:
    """Return the Allan variance of averages over ``window`` seconds (docs/explanation/models/sensors.md)."""
    m = window / tau
    return std**2 / m**2 * (2.0 * m - 3.0 + 4.0 * math.exp(-m) - math.exp(-2.0 * m))


def _over_processes(estimates: Floats, expected: float) -> Statistic:
    """Compare the mean of one estimate per independent process, with the standard error seen between them."""
    return against(np.mean(estimates), expected, float(np.std(estimates, ddof=1)) / math.sqrt(estimates.size))


def ornstein_uhlenbeck(processes: int, steps: int) -> dict[str, Any]:
    """Return the statistics of independent processes that start from their stationary distribution.

    Each has tau = 3 s, sigma = 2.5 and a step of tau/100, in float32; ``steps`` is a multiple of 500.
    """
    std, tau, per_tau = 2.5, 3.0, 100
    dt = tau / per_tau
    ids = jnp.arange(processes, dtype=jnp.uint32)
    key = Key.root(SEED)
    start = std * key.stream("start", ids).normals(jnp.uint32(0), 1, jnp.dtype(jnp.float32))[0]
    path = np.asarray(_ou_path(key.stream("stationary", ids), start, steps, dt, std, tau), np.float64)
    released = jnp.full(processes, 2.0 * std, jnp.float32)
    relaxing = np.asarray(_ou_path(key.stream("relaxing", ids), released, 2 * per_tau, dt, std, tau), np.float64)

    def window_estimates(length: int) -> Floats:
        averages = path[: steps // length * length].reshape(-1, length, processes).mean(axis=1)
        return np.asarray(0.5 * np.mean(np.square(np.diff(averages, axis=0)), axis=0))

    lags = {"tau_0_1": 10, "tau_0_5": 50, "tau_1": 100, "tau_2": 200}
    decay = {name: math.exp(-lag / per_tau) for name, lag in lags.items()}
    windows = {"tau_0_5": 50, "tau_1": 100, "tau_2": 200, "tau_5": 500}
    spread = std**2 * math.sqrt(2.0 / processes)
    tests: dict[str, Any] = {
        "variance": {
            "all": _over_processes(np.mean(np.square(path), axis=0), std**2),
            "first": against(np.mean(np.square(path[0])), std**2, spread),
            "last": against(np.mean(np.square(path[-1])), std**2, spread),
        },
        "autocovariance": {
            name: _over_processes(np.mean(path[lag:] * path[:-lag], axis=0), std**2 * decay[name])
            for name, lag in lags.items()
        },
        "conditional_mean": {
            name: against(
                np.mean(relaxing[lag - 1]),
                2.0 * std * decay[name],
                std * math.sqrt((1.0 - decay[name] ** 2) / processes),
            )
            for name, lag in lags.items()
        },
        "allan_variance": {
            name: _over_processes(window_estimates(length), allan_variance(std, tau, length * dt))
            for name, length in windows.items()
        },
    }
    return {
        "draws": int(path.size + relaxing.size),
        **family_summary(tests),
        "stationary_std": math.sqrt(tests["variance"]["all"]["value"]),
        "expected_std": std,
        **tests,
    }


def decay_precision(points: int = 20001) -> dict[str, Any]:
    """Return the largest relative errors of ``ou_decay`` for dt/tau from 1e-6 to 10, against NumPy in float64.

    ``spread`` is sqrt(1 - a^2), ``spread_plain`` the same without the series, and ``stationary_std`` the error of
    the standard deviation that the rounded pair settles at, spread/sqrt(1 - a^2), for dt/tau of 1e-5 and more.
    """
    dt = 0.02
    results: dict[str, Any] = {}
    for precision in ("float32", "float64"):
        with jax.enable_x64(precision == "float64"):
            tau = jnp.asarray(dt / np.logspace(-6, 1, points), precision)
            decay, spread = (np.asarray(part, np.float64) for part in jax.jit(ou_decay, static_argnums=0)(dt, tau))
            plain = np.asarray(jnp.sqrt(1.0 - jnp.asarray(decay, precision) ** 2), np.float64)
            x = np.asarray(jnp.asarray(dt, precision), np.float64) / np.asarray(tau, np.float64)
        exact = np.sqrt(-np.expm1(-2.0 * x))
        # 1 - a^2 of the rounded a; the factors are exact in float64.
        settled = (spread / np.sqrt((1.0 - decay) * (1.0 + decay)))[x >= 1e-5]
        results[precision] = {
            "decay": float(np.max(np.abs(decay / np.exp(-x) - 1.0))),
            "spread": float(np.max(np.abs(spread / exact - 1.0))),
            "spread_below_0_01": float(np.max(np.abs(spread / exact - 1.0)[x < 0.0099])),
            "spread_plain": float(np.max(np.abs(plain / exact - 1.0))),
            "stationary_std": float(np.max(np.abs(settled - 1.0))),
        }
    return results


def family(full: bool) -> dict[str, Any]:
    """Return the statistics of normals and of processes; the full form draws many times as many."""
    return {
        "normals": normals((4, 4096, 256) if full else (4, 1024, 64)),
        "ornstein_uhlenbeck": ornstein_uhlenbeck(4096, 4000) if full else ornstein_uhlenbeck(512, 2000),
    }
