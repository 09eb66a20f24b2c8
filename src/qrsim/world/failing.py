"""Failsafes of a fleet in a tick: their inputs, and the set-point that replaces the guidance's."""

from __future__ import annotations

from typing import cast

import jax.numpy as jnp
from jax import Array

from qrsim.control import Estimate, PathSetpoint, WaypointSetpoint
from qrsim.control.failsafe_flight import FailsafeState, Watched
from qrsim.core.tree import replace, select
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Charged, Pose
from qrsim.world.standing import on_ground
from qrsim.world.state import Fleet, FleetState, State, World


def first_failsafe(world: World, fleet: Fleet, pose: Pose) -> FailsafeState | None:
    """Return a fleet's failsafe state at the start, with home on the ground below; None without failsafes."""
    if fleet.failsafes is None:
        return None
    start = pose.position_ned
    return FailsafeState.start(
        replace(start, z=world.ground_down(start)), pose.attitude.yaw, rally=bool(fleet.failsafes.rally)
    )


def by_failsafe(
    world: World,
    whole: State,
    fleet: Fleet,
    state: FleetState,
    estimate: Estimate,
    setpoint: object,
    tick: Array,
) -> tuple[FailsafeState, PathSetpoint]:
    """Return a fleet's failsafe state after a tick, and the set-point (n,): the given one, or an active failsafe's.

    Args:
        world, whole: parameters and state.
        fleet, state: the fleet and its state.
        estimate: estimate that its controller gets.
        setpoint: set-point of its guidance, a waypoint or the point of a path.
        tick: () int32 now.
    """
    assert fleet.failsafes is not None
    assert state.failsafe is not None
    standing = on_ground(fleet, state)
    seen = Watched(
        estimate,
        jnp.zeros(fleet.size, bool) if standing is None else standing,
        tick,
        cast(Charged, state.battery).charge if fleet.battery.drains else None,
        _fixed(fleet, state),
        _heard(world, whole, fleet, tick),
    )
    found, asked = fleet.failsafes.step(state.failsafe, seen, _as_path(setpoint), world.time_step)
    # Nothing fails any more where the flight has ended; sensors there are silent.
    return select(state.violation.code == 0, found, state.failsafe), asked


def _as_path(setpoint: object) -> PathSetpoint:
    """Return a waypoint set-point as a path set-point at rest; a path set-point unchanged."""
    if isinstance(setpoint, PathSetpoint):
        return setpoint
    assert isinstance(setpoint, WaypointSetpoint)
    zero = jnp.zeros_like(setpoint.yaw)
    still = Vec3(zero, zero, zero)
    return PathSetpoint(setpoint.position_ned, still, still, setpoint.yaw)


def _fixed(fleet: Fleet, state: FleetState) -> Array | None:
    """Return (n,) bool: a GNSS receiver has a fix; None without a receiver, or for a controller fed with the truth."""
    if fleet.controller.feed == "truth":
        return None
    places = [vars(reading).get("position_ned") for reading in state.readings]
    fixes = [jnp.isfinite(place.x) for place in places if isinstance(place, Vec3)]
    if not fixes:
        return None
    found = fixes[0]
    for other in fixes[1:]:
        found = found | other
    return found


def _heard(world: World, whole: State, fleet: Fleet, tick: Array) -> Array | None:
    """Return the tick (n,) at which the link's newest received message was sent; None if link loss is not monitored."""
    assert fleet.failsafes is not None
    if fleet.failsafes.NAV_DLL_ACT == "none" or world.radio is None:
        return None
    senders = world.rows_of(fleet.failsafes.link_to)
    own = world.rows_of(fleet.name)
    return world.radio.last_heard(whole.radio, senders, tick, world.time_step)[own]
