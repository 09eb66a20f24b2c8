"""Keeping a formation by radio (docs/explanation/task_design.md)."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.control import VelocitySetpoint
from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record, setting
from qrsim.core.vectors import Vec3
from qrsim.models.radio.contracts import Inbox
from qrsim.tasks.agents import (
    BELIEVED,
    Axis,
    action_period,
    believed,
    duration_of,
    estimate_of,
    fleet_of,
    number_of,
    only,
    penalty,
    square,
    velocity_axes,
)
from qrsim.tasks.contracts import Task
from qrsim.world.state import Action, State, World

# Numbers of a beacon: position and velocity NED. An observation has these, an age and a mask for each other vehicle.
BEACON, OTHER = 6, 8


@record
class FormationMemory:
    """Memory of agents (n,)."""

    cost: Array = quantity(unit="m^2 s", doc="integral of each agent's squared error in this step")
    total: Array = quantity(unit="m^2", doc="rewards of each agent so far")


@record
class KeepFormation(Task):
    """Keep a place in a formation that follows a leader, by the positions that are received by radio.

    The places are the first waypoints of the agents, or their starts without waypoints, relative to the start of the
    leader. An agent's return is minus the mean over time of its squared error [m^2]. The error counts up to
    sqrt(-``penalty``), and a flight that ends early returns ``penalty``, so that no crash pays.
    """

    penalty: Array = penalty()
    fleet: str = setting(default="followers", doc="name of the fleet of the agents")
    leader: str = setting(default="leaders", doc="name of the fleet with the leader, its first vehicle")
    period: float = action_period(0.2)

    axes: ClassVar[tuple[Axis, ...]] = velocity_axes(3.0, "ned")
    asks_for: ClassVar[type | None] = VelocitySetpoint
    receives: ClassVar[bool] = True

    def init(self, world: World, state: State, draw: Draw) -> FormationMemory:
        """Return the task's memory at the start of an episode: costs and rewards of 0."""
        zero = jnp.zeros_like(fleet_of(world, state, self.fleet)[1].vehicle.position_ned.x)
        return FormationMemory(zero, zero)

    def commands(self, memory: FormationMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Convert actions (n, 3), velocities [m/s], to velocity set-points with the heading north."""
        return only(world, self.fleet, VelocitySetpoint(Vec3.of(action), jnp.zeros_like(action[:, 0])))

    def places(self, world: World) -> Vec3:
        """Return the positions (n,) NED [m] relative to the leader at which agents should fly (their places)."""
        followers, leaders = (world.fleets[number_of(world, name)] for name in (self.fleet, self.leader))
        first = followers.route.position_ned.map(lambda axis: axis[0])
        return first - leaders.start.position_ned.map(lambda axis: axis[0])

    def to_places(self, world: World, state: State) -> Vec3:
        """Return the true offsets (n,) NED [m] from the agents to their places in the formation."""
        (_, own), (_, leaders) = (fleet_of(world, state, name) for name in (self.fleet, self.leader))
        return leaders.vehicle.position_ned.map(lambda axis: axis[0]) + self.places(world) - own.vehicle.position_ned

    def each_tick(self, memory: FormationMemory, world: World, state: State) -> FormationMemory:
        """Return the memory with the agents' squared errors of one more tick."""
        error = jnp.minimum(square(self.to_places(world, state)), -jnp.asarray(self.penalty))
        return FormationMemory(memory.cost + error * world.time_step, memory.total)

    def judge(
        self, memory: FormationMemory, world: World, state: State, step: Array, steps: Array
    ) -> tuple[FormationMemory, Array]:
        """Return the memory and the agents' rewards (n,): minus this step's part of their mean squared errors [m^2]."""
        reward = -memory.cost / duration_of(steps, self.period, memory.cost)
        return FormationMemory(jnp.zeros_like(reward), memory.total + reward), reward

    def crashed(self, memory: FormationMemory, world: World, state: State, steps: Array) -> Array:
        """Return the rewards (n,) of the step of a crash, with which each agent's sum of rewards is ``penalty``."""
        return self.penalty - memory.total

    def truth(self, memory: FormationMemory, world: World, state: State) -> dict[str, Array]:
        """Return {"to_place_ned": (n, 3)}, the true offset NED [m] from each agent to its place in the formation."""
        return {"to_place_ned": self.to_places(world, state).stack()}

    def observe(self, memory: FormationMemory, world: World, state: State) -> Array:
        """Return the agents' observations (n, 9 + 8 n) as without radio messages: estimated states, then zeros."""
        own = believed(fleet_of(world, state, self.fleet)[1])
        return jnp.concatenate([own, jnp.zeros((own.shape[0], OTHER * own.shape[0]), own.dtype)], axis=-1)

    def observe_received(self, memory: FormationMemory, world: World, state: State, inbox: Inbox) -> Array:
        """Return observations (n, 9 + 8 n): estimated states, and what messages tell of the leader and other agents.

        For each: the offset from the agent to its place by that vehicle's position, where this vehicle would be now at
        the velocity that it sent; that velocity; the age of the message [s]; and 1. All are 0 without a message. The
        agents follow in the order of the fleet, beginning behind the agent itself.

        Args:
            memory, world, state: of the flight.
            inbox: messages that all vehicles of the world have received.
        """
        _, fleet = fleet_of(world, state, self.fleet)
        own = believed(fleet)
        senders, places = self._others(world)
        rows = world.rows_of(self.fleet)
        payload = inbox.payload[rows, :, :BEACON]
        # A sender without a fix sends NaN.
        there = inbox.mask[rows] & jnp.all(jnp.isfinite(payload), axis=-1)
        # Which of the messages (n, K) is of each other vehicle (n, M).
        which = there[:, None, :] & (inbox.sender[rows][:, None, :] == senders[:, :, None])
        beacon = jnp.sum(jnp.where(which[..., None], payload[:, None], 0.0), axis=2)
        age = jnp.sum(jnp.where(which, inbox.age[rows][:, None], 0.0), axis=2)
        heard = jnp.any(which, axis=2)
        position = estimate_of(fleet).position_ned.stack()[:, None]
        now = beacon[..., :3] + age[..., None] * beacon[..., 3:]
        to_place = jnp.where(heard[..., None], now + places - position, 0.0)
        marks = jnp.stack([age, heard.astype(age.dtype)], axis=-1)
        others = jnp.concatenate([to_place, beacon[..., 3:], marks], axis=-1)
        return jnp.concatenate([own, others.reshape(own.shape[0], -1)], axis=-1)

    def sees(self, world: World) -> tuple[Axis, ...]:
        """Describe the values of an observation by name, unit and range."""
        size = world.fleets[number_of(world, self.fleet)].size
        return (
            *BELIEVED,
            *_other_axes("", "leader"),
            *(axis for mate in range(1, size) for axis in _other_axes(f"mate_{mate}_", f"mate_{mate}")),
        )

    def _others(self, world: World) -> tuple[NumpyArray, Array]:
        """Return for each agent the others' vehicle numbers (n, M), and its place relative to each (n, M, 3) [m].

        M = n: the leader and the n - 1 other agents, beginning behind the agent itself.
        """
        count, first = world.fleets[number_of(world, self.fleet)].size, world.rows_of(self.fleet).start
        order = (np.arange(count)[:, None] + np.arange(1, count)[None]) % count
        leader = np.full((count, 1), world.rows_of(self.leader).start)
        places = self.places(world).stack()
        from_others = [places, *(places - jnp.roll(places, -mate, axis=0) for mate in range(1, count))]
        return np.concatenate([leader, first + order], axis=1).astype(np.int32), jnp.stack(from_others, axis=1)


def _other_axes(prefix: str, name: str) -> tuple[Axis, ...]:
    """Describe what an observation has of another vehicle; the names begin with ``prefix`` or ``name``."""
    directions = ("north", "east", "down")
    return (
        *(Axis(f"{prefix}to_place_{axis}", "m") for axis in directions),
        *(Axis(f"{name}_velocity_{axis}", "m/s") for axis in directions),
        Axis(f"{name}_age", "s", 0.0),
        Axis(f"{name}_heard", "1", 0.0, 1.0),
    )
