"""Control loops of the reference implementation, and routes to feed them (models.md section 7)."""

from __future__ import annotations

import math
from typing import Literal

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import sincos, wrap_angle
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.quadrotor import COMMAND_LIMITS, Command


@record
class Estimate:
    """What a controller knows of each vehicle (n,): the truth, or what the sensors say."""

    position_ned: Vec3 = quantity(unit="m", doc="position")
    velocity_ned: Vec3 = quantity(unit="m/s", doc="velocity over ground")
    attitude: Euler = quantity(unit="rad", doc="Euler angles")


@record
class WaypointSetpoint:
    """Where to be and which way to look, (n,)."""

    position_ned: Vec3 = quantity(unit="m", doc="waypoint")
    yaw: Array = quantity(unit="rad", doc="heading")


@record
class HeightState:
    """Memory of a height loop, (n,)."""

    integral: Array = quantity(unit="m s", doc="integral of the error")
    error: Array = quantity(unit="m", doc="error of the last step")
    z_wanted: Array = quantity(unit="m", doc="set-point of the last step")


@record
class HeightLoop:
    """PID from height error to throttle around the hover throttle."""

    hover_throttle: Array = parameter(
        default=0.59, unit="1", doc="throttle that carries the weight", minimum=0.0, maximum=1.0
    )
    kp: Array = parameter(default=0.03, unit="1/m", doc="proportional gain")
    ki: Array = parameter(default=0.0008, unit="1/(m s)", doc="integral gain")
    kd: Array = parameter(default=0.04, unit="s/m", doc="derivative gain")
    anti_windup: Array = parameter(default=2.0, unit="m s", doc="taken off the integral per unit of clipped throttle")

    def init(self, z: Array) -> HeightState:
        """Return a state that has not seen a set-point; z is (n,) [m]."""
        return HeightState(jnp.zeros_like(z), jnp.zeros_like(z), jnp.full_like(z, math.inf))

    def step(self, state: HeightState, z: Array, z_wanted: Array, dt: float) -> tuple[HeightState, Array]:
        """Return the new state and the throttle [0, 1] for z and z_wanted (n,) [m], down positive."""
        error = z - z_wanted
        # A new set-point would show as a spike of the derivative.
        rate = jnp.where(z_wanted == state.z_wanted, (error - state.error) / dt, 0.0)
        integral = state.integral + error * dt
        unclipped = self.hover_throttle + self.kp * error + self.ki * integral + self.kd * rate
        throttle = jnp.clip(unclipped, *COMMAND_LIMITS["throttle"])
        return HeightState(integral - self.anti_windup * (unclipped - throttle), error, z_wanted), throttle


@record
class WaypointController:
    """Flies to a waypoint at a limited speed, holding height and heading."""

    position_gain: Array = parameter(default=0.9, unit="1/s", doc="wanted speed per metre of error")
    speed_limit: Array = parameter(
        default=5.0, unit="m/s", doc="largest wanted speed along each heading axis", above=0.0
    )
    velocity_gain: Array = parameter(default=0.09, unit="rad s/m", doc="tilt per speed error")
    tilt_limit: Array = parameter(
        default=0.34, unit="rad", doc="largest commanded tilt per axis", above=0.0, maximum=0.9
    )
    yaw_gain: Array = parameter(default=6.0, unit="1/s", doc="yaw rate per heading error")
    yaw_rate_limit: Array = parameter(
        default=4.4, unit="rad/s", doc="largest commanded yaw rate", above=0.0, maximum=4.5
    )
    battery: Array = parameter(default=12.0, unit="V", doc="battery voltage", minimum=9.0, maximum=12.0)
    height: HeightLoop = quantity(default=HeightLoop(), doc="height loop")
    feed: Literal["measurements", "truth"] = setting(default="measurements", doc="what the controller is fed with")

    def init(self, estimate: Estimate) -> HeightState:
        """Return the state of a controller that has not run."""
        return self.height.init(estimate.position_ned.z)

    def step(
        self, state: HeightState, estimate: Estimate, setpoint: WaypointSetpoint, dt: float
    ) -> tuple[HeightState, Command]:
        """Return the new state and the command (n,)."""
        error = setpoint.position_ned - estimate.position_ned
        sine, cosine = sincos(estimate.attitude.yaw)

        def to_heading(north: Array, east: Array) -> tuple[Array, Array]:
            return cosine * north + sine * east, cosine * east - sine * north

        ahead, right = to_heading(error.x, error.y)
        u, v = to_heading(estimate.velocity_ned.x, estimate.velocity_ned.y)
        u_wanted = jnp.clip(self.position_gain * ahead, -self.speed_limit, self.speed_limit)
        v_wanted = jnp.clip(self.position_gain * right, -self.speed_limit, self.speed_limit)
        pitch = jnp.clip(self.velocity_gain * (u - u_wanted), -self.tilt_limit, self.tilt_limit)
        roll = jnp.clip(self.velocity_gain * (v_wanted - v), -self.tilt_limit, self.tilt_limit)
        yaw_error = wrap_angle(setpoint.yaw - estimate.attitude.yaw)
        yaw_rate = jnp.clip(self.yaw_gain * yaw_error, -self.yaw_rate_limit, self.yaw_rate_limit)
        state, throttle = self.height.step(state, estimate.position_ned.z, setpoint.position_ned.z, dt)
        return state, Command(pitch, roll, throttle, yaw_rate, jnp.broadcast_to(self.battery, pitch.shape))


@record
class Route:
    """Waypoints of each vehicle, padded to the longest route: W waypoints, n vehicles."""

    position_ned: Vec3 = quantity(unit="m", doc="(W, n) waypoints")
    yaw: Array = quantity(unit="rad", doc="(W, n) heading towards and at each waypoint")
    count: Array = quantity(doc="(n,) int32 number of waypoints")


@record
class RouteState:
    """Which waypoint each vehicle (n,) flies to."""

    index: Array = quantity(doc="int32")
    reached: Array = quantity(doc="int32 waypoints reached so far")


@record
class RouteFollower:
    """Hands out the next waypoint when the current one is near."""

    acceptance_radius: Array = parameter(
        default=3.0, unit="m", doc="distance at which a waypoint counts as reached", above=0.0
    )
    repeat: bool = setting(default=True, doc="start again after the last waypoint, else hold there")

    def init(self, route: Route) -> RouteState:
        """Return the start of each route."""
        zero = jnp.zeros(route.count.shape, jnp.int32)
        return RouteState(zero, zero)

    def step(self, state: RouteState, route: Route, position_ned: Vec3) -> tuple[RouteState, WaypointSetpoint]:
        """Return the new state and the set-point for vehicles that believe to be at position_ned (n,)."""
        arrived = (self.setpoint(state, route).position_ned - position_ned).norm() < self.acceptance_radius
        following = state.index + 1
        last = jnp.zeros_like(following) if self.repeat else route.count - 1
        following = jnp.where(following >= route.count, last, following)
        # Where a vehicle stays, at the last waypoint or the only one, it arrives once.
        counts = arrived & ((following != state.index) | (state.reached < route.count))
        moved = RouteState(jnp.where(arrived, following, state.index), state.reached + counts.astype(jnp.int32))
        return moved, self.setpoint(moved, route)

    @staticmethod
    def setpoint(state: RouteState, route: Route) -> WaypointSetpoint:
        """Return the current waypoint of each vehicle (n,)."""
        # A sum over a one-hot mask, because gathers are slow on a CPU and routes are short.
        rows = jnp.arange(route.yaw.shape[0], dtype=jnp.int32)[:, None]
        chosen = rows == state.index[None, :]

        def pick(values: Array) -> Array:
            return jnp.sum(jnp.where(chosen, values, 0.0), axis=0)

        return WaypointSetpoint(route.position_ned.map(pick), pick(route.yaw))
