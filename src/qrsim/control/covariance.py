"""Covariances of many vehicles at once, (m, m, n): what an estimator of n vehicles does to them in every tick.

Measurements are scalars and sparse, so that nothing has to be inverted; transitions are handed in as functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jax import Array

# Factors (n,) of errors by their numbers.
Sparse: TypeAlias = Mapping[int, Array]


def diagonal(variances: Sequence[Array]) -> Array:
    """Return the covariance (m, m, n) of independent errors of given variances (n,)."""
    return _eye(len(variances)) * jnp.stack(variances)[:, None]


def propagated(covariance: Array, transition: Callable[[Array], Array], noise: Sequence[Array]) -> Array:
    """Return F P F' + Q, where the first k errors move and all others stay what they are.

    Args:
        covariance: P, (m, m, n).
        transition: returns the first k rows of F X for X (m, l, n).
        noise: the diagonal of Q, m times (n,).
    """
    above = transition(covariance)
    moving = above.shape[0]
    corner = transition(jnp.swapaxes(above, 0, 1))
    # What rounding leaves of a part that is not symmetric would grow: measurements do not see it.
    corner = 0.5 * (corner + jnp.swapaxes(corner, 0, 1))
    beside = above[:, moving:]
    below = jnp.concatenate([jnp.swapaxes(beside, 0, 1), covariance[moving:, moving:]], axis=1)
    return jnp.concatenate([jnp.concatenate([corner, beside], axis=1), below]) + diagonal(noise)


def variance_of(covariance: Array, sensitivity: Sparse) -> tuple[Array, Array]:
    """Return P H' (m, n) and H P H' (n,) of a scalar measurement with the sensitivities H."""
    crossed = _sum([factor[None] * covariance[k] for k, factor in sensitivity.items()])
    return crossed, _sum([factor * crossed[k] for k, factor in sensitivity.items()])


def corrected(
    covariance: Array, errors: Array, sensitivity: Sparse, innovation: Array, variance: Array, used: Array
) -> tuple[Array, Array]:
    """Return covariance (m, m, n) and errors (m, n) after a scalar measurement (Kalman 1960).

    Args:
        covariance: before.
        errors: the mean of each error, by the measurements of this instant so far.
        sensitivity: of the measurement to the errors.
        innovation: measurement minus its prediction, were all errors zero (n,).
        variance: of its noise (n,).
        used: (n,) bool; where False, nothing changes.
    """
    crossed, own = variance_of(covariance, sensitivity)
    left = jnp.where(used, innovation - expected(errors, sensitivity), 0.0)
    gains = crossed * jnp.where(used, 1.0 / (own + variance), 0.0)[None]
    return covariance - gains[:, None] * crossed[None], errors + gains * left[None]


def expected(errors: Array, sensitivity: Sparse) -> Array:
    """Return what errors (m, n) make of a scalar measurement (n,)."""
    return _sum([factor * errors[k] for k, factor in sensitivity.items()])


def forgotten(covariance: Array, variances: Mapping[int, Array], where: Array) -> Array:
    """Return a covariance in which some errors are independent of all others, with new variances, where (n,) bool."""
    size = len(covariance)
    kept = np.array([float(i not in variances) for i in range(size)])
    zero = jnp.zeros_like(covariance[0, 0])
    mask = jnp.asarray(kept[:, None] * kept, covariance.dtype)[:, :, None]
    fresh = mask * covariance + diagonal([variances.get(i, zero) for i in range(size)])
    return jnp.where(where[None, None], fresh, covariance)


def _sum(parts: Sequence[Array]) -> Array:
    found = parts[0]
    for part in parts[1:]:
        found = found + part
    return found


def _eye(size: int) -> Array:
    return jnp.asarray(np.eye(size)[:, :, None], jnp.float32)
