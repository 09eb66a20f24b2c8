"""The largest value of a quantity of each vehicle, with its moment."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import quantity, record, select
from qrsim.core.vectors import Vec3


@record
class Extreme:
    """The largest value of a quantity of each vehicle (n,), with its time and position."""

    value: Array = quantity(doc="largest value; NaN before the first")
    tick: Array = quantity(doc="int32 tick at which it was reached, -1 before the first")
    position_ned: Vec3 = quantity(unit="m", doc="true position at the tick")

    @staticmethod
    def none(like: Array) -> Extreme:
        """Return an empty record of n vehicles' largest values (NaN, at tick -1), shaped as ``like`` (n,)."""
        nothing = jnp.full_like(like, jnp.nan)
        return Extreme(nothing, jnp.full(like.shape, -1, jnp.int32), Vec3(nothing, nothing, nothing))

    def update(self, value: Array, tick: Array, position_ned: Vec3, counts: Array) -> Extreme:
        """Return the record with ``value`` (n,), tick and position taken over where it is larger and ``counts`` (n,) is
        True."""
        larger = counts & (value > jnp.where(self.tick < 0, -jnp.inf, self.value))
        return select(larger, Extreme(value, jnp.full_like(self.tick, tick), position_ned), self)
