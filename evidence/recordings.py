"""How well the published constants reproduce the recorded flights, open loop (models.md, section 9)."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.integrate import heun
from qrsim.core.tree import cast
from qrsim.core.vectors import AttitudeTrig, Euler, Vec3, rotation
from qrsim.errors import RunError
from qrsim.models.vehicles.quadrotor import (
    THROTTLE_RAW_PER_UNIT,
    Command,
    ProcessNoise,
    Quadrotor,
    QuadrotorState,
    raw_to_command,
)
from qrsim.openloop import simulate_open_loop

DOC = "mean squared errors of the identified quadrotor against the recorded rotation, thrust and outdoor runs"

DT = 0.02
OUTDOOR_ROWS = 8000
# The outdoor record's commands lead its motion by half a second.
OUTDOOR_LEAD_ROWS = 25
# Commands that a recording leaves out.
BATTERY_V = 11.0
ROTATION_THROTTLE_RAW = 0.615 * THROTTLE_RAW_PER_UNIT
OUTDOOR_THROTTLE_OFFSET_RAW = 592.0
THRUST_START_N = 15.4

Table = np.ndarray[Any, np.dtype[np.floating[Any]]]
FETCH = "run 'qrsim data fetch' and set QRSIM_DATA_DIR to the folder it prints"


def data_folder() -> Path:
    """Return the folder named by QRSIM_DATA_DIR.

    Raises:
        RunError: the variable is not set.
    """
    name = os.environ.get("QRSIM_DATA_DIR", "")
    if not name:
        raise RunError(f"no recordings: QRSIM_DATA_DIR is not set; {FETCH}")
    return Path(name)


def load(folder: Path, name: str, columns: int) -> Table:
    """Read one recording.

    Raises:
        RunError: the file is absent, unreadable or has another number of columns.
    """
    path = folder / name
    try:
        with warnings.catch_warnings():
            # An empty file gives a warning and no columns; the check below names it.
            warnings.simplefilter("ignore", UserWarning)
            rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except OSError as error:
        raise RunError(f"no recording {path}: {error.strerror or 'not found'}; {FETCH}") from error
    except ValueError as error:
        raise RunError(f"{path}: not a table of numbers ({error}); {FETCH}") from error
    if rows.shape[1] != columns:
        raise RunError(f"{path}: {rows.shape[1]} columns, expected {columns}; {FETCH}")
    return rows


def command_rows(pitch: Table, roll: Table, throttle: Table, yaw: Table, battery: Table) -> Table:
    """Return (T, 5) SI commands from raw columns of shape (T,)."""
    columns: Any = raw_to_command(pitch, roll, throttle, yaw, battery)  # type: ignore[arg-type]
    return np.stack([columns.pitch, columns.roll, columns.throttle, columns.yaw_rate, columns.battery], axis=1)


def _mean_square(difference: Table, names: tuple[str, ...]) -> dict[str, float]:
    return dict(zip(names, np.mean(np.square(difference, dtype=np.float64), axis=0).tolist(), strict=True))


def rotation_errors(folder: Path, precision: str = "float64") -> dict[str, float]:
    """Return the mean squared errors of angles [rad^2] and rates [(rad/s)^2] on the rotation rig."""
    rows = load(folder, "rotation_rig.csv", 11)
    pitch, roll, yaw, q, p, r = rows[:, 1:7].T
    constant = np.ones(len(rows))
    commands = command_rows(rows[:, 7], rows[:, 8], ROTATION_THROTTLE_RAW * constant, rows[:, 10], BATTERY_V * constant)
    recorded = np.stack([roll, pitch, yaw, p, q, r], axis=1)
    vehicle = Quadrotor()
    start = np.zeros(13)
    start[3:6], start[9:12] = recorded[0, :3], recorded[0, 3:]
    start[12] = vehicle.mass * vehicle.gravity
    states = simulate_open_loop(vehicle, commands, start, dt=DT, precision=precision)
    return _mean_square(states[:, [3, 4, 5, 9, 10, 11]] - recorded, ("phi", "theta", "psi", "p", "q", "r"))


def thrust_errors(folder: Path, precision: str = "float64") -> dict[str, float]:
    """Return the mean squared error of the thrust [N^2] on the thrust rig, and the record's variance."""
    rows = load(folder, "thrust_rig.csv", 4)
    with jax.enable_x64(precision == "float64"):
        vehicle = cast(Quadrotor(), precision)
        inputs = jnp.asarray(rows[:, [1, 3]], precision)

        def tick(thrust: jax.Array, row: jax.Array) -> tuple[jax.Array, jax.Array]:
            # The rig holds the body still, so that thrust is the whole state.
            def slope(now: jax.Array) -> tuple[jax.Array, jax.Array]:
                rate = vehicle.thrust_rate(now, row[0] / THROTTLE_RAW_PER_UNIT, row[1], DT)
                return rate, rate

            thrust, _ = heun(slope, thrust, DT)
            return thrust, thrust

        thrust = np.asarray(jax.lax.scan(tick, jnp.asarray(THRUST_START_N, precision), inputs)[1])
    recorded = rows[:, 2]
    return {
        "mean_squared_error": float(np.mean(np.square(thrust - recorded, dtype=np.float64))),
        "record_variance": float(np.var(recorded)),
    }


def _outdoor(folder: Path, precision: str) -> tuple[Table, Table, Table, Table]:
    """Return start state (13,), commands (T, 5), model rows (T, 16) and recorded rows (T, 22) to compare with."""
    rows = load(folder, "outdoor_flight.csv", 22)
    driven = rows[:OUTDOOR_ROWS]
    throttle = driven[:, 20] + OUTDOOR_THROTTLE_OFFSET_RAW
    commands = command_rows(driven[:, 18], driven[:, 19], throttle, driven[:, 21], np.full(len(driven), BATTERY_V))
    vehicle = Quadrotor()
    start = np.zeros(13)
    start[:6], start[9:12] = driven[0, :6], driven[0, 9:12]
    start[12] = vehicle.mass * vehicle.gravity
    states = simulate_open_loop(vehicle, commands, start, dt=DT, precision=precision)
    return start, commands, states, rows[OUTDOOR_LEAD_ROWS : OUTDOOR_LEAD_ROWS + OUTDOOR_ROWS]


def _body(states: Table) -> QuadrotorState:
    """Return rows of shape (T, 13) as a state whose arrays have shape (T,)."""
    columns = [jnp.asarray(states[:, i]) for i in range(13)]
    return QuadrotorState(
        Vec3(*columns[:3]), Euler(*columns[3:6]), Vec3(*columns[6:9]), Vec3(*columns[9:12]), columns[12]
    )


def outdoor_velocity_errors(folder: Path, precision: str = "float64") -> dict[str, float]:
    """Return the mean squared errors of the NED velocity [(m/s)^2] on the outdoor flight."""
    _, _, states, recorded = _outdoor(folder, precision)
    with jax.enable_x64(True):
        body = _body(np.asarray(states[:, :13], np.float64))
        velocity = jax.jit(lambda body: rotation(body.attitude).to_ned(body.velocity_body).stack())(body)
    return _mean_square(np.asarray(velocity) - recorded[:, 6:9], ("north", "east", "down"))


def reference_specific_force(vehicle: Quadrotor, before: Table, commands: Table) -> Table:
    """Return what the reference implementation calls specific force, (T, 3) [m/s^2], in float64.

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
            rates, _ = vehicle.derivative(state, command, lambda trig: still, ProcessNoise(still, still), DT)
            direction = AttitudeTrig.of(state.attitude).rotation()
            weight = Vec3(direction.forward.z, direction.right.z, direction.down.z) * vehicle.gravity
            return rates, rates.velocity_body - weight

        return np.asarray(jax.jit(lambda state: heun(slope, state, DT)[1].stack())(_body(before)))


def specific_force_errors(folder: Path) -> dict[str, dict[str, float]]:
    """Return the mean squared errors of the specific force [(m/s^2)^2], this model's form and the reference's."""
    start, commands, states, recorded = _outdoor(folder, "float64")
    before = np.concatenate([start[None], states[:-1, :13]])
    reference = reference_specific_force(Quadrotor(), before, commands)
    axes = ("x", "y", "z")
    return {
        "ours": _mean_square(states[:, 13:] - recorded[:, 12:15], axes),
        "reference": _mean_square(reference - recorded[:, 12:15], axes),
    }


def run(full: bool, folder: Path | None = None) -> dict[str, Any]:
    """Return every mean squared error in float64; the full form adds those of a float32 run.

    Raises:
        RunError: no recordings.
    """
    folder = data_folder() if folder is None else folder
    results: dict[str, Any] = {
        "rotation": rotation_errors(folder),
        "thrust": thrust_errors(folder),
        "outdoor_velocity": outdoor_velocity_errors(folder),
        "specific_force": specific_force_errors(folder),
    }
    if full:
        results["float32"] = {
            "rotation": rotation_errors(folder, "float32"),
            "thrust": thrust_errors(folder, "float32"),
            "outdoor_velocity": outdoor_velocity_errors(folder, "float32"),
        }
    return results
