"""State of a fixed wing."""

from __future__ import annotations

from jax import Array

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3


@record
class Surfaces:
    """Angles of the control surfaces; each array of shape (n,)."""

    elevator: Array = quantity(unit="rad", doc="trailing edge down positive")
    aileron: Array = quantity(unit="rad", doc="rolling to the right positive")
    rudder: Array = quantity(unit="rad", doc="trailing edge to the left positive")


@record
class Stabiliser:
    """State of the stabiliser; each array of shape (n,)."""

    roll_integral: Array = quantity(unit="rad", doc="aileron by the integrated roll error")
    pitch_integral: Array = quantity(unit="rad", doc="elevator by the integrated pitch error")
    mean_yaw_rate: Array = quantity(unit="rad/s", doc="slow part of the yaw rate, which the rudder leaves alone")


@record
class FixedWingState:
    """The state of n fixed wings; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position of the centre of mass")
    quaternion: Quaternion = quantity(unit="1", doc="attitude, body to NED")
    velocity_body: Vec3 = quantity(unit="m/s", doc="velocity over ground in body axes (u, v, w)")
    rates_body: Vec3 = quantity(unit="rad/s", doc="body rates (p, q, r)")
    surfaces: Surfaces = quantity(doc="deflections of the control surfaces")
    stabiliser: Stabiliser = quantity(doc="state of the stabiliser")
    airspeed: Array = quantity(unit="m/s", doc="speed through the air at the end of the last step")
    angle_of_attack: Array = quantity(unit="rad", doc="angle of attack at the end of the last step")
    sideslip: Array = quantity(unit="rad", doc="sideslip at the end of the last step, positive from the right")
    thrust: Array = quantity(unit="N", doc="thrust of the propeller at the end of the last step")


@record
class Motion:
    """The part of a state that is integrated, from the place where a step began; each array of shape (n,)."""

    displacement: Vec3 = quantity(unit="m", doc="since the step began, NED")
    quaternion: Quaternion = quantity(unit="1", doc="attitude")
    velocity: Vec3 = quantity(unit="m/s", doc="in body axes")
    rates: Vec3 = quantity(unit="rad/s", doc="in body axes")
