"""The ground that vehicles stand on, and heights are counted from (docs/models/scene.md)."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import Ground


@record
class FlatGround(Ground):
    """A horizontal plane."""

    height: float = setting(default=0.0, unit="m", doc="height over the origin of the local frame, positive up")

    @property
    def at_zero(self) -> bool:  # type: ignore[override]
        """Whether the ground is the plane z = 0."""
        return self.height == 0.0

    def down(self, position_ned: Vec3) -> Array:
        """Return the down coordinate [m] of the ground below positions of any shape."""
        return jnp.full_like(position_ned.z, 0.0 - self.height)

    def normal(self, position_ned: Vec3) -> Vec3:
        """Return the normal, straight up."""
        flat = jnp.zeros_like(position_ned.z)
        return Vec3(flat, flat, flat - 1.0)
