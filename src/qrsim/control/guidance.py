"""Guidance of fleets without a commander: a route, or one constant set-point."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.control.contracts import Guidance
from qrsim.control.setpoints import (
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.core.tree import parameter, quantity, record, setting
from qrsim.core.vectors import Vec3


@record
class Route:
    """Waypoints of each vehicle, padded to the longest route: P waypoints, n vehicles."""

    position_ned: Vec3 = quantity(unit="m", doc="(P, n) waypoints")
    yaw: Array = quantity(unit="rad", doc="(P, n) heading towards and at each waypoint")
    count: Array = quantity(doc="(n,) int32 number of waypoints")


@record
class RouteState:
    """Index of each vehicle's waypoint (n,)."""

    index: Array = quantity(doc="int32")
    reached: Array = quantity(doc="int32 waypoints reached so far")
    overfull: Array | None = quantity(
        default=None,
        doc="int32 searches for neighbours that may have missed some for lack of room; None: there is always room",
    )

    @staticmethod
    def start(route: Route) -> RouteState:
        """Return the state of vehicles (n,) at the first waypoint of their routes."""
        zero = jnp.zeros(route.count.shape, jnp.int32)
        return RouteState(zero, zero)


class RouteGuidance(Guidance):
    """Base of guidances with a ``RouteState``; by default ``step`` returns the same set-point at every tick."""

    def init(self, route: Route) -> RouteState:
        """Return the state of vehicles (n,) at the first waypoint of their routes."""
        return RouteState.start(route)

    def step(
        self, state: RouteState, route: Route, position_ned: Vec3, others_ned: Vec3 | None = None
    ) -> tuple[RouteState, object]:
        """Return the state unchanged, and its set-point (n,); positions are not used."""
        return state, self.setpoint(state, route)


def after_arrival(state: RouteState, route: Route, arrived: Array, repeat: bool) -> RouteState:
    """Return the state with ``arrived`` vehicles (n,) sent to the next waypoint; ``repeat``: from last to first."""
    following = state.index + 1
    last = jnp.zeros_like(following) if repeat else route.count - 1
    following = jnp.where(following >= route.count, last, following)
    # Where a vehicle stays, at the last waypoint or the only one, it arrives once.
    counts = arrived & ((following != state.index) | (state.reached < route.count))
    return RouteState(jnp.where(arrived, following, state.index), state.reached + counts.astype(jnp.int32))


@record
class RouteFollower(RouteGuidance):
    """Gives the next waypoint when the current one is near."""

    acceptance_radius: Array = parameter(
        default=3.0, unit="m", doc="distance at which a waypoint counts as reached", above=0.0
    )
    repeat: bool = setting(default=True, doc="repeat the route after the last waypoint; if false, hold there")

    gives: ClassVar[type] = WaypointSetpoint

    def step(
        self, state: RouteState, route: Route, position_ned: Vec3, others_ned: Vec3 | None = None
    ) -> tuple[RouteState, WaypointSetpoint]:
        """Return the state, moved on where a waypoint is reached, and the present waypoint (n,) as set-point."""
        arrived = (self.setpoint(state, route).position_ned - position_ned).norm() < self.acceptance_radius
        moved = after_arrival(state, route, arrived, self.repeat)
        return moved, self.setpoint(moved, route)

    def setpoint(self, state: RouteState, route: Route) -> WaypointSetpoint:
        """Return the present waypoint of each vehicle (n,) as set-point."""
        # A sum over a one-hot mask, because gathers are slow on a CPU and routes are short.
        rows = jnp.arange(route.yaw.shape[0], dtype=jnp.int32)[:, None]
        chosen = rows == state.index[None, :]

        def pick(values: Array) -> Array:
            """Return each vehicle's entry (n,) of values (P, n) at its present waypoint."""
            return jnp.sum(jnp.where(chosen, values, 0.0), axis=0)

        return WaypointSetpoint(route.position_ned.map(pick), pick(route.yaw))


def _per_vehicle(value: Array, route: Route) -> Array:
    """Return a parameter () or (n,) broadcast to one value for each vehicle (n,) of a route."""
    return jnp.broadcast_to(jnp.asarray(value), route.count.shape)


@record
class VelocityGuidance(RouteGuidance):
    """Commands one velocity, at the vehicle's own heading."""

    velocity_north: Array = parameter(default=0.0, unit="m/s", doc="velocity over ground, north")
    velocity_east: Array = parameter(default=0.0, unit="m/s", doc="velocity over ground, east")
    velocity_down: Array = parameter(default=0.0, unit="m/s", doc="velocity over ground, down")

    gives: ClassVar[type] = VelocitySetpoint

    def setpoint(self, state: RouteState, route: Route) -> VelocitySetpoint:
        """Return the constant velocity set-point of each vehicle (n,), with its route's first heading."""
        wanted = Vec3(self.velocity_north, self.velocity_east, self.velocity_down)
        return VelocitySetpoint(wanted.map(lambda axis: _per_vehicle(axis, route)), route.yaw[0])


@record
class VelocityHeightGuidance(RouteGuidance):
    """Commands one horizontal velocity at the height of the first waypoint, or of the start without one."""

    velocity_north: Array = parameter(default=0.0, unit="m/s", doc="velocity over ground, north")
    velocity_east: Array = parameter(default=0.0, unit="m/s", doc="velocity over ground, east")

    gives: ClassVar[type] = VelocityHeightSetpoint

    def setpoint(self, state: RouteState, route: Route) -> VelocityHeightSetpoint:
        """Return the constant velocity set-point (n,), with height and heading of the route's first waypoint."""
        north, east = _per_vehicle(self.velocity_north, route), _per_vehicle(self.velocity_east, route)
        return VelocityHeightSetpoint(north, east, route.position_ned.z[0], route.yaw[0])


@record
class AttitudeHeightGuidance(RouteGuidance):
    """Commands one tilt at the height of the first waypoint, or of the start without one."""

    roll_rad: Array = parameter(default=0.0, unit="rad", doc="commanded roll", minimum=-0.9, maximum=0.9)
    pitch_rad: Array = parameter(default=0.0, unit="rad", doc="commanded pitch", minimum=-0.9, maximum=0.9)

    gives: ClassVar[type] = AttitudeHeightSetpoint

    def setpoint(self, state: RouteState, route: Route) -> AttitudeHeightSetpoint:
        """Return the constant tilt set-point (n,), with height and heading of the route's first waypoint."""
        roll, pitch = _per_vehicle(self.roll_rad, route), _per_vehicle(self.pitch_rad, route)
        return AttitudeHeightSetpoint(roll, pitch, route.position_ned.z[0], route.yaw[0])


@record
class AttitudeGuidance(RouteGuidance):
    """Commands one tilt and one thrust."""

    roll_rad: Array = parameter(default=0.0, unit="rad", doc="commanded roll", minimum=-0.9, maximum=0.9)
    pitch_rad: Array = parameter(default=0.0, unit="rad", doc="commanded pitch", minimum=-0.9, maximum=0.9)
    throttle: Array = parameter(default=0.59, unit="1", doc="normalised thrust", minimum=0.0, maximum=1.0)

    gives: ClassVar[type] = AttitudeSetpoint

    def setpoint(self, state: RouteState, route: Route) -> AttitudeSetpoint:
        """Return the constant tilt and thrust set-point (n,), with the heading of the route's first waypoint."""
        roll, pitch = _per_vehicle(self.roll_rad, route), _per_vehicle(self.pitch_rad, route)
        return AttitudeSetpoint(roll, pitch, route.yaw[0], _per_vehicle(self.throttle, route))
