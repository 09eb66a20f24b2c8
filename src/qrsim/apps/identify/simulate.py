"""The simulator's own vehicle under a log's commands, many windows at once, with its derivatives by every unknown."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.apps.identify.constants import CHANNELS
from qrsim.core.integrate import heun
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.vehicles.quadrotor import Command, ProcessNoise, Quadrotor, QuadrotorState

_WIDTH = len(CHANNELS)
PLACE = {name: i for i, name in enumerate(CHANNELS)}


def delayed(commands: Array, delay: Array, dt: float) -> Array:
    """Return commands (T, 5) that act ``delay`` [s] late, as the mean over each step of what is held during it."""
    steps = jnp.maximum(delay, 0.0) / dt
    whole = jnp.floor(steps)
    part = steps - whole
    rows = jnp.arange(len(commands)) - whole.astype(int)
    later, earlier = (commands[jnp.clip(rows - i, 0, len(commands) - 1)] for i in (0, 1))
    return later + part * (earlier - later)


def thrust_history(vehicle: Quadrotor, throttle: Array, battery: Array, first: Array | None, dt: float) -> Array:
    """Return the thrust (T,) [N] before each row of throttle and battery (T,), by the vehicle's own equation.

    Without a first value it starts where the first row's command would settle.
    """
    if first is None:
        first = jnp.minimum(vehicle.wanted_thrust(throttle[0]), vehicle.cvb0 + vehicle.cvb1 * battery[0])

    def tick(thrust: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        def slope(now: Array) -> tuple[Array, Array]:
            rate = vehicle.thrust_rate(now, row[0], row[1], dt)
            return rate, rate

        return heun(slope, thrust, dt)[0], thrust

    return jax.lax.scan(tick, first, (throttle, battery))[1]


def fly(vehicle: Quadrotor, start: Array, commands: Array, wind_ned: Vec3, dt: float) -> Array:
    """Return the channels (W, n, 10) of n vehicles at each row.

    Args:
        vehicle: parameters.
        start: (n, 10) channels before the first row.
        commands: (W, 5, n) SI.
        wind_ned: velocity of the air [m/s], numbers.
        dt: step [s].
    """
    zero = Vec3.zeros((start.shape[0],), start.dtype)
    column = [start[:, i] for i in range(_WIDTH)]
    attitude = Euler(*column[:3])
    velocity = rotation(attitude).to_body(Vec3(*column[6:9]))
    first = QuadrotorState(zero, attitude, velocity, Vec3(*column[3:6]), column[9])
    noise = ProcessNoise(zero, zero)
    wind = Vec3(*(jnp.broadcast_to(axis, zero.x.shape) for axis in (wind_ned.x, wind_ned.y, wind_ned.z)))

    def tick(state: QuadrotorState, row: Array) -> tuple[QuadrotorState, Array]:
        over_ground = rotation(state.attitude).to_ned(state.velocity_body)
        leaves = [*jax.tree.leaves((state.attitude, state.rates_body, over_ground)), state.thrust]
        command = Command(*(row[i] for i in range(5)))
        after, _ = vehicle.step(state, command, lambda trig: trig.rotation().to_body(wind), noise, dt)
        return after, jnp.stack(leaves, axis=-1)

    return jax.lax.scan(tick, first, commands)[1]


def channels(
    names: tuple[str, ...],
    thrust_measured: bool,
    vehicle: Quadrotor,
    unknowns: Array,
    starts: Array,
    commands: Array,
    windows: Array,
    dt: float,
) -> Array:
    """Return the channels (W, n, 10) of n windows of one log.

    Args:
        names: of the unknowns.
        thrust_measured: whether the thrust at the start of a window is one of ``starts``, or follows from the commands.
        vehicle: what is not among the unknowns.
        unknowns: (K,) in the order of ``names``.
        starts: (n, 10) channels at the first row of each window.
        commands: (T, 5) of the whole log.
        windows: (W, n) rows.
        dt: step [s].
    """
    value = dict(zip(names, (unknowns[i] for i in range(len(names))), strict=True))
    zero = jnp.zeros((), unknowns.dtype)
    constants = {name: number for name, number in value.items() if hasattr(vehicle, name)}
    vehicle = replace(vehicle, **constants)
    late = delayed(commands, value.get("delay", zero), dt)
    trims = [value.get(name, zero) for name in ("pitch_trim", "roll_trim", "", "yaw_rate_trim", "")]
    late = jnp.stack([late[:, i] + trim for i, trim in enumerate(trims)], axis=1)
    if not thrust_measured:
        history = thrust_history(vehicle, late[:, 2], late[:, 4], None, dt)
        starts = starts.at[:, PLACE["thrust"]].set(history[windows[0]])
    wind = Vec3(value.get("wind_north", zero), value.get("wind_east", zero), value.get("wind_down", zero))
    return fly(vehicle, starts, jnp.moveaxis(late[windows], 2, 1), wind, dt)


@partial(jax.jit, static_argnames=("names", "places", "thrust_measured", "dt"))
def predict(
    names: tuple[str, ...],
    places: tuple[int, ...],
    thrust_measured: bool,
    vehicle: Quadrotor,
    unknowns: Array,
    starts: Array,
    commands: Array,
    windows: Array,
    dt: float,
) -> Array:
    """Return the measured channels (W, n, C), those at ``places``; see ``channels``."""
    every = channels(names, thrust_measured, vehicle, unknowns, starts, commands, windows, dt)
    return every[:, :, jnp.array(places)]


@partial(jax.jit, static_argnames=("names", "places", "thrust_measured", "dt"))
def linearised(
    names: tuple[str, ...],
    places: tuple[int, ...],
    thrust_measured: bool,
    vehicle: Quadrotor,
    unknowns: Array,
    starts: Array,
    commands: Array,
    windows: Array,
    dt: float,
) -> tuple[Array, Array, Array]:
    """Return the measured channels (W, n, C) and their derivatives by unknowns (W, n, C, K) and own start (W, n, C, C).

    A window depends on its own start alone, so one direction moves the starts of all windows together.
    """

    def moved(both: tuple[Array, Array]) -> tuple[Array, Array]:
        theta, shift = both
        shifted = starts.at[:, jnp.array(places)].add(jnp.broadcast_to(shift, (starts.shape[0], len(places))))
        every = channels(names, thrust_measured, vehicle, theta, shifted, commands, windows, dt)
        found = every[:, :, jnp.array(places)]
        return found, found

    at: Any = (unknowns, jnp.zeros(len(places), unknowns.dtype))
    (by_unknowns, by_start), found = jax.jacfwd(moved, has_aux=True)(at)
    return found, by_unknowns, by_start
