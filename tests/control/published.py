"""Controllers and a vehicle as the reference implementation has them, where this package departs from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import jax.numpy as jnp

from qrsim.control.controllers import VelocityHeightController, VelocityHeightState, WaypointController
from qrsim.control.loops import HeightState, yaw_rate
from qrsim.control.setpoints import Estimate, VelocityHeightSetpoint, WaypointSetpoint
from qrsim.core.fastmath import sincos
from qrsim.core.tree import record, replace
from qrsim.core.vectors import AttitudeTrig, Vec3, rotation
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState


@record
class PublishedWaypoint(WaypointController):
    """The waypoint controller with u and v of the body in place of the level velocity along the heading."""

    def step(
        self, state: HeightState, estimate: Estimate, setpoint: WaypointSetpoint, dt: float
    ) -> tuple[HeightState, Command]:
        """Return the new state and the command (n,)."""
        body = rotation(estimate.attitude).to_body(estimate.velocity_ned)
        sine, cosine = sincos(estimate.attitude.yaw)
        # What the controller turns back by the heading.
        taken = Vec3(cosine * body.x - sine * body.y, sine * body.x + cosine * body.y, estimate.velocity_ned.z)
        return WaypointController.step(self, state, replace(estimate, velocity_ned=taken), setpoint, dt)


@record
class PublishedVelocityHeight(VelocityHeightController):
    """The velocity-height controller whose wanted velocity is level: a climb shows as a horizontal error."""

    def step(
        self, state: VelocityHeightState, estimate: Estimate, setpoint: VelocityHeightSetpoint, dt: float
    ) -> tuple[VelocityHeightState, Command]:
        """Return the new state and the command (n,)."""
        level = Vec3(setpoint.velocity_north, setpoint.velocity_east, jnp.zeros_like(setpoint.velocity_north))
        direction, limit = rotation(estimate.attitude), self.velocity.speed_limit
        wanted = direction.to_body(level).map(lambda axis: jnp.clip(axis, -limit, limit))
        error = wanted - direction.to_body(estimate.velocity_ned)
        horizontal, (forward, right) = self.velocity.step(
            state.horizontal, (error.x, error.y), level, self.tilt_limit, dt
        )
        height, throttle = self.height.step(state.height, estimate.position_ned.z, setpoint.z, dt)
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        battery = jnp.broadcast_to(jnp.asarray(self.battery), right.shape)
        return VelocityHeightState(horizontal, height), Command(-forward, right, throttle, turn, battery)


@record
class PublishedWind(Quadrotor):
    """The quadrotor whose wind is turned into the body once a step."""

    adds_position: ClassVar[bool] = True

    def step(
        self,
        state: QuadrotorState,
        command: Command,
        air_velocity: Callable[[AttitudeTrig], Vec3],
        noise: ProcessNoise,
        dt: float,
    ) -> tuple[QuadrotorState, Vec3]:
        """Advance one step."""
        air = air_velocity(AttitudeTrig.of(state.attitude))
        return Quadrotor.step(self, state, command, lambda trig: air, noise, dt)
