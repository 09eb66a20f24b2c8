"""Exact bounds of shares and quantiles, and the looks of a sequence, by published or independently computed numbers."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import binom

from qrsim.studies.brief.statistics import (
    allowed,
    first_look,
    looks,
    lower,
    quantile,
    quantile_bounds,
    runs_needed,
    spent,
    upper,
    wilson,
)


@pytest.mark.parametrize(
    ("limit", "runs"),
    [
        (0.05, [59, 93, 124, 153]),
        (0.02, [149, 236, 313, 386]),
        (0.01, [299, 473, 628, 773]),
        (0.001, [2995, 4742, 6294, 7752]),
    ],
)
def test_runs_of_one_look(limit: float, runs: list[int]) -> None:
    assert [runs_needed(limit, hits) for hits in range(4)] == runs


def test_bounds_of_none_lost() -> None:
    # 1 - 0.05^(1/n): the "rule of three" in its exact form.
    assert [round(100 * upper(0, runs), 2) for runs in (64, 80, 300)] == [4.57, 3.68, 0.99]
    assert [round(100 * wilson(0, runs)[1], 1) for runs in (64, 80)] == [5.7, 4.6]
    assert lower(0, 80) == 0.0
    assert upper(80, 80) == 1.0
    assert wilson(0, 0) == (0.0, 1.0)


def test_bounds_of_some_lost() -> None:
    # Clopper and Pearson for 4 of 20, two-sided 95 %: 0.0573 to 0.4366.
    assert lower(4, 20, 0.025) == pytest.approx(0.0573, abs=5e-5)
    assert upper(4, 20, 0.025) == pytest.approx(0.4366, abs=5e-5)


def test_looks_double_and_spend_their_error() -> None:
    assert [first_look(limit) for limit in (0.05, 0.02, 0.01, 0.001)] == [72, 183, 368, 3688]
    assert list(itertools.islice(looks(0.05), 4)) == [72, 144, 288, 576]
    assert [allowed(0.01, look) for look in range(1, 6)] == [0, 1, 5, 14, 37]
    assert allowed(0.05, 5) == 36
    assert [spent(look) for look in (1, 2, 3)] == pytest.approx([0.025, 0.05 / 6, 0.05 / 12])
    assert sum(spent(look) for look in range(1, 100_000)) == pytest.approx(0.05, abs=1e-6)


def test_quantiles_are_order_statistics() -> None:
    values = np.arange(1.0, 101.0)[::-1]
    assert quantile(values, 0.05) == 5.0
    assert quantile(values, 0.01) == 1.0
    assert np.isnan(quantile(np.array([np.nan]), 0.5))
    # The smallest of 59 values is the first that bounds the 5 % quantile with 95 %: 1 - 0.95^59 = 0.9515.
    assert quantile_bounds(np.arange(59.0), 0.05)[0] == 0.0
    assert quantile_bounds(np.arange(58.0), 0.05)[0] == -np.inf
    # At the first look, with an error of 2.5 %, 72 are needed.
    assert quantile_bounds(np.arange(72.0), 0.05, 0.025)[0] == 0.0
    assert quantile_bounds(np.arange(71.0), 0.05, 0.025)[0] == -np.inf
    # NaN does not count.
    assert quantile_bounds(np.append(np.arange(59.0), np.nan), 0.05)[0] == 0.0


def test_bounds_of_quantiles_hold_their_level() -> None:
    random = np.random.default_rng(1)
    values = random.random((1500, 144))
    bounds = np.array([quantile_bounds(row, 0.05) for row in values])
    # The true 5 % quantile of uniform numbers is 0.05; the binomial error of 1500 series is 0.0056.
    assert 0.93 < np.mean(bounds[:, 0] <= 0.05) < 1.0
    assert 0.93 < np.mean(bounds[:, 1] >= 0.05) < 1.0


@pytest.mark.parametrize("limit", [0.05, 0.01, 0.001])
def test_a_false_go_is_rare_over_all_looks(limit: float) -> None:
    random = np.random.default_rng(7)
    series, five = 20_000, 5
    going = np.zeros(series, bool)
    lost, before = np.zeros(series, int), 0
    for look, total in zip(range(1, five + 1), looks(limit), strict=False):
        lost += random.binomial(total - before, limit, series)
        before = total
        going |= lost <= allowed(limit, look)
    # Allowed is 0.05; its binomial error is 0.0015.
    assert 0.02 < going.mean() < 0.05


@pytest.mark.parametrize("runs", [72, 144, 368])
def test_wilson_covers_what_it_states(runs: int) -> None:
    intervals = np.array([wilson(hits, runs) for hits in range(runs + 1)])
    for share in np.linspace(0.05, 0.95, 19):
        inside = (intervals[:, 0] <= share) & (share <= intervals[:, 1])
        assert 0.92 < binom.pmf(np.arange(runs + 1), runs, share)[inside].sum() < 0.98
