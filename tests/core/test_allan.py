"""Allan deviation: the estimator against allantools, the closed form against integrals of the autocovariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy

from qrsim.core.allan import exponential_allan_variance, overlapping_allan_deviation
from qrsim.errors import UsageError

LENGTHS = np.array([1, 2, 3, 7, 10, 64, 100, 333, 499])


@pytest.mark.parametrize("kind", ["white", "random walk", "drift", "offset"])
def test_against_allantools(kind: str) -> None:
    import allantools

    white = np.random.default_rng(11).standard_normal(1000)
    values = {
        "white": white,
        "random walk": np.cumsum(white),
        "drift": white + 0.3 * np.arange(1000.0),
        "offset": 1e6 + white,
    }[kind]
    windows, deviation = overlapping_allan_deviation(values, 0.2, LENGTHS)
    expected_windows, expected, _, counts = allantools.oadev(values, rate=5.0, data_type="freq", taus=0.2 * LENGTHS)
    np.testing.assert_allclose(windows, expected_windows, rtol=1e-12)
    # An offset costs allantools digits: its running sum reaches 1e9.
    np.testing.assert_allclose(deviation, expected, rtol=1e-5 if kind == "offset" else 1e-9)
    # Both take every pair of windows that fits: N - 2 n + 1 of them.
    np.testing.assert_array_equal(counts, 1001 - 2 * LENGTHS)


def test_by_hand() -> None:
    # Means of neighbouring pairs of 1, 3, 2, 6: 2, 2.5, 4; the one difference over non-overlapping windows is 2.
    windows, deviation = overlapping_allan_deviation([1.0, 3.0, 2.0, 6.0], 10.0, [1, 2])
    np.testing.assert_array_equal(windows, [10.0, 20.0])
    np.testing.assert_allclose(deviation, [math.sqrt((4.0 + 1.0 + 16.0) / 3.0 / 2.0), math.sqrt(4.0 / 2.0)])


def test_columns_and_default_lengths() -> None:
    values = np.random.default_rng(12).standard_normal((100, 3, 2))
    windows, deviation = overlapping_allan_deviation(values, 0.5)
    np.testing.assert_array_equal(windows, 0.5 * np.array([1, 2, 4, 8, 16, 32]))
    assert deviation.shape == (6, 3, 2)
    for i, j in np.ndindex(3, 2):
        np.testing.assert_allclose(deviation[:, i, j], overlapping_allan_deviation(values[:, i, j], 0.5)[1])


@pytest.mark.parametrize("count", [2, 3, 4, 5, 63, 64, 65])
def test_default_lengths_fit(count: int) -> None:
    windows, _ = overlapping_allan_deviation(np.arange(float(count)), 1.0)
    assert 2 * windows[-1] <= count < 4 * windows[-1]


@pytest.mark.parametrize(
    ("values", "period", "lengths", "words"),
    [
        ([1.0], 0.2, None, r"values: at least 2 finite samples.*\(1,\)"),
        (1.0, 0.2, None, r"values: at least 2 finite samples.*\(\)"),
        ([1.0, math.nan, 2.0], 0.2, None, "values: at least 2 finite samples"),
        ([1.0, 2.0], 0.0, None, "sample_period: 0.0 s is not positive and finite"),
        ([1.0, 2.0], math.nan, None, "sample_period: nan s"),
        ([1.0, 2.0, 3.0, 4.0], 0.2, [0], "lengths: expected whole numbers from 1 to 2, half the 4 samples"),
        ([1.0, 2.0, 3.0, 4.0], 0.2, [3], "lengths: expected whole numbers from 1 to 2"),
        ([1.0, 2.0, 3.0, 4.0], 0.2, [1.5], "lengths: expected whole numbers from 1 to 2"),
    ],
)
def test_bad_input(values: Any, period: float, lengths: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        overlapping_allan_deviation(values, period, lengths)


@pytest.mark.parametrize("ratio", [0.01, 0.09, 0.11, 0.5, 1.0, 3.0, 20.0, 300.0])
def test_closed_form_against_integrals_of_the_autocovariance(ratio: float) -> None:
    """The average over [0, m] minus that over [m, 2 m] has a variance of twice the Allan variance."""
    tau = 7.0
    m = ratio * tau

    def covariance_of_averages(shift: float) -> float:
        # The difference of two uniform times has a triangular density.
        def integrand(t: float) -> float:
            return (1.0 - abs(t) / m) / m * math.exp(-abs(t + shift) / tau)

        halves = ((-m, 0.0), (0.0, m))
        return sum(scipy.integrate.quad(integrand, *half, epsabs=1e-14, epsrel=1e-12, limit=500)[0] for half in halves)

    expected = covariance_of_averages(0.0) - covariance_of_averages(m)
    assert float(exponential_allan_variance(m, tau)) == pytest.approx(expected, rel=1e-9, abs=1e-13)


def test_closed_form_is_smooth_and_has_the_right_limits() -> None:
    ratios = np.array([1e-9, 1e-6, 1e-3])
    # Short windows: a random walk, 2 x / 3. Long ones: white noise, 2 / x.
    np.testing.assert_allclose(exponential_allan_variance(ratios, 1.0), 2.0 / 3.0 * ratios - 0.5 * ratios**2, rtol=1e-6)
    assert float(exponential_allan_variance(1e6, 1.0)) == pytest.approx(2e-6, rel=1e-5)
    # Where the series ends and the closed form begins.
    below, above = exponential_allan_variance([0.1 * (1.0 - 1e-12), 0.1 * (1.0 + 1e-12)], 1.0)
    assert above == pytest.approx(below, rel=1e-11)
    assert exponential_allan_variance(np.ones((2, 3)), 5.0).shape == (2, 3)
