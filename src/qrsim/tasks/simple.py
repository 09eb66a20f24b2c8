"""The simple tasks: hold a place, reach one, hold a velocity; by SI commands at every tick (spec: simple tasks)."""

from __future__ import annotations

import math
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.noise import Draw
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.vehicles.quadrotor import COMMAND_FIELDS, COMMAND_LIMITS, Command
from qrsim.tasks.agents import BELIEVED, Axis, action_period, believed, estimate_of, fleet_of, only, penalty, square
from qrsim.world_tree import Action, State, World

_UNITS = {"pitch": "rad", "roll": "rad", "throttle": "1", "yaw_rate": "rad/s", "battery": "V"}
AXES = tuple(Axis(name, _UNITS[name], *COMMAND_LIMITS[name]) for name in COMMAND_FIELDS)


@record
class NoTask:
    """Nothing is to be done."""

    fleet: ClassVar[str] = ""


@record
class Effort:
    """What a command costs per second: |R (u - u_n)|^2."""

    tilt: Array = parameter(default=2.0 / math.pi, unit="1/rad", doc="weight of pitch and of roll", minimum=0.0)
    throttle: Array = parameter(default=0.5, unit="1", doc="weight of the throttle", minimum=0.0)
    yaw_rate: Array = parameter(default=1.0, unit="s/rad", doc="weight of the yaw rate", minimum=0.0)
    hover_throttle: Array = parameter(
        default=0.59, unit="1", doc="throttle that costs nothing", minimum=0.0, maximum=1.0
    )

    def rate(self, command: Command) -> Array:
        """Return the cost per second of commands (n,)."""
        tilt = self.tilt * self.tilt * (command.pitch * command.pitch + command.roll * command.roll)
        throttle, yaw = self.throttle * (command.throttle - self.hover_throttle), self.yaw_rate * command.yaw_rate
        return tilt + throttle * throttle + yaw * yaw


@record
class SimpleMemory:
    """Of vehicles (n,)."""

    start_ned: Vec3 = quantity(unit="m", doc="where each started")
    effort: Array = quantity(doc="integral of what the commands of this step cost")


@record
class Commanded:
    """What the simple tasks share: they are flown by SI commands, which cost."""

    effort: Effort = quantity(default=Effort(), doc="what commands cost")
    penalty: Array = penalty()
    fleet: str = setting(default="pelicans", doc="name of the fleet whose vehicles are the agents")
    period: float = action_period(0.02)

    axes: ClassVar[tuple[Axis, ...]] = AXES
    asks_for: ClassVar[type | None] = None
    ids: ClassVar[int] = 0

    def init(self, world: World, state: State, draw: Draw) -> SimpleMemory:
        """Return what is remembered at the start."""
        _, fleet = fleet_of(world, state, self.fleet)
        return SimpleMemory(fleet.vehicle.position_ned, jnp.zeros_like(fleet.vehicle.thrust))

    def commands(self, memory: SimpleMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Return commands of numbers (n, 5)."""
        return only(world, self.fleet, Command(*(action[:, i] for i in range(len(COMMAND_FIELDS)))))

    def each_tick(self, memory: SimpleMemory, world: World, state: State) -> SimpleMemory:
        """Add what the command costs during a tick."""
        _, fleet = fleet_of(world, state, self.fleet)
        return SimpleMemory(memory.start_ned, memory.effort + self.effort.rate(fleet.command) * world.time_step)


@record
class KeepSpot(Commanded):
    """Stay at the start, with little effort; the costs of several vehicles are summed."""

    sees: ClassVar[tuple[Axis, ...]] = (*BELIEVED, *(Axis(f"to_{name}", "m") for name in ("north", "east", "down")))

    def judge(
        self, memory: SimpleMemory, world: World, state: State, step: Array, steps: int
    ) -> tuple[SimpleMemory, Array]:
        """Return minus the cost: of the commands, and of the squared distance from where each is to be."""
        _, fleet = fleet_of(world, state, self.fleet)
        cost = memory.effort + square(fleet.vehicle.position_ned - self.goal(memory, world))
        return _paid(memory), _shared(-cost)

    def goal(self, memory: SimpleMemory, world: World) -> Vec3:
        """Return where each vehicle (n,) is to be [m]."""
        return memory.start_ned

    def observe(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return what each vehicle believes of itself, and where the goal is from there."""
        _, fleet = fleet_of(world, state, self.fleet)
        offset = self.goal(memory, world) - estimate_of(fleet).position_ned
        return jnp.concatenate([believed(fleet), offset.stack()], axis=-1)


@record
class ReachWaypoint(KeepSpot):
    """Fly to the last waypoint of the route and stay there, with little effort."""

    def goal(self, memory: SimpleMemory, world: World) -> Vec3:
        """Return where each vehicle (n,) is to be [m]."""
        route = next(fleet.route for fleet in world.fleets if fleet.name == self.fleet)
        return route.position_ned.map(lambda axis: axis[-1])


@record
class KeepVelocity(Commanded):
    """Fly at one velocity, with little effort."""

    velocity_north: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, north")
    velocity_east: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, east")
    velocity_down: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, down")

    sees: ClassVar[tuple[Axis, ...]] = (
        *BELIEVED,
        *(Axis(f"wanting_{name}", "m/s") for name in ("north", "east", "down")),
    )

    def each_tick(self, memory: SimpleMemory, world: World, state: State) -> SimpleMemory:
        """Add what the command and the error of the velocity cost during a tick."""
        _, fleet = fleet_of(world, state, self.fleet)
        error = rotation(fleet.vehicle.attitude).to_ned(fleet.vehicle.velocity_body) - self._wanted()
        rate = self.effort.rate(fleet.command) + square(error)
        return SimpleMemory(memory.start_ned, memory.effort + rate * world.time_step)

    def judge(
        self, memory: SimpleMemory, world: World, state: State, step: Array, steps: int
    ) -> tuple[SimpleMemory, Array]:
        """Return minus the cost."""
        return _paid(memory), _shared(-memory.effort)

    def observe(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return what each vehicle believes of itself, and what it lacks of the wanted velocity."""
        _, fleet = fleet_of(world, state, self.fleet)
        lacking = self._wanted() - estimate_of(fleet).velocity_ned
        return jnp.concatenate([believed(fleet), lacking.stack()], axis=-1)

    def _wanted(self) -> Vec3:
        return Vec3(self.velocity_north, self.velocity_east, self.velocity_down)


def _paid(memory: SimpleMemory) -> SimpleMemory:
    return SimpleMemory(memory.start_ned, jnp.zeros_like(memory.effort))


def _shared(reward: Array) -> Array:
    """Return the sum for each of the vehicles (n,)."""
    return jnp.broadcast_to(jnp.sum(reward), reward.shape)
