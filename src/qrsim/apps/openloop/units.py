"""Commands in a file's units to SI, within the limits of the vehicle."""

from __future__ import annotations

import math

import numpy as np

from qrsim.apps.openloop.command_file import CommandTable, Units
from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.models.vehicles.quadrotor import COMMAND_FIELDS, COMMAND_LIMITS, raw_to_command

_LIMITS = np.array([COMMAND_LIMITS[name] for name in COMMAND_FIELDS])


def to_si(values: NumpyArray, units: Units) -> NumpyArray:
    """Convert commands (T, 5) from ``units`` to SI, without clipping."""
    if units == "si":
        return values
    command = raw_to_command(*values.T)
    return np.column_stack([getattr(command, name) for name in COMMAND_FIELDS])


def limits_in(units: Units) -> NumpyArray:
    """Return the lowest and highest allowed command of each column (5, 2), in ``units``."""
    scale = to_si(np.ones((1, 5)), units)[0]
    return np.sort(_LIMITS / scale[:, None], axis=1)


def si_within_limits(table: CommandTable, units: Units, clip: bool) -> tuple[NumpyArray, NumpyArray]:
    """Convert commands to SI (T, 5), and check (``clip``: clip) their limits; also return which rows were clipped, (T,)
    bool.

    Raises:
        UsageError: a command is out of its range and ``clip`` is off; names the first one's line and column.
    """
    commands = to_si(table.values, units)
    clipped = np.clip(commands, _LIMITS[:, 0], _LIMITS[:, 1])
    changed = clipped != commands
    rows = changed.any(axis=1)
    if rows.any() and not clip:
        row = int(rows.argmax())
        _refuse(table, units, row, int(changed[row].argmax()), int(rows.sum()))
    return clipped, rows


def _refuse(table: CommandTable, units: Units, row: int, column: int, count: int) -> None:
    """Raise UsageError for an out-of-range command at a row and column; ``count``: number of such rows."""
    low, high = limits_in(units)[column]
    # Rounded towards the inside, so that a bound copied from the message is itself allowed.
    low, high = math.ceil(low * 100.0) / 100.0, math.floor(high * 100.0) / 100.0
    others = f" ({count} such rows)" if count > 1 else ""
    raise UsageError(
        f"{table.source}: line {table.lines[row]}: column '{table.names[column]}':"
        f" {_shown(table.values[row, column])} is outside {_shown(low)} to {_shown(high)}"
        f" (--units {units}){others}; --clip brings commands into their range"
    )


def _shown(value: float) -> str:
    """Return a number as text, without ".0" if it is whole."""
    return repr(float(value)).removesuffix(".0")
