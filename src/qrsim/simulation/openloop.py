"""Drive the vehicle model alone with recorded commands: no world, no sensors, no noise."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.pairs import parts_of
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.contracts import VehicleState
from qrsim.models.vehicles.moving import move
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState


@partial(jax.jit, static_argnames="dt")
def _scan(
    vehicle: Quadrotor, initial: jax.Array, rest: jax.Array, commands: jax.Array, wind_body: jax.Array, dt: float
) -> jax.Array:
    """Return a row of state and specific force for each command (T, 5); ``rest``: rounding remainder of ``initial``."""
    like = initial[0]
    still = Vec3.zeros((), like.dtype)
    noise = ProcessNoise(still, still)
    wind = Vec3.of(wind_body)

    def tick(
        carry: tuple[VehicleState, Vec3 | None], row: jax.Array
    ) -> tuple[tuple[VehicleState, Vec3 | None], jax.Array]:
        """Return the state after one command (5,), and its row of the result."""
        command = Command(*(row[i] for i in range(5)))
        state, low, force = move(vehicle, *carry, command, lambda trig: wind, noise, dt)
        return (state, low), jnp.stack([*jax.tree.leaves(state), force.x, force.y, force.z])

    leaves = [initial[i] for i in range(13)]
    start: VehicleState = QuadrotorState(
        Vec3(*leaves[:3]), Euler(*leaves[3:6]), Vec3(*leaves[6:9]), Vec3(*leaves[9:12]), leaves[12]
    )
    low = Vec3.of(rest[:3]) if like.dtype == jnp.float32 else None
    return jax.lax.scan(tick, (start, low), commands)[1]


def simulate_open_loop(
    vehicle: Quadrotor,
    commands: NumpyArray,
    initial_state: NumpyArray,
    *,
    wind_body: tuple[float, float, float] = (0.0, 0.0, 0.0),
    dt: float = 0.02,
    precision: str = "float64",
) -> NumpyArray:
    """Fly a quadrotor by a sequence of commands (T, 5) in a constant wind, without world and sensors; return its states
    (T, 16).

    Args:
        vehicle: parameters.
        commands: (T, 5) SI commands (pitch, roll, throttle, yaw rate, battery), row i applied during step i.
        initial_state: (13,) state before the first row (position NED, Euler angles, body velocity, rates, thrust).
        wind_body: air velocity in body axes [m/s], constant in the body frame.
        dt: step [s].
        precision: "float64" or "float32".

    Returns:
        (T, 16): the state after each row, then the mean specific force [m/s^2] during it.
    """
    dtype = np.dtype(precision)
    first, rest = parts_of(np.asarray(initial_state, np.float64), dtype)
    with jax.enable_x64(dtype == np.float64):
        rows = _scan(
            cast(vehicle, dtype),
            jnp.asarray(first),
            jnp.asarray(rest),
            jnp.asarray(commands, dtype),
            jnp.asarray(wind_body, dtype),
            dt,
        )
        return np.asarray(rows)


def hover_state(vehicle: Quadrotor, position_ned: tuple[float, float, float] = (0.0, 0.0, -10.0)) -> NumpyArray:
    """Return the state (13,) of a quadrotor that hovers at a position NED [m], at rest, with thrust equal to its
    weight."""
    state = np.zeros(13)
    state[:3] = position_ned
    state[12] = float(vehicle.mass) * float(vehicle.gravity)
    return state
