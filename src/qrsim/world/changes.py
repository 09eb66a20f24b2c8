"""Numbers of the weather that change while a world flies: wind, strength of gusts, power of jammers."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import rounded
from qrsim.core.tree import quantity, record


@record
class Course:
    """A number over time in K legs, of which the last that has begun counts; K is part of what is compiled."""

    start_tick: Array = quantity(doc="(K,) int32 tick at which a leg begins, increasing")
    ticks: Array = quantity(doc="(K,) int32 ticks that it takes; 0: it is a step")
    before: Array = quantity(doc="(K,) value at which it begins")
    after: Array = quantity(doc="(K,) value at which it ends, and which is kept")

    def at(self, tick: Array) -> Array:
        """Return the number () at a tick."""
        value = self.after[0]
        for leg in range(self.start_tick.shape[0]):
            since, ticks = tick - self.start_tick[leg], self.ticks[leg]
            share = since.astype(value.dtype) / jnp.maximum(ticks, 1).astype(value.dtype)
            # Rounded, so that every program makes the same bits.
            on_the_way = self.before[leg] + rounded(share * (self.after[leg] - self.before[leg]))
            value = jnp.where(since >= 0, jnp.where(since >= ticks, self.after[leg], on_the_way), value)
        return value


@record
class Changes:
    """What of a world's weather changes; None and () of what does not."""

    speed_20ft: Course | None = quantity(default=None, doc="of the mean wind [m/s]")
    wind_from_rad: Course | None = quantity(default=None, doc="bearing that it comes from [rad]")
    gusts: Course | None = quantity(default=None, doc="what random gusts are multiplied by")
    powers: tuple[Course, ...] = quantity(default=(), doc="of each jammer [W]")
