"""Means with their intervals, paired tests, and Allan deviations over many seeds; intervals hold with CONFIDENCE."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from qrsim.core.allan import overlapping_allan_deviation
from qrsim.studies.slam.flight import Floats

CONFIDENCE = 0.95
RESAMPLES, RESAMPLE_SEED = 2000, 20140917
# Windows between which the slope of the Allan deviation is fitted [s].
SLOPE_WINDOWS = (0.4, 10.0)


def interval(values: Floats) -> dict[str, float]:
    """Return the mean of values with its Student t interval, by name; only the mean for one value, {} for none."""
    known = values[np.isfinite(values)]
    if not len(known):
        return {}
    found = {"mean": float(known.mean()), "median": float(np.median(known))}
    if len(known) > 1:
        half = scipy.stats.t.ppf(0.5 + CONFIDENCE / 2, len(known) - 1) * known.std(ddof=1) / math.sqrt(len(known))
        found |= {"low": found["mean"] - float(half), "high": found["mean"] + float(half)}
    return found


def paired(one: Floats, other: Floats) -> dict[str, float]:
    """Return the mean of ``other - one`` over pairs, its Student t interval, and Wilcoxon's signed-rank p, by name."""
    both = np.isfinite(one) & np.isfinite(other)
    difference = other[both] - one[both]
    found = interval(difference)
    found["pairs"] = int(both.sum())
    found["larger"] = int(np.sum(difference > 0.0))
    found["p"] = float(scipy.stats.wilcoxon(difference).pvalue) if np.any(difference != 0.0) else 1.0
    return found


def recovered(white: Floats, coloured: Floats, remedied: Floats) -> dict[str, float]:
    """Return the share of the accuracy lost by coloured errors that a remedy recovers: "part", "low", "high".

    The interval is a percentile bootstrap over seeds.
    """
    both = np.isfinite(white) & np.isfinite(coloured) & np.isfinite(remedied)
    rows = np.stack([white[both], coloured[both], remedied[both]], axis=1)

    def part(means: Floats) -> Floats:
        """Return the recovered share from means over seeds (..., 3): white, coloured, remedied."""
        return np.asarray((means[..., 1] - means[..., 2]) / (means[..., 1] - means[..., 0]))

    low, high = _bootstrapped(part(_resampled(rows).mean(axis=1)))
    return {"part": float(part(rows.mean(axis=0))), "low": low, "high": high}


def _resampled(rows: Floats) -> Floats:
    """Return rows (S, K) resampled with replacement, (RESAMPLES, S, K)."""
    chosen = np.random.default_rng(RESAMPLE_SEED).integers(0, len(rows), (RESAMPLES, len(rows)))
    return np.asarray(rows[chosen])


def _bootstrapped(values: Floats) -> tuple[float, float]:
    """Return the percentile interval (low, high) of resampled values (RESAMPLES,)."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(values, [tail, 1.0 - tail])
    return float(low), float(high)


def allan(errors: Sequence[Floats], period: float, longest: float | None = None) -> tuple[Floats, Floats]:
    """Return windows (K,) [s] and the Allan deviation (K,) [m] of errors (N, 2), pooled over seeds and axes.

    Args:
        errors: of each seed, one every ``period`` [s].
        period: [s].
        longest: window [s]; None: a third of the record.
    """
    windows, variances = _allan_variances(errors, period, longest)
    return windows, np.sqrt(variances.mean(axis=0))


def _allan_variances(errors: Sequence[Floats], period: float, longest: float | None) -> tuple[Floats, Floats]:
    """Return windows (K,) [s] and Allan variances (S, K) [m^2] of S seeds' errors (N, 2), mean of both axes."""
    most = len(errors[0]) // 3 if longest is None else round(longest / period)
    lengths = np.unique(np.round(np.geomspace(1, most, 16)).astype(np.int64))
    found = [overlapping_allan_deviation(error, period, lengths) for error in errors]
    return found[0][0], np.stack([np.mean(np.square(deviation), axis=1) for _, deviation in found])


def allan_slope(errors: Sequence[Floats], period: float) -> dict[str, float]:
    """Return the slope of the pooled Allan deviation of errors over SLOPE_WINDOWS, in log-log scale, with interval.

    Its interval is a percentile bootstrap over seeds; of one seed there is none.
    """
    windows, variances = _allan_variances(errors, period, SLOPE_WINDOWS[1])
    within = windows >= SLOPE_WINDOWS[0] - 1e-9
    abscissa = np.log(windows[within])
    centred = (abscissa - abscissa.mean()) / np.sum(np.square(abscissa - abscissa.mean()))

    def slope(pooled: Floats) -> Floats:
        """Return the slope of an Allan deviation over its windows, in log-log scale, from the pooled variances."""
        return np.asarray(0.5 * np.log(pooled[..., within]) @ centred)

    found = {"slope": float(slope(variances.mean(axis=0)))}
    if len(variances) > 1:
        low, high = _bootstrapped(slope(_resampled(variances).mean(axis=1)))
        found |= {"low": low, "high": high}
    return found
