"""Numbers of the weather that change while a world flies: wind, strength of gusts, power of jammers."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import rounded
from qrsim.core.tree import quantity, record


@record
class Course:
    """A number over time, in K legs; the leg that began last determines it. K is fixed in the compiled program."""

    start_tick: Array = quantity(doc="(K,) int32 tick at which a leg begins, increasing")
    ticks: Array = quantity(doc="(K,) int32 duration of the leg [ticks]; 0: a step")
    before: Array = quantity(doc="(K,) value at the beginning of the leg")
    after: Array = quantity(doc="(K,) value at its end and after it")

    def at(self, tick: Array) -> Array:
        """Return the number's value () at a tick: linear during a change, constant otherwise."""
        value = self.after[0]
        for leg in range(self.start_tick.shape[0]):
            since, ticks = tick - self.start_tick[leg], self.ticks[leg]
            share = since.astype(value.dtype) / jnp.maximum(ticks, 1).astype(value.dtype)
            # The product is rounded, so that the result does not depend on the program around it.
            on_the_way = self.before[leg] + rounded(share * (self.after[leg] - self.before[leg]))
            value = jnp.where(since >= 0, jnp.where(since >= ticks, self.after[leg], on_the_way), value)
        return value


@record
class Changes:
    """Changes of a world's weather over time; None or () for numbers that do not change."""

    speed_20ft: Course | None = quantity(default=None, doc="speed of the mean wind [m/s]")
    wind_from_rad: Course | None = quantity(default=None, doc="bearing from which it blows [rad]")
    gusts: Course | None = quantity(default=None, doc="factor of random gusts")
    powers: tuple[Course, ...] = quantity(default=(), doc="power of each jammer [W]")
