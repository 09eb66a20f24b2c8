"""How often and how long vehicles were outside the zones of an area that reports it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.scene.zones import ZonesArea
from qrsim.world.state import World


@record
class Breaches:
    """Breaches of n vehicles, each (n,)."""

    outside: Array = quantity(doc="bool: outside at the last tick")
    count: Array = quantity(doc="int32 times that the zones were left")
    ticks: Array = quantity(doc="int32 ticks outside")

    @staticmethod
    def none(world: World, like: Array) -> Breaches | None:
        """Return counts of zero at a flight's start, shaped as ``like`` (n,); None if leaving the flight area ends a
        flight."""
        if not (isinstance(world.area, ZonesArea) and world.area.breach == "report"):
            return None
        count = jnp.zeros(like.shape, jnp.int32)
        return Breaches(jnp.zeros(like.shape, bool), count, count)

    def update(self, world: World, position_ned: Vec3, counts: Array, tick: Array) -> Breaches:
        """Return the counts updated by positions (n,) at a tick, for the vehicles marked in ``counts`` (n,) bool."""
        assert isinstance(world.area, ZonesArea)
        outside = counts & ~world.area.inside(position_ned)
        left = outside & ~self.outside
        return Breaches(
            outside,
            self.count + left.astype(jnp.int32),
            self.ticks + (outside & (tick > 0)).astype(jnp.int32),
        )


def breach_metrics(found: Breaches | None, dt: float) -> dict[str, Floats]:
    """Convert counts of departures from the flight area to metrics by name, each (W, n); {} without counts. ``dt``:
    time step [s]."""
    if found is None:
        return {}
    return {"breaches": np.asarray(found.count), "seconds_outside": np.asarray(found.ticks) * dt}
