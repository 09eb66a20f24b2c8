"""Ground cover of the search area (docs/explanation/models/scene.md)."""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.fastmath import log, sincos
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import GroundCover

CLEAR, CLUTTER, OCCLUSION = 0, 1, 2
_STEPS = ((1, 0), (-1, 0), (0, 1), (0, -1))


@record
class ClearGround(GroundCover):
    """Ground that hides nothing."""

    random: ClassVar[bool] = False

    def class_at(self, state: None, position_ned: Vec3, area: object) -> Array:
        """Return the land-cover class (int32) below positions of any shape: clear ground everywhere."""
        return jnp.full(position_ned.x.shape, CLEAR, jnp.int32)

    def cells(self, state: None) -> Array:
        """Return the land-cover classes as a grid (1, 1) int32 of clear ground."""
        return jnp.full((1, 1), CLEAR, jnp.int32)


@record
class TerrainState:
    """The ground of an episode."""

    classes: Array = quantity(doc="(C, C) int32 class of each cell, north and east from the south-western corner")


class _Pouring(NamedTuple):
    """A class on its way to its share."""

    cells: Array
    centre: Array  # (2,) cell where drops start
    drop: Array  # (2,) cell where the drop is
    left: Array  # drops still to pour here
    turned: Array  # cells turned so far
    draws: Array


@record
class PatchyGround(GroundCover):
    """Patches of clutter, where false alarms are more likely, and of occlusion, where persons are hard to see.

    Each class grows by drops: from a random cell jump some cells in a random direction (beyond an edge on from the
    opposite one), pour drops there, and jump again; each drop walks from cell to neighbouring cell until it meets one
    not of its class and turns it, until the class has its share. What the second class turns can have been of the
    first.
    """

    clutter_share: Array = parameter(default=0.2, unit="1", doc="share of clutter", minimum=0.0, maximum=0.5)
    occlusion_share: Array = parameter(default=0.05, unit="1", doc="share of occlusion", minimum=0.0, maximum=0.5)
    jump: Array = parameter(
        default=4.0, unit="1", doc="mean length of a jump between places, in cells", minimum=0.0, maximum=1000.0
    )
    drops_least: Array = parameter(
        default=10.0, unit="1", doc="least number of drops poured at a place", minimum=1.0, maximum=1e4
    )
    drops_spread: Array = parameter(
        default=100.0, unit="1", doc="largest number of drops beyond drops_least", minimum=0.0, maximum=1e4
    )
    side: int = setting(default=50, unit="1", doc="cells along each side", minimum=2, maximum=500)
    random: ClassVar[bool] = True

    def init(self, draw: Draw) -> TerrainState:
        """Return an episode's random land cover; ``draw`` has one id."""
        # Classes have no derivatives, and JAX cannot differentiate a loop of unknown length in reverse.
        return jax.tree.map(lax.stop_gradient, self)._grown(draw)

    def _grown(self, draw: Draw) -> TerrainState:
        """Return land cover with random patches of clutter, then of occlusion, each to its share of all cells."""
        cells = jnp.full((self.side, self.side), CLEAR, jnp.int32)
        first = jnp.int32(0)
        for number, share in ((CLUTTER, self.clutter_share), (OCCLUSION, self.occlusion_share)):
            target = jnp.round(jnp.asarray(share) * self.side**2).astype(jnp.int32)
            cells, first = self._pour(draw, cells, number, target, first)
        return TerrainState(cells)

    def _pour(self, draw: Draw, cells: Array, number: int, target: Array, first: Array) -> tuple[Array, Array]:
        """Return the cells with ``target`` random ones set to class ``number``, and the number of draws made so far."""
        corner = _cell(self._uniforms(draw, first), self.side)
        nothing = jnp.int32(0)
        start = _Pouring(cells, corner, corner, nothing, nothing, first + 1)

        def step(now: _Pouring) -> _Pouring:
            """Return the state after one random step: the drop moves to a neighbour cell, or a new one starts."""
            chance = self._uniforms(draw, now.draws)
            place = now.cells[now.drop[0], now.drop[1]] == number
            pouring = now.left > 0
            turns = pouring & ~place
            cells = now.cells.at[now.drop[0], now.drop[1]].set(
                jnp.where(turns, number, now.cells[now.drop[0], now.drop[1]])
            )
            centre = jnp.where(pouring, now.centre, self._jumped(now.centre, chance))
            walked = now.drop + jnp.array(_STEPS, jnp.int32)[jnp.floor(4.0 * chance[0]).astype(jnp.int32)]
            inside = jnp.all((walked >= 0) & (walked < self.side))
            drop = jnp.where(pouring & place, jnp.where(inside, walked, now.drop), centre)
            fresh = (self.drops_least + jnp.ceil(self.drops_spread * chance[2])).astype(jnp.int32)
            left = jnp.where(pouring, now.left - turns.astype(jnp.int32), fresh)
            return _Pouring(cells, centre, drop, left, now.turned + turns.astype(jnp.int32), now.draws + 1)

        done = lax.while_loop(lambda now: now.turned < target, step, start)
        return done.cells, done.draws

    @staticmethod
    def _uniforms(draw: Draw, index: Array) -> tuple[Array, Array, Array]:
        """Return three uniform random numbers () in (0, 1) for draw number ``index``."""
        first, second = draw.stream.words(draw.tick, index)
        # A word gives two: its halves are independent.
        words = (first[0] & 0xFFFF, second[0] >> 9, first[0] >> 16)
        scales = (2.0**-16, 2.0**-23, 2.0**-16)
        dtype = draw.like.dtype
        found = [(word.astype(jnp.int32).astype(dtype) + 0.5) * s for word, s in zip(words, scales, strict=True)]
        return found[0], found[1], found[2]

    def _jumped(self, centre: Array, chance: tuple[Array, Array, Array]) -> Array:
        """Return the cell at a random jump from cell ``centre``, wrapped at the edges, by two uniforms in (0, 1)."""
        length = -self.jump * log(chance[0])
        sine, cosine = sincos(2.0 * math.pi * chance[1])
        steps = jnp.round(jnp.stack([length * cosine, length * sine])).astype(jnp.int32)
        return (centre + steps) % self.side

    def class_at(self, state: TerrainState, position_ned: Vec3, area: Any) -> Array:
        """Return the land-cover class (int32) below positions of any shape [m]; beyond the area that of its edge.

        The cells are stretched over the area by nearest neighbour in steps of 1 m.
        """

        def number(value: Array, low: Array, high: Array) -> Array:
            """Return the index of the cell along a side [low, high] that contains a coordinate, clipped to the grid."""
            metres = jnp.clip(jnp.floor(value - low), 0.0, jnp.ceil(high - low) - 1.0) + 0.5
            return jnp.clip(jnp.floor(metres * (self.side / (high - low))).astype(jnp.int32), 0, self.side - 1)

        north = number(position_ned.x, area.x_min, area.x_max)
        east = number(position_ned.y, area.y_min, area.y_max)
        return state.classes[north, east]

    def cells(self, state: TerrainState) -> Array:
        """Return the land-cover classes as a grid (C, C) int32."""
        return state.classes


def _cell(chance: tuple[Array, Array, Array], side: int) -> Array:
    """Return a random cell's row and column (2,) int32, from the first two of three uniform numbers."""
    return jnp.stack([jnp.floor(side * part).astype(jnp.int32) for part in chance[:2]])
