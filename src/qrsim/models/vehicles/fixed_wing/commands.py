"""Commands of fixed wings: attitude and throttle for the stabiliser, or the surfaces past it."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record

ROLL_MAX_RAD, PITCH_MAX_RAD = 1.0, 0.6
ELEVATOR_MAX_RAD, AILERON_MAX_RAD, RUDDER_MAX_RAD = 0.44, 0.5236, 0.35


@record
class AttitudeCommand:
    """Roll and pitch, which the aeroplane's own stabiliser holds, and throttle; each of shape (n,)."""

    roll: Array = quantity(
        unit="rad", doc="roll angle, right side down positive", minimum=-ROLL_MAX_RAD, maximum=ROLL_MAX_RAD
    )
    pitch: Array = quantity(
        unit="rad", doc="pitch angle, nose up positive", minimum=-PITCH_MAX_RAD, maximum=PITCH_MAX_RAD
    )
    throttle: Array = quantity(unit="1", doc="voltage of the motor over the largest", minimum=0.0, maximum=1.0)


@record
class SurfaceCommand:
    """Angles of the control surfaces, past the stabiliser, and throttle; each of shape (n,)."""

    elevator: Array = quantity(
        unit="rad", doc="trailing edge down positive: nose down", minimum=-ELEVATOR_MAX_RAD, maximum=ELEVATOR_MAX_RAD
    )
    aileron: Array = quantity(
        unit="rad",
        doc="half the difference, rolling to the right positive",
        minimum=-AILERON_MAX_RAD,
        maximum=AILERON_MAX_RAD,
    )
    rudder: Array = quantity(
        unit="rad", doc="trailing edge to the left positive: nose left", minimum=-RUDDER_MAX_RAD, maximum=RUDDER_MAX_RAD
    )
    throttle: Array = quantity(unit="1", doc="voltage of the motor over the largest", minimum=0.0, maximum=1.0)


def shown(command: Any) -> AttitudeCommand:
    """Return a fixed-wing command of any type as the record a world's state keeps, NaN in fields that it lacks."""
    if isinstance(command, AttitudeCommand):
        return command
    none = jnp.full_like(command.throttle, jnp.nan)
    return AttitudeCommand(none, none, command.throttle)
