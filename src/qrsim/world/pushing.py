"""Pushes: accelerations of vehicles for a time, of any vehicle model that is ``pushable``."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import rounded
from qrsim.core.vectors import Vec3, rotation
from qrsim.models.vehicles.contracts import Vehicle, VehicleState
from qrsim.world.state import Fleet

# A vehicle one step later, the remainder of its position [m], and its mean specific force [m/s^2].
Moved = tuple[VehicleState, Vec3 | None, Vec3]


def pushed(fleet: Fleet, vehicle: VehicleState, step: Callable[[VehicleState], Moved], tick: Array, dt: float) -> Moved:
    """Return the result of one dynamics step ``step`` of vehicles (n,), with the active pushes (accelerations) applied.

    Half of the change of velocity comes before the step, and half after it (Strang splitting), so that a free vehicle
    gains exactly the acceleration times the time, and the position that belongs to it. Accelerometers feel a push.

    Args:
        fleet: of the vehicles.
        vehicle: their state before the step.
        step: from a state to the next one, the remainder of its position, and the mean specific force [m/s^2].
        tick: () int32, at which the step begins.
        dt: of the step [s].

    Returns:
        The results of ``step``, with pushes.
    """
    pushes = (*fleet.pushes, *(() if fleet.push_slot is None else (fleet.push_slot,)))
    if not pushes:
        return step(vehicle)
    ned, body = pushes[0].at(tick)
    for push in pushes[1:]:
        more_ned, more_body = push.at(tick)
        ned, body = ned + more_ned, body + more_body
    vehicle, before = _half(fleet.vehicle, vehicle, ned, body, dt)
    moved, low, force = step(vehicle)
    moved, after = _half(fleet.vehicle, moved, ned, body, dt)
    return moved, low, force + (before + after).map(lambda axis: _scaled(0.5, axis))


def _half(model: Vehicle, vehicle: VehicleState, ned: Vec3, body: Vec3, dt: float) -> tuple[VehicleState, Vec3]:
    """Return vehicles (n,) after dt/2 of acceleration alone, ``ned`` plus ``body``, and that sum in body axes."""
    felt = rotation(model.pose(vehicle).attitude).to_body(ned) + body
    free = [
        axis if name in model.pushable else jnp.zeros_like(axis) for name, axis in zip("xyz", felt.axes, strict=True)
    ]
    felt = Vec3(*free)
    return model.pushed(vehicle, felt.map(lambda axis: _scaled(0.5 * dt, axis))), felt


def _scaled(factor: float, axis: Array) -> Array:
    """Return ``factor`` times an array (n,), with -0.0 for 0, which changes no bit when added."""
    return jnp.where(axis != 0.0, rounded(factor * axis), -0.0)
