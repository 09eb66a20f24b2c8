"""What a reading of the sensor ``gnss`` has of each satellite, for those who ask for it."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import replace
from qrsim.models.gnss.fixes import GnssFix
from qrsim.models.gnss.geometry import Geometry, strengths
from qrsim.models.gnss.interference import Effect
from qrsim.models.gnss.slots import NOBODY, Slots


def with_satellites(receiver: Any, reading: GnssFix, now: Geometry, slots: Slots, effect: Effect | None) -> GnssFix:
    """Return a reading with what each satellite in a slot is to receivers (n,)."""
    like, sight = reading.satellites[None, :] * 0.0, slots.sight
    is_tracked = now.age > 0.0
    cn0 = strengths(receiver, slots, None if effect is None else effect.jam)
    taken = (slots.ids != jnp.uint32(NOBODY))[:, None]
    numbers = slots.ids.astype(jnp.int32).astype(like.dtype)
    azimuth = jnp.arctan2(sight.line_of_sight.y, sight.line_of_sight.x)

    def each(rows: Array, free: float = 0.0) -> tuple[Array, ...]:
        spread = jnp.where(taken, rows, free) + like
        return tuple(spread[i] for i in range(spread.shape[0]))

    return replace(
        reading,
        cn0=each(jnp.where(is_tracked, cn0, 0.0)),
        satellite_state=each(is_tracked.astype(like.dtype)),
        satellite=each(numbers[:, None], -1.0),
        azimuth=each(jnp.where(azimuth < 0.0, azimuth + 2.0 * math.pi, azimuth)[:, None]),
        elevation=each(sight.elevation[:, None]),
    )
