"""The wake of a vehicle that hangs on rotors: one round turbulent jet, which others fly through.

L. Bauersfeld et al., "Robotics meets fluid dynamics: a characterization of the induced airflow below a quadrotor as a
turbulent jet", RA-L 2024: below two and a half vehicle sizes the flows of all propellers are one jet. Its decay and
spread are those of S. B. Pope, "Turbulent Flows", 2000, section 5.1, with the momentum of the thrust.
"""

from __future__ import annotations

import math

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3

# Velocity decay and spreading rate of a round jet (Pope, table 5.1); half width over distance.
DECAY, SPREAD = 6.0, 0.096
# From so many sizes below the vehicle on its jet is one [1].
MERGED = 2.5
AIR_DENSITY = 1.225
_PROFILE = math.sqrt(2.0) - 1.0


@record
class Wake:
    """What a wake depends on; each (n,), or one number for all."""

    size: Array = quantity(unit="m", doc="distance between the rotors that are farthest apart")
    disc_area: Array = quantity(unit="m^2", doc="area of all rotor discs")


def jet_velocity(wake: Wake, thrust: Array, down_ned: Vec3, relative_wind_ned: Vec3, offset_ned: Vec3) -> Vec3:
    """Return the velocity [m/s] that a wake adds to the air at an offset from its vehicle (V32).

    Its axis is that of the flow through the rotors: twice the induced velocity of hover along body down, and the
    relative wind.

    Args:
        wake: of the upper vehicle.
        thrust: its thrust [N].
        down_ned: the direction that its rotors blow to.
        relative_wind_ned: velocity of the air as it sees it [m/s].
        offset_ned: from it to the place [m]; shapes may broadcast.
    """
    push = jnp.maximum(thrust, 0.0)
    exhaust = jnp.sqrt(2.0 * push / (AIR_DENSITY * wake.disc_area))
    through = down_ned * exhaust + relative_wind_ned
    axis = through * (1.0 / jnp.sqrt(jnp.maximum(through.dot(through), 1e-12)))
    along = offset_ned.dot(axis)
    far = jnp.maximum(along, 1e-3)
    width = SPREAD * jnp.maximum(along, MERGED * wake.size)
    beside_squared = jnp.maximum(offset_ned.dot(offset_ned) - along * along, 0.0)
    middle = jnp.minimum(exhaust, DECAY * jnp.sqrt(4.0 * push / (AIR_DENSITY * math.pi)) / far)
    shape = 1.0 + _PROFILE * beside_squared / (width * width)
    speed = jnp.where(along > 0.0, middle / (shape * shape), 0.0)
    return axis * speed
