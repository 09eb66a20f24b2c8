"""Controllers: map an estimate and a set-point to a command; one record for each kind of set-point."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Controller
from qrsim.control.loops import ClimbLoop, HeightLoop, HeightState, VelocityLoop, VelocityState, yaw_rate
from qrsim.control.setpoints import (
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    Estimate,
    OffboardSetpoint,
    Setpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.core.fastmath import sincos
from qrsim.core.tree import parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.vehicles.quadrotor import COMMAND_LIMITS, Command

Feed = Literal["measurements", "truth"]


def _tilt_limit() -> Array:
    """Return the field declaration of the parameter ``tilt_limit`` [rad], shared by several controllers."""
    return parameter(default=0.34, unit="rad", doc="largest commanded tilt per axis", above=0.0, maximum=0.9)


def _yaw_gain() -> Array:
    """Return the field declaration of the parameter ``yaw_gain`` [1/s], shared by several controllers."""
    return parameter(default=6.0, unit="1/s", doc="yaw rate per heading error")


def _yaw_rate_limit() -> Array:
    """Return the field declaration of the parameter ``yaw_rate_limit`` [rad/s], shared by several controllers."""
    return parameter(default=4.4, unit="rad/s", doc="largest commanded yaw rate", above=0.0, maximum=4.5)


def _battery() -> Array:
    """Return the field declaration of the parameter ``battery`` (voltage) [V], shared by several controllers."""
    return parameter(default=12.0, unit="V", doc="battery voltage", minimum=9.0, maximum=12.0)


def _feed() -> Any:
    """Return the field declaration of the setting ``feed``: a controller's input is sensor readings or the truth."""
    return setting(default="measurements", doc="input of the controller: the sensors' readings, or the truth")


def _hold(
    loop: HeightLoop, state: HeightState, estimate: Estimate, z_wanted: Array, dt: float
) -> tuple[HeightState, Array]:
    """Return the height loop's new state, and the throttle (n,), 0 to 1, to hold down coordinate ``z_wanted`` [m]."""
    low = estimate.position_low_ned
    return loop.step(state, estimate.position_ned.z, z_wanted, dt, None if low is None else low.z)


class QuadrotorController(Controller):
    """Base of all controllers of the identified quadrotor: they start in hover, at their own throttle and voltage."""

    gives: ClassVar[type] = Command
    battery: Array

    @property
    @abstractmethod
    def hover_throttle(self) -> Array:
        """Throttle, 0 to 1, at which the vehicle hovers."""

    def idle_command(self, command: Command) -> Command:
        """Return a vehicle's idle command ``command`` with this controller's hover throttle and battery voltage."""
        own = (self.hover_throttle, self.battery)
        throttle, battery = (jnp.broadcast_to(jnp.asarray(value), command.throttle.shape) for value in own)
        return replace(command, throttle=throttle, battery=battery)


class HeightController(QuadrotorController):
    """Base of those that hold a height."""

    height: HeightLoop

    @property
    def hover_throttle(self) -> Array:
        """Throttle, 0 to 1, at which the vehicle hovers."""
        return self.height.hover_throttle


@record
class WaypointController(HeightController):
    """Flies to a waypoint at a limited speed, and holds height and heading."""

    position_gain: Array = parameter(default=0.9, unit="1/s", doc="commanded speed per metre of error")
    speed_limit: Array = parameter(
        default=5.0, unit="m/s", doc="largest commanded speed along each heading axis", above=0.0
    )
    velocity_gain: Array = parameter(default=0.09, unit="rad s/m", doc="tilt per speed error")
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    height: HeightLoop = quantity(default=HeightLoop(), doc="height loop")
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (WaypointSetpoint,)

    def init(self, estimate: Estimate) -> HeightState:
        """Return the controller's initial state (n,), that of its height loop."""
        return self.height.init(estimate.position_ned.z)

    def step(
        self, state: HeightState, estimate: Estimate, setpoint: WaypointSetpoint, dt: float
    ) -> tuple[HeightState, Command]:
        """Return the state after a tick of dt [s], and the command (n,) that flies to the waypoint."""
        error = -estimate.offset_from(setpoint.position_ned)
        sine, cosine = sincos(estimate.attitude.yaw)

        def to_heading(north: Array, east: Array) -> tuple[Array, Array]:
            """Return the forward and right components of a vector (north, east), by the estimated heading."""
            return cosine * north + sine * east, cosine * east - sine * north

        ahead, right = to_heading(error.x, error.y)
        u, v = to_heading(estimate.velocity_ned.x, estimate.velocity_ned.y)
        u_wanted = jnp.clip(self.position_gain * ahead, -self.speed_limit, self.speed_limit)
        v_wanted = jnp.clip(self.position_gain * right, -self.speed_limit, self.speed_limit)
        pitch = jnp.clip(self.velocity_gain * (u - u_wanted), -self.tilt_limit, self.tilt_limit)
        roll = jnp.clip(self.velocity_gain * (v_wanted - v), -self.tilt_limit, self.tilt_limit)
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        state, throttle = _hold(self.height, state, estimate, setpoint.position_ned.z, dt)
        return state, Command(pitch, roll, throttle, turn, jnp.broadcast_to(self.battery, pitch.shape))


@record
class VelocityControllerState:
    """Memory of a velocity controller, (n,)."""

    horizontal: VelocityState = quantity(doc="horizontal loop")
    climb: Array = quantity(unit="m", doc="integral of the climb loop")


@record
class VelocityController(QuadrotorController):
    """Flies at a velocity over ground, and holds the heading."""

    velocity: VelocityLoop = quantity(default=VelocityLoop(), doc="horizontal loop")
    climb: ClimbLoop = quantity(default=ClimbLoop(), doc="vertical loop")
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (VelocitySetpoint,)

    @property
    def hover_throttle(self) -> Array:
        """Throttle, 0 to 1, at which the vehicle hovers."""
        return self.climb.hover_throttle

    def init(self, estimate: Estimate) -> VelocityControllerState:
        """Return the initial states of the controller's loops for vehicles (n,)."""
        z = estimate.position_ned.z
        return VelocityControllerState(self.velocity.init(z), jnp.zeros_like(z))

    def step(
        self, state: VelocityControllerState, estimate: Estimate, setpoint: VelocitySetpoint, dt: float
    ) -> tuple[VelocityControllerState, Command]:
        """Return the state after a tick of dt [s], and the command (n,) that flies at the wanted velocity."""
        error = _body_error(estimate, setpoint.velocity_ned, self.velocity.speed_limit)
        horizontal, (forward, right) = self.velocity.step(
            state.horizontal, (error.x, error.y), setpoint.velocity_ned, self.tilt_limit, dt
        )
        climb, throttle = self.climb.step(state.climb, error.z, dt)
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        command = Command(-forward, right, throttle, turn, jnp.broadcast_to(self.battery, right.shape))
        return VelocityControllerState(horizontal, climb), command


def _body_error(estimate: Estimate, wanted_ned: Vec3, speed_limit: Array) -> Vec3:
    """Return wanted minus actual velocity (n,) [m/s] in body axes, each wanted component clipped to ``speed_limit``."""
    direction = rotation(estimate.attitude)
    wanted = direction.to_body(wanted_ned).map(lambda axis: jnp.clip(axis, -speed_limit, speed_limit))
    return wanted - direction.to_body(estimate.velocity_ned)


@record
class VelocityHeightState:
    """Memory of a velocity-height controller, (n,)."""

    horizontal: VelocityState = quantity(doc="horizontal loop")
    height: HeightState = quantity(doc="height loop")


@record
class VelocityHeightController(HeightController):
    """Flies at a horizontal velocity over ground, and holds height and heading."""

    velocity: VelocityLoop = quantity(default=VelocityLoop(), doc="horizontal loop")
    height: HeightLoop = quantity(default=HeightLoop(), doc="height loop")
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (VelocityHeightSetpoint,)

    def init(self, estimate: Estimate) -> VelocityHeightState:
        """Return the initial states of the controller's loops for vehicles (n,)."""
        z = estimate.position_ned.z
        return VelocityHeightState(self.velocity.init(z), self.height.init(z))

    def step(
        self, state: VelocityHeightState, estimate: Estimate, setpoint: VelocityHeightSetpoint, dt: float
    ) -> tuple[VelocityHeightState, Command]:
        """Return the state after a tick of dt [s], and the command (n,) that flies at the velocity and height."""
        north, east = setpoint.velocity_north, setpoint.velocity_east
        # The height loop controls the climb: the vertical velocity set-point is the present velocity, without an error.
        wanted = Vec3(north, east, estimate.velocity_ned.z)
        error = _body_error(estimate, wanted, self.velocity.speed_limit)
        asked = Vec3(north, east, jnp.zeros_like(north))
        horizontal, (forward, right) = self.velocity.step(
            state.horizontal, (error.x, error.y), asked, self.tilt_limit, dt
        )
        height, throttle = _hold(self.height, state.height, estimate, setpoint.z, dt)
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        command = Command(-forward, right, throttle, turn, jnp.broadcast_to(self.battery, right.shape))
        return VelocityHeightState(horizontal, height), command


@record
class AttitudeHeightController(HeightController):
    """Passes tilt to the platform's own stabilisation, and holds height and heading."""

    height: HeightLoop = quantity(default=HeightLoop(), doc="height loop")
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (AttitudeHeightSetpoint,)

    def init(self, estimate: Estimate) -> HeightState:
        """Return the controller's initial state (n,), that of its height loop."""
        return self.height.init(estimate.position_ned.z)

    def step(
        self, state: HeightState, estimate: Estimate, setpoint: AttitudeHeightSetpoint, dt: float
    ) -> tuple[HeightState, Command]:
        """Return the state after a tick of dt [s], and the command (n,) with the wanted tilt, at the wanted height."""
        state, throttle = _hold(self.height, state, estimate, setpoint.z, dt)
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        pitch = jnp.clip(setpoint.pitch, -self.tilt_limit, self.tilt_limit)
        roll = jnp.clip(setpoint.roll, -self.tilt_limit, self.tilt_limit)
        return state, Command(pitch, roll, throttle, turn, jnp.broadcast_to(self.battery, pitch.shape))


@record
class AttitudeController(QuadrotorController):
    """Passes tilt and normalised thrust to the platform, and holds the heading."""

    hover_throttle: Array = parameter(
        default=0.59,
        unit="1",
        doc="throttle of hover, used until the first set-point",
        minimum=0.0,
        maximum=1.0,
    )
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (AttitudeSetpoint,)

    def init(self, estimate: Estimate) -> None:
        """Return None: the controller has no state."""

    def step(self, state: None, estimate: Estimate, setpoint: AttitudeSetpoint, dt: float) -> tuple[None, Command]:
        """Return None as state, and the command (n,): the set-point's tilt and throttle, clipped, and a yaw rate."""
        turn = yaw_rate(estimate.attitude.yaw, setpoint.yaw, self.yaw_gain, self.yaw_rate_limit)
        pitch = jnp.clip(setpoint.pitch, -self.tilt_limit, self.tilt_limit)
        roll = jnp.clip(setpoint.roll, -self.tilt_limit, self.tilt_limit)
        throttle = jnp.clip(setpoint.throttle, *COMMAND_LIMITS["throttle"])
        return None, Command(pitch, roll, throttle, turn, jnp.broadcast_to(self.battery, pitch.shape))


@record
class OffboardState:
    """State of the loops of an offboard controller, (n,); loops that a set-point does not use are reset."""

    height: HeightState = quantity(doc="height loop")
    horizontal: VelocityState = quantity(doc="horizontal velocity loop")
    climb: Array = quantity(unit="m", doc="integral of the climb loop")


@record
class OffboardController(HeightController):
    """Takes every kind of set-point, as an autopilot in offboard mode does: the gains of all the controllers."""

    position_gain: Array = parameter(default=0.9, unit="1/s", doc="commanded speed per metre of error, for waypoints")
    speed_limit: Array = parameter(
        default=5.0, unit="m/s", doc="largest commanded speed along each heading axis, for waypoints", above=0.0
    )
    velocity_gain: Array = parameter(default=0.09, unit="rad s/m", doc="tilt per speed error, for waypoints")
    velocity: VelocityLoop = quantity(default=VelocityLoop(), doc="horizontal loop, for velocities")
    climb: ClimbLoop = quantity(default=ClimbLoop(), doc="vertical loop, for velocities")
    height: HeightLoop = quantity(default=HeightLoop(), doc="height loop")
    tilt_limit: Array = _tilt_limit()
    yaw_gain: Array = _yaw_gain()
    yaw_rate_limit: Array = _yaw_rate_limit()
    battery: Array = _battery()
    feed: Feed = _feed()

    setpoints: ClassVar[tuple[type, ...]] = (
        WaypointSetpoint,
        VelocitySetpoint,
        VelocityHeightSetpoint,
        AttitudeHeightSetpoint,
        AttitudeSetpoint,
    )

    def init(self, estimate: Estimate) -> OffboardState:
        """Return the initial states of the controller's loops for vehicles (n,)."""
        z = estimate.position_ned.z
        return OffboardState(self.height.init(z), self.velocity.init(z), jnp.zeros_like(z))

    def shown(self, setpoint: Setpoint) -> OffboardSetpoint:
        """Return any kind of set-point as an ``OffboardSetpoint``, which a world's state keeps; NaN if unused."""
        return OffboardSetpoint.of(setpoint)

    def step(self, state: OffboardState, estimate: Estimate, setpoint: Any, dt: float) -> tuple[OffboardState, Command]:
        """Return the state after a tick of dt [s], and the command (n,) for a set-point of any kind."""
        fresh = self.init(estimate)
        shared: dict[str, Any] = {
            "tilt_limit": self.tilt_limit,
            "yaw_gain": self.yaw_gain,
            "yaw_rate_limit": self.yaw_rate_limit,
            "battery": self.battery,
            "feed": self.feed,
        }
        if isinstance(setpoint, WaypointSetpoint):
            gains = (self.position_gain, self.speed_limit, self.velocity_gain)
            waypoint = WaypointController(*gains, height=self.height, **shared)
            height, command = waypoint.step(state.height, estimate, setpoint, dt)
            return OffboardState(height, fresh.horizontal, fresh.climb), command
        if isinstance(setpoint, VelocitySetpoint):
            velocity = VelocityController(self.velocity, self.climb, **shared)
            before = VelocityControllerState(state.horizontal, state.climb)
            after, command = velocity.step(before, estimate, setpoint, dt)
            return OffboardState(fresh.height, after.horizontal, after.climb), command
        if isinstance(setpoint, VelocityHeightSetpoint):
            level = VelocityHeightController(self.velocity, self.height, **shared)
            held, command = level.step(VelocityHeightState(state.horizontal, state.height), estimate, setpoint, dt)
            return OffboardState(held.height, held.horizontal, fresh.climb), command
        if isinstance(setpoint, AttitudeHeightSetpoint):
            height, command = AttitudeHeightController(self.height, **shared).step(state.height, estimate, setpoint, dt)
            return OffboardState(height, fresh.horizontal, fresh.climb), command
        _, command = AttitudeController(self.hover_throttle, **shared).step(None, estimate, setpoint, dt)
        return fresh, command
