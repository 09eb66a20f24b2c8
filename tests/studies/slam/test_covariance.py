"""Marginal covariances against closed forms, and the ellipses that are drawn of them."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.studies.slam.covariance import marginals
from qrsim.studies.slam.figures import ellipse_of
from qrsim.studies.slam.graph import Normal

ONE = np.eye(3)


def normal_of(diagonal: Any, below: Any, border: Any, corner: Any) -> Normal:
    """Normal equations of independent, equal axes from their numbers for one axis."""
    with jax.enable_x64(True):
        wide = jnp.asarray(np.asarray(border, np.float64)[:, None, :, None] * ONE[None, :, None, :])
        blocks = [jnp.asarray(np.asarray(values)[:, None, None] * ONE) for values in (diagonal, below, corner)]
        nothing = jnp.zeros((len(diagonal), 3)), jnp.zeros((len(corner), 3))
        return Normal(jnp.zeros(()), blocks[0], blocks[1], wide, blocks[2], *nothing)


def test_a_loop_of_unit_links_has_the_variances_of_resistors() -> None:
    """Linear: prior, two motions, and a landmark measured from the first and the last state, each of variance 1.

    Variances add in series and in parallel as resistances do: 1, 1 + 1|3, 1 + 2|2, and the landmark 1 + 1|3 m^2.
    """
    found = marginals(normal_of([3.0, 2.0, 2.0], [-1.0, -1.0], [[-1.0], [0.0], [-1.0]], [2.0]))
    for covariance, variance in zip(found.positions, (1.0, 1.75, 2.0), strict=True):
        np.testing.assert_allclose(covariance, variance * ONE, atol=1e-12)
    np.testing.assert_allclose(found.landmarks[0], 1.75 * ONE, atol=1e-12)


def test_a_chain_with_a_fix_at_its_end() -> None:
    """The first of 1 m^2 and a fix of the last of 1 m^2, two motions of 1: 1|3, 2|2, 3|1; the landmark 1 more."""
    found = marginals(normal_of([2.0, 2.0, 3.0], [-1.0, -1.0], [[0.0], [0.0], [-1.0]], [1.0]))
    for covariance, variance in zip(found.positions, (0.75, 1.0, 0.75), strict=True):
        np.testing.assert_allclose(covariance, variance * ONE, atol=1e-12)
    np.testing.assert_allclose(found.landmarks[0], 1.75 * ONE, atol=1e-12)


def test_an_ellipse_has_the_size_and_the_bearing_of_its_covariance() -> None:
    """4 m^2 along a bearing of 30 degrees, 1 m^2 across; 95 % lie within 2.4477 standard deviations."""
    bearing = math.radians(30.0)
    along = np.array([math.cos(bearing), math.sin(bearing)])
    half, found = ellipse_of(np.eye(2) + 3.0 * np.outer(along, along))
    np.testing.assert_allclose(half, [4.8955, 2.4477], rtol=1e-4)
    assert found == pytest.approx(bearing)
