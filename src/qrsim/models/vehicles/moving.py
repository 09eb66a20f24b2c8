"""A vehicle's step with its position in two parts, for any vehicle model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.pairs import added
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Around, Vehicle, VehicleState, velocity_of


def move(
    vehicle: Vehicle,
    state: Any,
    position_low_ned: Vec3 | None,
    command: Any,
    air_velocity: Callable[..., Vec3],
    noise: Any,
    dt: float,
    around: Around | None = None,
) -> tuple[VehicleState, Vec3 | None, Vec3]:
    """Advance a vehicle by one step; the other arguments are those of its own ``step``.

    A model that looks at nothing but how it moves is handed the second part in place of its position: that is a small
    number, to which a small step can be added. What comes back is added to the first part without loss.

    Args:
        vehicle: the model.
        state: its state, arrays (n,), with the first part of the position.
        position_low_ned: the second part; None: the position has one part only.

    Returns:
        The state after the step, the second part of its position, and the mean specific force [m/s^2].
    """

    def step(position_ned: Vec3) -> tuple[Any, Vec3]:
        # A vehicle that looks at nothing around it need not take it.
        more = () if around is None else (around,)
        return vehicle.step(replace(state, position_ned=position_ned), command, air_velocity, noise, dt, *more)

    if position_low_ned is None:
        moved, force = step(state.position_ned)
        return moved, None, force
    # Whoever reads the ground looks at where it is.
    if "ground" not in vehicle.reads and only_adds(step, position_low_ned):
        moved, force = step(position_low_ned)
        change = moved.position_ned
    else:
        moved, force = step(state.position_ned)
        change = position_low_ned + _way(vehicle, state, moved, dt)
    high, low = added(state.position_ned, change)
    return replace(moved, position_ned=high), low, force


def _way(vehicle: Vehicle, before: Any, after: Any, dt: float) -> Vec3:
    """Return how far vehicles (n,) of a model that looks at where it is have moved in a step.

    The difference of the two positions is known to their rounding only; within that the mean velocity decides.
    """
    first, last = velocity_of(vehicle.pose(before)), velocity_of(vehicle.pose(after))
    parts = []
    for axis in "xyz":
        old, new = getattr(before.position_ned, axis), getattr(after.position_ned, axis)
        doubt = jnp.abs(new) * float(np.finfo(new.dtype).eps)
        mean = (0.5 * dt) * (getattr(first, axis) + getattr(last, axis))
        parts.append(jnp.clip(mean, new - old - doubt, new - old + doubt))
    return Vec3(*parts)


def only_adds(step: Callable[[Vec3], tuple[Any, Vec3]], position_ned: Vec3) -> bool:
    """Return whether a step does nothing with a position but add to it, axis by axis.

    Args:
        step: from a position to (the state after it, with ``position_ned``; anything else).
        position_ned: only its shapes and types are looked at.
    """
    # As a list, because to JAX two structures are equal whose records differ in nothing but their type.
    closed, found = jax.make_jaxpr(lambda axes: step(Vec3(*axes)), return_shape=True)(
        list(jax.tree.leaves(position_ned))
    )
    after, other = jax.tree.map(lambda leaf: "", found)
    expected = jax.tree.leaves((replace(after, position_ned=Vec3("x", "y", "z")), other))  # type: ignore[arg-type]
    return _followed(closed.jaxpr, ["x", "y", "z"]) == expected


def _followed(jaxpr: Any, axes: list[str]) -> list[str] | None:
    """Return which axis of the position each result of a program is, "" where none; None where it is used otherwise."""
    axis_of = dict(zip(jaxpr.invars, axes, strict=True))

    def axis(variable: Any) -> str:
        return "" if hasattr(variable, "val") else axis_of.get(variable, "")

    for equation in jaxpr.eqns:
        given = [axis(variable) for variable in equation.invars]
        if not any(given):
            continue
        name, inner = equation.primitive.name, equation.params.get("jaxpr")
        if name in ("add", "add_any") and not all(given):
            results: list[str] | None = ["".join(given)]
        elif name == "sub" and not given[1]:
            results = given[:1]
        elif name in ("pjit", "jit") and inner is not None:
            results = _followed(inner.jaxpr, given)
        else:
            return None
        if results is None:
            return None
        axis_of |= dict(zip(equation.outvars, results, strict=True))
    return [axis(variable) for variable in jaxpr.outvars]
