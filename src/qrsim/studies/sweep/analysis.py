"""Analysis of results: responses with bands, maps, the boundary of failure, Sobol indices, the worst episodes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.studies.sweep.results import Parameter, Results

CONFIDENCE = 0.95
RESAMPLES = 200
# Of the logistic fit: of the squared coefficients, so that a boundary without any mixed point stays finite.
PENALTY = 1e-3
SURE = 0.05


@dataclass(frozen=True)
class Response:
    """A metric against one parameter, averaged over all others; (L,) each, NaN for a level without episodes.

    Attributes:
        parameter: which.
        mean, low, high: mean and its interval at CONFIDENCE.
    """

    parameter: Parameter
    mean: NumpyArray
    low: NumpyArray
    high: NumpyArray


def response(
    results: Results, parameter: Parameter, values: NumpyArray, limits: tuple[float, float] = (-np.inf, np.inf)
) -> Response:
    """Return the mean of values (E,) of E episodes at each level of a parameter, with intervals clipped to ``limits``.

    At each level the means of the seeds (of sampled points: of the points) are what is independent; their Student t
    interval is the band, cut where the metric ends. All points of a study share their seeds, so that episodes are not
    independent. Where every value is 0 or 1, it is a share and has an exact interval; see ``share_interval``.
    """
    groups = results.points if parameter.sampled else results.seeds
    found = np.full((3, len(parameter.levels)), np.nan)
    fine = np.isfinite(values)
    for i in range(len(parameter.levels)):
        at = fine & (parameter.level == i)
        if at.any():
            found[:, i] = _mean(values[at], groups[at], limits)
    return Response(parameter, *found)


def _mean(values: NumpyArray, groups: NumpyArray, limits: tuple[float, float]) -> tuple[float, float, float]:
    """Return (mean, low, high), clipped to ``limits``, of values (E,) that depend within each of ``groups`` (E,)."""
    from scipy.stats import t

    mean = float(values.mean())
    _, index = np.unique(groups, return_inverse=True)
    counts = np.bincount(index)
    means = np.bincount(index, values) / counts
    if np.isin(values, (0.0, 1.0)).all():
        return mean, *share_interval(mean, means, len(values))
    if len(means) < 2:
        return mean, np.nan, np.nan
    # Every group counts as much, which is the mean itself where all are complete.
    half = t.ppf(0.5 + CONFIDENCE / 2, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means))
    return mean, max(mean - half, limits[0]), min(mean + half, limits[1])


def share_interval(share: float, shares: NumpyArray, count: int) -> tuple[float, float]:
    """Return the exact interval (Clopper and Pearson 1934) of a share of ``count`` episodes; ``shares`` is by group.

    Episodes of one group are not independent: as many count as would give the variance between the groups (Korn and
    Graubard, Survey Methodology 24, 1998, with their correction by Student's t), and none beyond the number of groups
    where all groups are equal.

    Args:
        share: of all episodes.
        shares: (G,) of the groups.
        count: episodes.
    """
    from scipy.stats import beta, t

    groups, effective = len(shares), float(count)
    if count > groups:
        between = float(shares.var(ddof=1)) / groups if groups > 1 else 0.0
        effective = min(effective, share * (1.0 - share) / between) if between > 0.0 else float(groups)
        if groups > 1:
            middle = 0.5 + CONFIDENCE / 2
            # The ratio is for the lost degrees of freedom of the variance.
            effective *= (t.ppf(middle, count - 1) / t.ppf(middle, groups - 1)) ** 2 if between > 0.0 else 1.0
    hits, tail = share * effective, 0.5 - CONFIDENCE / 2
    low = 0.0 if share == 0.0 else float(beta.ppf(tail, hits, effective - hits + 1.0))
    high = 1.0 if share == 1.0 else float(beta.ppf(1.0 - tail, hits + 1.0, effective - hits))
    return low, high


def failures(results: Results, parameter: Parameter) -> Response:
    """Return the share of failed episodes at each level of a parameter, with its exact interval."""
    return response(results, parameter, results.failed.astype(float))


def heat_map(one: Parameter, other: Parameter, values: NumpyArray) -> NumpyArray:
    """Return the mean of values (E,) of E episodes at each pair of two parameters' levels (L1, L2); NaN if none."""
    fine = np.isfinite(values)
    cell = one.level[fine] * len(other.levels) + other.level[fine]
    size = len(one.levels) * len(other.levels)
    count = np.bincount(cell, minlength=size)
    total = np.bincount(cell, values[fine], minlength=size)
    with np.errstate(invalid="ignore"):
        return (np.where(count > 0, total, np.nan) / np.where(count > 0, count, 1)).reshape(len(one.levels), -1)


@dataclass(frozen=True)
class Boundary:
    """The boundary at which half of the episodes fail, by logistic regression.

    Attributes:
        parameters: the numbers that it depends on.
        squares: whether products of two parameters are in it, by Akaike's criterion, or first powers only.
        coefficients: of the terms.
        middle, scale: (d,) by which parameters are standardised, on their even scales.
        resampled: (R, terms) coefficients of resampled seeds, for intervals; empty with fewer than 3 seeds.
    """

    parameters: tuple[Parameter, ...]
    squares: bool
    coefficients: NumpyArray
    middle: NumpyArray
    scale: NumpyArray
    resampled: NumpyArray

    def probability(self, values: NumpyArray) -> NumpyArray:
        """Return the fitted probability of failure at d parameters' values (..., d), on their even scales."""
        return _logistic(self._terms(values) @ self.coefficients)

    def band(self, values: NumpyArray) -> tuple[NumpyArray, NumpyArray] | None:
        """Return the interval (low, high) of the failure probability at values (..., d); None with too few seeds."""
        if not len(self.resampled):
            return None
        found = _logistic(self._terms(values) @ self.resampled.T)
        low, high = np.quantile(found, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2], axis=-1)
        return low, high

    def _terms(self, values: NumpyArray) -> NumpyArray:
        """Return the terms (k, terms) of the logistic model at values (k, d), standardised as in the fit."""
        return terms((values - self.middle) / self.scale, self.squares)

    def crossing(self, number: int) -> tuple[float, float, float] | None:
        """Return (value, low, high) of parameter ``number`` where half of the episodes fail, others mid-range; else
        None.

        None where it does not within the values that were flown.
        """
        parameter = self.parameters[number]
        line = self.line(number, 401)
        rows = self._terms(line)
        at = _half(line[:, number], rows @ self.coefficients)
        if at is None:
            return None
        others = [_half(line[:, number], rows @ each) for each in self.resampled]
        known = [other for other in others if other is not None]
        low, high = np.nan, np.nan
        # An interval that too many resamples leave is none.
        if known and len(known) >= 0.9 * len(others):
            low, high = np.quantile(known, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
            # Between two levels of which one never fails and the other always does, nothing is known.
            beside = self._beside(number, at)
            low, high = min(low, beside[0]), max(high, beside[1])
        return tuple(parameter.uneven(np.array([at, low, high])).tolist())

    def line(self, number: int, count: int) -> NumpyArray:
        """Return ``count`` values (count, d) along parameter ``number``, with the other parameters mid-range."""
        line = np.tile(self.middle, (count, 1))
        middle, scale = float(self.middle[number]), float(self.scale[number])
        line[:, number] = np.linspace(middle - scale, middle + scale, count)
        return line

    def _beside(self, number: int, at: float) -> tuple[float, float]:
        """Return the levels below and above a value if the fit is sure at both; else (value, value)."""
        levels = self.parameters[number].even(np.asarray(self.parameters[number].levels, float))
        i = int(np.clip(np.searchsorted(levels, at), 1, len(levels) - 1))
        pair = np.tile(self.middle, (2, 1))
        pair[:, number] = levels[i - 1 : i + 1]
        chances = self.probability(pair)
        sure = chances.min() < SURE and chances.max() > 1.0 - SURE
        return (float(levels[i - 1]), float(levels[i])) if sure else (at, at)


def _half(values: NumpyArray, score: NumpyArray) -> float | None:
    """Return the value at which ``score``, the log odds of failure, first crosses 0, interpolated; else None."""
    crossings = np.flatnonzero(np.diff(np.signbit(score)))
    if not len(crossings):
        return None
    i = int(crossings[0])
    return float(values[i] + (values[i + 1] - values[i]) * score[i] / (score[i] - score[i + 1]))


def terms(values: NumpyArray, squares: bool) -> NumpyArray:
    """Return the terms of a logistic model (1, values, with ``squares`` also products) at scaled values (..., d)."""
    count = values.shape[-1]
    parts = [np.ones(values.shape[:-1]), *(values[..., i] for i in range(count))]
    if squares:
        parts += [values[..., i] * values[..., j] for i in range(count) for j in range(i, count)]
    return np.stack(parts, axis=-1)


def _logistic(score: NumpyArray) -> NumpyArray:
    """Return the probability with a given log odds, the logistic function."""
    return 1.0 / (1.0 + np.exp(-np.clip(score, -50.0, 50.0)))


def boundary(results: Results) -> Boundary | str:
    """Fit the boundary at which half of the episodes fail; return a text that says why if it cannot be fitted."""
    parameters = tuple(p for p in results.parameters.values() if p.numeric and np.ptp(p.values) > 0)
    failed = results.failed
    if not parameters:
        return "no parameter is a number"
    if failed.all() or not failed.any():
        return f"{'every' if failed.any() else 'no'} episode failed ({results.failure})"
    values = np.stack([parameter.even(parameter.values) for parameter in parameters], axis=1)
    middle = 0.5 * (values.min(axis=0) + values.max(axis=0))
    scale = 0.5 * np.ptp(values, axis=0)
    counts = _Counts(results, (values - middle) / scale)
    fits = {squares: _fit(terms(counts.values, squares), counts.flown, counts.failed) for squares in (False, True)}
    squares = fits[True][1] < fits[False][1]
    rows = terms(counts.values, squares)
    resampled = [_fit(rows, *counts.drawn(seed), fits[squares][0])[0] for seed in range(counts.resamples)]
    return Boundary(parameters, squares, fits[squares][0], middle, scale, np.array(resampled))


class _Counts:
    """Episodes and failures at each point, of all seeds or of resampled ones."""

    def __init__(self, results: Results, values: NumpyArray):
        _, first, self._point = np.unique(results.points, return_index=True, return_inverse=True)
        self.values = values[first]
        seeds, self._seed = np.unique(results.seeds, return_inverse=True)
        self._failed = results.failed
        self._seeds = len(seeds)
        # With few seeds their resamples are too much alike; of one, points are what can be drawn.
        self.resamples = RESAMPLES if self._seeds >= 3 or self._seeds == 1 else 0
        self.flown, self.failed = self._count(np.ones(self._seeds if self._seeds > 1 else len(first)))

    def _count(self, weights: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
        """Return episodes and failed episodes at each point, weighted by seed (by point with a single seed)."""
        weight = weights[self._seed if self._seeds > 1 else self._point]
        return np.bincount(self._point, weight), np.bincount(self._point, weight * self._failed)

    def drawn(self, number: int) -> tuple[NumpyArray, NumpyArray]:
        """Return episodes and failed episodes at each point for bootstrap resample ``number``."""
        size = self._seeds if self._seeds > 1 else len(self.values)
        random = np.random.default_rng(number)
        return self._count(np.bincount(random.integers(0, size, size), minlength=size).astype(float))


def _fit(
    rows: NumpyArray, flown: NumpyArray, failed: NumpyArray, start: NumpyArray | None = None
) -> tuple[NumpyArray, float]:
    """Fit a logistic model to failures; ``rows`` are its terms. Return coefficients and Akaike's criterion."""
    from scipy.optimize import minimize

    total = flown.sum()

    def loss(coefficients: NumpyArray) -> tuple[float, NumpyArray]:
        """Return the penalised mean negative log-likelihood of the model's coefficients, and its gradient."""
        score = rows @ coefficients
        unlikely = flown * np.logaddexp(0.0, score) - failed * score
        slope = rows.T @ (flown * _logistic(score) - failed)
        penalty = PENALTY * coefficients[1:] @ coefficients[1:]
        slope[1:] += 2 * PENALTY * coefficients[1:]
        return float(unlikely.sum() + penalty) / total, slope / total

    begin = np.zeros(rows.shape[1]) if start is None else start
    found = minimize(loss, begin, jac=True, method="L-BFGS-B")
    return found.x, 2.0 * found.fun * total + 2.0 * rows.shape[1]


@dataclass(frozen=True)
class Sensitivity:
    """Sobol indices of the mean over seeds, (d,) each, with half-widths of their intervals at CONFIDENCE.

    Attributes:
        names: of the parameters.
        first, first_half: the part of the variance that a parameter has alone.
        total, total_half: the part that it has together with others.
    """

    names: tuple[str, ...]
    first: NumpyArray
    first_half: NumpyArray
    total: NumpyArray
    total_half: NumpyArray


def sensitivity(results: Results, values: NumpyArray) -> Sensitivity | str:
    """Return the Sobol indices of values (E,) of E episodes, by SALib; or a text that says why not."""
    sampling = results.spec.sampling
    if sampling is None or sampling.type != "saltelli":
        return "they need 'sampling: {type: saltelli, ...}'"
    sampled = [item.name or path for path, item in results.spec.vary.items() if item.listed is None and not item.count]
    if len(sampled) < len(results.spec.vary):
        return "not for a study that also has parameters with values"
    if results.episodes < results.planned:
        return "the study is not complete"
    means = values.reshape(-1, results.dataset.sizes["seed"]).mean(axis=1)
    if not np.isfinite(means).all():
        return "the metric is not defined in every episode"
    if np.ptp(means) == 0.0:
        return "the metric is the same at all points"
    from SALib.analyze import sobol

    problem = {"num_vars": len(sampled), "names": sampled, "bounds": [[0.0, 1.0]] * len(sampled)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sobol.analyze(problem, means, calc_second_order=False, conf_level=CONFIDENCE, seed=0)
    return Sensitivity(tuple(sampled), *(np.asarray(found[name]) for name in ("S1", "S1_conf", "ST", "ST_conf")))


def worst(results: Results, ranking: Mapping[str, bool], count: int) -> list[int]:
    """Return indices of at most ``count`` worst episodes with a value; ``ranking``: metric -> whether small is bad.

    Args:
        results: of the store.
        ranking: metrics, the first of which counts most, each with whether small values are the bad ones.
        count: how many at most.
    """
    goodness = [results.metric(metric) * (1.0 if low_is_bad else -1.0) for metric, low_is_bad in ranking.items()]
    order = np.lexsort(goodness[::-1])  # NaN last
    return [int(i) for i in order[:count] if not all(np.isnan(values[i]) for values in goodness)]
