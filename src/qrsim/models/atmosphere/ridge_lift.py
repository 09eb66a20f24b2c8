"""Lift at slopes: wind that follows the ground, less with height (docs/explanation/models/air.md)."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.tree import parameter, record
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.contracts import Updraft

# Half of the way over which the slope is taken: by the height above ground, at the ground and at most [m].
PER_HEIGHT, AT_GROUND, FARTHEST = 0.8, 16.0, 300.0


@record
class RidgeLift(Updraft):
    """Air that rises on windward slopes and sinks on lee slopes."""

    decay_height: Array = parameter(
        default=150.0,
        unit="m",
        doc="height above ground over which the lift falls to 1/e, about the spacing of valleys divided by 2 pi",
        minimum=1.0,
        maximum=5000.0,
    )

    reads: ClassVar[tuple[str, ...]] = ("ground",)

    def velocity_ned(
        self,
        position_ned: Vec3,
        height_agl: Array,
        wind_ned: Vec3,
        seconds: Array,
        fraction: Array,
        *,
        ground: Any,
        **reads: object,
    ) -> Vec3:
        """Return the velocity (n,) [m/s] NED, vertical, of wind deflected by the slope of the ground.

        Args:
            position_ned, height_agl: (n,) [m].
            wind_ned: mean wind (n,) [m/s].
            seconds, fraction: not read.
            ground: a ``Ground``, for its slopes.
        """
        height = jnp.maximum(height_agl, 0.0)
        half = jnp.minimum(PER_HEIGHT * height + AT_GROUND, FARTHEST)
        zero = jnp.zeros_like(half)
        slopes = [
            (ground.down(position_ned - step) - ground.down(position_ned + step)) / (2.0 * half)
            for step in (Vec3(half, zero, zero), Vec3(zero, half, zero))
        ]
        climbs = wind_ned.x * slopes[0] + wind_ned.y * slopes[1]
        steep = jnp.sqrt(1.0 + slopes[0] * slopes[0] + slopes[1] * slopes[1])
        return Vec3(zero, zero, -climbs / steep * exp(-height / self.decay_height))
