"""The autopilot's inner loops: tilt and heading to body rates, body rates to torque, torque to rotor thrusts."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2, sincos
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import parameter, record
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.mixer import Mixer


@record
class Stabiliser:
    """Gains of the inner loops; a number, or one for each vehicle (n,)."""

    attitude_gain: Array = parameter(default=8.0, unit="1/s", doc="bandwidth of roll and pitch (w_a)", above=0.0)
    rate_gain: Array = parameter(
        default=24.0, unit="1/s", doc="bandwidth of roll and pitch rate; three times that of the angles", above=0.0
    )
    yaw_gain: Array = parameter(default=2.8, unit="1/s", doc="bandwidth of the heading", above=0.0)
    yaw_rate_gain: Array = parameter(default=8.0, unit="1/s", doc="bandwidth of the yaw rate", above=0.0)
    yaw_weight: Array = parameter(
        default=0.4, unit="1", doc="weight of the heading error relative to the tilt error", above=0.0, maximum=1.0
    )
    integral: Array = parameter(
        default=0.2, unit="1", doc="integral gain of roll and pitch rate over the square of the rate gain", minimum=0.0
    )
    yaw_integral: Array = parameter(
        default=0.1, unit="1", doc="integral gain of the yaw rate over the square of its gain", minimum=0.0
    )
    integral_limit: Array = parameter(
        default=0.3, unit="rad/s", doc="largest integral divided by the rate gain", minimum=0.0
    )
    rate_limit: Array = parameter(default=3.84, unit="rad/s", doc="largest commanded roll and pitch rate", above=0.0)
    yaw_rate_limit: Array = parameter(default=3.5, unit="rad/s", doc="largest commanded yaw rate", above=0.0)
    yaw_share: Array = parameter(
        default=0.15,
        unit="1",
        doc="share of a yaw torque that is kept when rotors saturate",
        minimum=0.0,
        maximum=1.0,
    )


def rates_wanted(gains: Stabiliser, attitude: Quaternion, wanted: Quaternion, yaw_rate: Array) -> Vec3:
    """Return the body rates (n,) [rad/s] that rotate ``attitude`` to ``wanted``, tilt first (eq. V28).

    D. Brescianini, M. Hehn, R. D'Andrea, "Nonlinear quadrocopter attitude control", ETH Zurich, 2013.

    Args:
        gains: parameters.
        attitude, wanted: of n vehicles.
        yaw_rate: about down [rad/s], added.
    """
    error = attitude.conjugate() * wanted
    # Of the two quaternions of a rotation the one below half a turn.
    sign = jnp.where(error.w < 0.0, -1.0, 1.0)
    w, z = error.w * sign, error.z * sign
    # The error is a tilt after a turn about body down; s is the cosine of half the tilt.
    s = jnp.maximum(jnp.sqrt(jnp.maximum(w * w + z * z, 1e-30)), 1e-6)
    x = (error.x * error.w - error.y * error.z) / s
    y = (error.y * error.w + error.x * error.z) / s
    sine, cosine = sincos(gains.yaw_weight * arctan2(z, w))
    tilt, turn = 2.0 * gains.attitude_gain, 2.0 * gains.yaw_gain / gains.yaw_weight
    down = attitude.rotation()
    limit, yaw_limit = gains.rate_limit, gains.yaw_rate_limit
    return Vec3(
        jnp.clip(tilt * (x * cosine + y * sine) + down.forward.z * yaw_rate, -limit, limit),
        jnp.clip(tilt * (y * cosine - x * sine) + down.right.z * yaw_rate, -limit, limit),
        jnp.clip(turn * (s * sine) + down.down.z * yaw_rate, -yaw_limit, yaw_limit),
    )


def rotor_thrusts(
    gains: Stabiliser,
    inertia: Vec3,
    mixer: Mixer,
    rates: Vec3,
    wanted: Vec3,
    integral: Vec3,
    thrust: Array,
    dt: float,
) -> tuple[list[Array], Vec3]:
    """Return each rotor's thrust (n,) [N] for wanted body rates [rad/s], and the rate loop's integral (eq. V29).

    Args:
        gains, inertia: parameters.
        mixer: shares out thrust and torque.
        rates, wanted: [rad/s].
        integral: of the rate loop [rad/s^2].
        thrust: collective [N].
        dt: until it is asked again [s].
    """
    error = wanted - rates
    rate, yaw_rate = gains.rate_gain, gains.yaw_rate_gain
    loop = Vec3(rate * error.x, rate * error.y, yaw_rate * error.z) + integral
    gyro = rates.cross(_by_axes(inertia, rates))
    torque = _by_axes(inertia, loop) + gyro
    torque = Vec3(torque.x, torque.y, torque.z * mixer.holds_yaw)
    thrusts = mixer.share(thrust, torque, gains.yaw_share)
    got = mixer.torque(thrusts)
    grow = (gains.integral * rate * rate, gains.integral * rate * rate, gains.yaw_integral * yaw_rate * yaw_rate)
    most = gains.integral_limit
    limits = (most * rate, most * rate, most * yaw_rate)
    missing = torque - got
    # In single precision a torque that is met differs from what is wanted by its rounding.
    slack = 1e-6 if thrust.dtype == jnp.float64 else 1e-4
    after = [
        _integrated(now, wrong, lack, slack * jnp.abs(asked), dt * gain, limit)
        for now, wrong, lack, asked, gain, limit in zip(
            integral.axes, error.axes, missing.axes, torque.axes, grow, limits, strict=True
        )
    ]
    return thrusts, Vec3(*after)


def _integrated(now: Array, error: Array, missing: Array, slack: Array, gain: Array, limit: Array) -> Array:
    """Return one axis' rate-loop integral after a step, clipped; held while rotors saturate in that direction."""
    held = (jnp.abs(missing) > slack + 1e-9) & (error * missing > 0.0)
    return jnp.clip(jnp.where(held, now, now + gain * error), -limit, limit)


def _by_axes(inertia: Vec3, vector: Vec3) -> Vec3:
    """Return the elementwise product of two vectors."""
    return Vec3(inertia.x * vector.x, inertia.y * vector.y, inertia.z * vector.z)
