"""Covariances of many vehicles at once: how an estimator of n vehicles changes them in every tick.

Half a matrix is kept, row after row (``qrsim.core.symmetric``). Measurements are scalars and sparse, so that nothing
has to be inverted. Those of one reading change the covariance together: once for all, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from operator import add
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.symmetric import Term, lowered, place_of, size_of, times, transformed

# Errors of an axis each, in groups of three: a filter has whole groups.
BLOCK = 3
# (h, n), h = m (m + 1)/2.
Covariance: TypeAlias = Array
# Factors (n,) of errors by their numbers.
Sparse: TypeAlias = Mapping[int, Array]
# Adds arrays in their order.
_sum: Callable[[Sequence[Array]], Array] = partial(reduce, add)


class Moves(NamedTuple):
    """A transition matrix F: ones on the diagonal, and other numbers only right of it."""

    terms: Sequence[Term]
    factors: Sequence[Array]  # (n,), of the terms


class Measured(NamedTuple):
    """A scalar measurement of n vehicles: one row of the measurement equation."""

    innovation: Array  # (n,) reading minus prediction, were all errors zero
    variance: Array  # (n,) or (), of its noise
    sensitivity: dict[int, Array]  # its derivatives (n,) by the error states with these numbers


def variances(covariance: Covariance) -> list[Array]:
    """Return the variance (..., n) of each of m errors, the diagonal of a half-stored covariance; NumPy for NumPy."""
    size = size_of(covariance.shape[-2])
    return [covariance[..., place_of(i, i, size), :] for i in range(size)]


def matrix(covariance: Covariance) -> Array:
    """Return a half-stored covariance as full symmetric matrices (..., m, m, n)."""
    size = size_of(covariance.shape[-2])
    rows, zero = [], jnp.zeros_like(covariance[..., :size, :])
    for i in range(size):
        first = place_of(i, i, size)
        rows.append(jnp.concatenate([zero[..., :i, :], covariance[..., first : first + size - i, :]], axis=-2))
    upper = jnp.stack(rows, axis=-3)
    right = np.triu(np.ones((size, size), bool))[:, :, None]
    return jnp.where(right, upper, jnp.swapaxes(upper, -3, -2))


def independent(variances: Sequence[Array]) -> Covariance:
    """Return the half-stored diagonal covariance of independent errors with these variances (n,)."""
    size, zero = len(variances), jnp.zeros((len(variances) - 1, *variances[0].shape), variances[0].dtype)
    rows = [part for i, variance in enumerate(variances) for part in (variance[None], zero[: size - 1 - i])]
    return jnp.concatenate(rows)


def propagated(covariance: Covariance, moves: Moves, noise: Sequence[Array]) -> Covariance:
    """Return the covariance P one step later, F P F' + Q: ``moves`` is F, and ``noise`` the diagonal of Q.

    Args:
        covariance: P.
        moves: F.
        noise: the diagonal of Q, m times () or (n,).
    """
    return transformed(covariance, moves.terms, moves.factors, dict(enumerate(noise)))


def variance_of(covariance: Covariance, sensitivity: Sparse) -> Array:
    """Return the variance H P H' (n,) of a scalar measurement with derivatives H {index: (n,)}, without its noise."""
    size, given = size_of(covariance.shape[-2]), list(sensitivity.items())
    parts = []
    for a, (i, first) in enumerate(given):
        for j, second in given[a:]:
            share = first * second * covariance[place_of(i, j, size)]
            parts.append(share if i == j else share + share)
    return _sum(parts)


def crossed(covariance: Covariance, scalars: Sequence[Measured]) -> list[Array]:
    """Return, for each scalar measurement, its covariance P H' (m, n) with all m error states."""
    return [times(covariance, scalar.sensitivity) for scalar in scalars]


def corrected(
    covariance: Covariance,
    errors: Array,
    scalars: Sequence[Measured],
    used: Array,
    known: Sequence[Array] | None = None,
) -> tuple[Covariance, Array]:
    """Return covariance and mean errors after a sequence of scalar Kalman updates, where ``used`` (n,) is True.

    Args:
        covariance: before.
        errors: the mean of each error, (m, n), by the measurements of this instant so far.
        scalars: the measurements.
        used: (n,) bool; where False, nothing changes.
        known: ``crossed`` of them, if it has been computed.
    """
    columns: list[Array] = []
    for scalar, column in zip(scalars, crossed(covariance, scalars) if known is None else known, strict=True):
        # As if the covariance had been changed by those before it.
        for other in columns:
            column = column - other * expected(other, scalar.sensitivity)[None]
        own = expected(column, scalar.sensitivity)
        left = jnp.where(used, scalar.innovation - expected(errors, scalar.sensitivity), 0.0)
        # Both factors of the square get the root.
        scale = jnp.where(used, 1.0 / jnp.sqrt(own + scalar.variance), 0.0)
        column = column * scale[None]
        errors = errors + column * (left * scale)[None]
        columns.append(column)
    return lowered(covariance, columns), errors


def expected(errors: Array, sensitivity: Sparse) -> Array:
    """Return the first-order change (n,) of a scalar measurement for errors (m, n), by derivatives ``sensitivity``."""
    return _sum([factor * errors[k] for k, factor in sensitivity.items()])


def forgotten(covariance: Covariance, variances: Sparse, where: Array) -> Covariance:
    """Return the covariance with errors in ``variances`` {index: (n,)} decorrelated and reset where ``where`` (n,)."""
    size = size_of(covariance.shape[-2])
    rows, columns = np.triu_indices(size)
    gone = np.isin(rows, list(variances)) | np.isin(columns, list(variances))
    left = jnp.where(where[None] & jnp.asarray(gone)[:, None], 0.0, covariance)
    return widened(left, {k: jnp.where(where, variance, 0.0) for k, variance in variances.items()})


def widened(covariance: Covariance, variances: Sparse) -> Covariance:
    """Return the covariance with ``variances`` {index of the error: (n,)} added on its diagonal."""
    return transformed(covariance, (), (), variances)
