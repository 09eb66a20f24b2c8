"""Exact statistics of a brief: shares, quantiles by order statistics, and the rule that stops a sequence of looks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.stats import beta, binom, norm

from qrsim.core.arrays import NumpyArray

# Errors that all looks together may make: a false go, and a false no-go.
ALPHA = 0.05
# Runs of the first look for a no-go: earlier ones decide nothing.
FEWEST = 32


def upper(hits: int, runs: int, alpha: float = ALPHA) -> float:
    """Return the one-sided upper confidence bound of ``hits / runs`` (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 if hits >= runs else float(beta.ppf(1.0 - alpha, hits + 1, runs - hits))


def lower(hits: int, runs: int, alpha: float = ALPHA) -> float:
    """Return the one-sided lower confidence bound of the share ``hits / runs``; see ``upper``."""
    return 0.0 if hits <= 0 else float(beta.ppf(alpha, hits, runs - hits + 1))


def wilson(hits: int, runs: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the two-sided confidence interval of the share ``hits / runs`` for display (Wilson, JASA 22, 1927)."""
    if runs == 0:
        return 0.0, 1.0
    z = float(norm.ppf(0.5 + confidence / 2.0))
    share = hits / runs
    middle = (share + z * z / (2 * runs)) / (1.0 + z * z / runs)
    half = z * math.sqrt(share * (1.0 - share) / runs + z * z / (4 * runs * runs)) / (1.0 + z * z / runs)
    return max(0.0, middle - half), min(1.0, middle + half)


def runs_for(width: float) -> int:
    """Return the number of runs without a hit after which the share's interval is at most ``width`` wide."""
    z = float(norm.ppf(0.975))
    # The upper end of Wilson's interval of none is z^2/(n + z^2).
    return math.ceil(z * z * (1.0 / width - 1.0))


def runs_needed(limit: float, hits: int = 0, alpha: float = ALPHA) -> int:
    """Return the fewest runs with ``hits`` hits at which the share's upper confidence bound is below a limit."""
    first, last = hits + 1, hits + 2
    while upper(hits, last, alpha) >= limit:
        first, last = last, 2 * last
    while last - first > 1:
        middle = (first + last) // 2
        first, last = (middle, last) if upper(hits, middle, alpha) >= limit else (first, middle)
    return first if upper(hits, first, alpha) < limit else last


def spent(look: int) -> float:
    """Return the part of the error probability ALPHA for interim analysis ``look`` (1, 2, ...); all sum to ALPHA."""
    return ALPHA / (look * (look + 1))


def first_look(limit: float) -> int:
    """Return how many runs the first interim analysis has: the fewest that give a go if none is lost."""
    return runs_needed(limit, 0, spent(1))


def looks(limit: float) -> Iterator[int]:
    """Yield the total number of runs at each interim analysis; each total is twice the one before."""
    runs = first_look(limit)
    while True:
        yield runs
        runs *= 2


def allowed(limit: float, look: int) -> int:
    """Return the largest number of losses at interim analysis ``look`` that still gives a go."""
    runs = first_look(limit) * 2 ** (look - 1)
    hits = 0
    while upper(hits + 1, runs, spent(look)) < limit:
        hits += 1
    return hits


def quantile(values: NumpyArray, share: float) -> float:
    """Return the quantile of values (E,) at a share from 0 to 1, as an order statistic; NaN without values."""
    known = np.sort(values[np.isfinite(values)])
    return float(known[max(0, math.ceil(share * len(known) - 1e-9) - 1)]) if len(known) else math.nan


def quantile_bounds(values: NumpyArray, share: float, alpha: float = ALPHA) -> tuple[float, float]:
    """Return the exact one-sided lower and upper confidence bounds of a quantile, for any distribution.

    The r-th smallest of n values is a lower bound if at least r of them are below the quantile with a probability of
    1 - alpha, by the binomial distribution; infinite where n is too small.
    """
    known = np.sort(values[np.isfinite(values)])
    count = len(known)
    below, above = -math.inf, math.inf
    if count:
        # P(B <= r - 1) <= alpha, and P(B <= s - 1) >= 1 - alpha, B binomial.
        chances = binom.cdf(np.arange(count), count, share)
        lows = int(np.sum(chances <= alpha))
        highs = np.flatnonzero(chances >= 1.0 - alpha)
        below = float(known[lows - 1]) if lows else -math.inf
        above = float(known[highs[0]]) if len(highs) else math.inf
    return below, above
