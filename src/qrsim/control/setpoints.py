"""Estimates and set-points of controllers; every field is (n,)."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Euler, Vec3


def library(*values: object) -> Any:
    """Return the module jax.numpy if any value is a JAX array, else NumPy."""
    return jnp if any(isinstance(value, Array) for value in values) else np


def number(values: object) -> Any:
    """Return values as an array of floats, of the library and floating dtype of ``values``."""
    lib = library(values)
    array = lib.asarray(values)
    return array if lib.issubdtype(array.dtype, lib.floating) else array.astype(float)


def axes(array: Any, count: int = 3) -> Any:
    """Return an array (..., count) split along its last axis, as a Vec3 for 3, else a tuple; raise ValueError."""
    array = number(array)
    if array.ndim == 0 or array.shape[-1] != count:
        raise ValueError(f"expected an array (..., {count}), found shape {array.shape}")
    parts = [array[..., axis] for axis in range(count)]
    return Vec3(*parts) if count == 3 else tuple(parts)


def like(array: Any, value: Any) -> Any:
    """Return a value broadcast to an array's shape and converted to its dtype."""
    lib = library(array, value)
    return lib.broadcast_to(lib.asarray(value, array.dtype), array.shape)


@record
class Estimate:
    """A controller's estimate of each vehicle (n,): the truth, or from sensors, or from a user's filter."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    attitude: Euler = quantity(unit="rad", doc="Euler angles")
    position_low_ned: Vec3 | None = quantity(
        default=None, unit="m", doc="remainder of the position beyond single precision; None if unknown"
    )
    airspeed: Array | None = quantity(
        default=None, unit="m/s", doc="airspeed; None for a controller that does not use it"
    )

    def offset_from(self, place_ned: Vec3) -> Vec3:
        """Return the position minus ``place_ned`` (n,) [m], exact for small differences of large coordinates."""
        offset = self.position_ned - place_ned
        return offset if self.position_low_ned is None else offset + self.position_low_ned

    @staticmethod
    def of(position_ned: object, velocity_ned: object, attitude: object) -> Estimate:
        """Return an estimate from arrays (n, 3), NumPy or JAX: position [m], velocity [m/s], roll, pitch, yaw [rad]."""
        angles = axes(attitude)
        return Estimate(axes(position_ned), axes(velocity_ned), Euler(angles.x, angles.y, angles.z))


@record
class WaypointSetpoint:
    """Position and heading, (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="waypoint")
    yaw: Array = quantity(unit="rad", doc="heading")

    @staticmethod
    def of(position_ned: object, yaw_rad: object = 0.0) -> WaypointSetpoint:
        """Return a set-point from positions (n, 3) [m] and headings (n,), or one for all, [rad]; NumPy or JAX."""
        position = axes(position_ned)
        return WaypointSetpoint(position, like(position.x, yaw_rad))


@record
class PathSetpoint:
    """A point of a path, (n,): its position, velocity and acceleration (feed-forwards), and a heading.

    Where ``level`` is set, a vehicle with feet that touches the ground is not to lean. Where ``idle`` is set, one that
    has landed is to stay on the ground with idle motors. Where ``blind`` is set, a vehicle without a position flies at
    the vertical velocity without leaning, and drifts with the wind.
    """

    position_ned: Vec3 = quantity(unit="m", doc="point of the path")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity along the path, over ground")
    acceleration_ned: Vec3 = quantity(unit="m/s^2", doc="acceleration along the path")
    yaw: Array = quantity(unit="rad", doc="heading")
    idle: Array | None = quantity(default=None, doc="bool: motors idle; None: they never are")
    level: Array | None = quantity(default=None, doc="bool: it stays level; None: it tilts as its motion requires")
    blind: Array | None = quantity(default=None, doc="bool: level flight after a lost position; None: none is")

    @staticmethod
    def of(
        position_ned: object,
        velocity_ned: object = (0.0, 0.0, 0.0),
        acceleration_ned: object = (0.0, 0.0, 0.0),
        yaw_rad: object = 0.0,
    ) -> PathSetpoint:
        """Return a set-point from arrays (n, 3), or (3,) for all, [m], [m/s], [m/s^2], and headings [rad]."""
        position = axes(position_ned)

        def each(values: object) -> Vec3:
            """Return rows (n, 3), or one row (3,) for all, as a vector of arrays (n,)."""
            wanted: Vec3 = axes(values)
            return wanted.map(lambda axis: like(position.x, axis))

        return PathSetpoint(position, each(velocity_ned), each(acceleration_ned), like(position.x, yaw_rad))


@record
class TrackSetpoint:
    """A straight line to fly or drive along, or a circle to go round, (n,), for rovers and fixed wings."""

    begin_ned: Vec3 = quantity(
        unit="m", doc="start of the line; equal to the end: fly straight there; unused for a circle"
    )
    position_ned: Vec3 = quantity(unit="m", doc="end of the line, or centre of the circle; with the height")
    radius: Array = quantity(unit="m", doc="radius of the circle, positive clockwise from above; 0: a line")
    speed: Array = quantity(
        unit="m/s", doc="speed along the path, for a fixed wing its airspeed; 0: that of the controller"
    )
    stops: Array = quantity(unit="1", doc="1: stop at the end of the line, if the vehicle can; 0: continue")

    @staticmethod
    def line(begin_ned: object, end_ned: object, speed: object = 0.0, stops: object = 0.0) -> TrackSetpoint:
        """Return a set-point of lines between positions (n, 3) [m] at speeds [m/s]; ``stops`` 1: stop; NumPy or JAX."""
        begin, end = axes(begin_ned), axes(end_ned)
        return TrackSetpoint(begin, end, like(end.x, 0.0), like(end.x, speed), like(end.x, stops))

    @staticmethod
    def orbit(centre_ned: object, radius: object, speed: object = 0.0) -> TrackSetpoint:
        """Return a set-point of circles: centres (n, 3) [m], radii, clockwise positive, speeds [m/s]; NumPy or JAX."""
        centre = axes(centre_ned)
        return TrackSetpoint(centre, centre, like(centre.x, radius), like(centre.x, speed), like(centre.x, 0.0))


@record
class VelocitySetpoint:
    """Velocity and heading, (n,)."""

    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    yaw: Array = quantity(unit="rad", doc="heading")

    @staticmethod
    def of(velocity_ned: object, yaw_rad: object = 0.0) -> VelocitySetpoint:
        """Return a set-point from velocities (n, 3) [m/s] and headings (n,), or one for all, [rad]; NumPy or JAX."""
        velocity = axes(velocity_ned)
        return VelocitySetpoint(velocity, like(velocity.x, yaw_rad))


@record
class VelocityHeightSetpoint:
    """Horizontal velocity, height and heading, (n,)."""

    velocity_north: Array = quantity(unit="m/s", doc="velocity over ground, north")
    velocity_east: Array = quantity(unit="m/s", doc="velocity over ground, east")
    z: Array = quantity(unit="m", doc="position down: -10 is 10 m above the origin of the local frame")
    yaw: Array = quantity(unit="rad", doc="heading")

    @staticmethod
    def of(velocity_north_east: object, z: object, yaw_rad: object = 0.0) -> VelocityHeightSetpoint:
        """Return a set-point from north and east velocities (n, 2) [m/s], down [m] and heading [rad], (n,) or one."""
        north, east = axes(velocity_north_east, 2)
        return VelocityHeightSetpoint(north, east, like(north, z), like(north, yaw_rad))


@record
class AttitudeHeightSetpoint:
    """Tilt as commanded to the platform's own stabilisation, height and heading, (n,).

    The identified platform settles at 0.745 of a tilt command (docs/explanation/models/control.md).
    """

    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    z: Array = quantity(unit="m", doc="position down: -10 is 10 m above the origin of the local frame")
    yaw: Array = quantity(unit="rad", doc="heading")

    @staticmethod
    def of(roll_rad: object, pitch_rad: object, z: object, yaw_rad: object = 0.0) -> AttitudeHeightSetpoint:
        """Return a set-point from roll (n,) [rad], pitch [rad], down coordinate [m], heading [rad], (n,) or one."""
        roll = number(roll_rad)
        return AttitudeHeightSetpoint(roll, like(roll, pitch_rad), like(roll, z), like(roll, yaw_rad))


@record
class AttitudeSetpoint:
    """Tilt as commanded to the platform's own stabilisation, normalised thrust and heading, (n,)."""

    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    yaw: Array = quantity(unit="rad", doc="heading")
    throttle: Array = quantity(unit="1", doc="normalised thrust, 0 to 1")

    @staticmethod
    def of(roll_rad: object, pitch_rad: object, yaw_rad: object, throttle: object) -> AttitudeSetpoint:
        """Return a set-point from roll (n,) [rad], pitch [rad], heading [rad] and thrust [0, 1], each (n,) or one."""
        roll = number(roll_rad)
        return AttitudeSetpoint(roll, like(roll, pitch_rad), like(roll, yaw_rad), like(roll, throttle))


@record
class OffboardSetpoint:
    """A set-point of any kind, (n,): NaN in the fields that its kind leaves free."""

    position_ned: Vec3 = quantity(unit="m", doc="waypoint")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    z: Array = quantity(unit="m", doc="position down: -10 is 10 m above the origin of the local frame")
    roll: Array = quantity(unit="rad", doc="commanded roll")
    pitch: Array = quantity(unit="rad", doc="commanded pitch")
    yaw: Array = quantity(unit="rad", doc="heading")
    throttle: Array = quantity(unit="1", doc="normalised thrust, 0 to 1")

    @staticmethod
    def of(setpoint: Setpoint) -> OffboardSetpoint:
        """Return a set-point of any kind as one record with the fields of all kinds, NaN in unused ones."""
        none = jnp.full_like(setpoint.yaw, math.nan)
        nowhere = Vec3(none, none, none)
        given = vars(setpoint)
        velocity = given.get("velocity_ned", nowhere)
        if isinstance(setpoint, VelocityHeightSetpoint):
            velocity = Vec3(setpoint.velocity_north, setpoint.velocity_east, none)
        others = [given.get(name, none) for name in ("z", "roll", "pitch", "yaw", "throttle")]
        return OffboardSetpoint(given.get("position_ned", nowhere), velocity, *others)


Setpoint = (
    WaypointSetpoint
    | VelocitySetpoint
    | VelocityHeightSetpoint
    | AttitudeHeightSetpoint
    | AttitudeSetpoint
    | PathSetpoint
)
# By the name that controllers and guidance of their kind have in a scenario.
SETPOINTS: dict[str, type] = {
    "waypoint": WaypointSetpoint,
    "velocity": VelocitySetpoint,
    "velocity_height": VelocityHeightSetpoint,
    "attitude_height": AttitudeHeightSetpoint,
    "attitude": AttitudeSetpoint,
    "path": PathSetpoint,
    "track": TrackSetpoint,
}
