"""A rover that turns by the different speeds of its two sides (D5)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.integrate import rk4
from qrsim.core.tree import parameter, quantity, record, replace
from qrsim.core.vectors import AttitudeTrig, Euler, Rotation, Vec3
from qrsim.models.vehicles.contracts import Around, Load, Outline, Pose, Vehicle
from qrsim.models.vehicles.rover.commands import WheelCommand
from qrsim.models.vehicles.rover.planar import Ground, Plane, felt, ground_of, set_down, slope_rates, tilt_of


@record
class DifferentialRoverState:
    """The state of n rovers with two driven sides; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position of the middle between the wheels, on the ground")
    attitude: Euler = quantity(unit="rad", doc="tilt of the ground, and the heading")
    left: Array = quantity(unit="m/s", doc="speed of the left wheels at their rims")
    right: Array = quantity(unit="m/s", doc="speed of the right wheels at their rims")


@record
class _Motion:
    plane: Plane = quantity()
    left: Array = quantity(unit="m/s")
    right: Array = quantity(unit="m/s")


@record
class DifferentialRover(Vehicle):
    """Two driven sides with a lag; scrubbing reduces the yaw rate."""

    track: Array = parameter(default=0.4, unit="m", doc="distance between the left and right wheels", above=0.0)
    slip: Array = parameter(
        default=0.3, unit="1", doc="share of the yaw rate that is lost by scrubbing", minimum=0.0, maximum=0.95
    )
    friction: Array = parameter(default=0.7, unit="1", doc="largest force of a tyre divided by its load", above=0.0)
    speed_max: Array = parameter(default=3.0, unit="m/s", doc="largest speed of a wheel", above=0.0)
    speed_lag: Array = parameter(default=0.4, unit="s", doc="time constant of a wheel's speed", minimum=0.05)
    acceleration_max: Array = parameter(default=4.0, unit="m/s^2", doc="largest acceleration of a wheel", above=0.0)
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", above=0.0)

    command_type: ClassVar[type] = WheelCommand
    actions: ClassVar[tuple[type, ...]] = (WheelCommand,)
    reads: ClassVar[tuple[str, ...]] = ("ground",)
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"pitch": math.pi / 2.0, "velocity": 30.0, "rate": 20.0}
    )
    default_controller: ClassVar[str] = "rover"
    rides: ClassVar[bool] = True
    pushable: ClassVar[tuple[str, ...]] = ("x",)

    def drive(self, speed: Array, curvature: Array) -> WheelCommand:
        """Return the command (n,) for a speed [m/s] and a curvature [1/m], right positive, clipped to the limits."""
        # In a tight turn the rover is slower, so that the outer wheels stay below their largest speed.
        half = 0.5 * self.track / (1.0 - self.slip) * curvature
        most = self.speed_max / (1.0 + jnp.abs(half))
        speed = jnp.clip(speed, -most, most)
        return WheelCommand(speed * (1.0 + half), speed * (1.0 - half))

    def initial_state(
        self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3
    ) -> DifferentialRoverState:
        """Return the state at a pose; of the velocity only the forward part is used."""
        half = 0.5 * self.track / (1.0 - self.slip) * rates_body.z
        return DifferentialRoverState(position_ned, attitude, velocity_body.x + half, velocity_body.x - half)

    def idle_command(self, like: Array) -> WheelCommand:
        """Return the command for standing still; ``like``: any array (n,), for the shape."""
        zero = jnp.zeros_like(like)
        return WheelCommand(zero, zero)

    def load(self, state: DifferentialRoverState) -> Load:
        """Return a battery load of NaN: the vehicle has no thrust, and no weight that thrust would carry."""
        nothing = jnp.full_like(state.left, jnp.nan)
        return Load(nothing, nothing)

    def pose(self, state: DifferentialRoverState) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""
        speed, turn = self._turn(state.left, state.right)
        zero = jnp.zeros_like(speed)
        return Pose(state.position_ned, state.attitude, Vec3(speed, zero, zero), Vec3(zero, zero, turn))

    def step(
        self,
        state: DifferentialRoverState,
        command: WheelCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> tuple[DifferentialRoverState, Vec3]:
        """Return the state dt [s] later, and the mean specific force (n,); without ``around`` level ground at 0 m."""
        turned = tilt_of(state.attitude)
        after, force = rk4(lambda motion: self._slope(motion, command, turned), _motion_of(state), dt)
        plane, before = after.plane, state.position_ned
        place = Vec3(before.x + plane.north, before.y + plane.east, before.z)
        place, attitude = set_down(place, wrap_angle(plane.heading), ground_of(around, state.left))
        return DifferentialRoverState(place, attitude, after.left, after.right), force

    def specific_force(
        self,
        state: DifferentialRoverState,
        command: WheelCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant, at the present wheel speeds."""
        held = WheelCommand(state.left, state.right)
        return self._slope(_motion_of(state), held, tilt_of(state.attitude))[1]

    def stopped(self, state: DifferentialRoverState) -> DifferentialRoverState:
        """Return the state with all motion set to zero, as for vehicles that have been stopped."""
        zero = jnp.zeros_like(state.left)
        return replace(state, left=zero, right=zero)

    def stood(self, state: DifferentialRoverState, ground: Ground) -> DifferentialRoverState:
        """Return the state put on the ground below; ``ground``: from position to (down coordinate, normal)."""
        place, attitude = set_down(state.position_ned, state.attitude.yaw, ground)
        return replace(state, position_ned=place, attitude=attitude)

    def pushed(self, state: DifferentialRoverState, change_body: Vec3) -> DifferentialRoverState:
        """Return the state after a velocity change (n,) [m/s], forward only, as wheels do not slip sideways."""
        return replace(state, left=state.left + change_body.x, right=state.right + change_body.x)

    def outline(self) -> Outline:
        """Return the outline of a car, for pictures."""
        return Outline(kind="car", size=0.6)

    def _turn(self, left: Array, right: Array) -> tuple[Array, Array]:
        """Return speed [m/s] and yaw rate [rad/s] (n,) for left and right wheel speeds [m/s], limited by tyre grip."""
        speed = 0.5 * (left + right)
        turn = (left - right) * ((1.0 - self.slip) / self.track)
        most = self.friction * self.gravity / jnp.maximum(jnp.abs(speed), 1e-3)
        return speed, jnp.clip(turn, -most, most)

    def _slope(self, motion: _Motion, command: WheelCommand, turned: Rotation) -> tuple[_Motion, Vec3]:
        """Return the time derivative of a motion for a command, and the specific force (n,) [m/s^2] in body axes."""
        hardest = jnp.minimum(self.acceleration_max, self.friction * self.gravity)

        def spun(wanted: Array, wheel: Array) -> Array:
            """Return a wheel's acceleration [m/s^2] towards a wanted speed [m/s]."""
            fast = jnp.clip(wanted, -self.speed_max, self.speed_max)
            return jnp.clip((fast - wheel) / self.speed_lag, -hardest, hardest)

        left, right = spun(command.left, motion.left), spun(command.right, motion.right)
        speed, turn = self._turn(motion.left, motion.right)
        north, east = slope_rates(turned, sincos(motion.plane.heading), speed, jnp.zeros_like(speed))
        slope = _Motion(Plane(north, east, turn), left, right)
        return slope, felt(turned, self.gravity, 0.5 * (left + right), speed * turn)


def _motion_of(state: DifferentialRoverState) -> _Motion:
    """Return the parts of a state that the solver integrates, with the displacement in the step set to 0."""
    zero = jnp.zeros_like(state.left)
    return _Motion(Plane(zero, zero, state.attitude.yaw), state.left, state.right)
