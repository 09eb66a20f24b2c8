"""Solid things in an area: boxes, upright cylinders, and prisms (docs/howto/write_a_scenario.md)."""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.host import library_of
from qrsim.core.tree import parameter, quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.scene.prisms import Prisms, length_of

T = TypeVar("T")


@record
class BoxObstacle:
    """A box with its faces along north, east and down."""

    x_min: Array = parameter(unit="m", doc="southern face")
    x_max: Array = parameter(unit="m", doc="northern face")
    y_min: Array = parameter(unit="m", doc="western face")
    y_max: Array = parameter(unit="m", doc="eastern face")
    z_min: Array = parameter(unit="m", doc="top, negative above ground")
    z_max: Array = parameter(default=0.0, unit="m", doc="bottom; 0 is the ground")

    def distance(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the box, 0 inside it."""
        return _length(
            _beyond(position_ned.x, self.x_min, self.x_max),
            _beyond(position_ned.y, self.y_min, self.y_max),
            _beyond(position_ned.z, self.z_min, self.z_max),
        )


@record
class CylinderObstacle:
    """An upright cylinder, such as a mast or a tree."""

    x: Array = parameter(unit="m", doc="north coordinate of the axis")
    y: Array = parameter(unit="m", doc="east coordinate of the axis")
    radius: Array = parameter(unit="m", doc="radius", above=0.0)
    z_min: Array = parameter(unit="m", doc="top, negative above ground")
    z_max: Array = parameter(default=0.0, unit="m", doc="bottom; 0 is the ground")

    def distance(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the cylinder, 0 inside it."""
        dx, dy = position_ned.x - self.x, position_ned.y - self.y
        lib = library_of(dx)
        radial = lib.maximum(_length(dx, dy, lib.zeros_like(dx)) - self.radius, 0.0)
        vertical = _beyond(position_ned.z, self.z_min, self.z_max)
        return _length(radial, vertical, lib.zeros_like(radial))


@record
class Obstacles:
    """All obstacles of a world; the parameters of each kind are arrays with one entry per obstacle."""

    boxes: BoxObstacle = quantity(doc="(B,) boxes")
    cylinders: CylinderObstacle = quantity(doc="(C,) cylinders")
    numbers: Array = quantity(doc="(B + C,) number of each in the scenario, boxes first")
    prisms: Prisms | None = quantity(default=None, doc="prisms with their numbers; None without any")

    def nearest(self, position_ned: Vec3) -> tuple[Array, Array]:
        """Return the distance (n,) [m] of positions from the nearest obstacle, and its number in the scenario.

        Without any obstacle the distance is infinite and the number -1. A prism that is farther than ``prisms.reach``
        may be overlooked.
        """
        if self.prisms is None:
            return self._nearest_plain(position_ned)
        distance, number = self._nearest_plain(position_ned)
        other, its_number = self.prisms.nearest(position_ned)
        # NaN stays NaN.
        closer = ~(other >= distance)
        return jnp.where(closer, other, distance), jnp.where(closer, its_number, number)

    def _nearest_plain(self, position_ned: Vec3) -> tuple[Array, Array]:
        """Return distance [m] and number of the nearest box or cylinder; infinite and -1 if there are neither."""
        row = position_ned.map(lambda axis: axis[None, :])
        rows = [
            kind.distance(row) for kind in (_as_columns(self.boxes), _as_columns(self.cylinders)) if kind.z_min.shape[0]
        ]
        if not rows:
            return jnp.full_like(position_ned.x, jnp.inf), jnp.full_like(position_ned.x, -1.0)
        distance = jnp.concatenate(rows, axis=0)
        place = jnp.arange(distance.shape[0])[:, None]
        # A sum with one non-zero term is faster than an indexed read.
        chosen = jnp.where(place == jnp.argmin(distance, axis=0)[None, :], self.numbers[:, None], 0.0)
        return jnp.min(distance, axis=0), jnp.sum(chosen, axis=0)


def _as_columns(item: T) -> T:
    """Return a record of k solids with arrays (k,) reshaped to (k, 1), to broadcast against vehicles (n,)."""
    return jax.tree.map(lambda leaf: leaf[:, None], item)


def _beyond(value: Array, low: Array, high: Array) -> Array:
    """Return the distance of coordinates from the interval [low, high], 0 inside it."""
    lib = library_of(value)
    return lib.maximum(lib.maximum(low - value, value - high), 0.0)


def _length(x: Array, y: Array, z: Array) -> Array:
    """Return the length of vectors (x, y, z); its gradient at zero is finite."""
    return length_of(library_of(x), x * x + y * y + z * z)
