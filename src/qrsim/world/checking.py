"""Checks that end flights: collisions among all vehicles, and the limits of each vehicle alone."""

from __future__ import annotations

import functools
from typing import cast

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import concatenated, map_tree, replace, select
from qrsim.core.vectors import Vec3
from qrsim.models.scene.area import Violation, collisions, reason_code
from qrsim.models.scene.sweeping import obstacle_hit
from qrsim.models.vehicles.contracts import Charged
from qrsim.world.sensing import at_rest
from qrsim.world.standing import ground_checks, over_the_floor
from qrsim.world.state import Fleet, FleetState, World


def check(world: World, before: tuple[FleetState, ...], flown: tuple[FleetState, ...]) -> tuple[FleetState, ...]:
    """Return the fleets' states after a step with vehicles that break a limit stopped where they were before it.

    Args:
        world: parameters.
        before, flown: states of each fleet before and after the step.
    """
    positions = []
    for old, new in zip(before, flown, strict=True):
        moving = old.violation.code == 0
        positions.append(select(moving, new.vehicle.position_ned, old.vehicle.position_ned))
    came_from = concatenated([old.vehicle.position_ned for old in before])
    collided = collisions(concatenated(positions), world.collision_distance, world.radii, came_from)
    checked, first = [], 0
    for fleet, old, new in zip(world.fleets, before, flown, strict=True):
        own = Violation.first(own_checks(world, fleet, new, old.vehicle.position_ned), new.vehicle.position_ned.x)
        in_collision = map_tree(lambda leaf: leaf[first : first + fleet.size], collided)  # noqa: B023
        first += fleet.size
        violation = old.violation.or_else(own.or_else(in_collision))
        stopped = fleet.vehicle.stopped(old.vehicle)
        valid = violation.code == 0
        # Only the vehicle and its estimate are put back: nothing else of a stopped vehicle has an effect.
        vehicle = select(valid, new.vehicle, stopped)
        low = select(valid, new.position_low_ned, old.position_low_ned)
        checked.append(
            replace(
                new,
                vehicle=vehicle,
                position_low_ned=low,
                violation=violation,
                estimate=select(valid, new.estimate, at_rest(old.estimate)),
                command_clipped=new.command_clipped & valid,
            )
        )
    return tuple(checked)


def own_checks(
    world: World, fleet: Fleet, state: FleetState, before_ned: Vec3 | None = None
) -> list[tuple[int, Array, Array]]:
    """Return the checks (reason code, value (n,), broken (n,)) of a fleet's vehicles that need no other vehicle.

    Args:
        world, fleet, state: of the fleet.
        before_ned: positions (n,) [m] from which it came in a straight line; None: it was put where it is.
    """
    pose = fleet.vehicle.pose(state.vehicle)
    over = over_the_floor(world, fleet, pose.position_ned)
    # One after the other: side by side in one array they would be written to memory first.
    finite = functools.reduce(jnp.logical_and, map(jnp.isfinite, jax.tree.leaves(state.vehicle)))
    return [
        # The vehicle's own checks are first: a crash so hard that the state overflows is reported as a crash.
        *fleet.vehicle.own_checks(state.vehicle),
        (reason_code("not_finite", "state"), jnp.zeros_like(pose.position_ned.x), ~finite),
        *ground_checks(world, fleet, state),
        *(world.area.check(over) if before_ned is None else world.area.swept(before_ned, over)),
        _hits_obstacle(world, fleet, pose.position_ned if before_ned is None else before_ned, pose.position_ned),
        *_empty_battery(fleet, state),
        *fleet.battery.own_checks(state.battery),
        *fleet.limits.check(pose.attitude, pose.velocity_body, pose.rates_body, state.turns),
    ]


def _empty_battery(fleet: Fleet, state: FleetState) -> list[tuple[int, Array, Array]]:
    """Return the check (reason code, charge (n,), empty (n,)) in a list, [] for a battery that cannot run out."""
    if not fleet.battery.drains:
        return []
    charge = cast(Charged, state.battery).charge
    return [(reason_code("battery_empty", "charge"), charge, charge <= 0.0)]


def _hits_obstacle(world: World, fleet: Fleet, start_ned: Vec3, end_ned: Vec3) -> tuple[int, Array, Array]:
    """Return the check (reason code, obstacle number (n,), hit (n,)) of straight paths against obstacles."""
    number, hit = obstacle_hit(world.obstacles, start_ned, end_ned, world.radius_of(fleet))
    return reason_code("collision", "obstacle"), number, hit
