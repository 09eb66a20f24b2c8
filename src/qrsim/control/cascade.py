"""A cascade of position, velocity and thrust for vehicles that take tilt and throttle.

See docs/explanation/models/control.md, C10 to C15.

The structure is that of the multicopter position control of PX4: position error to velocity, velocity error to
acceleration, acceleration to the direction and size of the thrust; height goes before the horizontal.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Controller, Estimator
from qrsim.control.filter import ComplementaryFilter
from qrsim.control.loops import NEVER, yaw_rate
from qrsim.control.setpoints import (
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    Estimate,
    PathSetpoint,
    Setpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.core.fastmath import sincos
from qrsim.core.tree import derived, parameter, quantity, record, replace, select, setting
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.errors import UsageError
from qrsim.models.vehicles.contracts import Handling, Vehicle, handling_of, has_contact


@record
class CascadeState:
    """Memory of a cascade, (n,)."""

    integral: Vec3 = quantity(unit="m/s^2", doc="integral of the velocity error, NED")
    velocity: Vec3 = quantity(unit="m/s", doc="estimated velocity of the last step, NED")
    acceleration: Vec3 = quantity(unit="m/s^2", doc="filtered derivative of the velocity, NED")


@record
class CascadeController(Controller):
    """Holds positions, paths, velocities and heights in wind; for any vehicle that takes tilt and throttle."""

    position_gain: Array = parameter(default=1.2, unit="1/s", doc="commanded horizontal speed per metre of error")
    height_gain: Array = parameter(default=1.0, unit="1/s", doc="commanded climb rate per metre of error")
    speed_limit: Array = parameter(default=8.0, unit="m/s", doc="largest commanded horizontal speed", above=0.0)
    climb_limit: Array = parameter(default=3.0, unit="m/s", doc="largest commanded climb rate", above=0.0)
    sink_limit: Array = parameter(default=1.5, unit="m/s", doc="largest commanded sink rate", above=0.0)
    velocity_gain: Array = parameter(default=2.2, unit="1/s", doc="horizontal acceleration per velocity error")
    velocity_integral_gain: Array = parameter(default=0.9, unit="1/s^2", doc="the same, per integrated error")
    velocity_derivative_gain: Array = parameter(default=0.2, unit="1", doc="the same, per measured acceleration")
    derivative_lag: Array = parameter(default=0.05, unit="s", doc="time constant of the measured acceleration", above=0)
    velocity_integral_limit: Array = parameter(
        default=14.0, unit="m/s^2", doc="largest horizontal integral", minimum=0.0
    )
    climb_gain: Array = parameter(default=4.0, unit="1/s", doc="vertical acceleration per speed error")
    climb_integral_gain: Array = parameter(default=2.0, unit="1/s^2", doc="the same, per integrated error")
    climb_integral_limit: Array = parameter(default=6.0, unit="m/s^2", doc="largest vertical integral", minimum=0.0)
    tilt_limit: Array = parameter(
        default=0.611,
        unit="rad",
        doc="largest tilt of the thrust, as flown and not as commanded",
        above=0.0,
        maximum=1.4,
    )
    thrust_fraction: Array = parameter(
        default=0.98,
        unit="1",
        doc="share of the vehicle's largest thrust that the controller uses",
        above=0.0,
        maximum=1.0,
    )
    least_lift: Array = parameter(
        default=0.3, unit="1", doc="smallest lift, as a share of the weight", minimum=0.01, maximum=1.0
    )
    yaw_gain: Array = parameter(default=2.0, unit="1/s", doc="yaw rate per heading error")
    yaw_rate_limit: Array = parameter(default=1.0, unit="rad/s", doc="largest commanded yaw rate", above=0.0)
    filter: ComplementaryFilter = quantity(default=ComplementaryFilter(), doc="estimator, with feed filter")
    feed: Literal["filter", "measurements", "truth"] = setting(
        default="filter", doc="input of the controller: its filter, the sensors' readings, or the truth"
    )
    nominal: Vehicle | None = derived(default=None, doc="the vehicle that it is fitted to")

    setpoints: ClassVar[tuple[type, ...]] = (
        WaypointSetpoint,
        PathSetpoint,
        VelocitySetpoint,
        VelocityHeightSetpoint,
        AttitudeHeightSetpoint,
        AttitudeSetpoint,
    )
    gives: ClassVar[type] = object

    def fitted(self, vehicle: Vehicle) -> CascadeController:
        """Return the controller fitted to a nominal vehicle, of which it uses mass, thrust and command responses.

        Raises:
            UsageError: the vehicle takes no tilt and throttle.
        """
        if handling_of(vehicle) is None:
            raise UsageError(
                f"a cascade commands tilt and throttle, and {type(vehicle).__name__} says of none how it answers "
                "(handling); give the fleet another controller, as waypoint for an identified quadrotor"
            )
        return replace(self, nominal=vehicle)

    def estimator(self) -> Estimator | None:
        """Return the controller's own state estimator if ``feed`` is "filter", else None."""
        return self.filter if self.feed == "filter" else None

    def init(self, estimate: Estimate) -> CascadeState:
        """Return the controller's initial state for vehicles (n,); the estimate only gives the shape."""
        none = jnp.zeros_like(estimate.position_ned.z)
        zero, never = Vec3(none, none, none), jnp.full_like(none, NEVER)
        return CascadeState(zero, Vec3(never, never, never), zero)

    def shown(self, setpoint: Setpoint) -> PathSetpoint:
        """Return any kind of set-point as a ``PathSetpoint``, which a world's state keeps; NaN in unset fields."""
        zero = jnp.zeros_like(setpoint.yaw)
        none = jnp.full_like(zero, jnp.nan)
        nothing, still = Vec3(none, none, none), Vec3(zero, zero, zero)
        if isinstance(setpoint, PathSetpoint):
            return replace(setpoint, idle=None, level=None, blind=None)
        if isinstance(setpoint, WaypointSetpoint):
            return PathSetpoint(setpoint.position_ned, still, still, setpoint.yaw)
        if isinstance(setpoint, VelocitySetpoint):
            return PathSetpoint(nothing, setpoint.velocity_ned, still, setpoint.yaw)
        if isinstance(setpoint, AttitudeSetpoint):
            return PathSetpoint(nothing, nothing, nothing, setpoint.yaw)
        height = Vec3(none, none, setpoint.z)
        if isinstance(setpoint, VelocityHeightSetpoint):
            level = Vec3(setpoint.velocity_north, setpoint.velocity_east, none)
            return PathSetpoint(height, level, still, setpoint.yaw)
        return PathSetpoint(height, nothing, nothing, setpoint.yaw)

    def step(self, state: CascadeState, estimate: Estimate, setpoint: Any, dt: float) -> tuple[CascadeState, object]:
        """Return the state after a tick of dt [s], and the vehicle command (n,) that follows the set-point."""
        vehicle, known = self._vehicle()
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit) / known.yaw_rate_gain
        if isinstance(setpoint, AttitudeSetpoint):
            # Nothing is closed: whatever was learned of the wind is let go.
            pitch, roll = _within(setpoint.pitch, known.tilt_max), _within(setpoint.roll, known.tilt_max)
            return self.init(estimate), vehicle.tilt_command(pitch, roll, jnp.clip(setpoint.throttle, 0.0, 1.0), turn)
        wanted, forward = self._wanted_velocity(estimate, setpoint)
        error = wanted - estimate.velocity_ned
        state = self._differentiated(state, estimate.velocity_ned, dt)
        asked = forward + self._acceleration(state, error)
        force, limited = self._specific_thrust(asked, known)
        state = replace(state, integral=self._integrated(state.integral, error, asked, limited, known, dt))
        if isinstance(setpoint, AttitudeHeightSetpoint):
            pitch, roll = _within(setpoint.pitch, known.tilt_max), _within(setpoint.roll, known.tilt_max)
            none = jnp.zeros_like(pitch)
            state = replace(state, integral=Vec3(none, none, state.integral.z))
            size = -force.z / jnp.maximum(rotation(estimate.attitude).down.z, 0.1)
        else:
            size = force.norm()
            pitch, roll = _tilt(force, size, estimate.attitude, known)
        if isinstance(setpoint, PathSetpoint) and setpoint.level is not None and has_contact(vehicle):
            # Without a contact of its own a vehicle does not turn over its feet.
            level = setpoint.level
            pitch, roll, turn = (jnp.where(level, 0.0, value) for value in (pitch, roll, turn))
            size = jnp.where(level, -force.z, size)
        if isinstance(setpoint, PathSetpoint) and setpoint.blind is not None:
            blind, learned = setpoint.blind, state.integral
            pitch, roll = (jnp.where(blind, 0.0, value) for value in (pitch, roll))
            size = jnp.where(blind, -force.z, size)
            north, east = (jnp.where(blind, 0.0, axis) for axis in (learned.x, learned.y))
            state = replace(state, integral=Vec3(north, east, learned.z))
        throttle = known.throttle(known.mass * size)
        if isinstance(setpoint, PathSetpoint) and setpoint.idle is not None:
            idle = setpoint.idle
            pitch, roll, throttle, turn = (jnp.where(idle, 0.0, value) for value in (pitch, roll, throttle, turn))
            state = select(idle, self.init(estimate), state)
        return state, vehicle.tilt_command(pitch, roll, throttle, turn)

    def _vehicle(self) -> tuple[Vehicle, Handling]:
        """Return the nominal vehicle and its handling data; raise UsageError if the controller is not fitted."""
        known = None if self.nominal is None else self.nominal.handling()
        if self.nominal is None or known is None:
            raise UsageError("this cascade knows no vehicle; fit it first: controller.fitted(vehicle)")
        return self.nominal, known

    def _wanted_velocity(self, estimate: Estimate, setpoint: Any) -> tuple[Vec3, Vec3]:
        """Return the velocity [m/s] and feed-forward acceleration [m/s^2], (n,) NED, of a set-point (eq. C10)."""
        none = jnp.zeros_like(estimate.position_ned.z)
        acceleration = Vec3(none, none, none)
        if isinstance(setpoint, WaypointSetpoint | PathSetpoint):
            error = -estimate.offset_from(setpoint.position_ned)
            north, east, down = self.position_gain * error.x, self.position_gain * error.y, self.height_gain * error.z
            if isinstance(setpoint, PathSetpoint):
                along, acceleration = setpoint.velocity_ned, setpoint.acceleration_ned
                north, east, down = north + along.x, east + along.y, down + along.z
        elif isinstance(setpoint, VelocitySetpoint):
            north, east, down = setpoint.velocity_ned.x, setpoint.velocity_ned.y, setpoint.velocity_ned.z
        else:
            level = isinstance(setpoint, VelocityHeightSetpoint)
            north, east = (setpoint.velocity_north, setpoint.velocity_east) if level else (none, none)
            here_at_height = Vec3(estimate.position_ned.x, estimate.position_ned.y, setpoint.z)
            down = -self.height_gain * estimate.offset_from(here_at_height).z
        north, east = _shortened(north, east, self.speed_limit)
        return Vec3(north, east, jnp.clip(down, -self.climb_limit, self.sink_limit)), acceleration

    def _differentiated(self, state: CascadeState, velocity: Vec3, dt: float) -> CascadeState:
        """Return the state with the filtered time derivative of the velocity (n,) updated by its value now."""
        ran = state.velocity.x != NEVER
        share = dt / (self.derivative_lag + dt)

        def filtered(new: Array, old: Array, before: Array) -> Array:
            """Return the low-pass filtered derivative, from the value now, the last one, and the last derivative."""
            return before + share * (jnp.where(ran, (new - old) * (1.0 / dt), 0.0) - before)

        parts = [
            filtered(getattr(velocity, axis), getattr(state.velocity, axis), getattr(state.acceleration, axis))
            for axis in "xyz"
        ]
        return replace(state, velocity=velocity, acceleration=Vec3(*parts))

    def _acceleration(self, state: CascadeState, error: Vec3) -> Vec3:
        """Return the acceleration (n,) [m/s^2] NED commanded for a velocity error (n,) [m/s] (eq. C11)."""
        level = [
            self.velocity_gain * getattr(error, axis)
            + getattr(state.integral, axis)
            - self.velocity_derivative_gain * getattr(state.acceleration, axis)
            for axis in "xy"
        ]
        return Vec3(level[0], level[1], self.climb_gain * error.z + state.integral.z)

    def _specific_thrust(self, asked: Vec3, known: Handling) -> tuple[Vec3, Array]:
        """Return the limited thrust over mass (n,) [m/s^2] NED, and its largest horizontal part (eq. C12)."""
        most = known.thrust_max / known.mass
        z = jnp.clip(asked.z - known.gravity, -self.thrust_fraction * most, -self.least_lift * known.gravity)
        sine, cosine = sincos(jnp.asarray(self.tilt_limit))
        # Half a metre per second squared is left to lean with, whatever the height takes.
        left = jnp.sqrt(jnp.maximum(most * most - z * z, 0.25))
        limit = jnp.minimum(-z * (sine / cosine), left)
        north, east = _shortened(asked.x, asked.y, limit)
        return Vec3(north, east, z), limit

    def _integrated(self, integral: Vec3, error: Vec3, asked: Vec3, limit: Array, known: Handling, dt: float) -> Vec3:
        """Return the velocity loop's integral after dt [s], held while the thrust saturates that way (eq. C13)."""
        beyond = asked.x * asked.x + asked.y * asked.y > limit * limit
        held = beyond & (asked.x * error.x + asked.y * error.y > 0.0)
        gain = self.velocity_integral_gain * dt
        north = jnp.where(held, integral.x, integral.x + gain * error.x)
        east = jnp.where(held, integral.y, integral.y + gain * error.y)
        north, east = _shortened(north, east, self.velocity_integral_limit)
        most, wanted = known.thrust_max / known.mass, asked.z - known.gravity
        up, down = wanted < -self.thrust_fraction * most, wanted > -self.least_lift * known.gravity
        held = (up & (error.z < 0.0)) | (down & (error.z > 0.0))
        z = jnp.where(held, integral.z, integral.z + self.climb_integral_gain * dt * error.z)
        return Vec3(north, east, _within(z, self.climb_integral_limit))


def _within(value: Array, limit: Array) -> Array:
    """Return values clipped elementwise to [-limit, limit]."""
    return jnp.clip(value, -limit, limit)


def _shortened(x: Array, y: Array, limit: Array) -> tuple[Array, Array]:
    """Return a horizontal vector (n,) scaled down to a length of at most ``limit``, its direction kept."""
    square = x * x + y * y
    longer = square > limit * limit
    scale = jnp.where(longer, limit / jnp.sqrt(jnp.where(longer, square, 1.0)), 1.0)
    return x * scale, y * scale


def _tilt(force: Vec3, size: Array, attitude: Euler, known: Handling) -> tuple[Array, Array]:
    """Return pitch and roll commands (n,) [rad] that point the thrust along ``force`` (n,) [m/s^2] NED (eq. C14)."""
    sine, cosine = sincos(attitude.yaw)
    ahead, right = cosine * force.x + sine * force.y, cosine * force.y - sine * force.x
    down = -force.z
    pitch = jnp.arctan2(-ahead, down)
    roll = jnp.arctan2(right, jnp.sqrt(ahead * ahead + down * down))
    gain = known.tilt_gain if known.pitch_gain is None else known.pitch_gain
    return _within(pitch / gain, known.tilt_max), _within(roll / known.tilt_gain, known.tilt_max)
