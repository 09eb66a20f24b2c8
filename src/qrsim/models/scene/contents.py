"""Contents of a world other than vehicles: plume, ground cover, persons."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike

from qrsim.core.clock import split_time
from qrsim.core.tree import quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere import contracts
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.models.scene.contracts import Area, Ground, GroundCover, People
from qrsim.models.scene.ground import FlatGround
from qrsim.models.scene.obstacles import Obstacles
from qrsim.models.scene.persons import NoPersons
from qrsim.models.scene.plume import NoPlume, Wind
from qrsim.models.scene.terrain import ClearGround
from qrsim.models.scene.traffic import Traffic

# The wind that carries a plume is that at this height [m].
WIND_HEIGHT = 6.0


@record
class Contents:
    """The components; by default a world is empty."""

    plume: Any = quantity(default=NoPlume(), doc="concentration field")
    terrain: GroundCover = quantity(default=ClearGround(), doc="cover of the ground")
    persons: People = quantity(default=NoPersons(), doc="persons to find")

    @property
    def random(self) -> bool:
        """True if plume, land cover or persons are drawn at random for each episode."""
        return bool(self.plume.random or self.terrain.random or self.persons.random)


@record
class ContentsState:
    """Their states, and values drawn once an episode; None if absent."""

    plume: Any = quantity(default=None, doc="sources and puffs")
    terrain: Any = quantity(default=None, doc="classes of the ground")
    persons: Any = quantity(default=None, doc="persons, and those found")


@record
class Surroundings:
    """The part of a world that sensors may read at a tick."""

    contents: Contents = quantity(doc="components")
    state: ContentsState = quantity(doc="their state")
    wind: contracts.Wind = quantity(doc="mean wind")
    area: Area = quantity(doc="area of flight")
    tick: Array = quantity(doc="() int32")
    time_step: float = setting(unit="s", doc="simulation step")
    ground: Ground = quantity(default=FlatGround(), doc="surface of the ground")
    skyline: Any = quantity(default=None, doc="effect of obstacles on satellite signals; None: none")
    obstacles: Obstacles | None = quantity(default=None, doc="solid things, an ``Obstacles``")
    traffic: Traffic | None = quantity(
        default=None, doc="all vehicles of the world, a ``Traffic``; None if no sensor uses them"
    )

    def over_ground(self, position_ned: Vec3) -> Vec3:
        """Return positions with z replaced by minus the height above the ground, as for flat ground at z = 0.

        Plumes, persons and cameras know a ground at z = 0: each vehicle sees it level, at the height of that below it.
        """
        return over_ground(self.ground, position_ned)

    def carrying_wind(self, dtype: DTypeLike) -> Wind:
        """Return the mean wind at the origin, which carries plumes, with numbers of ``dtype``."""
        time, height = split_time(self.tick, self.time_step, dtype), jnp.full(1, WIND_HEIGHT, dtype)
        place = Vec3(jnp.zeros(1, dtype), jnp.zeros(1, dtype), -height)
        return Wind.of(mean_wind_at(self.wind, height, place, time).map(lambda axis: axis[0]))

    def concentration(self, position_ned: Vec3) -> Array:
        """Return the plume's concentration at positions (n,) [m]."""
        plume, position_ned = self.contents.plume, self.over_ground(position_ned)
        ticks = max(1, round(plume.period / self.time_step))
        dtype = position_ned.x.dtype
        since = (self.tick % ticks).astype(dtype) * self.time_step
        return plume.concentration(self.state.plume, position_ned, self.carrying_wind(dtype), self.area, since)

    def ground_class(self, position_ned: Vec3) -> Array:
        """Return the land-cover class (int32) of the ground below positions of any shape [m]."""
        return self.contents.terrain.class_at(self.state.terrain, position_ned, self.area)


def over_ground(ground: Ground, position_ned: Vec3) -> Vec3:
    """Return positions with z replaced by minus the height above ``ground``, as for flat ground at z = 0."""
    if ground.at_zero:
        return position_ned
    return replace(position_ned, z=position_ned.z - ground.down(position_ned))
