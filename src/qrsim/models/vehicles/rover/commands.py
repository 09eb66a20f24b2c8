"""Commands of rovers: a steering angle and a speed, or the speeds of the wheels of both sides."""

from __future__ import annotations

from jax import Array

from qrsim.core.tree import quantity, record

STEERING_MAX_RAD, SPEED_MAX_M_S = 0.8, 20.0


class DriveCommand:
    """Base of the commands of rovers; ``Drives.drive`` makes one of a speed and a curvature."""


@record
class SteeringCommand(DriveCommand):
    """Steering angle and speed, which the rover's own drives bring about; each of shape (n,)."""

    steering: Array = quantity(
        unit="rad",
        doc="angle of the front wheels, to the right positive",
        minimum=-STEERING_MAX_RAD,
        maximum=STEERING_MAX_RAD,
    )
    speed: Array = quantity(
        unit="m/s", doc="forward speed, negative backwards", minimum=-SPEED_MAX_M_S, maximum=SPEED_MAX_M_S
    )


@record
class WheelCommand(DriveCommand):
    """Speeds of the wheels of both sides at their rims; each of shape (n,)."""

    left: Array = quantity(
        unit="m/s", doc="speed of the left wheels, negative backwards", minimum=-SPEED_MAX_M_S, maximum=SPEED_MAX_M_S
    )
    right: Array = quantity(
        unit="m/s", doc="speed of the right wheels, negative backwards", minimum=-SPEED_MAX_M_S, maximum=SPEED_MAX_M_S
    )
