"""A vehicle's step with its position in two parts, for any vehicle model."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from qrsim.core.pairs import added
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Around, Vehicle, VehicleState, velocity_of


def move(
    vehicle: Vehicle,
    state: VehicleState,
    position_low_ned: Vec3 | None,
    command: object,
    air_velocity: Callable[..., Vec3],
    noise: object,
    dt: float,
    around: Around | None = None,
) -> tuple[VehicleState, Vec3 | None, Vec3]:
    """Return the vehicle's state dt [s] later, the remainder of its position or None, and the specific force.

    A model that only adds to its position is given the second part in place of it: that is a small number, to which a
    small step can be added. The result is added to the first part without loss.

    Args:
        vehicle: the model.
        state: its state, arrays (n,), with the first part of the position.
        position_low_ned: the second part; None: the position has one part only.

    Returns:
        The state after the step, the remainder of its position, and the mean specific force [m/s^2].
    """

    def step(position_ned: Vec3) -> tuple[VehicleState, Vec3]:
        """Return the state one step later from ``position_ned`` (n,) [m], and the specific force."""
        # Vehicles without ``reads`` have no argument for their surroundings.
        more = () if around is None else (around,)
        return vehicle.step(replace(state, position_ned=position_ned), command, air_velocity, noise, dt, *more)

    if position_low_ned is None:
        moved, force = step(state.position_ned)
        return moved, None, force
    # Not by inheritance, because a subclass may well look at where it is.
    if vars(type(vehicle)).get("adds_position", False):
        moved, force = step(position_low_ned)
        change = moved.position_ned
    else:
        moved, force = step(state.position_ned)
        change = position_low_ned + _displacement(vehicle, state, moved, dt)
    high, low = added(state.position_ned, change)
    return replace(moved, position_ned=high), low, force


def _displacement(vehicle: Vehicle, before: VehicleState, after: VehicleState, dt: float) -> Vec3:
    """Return the displacement (n,) [m] in a step, for vehicle models that depend on their position.

    It is the mean velocity times the step, clipped to the difference of the two positions give or take their rounding.
    """
    first, last = velocity_of(vehicle.pose(before)), velocity_of(vehicle.pose(after))
    parts = []
    for axis in "xyz":
        old, new = getattr(before.position_ned, axis), getattr(after.position_ned, axis)
        doubt = jnp.abs(new) * float(np.finfo(new.dtype).eps)
        mean = (0.5 * dt) * (getattr(first, axis) + getattr(last, axis))
        parts.append(jnp.clip(mean, new - old - doubt, new - old + doubt))
    return Vec3(*parts)
