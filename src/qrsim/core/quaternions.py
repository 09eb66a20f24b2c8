"""Unit quaternions with one array per component: attitudes without a singularity and without trigonometry."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2, sincos
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Euler, Rotation, Vec3


@record
class Quaternion:
    """A unit quaternion, each component of any common shape; it takes body axes to NED."""

    w: Array = quantity(unit="1", doc="cosine of half the angle")
    x: Array = quantity(unit="1", doc="first axis")
    y: Array = quantity(unit="1", doc="second axis")
    z: Array = quantity(unit="1", doc="third axis")

    def __mul__(self, other: Quaternion) -> Quaternion:
        """Return Hamilton's product."""
        a, b = self, other
        return Quaternion(
            a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
        )

    def conjugate(self) -> Quaternion:
        """Return the conjugate, the inverse rotation of a unit quaternion."""
        return Quaternion(self.w, -self.x, -self.y, -self.z)

    def rate(self, rates_body: Vec3) -> Quaternion:
        """Return the quaternion's time derivative [1/s] for body rates [rad/s]."""
        p, q, r = 0.5 * rates_body.x, 0.5 * rates_body.y, 0.5 * rates_body.z
        return Quaternion(
            -self.x * p - self.y * q - self.z * r,
            self.w * p + self.y * r - self.z * q,
            self.w * q + self.z * p - self.x * r,
            self.w * r + self.x * q - self.y * p,
        )

    def normalised(self) -> Quaternion:
        """Return the quaternion scaled to unit length."""
        scale = 1.0 / jnp.sqrt(self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z)
        return Quaternion(self.w * scale, self.x * scale, self.y * scale, self.z * scale)

    def rotation(self) -> Rotation:
        """Return the direction cosines: the body axes as unit vectors in NED."""
        w, x, y, z = self.w, self.x, self.y, self.z
        xx, yy, zz = x * x, y * y, z * z
        xy, xz, yz, wx, wy, wz = x * y, x * z, y * z, w * x, w * y, w * z
        return Rotation(
            Vec3(1.0 - 2.0 * (yy + zz), 2.0 * (xy + wz), 2.0 * (xz - wy)),
            Vec3(2.0 * (xy - wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz + wx)),
            Vec3(2.0 * (xz + wy), 2.0 * (yz - wx), 1.0 - 2.0 * (xx + yy)),
        )

    def euler(self) -> Euler:
        """Return the ZYX Euler angles [rad]; at a pitch of 90 degrees only roll and yaw together are defined."""
        turned = self.rotation()
        forward = turned.forward
        # The length is that of the cosine of the pitch, so that the angle is exact near 90 degrees too.
        level = jnp.sqrt(jnp.maximum(forward.x * forward.x + forward.y * forward.y, 1e-30))
        return Euler(arctan2(turned.right.z, turned.down.z), arctan2(-forward.z, level), arctan2(forward.y, forward.x))

    @staticmethod
    def of(attitude: Euler) -> Quaternion:
        """Return the unit quaternion of ZYX Euler angles [rad]."""
        sr, cr = sincos(0.5 * attitude.roll)
        sp, cp = sincos(0.5 * attitude.pitch)
        sy, cy = sincos(0.5 * attitude.yaw)
        return Quaternion(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )

    @staticmethod
    def of_tilt(roll: Array, pitch: Array) -> Quaternion:
        """Return the unit quaternion of roll and pitch [rad] at yaw 0."""
        sr, cr = sincos(0.5 * roll)
        sp, cp = sincos(0.5 * pitch)
        return Quaternion(cr * cp, sr * cp, cr * sp, -sr * sp)
