"""Rovers alone on a plane, driven by one jitted scan in double precision."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.contracts import Around


def still(count: int) -> Vec3:
    zero = np.zeros(count)
    return Vec3(zero, zero, zero)  # type: ignore[arg-type]


def around(normal: tuple[float, float, float], like: Any) -> Around:
    """Return a plane through the origin with an upward normal."""
    n, e, d = normal

    def ground(place: Vec3) -> tuple[Any, Vec3]:
        down = -(n * place.x + e * place.y) / d
        return down, Vec3(*(jnp.full_like(like, part) for part in normal))

    zero = jnp.zeros_like(like)
    nothing = Vec3(zero, zero, zero)
    return Around(ground, nothing)


def drive(
    model: Any,
    commands: Any,
    dt: float,
    substeps: int = 1,
    normal: tuple[float, float, float] = (0.0, 0.0, -1.0),
    yaw: float = 0.0,
    dtype: Any = np.float64,
) -> tuple[Any, Any]:
    """Return states and specific forces, leaves (T, n), after each of some commands, a record of (T, n)."""
    with jax.enable_x64(dtype == np.float64):
        model, commands = cast(model, dtype), cast(commands, dtype)
        count = jax.tree.leaves(commands)[0].shape[1]
        nothing = cast(still(count), dtype)
        heading = Euler(np.zeros(count, dtype), np.zeros(count, dtype), np.full(count, yaw, dtype))  # type: ignore[arg-type]

        @jax.jit
        def run(commands: Any) -> Any:
            like = jnp.zeros(count, dtype)
            surroundings = around(normal, like)
            start = model.stood(model.initial_state(nothing, heading, nothing, nothing), surroundings.ground)

            def step(state: Any, command: Any) -> Any:
                def part(_: Any, carried: Any) -> Any:
                    return model.step(carried[0], command, lambda trig: nothing, None, dt / substeps, surroundings)

                state, force = jax.lax.fori_loop(0, substeps, part, (state, nothing))
                return state, (state, force)

            return jax.lax.scan(step, start, commands)[1]

        found: Any = jax.tree.map(np.asarray, run(commands))
    return found
