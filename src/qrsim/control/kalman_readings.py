"""Measurement equations of the Kalman filter: innovations of single readings, and their sensitivities.

The scalars of docs/explanation/models/estimators.md, F2 to F5.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.control.covariance import Measured
from qrsim.control.kalman_state import ACCELEROMETER, PLACE, SPEED, TURN, KalmanState, Past, body_axes, of_angles, swung
from qrsim.core.fastmath import arctan2, sincos, wrap_angle
from qrsim.core.vectors import Euler, Vec3


def places(state: KalmanState, fix: Vec3, variances: tuple[Array, ...], axes: str, late: float) -> list[Measured]:
    """Return scalar measurements of a fix's position along ``axes`` ("xyz" or "xy"), made ``late`` [s] ago (eq. F2)."""
    then = _then(state)
    scalars = []
    for i, axis in enumerate(axes):
        miss = getattr(fix, axis) - getattr(then.position_ned, axis) - getattr(then.position_low_ned, axis)
        one = jnp.ones_like(miss)
        # An error of the velocity now was there then, too.
        back = {SPEED + i: -late * one} if state.past else {}
        scalars.append(Measured(miss, variances[i], {PLACE + i: one, **back}))
    return scalars


def velocities(state: KalmanState, velocity: Vec3, variances: tuple[Array, ...], late: float) -> list[Measured]:
    """Return the scalar measurements of the three axes of a fix's velocity, taken ``late`` [s] ago (eq. F2)."""
    then, turns = _then(state), swung(state.force_ned)
    body = zip(*(axis.axes for axis in body_axes(state.rotation)), strict=True)
    scalars = []
    for i, (axis, cosines) in enumerate(zip("xyz", body, strict=True)):
        back = {TURN + k: -late * factor for k, factor in turns[i].items()} if state.past else {}
        back |= {ACCELEROMETER + k: late * factor for k, factor in enumerate(cosines)} if state.past else {}
        miss = getattr(velocity, axis) - getattr(then.velocity_ned, axis)
        scalars.append(Measured(miss, variances[i], {SPEED + i: jnp.ones_like(miss), **back}))
    return scalars


def _then(state: KalmanState) -> Past:
    """Return the estimated position and velocity at the tick when the fix that arrives now was taken."""
    return state.past[0] if state.past else Past(state.position_ned, state.position_low_ned, state.velocity_ned)


def heights(state: KalmanState, height: Array, variance: Array) -> list[Measured]:
    """Return the scalar measurement, in a list, of a barometer's height (n,) [m], with its bias if estimated."""
    miss = -height - state.position_ned.z - state.position_low_ned.z
    one = jnp.ones_like(miss)
    at = state.places.height
    bias = state.inner.height_bias
    if at is None or bias is None:
        return [Measured(miss, variance, {PLACE + 2: one})]
    return [Measured(miss + bias, variance, {PLACE + 2: one, at: -one})]


def headings(state: KalmanState, attitude: Euler, variance: Array) -> list[Measured]:
    """Return the scalar measurement, in a list, of the yaw (n,) [rad] in an attitude reading."""
    miss = wrap_angle(attitude.yaw - state.attitude.euler().yaw)
    return [Measured(miss, variance, of_angles(state.rotation)[2])]


def fields(state: KalmanState, measured: Vec3, variance: Array) -> list[Measured]:
    """Return three scalar measurements of a magnetometer reading (n,) [uT] in body axes (eq. F3)."""
    earth, bias, at = state.inner.earth_field_ned, state.inner.field_bias, state.places
    assert earth is not None
    assert bias is not None
    assert at.field is not None
    assert at.field_bias is not None
    scalars = []
    for i, axis in enumerate(body_axes(state.rotation)):
        miss = measured.axes[i] - axis.dot(earth) - bias.axes[i]
        sensitivity = dict(enumerate(axis.cross(earth).axes, TURN))
        sensitivity |= dict(enumerate(axis.axes, at.field))
        sensitivity[at.field_bias + i] = jnp.ones_like(miss)
        scalars.append(Measured(miss, variance, sensitivity))
    return scalars


def gravities(state: KalmanState, force: Vec3, gravity: Array, variance: Array) -> list[Measured]:
    """Return scalar measurements of tilt and accelerometer bias by the specific force (n,) [m/s^2] at rest (eq. F7)."""
    zero = jnp.zeros_like(force.x)
    up = Vec3(zero, zero, zero - gravity)
    scalars = []
    for i, axis in enumerate(body_axes(state.rotation)):
        miss = force.axes[i] - axis.dot(up) - state.inner.accelerometer_bias.axes[i]
        sensitivity = dict(enumerate(axis.cross(up).axes, TURN)) | {ACCELEROMETER + i: jnp.ones_like(miss)}
        scalars.append(Measured(miss, variance, sensitivity))
    return scalars


def compass(state: KalmanState, measured: Vec3, declination: Array, variance: Array) -> list[Measured]:
    """Return the scalar measurement, in a list, of yaw by a magnetometer reading's level part (n,) (eq. F4)."""
    x, y, z = state.rotation.to_ned(measured).axes
    miss = wrap_angle(declination - arctan2(y, x))
    # Of a wrong tilt the vertical part of the field makes a wrong heading: by the direction that is known, because that
    # of the reading has the noise of ``miss``, from which the filter would learn a tilt that it does not measure.
    slope = z / jnp.sqrt(jnp.maximum(x * x + y * y, 1e-6))
    east, north = sincos(declination)
    return [Measured(miss, variance, {TURN: -north * slope, TURN + 1: -east * slope, TURN + 2: jnp.ones_like(slope)})]


def airspeeds(state: KalmanState, airspeed: Array, variance: Array) -> list[Measured]:
    """Return the scalar measurement, in a list, of an airspeed (n,) [m/s] along the body's forward axis (eq. F5)."""
    at = state.places.wind
    assert at is not None
    assert state.inner.wind_north is not None
    assert state.inner.wind_east is not None
    ahead, speed = state.rotation.forward, state.velocity_ned
    air = Vec3(speed.x - state.inner.wind_north, speed.y - state.inner.wind_east, speed.z)
    sensitivity = dict(enumerate(ahead.axes, SPEED)) | dict(enumerate(ahead.cross(air).axes, TURN))
    sensitivity |= {at: -ahead.x, at + 1: -ahead.y}
    return [Measured(airspeed - ahead.dot(air), variance, sensitivity)]
