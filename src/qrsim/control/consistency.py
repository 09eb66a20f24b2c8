"""Consistency of an estimator: its errors compared with its covariance, as normalised estimation errors squared.

See docs/explanation/consistency.md.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Euler, Vec3

# Variance that is left of an error of variance 1 once others are known: less is rounding, in single precision.
LEAST = 1e-6


@record
class Truth:
    """True values with which an estimate is compared, (n,) or (T, n)."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    attitude: Euler = quantity(unit="rad", doc="Euler angles")
    position_low_ned: Vec3 | None = quantity(
        default=None, unit="m", doc="remainder of the position beyond single precision; None in double precision"
    )
    gyroscope_bias: Vec3 | None = quantity(default=None, unit="rad/s", doc="error of the body rates; None if unknown")
    accelerometer_bias: Vec3 | None = quantity(
        default=None, unit="m/s^2", doc="error of the specific force, body axes; None if unknown"
    )


@record
class Consistency:
    """ANEES of each block: the square of its errors over what is stated, per error; 1 is expected (Li et al. 2002).

    Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4.
    """

    every: Array = quantity(unit="1", doc="NEES of all errors that are known")
    position: Array = quantity(unit="1", doc="NEES of the position")
    velocity: Array = quantity(unit="1", doc="NEES of the velocity")
    attitude: Array = quantity(unit="1", doc="NEES of the attitude")
    bias: Array = quantity(unit="1", doc="NEES of the biases of gyroscope and accelerometer; NaN if unknown")


def normalised(covariance: Array, errors: Array) -> Array:
    """Return the normalised estimation error squared e' P^-1 e, divided by the number m of errors, (..., n).

    Args:
        covariance: P, (..., m, m, n).
        errors: e, (..., m, n).
    """
    count = errors.shape[-2]
    scale = 1.0 / jnp.sqrt(jnp.stack([covariance[..., i, i, :] for i in range(count)], axis=-2))
    left, rest = errors * scale, covariance * scale[..., :, None, :] * scale[..., None, :, :]
    total: Array | float = 0.0
    for _ in range(count):
        own = jnp.maximum(rest[..., 0, 0, :], LEAST)
        share = left[..., 0, :] / own
        total = total + left[..., 0, :] * share
        column = rest[..., 1:, 0, :]
        left = left[..., 1:, :] - column * share[..., None, :]
        rest = rest[..., 1:, 1:, :] - column[..., :, None, :] * (column / own[..., None, :])[..., None, :, :]
    return jnp.asarray(total) * (1.0 / count)


def turned(true: Euler, estimated: Quaternion) -> Vec3:
    """Return the small rotation vector (n,) NED [rad] that takes the estimated attitude to the true one."""
    between = Quaternion.of(true) * estimated.conjugate()
    twice = jnp.where(between.w < 0.0, -2.0, 2.0)
    return Vec3(twice * between.x, twice * between.y, twice * between.z)


def of_blocks(covariance: Array, errors: list[Array], known_biases: bool) -> Consistency:
    """Return the NEES (..., n) of all errors, and of position, velocity, attitude and sensor biases separately."""

    def block(first: int, end: int) -> Array:
        """Return the NEES (..., n) of the errors with indices from ``first`` up to ``end``, exclusive."""
        return normalised(covariance[..., first:end, first:end, :], jnp.stack(errors[first:end], axis=-2))

    bias = block(9, 15) if known_biases else jnp.full_like(errors[0], jnp.nan)
    return Consistency(block(0, 15 if known_biases else 9), block(0, 3), block(3, 6), block(6, 9), bias)
