"""Search and rescue (docs/explanation/task_design.md), as in the reference implementation."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.control import VelocitySetpoint
from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.sensors.camera import Camera, Picture
from qrsim.tasks.agents import (
    BELIEVED,
    Axis,
    action_period,
    believed,
    fleet_of,
    leaving,
    number_of,
    only,
    penalty,
    velocity_axes,
)
from qrsim.tasks.contracts import Task
from qrsim.tasks.perceived import sensed, sensed_axes, senses
from qrsim.world.episode import film, picture, surroundings
from qrsim.world.state import Action, State, World


@record
class SearchMemory:
    """Memory of an episode."""

    yaw: Array = quantity(unit="rad", doc="(n,) heading that each vehicle keeps")
    found: Array = quantity(doc="() int32 persons found so far")


@record
class Search(Task):
    """Find persons on the ground: see them, and hover near them.

    A step gives 1 for every person just found, else -1/steps, to all vehicles.
    """

    penalty: Array = penalty()
    leave: bool = leaving()
    fleet: str = setting(default="helicopters", doc="name of the fleet whose vehicles are the agents")
    camera: str = setting(default="camera", doc="name of their camera")
    period: float = action_period(1.0)
    senses: tuple[str, ...] = senses()

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ned")
    asks_for: ClassVar[type | None] = VelocitySetpoint

    def init(self, world: World, state: State, draw: Draw) -> SearchMemory:
        """Return the task's memory at the start of an episode."""
        model, fleet = fleet_of(world, state, self.fleet)
        return SearchMemory(model.vehicle.pose(fleet.vehicle).attitude.yaw, jnp.int32(0))

    def commands(self, memory: SearchMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Convert actions (n, 3), velocities [m/s], to velocity set-points with the starting heading."""
        return only(world, self.fleet, VelocitySetpoint(Vec3.of(action), memory.yaw))

    def judge(
        self, memory: SearchMemory, world: World, state: State, step: Array, steps: int
    ) -> tuple[SearchMemory, Array]:
        """Return the memory and each vehicle's reward (n,) for the persons found in a step."""
        found = jnp.sum(state.contents.persons.found_tick >= 0).astype(jnp.int32)
        fresh = found - memory.found
        yaw = memory.yaw
        reward = jnp.where(fresh > 0, fresh.astype(yaw.dtype), -1.0 / steps)
        return SearchMemory(yaw, found), jnp.broadcast_to(reward, yaw.shape)

    def picture(self, world: World, state: State) -> Picture:
        """Return the last camera picture of each vehicle (n,)."""
        world = world.with_drawn(state.drawn)
        number = number_of(world, self.fleet)
        return picture(world, state, number, self.camera)

    def observe(self, memory: SearchMemory, world: World, state: State) -> dict[str, Array]:
        """Return the vehicles' observations by name: estimated state and last camera picture, arrays (n, ...).

        ``vehicle`` (n, 9) is what it believes of itself, ``ratio`` (n, R, C) the log-likelihood ratio of each window of
        its last picture, 0 beyond the grid, ``grid`` (n, 2) the rows and columns of the grid, and ``corners`` (n, 4, 2)
        north and east [m] of the grid's corners on the ground: upper left, upper right, lower right, lower left. They
        and the grid are enough to know all windows' corners. ``sensed`` (n, S) is what the sensors of ``senses`` say.
        """
        ratio = self.picture(world, state).ratio
        # Nothing is seen any more by a vehicle that has stopped.
        return self.observe_early(memory, world, state) | {"ratio": jnp.where(jnp.isfinite(ratio), ratio, 0.0)}

    def later(self, world: World) -> dict[str, tuple[int, ...]]:
        """Return {"ratio": (n, R, C)}, the pictures' shape; {} if a subclass overrides ``observe`` or ``picture``."""
        if (type(self).observe, type(self).picture) != (Search.observe, Search.picture):
            return {}
        lens = self.lens(world)
        return {"ratio": (world.fleets[number_of(world, self.fleet)].size, lens.most_rows, lens.most_columns)}

    def observe_early(self, memory: SearchMemory, world: World, state: State) -> dict[str, Array]:
        """Return the observations without the pixels ("ratio") of the pictures."""
        _, fleet = fleet_of(world, state, self.fleet)
        world = world.with_drawn(state.drawn)
        taking, reading, _ = film(world, state, number_of(world, self.fleet), self.camera)
        grid, corners = taking.frame(
            reading, surroundings(world, state.contents, jnp.int32(0)), world.contents.persons.size
        )
        more = {"sensed": sensed(world, state, self.fleet, self.senses)} if self.senses else {}
        return more | {
            "vehicle": believed(fleet),
            "grid": grid,
            "corners": jnp.where(jnp.isfinite(corners), corners, 0.0),
        }

    def shot(self, world: World, state: State) -> Any:
        """Return the last camera reading of each vehicle (n,), from which ``look`` computes its picture."""
        return film(world, state, number_of(world, self.fleet), self.camera)[1]

    def look(self, world: World, state: State, shot: Any, to: dict[str, Array]) -> dict[str, Array]:
        """Compute {"ratio": (n, R, C)}, the pictures' log-likelihood ratios, for the camera readings in ``shot``."""
        world = world.with_drawn(state.drawn)
        taking, _, stream = film(world, state, number_of(world, self.fleet), self.camera)
        # Persons count as they were when the picture was taken, whatever the tick is.
        around = surroundings(world, state.contents, jnp.int32(0))
        return {"ratio": taking.ratios(shot, around, stream, world.contents.persons.size, to["ratio"])}

    def sees(self, world: World) -> dict[str, tuple[Axis, ...]]:
        """Describe the values of each named part of an observation by name, unit and range."""
        more = {"sensed": sensed_axes(world, self.fleet, self.senses)} if self.senses else {}
        lens = self.lens(world)
        most = (("rows", lens.most_rows), ("columns", lens.most_columns))
        return more | {"vehicle": BELIEVED, "grid": tuple(Axis(name, "1", 0.0, float(high)) for name, high in most)}

    def lens(self, world: World) -> Camera:
        """Return the camera that the agents' vehicles carry."""
        fleet = world.fleets[number_of(world, self.fleet)]
        camera = fleet.sensors[fleet.sensor_names.index(self.camera)]
        assert isinstance(camera, Camera)
        return camera
