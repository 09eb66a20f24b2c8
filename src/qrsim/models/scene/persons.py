"""Persons on the ground, and when one is found (docs/explanation/models/scene.md)."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.scene.contracts import People
from qrsim.models.scene.terrain import CLEAR, CLUTTER, OCCLUSION
from qrsim.models.scene.uniform import uniform, whole

# Of the area persons are in this part, along each side.
INNER = 0.8


@record
class NoPersons(People):
    """No persons."""

    random: ClassVar[bool] = False


@record
class PersonsState:
    """Persons of an episode, (P,)."""

    north: Array = quantity(unit="m", doc="north coordinate of the middle")
    east: Array = quantity(unit="m", doc="east coordinate of the middle")
    there: Array = quantity(doc="bool: this episode has this person")
    found_tick: Array = quantity(doc="int32 tick at which it was found, -1 before")

    def missing(self, tick: Array | None = None) -> Array:
        """Return (P,) bool: the person is present and has not been found by a tick (None: until now)."""
        found = self.found_tick >= 0
        return self.there & ~(found if tick is None else found & (self.found_tick <= tick))


@record
class Persons(People):
    """Persons at rest; one is found when a vehicle hovers near, checked once a period."""

    size: Array = parameter(default=0.5, unit="m", doc="side of the square that represents a person", above=0.0)
    found_distance: Array = parameter(
        default=5.0, unit="m", doc="distance in 3-D within which a vehicle finds a person", above=0.0
    )
    found_speed: Array = parameter(
        default=0.1, unit="m/s", doc="largest speed at which a vehicle finds a person", minimum=0.0
    )
    on_clutter: Array = parameter(default=0.0, unit="1", doc="chance of lying on clutter", minimum=0.0, maximum=1.0)
    on_occlusion: Array = parameter(default=0.0, unit="1", doc="chance of being occluded", minimum=0.0, maximum=1.0)
    fewest: int = setting(default=5, unit="1", doc="fewest persons of an episode", minimum=1, maximum=1000)
    most: int = setting(default=10, unit="1", doc="most persons of an episode", minimum=1, maximum=1000)
    period: float = setting(
        default=1.0, unit="s", doc="interval between checks, a multiple of the time step", above=0.0
    )
    random: ClassVar[bool] = True

    def init(self, draw: Draw, cells: Array, area: Any) -> PersonsState:
        """Return an episode's random persons (P,), uniform over land of their class in the area's inner part.

        Where the area has no such ground, a person is anywhere in the inner part.

        Args:
            draw: for P ids.
            cells: (C, C) class of the ground.
            area: a box.
        """
        chance = uniform(draw, 0)
        on = jnp.where(chance < self.on_clutter, CLUTTER, CLEAR)
        on = jnp.where((chance >= self.on_clutter) & (chance < self.on_clutter + self.on_occlusion), OCCLUSION, on)
        low, width = _overlaps(area.x_min, area.x_max, cells.shape[0])
        low_east, width_east = _overlaps(area.y_min, area.y_max, cells.shape[1])
        size = (width[:, None] * width_east[None]).reshape(1, -1)
        fitting = jnp.where(cells.reshape(1, -1) == on[:, None], size, 0.0)
        fitting = jnp.where(jnp.sum(fitting, axis=1, keepdims=True) > 0.0, fitting, size)
        summed = jnp.cumsum(fitting, axis=1)
        wanted = uniform(draw, 1)[:, None] * summed[:, -1:]
        number = jnp.sum(summed < wanted, axis=1)
        row, column = number // cells.shape[1], number % cells.shape[1]
        north = low[row] + uniform(draw, 2) * width[row]
        east = low_east[column] + uniform(draw, 3) * width_east[column]
        there = jnp.arange(self.most, dtype=jnp.int32) < whole(draw, 4, self.fewest, self.most)[0]
        return PersonsState(north, east, there, jnp.full(self.most, -1, jnp.int32))

    def step(self, state: PersonsState, position_ned: Vec3, speed: Array, valid: Array, tick: Array) -> PersonsState:
        """Return the state with persons marked as found that vehicles (n,) find at a tick."""
        north, east = position_ned.x[:, None] - state.north[None], position_ned.y[:, None] - state.east[None]
        distance = jnp.sqrt(north * north + east * east + (position_ned.z * position_ned.z)[:, None])
        finds = (distance <= self.found_distance) & ((speed <= self.found_speed) & valid)[:, None]
        now = jnp.any(finds, axis=0) & state.missing()
        return PersonsState(state.north, state.east, state.there, jnp.where(now, tick, state.found_tick))


def _overlaps(low: Array, high: Array, cells: int) -> tuple[Array, Array]:
    """Return, for each cell along a side [low, high], start and length [m] of its part in the inner area."""
    edges = low + (high - low) * (jnp.arange(cells + 1).astype(jnp.asarray(low).dtype) / cells)
    middle, half = 0.5 * (low + high), 0.5 * INNER * (high - low)
    inner = jnp.clip(edges, middle - half, middle + half)
    return inner[:-1], inner[1:] - inner[:-1]
