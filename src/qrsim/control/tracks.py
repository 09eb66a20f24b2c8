"""Guidance along lines from waypoint to waypoint, for rovers, which stop at the last, and fixed wings, which circle it.

Code of what both share: a line is reached where its end is near, or behind.
"""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.control.guidance import Route, RouteGuidance, RouteState, after_arrival
from qrsim.control.setpoints import TrackSetpoint
from qrsim.core.tree import parameter, record, setting
from qrsim.core.vectors import Vec3, root


def waypoint_at(route: Route, index: Array) -> Vec3:
    """Return each vehicle's waypoint (n,) [m] NED with number ``index`` (n,) of its route."""
    # A sum over a one-hot mask, because gathers are slow on a CPU and routes are short.
    rows = jnp.arange(route.yaw.shape[0], dtype=jnp.int32)[:, None]
    chosen = rows == index[None, :]
    return route.position_ned.map(lambda values: jnp.sum(jnp.where(chosen, values, 0.0), axis=0))


def line_of(state: RouteState, route: Route) -> tuple[Vec3, Vec3]:
    """Return begin and end (n,) [m] of each vehicle's present line, its previous and its present waypoint."""
    before = jnp.where(state.index > 0, state.index - 1, jnp.where(state.reached > 0, route.count - 1, 0))
    return waypoint_at(route, before), waypoint_at(route, state.index)


def left_of(begin: Vec3, end: Vec3, position_ned: Vec3) -> tuple[Array, Array]:
    """Return the horizontal distance (n,) [m] to a line's end, and its part along the line, 0 without a line."""
    north, east = end.x - position_ned.x, end.y - position_ned.y
    way_north, way_east = end.x - begin.x, end.y - begin.y
    length = root(way_north * way_north + way_east * way_east)
    along = (north * way_north + east * way_east) / jnp.maximum(length, 1e-3)
    return root(north * north + east * east), along


def advanced(
    state: RouteState, route: Route, position_ned: Vec3, reach: Array, passed: Array | bool, repeat: bool
) -> RouteState:
    """Return the state moved on past waypoints nearer than ``reach`` (n,) [m], or, where ``passed``, flown past."""
    begin, end = line_of(state, route)
    distance, along = left_of(begin, end, position_ned)
    has_line = (begin.x != end.x) | (begin.y != end.y)
    arrived = (distance < reach) | (has_line & (along < 0.0) & passed)
    return after_arrival(state, route, arrived, repeat)


def ends_at(state: RouteState, route: Route, repeat: bool) -> Array:
    """Return (n,) bool: the route ends at the vehicle's present waypoint; if ``repeat``, only with one waypoint."""
    final = state.index + 1 >= route.count
    return final & (route.count < 2) if repeat else final


@record
class RoverGuidance(RouteGuidance):
    """Drives along the lines between waypoints."""

    acceptance_radius: Array = parameter(
        default=1.5, unit="m", doc="distance at which a waypoint counts as reached", above=0.0
    )
    repeat: bool = setting(default=True, doc="repeat the route after the last waypoint; if false, stop there")

    gives: ClassVar[type] = TrackSetpoint

    def step(
        self, state: RouteState, route: Route, position_ned: Vec3, others_ned: Vec3 | None = None
    ) -> tuple[RouteState, TrackSetpoint]:
        """Return the state, moved on where a waypoint is reached, and the present line (n,) as set-point."""
        moved = advanced(state, route, position_ned, self.acceptance_radius, True, self.repeat)
        return moved, self.setpoint(moved, route)

    def setpoint(self, state: RouteState, route: Route) -> TrackSetpoint:
        """Return the line from the previous to the present waypoint of each vehicle (n,) as set-point."""
        begin, end = line_of(state, route)
        stops = ends_at(state, route, self.repeat)
        zero = jnp.zeros_like(end.x)
        return TrackSetpoint(begin, end, zero, zero, jnp.where(stops, 1.0 + zero, zero))


@record
class FixedWingGuidance(RouteGuidance):
    """Flies along the lines between waypoints, and circles the last one; without waypoints, the start."""

    acceptance_radius: Array = parameter(
        default=40.0,
        unit="m",
        doc="distance at which the next line begins, to avoid overshoot",
        above=0.0,
    )
    radius: Array = parameter(
        default=150.0,
        unit="m",
        doc="radius of the circle around the last waypoint; positive: clockwise, negative: anticlockwise",
    )
    airspeed: Array = parameter(
        default=0.0, unit="m/s", doc="commanded airspeed; 0: that of the controller", minimum=0.0
    )
    repeat: bool = setting(default=False, doc="repeat the route after the last waypoint; if false, circle it")

    gives: ClassVar[type] = TrackSetpoint

    def step(
        self, state: RouteState, route: Route, position_ned: Vec3, others_ned: Vec3 | None = None
    ) -> tuple[RouteState, TrackSetpoint]:
        """Return the state, moved on where a waypoint is reached, and the present line or circle (n,) as set-point."""
        circles = ends_at(state, route, self.repeat)
        reach = self.acceptance_radius + jnp.where(circles, jnp.abs(self.radius), 0.0)
        moved = advanced(state, route, position_ned, reach, ~circles, self.repeat)
        return moved, self.setpoint(moved, route)

    def setpoint(self, state: RouteState, route: Route) -> TrackSetpoint:
        """Return each vehicle's line to its present waypoint, or circle around the route's last, (n,) as set-point."""
        begin, end = line_of(state, route)
        zero = jnp.zeros_like(end.x)
        radius = jnp.where(ends_at(state, route, self.repeat), self.radius, 0.0)
        return TrackSetpoint(begin, end, radius, zero + self.airspeed, zero)
