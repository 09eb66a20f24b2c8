"""Cats and mouse (docs/explanation/task_design.md), as in the reference implementation."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

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
    mice_z: Any = quantity(default=None, unit="m", doc="(m,) that of each mouse, where these are agents")


@record
class Pursuit(Task):
    """Cats, the agents, catch a mouse that runs away.

    The reward comes in the last step: minus the sum over all cats of max(0, distance to the nearest mouse - reach)^2,
    reach being ``reach`` collision distances. (The reference sums the first cat only.)

    With ``mouse: agent`` the vehicles of ``prey`` are agents too, each with the opposite reward. A step in which a
    vehicle stops brings the penalty to both sides, so that nobody gains by a crash.
    """

    reach: Array = parameter(default=2.0, unit="1", doc="distance of a catch, in collision distances", minimum=0.0)
    penalty: Array = penalty()
    leave: bool = leaving()
    fleet: str = setting(default="cats", doc="name of the fleet whose vehicles are the agents")
    prey: str = setting(default="mice", doc="name of the fleet to catch")
    mouse: Literal["scripted", "agent"] = setting(
        default="scripted",
        doc="control of the fleet to catch: its guidance, or agents with velocity actions as cats have",
    )
    period: float = action_period(1.0)
    senses: tuple[str, ...] = senses()

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ne")
    asks_for: ClassVar[type | None] = VelocityHeightSetpoint

    def init(self, world: World, state: State, draw: Draw) -> PursuitMemory:
        """Return the task's memory at the start of an episode: the heights (z) that vehicles keep."""
        starts = [fleet_of(world, state, name)[1].vehicle.position_ned.z for name in self.fleets]
        return PursuitMemory(starts[0], starts[1] if self._both else None)

    @property
    def _both(self) -> bool:
        """Whether the mice are agents of the task too, and not flown by a guidance."""
        return self.mouse == "agent"

    @property
    def fleets(self) -> tuple[str, ...]:
        """Names of the fleets whose vehicles are the agents."""
        return (self.fleet, self.prey) if self._both else (self.fleet,)

    def acts(self, world: World) -> Any:
        """Describe an action, a horizontal velocity, by name, unit and range; by fleet if the mice are agents too."""
        return dict.fromkeys(self.fleets, self.axes) if self._both else self.axes

    def commands(self, memory: PursuitMemory, world: World, action: Any) -> tuple[Action, ...]:
        """Convert actions (n, 2), velocities [m/s], to set-points at the starting height with the heading north."""
        if not self._both:
            return only(world, self.fleet, _level_setpoint(action, memory.z))
        each = {
            self.fleet: _level_setpoint(action[self.fleet], memory.z),
            self.prey: _level_setpoint(action[self.prey], memory.mice_z),
        }
        return tuple(each.get(fleet.name) for fleet in world.fleets)

    def judge(
        self, memory: PursuitMemory, world: World, state: State, step: Array, steps: Array
    ) -> tuple[PursuitMemory, Any]:
        """Return the memory, and the reward that all cats share (mice: the negative one); 0 before the last step."""
        _, cats = fleet_of(world, state, self.fleet)
        _, mice = fleet_of(world, state, self.prey)
        offset = _between(cats.vehicle.position_ned, mice.vehicle.position_ned)
        nearest = jnp.min(offset.norm(), axis=1)
        missing = jnp.maximum(nearest - self.reach * world.collision_distance, 0.0)
        reward = jnp.where(step >= steps, -jnp.sum(missing * missing), 0.0)
        of_cats = jnp.broadcast_to(reward, nearest.shape)
        if not self._both:
            return memory, of_cats
        return memory, {self.fleet: of_cats, self.prey: jnp.broadcast_to(-reward, mice.vehicle.position_ned.x.shape)}

    def observe(self, memory: PursuitMemory, world: World, state: State) -> Any:
        """Return each cat's measured position, velocity, and offsets to mice and other cats; mice that are agents too.

        North and east of each: position, velocity, offsets to the m mice, offsets to the n - 1 other cats in the order
        of the fleet, beginning behind the cat itself. With ``senses``, what these sensors say in place of all offsets.
        A mouse that is an agent sees the same of itself, the n cats and the m - 1 other mice, always by offsets.
        """
        of_cats = self._seen(world, state, self.fleet, self.prey, bool(self.senses))
        if not self._both:
            return of_cats
        return {self.fleet: of_cats, self.prey: self._seen(world, state, self.prey, self.fleet, sensing=False)}

    def _seen(self, world: World, state: State, own_fleet: str, others_fleet: str, sensing: bool) -> Array:
        """Return the observations (n, O) of one side, in the order of ``observe`` [m, m/s].

        Args:
            world, state: those of the flight.
            own_fleet: the fleet that observes, n vehicles.
            others_fleet: the fleet that it pursues or flees from, m vehicles.
            sensing: the readings of ``senses`` replace all offsets.
        """
        _, side = fleet_of(world, state, own_fleet)
        _, opponents = fleet_of(world, state, others_fleet)
        known = estimate_of(side)
        own, velocity = known.position_ned, known.velocity_ned
        parts = [jnp.stack([own.x, own.y, velocity.x, velocity.y], axis=-1)]
        if sensing:
            return jnp.concatenate([*parts, sensed(world, state, self.fleet, self.senses)], axis=-1)
        count = own.x.shape[0]
        to_opponents, to_mates = -_between(own, estimate_of(opponents).position_ned), -_between(own, own)
        offsets = [(to_opponents.x, to_opponents.y)]
        if count > 1:
            # Row i: the mates of vehicle i, beginning behind it.
            order = (jnp.arange(count)[:, None] + jnp.arange(1, count)[None]) % count
            north, east = (jnp.take_along_axis(axis, order, axis=1) for axis in (to_mates.x, to_mates.y))
            offsets.append((north, east))
        for north, east in offsets:
            parts.append(jnp.stack([north, east], axis=-1).reshape(count, -1))
        return jnp.concatenate(parts, axis=-1)

    def sees(self, world: World) -> Any:
        """Describe the values of an observation by name, unit and range; by fleet if the mice are agents too."""
        sizes = {fleet.name: fleet.size for fleet in world.fleets}
        cats, mice = sizes[self.fleet], sizes[self.prey]
        of_cats = _seen_axes(0 if self.senses else mice, "mouse", 0 if self.senses else cats, "cat")
        of_cats = (*of_cats, *sensed_axes(world, self.fleet, self.senses))
        return {self.fleet: of_cats, self.prey: _seen_axes(cats, "cat", mice, "mouse")} if self._both else of_cats


def _seen_axes(others: int, other: str, count: int, mate: str) -> tuple[Axis, ...]:
    """Describe the values of one fleet's observation: own position and velocity, offsets to others and to mates."""
    names = [("position", "m"), ("velocity", "m/s"), *((f"{other}_{i}_offset", "m") for i in range(others))]
    names += [(f"{mate}_{i}_offset", "m") for i in range(1, count)]
    return tuple(Axis(f"{name}_{axis}", unit) for name, unit in names for axis in ("north", "east"))


def _level_setpoint(action: Array, z: Array) -> VelocityHeightSetpoint:
    """Return a set-point with a horizontal velocity (n, 2) [m/s], heading north, at down coordinate ``z`` [m]."""
    return VelocityHeightSetpoint(action[:, 0], action[:, 1], z, jnp.zeros_like(action[:, 0]))


def _between(one: Vec3, other: Vec3) -> Vec3:
    """Return the offsets (n, m) to each position of ``one`` (n,) from each of ``other`` (m,)."""
    return Vec3(*(getattr(one, axis)[:, None] - getattr(other, axis)[None] for axis in "xyz"))
