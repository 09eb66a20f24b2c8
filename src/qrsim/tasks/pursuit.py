"""Cats and mouse (docs/tasks.md), as in the reference implementation."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.control import VelocityHeightSetpoint
from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.tasks.agents import Axis, action_period, estimate_of, fleet_of, leaving, only, penalty, velocity_axes
from qrsim.tasks.contracts import Task
from qrsim.tasks.perceived import sensed, sensed_axes, senses
from qrsim.world.state import Action, State, World


@record
class PursuitMemory:
    """Memory of an episode."""

    z: Array = quantity(unit="m", doc="(n,) position down that each cat keeps")


@record
class Pursuit(Task):
    """Cats, the agents, catch a mouse that runs away.

    The reward comes in the last step: minus the sum over all cats of max(0, distance to the nearest mouse - reach)^2,
    reach being ``reach`` collision distances. (The reference sums the first cat only.)
    """

    reach: Array = parameter(default=2.0, unit="1", doc="collision distances that are near enough", minimum=0.0)
    penalty: Array = penalty()
    leave: bool = leaving()
    fleet: str = setting(default="cats", doc="name of the fleet whose vehicles are the agents")
    prey: str = setting(default="mice", doc="name of the fleet that is caught")
    period: float = action_period(1.0)
    senses: tuple[str, ...] = senses()

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ne")
    asks_for: ClassVar[type | None] = VelocityHeightSetpoint

    def init(self, world: World, state: State, draw: Draw) -> PursuitMemory:
        """Return the memory at the start."""
        _, fleet = fleet_of(world, state, self.fleet)
        return PursuitMemory(fleet.vehicle.position_ned.z)

    def commands(self, memory: PursuitMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Return velocities of numbers (n, 2), at the height of the start and heading north."""
        zero = jnp.zeros_like(action[:, 0])
        return only(world, self.fleet, VelocityHeightSetpoint(action[:, 0], action[:, 1], memory.z, zero))

    def judge(
        self, memory: PursuitMemory, world: World, state: State, step: Array, steps: int
    ) -> tuple[PursuitMemory, Array]:
        """Return the reward of all cats together for each of them; 0 before the last step."""
        _, cats = fleet_of(world, state, self.fleet)
        _, mice = fleet_of(world, state, self.prey)
        offset = _between(cats.vehicle.position_ned, mice.vehicle.position_ned)
        nearest = jnp.min(offset.norm(), axis=1)
        missing = jnp.maximum(nearest - self.reach * world.collision_distance, 0.0)
        reward = jnp.where(step >= steps, -jnp.sum(missing * missing), 0.0)
        return memory, jnp.broadcast_to(reward, nearest.shape)

    def observe(self, memory: PursuitMemory, world: World, state: State) -> Array:
        """Return each cat's measured position and velocity, and measured offsets to mice and other cats.

        North and east of each: position, velocity, offsets to the m mice, offsets to the n - 1 other cats in the order
        of the fleet, beginning behind the cat itself. With ``senses``, what these sensors say in place of all offsets.
        """
        _, cats = fleet_of(world, state, self.fleet)
        _, mice = fleet_of(world, state, self.prey)
        known = estimate_of(cats)
        own, velocity = known.position_ned, known.velocity_ned
        parts = [jnp.stack([own.x, own.y, velocity.x, velocity.y], axis=-1)]
        if self.senses:
            return jnp.concatenate([*parts, sensed(world, state, self.fleet, self.senses)], axis=-1)
        prey, count = estimate_of(mice), own.x.shape[0]
        to_mice, to_cats = -_between(own, prey.position_ned), -_between(own, own)
        order = (jnp.arange(count)[:, None] + jnp.arange(1, count)[None]) % count
        others = [jnp.take_along_axis(axis, order, axis=1) for axis in (to_cats.x, to_cats.y)]
        for north, east in ((to_mice.x, to_mice.y), others):
            parts.append(jnp.stack([north, east], axis=-1).reshape(count, -1))
        return jnp.concatenate(parts, axis=-1)

    def sees(self, world: World) -> tuple[Axis, ...]:
        """Describe the numbers of an observation."""
        count, mice = (
            next(fleet.size for fleet in world.fleets if fleet.name == name) for name in (self.fleet, self.prey)
        )
        named = [("position", "m"), ("velocity", "m/s")]
        if not self.senses:
            named += [(f"mouse_{i}_offset", "m") for i in range(mice)]
            named += [(f"cat_{i}_offset", "m") for i in range(1, count)]
        own = tuple(Axis(f"{name}_{axis}", unit) for name, unit in named for axis in ("north", "east"))
        return (*own, *sensed_axes(world, self.fleet, self.senses))


def _between(one: Vec3, other: Vec3) -> Vec3:
    """Return positions (n,) minus positions (m,), (n, m)."""
    return Vec3(*(getattr(one, axis)[:, None] - getattr(other, axis)[None] for axis in "xyz"))
