"""The controller of fixed wings: L1 guidance in the plane, total energy in height.

See docs/explanation/models/fixed_wing.md.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Controller
from qrsim.control.setpoints import Estimate, TrackSetpoint, WaypointSetpoint
from qrsim.core.fastmath import arctan2, sincos, wrap_angle
from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import root
from qrsim.errors import UsageError
from qrsim.models.vehicles.fixed_wing import AttitudeCommand
from qrsim.models.vehicles.fixed_wing.parameters import Aeroplane
from qrsim.models.vehicles.fixed_wing.trim import cruise

# Of the heading to a track, the most that L1 turns away from it [rad].
MOST = 0.25 * math.pi
# What is slower [m/s] has no direction.
SLOWEST = 0.1


@record
class FixedWingControllerState:
    """Memory of a fixed wing's controller, (n,)."""

    airspeed: Array = quantity(unit="m/s", doc="of the last step")
    acceleration: Array = quantity(unit="m/s^2", doc="filtered derivative of the airspeed")
    energy_integral: Array = quantity(unit="1", doc="throttle by the integrated error of the energy rate")
    balance_integral: Array = quantity(unit="rad", doc="pitch by the integrated error of the balance of energies")


@record
class FixedWingController(Controller):
    """Flies along lines and circles at a height and an airspeed; for a place, it circles around it."""

    airspeed: Array = parameter(
        default=0.0, unit="m/s", doc="airspeed of set-points without one; 0: the vehicle's cruise airspeed", minimum=0.0
    )
    loiter_radius: Array = parameter(
        default=150.0,
        unit="m",
        doc="radius of the circle around a waypoint; positive: clockwise, negative: anticlockwise",
    )
    roll_limit: Array = parameter(default=math.radians(45.0), unit="rad", doc="largest roll", above=0.0, maximum=1.0)
    pitch_limit: Array = parameter(default=0.35, unit="rad", doc="largest pitch", above=0.0, maximum=0.6)
    l1_period: Array = parameter(default=12.0, unit="s", doc="period of the return to a track (L1)", above=0.0)
    l1_damping: Array = parameter(default=0.75, unit="1", doc="damping ratio of the return to a track", above=0.0)
    climb_limit: Array = parameter(default=3.0, unit="m/s", doc="largest commanded climb rate", above=0.0)
    sink_limit: Array = parameter(default=3.0, unit="m/s", doc="largest commanded sink rate", above=0.0)
    acceleration_limit: Array = parameter(
        default=2.0, unit="m/s^2", doc="largest commanded rate of airspeed", above=0.0
    )
    time_constant: Array = parameter(
        default=3.0, unit="s", doc="time constant of the height and airspeed responses", above=0.0
    )
    acceleration_lag: Array = parameter(
        default=0.5, unit="s", doc="time constant of the measured rate of airspeed", above=0.0
    )
    energy_gain: Array = parameter(default=1.5, unit="1", doc="throttle per error of the energy rate")
    energy_forward: Array = parameter(default=2.0, unit="1", doc="throttle per commanded energy rate")
    energy_integral_gain: Array = parameter(
        default=1.0, unit="1/s", doc="throttle per integrated error of the energy rate"
    )
    balance_gain: Array = parameter(default=0.4, unit="rad", doc="pitch per error of the energy balance")
    balance_forward: Array = parameter(default=0.8, unit="rad", doc="pitch per commanded energy balance")
    balance_integral_gain: Array = parameter(
        default=0.3, unit="rad/s", doc="pitch per integrated error of the energy balance"
    )
    balance_integral_limit: Array = parameter(
        default=0.3, unit="rad", doc="largest pitch by that integral", minimum=0.0
    )
    feed: Literal["measurements", "truth"] = setting(
        default="measurements", doc="input of the controller: the sensors' readings, or the truth"
    )
    nominal: Any = derived(default=None, doc="the vehicle that it is fitted to")

    setpoints: ClassVar[tuple[type, ...]] = (TrackSetpoint, WaypointSetpoint)
    gives: ClassVar[type] = AttitudeCommand
    reads_airspeed: ClassVar[bool] = True

    def fitted(self, vehicle: object) -> FixedWingController:
        """Return the controller fitted to a nominal vehicle, of which it uses the trim for level flight.

        Raises:
            UsageError: the vehicle has no wings.
        """
        if not isinstance(vehicle, Aeroplane):
            raise UsageError(
                f"it starts from the level flight of wings, none of {type(vehicle).__name__}; allowed: a fixed_wing"
            )
        return replace(self, nominal=vehicle)

    def init(self, estimate: Estimate) -> FixedWingControllerState:
        """Return the controller's initial state for vehicles (n,), with their estimated airspeed."""
        zero = jnp.zeros_like(estimate.position_ned.z)
        return FixedWingControllerState(self._airspeed_of(estimate), zero, zero, zero)

    def shown(self, setpoint: Any) -> TrackSetpoint:
        """Return a set-point as a ``TrackSetpoint``, which a world's state keeps; a waypoint becomes a circle."""
        if isinstance(setpoint, TrackSetpoint):
            return setpoint
        place, zero = setpoint.position_ned, jnp.zeros_like(setpoint.yaw)
        return TrackSetpoint(place, place, zero + self.loiter_radius, zero, zero)

    def step(
        self, state: FixedWingControllerState, estimate: Estimate, setpoint: object, dt: float
    ) -> tuple[FixedWingControllerState, AttitudeCommand]:
        """Return the state after a tick of dt [s], and the command (n,) that follows the line or circle."""
        track = self.shown(setpoint)
        roll = self._roll(estimate, track)
        state, pitch, throttle = self._energy(state, estimate, track, dt)
        return state, AttitudeCommand(roll, pitch, throttle)

    def _vehicle(self) -> Aeroplane:
        """Return the nominal vehicle; raise UsageError if the controller is not fitted."""
        if self.nominal is None:
            raise UsageError("this controller knows no vehicle; fit it first: controller.fitted(vehicle)")
        found: Aeroplane = self.nominal
        return found

    def _airspeed_of(self, estimate: Estimate) -> Array:
        """Return the estimated airspeed (n,) [m/s], or the cruise airspeed where it is unknown."""
        usual = jnp.zeros_like(estimate.position_ned.z) + self._vehicle().cruise_airspeed
        if estimate.airspeed is None:
            return usual
        return jnp.where(jnp.isfinite(estimate.airspeed), estimate.airspeed, usual)

    def _energy(
        self, state: FixedWingControllerState, estimate: Estimate, track: TrackSetpoint, dt: float
    ) -> tuple[FixedWingControllerState, Array, Array]:
        """Return the state, pitch [rad] and throttle [0, 1] (n,) for height and airspeed, by total energy (eq. W12)."""
        vehicle = self._vehicle()
        trim_pitch, _, trim_throttle = cruise(vehicle, jnp.asarray(vehicle.cruise_airspeed))
        usual = jnp.where(jnp.asarray(self.airspeed) > 0.0, self.airspeed, vehicle.cruise_airspeed)
        fast = jnp.where(track.speed > 0.0, track.speed, usual)
        speed = self._airspeed_of(estimate)
        change = (speed - state.airspeed) * (1.0 / dt)
        grown = state.acceleration + (dt / (self.acceleration_lag + dt)) * (change - state.acceleration)
        below = estimate.offset_from(track.position_ned).z
        climb = jnp.clip(below / self.time_constant, -self.sink_limit, self.climb_limit)
        limit = self.acceleration_limit
        faster = jnp.clip((fast - speed) / self.time_constant, -limit, limit) / vehicle.gravity
        over = 1.0 / jnp.maximum(speed, SLOWEST)
        climb, climbs = climb * over, -estimate.velocity_ned.z * over
        gains = grown / vehicle.gravity
        energy, balance = climb + faster, climb - faster
        error, tilt = energy - (climbs + gains), balance - (climbs - gains)
        throttle = trim_throttle + self.energy_gain * error + self.energy_forward * energy + state.energy_integral
        held = ((throttle > 1.0) & (error > 0.0)) | ((throttle < 0.0) & (error < 0.0))
        integral = jnp.where(held, 0.0, self.energy_integral_gain * dt * error) + state.energy_integral
        most = self.balance_integral_limit
        leant = jnp.clip(state.balance_integral + self.balance_integral_gain * dt * tilt, -most, most)
        pitch = trim_pitch + self.balance_forward * balance + self.balance_gain * tilt + leant
        pitch = jnp.clip(pitch, -self.pitch_limit, self.pitch_limit)
        return FixedWingControllerState(speed, grown, integral, leant), pitch, jnp.clip(throttle, 0.0, 1.0)

    def _roll(self, estimate: Estimate, track: TrackSetpoint) -> Array:
        """Return the roll command (n,) [rad] that follows a line or circle (eq. W11)."""
        acceleration = jnp.where(track.radius == 0.0, self._on_line(estimate, track), self._on_circle(estimate, track))
        roll = jnp.arctan(acceleration / self._vehicle().gravity)
        return jnp.clip(roll, -self.roll_limit, self.roll_limit)

    def _reach(self, over_ground: Array) -> Array:
        """Return the look-ahead distance (n,) [m] of L1 guidance at a ground speed (n,) [m/s]."""
        return self.l1_period * self.l1_damping / math.pi * over_ground

    def _turned(self, speed: Array, eta: Array) -> Array:
        """Return L1 guidance's lateral acceleration (n,) [m/s^2], right positive, for an angle eta [rad] off course."""
        sine = sincos(jnp.clip(eta, -0.5 * math.pi, 0.5 * math.pi))[0]
        return 4.0 * self.l1_damping * self.l1_damping * speed * speed / self._reach(speed) * sine

    def _on_line(self, estimate: Estimate, track: TrackSetpoint) -> Array:
        """Return the lateral acceleration (n,) [m/s^2], right positive, to follow a line, or reach its single point."""
        v, away = estimate.velocity_ned, estimate.offset_from(track.position_ned)
        speed = jnp.maximum(root(v.x * v.x + v.y * v.y), SLOWEST)
        way_north, way_east = (track.position_ned.x - track.begin_ned.x, track.position_ned.y - track.begin_ned.y)
        length = root(way_north * way_north + way_east * way_east)
        has_line = length > 1e-3
        distance = jnp.maximum(root(away.x * away.x + away.y * away.y), 1e-3)
        over = 1.0 / jnp.where(has_line, length, distance)
        north, east = jnp.where(has_line, way_north, -away.x) * over, jnp.where(has_line, way_east, -away.y) * over
        # To the right of the line is positive.
        beside = jnp.where(has_line, north * away.y - east * away.x, 0.0)
        sine = jnp.clip(-beside / self._reach(speed), -math.sin(MOST), math.sin(MOST))
        bearing = arctan2(east, jnp.where((north == 0.0) & (east == 0.0), 1.0, north)) + jnp.arcsin(sine)
        return self._turned(speed, wrap_angle(bearing - _course(v.x, v.y)))

    def _on_circle(self, estimate: Estimate, track: TrackSetpoint) -> Array:
        """Return the lateral acceleration (n,) [m/s^2], right positive, to follow a circle or, far off, to reach it."""
        v, out = estimate.velocity_ned, estimate.offset_from(track.position_ned)
        speed = jnp.maximum(root(v.x * v.x + v.y * v.y), SLOWEST)
        side = jnp.where(track.radius < 0.0, -1.0, 1.0)
        radius = jnp.maximum(jnp.abs(track.radius), 1.0)
        distance = jnp.maximum(root(out.x * out.x + out.y * out.y), 1e-2)
        north, east = out.x / distance, out.y / distance
        beside, leaving = distance - radius, v.x * north + v.y * east
        along = side * (v.y * north - v.x * east)
        omega = 2.0 * math.pi / self.l1_period
        closing = beside * omega * omega + leaving * (2.0 * self.l1_damping * omega)
        # Inside, flying the wrong way round, it does not turn outwards.
        closing = jnp.where((along < 0.0) & (beside < 0.0), jnp.maximum(closing, 0.0), closing)
        circling = side * (closing + along * along / jnp.maximum(0.5 * radius, distance))
        inwards = arctan2(-east, jnp.where((north == 0.0) & (east == 0.0), 1.0, -north))
        capture = self._turned(speed, wrap_angle(inwards - _course(v.x, v.y)))
        far = (beside > 0.5 * self._reach(speed)) & (side * capture < side * circling)
        return jnp.where(far, capture, circling)


def _course(north: Array, east: Array) -> Array:
    """Return the direction [rad] of a horizontal vector, clockwise from north; 0 for a zero vector."""
    return arctan2(east, jnp.where((north == 0.0) & (east == 0.0), 1.0, north))
