"""Errors that no reading shows the Kalman filter: considered in what it reports, and not estimated (F6).

The covariance of the filter is that of its errors against its sensors. What the sensors have in common with the
estimate cannot be learned from them: the slow error of the fixes is one of the position, and an accelerometer that is
not square to the body leans the estimate with it. These errors are independent of the rest, as those of a
Schmidt-Kalman filter whose cross-covariances are zero (Schmidt 1966).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from qrsim.control.kalman_state import ACCELEROMETER, GYROSCOPE, PLACE, TURN, KalmanState, body_axes
from qrsim.core.tree import replace
from qrsim.core.vectors import Rotation, Vec3

# Time constant of the mean lean [s]: faster tilts turn back before a bias by the lean has turned the estimate.
LEAN_S = 20.0


class Unseen(NamedTuple):
    """An error that is not estimated: its variance (n,), and how the errors of the filter depend on it."""

    variance: Array
    factors: dict[int, Array]


def leaned(lean: Vec3, turned: Rotation, dt: float) -> tuple[Vec3, Array]:
    """Return the low-pass filtered down direction (n,) in body axes after dt [s], and its squared change in this time.

    The squares of the ticks that follow a sudden change add up to the square of that change.
    """
    away = Vec3(*(axis.z for axis in body_axes(turned))) - lean
    return lean + away * (dt / LEAN_S), away.dot(away) * (2.0 * dt / LEAN_S)


def unseen(state: KalmanState, scale: Array, sensitivity: Array, gravity: Array) -> list[Unseen]:
    """Return the errors that no sensor observes: variance and effect on each error state; NumPy for a NumPy state.

    Args:
        state: of the filter.
        scale: error of a specific force over it [1].
        sensitivity: of the gyroscope to the specific force [rad s/m].
        gravity: [m/s^2].
    """
    one = 0.0 * state.since_fix + 1.0
    found = (
        [] if state.slow is None else [Unseen(variance, {PLACE + i: one}) for i, variance in enumerate(state.slow.axes)]
    )
    # Its part along a level axis of the body is that of gravity and looks like a tilt.
    for i, axis in enumerate(body_axes(state.rotation)[:2]):
        lean = {TURN: axis.y, TURN + 1: -axis.x, ACCELEROMETER + i: one * gravity}
        found.append(Unseen(one * scale * scale, lean))
    # The biases are those of a level vehicle, and a lean changes them.
    away = replace(state.lean, z=state.lean.z - 1.0) * gravity
    square = away.dot(away)
    for first, std in ((GYROSCOPE, sensitivity), (ACCELEROMETER, scale)):
        found += [Unseen(square * std * std, {first + i: one}) for i in range(3)]
    return found


def along(errors: Sequence[Unseen], sensitivity: Mapping[int, Array | float]) -> Array | float:
    """Return the variance (n,) that unobserved errors add to a sum of error states weighted by ``sensitivity``."""
    total: Array | float = 0.0
    for error in errors:
        shared = [factor * error.factors[k] for k, factor in sensitivity.items() if k in error.factors]
        if shared:
            total = total + error.variance * sum(shared[1:], shared[0]) ** 2
    return total


def with_unseen(covariance: Array, errors: Sequence[Unseen]) -> Array:
    """Return the covariance (m, m, n) with that of the unobserved errors added."""
    size = covariance.shape[-2]
    for variance, factors in errors:
        zero = jnp.zeros_like(variance)
        std = jnp.sqrt(variance)
        column = jnp.stack([std * factors[k] if k in factors else zero for k in range(size)], axis=-2)
        covariance = covariance + column[..., :, None, :] * column[..., None, :, :]
    return covariance
