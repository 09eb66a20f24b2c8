"""The controller of rovers: pure pursuit of lines and circles, and a speed loop.

See docs/explanation/models/rover.md, D7 to D9.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Controller
from qrsim.control.setpoints import Estimate, PathSetpoint, TrackSetpoint, VelocitySetpoint, WaypointSetpoint
from qrsim.control.tracks import left_of
from qrsim.core.fastmath import arctan2, sincos, wrap_angle
from qrsim.core.tree import derived, parameter, quantity, record, replace, setting
from qrsim.core.vectors import Vec3, root, rotation
from qrsim.errors import UsageError
from qrsim.models.vehicles.rover import DriveCommand
from qrsim.models.vehicles.rover.planar import Drives

# A commanded speed below this [m/s] is a stop.
CREEP = 0.15
# With this speed [m/s] it backs away from a place that no forward turn leads to, until an arc this much wider does.
BACK_SPEED, BACK_SHARE = 0.5, 1.4


@record
class RoverControllerState:
    """Memory of a rover's controller, (n,)."""

    integral: Array = quantity(unit="m/s", doc="integral of the speed error")
    resting: Array = quantity(doc="bool: has reached the place of its stop")


@record
class RoverController(Controller):
    """Drives along lines and circles, to places and at velocities; for any vehicle that takes speed and curvature."""

    speed: Array = parameter(default=2.0, unit="m/s", doc="speed of set-points without one", above=0.0)
    lookahead: Array = parameter(default=1.0, unit="s", doc="look-ahead time on the track", above=0.0)
    lookahead_min: Array = parameter(default=1.5, unit="m", doc="smallest look-ahead distance", above=0.0)
    side_acceleration: Array = parameter(
        default=3.0, unit="m/s^2", doc="largest lateral acceleration on entering a turn", above=0.0
    )
    deceleration: Array = parameter(default=1.0, unit="m/s^2", doc="deceleration of a stop", above=0.0)
    stop_radius: Array = parameter(
        default=0.3, unit="m", doc="distance at which the place of a stop counts as reached", above=0.0
    )
    leave_radius: Array = parameter(
        default=4.0, unit="m", doc="estimated distance from that place at which it moves again", above=0.0
    )
    position_gain: Array = parameter(
        default=0.8, unit="1/s", doc="commanded speed per metre of error to a moving point"
    )
    heading_gain: Array = parameter(default=2.0, unit="1/s", doc="yaw rate per heading error, for velocity set-points")
    speed_integral_gain: Array = parameter(default=0.2, unit="1/s", doc="commanded speed per integrated speed error")
    speed_integral_limit: Array = parameter(default=0.5, unit="m/s", doc="largest speed by that integral", minimum=0.0)
    feed: Literal["measurements", "truth"] = setting(
        default="measurements", doc="input of the controller: the sensors' readings, or the truth"
    )
    nominal: Any = derived(default=None, doc="the vehicle that it is fitted to")

    setpoints: ClassVar[tuple[type, ...]] = (TrackSetpoint, WaypointSetpoint, VelocitySetpoint, PathSetpoint)
    gives: ClassVar[type] = DriveCommand

    def fitted(self, vehicle: object) -> RoverController:
        """Return the controller fitted to a nominal vehicle, which decides the type of its commands.

        Raises:
            UsageError: the vehicle has no wheels.
        """
        if not isinstance(vehicle, Drives):
            raise UsageError(
                f"it commands speed and curvature, and {type(vehicle).__name__} takes none; allowed: a rover or a "
                "differential_rover"
            )
        return replace(self, nominal=vehicle)

    def init(self, estimate: Estimate) -> RoverControllerState:
        """Return the controller's initial state for vehicles (n,); the estimate only gives the shape."""
        zero = jnp.zeros_like(estimate.position_ned.z)
        return RoverControllerState(zero, jnp.zeros(zero.shape, bool))

    def shown(self, setpoint: Any) -> TrackSetpoint:
        """Return a set-point as a ``TrackSetpoint``, which a world's state keeps; a velocity has NaN positions."""
        if isinstance(setpoint, TrackSetpoint):
            return setpoint
        zero = jnp.zeros_like(setpoint.yaw)
        none = zero + jnp.nan
        if isinstance(setpoint, VelocitySetpoint):
            nowhere = Vec3(none, none, none)
            return TrackSetpoint(nowhere, nowhere, zero, _level(setpoint.velocity_ned), zero)
        position_ned = setpoint.position_ned
        if isinstance(setpoint, PathSetpoint):
            return TrackSetpoint(position_ned, position_ned, zero, _level(setpoint.velocity_ned), zero)
        return TrackSetpoint(position_ned, position_ned, zero, zero, zero + 1.0)

    def step(
        self, state: RoverControllerState, estimate: Estimate, setpoint: object, dt: float
    ) -> tuple[RoverControllerState, DriveCommand]:
        """Return the state after a tick of dt [s], and the drive command (n,) that follows the set-point."""
        if self.nominal is None:
            raise UsageError("this controller knows no vehicle; fit it first: controller.fitted(vehicle)")
        speed = rotation(estimate.attitude).to_body(estimate.velocity_ned).x
        if isinstance(setpoint, VelocitySetpoint | PathSetpoint):
            wanted, curvature = self._towards(estimate, setpoint, speed)
            resting = jnp.zeros(speed.shape, bool)
        else:
            track = setpoint if isinstance(setpoint, TrackSetpoint) else self.shown(setpoint)
            wanted, curvature, resting = self._along(state, estimate, track, speed)
        error = wanted - speed
        limit = self.speed_integral_limit
        grown = jnp.clip(state.integral + (self.speed_integral_gain * dt) * error, -limit, limit)
        # Only near the wanted speed, so that it does not fill while the rover speeds up.
        integral = jnp.where(jnp.abs(error) < limit, grown, state.integral)
        integral = jnp.where(wanted == 0.0, 0.0, integral)
        return RoverControllerState(integral, resting), self.nominal.drive(wanted + integral, curvature)

    def _along(
        self, state: RoverControllerState, estimate: Estimate, track: TrackSetpoint, speed: Array
    ) -> tuple[Array, Array, Array]:
        """Return (speed [m/s], curvature [1/m], bool: at rest), each (n,), to follow a line or circle (eqs. D7, D8)."""
        ahead = jnp.maximum(self.lookahead_min, self.lookahead * jnp.abs(speed))
        aim = jnp.where(
            track.radius == 0.0, _aim_on_line(estimate, track, ahead), _aim_on_circle(estimate, track, ahead)
        )
        off = wrap_angle(aim - estimate.attitude.yaw)
        sine, cosine = sincos(off)
        distance, left = left_of(track.begin_ned, track.position_ned, estimate.position_ned)
        stops = track.stops > 0.0
        side = jnp.where(sine < 0.0, -1.0, 1.0)
        # Nearer than the lookahead to its stop, it takes the arc through that; where the arc is too tight, it backs.
        near = stops & (track.radius == 0.0) & (distance < ahead)
        tightest = self.lookahead_min * jnp.where(speed < -CREEP, BACK_SHARE, 1.0)
        backs = near & (distance < tightest * jnp.abs(sine))
        reach = jnp.where(near & (cosine > 0.0), jnp.maximum(distance, self.stop_radius), ahead)
        # A rover that points away from its goal turns as for a point at its side.
        curvature = 2.0 * jnp.where(cosine < 0.0, side, sine) / reach
        wanted = jnp.where(track.speed > 0.0, track.speed, self.speed)
        wanted = jnp.minimum(wanted, root(self.side_acceleration / jnp.maximum(jnp.abs(curvature), 1e-3)))
        has_line = (track.begin_ned.x != track.position_ned.x) | (track.begin_ned.y != track.position_ned.y)
        over = (distance < self.stop_radius) | (has_line & (left < 0.0) & (distance < self.leave_radius))
        resting = stops & (over | (state.resting & (distance < self.leave_radius)))
        braked = jnp.minimum(wanted, root(2.0 * self.deceleration * distance))
        wanted = jnp.where(stops, braked, wanted)
        wanted = jnp.where(backs, -BACK_SPEED, wanted)
        curvature = jnp.where(backs, -2.0 * side / self.lookahead_min, curvature)
        wanted = jnp.where(resting, 0.0, wanted)
        return wanted, jnp.where(resting, 0.0, curvature), resting

    def _towards(
        self, estimate: Estimate, setpoint: VelocitySetpoint | PathSetpoint, speed: Array
    ) -> tuple[Array, Array]:
        """Return the speed [m/s] and curvature [1/m] (n,) to follow a velocity or a moving point (eq. D9)."""
        north, east = setpoint.velocity_ned.x, setpoint.velocity_ned.y
        idle: Array | None = None
        if isinstance(setpoint, PathSetpoint):
            behind = -estimate.offset_from(setpoint.position_ned)
            north, east = north + self.position_gain * behind.x, east + self.position_gain * behind.y
            idle = setpoint.idle
        size = root(north * north + east * east)
        moves = size > CREEP if idle is None else (size > CREEP) & ~idle
        off = wrap_angle(arctan2(east, jnp.where(moves, north, 1.0)) - estimate.attitude.yaw)
        curvature = self.heading_gain * off / jnp.maximum(jnp.abs(speed), 0.5)
        # Slower while it looks elsewhere, but not so slow that it cannot turn.
        wanted = size * jnp.maximum(sincos(off)[1], 0.3)
        wanted = jnp.minimum(wanted, root(self.side_acceleration / jnp.maximum(jnp.abs(curvature), 1e-3)))
        return jnp.where(moves, wanted, 0.0), jnp.where(moves, curvature, 0.0)


def _level(velocity: Vec3) -> Array:
    """Return the horizontal speed [m/s] of a velocity NED."""
    return root(velocity.x * velocity.x + velocity.y * velocity.y)


def _aim_on_line(estimate: Estimate, track: TrackSetpoint, ahead: Array) -> Array:
    """Return the bearing (n,) [rad] of the look-ahead point on a line, ``ahead`` (n,) [m] away, at most its end."""
    begin, end = track.begin_ned, track.position_ned
    to_end = -estimate.offset_from(end)
    way_north, way_east = end.x - begin.x, end.y - begin.y
    length = root(way_north * way_north + way_east * way_east)
    has_line = length > 1e-3
    north, east = (jnp.where(has_line, axis / jnp.maximum(length, 1e-3), 0.0) for axis in (way_north, way_east))
    left = to_end.x * north + to_end.y * east
    # From the vehicle to the nearest point of the line.
    beside_north, beside_east = to_end.x - left * north, to_end.y - left * east
    beside = beside_north * beside_north + beside_east * beside_east
    forward = root(jnp.maximum(ahead * ahead - beside, 0.25 * ahead * ahead))
    on_line = has_line & (left > forward)
    aim_north = jnp.where(on_line, beside_north + forward * north, to_end.x)
    aim_east = jnp.where(on_line, beside_east + forward * east, to_end.y)
    there = (aim_north == 0.0) & (aim_east == 0.0)
    return arctan2(aim_east, jnp.where(there, 1.0, aim_north))


def _aim_on_circle(estimate: Estimate, track: TrackSetpoint, ahead: Array) -> Array:
    """Return the bearing (n,) [rad] of the look-ahead point on a circle, ``ahead`` (n,) [m] further along."""
    out = estimate.offset_from(track.position_ned)
    radius = jnp.maximum(jnp.abs(track.radius), 1e-3)
    where = arctan2(out.y, jnp.where((out.x == 0.0) & (out.y == 0.0), 1.0, out.x))
    # On the circle the chord to that point is as long as the distance.
    swing = 2.0 * jnp.arcsin(jnp.minimum(0.5 * ahead / radius, 0.7))
    sine, cosine = sincos(where + jnp.where(track.radius < 0.0, -swing, swing))
    north, east = radius * cosine - out.x, radius * sine - out.y
    return arctan2(east, jnp.where((north == 0.0) & (east == 0.0), 1.0, north))
