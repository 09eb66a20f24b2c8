"""Search and rescue (docs/explanation/task_design.md), as in the reference implementation."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

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
    square,
    velocity_axes,
)
from qrsim.tasks.contracts import Task
from qrsim.tasks.perceived import sensed, sensed_axes, senses
from qrsim.world.episode import film, picture, surroundings
from qrsim.world.state import Action, State, World

# Largest size of a ratio in an observation of the likeliest window, and of the squared distance to a person [m^2].
MOST_RATIO, FARTHEST = 20.0, 1e12
LIKELIEST = (Axis("likeliest_north", "m"), Axis("likeliest_east", "m"), Axis("likeliest_ratio", "1", -20.0, 20.0))


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
    observes: Literal["picture", "likeliest"] = setting(
        default="picture",
        doc="picture: a dict with the ratios of all windows; likeliest: an array of numbers with the offset to the "
        "window of the largest ratio, and this ratio",
    )

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ned")
    asks_for: ClassVar[type | None] = VelocitySetpoint

    def init(self, world: World, state: State, draw: Draw) -> SearchMemory:
        """Return the task's memory at the start of an episode: vehicles' headings, and no persons found."""
        model, fleet = fleet_of(world, state, self.fleet)
        return SearchMemory(model.vehicle.pose(fleet.vehicle).attitude.yaw, jnp.int32(0))

    def commands(self, memory: SearchMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Convert actions (n, 3), velocities [m/s], to velocity set-points with the starting heading."""
        return only(world, self.fleet, VelocitySetpoint(Vec3.of(action), memory.yaw))

    def judge(
        self, memory: SearchMemory, world: World, state: State, step: Array, steps: Array
    ) -> tuple[SearchMemory, Array]:
        """Return the memory and each vehicle's reward (n,): persons found in a step; if none, -1 / ``steps``."""
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

    def observe(self, memory: SearchMemory, world: World, state: State) -> Any:
        """Return the vehicles' observations by name: estimated state and last camera picture, arrays (n, ...).

        ``vehicle`` (n, 9) is what it believes of itself, ``ratio`` (n, R, C) the log-likelihood ratio of each window of
        its last picture, 0 beyond the grid, ``grid`` (n, 2) the rows and columns of the grid, and ``corners`` (n, 4, 2)
        north and east [m] of the grid's corners on the ground: upper left, upper right, lower right, lower left. They
        and the grid are enough to know all windows' corners. ``sensed`` (n, S) is what the sensors of ``senses`` say.

        With ``observes: likeliest`` it is an array (n, 12 + S): ``vehicle``, the offset north and east [m] from where
        the last picture was taken to the middle of the window with the largest ratio, that ratio, and ``sensed``. The
        offset is 0 unless the ratio is above ln(R C), where a person is as likely as none.
        """
        if self.observes == "likeliest":
            return self._likeliest(world, state)
        ratio = self.picture(world, state).ratio
        # Nothing is seen any more by a vehicle that has stopped.
        return self.observe_early(memory, world, state) | {"ratio": jnp.where(jnp.isfinite(ratio), ratio, 0.0)}

    def later(self, world: World) -> dict[str, tuple[int, ...]]:
        """Return {"ratio": (n, R, C)}; {} without pictures, or if a subclass overrides ``observe`` or ``picture``."""
        if self.observes != "picture" or (type(self).observe, type(self).picture) != (Search.observe, Search.picture):
            return {}
        lens = self.lens(world)
        return {"ratio": (world.fleets[number_of(world, self.fleet)].size, lens.most_rows, lens.most_columns)}

    def observe_early(self, memory: SearchMemory, world: World, state: State) -> dict[str, Array]:
        """Return the observations without the log-likelihood ratios ("ratio") of the pictures."""
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

    def truth(self, memory: SearchMemory, world: World, state: State) -> dict[str, Array]:
        """Return name -> true values: offset (n, 3) NED [m] to the nearest missing person, number missing (n,).

        The offset is 0 once all are found. With ``observes: picture`` the dict is empty.
        """
        if self.observes == "picture":
            return {}
        model, fleet = fleet_of(world, state, self.fleet)
        here, persons = model.vehicle.pose(fleet.vehicle).position_ned, state.contents.persons
        missing = persons.missing()
        offset = Vec3(persons.north[None] - here.x[:, None], persons.east[None] - here.y[:, None], -here.z[:, None])
        squared = jnp.where(missing[None], square(offset), FARTHEST)
        nearest = (squared == jnp.min(squared, axis=1, keepdims=True)) & missing[None]
        share = nearest.astype(squared.dtype)
        share = share / jnp.maximum(jnp.sum(share, axis=1, keepdims=True), 1.0)
        to_person = offset.map(lambda axis: jnp.sum(share * axis, axis=1))
        number = jnp.sum(missing).astype(squared.dtype)
        return {"to_person_ned": to_person.stack(), "missing": jnp.broadcast_to(number, here.x.shape)}

    def _likeliest(self, world: World, state: State) -> Array:
        """Return observations (n, 12 + S): estimated state, offset to the likeliest picture cell, ratio, sensors."""
        _, fleet = fleet_of(world, state, self.fleet)
        picture, taken_at = self.picture(world, state), self.shot(world, state).taken_at_ned
        shown = jnp.isfinite(picture.ratio)
        ratio = jnp.where(shown, jnp.clip(picture.ratio, -MOST_RATIO, MOST_RATIO), -MOST_RATIO)
        most = jnp.max(ratio, axis=(1, 2), keepdims=True)
        # A person anywhere in the picture is as likely as not at the logarithm of the number of windows.
        likely = most > jnp.log(jnp.maximum(jnp.sum(shown, axis=(1, 2), keepdims=True), 1).astype(ratio.dtype))
        best = shown & (ratio == most) & likely
        count = jnp.maximum(jnp.sum(best, axis=(1, 2)), 1).astype(ratio.dtype)

        def offset(corners: Array, start: Array) -> Array:
            """Return the offset (n,) [m] along one axis from ``start`` to the middle of the likeliest picture cell."""
            middle = 0.25 * (corners[:, 1:, 1:] + corners[:, 1:, :-1] + corners[:, :-1, 1:] + corners[:, :-1, :-1])
            return jnp.sum(jnp.where(best, middle - start[:, None, None], 0.0), axis=(1, 2)) / count

        found = [offset(picture.north, taken_at.x), offset(picture.east, taken_at.y), most[:, 0, 0]]
        parts = [believed(fleet), jnp.stack(found, axis=-1)]
        more = [sensed(world, state, self.fleet, self.senses)] if self.senses else []
        return jnp.concatenate([*parts, *more], axis=-1)

    def sees(self, world: World) -> Any:
        """Describe an observation's values, or those of each named part, by name, unit and range."""
        if self.observes == "likeliest":
            return (*BELIEVED, *LIKELIEST, *sensed_axes(world, self.fleet, self.senses))
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
