"""Positions and velocities of all vehicles of a world, for sensors that measure others."""

from __future__ import annotations

import jax
from jax import Array

from qrsim.core.tree import quantity, record, replace, setting
from qrsim.core.vectors import Vec3


@record
class Traffic:
    """All N vehicles of a world, fleet after fleet."""

    position_ned: Vec3 = quantity(unit="m", doc="(N,) position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="(N,) velocity over ground")
    flies: Array = quantity(doc="(N,) bool: the vehicle is still valid")
    radius: Array = quantity(unit="m", doc="(N,) radius of the sphere that collides")
    fleets: tuple[str, ...] = setting(doc="names of the fleets")
    sizes: tuple[int, ...] = setting(doc="vehicles of each")
    first: int = setting(default=0, doc="number of the first vehicle of the observing fleet")

    @property
    def count(self) -> int:
        """Number N of vehicles in the world."""
        return sum(self.sizes)

    def part(self, first: int, count: int) -> Traffic:
        """Return ``count`` vehicles of the traffic from number ``first`` on, renumbered from 0 as one fleet."""
        chosen = jax.tree.map(lambda leaf: leaf[first : first + count], self)
        return replace(chosen, fleets=("",), sizes=(count,), first=0)

    def seen_by(self, fleet: str) -> Traffic:
        """Return the traffic for the sensors of fleet ``fleet``: ``first`` is set to that fleet's first vehicle."""
        return replace(self, first=sum(self.sizes[: self.fleets.index(fleet)]))
