"""State of a multirotor."""

from __future__ import annotations

from jax import Array

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3


@record
class Brush:
    """Deflection of the bristles of one contact point, 1 where they slide; each of shape (n,)."""

    north: Array = quantity(unit="1", doc="along the ground, northwards")
    east: Array = quantity(unit="1", doc="along the ground, eastwards")


@record
class MultirotorState:
    """The state of n multirotors; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position of the centre of mass")
    quaternion: Quaternion = quantity(unit="1", doc="attitude, body to NED")
    velocity_body: Vec3 = quantity(unit="m/s", doc="velocity over ground in body axes (u, v, w)")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates (p, q, r)")
    rotor_speed: tuple[Array, ...] = quantity(unit="rad/s", doc="speed of each rotor")
    yaw_setpoint: Array = quantity(unit="rad", doc="heading that the stabiliser holds")
    rate_integral: Vec3 = quantity(unit="rad/s^2", doc="integral of the stabiliser's rate loop")
    brush: tuple[Brush, ...] = quantity(unit="1", doc="friction of each contact point")
    standing: Array = quantity(unit="s", doc="how long all feet have borne at less than 0.1 m/s")
    impact_speed: Array = quantity(unit="m/s", doc="largest speed into the ground at a contact point in the last step")
    hub_contact: Array = quantity(unit="1", doc="1 if a rotor or the top touched the ground in the last step, else 0")


@record
class Motion:
    """The part of a state that is integrated, from the place where a step began; each array of shape (n,)."""

    displacement: Vec3 = quantity(unit="m", doc="since the step began, NED")
    quaternion: Quaternion = quantity(unit="1", doc="attitude")
    velocity: Vec3 = quantity(unit="m/s", doc="in body axes")
    rates: Vec3 = quantity(unit="rad/s", doc="in body axes")
    rotor_speed: tuple[Array, ...] = quantity(unit="rad/s", doc="speed of each rotor")
    brush: tuple[Brush, ...] = quantity(unit="1", doc="of each contact point; () far from the ground")


@record
class Ground:
    """The plane that replaces the ground during a step; each array of shape (n,)."""

    height: Array = quantity(unit="m", doc="of the centre of mass over it when the step began, along its normal")
    normal: Vec3 = quantity(unit="1", doc="upwards, NED")
    north: Vec3 = quantity(unit="1", doc="unit vector in the plane, northwards")
    east: Vec3 = quantity(unit="1", doc="unit vector in the plane, eastwards")
