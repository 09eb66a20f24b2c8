"""A rover with steered front wheels, on tyres that slip (D1 to D4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.integrate import rk4
from qrsim.core.presets import Presets
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import AttitudeTrig, Euler, Rotation, Vec3
from qrsim.models.vehicles.contracts import Around, Load, Outline, Pose, Vehicle
from qrsim.models.vehicles.rover.commands import SteeringCommand
from qrsim.models.vehicles.rover.planar import Ground, Plane, felt, ground_of, set_down, slope_rates, tilt_of

# Below the first speed [m/s] the kinematic bicycle alone turns it, above the second its tyres; with this lag [s].
KINEMATIC_BELOW, SLIPS_FROM, KINEMATIC_LAG = 0.5, 1.5, 0.05
# The slip angles are those of a vehicle at least so fast [m/s].
SLOWEST = 1.0

PRESETS: Presets = {
    "car_1_10": {},
    "r1": {"mass": 10.0, "front_arm": 0.175, "rear_arm": 0.175, "yaw_inertia": 0.169, "speed_max": 3.0},
}


@record
class RoverState:
    """The state of n steered rovers; each array of shape (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="position of the centre of mass, on the ground")
    attitude: Euler = quantity(unit="rad", doc="tilt of the ground, and the heading")
    speed: Array = quantity(unit="m/s", doc="forward speed")
    slip_speed: Array = quantity(unit="m/s", doc="speed to the right")
    yaw_rate: Array = quantity(unit="rad/s", doc="rate of the heading")
    steering: Array = quantity(unit="rad", doc="angle of the front wheels, to the right positive")


@record
class _Motion:
    plane: Plane = quantity()
    speed: Array = quantity(unit="m/s")
    slip_speed: Array = quantity(unit="m/s")
    yaw_rate: Array = quantity(unit="rad/s")
    steering: Array = quantity(unit="rad")


@record
class Rover(Vehicle):
    """A bicycle model of a car, with lags of its drives, tyres that saturate, and the ground below.

    Parameters that are not given are those of the preset.
    """

    preset: Literal["car_1_10", "r1"] = setting(default="car_1_10", doc="rover that provides the parameters left out")
    mass: Array = parameter(default=4.0, unit="kg", doc="mass", above=0.0)
    front_arm: Array = parameter(default=0.165, unit="m", doc="from the centre of mass to the front axle", above=0.0)
    rear_arm: Array = parameter(default=0.165, unit="m", doc="from the centre of mass to the rear axle", above=0.0)
    yaw_inertia: Array = parameter(default=0.06, unit="kg m^2", doc="moment of inertia about down", above=0.0)
    friction: Array = parameter(default=0.7, unit="1", doc="largest force of a tyre divided by its load", above=0.0)
    cornering_stiffness: Array = parameter(
        default=10.0, unit="1/rad", doc="side force of a tyre divided by its load and slip angle", above=0.0
    )
    speed_max: Array = parameter(default=8.0, unit="m/s", doc="largest speed", above=0.0)
    speed_lag: Array = parameter(default=0.4, unit="s", doc="time constant of the speed", minimum=0.05)
    acceleration_max: Array = parameter(default=4.0, unit="m/s^2", doc="largest acceleration of its drive", above=0.0)
    steering_max: Array = parameter(default=0.5, unit="rad", doc="largest steering angle", above=0.0, maximum=0.8)
    steering_lag: Array = parameter(default=0.1, unit="s", doc="time constant of the steering", minimum=0.02)
    steering_rate_max: Array = parameter(default=4.0, unit="rad/s", doc="largest rate of the steering", above=0.0)
    gravity: Array = parameter(default=9.81, unit="m/s^2", doc="gravitational acceleration", above=0.0)

    presets: ClassVar[Presets] = PRESETS
    command_type: ClassVar[type] = SteeringCommand
    actions: ClassVar[tuple[type, ...]] = (SteeringCommand,)
    reads: ClassVar[tuple[str, ...]] = ("ground",)
    default_limits: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"pitch": math.pi / 2.0, "velocity": 30.0, "rate": 20.0}
    )
    default_controller: ClassVar[str] = "rover"
    rides: ClassVar[bool] = True
    pushable: ClassVar[tuple[str, ...]] = ("x", "y")

    def drive(self, speed: Array, curvature: Array) -> SteeringCommand:
        """Return the command (n,) for a speed [m/s] and a curvature [1/m], right positive, clipped to the limits."""
        steering = jnp.arctan((self.front_arm + self.rear_arm) * curvature)
        limit, most = self.steering_max, self.speed_max
        return SteeringCommand(jnp.clip(steering, -limit, limit), jnp.clip(speed, -most, most))

    def initial_state(self, position_ned: Vec3, attitude: Euler, velocity_body: Vec3, rates_body: Vec3) -> RoverState:
        """Return the state at a pose, with wheels straight."""
        zero = jnp.zeros_like(jnp.asarray(position_ned.x))
        return RoverState(position_ned, attitude, velocity_body.x, velocity_body.y, rates_body.z, zero)

    def idle_command(self, like: Array) -> SteeringCommand:
        """Return the command for standing still, wheels straight; ``like``: any array (n,), for the shape."""
        zero = jnp.zeros_like(like)
        return SteeringCommand(zero, zero)

    def load(self, state: RoverState) -> Load:
        """Return a battery load of NaN: the vehicle has no thrust, and no weight that thrust would carry."""
        nothing = jnp.full_like(state.speed, jnp.nan)
        return Load(nothing, nothing)

    def pose(self, state: RoverState) -> Pose:
        """Return position, attitude, velocity and body rates (n,) of a state."""
        zero = jnp.zeros_like(state.speed)
        return Pose(
            state.position_ned,
            state.attitude,
            Vec3(state.speed, state.slip_speed, zero),
            Vec3(zero, zero, state.yaw_rate),
        )

    def step(
        self,
        state: RoverState,
        command: SteeringCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> tuple[RoverState, Vec3]:
        """Return the state dt [s] later, and the mean specific force (n,); without ``around`` level ground at 0 m."""
        turned = tilt_of(state.attitude)
        after, force = rk4(lambda motion: self._slope(motion, command, turned), _motion_of(state), dt)
        plane, before = after.plane, state.position_ned
        place = Vec3(before.x + plane.north, before.y + plane.east, before.z)
        place, attitude = set_down(place, wrap_angle(plane.heading), ground_of(around, state.speed))
        moved = RoverState(place, attitude, after.speed, after.slip_speed, after.yaw_rate, after.steering)
        return moved, force

    def specific_force(
        self,
        state: RoverState,
        command: SteeringCommand,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: object,
        dt: float,
        around: Around | None = None,
    ) -> Vec3:
        """Return the specific force (n,) [m/s^2] in body axes at an instant, at the present speed and steering."""
        held = SteeringCommand(state.steering, state.speed)
        return self._slope(_motion_of(state), held, tilt_of(state.attitude))[1]

    def stopped(self, state: RoverState) -> RoverState:
        """Return the state with all motion set to zero, as for vehicles that have been stopped."""
        zero = jnp.zeros_like(state.speed)
        return replace(state, speed=zero, slip_speed=zero, yaw_rate=zero)

    def stood(self, state: RoverState, ground: Ground) -> RoverState:
        """Return the state put on the ground below; ``ground``: from position to (down coordinate, normal)."""
        place, attitude = set_down(state.position_ned, state.attitude.yaw, ground)
        return replace(state, position_ned=place, attitude=attitude)

    def pushed(self, state: RoverState, change_body: Vec3) -> RoverState:
        """Return the state after a velocity change (n,) [m/s], body axes; sideways, the tyres slip."""
        return replace(state, speed=state.speed + change_body.x, slip_speed=state.slip_speed + change_body.y)

    def outline(self) -> Outline:
        """Return the outline of a car, for pictures."""
        return Outline(kind="car", size=0.5)

    def _slope(self, motion: _Motion, command: SteeringCommand, turned: Rotation) -> tuple[_Motion, Vec3]:
        """Return the time derivative of a motion for a command, and the specific force (n,) [m/s^2] in body axes."""
        v, vy, r, delta = motion.speed, motion.slip_speed, motion.yaw_rate, motion.steering
        wanted = jnp.clip(command.steering, -self.steering_max, self.steering_max)
        turning = jnp.clip((wanted - delta) / self.steering_lag, -self.steering_rate_max, self.steering_rate_max)
        grip = self.friction * self.gravity
        fast = jnp.clip(command.speed, -self.speed_max, self.speed_max)
        hardest = jnp.minimum(self.acceleration_max, grip)
        ahead = jnp.clip((fast - v) / self.speed_lag, -hardest, hardest)
        aside, swing = self._cornering(v, vy, r, delta)
        sine, cosine = sincos(motion.plane.heading)
        north, east = slope_rates(turned, (sine, cosine), v, vy)
        slope = _Motion(Plane(north, east, r), ahead, aside, swing, turning)
        return slope, felt(turned, self.gravity, ahead - r * vy, aside + v * r)

    def _cornering(self, v: Array, vy: Array, r: Array, delta: Array) -> tuple[Array, Array]:
        """Return the rates of lateral velocity [m/s^2] and yaw rate [rad/s^2] (n,) by the tyres' side forces."""
        front, rear = self.front_arm, self.rear_arm
        tangent, cosine = jnp.tan(delta), jnp.cos(delta)
        forward = jnp.where(v < 0.0, -1.0, 1.0) * jnp.maximum(jnp.abs(v), SLOWEST)
        slip_front = delta - jnp.arctan((vy + front * r) / forward)
        slip_rear = -jnp.arctan((vy - rear * r) / forward)
        load = 0.5 * self.mass * self.gravity
        most, stiffness = self.friction * load, self.cornering_stiffness / self.friction
        push_front, push_rear = most * jnp.tanh(stiffness * slip_front), most * jnp.tanh(stiffness * slip_rear)
        side = (push_front * cosine + push_rear) / self.mass - v * r
        swing = (front * push_front * cosine - rear * push_rear) / self.yaw_inertia
        turn = v * tangent / (front + rear)
        side_slow, swing_slow = (rear * turn - vy) / KINEMATIC_LAG, (turn - r) / KINEMATIC_LAG
        share = jnp.clip((jnp.abs(v) - KINEMATIC_BELOW) / (SLIPS_FROM - KINEMATIC_BELOW), 0.0, 1.0)
        return share * side + (1.0 - share) * side_slow, share * swing + (1.0 - share) * swing_slow


def _motion_of(state: RoverState) -> _Motion:
    """Return the parts of a state that the solver integrates, with the displacement in the step set to 0."""
    zero = jnp.zeros_like(state.speed)
    return _Motion(Plane(zero, zero, state.attitude.yaw), state.speed, state.slip_speed, state.yaw_rate, state.steering)
