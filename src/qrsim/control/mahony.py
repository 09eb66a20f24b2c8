"""Attitude from gyroscope and accelerometer, with a heading where there is one.

See docs/explanation/models/estimators.md, F8.

The explicit complementary filter of Mahony, Hamel and Pflimlin, "Nonlinear complementary filters on the special
orthogonal group", IEEE Transactions on Automatic Control 53, 2008, with the acceleration taken out by GNSS velocities.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2, wrap_angle
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import quantity, record, replace
from qrsim.core.vectors import Vec3


@record
class Turning:
    """State of the attitude filter, (n,)."""

    attitude: Quaternion = quantity(doc="estimated attitude")
    gyroscope_bias: Vec3 = quantity(unit="rad/s", doc="estimated error of the body rates")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates as last measured")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity of the last fix")
    acceleration_ned: Vec3 = quantity(unit="m/s^2", doc="by the last two fixes")
    since_fix: Array = quantity(unit="s", doc="time since the last velocity of a fix")
    since_heading: Array = quantity(unit="s", doc="time since the last heading")

    @staticmethod
    def start(attitude: Quaternion, velocity_ned: Vec3) -> Turning:
        """Return the attitude filter's initial state from an attitude and a velocity [m/s], with zero acceleration."""
        zero = jnp.zeros_like(velocity_ned.x)
        none = Vec3(zero, zero, zero)
        return Turning(attitude, none, none, velocity_ned, none, zero, zero)

    def waited(self, dt: float) -> Turning:
        """Return the state with dt [s] added to the times since the last velocity fix and the last heading."""
        return replace(self, since_fix=self.since_fix + dt, since_heading=self.since_heading + dt)

    def with_velocity(self, velocity_ned: Vec3, new: Array) -> Turning:
        """Return the state with the acceleration from the last two velocity fixes, where ``new`` (n,) is True."""
        for axis in velocity_ned.axes:
            new = new & jnp.isfinite(axis)
        change = (velocity_ned - self.velocity_ned) * (1.0 / jnp.maximum(self.since_fix, 1e-3))

        def chosen(now: Vec3, before: Vec3) -> Vec3:
            """Return ``now`` for vehicles with a new velocity, else ``before``."""
            return Vec3(*(jnp.where(new, a, b) for a, b in zip(now.axes, before.axes, strict=True)))

        return replace(
            self,
            velocity_ned=chosen(velocity_ned, self.velocity_ned),
            acceleration_ned=chosen(change, self.acceleration_ned),
            since_fix=jnp.where(new, 0.0, self.since_fix),
        )

    def tilt_error(self, force_body: Vec3, gravity: Array) -> Vec3:
        """Return the horizontal rotation (n,) NED [rad] that aligns measured with expected specific force."""
        felt = self.attitude.rotation().to_ned(force_body)
        down = self.acceleration_ned.z - gravity
        expected = replace(self.acceleration_ned, z=down)
        size = jnp.sqrt(jnp.maximum(felt.dot(felt) * expected.dot(expected), 1e-6))
        error = felt.cross(expected) * (1.0 / size)
        seen = jnp.isfinite(error.x) & jnp.isfinite(error.y)
        # About the vertical the specific force says nothing of use.
        return Vec3(jnp.where(seen, error.x, 0.0), jnp.where(seen, error.y, 0.0), jnp.zeros_like(error.z))

    def compass_error(self, field_body: Vec3, declination: Array) -> Array:
        """Return the yaw correction (n,) [rad] by a magnetometer reading, at a magnetic declination [rad]."""
        field = self.attitude.rotation().to_ned(field_body)
        return wrap_angle(declination - arctan2(field.y, field.x))

    def course_error(self, velocity_ned: Vec3, least: Array) -> Array:
        """Return course over ground minus yaw (n,) [rad], wrapped; NaN below a ground speed of ``least`` [m/s]."""
        fast = velocity_ned.x * velocity_ned.x + velocity_ned.y * velocity_ned.y > least * least
        course = arctan2(velocity_ned.y, velocity_ned.x)
        return jnp.where(fast, wrap_angle(course - self.attitude.euler().yaw), jnp.nan)

    def turned(self, rates_body: Vec3, correction: Vec3, learned: Vec3, dt: float) -> Turning:
        """Return the state with attitude and gyroscope bias advanced by dt [s], corrections applied.

        Args:
            rates_body: as measured now (n,) [rad/s]; with those of the last tick they are the mean of this one.
            correction: rotation (n,) in NED [rad] by which the attitude is put right.
            learned: what the bias is found to be too small by (n,), in NED [rad/s].
        """
        way = (0.5 * (rates_body + self.rates_body) - self.gyroscope_bias) * dt
        rotation = self.attitude.rotation()
        half = (way + rotation.to_body(correction)) * 0.5
        turn = Quaternion(jnp.ones_like(half.x), half.x, half.y, half.z)
        return replace(
            self,
            attitude=(self.attitude * turn).normalised(),
            rates_body=rates_body,
            gyroscope_bias=self.gyroscope_bias + rotation.to_body(learned),
        )
