"""How a vehicle flies to a place on the ground and comes to rest above it, fast."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray

# Where a person is found: at rest this high above the ground, and so near to the person on the map [m].
HEIGHT, NEAR = 3.0, 2.5
# Velocity for each metre of the way [1/s], at most so fast on each axis [m/s].
GAIN, SPEED = 0.45, 3.0
# Nothing leads a vehicle lower than this [m].
FLOOR = 2.0
# Vehicles closer than this [m] move apart.
SEPARATION = 12.0


def toward(here: NumpyArray, point: NumpyArray, height: float = HEIGHT) -> NumpyArray:
    """Return a velocity NED (3,) [m/s] that brings a vehicle at ``here`` (3,) to rest above ``point`` (2,).

    It goes down as late as it can, so that it sees most on its way, and stops as soon as it is near.
    """
    offset = point - here[:2]
    distance = float(np.linalg.norm(offset))
    level = np.zeros(2)
    if distance > NEAR:
        aim = offset * (1.0 - 0.5 * NEAR / distance)
        level = aim * min(1.0, SPEED / max(GAIN * float(np.abs(aim).max()), 1e-9)) * GAIN
    error = height + here[2]
    down = -error if abs(error) > 0.7 else 0.0
    return np.array([*level, np.clip(GAIN * down, -SPEED, SPEED)])


def over_ground(velocity: NumpyArray, place: NumpyArray) -> NumpyArray:
    """Limit velocities NED (n, 3) [m/s] so that no vehicle at ``place`` (n, 3) NED [m] descends into the ground.

    One that others above it push away would go there.
    """
    sinking = np.minimum(velocity[:, 2], GAIN * (-place[:, 2] - FLOOR))
    return np.concatenate([velocity[:, :2], sinking[:, None]], axis=1)
