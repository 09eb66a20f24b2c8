"""White accelerations that disturb a vehicle, for any rigid body."""

from __future__ import annotations

import math

from jax import Array

from qrsim.core.noise import Noise
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3

# The process noise is quoted per step of this length; as a spectral density it holds for any step.
PROCESS_NOISE_STEP_S = 0.02
NORMALS = 6


@record
class ProcessNoise:
    """White accelerations of one step; each of shape (n,)."""

    linear: Vec3 = quantity(unit="m/s^2", doc="in body axes")
    angular: Vec3 = quantity(unit="rad/s^2", doc="in body axes")


def white_accelerations(draw: Noise, std: Array | float, dt: float) -> ProcessNoise:
    """Return a step's random accelerations, as white noise of a fixed spectral density: std sigma sqrt(0.02/dt).

    Args:
        draw: source of NORMALS normals.
        std: of each acceleration at a step of PROCESS_NOISE_STEP_S [m/s^2, rad/s^2].
        dt: step [s].
    """
    scale = std * math.sqrt(PROCESS_NOISE_STEP_S / dt)
    drawn = [normal * scale for normal in draw.normals(NORMALS)]
    return ProcessNoise(Vec3(*drawn[:3]), Vec3(*drawn[3:]))
