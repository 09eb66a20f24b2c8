"""The outdoor flight: the model under its commands, in still air and in wind, in one run or in pieces."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.integrate import heun
from qrsim.core.tree import cast
from qrsim.core.vectors import AttitudeTrig, Vec3, rotation
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState
from qrsim.simulation.openloop import simulate_open_loop
from qrsim.studies.validate.recorded import BATTERY_V, DT, Match, command_rows, mean_square, read_table, state_of

RECORDING = "outdoor_flight.csv"
ROWS = 8000
# The record's commands lead its motion by half a second.
LEAD_ROWS = 25
# What the recording's throttle lacks.
THROTTLE_OFFSET_RAW = 592.0
AXES = ("north", "east", "down")


class Outdoor(NamedTuple):
    """The recording and the model's run in still air.

    Attributes:
        start: (13,) state before the first row.
        commands: (T, 5) in SI units.
        states: (T, 16) rows of ``simulate_open_loop``.
        recorded: (T, 22) rows to compare with.
        before: (T, 22) the rows before those.
    """

    start: Floats
    commands: Floats
    states: Floats
    recorded: Floats
    before: Floats


def fly_recorded(path: Path, precision: str = "float64") -> Outdoor:
    """Simulate the recorded outdoor flight in still air, from the commands of its first 8000 rows."""
    rows = read_table(path, 22)
    driven = rows[:ROWS]
    throttle = driven[:, 20] + THROTTLE_OFFSET_RAW
    commands = command_rows(driven[:, 18], driven[:, 19], throttle, driven[:, 21], np.full(len(driven), BATTERY_V))
    vehicle = Quadrotor()
    start = np.zeros(13)
    start[:6], start[9:12] = driven[0, :6], driven[0, 9:12]
    start[12] = vehicle.mass * vehicle.gravity
    states = simulate_open_loop(vehicle, commands, start, dt=DT, precision=precision)
    recorded, before = (rows[first : first + ROWS] for first in (LEAD_ROWS, LEAD_ROWS - 1))
    return Outdoor(start, commands, states, recorded, before)


def velocity_match(flight: Outdoor) -> Match:
    """Return recorded and simulated NED velocity [m/s] of the outdoor flight."""
    with jax.enable_x64(True):
        body = state_of(np.asarray(flight.states[:, :13], np.float64))
        velocity = jax.jit(lambda body: rotation(body.attitude).to_ned(body.velocity_body).stack())(body)
    return Match(DT * np.arange(len(flight.states)), flight.recorded[:, 6:9], np.asarray(velocity), AXES)


def reference_specific_force(vehicle: Quadrotor, before: Floats, commands: Floats) -> Floats:
    """Return the specific force (T, 3) [m/s^2] by the reference implementation's formula, in float64.

    It takes gravity from the rate of change of the body velocity, and so leaves a false -omega x v; the mean of
    the two stages of Heun's rule, as for the model's own.

    Args:
        vehicle: parameters.
        before: (T, 13) state before each step.
        commands: (T, 5) SI commands of each step.
    """
    with jax.enable_x64(True):
        vehicle = cast(vehicle, np.float64)
        command = Command(*(jnp.asarray(commands[:, i]) for i in range(5)))
        still = Vec3.zeros((len(before),), jnp.dtype(np.float64))

        def slope(state: QuadrotorState) -> tuple[QuadrotorState, Vec3]:
            """Return the derivative of the state, and the specific force by the reference's formula."""
            rates, _ = vehicle.derivative(state, command, lambda trig: still, ProcessNoise(still, still), DT)
            direction = AttitudeTrig.of(state.attitude).rotation()
            weight = Vec3(direction.forward.z, direction.right.z, direction.down.z) * vehicle.gravity
            return rates, rates.velocity_body - weight

        return np.asarray(jax.jit(lambda state: heun(slope, state, DT)[1].stack())(state_of(before)))


def specific_force_errors(flight: Outdoor) -> dict[str, dict[str, float]]:
    """Return mean squared errors of the specific force [(m/s^2)^2], by this model's and the reference's formula."""
    before = np.concatenate([flight.start[None], flight.states[:-1, :13]])
    reference = reference_specific_force(Quadrotor(), before, flight.commands)
    axes = ("x", "y", "z")
    return {
        "ours": mean_square(flight.states[:, 13:] - flight.recorded[:, 12:15], axes),
        "reference": mean_square(reference - flight.recorded[:, 12:15], axes),
    }


@partial(jax.jit, static_argnames="dt")
def _simulate_in_wind(
    vehicle: Quadrotor, start: QuadrotorState, commands: jax.Array, wind_ned: Vec3, dt: float
) -> tuple[jax.Array, jax.Array]:
    """Simulate a model open loop in a constant wind; return NED velocities and positions after each command."""
    still = Vec3.zeros(start.thrust.shape, start.thrust.dtype)
    noise = ProcessNoise(still, still)

    def tick(state: QuadrotorState, row: jax.Array) -> tuple[QuadrotorState, tuple[jax.Array, jax.Array]]:
        """Advance the state by one row of commands; return it, and velocity and position NED."""
        command = Command(*(row[i] for i in range(5)))
        state, _ = vehicle.step(state, command, lambda trig: trig.rotation().to_body(wind_ned), noise, dt)
        velocity = rotation(state.attitude).to_ned(state.velocity_body)
        return state, (velocity.stack(), state.position_ned.stack())

    return jax.lax.scan(tick, start, commands)[1]


def fly_in_wind(start: Floats, commands: Floats, wind_ned: Floats) -> tuple[Floats, Floats]:
    """Simulate n models open loop in constant winds (n, 3); return NED velocities and positions (T, n, 3).

    Args:
        start: (n, 13) states before the first row.
        commands: (T, 5, n) SI commands.
        wind_ned: (n, 3) velocity of the air [m/s].

    Returns:
        NED velocities [m/s] and positions [m] after each row, (T, n, 3) each.
    """
    with jax.enable_x64(True):
        vehicle = cast(Quadrotor(), np.float64)
        wind = Vec3.of(jnp.asarray(wind_ned))
        velocity, position = _simulate_in_wind(vehicle, state_of(start), jnp.asarray(commands), wind, DT)
        return np.asarray(velocity), np.asarray(position)


def fit_wind(still: Floats, response: Floats, recorded: Floats) -> Floats:
    """Return the constant horizontal wind (2,) [m/s], north and east, that best fits the recorded velocities.

    Attitude and thrust do not depend on the wind, and the rest of the model is linear in velocity and wind, so that
    the velocity is exactly the one in still air plus a response to each component: linear least squares.

    Args:
        still: (T, 3) simulated velocity in still air.
        response: (T, 3, 2) what 1 m/s of wind from the south, and from the west, adds to it.
        recorded: (T, 3).
    """
    columns = response[:, :2].reshape(-1, 2)
    return np.asarray(np.linalg.lstsq(columns, (recorded - still)[:, :2].reshape(-1), rcond=None)[0])


def fly_pieces(flight: Outdoor, wind_ned: Floats, steps: int, spacing: int) -> tuple[Floats, Floats]:
    """Simulate ``steps`` rows from every ``spacing``-th row; return simulated and recorded velocities (steps, n, 3).

    Returns:
        Velocities (steps, n, 3) [m/s] simulated, and recorded.
    """
    firsts = np.arange(0, len(flight.commands) - steps, spacing)
    rows = firsts[:, None] + np.arange(steps)
    start = np.zeros((len(firsts), 13))
    before = flight.before[firsts]
    start[:, 3:6], start[:, 9:12] = before[:, 3:6], before[:, 9:12]
    with jax.enable_x64(True):
        attitude = state_of(start).attitude
        start[:, 6:9] = np.asarray(rotation(attitude).to_body(Vec3.of(jnp.asarray(before[:, 6:9]))).stack())
    # Thrust was not recorded; the model's own depends on the commands alone.
    start[:, 12] = np.concatenate([flight.start[None, 12], flight.states[:-1, 12]])[firsts]
    winds = np.broadcast_to(wind_ned, (len(firsts), 3))
    velocity, _ = fly_in_wind(start, np.moveaxis(flight.commands[rows], 0, -1), winds)
    return velocity, np.moveaxis(flight.recorded[rows, 6:9], 0, 1)
