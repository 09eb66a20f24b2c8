"""Intervals of what is measured over independent worlds: bootstrap over the worlds, exact ones of shares."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

CONFIDENCE = 0.95
RESAMPLES, SEED = 2000, 20261122

Values = np.ndarray[Any, Any]
Interval = dict[str, float]


def resampled(worlds: int) -> Values:
    """Return numbers (RESAMPLES, W) of worlds drawn with replacement, always the same."""
    return np.random.default_rng(SEED).integers(0, worlds, (RESAMPLES, worlds))


def bootstrap(of: Callable[..., Any], *worlds: Values) -> Interval:
    """Return a statistic and its percentile interval.

    Args:
        of: takes arrays (..., W) and returns numbers (...).
        worlds: each (W,), one number a world.
    """
    chosen = resampled(len(worlds[0]))
    every = of(*(each[chosen] for each in worlds))
    low, high = np.quantile(every, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return {"value": float(of(*worlds)), "low": float(low), "high": float(high)}


def mean(values: Values) -> Interval:
    """Return the mean of numbers (W,)."""
    return bootstrap(lambda each: each.mean(axis=-1), values)


def root_mean(squares: Values) -> Interval:
    """Return the root of the mean of mean squares (W,)."""
    return bootstrap(lambda each: np.sqrt(each.mean(axis=-1)), squares)


def ratio(above: Values, below: Values) -> Interval:
    """Return the ratio of two means, each of (W,)."""
    return bootstrap(lambda a, b: a.mean(axis=-1) / b.mean(axis=-1), above, below)


def quantile(values: Values, part: float) -> Interval:
    """Return a quantile of numbers (W,)."""
    return bootstrap(lambda each: np.quantile(each, part, axis=-1), values)


def share(true: Values) -> Interval:
    """Return how many of (W,) are true, with the exact interval of Clopper and Pearson (1934)."""
    found = scipy.stats.binomtest(int(np.sum(true)), len(true)).proportion_ci(CONFIDENCE, method="exact")
    return {"value": float(np.mean(true)), "low": float(found.low), "high": float(found.high)}
