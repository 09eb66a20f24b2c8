"""The simple tasks: hold a position, reach one, hold a velocity; by SI commands, at a cost.

The rewards of an episode add up to what the reference implementation returns at its end: minus the integral of the
costs, and for a place minus the squared distance from it at the end. That distance is paid as it changes, a potential
of the state (Ng, Harada and Russell 1999), so who learns hears of it at once, and the sum is that of the end for every
``period``. So is a part of what a crash costs: paid on the way to the nearest limit of the area, given back on the way
home and at the end. Who crashes gets what is missing to a total that no crash can have made better: see ``crash``.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control import VelocitySetpoint
from qrsim.core.noise import Draw
from qrsim.core.tree import field_info, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.commands import limits_of
from qrsim.models.vehicles.contracts import velocity_of
from qrsim.models.vehicles.quadrotor import Command
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
    square,
    velocity_axes,
)
from qrsim.tasks.contracts import Task
from qrsim.tasks.direct import (
    DIRECT,
    OBSERVED_RATES,
    accepts,
    command_kind,
    direct_axes,
    flown,
    measured_rates,
    own_hover,
)
from qrsim.tasks.perceived import sensed, sensed_axes, senses
from qrsim.world.state import Action, Fleet, FleetState, State, World

Crash = Literal["worst", "published"]
Actions = Literal["command", "velocity", "rates", "motors"]
# Largest velocity of an action in each axis [m/s].
FASTEST = 3.0
# Distance from the limits of a goal that is nearer to them, or beyond [m].
SHORTEST_REACH = 1.0


def axes_of(kind: type, hover: Any = None) -> tuple[Axis, ...]:
    """Describe the fields of a command record as numbers of an action; 0 of a throttle means ``hover`` ()."""
    limits = limits_of(kind)
    neutral = {"throttle": hover}
    return tuple(
        Axis(field.name, field_info(field).unit, *limits[field.name], neutral.get(field.name)) for field in fields(kind)
    )


@record
class NoTask(Task):
    """No task."""

    fleet: ClassVar[str] = ""  # type: ignore[misc]
    axes: ClassVar[tuple[Axis, ...]] = ()

    def init(self, world: World, state: State, draw: Draw) -> None:
        """Return None: the task has no memory."""

    def commands(self, memory: None, world: World, action: Array) -> tuple[Action, ...]:
        """Return one None (no command) per fleet."""
        return (None,) * len(world.fleets)

    def judge(self, memory: None, world: World, state: State, step: Array, steps: Array) -> tuple[None, Array]:
        """Return no memory and an empty reward (0,), because there are no agents."""
        return None, jnp.zeros(0)

    def observe(self, memory: None, world: World, state: State) -> Array:
        """Return empty observations (0, 0), because there are no agents."""
        return jnp.zeros((0, 0))

    def sees(self, world: World) -> tuple[Axis, ...]:
        """Return (): observations have no values."""
        return ()


@record
class Effort:
    """Cost of a command per second: |R (u - u_n)|^2."""

    tilt: Array = parameter(default=2.0 / math.pi, unit="1/rad", doc="weight of pitch and of roll", minimum=0.0)
    throttle: Array = parameter(default=0.5, unit="1", doc="weight of the throttle", minimum=0.0)
    yaw_rate: Array = parameter(default=1.0, unit="s/rad", doc="weight of the yaw rate", minimum=0.0)
    hover_throttle: Array = parameter(
        default=0.59, unit="1", doc="throttle without cost, and that of an action of 0", minimum=0.0, maximum=1.0
    )

    def rate(self, command: Any) -> Array:
        """Return the cost per second (n,) of commands (n,): weighted squares of tilt, throttle and yaw rate."""
        tilt = self.tilt * self.tilt * (command.pitch * command.pitch + command.roll * command.roll)
        throttle, yaw = self.throttle * (command.throttle - self.hover_throttle), self.yaw_rate * command.yaw_rate
        return tilt + throttle * throttle + yaw * yaw

    def highest_rate(self, kind: type = Command) -> Array:
        """Return the largest cost per second () that a command of type ``kind`` can have."""
        limits = limits_of(kind).values()
        low, high = (kind(*(jnp.full(1, each[end]) for each in limits)) for end in (0, 1))
        low = replace(low, pitch=high.pitch, roll=high.roll, yaw_rate=high.yaw_rate)
        return jnp.maximum(self.rate(low), self.rate(high))[0]


@record
class SimpleMemory:
    """Memory of vehicles (n,)."""

    start_ned: Vec3 = quantity(unit="m", doc="start of each vehicle")
    cost: Array = quantity(doc="integral of what this step costs each")
    owed: Array = quantity(doc="squared distance and stake of each that have been paid")
    total: Array = quantity(doc="() rewards so far, the sum over all")


@record
class Commanded(Task):
    """Base of the simple tasks: flown by SI commands, at a cost."""

    effort: Effort = quantity(default=Effort(), doc="cost of commands")
    penalty: Array = parameter(default=-1000.0, unit="1", doc="return of an episode that ends in a crash", maximum=0.0)
    crash: Crash = setting(
        default="worst",
        doc="return after a crash; published: the penalty; worst: at most the lowest return without a crash",
    )
    stake: Array = parameter(
        default=0.5,
        unit="1",
        doc="share of a crash's cost that is charged as the limits approach and repaid on retreat",
        minimum=0.0,
        maximum=1.0,
    )
    fleet: str = setting(default="pelicans", doc="name of the fleet whose vehicles are the agents")
    period: float = action_period(0.02)
    senses: tuple[str, ...] = senses()
    actions: Actions = setting(
        default="command",
        doc="numbers of an action: command: those of the vehicles; velocity: north, east and down over ground, up to "
        "3 m/s, which the fleet's controller flies with the heading north; rates: roll and pitch rate up to 3 rad/s, "
        "yaw rate up to 1.5 rad/s and throttle; motors: the speed of each rotor; both of multirotors",
    )

    # Of quadrotors; ``acts`` has those of the fleet.
    axes: ClassVar[tuple[Axis, ...]] = axes_of(Command)

    def asks(self, fleet: str) -> type | None:
        """Return the type of set-points with which agents steer a fleet; None if they give commands."""
        return VelocitySetpoint if self.actions == "velocity" else None

    def init(self, world: World, state: State, draw: Draw) -> SimpleMemory:
        """Return the task's memory at the start of an episode: vehicles' starts, and costs of 0."""
        _, fleet = fleet_of(world, state, self.fleet)
        start = fleet.vehicle.position_ned
        zero = jnp.zeros_like(start.x)
        return SimpleMemory(start, zero, zero, jnp.zeros((), zero.dtype))

    def acts(self, world: World) -> tuple[Axis, ...]:
        """Describe an action, a command of the fleet's vehicles or a velocity, by name, unit and range."""
        if self.actions == "velocity":
            return velocity_axes(FASTEST, "ned")
        vehicle = self._vehicle(world)
        if is_direct(self):
            return direct_axes(axes_of(self.action_type(world)), vehicle)
        hover = own_hover(vehicle) if accepts(type(vehicle)) else self.effort.hover_throttle
        return axes_of(self.command_type(world), hover)

    def _vehicle(self, world: World) -> Any:
        """Return the model of the fleet's vehicles."""
        return world.fleets[number_of(world, self.fleet)].vehicle

    def action_type(self, world: World) -> type:
        """Return the record type of commands that an action gives."""
        return command_kind(self.actions, self._vehicle(world)) if is_direct(self) else self.command_type(world)

    def command_type(self, world: World) -> type:
        """Return the record type of commands to the fleet's vehicles."""
        found: type = self._vehicle(world).command_type
        return found

    def commands(self, memory: SimpleMemory, world: World, action: Array) -> tuple[Action, ...]:
        """Convert actions (n, A), in physical units, to commands, or to velocity set-points heading north."""
        if self.actions == "velocity":
            return only(world, self.fleet, VelocitySetpoint(Vec3.of(action), jnp.zeros_like(action[:, 0])))
        return only(world, self.fleet, self.action_type(world)(*(action[:, i] for i in range(action.shape[1]))))

    def each_tick(self, memory: SimpleMemory, world: World, state: State) -> SimpleMemory:
        """Return the memory (costs so far) with the cost of one more tick."""
        cost = self.cost_rate(*fleet_of(world, state, self.fleet))
        return replace(memory, cost=memory.cost + cost * world.time_step)

    def cost_rate(self, model: Fleet, fleet: FleetState) -> Array:
        """Return the cost per second (n,) of each vehicle's present command; of rates and motors, of its motion."""
        return self.effort.rate(flown(self.actions, model, fleet) if is_direct(self) else fleet.command)

    def distance_squared(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return each vehicle's extra cost (n,) if the episode ended in this state; 0 here."""
        return jnp.zeros_like(memory.owed)

    def danger(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return each vehicle's share (n,) of the crash cost to charge now, from 0 at its goal to 1; 0 here."""
        return jnp.zeros_like(memory.owed)

    def judge(
        self, memory: SimpleMemory, world: World, state: State, step: Array, steps: Array
    ) -> tuple[SimpleMemory, Array]:
        """Return the memory and the reward (n,) of a step: minus the cost of all vehicles, the same for each."""
        distance = self.distance_squared(memory, world, state)
        stake = -self.stake * self.crash_return(memory, world, state, steps) / distance.shape[0]
        owed = distance + jnp.where(step < steps, stake * self.danger(memory, world, state), 0.0)
        reward = -jnp.sum(memory.cost + (owed - memory.owed))
        after = replace(memory, cost=jnp.zeros_like(owed), owed=owed, total=memory.total + reward)
        return after, jnp.broadcast_to(reward, owed.shape)

    def crashed(self, memory: SimpleMemory, world: World, state: State, steps: Array) -> Array:
        """Return the reward () of the step of a crash, with which the episode's sum of rewards is ``crash_return``."""
        return self.crash_return(memory, world, state, steps) - memory.total

    def crash_return(self, memory: SimpleMemory, world: World, state: State, steps: Array) -> Array:
        """Return the sum of rewards () that an episode with a crash has.

        Raises:
            UsageError: the area cannot say how far away one can be in it.
        """
        penalty = jnp.asarray(self.penalty)
        if self.crash == "published":
            return penalty
        duration = duration_of(steps, self.period, memory.total)
        cost = self.highest_cost(memory, world.with_drawn(state.drawn), duration)
        return jnp.minimum(penalty, -jnp.sum(cost))

    def with_sensed(self, world: World, state: State, *parts: Array) -> Array:
        """Return parts (n, ...) of an observation, with body rates if actions need them, and readings of ``senses``."""
        rates = [measured_rates(fleet_of(world, state, self.fleet)[1])] if is_direct(self) else []
        more = [sensed(world, state, self.fleet, self.senses)] if self.senses else []
        return jnp.concatenate([*parts, *rates, *more], axis=-1)

    def further_axes(self, world: World) -> tuple[Axis, ...]:
        """Describe the numbers that ``with_sensed`` appends, by name, unit and range."""
        rates = OBSERVED_RATES if is_direct(self) else ()
        return (*rates, *sensed_axes(world, self.fleet, self.senses))

    def highest_cost(self, memory: SimpleMemory, world: World, duration: Array) -> Array:
        """Return an upper bound of each vehicle's cost (n,) in ``duration`` [s] without a crash."""
        return jnp.broadcast_to(self.effort.highest_rate(self.command_type(world)) * duration, memory.owed.shape)


def is_direct(task: object) -> bool:
    """Return whether the actions of a task are body rates or rotor speeds, which no vehicle stabilises."""
    return isinstance(task, Commanded) and task.actions in DIRECT


@record
class KeepSpot(Commanded):
    """Stay at the start with little effort; the costs of several vehicles are added."""

    def sees(self, world: World) -> tuple[Axis, ...]:
        """Describe the values of an observation by name, unit and range: estimated state, offset to the goal."""
        goal = tuple(Axis(f"to_{name}", "m") for name in ("north", "east", "down"))
        return (*BELIEVED, *goal, *self.further_axes(world))

    def danger(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return the squared distance from the goal (n,), relative to that of the area's limit; at most 1.

        Who starts farther away than that limit has far to go in some directions and not in others: there it is the sum
        over north, east and down, of how much nearer the limits are at the vehicle than at the goal, each squared.
        """
        _, fleet = fleet_of(world, state, self.fleet)
        here = fleet.vehicle.position_ned
        goal = self.goal(memory.start_ned, world).map(lambda axis: jnp.broadcast_to(axis, here.x.shape))
        reach = jnp.maximum(world.area.margin(goal), SHORTEST_REACH)
        along = (replace(goal, x=here.x), replace(goal, y=here.y), replace(goal, z=here.z))
        nearer = [jnp.maximum(1.0 - world.area.margin(place) / reach, 0.0) for place in along]
        by_axis = nearer[0] * nearer[0] + nearer[1] * nearer[1] + nearer[2] * nearer[2]
        is_near = square(memory.start_ned - goal) <= reach * reach
        return jnp.minimum(jnp.where(is_near, square(here - goal) / (reach * reach), by_axis), 1.0)

    def distance_squared(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return the squared distance (n,) [m^2] of each vehicle from its goal."""
        _, fleet = fleet_of(world, state, self.fleet)
        return square(fleet.vehicle.position_ned - self.goal(memory.start_ned, world))

    def highest_cost(self, memory: SimpleMemory, world: World, duration: Array) -> Array:
        """Return the largest cost (n,): of commands for ``duration`` [s], and of ending at the farthest corner."""
        effort: Array = Commanded.highest_cost(self, memory, world, duration)
        return effort + world.area.farthest_squared(self.goal(memory.start_ned, world))

    def goal(self, start_ned: Vec3, world: World) -> Vec3:
        """Return each vehicle's goal (n,) NED [m]."""
        return start_ned

    def observe(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return each vehicle's observation (n, O): its estimated state and the offset to its goal."""
        _, fleet = fleet_of(world, state, self.fleet)
        offset = self.goal(memory.start_ned, world) - estimate_of(fleet).position_ned
        return self.with_sensed(world, state, believed(fleet), offset.stack())


@record
class ReachWaypoint(KeepSpot):
    """Fly to the last waypoint of the route and stay there, with little effort."""

    def goal(self, start_ned: Vec3, world: World) -> Vec3:
        """Return each vehicle's goal (n,) NED [m]."""
        route = next(fleet.route for fleet in world.fleets if fleet.name == self.fleet)
        return route.position_ned.map(lambda axis: axis[-1])


@record
class KeepVelocity(Commanded):
    """Fly at one velocity, with little effort."""

    velocity_north: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, north")
    velocity_east: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, east")
    velocity_down: Array = parameter(default=0.0, unit="m/s", doc="wanted velocity over ground, down")

    def sees(self, world: World) -> tuple[Axis, ...]:
        """Describe the values of an observation by name, unit and range: estimated state, velocity error."""
        lacking = tuple(Axis(f"wanting_{name}", "m/s") for name in ("north", "east", "down"))
        return (*BELIEVED, *lacking, *self.further_axes(world))

    def cost_rate(self, model: Fleet, fleet: FleetState) -> Array:
        """Return each vehicle's cost per second (n,): of its command, plus the squared velocity error."""
        error = velocity_of(model.vehicle.pose(fleet.vehicle)) - self._target_velocity()
        effort: Array = Commanded.cost_rate(self, model, fleet)
        return effort + square(error)

    def highest_cost(self, memory: SimpleMemory, world: World, duration: Array) -> Array:
        """Return the largest cost (n,) in ``duration`` [s]: of commands, and of velocity errors within the limits."""
        fleet = world.fleets[number_of(world, self.fleet)]
        error = math.sqrt(3.0) * fleet.limits.velocity + jnp.sqrt(square(self._target_velocity()))
        return Commanded.highest_cost(self, memory, world, duration) + error * error * duration

    def observe(self, memory: SimpleMemory, world: World, state: State) -> Array:
        """Return each vehicle's observation (n, O): its estimated state and its velocity error."""
        _, fleet = fleet_of(world, state, self.fleet)
        lacking = self._target_velocity() - estimate_of(fleet).velocity_ned
        return self.with_sensed(world, state, believed(fleet), lacking.stack())

    def _target_velocity(self) -> Vec3:
        """Return the velocity to keep, NED [m/s]."""
        return Vec3(self.velocity_north, self.velocity_east, self.velocity_down)
