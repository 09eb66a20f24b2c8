"""Intervals know from how many pieces of a log a constant is known."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.studies.identify.intervals import covariance
from qrsim.studies.identify.problem import Misfit


def line(rng: np.random.Generator, shows: np.ndarray) -> Misfit:
    """Residuals, at their optimum, of ten windows in which two unknowns show, (10, 2), and the derivatives."""
    by_value = rng.standard_normal((50, 10, 1, 2)) * shows[None, :, None, :]
    rows = by_value.reshape(-1, 2)
    noise = rng.standard_normal(len(rows))
    left = noise - rows @ np.linalg.lstsq(rows, noise, rcond=None)[0]
    return Misfit(left.reshape(50, 10, 1), by_value, np.zeros((10, 0)), np.zeros((10, 0, 2)))


def test_a_constant_that_shows_in_two_windows_has_few_degrees_of_freedom() -> None:
    shows = np.ones((10, 2))
    shows[2:, 1] = 0.0
    found = covariance(
        ("a", "b"), np.zeros(2), np.ones(2), [line(np.random.default_rng(1), shows)], [5.0], np.eye(2) * 1e-3, False
    )
    assert 6.0 < found.freedom[0] <= 9.0
    assert 1.0 <= found.freedom[1] < 2.5
    assert found.quantile[1] > 2.0 * found.quantile[0]
    # 500 and 100 rows of white noise.
    assert found.white == pytest.approx([500**-0.5, 100**-0.5], rel=0.15)


def test_intervals_hold_as_often_as_they_say() -> None:
    """400 draws in which the second unknown shows in three of ten windows: 95 % within 3.5 standard errors."""
    shows = np.ones((10, 2))
    shows[3:, 1] = 0.0
    inside = np.zeros(2)
    rng = np.random.default_rng(2)
    for _ in range(400):
        by_value = rng.standard_normal((20, 10, 1, 2)) * shows[None, :, None, :]
        rows = by_value.reshape(-1, 2)
        noise = rng.standard_normal(len(rows))
        estimate = np.linalg.lstsq(rows, noise, rcond=None)[0]
        left = (rows @ estimate - noise).reshape(20, 10, 1)
        misfit = Misfit(left, by_value, np.zeros((10, 0)), np.zeros((10, 0, 2)))
        found = covariance(("a", "b"), estimate, np.ones(2), [misfit], [5.0], np.eye(2) * 1e-6, False)
        inside += np.abs(estimate) < found.quantile * found.std
    assert (np.abs(inside / 400 - 0.95) < 3.5 * (0.05 * 0.95 / 400) ** 0.5).all()


def test_a_direction_that_one_block_shows_has_no_interval() -> None:
    """Without the window that shows the second unknown its curvature is singular; the first is as before."""
    shows = np.ones((10, 2))
    shows[1:, 1] = 0.0
    rng = np.random.default_rng(3)
    found = covariance(("a", "b"), np.zeros(2), np.ones(2), [line(rng, shows)], [5.0], np.zeros((0, 2)), False)
    assert found.lost.tolist() == [False, True]
    assert np.isfinite(found.matrix).all()
    assert found.white[0] == pytest.approx(500**-0.5, rel=0.15)
    assert 0.5 < found.std[0] / found.white[0] < 2.0


def test_what_nothing_shows_and_what_is_not_told_apart_have_no_interval() -> None:
    """The second unknown has no effect; the third has that of the first."""
    rng = np.random.default_rng(4)
    one = line(rng, np.ones((10, 1)) * [1.0, 0.0])
    by_value = np.concatenate([one.by_value, one.by_value[..., :1]], axis=-1)
    same = Misfit(one.residual, by_value, np.zeros((10, 0)), np.zeros((10, 0, 3)))
    found = covariance(("a", "b", "c"), np.zeros(3), np.ones(3), [same], [5.0], np.zeros((0, 3)), False)
    assert found.lost.all()
    assert np.isfinite(found.matrix).all()
