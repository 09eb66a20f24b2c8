"""Errors that no reading shows the Kalman filter: considered in what it reports, and not estimated (F6).

The covariance of the filter is that of its errors against its sensors. What the sensors have in common with the
estimate cannot be learned from them: the slow error of the fixes is one of the position, and an accelerometer that is
not square to the body leans the estimate with it. These errors are independent of the rest, as those of a
Schmidt-Kalman filter whose cross-covariances are zero (Schmidt 1966).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.control.covariance import Sparse
from qrsim.control.kalman_state import ACCELEROMETER, PLACE, TURN, KalmanState, body_axes


class Unseen(NamedTuple):
    """An error that is not estimated: its variance (n,), and how the errors of the filter depend on it."""

    variance: Array
    factors: dict[int, Array]


def unseen(state: KalmanState, scale: Array, gravity: Array) -> list[Unseen]:
    """Return the slow errors of the position, and the lean of an accelerometer with errors of ``scale`` [1]."""
    one = jnp.ones_like(state.since_fix)
    found = [] if state.slow is None else [
        Unseen(variance, {PLACE + i: one}) for i, variance in enumerate(state.slow.axes)
    ]  # fmt: skip
    # Its part along a level axis of the body is that of gravity and looks like a tilt.
    for i, axis in enumerate(body_axes(state.rotation)[:2]):
        lean = {TURN: axis.y, TURN + 1: -axis.x, ACCELEROMETER + i: one * gravity}
        found.append(Unseen(one * scale * scale, lean))
    return found


def along(errors: Sequence[Unseen], sensitivity: Sparse) -> Array:
    """Return the variance (n,) that unseen errors add to a sum of errors with these factors."""
    total: Array | float = 0.0
    for error in errors:
        shared = [factor * error.factors[k] for k, factor in sensitivity.items() if k in error.factors]
        if shared:
            total = total + error.variance * jnp.square(sum(shared[1:], shared[0]))
    return jnp.asarray(total)


def with_unseen(covariance: Array, errors: Sequence[Unseen]) -> Array:
    """Return the covariance (m, m, n) with that of unseen errors."""
    size = covariance.shape[-2]
    for variance, factors in errors:
        zero = jnp.zeros_like(variance)
        std = jnp.sqrt(variance)
        column = jnp.stack([std * factors[k] if k in factors else zero for k in range(size)], axis=-2)
        covariance = covariance + column[..., :, None, :] * column[..., None, :, :]
    return covariance
