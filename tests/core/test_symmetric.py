"""Operations of symmetric matrices that are kept as halves, against those of whole matrices."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control.covariance import variance_of
from qrsim.core.symmetric import Term, lowered, place_of, places, size_of, times, transformed

SIZE, COUNT = 5, 3
UPPER = np.triu_indices(SIZE)


@pytest.fixture
def whole() -> np.ndarray:
    """Matrices (n, m, m) with positive eigenvalues."""
    found = np.random.default_rng(1).normal(size=(COUNT, SIZE, SIZE))
    return found @ np.swapaxes(found, 1, 2) + np.eye(SIZE)


def half_of(whole: np.ndarray) -> jax.Array:
    return jnp.asarray(whole[:, UPPER[0], UPPER[1]].T, jnp.float32)


def test_a_half_has_its_rows_one_after_the_other():
    """Of three rows: 0 1 2, 3 4, 5."""
    assert [place_of(row, column, 3) for row, column in ((0, 0), (0, 2), (1, 1), (2, 1), (2, 2))] == [0, 2, 3, 4, 5]
    np.testing.assert_array_equal(places(3), [[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    assert [size_of(half) for half in (1, 3, 6, 231)] == [1, 2, 3, 21]


def test_a_product_with_a_sparse_vector(whole: np.ndarray):
    factors = {3: jnp.array([1.0, -2.0, 0.5]), 0: jnp.array([0.0, 4.0, 1.0])}
    vector = np.zeros((COUNT, SIZE))
    vector[:, 3], vector[:, 0] = [1.0, -2.0, 0.5], [0.0, 4.0, 1.0]
    expected = np.einsum("nij,nj->in", whole, vector)
    np.testing.assert_allclose(times(half_of(whole), factors), expected, rtol=1e-5, atol=1e-5)


def test_less_the_squares_of_vectors(whole: np.ndarray):
    columns = np.random.default_rng(2).normal(size=(2, SIZE, COUNT))
    expected = whole - np.einsum("kin,kjn->nij", columns, columns)
    found = lowered(half_of(whole), [jnp.float32(column) for column in columns])
    np.testing.assert_allclose(found, half_of(expected), rtol=1e-5, atol=1e-5)


def test_a_transformation_by_a_sparse_matrix(whole: np.ndarray):
    """With a factor that two numbers share, a row that is read after it has changed, and numbers on the diagonal."""
    terms = [Term(1, 2, -0.5, 0), Term(0, 1, 0.02), Term(2, 4, 2.0, 0)]
    factor, added = np.array([1.0, -3.0, 0.25]), np.array([0.5, 1.0, 2.0])
    matrix = np.repeat(np.eye(SIZE)[None], COUNT, axis=0)
    matrix[:, 0, 1], matrix[:, 1, 2], matrix[:, 2, 4] = 0.02, -0.5 * factor, 2.0 * factor
    expected = matrix @ whole @ np.swapaxes(matrix, 1, 2)
    expected[:, 4, 4] += added
    expected[:, 0, 0] += 7.0
    found = transformed(half_of(whole), terms, [jnp.float32(factor)], {4: jnp.float32(added), 0: jnp.float32(7.0)})
    np.testing.assert_allclose(found, half_of(expected), rtol=1e-5, atol=1e-4)


def test_operations_are_batched_and_differentiated(whole: np.ndarray):
    """d (x'P'x) / ds of P' = P - s^2 c c' is -2 s (c'x)^2: here of columns and vectors of ones."""
    ones = jnp.ones((SIZE, COUNT))

    def form(scale: jax.Array) -> jax.Array:
        less = lowered(half_of(whole), [scale * ones])
        return times(less, dict.fromkeys(range(SIZE), jnp.ones(COUNT))).sum()

    slopes = jax.vmap(jax.grad(form))(jnp.array([1.0, 0.5]))
    np.testing.assert_allclose(slopes, [-150.0, -75.0], rtol=1e-5)


def test_variance_of_a_measurement_is_that_of_the_whole_matrix(whole: np.ndarray) -> None:
    """H P H' with one, two and three sensitivities."""
    for sensitivity in ({2: 1.5}, {0: 1.0, 3: -0.5}, {1: 2.0, 2: -1.0, 4: 0.25}):
        row = np.zeros(SIZE)
        row[list(sensitivity)] = list(sensitivity.values())
        given = {i: jnp.full(COUNT, value, jnp.float32) for i, value in sensitivity.items()}
        np.testing.assert_allclose(variance_of(half_of(whole), given), row @ whole @ row, rtol=1e-5)
