"""Reads the recorded flights, and converts their columns."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import RunError
from qrsim.models.vehicles.quadrotor import QuadrotorState, raw_to_command

DT = 0.02
# A command that the recordings leave out.
BATTERY_V = 11.0
FETCH = "run 'qrsim data fetch' and set QRSIM_DATA_DIR to the folder it prints"


class Match(NamedTuple):
    """A simulation and its recording, row by row.

    Attributes:
        time: (T,) since the first row [s].
        recorded, simulated: (T, K).
        names: of the K columns.
    """

    time: Floats
    recorded: Floats
    simulated: Floats
    names: tuple[str, ...]

    @property
    def residual(self) -> Floats:
        """Recorded minus simulated values, (T, K)."""
        return self.recorded - self.simulated

    def mean_square(self) -> dict[str, float]:
        """Return name -> mean squared error of each of the K columns."""
        return mean_square(self.residual, self.names)

    def explained(self) -> dict[str, float]:
        """Return name -> share of the recorded variance that the simulation explains: 1 - mean square
        error/variance."""
        variance = np.var(self.recorded, axis=0)
        return {name: 1.0 - error / float(variance[i]) for i, (name, error) in enumerate(self.mean_square().items())}


def mean_square(difference: Floats, names: tuple[str, ...]) -> dict[str, float]:
    """Return name -> mean square of each column (T, K)."""
    return dict(zip(names, np.mean(np.square(difference, dtype=np.float64), axis=0).tolist(), strict=True))


def read_table(path: Path, columns: int) -> Floats:
    """Read a public recording of numbers with a given number of columns.

    Raises:
        RunError: the file is absent, unreadable or has another number of columns.
    """
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


def command_rows(pitch: Floats, roll: Floats, throttle: Floats, yaw: Floats, battery: Floats) -> Floats:
    """Convert raw recorded columns (T,) to commands in SI (T, 5)."""
    columns = raw_to_command(pitch, roll, throttle, yaw, battery)  # type: ignore[arg-type]
    return np.stack([columns.pitch, columns.roll, columns.throttle, columns.yaw_rate, columns.battery], axis=1)


def state_of(states: Floats) -> QuadrotorState:
    """Convert rows of states (T, 13) to a vehicle state with arrays (T,)."""
    columns = [jnp.asarray(states[:, i]) for i in range(13)]
    return QuadrotorState(
        Vec3(*columns[:3]), Euler(*columns[3:6]), Vec3(*columns[6:9]), Vec3(*columns[9:12]), columns[12]
    )
