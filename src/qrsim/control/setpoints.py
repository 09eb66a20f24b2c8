"""What a controller knows (Estimate) and what it can be asked for (set-points); every field is (n,)."""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Euler, Vec3


@record
class Estimate:
    """What a controller knows of each vehicle (n,): the truth, what the sensors say, or what a user's filter says."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    attitude: Euler = quantity(unit="rad", doc="Euler angles")


@record
class WaypointSetpoint:
    """Where to be and which way to look, (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="waypoint")
    yaw: Array = quantity(unit="rad", doc="heading")


@record
class VelocitySetpoint:
    """Which way to move and to look, (n,)."""

    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    yaw: Array = quantity(unit="rad", doc="heading")


@record
class VelocityHeightSetpoint:
    """Which way to move in the horizontal, at which height, and which way to look, (n,)."""

    velocity_north: Array = quantity(unit="m/s", doc="velocity over ground, north")
    velocity_east: Array = quantity(unit="m/s", doc="velocity over ground, east")
    height: Array = quantity(unit="m", doc="height above the origin of the local frame, positive up")
    yaw: Array = quantity(unit="rad", doc="heading")


@record
class AttitudeHeightSetpoint:
    """Tilt as commanded to the platform's own stabilisation, height and heading, (n,).

    The identified platform settles at 0.745 of a tilt command (models.md section 2).
    """

    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    height: Array = quantity(unit="m", doc="height above the origin of the local frame, positive up")
    yaw: Array = quantity(unit="rad", doc="heading")


@record
class AttitudeSetpoint:
    """Tilt as commanded to the platform's own stabilisation, normalised thrust and heading, (n,)."""

    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    yaw: Array = quantity(unit="rad", doc="heading")
    throttle: Array = quantity(unit="1", doc="normalised thrust, 0 to 1")


@record
class OffboardSetpoint:
    """A set-point of any kind, (n,): NaN is what its kind does not ask for."""

    position_ned: Vec3 = quantity(unit="m", doc="waypoint")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    height: Array = quantity(unit="m", doc="height above the origin of the local frame, positive up")
    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    yaw: Array = quantity(unit="rad", doc="heading")
    throttle: Array = quantity(unit="1", doc="normalised thrust, 0 to 1")

    @staticmethod
    def of(setpoint: Setpoint) -> OffboardSetpoint:
        """Return a set-point with the fields of every kind."""
        none = jnp.full_like(setpoint.yaw, math.nan)
        nowhere = Vec3(none, none, none)
        velocity = getattr(setpoint, "velocity_ned", nowhere)
        if isinstance(setpoint, VelocityHeightSetpoint):
            velocity = Vec3(setpoint.velocity_north, setpoint.velocity_east, none)
        others = [getattr(setpoint, name, none) for name in ("height", "roll", "pitch", "yaw", "throttle")]
        return OffboardSetpoint(getattr(setpoint, "position_ned", nowhere), velocity, *others)


Setpoint = WaypointSetpoint | VelocitySetpoint | VelocityHeightSetpoint | AttitudeHeightSetpoint | AttitudeSetpoint
# By the name that controllers and guidance of their kind have in a scenario.
SETPOINTS: dict[str, type] = {
    "waypoint": WaypointSetpoint,
    "velocity": VelocitySetpoint,
    "velocity_height": VelocityHeightSetpoint,
    "attitude_height": AttitudeHeightSetpoint,
    "attitude": AttitudeSetpoint,
}
