"""Base of rovers: they stay on the ground, which tilts them and carries their weight."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import arctan2, sincos
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import AttitudeTrig, Euler, Rotation, Vec3
from qrsim.models.vehicles.contracts import Around

Ground = Callable[[Vec3], tuple[Array, Vec3]]


@runtime_checkable
class Drives(Protocol):
    """A vehicle on wheels, as its controller sees it.

    Attributes:
        speed_max: largest speed (n,) [m/s].
    """

    speed_max: Array

    @abstractmethod
    def drive(self, speed: Array, curvature: Array) -> object:
        """Return the command (n,) for a speed [m/s] and a curvature [1/m], right positive, clipped to the limits."""


@record
class Plane:
    """Horizontal motion of a step, from the place and heading where it began; each array of shape (n,)."""

    north: Array = quantity(unit="m", doc="since the step began")
    east: Array = quantity(unit="m", doc="since the step began")
    heading: Array = quantity(unit="rad", doc="clockwise from north")


def ground_of(around: Around | None, like: Array) -> Ground:
    """Return the ground as a function from position to (down coordinate, normal); level at 0 m without ``around``."""
    if around is not None:
        return around.ground
    zero = jnp.zeros_like(like)
    return lambda place: (zero, Vec3(zero, zero, zero - 1.0))


def on_slope(heading: Array, normal: Vec3) -> Euler:
    """Return the attitude (n,) of a vehicle at a heading [rad] on a plane with an upward unit normal (n,) (eq. D6)."""
    sine, cosine = sincos(heading)
    pitch = arctan2(-(cosine * normal.x + sine * normal.y), -normal.z)
    # The right side is across the heading in the plane: its way down by its level part gives the roll.
    roll = arctan2((cosine * normal.y - sine * normal.x) * sincos(pitch)[1], -normal.z)
    return Euler(roll, pitch, heading)


def slope_rates(turned: Rotation, heading: tuple[Array, Array], forward: Array, right: Array) -> tuple[Array, Array]:
    """Return the velocity (n,) [m/s] north and east of body velocities, for a tilt and a heading's (sine, cosine).

    Args:
        turned: the tilt, as of a vehicle that heads north.
        heading: sine and cosine.
        forward, right: in body axes [m/s].
    """
    sine, cosine = heading
    ahead = turned.forward.x * forward + turned.right.x * right
    beside = turned.forward.y * forward + turned.right.y * right
    return cosine * ahead - sine * beside, sine * ahead + cosine * beside


def tilt_of(attitude: Euler) -> Rotation:
    """Return the rotation of an attitude with its yaw set to 0."""
    return AttitudeTrig.of(Euler(attitude.roll, attitude.pitch, jnp.zeros_like(attitude.yaw))).rotation()


def felt(turned: Rotation, gravity: Array, ahead: Array, beside: Array) -> Vec3:
    """Return the specific force (n,) [m/s^2] in body axes for accelerations (n,) forward and to the right."""
    weight = jnp.zeros_like(ahead) + gravity
    return Vec3(ahead - weight * turned.forward.z, beside - weight * turned.right.z, -weight * turned.down.z)


def set_down(position_ned: Vec3, heading: Array, ground: Ground) -> tuple[Vec3, Euler]:
    """Return position and attitude (n,) of a vehicle set on the ground below a position."""
    down, normal = ground(position_ned)
    return Vec3(position_ned.x, position_ned.y, down + jnp.zeros_like(position_ned.z)), on_slope(heading, normal)
