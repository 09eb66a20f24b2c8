"""The simulator's own vehicle under a log's commands, many windows at once, with its derivatives by every unknown."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from qrsim.core.integrate import heun
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState
from qrsim.studies.identify.constants import CHANNELS

_WIDTH = len(CHANNELS)
PLACE = {name: i for i, name in enumerate(CHANNELS)}
# Places in a start beside those of the channels: the wind in the middle of a window less that of its log, along north,
# east and down, and by how much it changes from there to the window's end.
GUST = tuple(range(_WIDTH, _WIDTH + 3))
DRIFT = tuple(range(_WIDTH + 3, _WIDTH + 6))


def delayed(commands: Array, delay: Array, dt: float) -> Array:
    """Delay commands (T, 5) by ``delay`` [s]: each becomes the mean, over its step, of the command then held."""
    steps = jnp.maximum(delay, 0.0) / dt
    whole = jnp.floor(steps)
    part = steps - whole
    rows = jnp.arange(len(commands)) - whole.astype(int)
    later, earlier = (commands[jnp.clip(rows - i, 0, len(commands) - 1)] for i in (0, 1))
    return later + part * (earlier - later)


def thrust_history(vehicle: Quadrotor, throttle: Array, battery: Array, first: Array | None, dt: float) -> Array:
    """Simulate the thrust (T,) [N] before each row's command acts, from throttle and battery voltage (T,).

    Without a first value it starts where the first row's command would settle.
    """
    if first is None:
        first = jnp.minimum(vehicle.wanted_thrust(throttle[0]), vehicle.cvb0 + vehicle.cvb1 * battery[0])

    def tick(thrust: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        """Advance the thrust by one row; return it, and the thrust before the row."""

        def slope(now: Array) -> tuple[Array, Array]:
            """Return the rate of the thrust [N/s], twice as ``heun`` needs."""
            rate = vehicle.thrust_rate(now, row[0], row[1], dt)
            return rate, rate

        return heun(slope, thrust, dt)[0], thrust

    return jax.lax.scan(tick, first, (throttle, battery))[1]


def fly(vehicle: Quadrotor, start: Array, commands: Array, wind_ned: Vec3, drift_ned: Vec3, dt: float) -> Array:
    """Simulate n vehicles through R rows of commands, with wind and drift; return channels (R, n, 10).

    Args:
        vehicle: parameters.
        start: (n, 10) channels before the first row.
        commands: (R, 5, n) SI.
        wind_ned: velocity of the air in the middle of each window [m/s], (n,).
        drift_ned: its change from there to the end, (n,).
        dt: step [s].
    """
    zero = Vec3.zeros((start.shape[0],), start.dtype)
    column = [start[:, i] for i in range(_WIDTH)]
    attitude = Euler(*column[:3])
    velocity = rotation(attitude).to_body(Vec3(*column[6:9]))
    first = QuadrotorState(zero, attitude, velocity, Vec3(*column[3:6]), column[9])
    noise = ProcessNoise(zero, zero)

    def tick(state: QuadrotorState, now: tuple[Array, Array]) -> tuple[QuadrotorState, Array]:
        """Advance the state by one row; return it, and the channels before the row."""
        row, part = now
        wind = wind_ned + drift_ned * part
        over_ground = rotation(state.attitude).to_ned(state.velocity_body)
        leaves = [*jax.tree.leaves((state.attitude, state.rates_body, over_ground)), state.thrust]
        command = Command(*(row[i] for i in range(5)))
        after, _ = vehicle.step(state, command, lambda trig: trig.rotation().to_body(wind), noise, dt)
        return after, jnp.stack(leaves, axis=-1)

    return jax.lax.scan(tick, first, (commands, jnp.linspace(-1.0, 1.0, len(commands), dtype=start.dtype)))[1]


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
    """Simulate n windows from initial states, with thrust in them if ``thrust_measured``; return (R, n, 10).

    Args:
        names: of the unknowns.
        thrust_measured: whether the thrust at the start of a window is one of ``starts``, or follows from the commands.
        vehicle: what is not among the unknowns.
        unknowns: (K,) in the order of ``names``.
        starts: (n, 16) channels at the first row of each window, its gust and drift.
        commands: (T, 5) of the whole log.
        windows: (R, n) rows.
        dt: step [s].
    """
    value = dict(zip(names, (unknowns[i] for i in range(len(names))), strict=True))
    zero = jnp.zeros((), unknowns.dtype)
    constants = {name: number for name, number in value.items() if name in vars(vehicle)}
    vehicle = replace(vehicle, **constants)
    late = delayed(commands, value.get("delay", zero), dt)
    trims = [value.get(name, zero) for name in ("pitch_trim", "roll_trim", "", "yaw_rate_trim", "")]
    late = jnp.stack([late[:, i] + trim for i, trim in enumerate(trims)], axis=1)
    if not thrust_measured:
        history = thrust_history(vehicle, late[:, 2], late[:, 4], None, dt)
        starts = starts.at[:, PLACE["thrust"]].set(history[windows[0]])
    axes = zip(("wind_north", "wind_east", "wind_down"), GUST, strict=True)
    wind = Vec3(*(value.get(name, zero) + starts[:, place] for name, place in axes))
    drift = Vec3(*(starts[:, place] for place in DRIFT))
    return fly(vehicle, starts[:, :_WIDTH], jnp.moveaxis(late[windows], 2, 1), wind, drift, dt)


@partial(jax.jit, static_argnames=("names", "places", "thrust_measured", "dt"))
def predict(places: tuple[int, ...], **arguments: Any) -> Array:
    """Simulate the measured channels (R, n, C), those with indices ``places``; arguments as for ``channels``."""
    return channels(**arguments)[:, :, jnp.array(places)]


@partial(jax.jit, static_argnames=("names", "places", "free", "thrust_measured", "dt"))
def linearised(
    places: tuple[int, ...], free: tuple[int, ...], unknowns: Array, starts: Array, **rest: Any
) -> tuple[Array, Array, Array]:
    """Return channels (R, n, C), their derivatives (R, n, C, K) by unknowns, and by the S initial values ``free``.

    A window depends on its own start alone, so one direction moves the starts of all windows together.

    Args:
        places: of the measured channels.
        free: places in ``starts`` by which is differentiated.
        unknowns, starts, rest: of ``channels``.
    """

    def moved(both: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the channels for shifted unknowns and initial states, twice, as ``jacfwd`` needs."""
        theta, shift = both
        shifted = starts.at[:, jnp.array(free)].add(jnp.broadcast_to(shift, (starts.shape[0], len(free))))
        found = channels(unknowns=theta, starts=shifted, **rest)[:, :, jnp.array(places)]
        return found, found

    at = (unknowns, jnp.zeros(len(free), unknowns.dtype))
    (by_unknowns, by_start), found = jax.jacfwd(moved, has_aux=True)(at)
    return found, by_unknowns, by_start
