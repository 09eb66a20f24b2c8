"""Start of the Kalman filter: calibrated, aligned at rest by its readings, or in flight with a drawn error (F7)."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Preflight
from qrsim.control.covariance import corrected, variances
from qrsim.control.kalman_parameters import KalmanParameters
from qrsim.control.kalman_readings import fields, gravities
from qrsim.control.kalman_state import TURN, KalmanState, injected, small, with_turn
from qrsim.control.reading_fields import FIELD, field_of, known
from qrsim.core.fastmath import arctan2
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3, root, rotation

# Standard normals of a start: the turn of the attitude, the gyroscope's bias, the Earth's field.
NORMALS = 9
# What is known of roll and pitch, and of the yaw by a compass, before the readings at rest [rad].
TILT_BEFORE, YAW_BEFORE = 0.3, 0.5
# Level fields of fewer stds of their bias than this show no heading.
WEAK = 5.0
# Time that a first reading is the mean of [s].
FIRST_S = 0.02


def turned_by(stds: tuple[Array, Array, Array], normals: tuple[Array, ...], attitude: Quaternion) -> Quaternion:
    """Return an attitude (n,) rotated by small random NED angles: standard deviations [rad] times standard normals."""
    return small(Vec3(*(0.5 * std * normal for std, normal in zip(stds, normals, strict=True)))) * attitude


def calibrated(kalman: KalmanParameters, preflight: Preflight | None) -> Vec3 | None:
    """Return the gyroscope bias (n,) [rad/s] found by averaging at rest before take-off; None without calibration."""
    if preflight is None or preflight.rates_bias is None or kalman.calibration_time == 0.0:
        return None
    std = kalman.gyroscope_calibrated_std
    normals = zip(preflight.rates_bias.axes, preflight.normals[3:6], strict=True)
    return Vec3(*(bias + std * normal for bias, normal in normals))


def levelled(kalman: KalmanParameters, state: KalmanState, readings: Mapping[str, object]) -> KalmanState:
    """Return the state of vehicles (n,) at rest, with tilt from the accelerometer and heading from the magnetometer."""
    force, field = field_of(readings, "specific_force"), field_of(readings, FIELD)
    if force is None:
        return state
    roll = arctan2(-force.y, -force.z)
    pitch = arctan2(force.x, root(force.y * force.y + force.z * force.z))
    before = state.attitude.euler()
    yaw, zero = before.yaw, jnp.zeros_like(roll)
    own = variances(state.covariance)[TURN + 2]
    if field is not None:
        level = rotation(Euler(roll, pitch, zero)).to_ned(field)
        # Near a magnetic pole a compass has no direction, and the yaw is known from elsewhere.
        strong = level.x * level.x + level.y * level.y > (WEAK * kalman.field_bias_std) ** 2
        yaw = jnp.where(strong, kalman.declination - arctan2(level.y, level.x), yaw)
        own = jnp.where(strong, YAW_BEFORE * YAW_BEFORE, own)
    attitude = Quaternion.of(known(Euler(roll, pitch, yaw), before))
    tilt = zero + TILT_BEFORE * TILT_BEFORE
    state = replace(state, attitude=attitude, covariance=with_turn(state.covariance, (tilt, tilt, own)))
    noise = kalman.accelerometer_noise
    scalars = gravities(state, force, kalman.gravity, zero + noise * noise * (1.0 / FIRST_S) + 1e-6)
    if field is not None and state.places.field is not None:
        scalars += fields(state, field, zero + kalman.field_std * kalman.field_std)
    errors = jnp.zeros((state.places.size, *zero.shape), zero.dtype)
    covariance = state.covariance
    for scalar in scalars:
        used = jnp.isfinite(scalar.innovation)
        covariance, errors = corrected(covariance, errors, [scalar], used)
    return injected(replace(state, covariance=covariance), errors, 0.0)
