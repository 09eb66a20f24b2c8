"""How a vehicle's step uses its position, read from its traced program."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.noise import Drawn
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.contracts import Around

DT = 0.02


def only_adds(vehicle: Any) -> bool:
    """Return whether a step under the vehicle's own command does nothing with a position but add to it."""
    one = np.ones(3, np.float32)

    def vector(value: float) -> Vec3:
        return Vec3(value * one, value * one, value * one)  # type: ignore[arg-type]

    state = vehicle.initial_state(vector(-5.0), Euler(0.0 * one, 0.0 * one, 0.0 * one), vector(1.0), vector(0.0))  # type: ignore[arg-type]
    command = vehicle.idle_command(jnp.asarray(one))
    noise = vehicle.draw_noise(Drawn((jnp.asarray(one),) * vehicle.normals), DT)
    around = Around(lambda place: (0.0 * place.x, place * 0.0), vector(0.0))
    more = (around,) if vehicle.reads else ()

    def step(axes: list[Any]) -> Any:
        return vehicle.step(
            replace(state, position_ned=Vec3(*axes)), command, lambda trig: vector(0.0), noise, DT, *more
        )

    # As a list, because to JAX two structures are equal whose records differ in nothing but their type.
    closed, found = jax.make_jaxpr(step, return_shape=True)(list(jax.tree.leaves(state.position_ned)))
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
