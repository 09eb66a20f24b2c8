"""Mean wind as a function of height.

Wind axes: x along the moving air, y across it, z down. ``wind_from_rad`` is the bearing the wind comes
FROM, clockwise from north, as meteorologists give it.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import log, sincos
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Wind

FEET_PER_METRE = 1.0 / 0.3048
ROUGHNESS_FT = 0.15
ROUGHNESS_M = 0.04572
REFERENCE_FT = 20.0


def wind_to_ned(along: Array, across: Array, down: Array, wind_from_rad: Array) -> Vec3:
    """Return a vector along, across and down the wind as NED, by the bearing it comes from (MIL-F-8785C, 3.7.1)."""
    return turned_to_ned(along, across, down, *sincos(jnp.asarray(wind_from_rad)))


def turned_to_ned(along: Array, across: Array, down: Array, sine: Array, cosine: Array) -> Vec3:
    """Return a vector along, across and down the wind as NED, by sine and cosine of the bearing it comes from."""
    return Vec3(sine * across - cosine * along, -sine * along - cosine * across, down)


def mean_wind_at(wind: Wind, height_agl: Array, position_ned: Vec3, time: tuple[Array, Array]) -> Vec3:
    """Return the mean wind (n,) [m/s] NED at positions (n,) [m], heights above ground (n,) [m] and a time."""
    inputs: dict[str, Any] = {"position_ned": position_ned} if "position_ned" in wind.reads else {}
    return wind.velocity_ned(height_agl, *time, **inputs)


@record
class Calm(Wind):
    """No mean wind."""

    def velocity_ned(self, height_agl: Array, seconds: Array | None = None, fraction: Array | None = None) -> Vec3:
        """Return zero wind [m/s] at every height (n,) and time."""
        return Vec3.zeros(height_agl.shape, height_agl.dtype)


@record
class LogShear(Wind):
    """A steady wind; its speed grows with the logarithm of height."""

    speed_20ft: Array = parameter(unit="m/s", doc="speed 20 ft (6.096 m) above the ground", minimum=0.0, maximum=50.0)
    wind_from_rad: Array = parameter(
        unit="rad", doc="bearing the wind comes from, clockwise from north", minimum=-2 * math.pi, maximum=2 * math.pi
    )
    roughness: float = setting(
        default=ROUGHNESS_M,
        unit="m",
        doc="roughness length of the land: 0.03 grass, 0.1 crops, 0.5 bushes and houses",
        above=0.0,
        maximum=2.0,
    )

    def velocity_ned(self, height_agl: Array, seconds: Array | None = None, fraction: Array | None = None) -> Vec3:
        """Return the mean wind (n,) [m/s] NED at heights (n,) [m] by the log law; zero up to the roughness height.

        The same at any time (``seconds`` and ``fraction``, which other winds need).
        |w(h)| = u20 ln(h/z0)/ln(20/z0), h in feet, by default z0 = 0.15 ft (MIL-F-8785C, section 3.7.3.2).
        """
        roughness_ft = self.roughness / 0.3048
        ratio = jnp.maximum(height_agl * (FEET_PER_METRE / roughness_ft), 1.0)
        speed = self.speed_20ft * log(ratio) * (1.0 / math.log(REFERENCE_FT / roughness_ft))
        zero = jnp.zeros_like(speed)
        return wind_to_ned(speed, zero, zero, self.wind_from_rad)
