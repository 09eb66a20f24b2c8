"""The layouts of the public recordings: tables of numbers without a header (docs/explanation/paper.md)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from qrsim.errors import LogError
from qrsim.files.user_files import open_text
from qrsim.models.vehicles.quadrotor import (
    PITCH_ROLL_RAD_PER_RAW,
    THROTTLE_RAW_PER_UNIT,
    YAW_RATE_RAD_S_PER_RAW,
)
from qrsim.studies.flight_logs.preparing import prepare
from qrsim.studies.flight_logs.signals import FlightLog, Floats, Track

DT = 0.02
BATTERY_V = 11.0
# What the outdoor recording's throttle lacks, and by how much its velocity lags behind its commands and attitude.
OUTDOOR_THROTTLE_RAW, OUTDOOR_LEAD_ROWS = 592.0, 25


def _rotation_signals(rows: Floats) -> dict[str, Floats]:
    """Convert rows of the public rotation recording to signals by name, in SI."""
    return {
        "pitch": rows[:, 1],
        "roll": rows[:, 2],
        "yaw": rows[:, 3],
        "pitch_rate": rows[:, 4],
        "roll_rate": rows[:, 5],
        "yaw_rate": rows[:, 6],
        "pitch_command": rows[:, 7] * PITCH_ROLL_RAD_PER_RAW,
        "roll_command": rows[:, 8] * PITCH_ROLL_RAD_PER_RAW,
        "yaw_rate_command": rows[:, 10] * YAW_RATE_RAD_S_PER_RAW,
    }


def _thrust_signals(rows: Floats) -> dict[str, Floats]:
    """Convert rows of the public thrust recording to signals by name, in SI."""
    return {"throttle": rows[:, 1] / THROTTLE_RAW_PER_UNIT, "thrust": rows[:, 2], "battery": rows[:, 3]}


def _outdoor_signals(rows: Floats) -> dict[str, Floats]:
    """Convert rows of the public outdoor recording to signals by name, in SI."""
    names = ("roll", "pitch", "yaw", "velocity_north", "velocity_east", "velocity_down")
    rates = ("roll_rate", "pitch_rate", "yaw_rate")
    return {
        **dict(zip((*names, *rates), rows.T[3:12], strict=True)),
        "pitch_command": rows[:, 18] * PITCH_ROLL_RAD_PER_RAW,
        "roll_command": rows[:, 19] * PITCH_ROLL_RAD_PER_RAW,
        "throttle": (rows[:, 20] + OUTDOOR_THROTTLE_RAW) / THROTTLE_RAW_PER_UNIT,
        "yaw_rate_command": rows[:, 21] * YAW_RATE_RAD_S_PER_RAW,
        "battery": np.full(len(rows), BATTERY_V),
    }


LAYOUTS: dict[int, tuple[str, Callable[[Floats], dict[str, Floats]]]] = {
    4: ("thrust rig", _thrust_signals),
    11: ("rotation rig", _rotation_signals),
    22: ("outdoor flight", _outdoor_signals),
}


def read_recording(path: Path) -> FlightLog:
    """Read a table of numbers in the layout of a public recording, identified by its number of columns.

    The state after a row's command belongs to that row, so the commands are moved one row back: here a command acts
    from its row to the next.

    Raises:
        LogError: not numbers only, or another number of columns.
    """
    try:
        # Not by its name, by which NumPy would unpack it.
        with open_text(path) as stream:
            rows = np.loadtxt(stream, delimiter=",", ndmin=2)
    except ValueError as error:
        raise LogError(f"{path}: neither a header with names nor numbers only: {error}") from None
    if rows.shape[1] not in LAYOUTS:
        known = ", ".join(f"{columns} ({name})" for columns, (name, _) in LAYOUTS.items())
        raise LogError(
            f"{path}: numbers without a header, {rows.shape[1]} columns; known without a header: {known};"
            " any other table needs a first line with names and units, such as 'time [s],roll [deg]'"
        )
    name, columns = LAYOUTS[rows.shape[1]]
    # The clocks of the rigs are rounded, and the flight has none: all rows are 20 ms apart.
    time = DT * np.arange(len(rows), dtype=np.float64)
    signals = columns(rows)
    for signal in [s for s in signals if s.endswith("_command") or s == "throttle"]:
        signals[signal] = np.append(signals[signal][1:], signals[signal][-1])
    notes = [f"public recording, layout '{name}'"]
    if name == "outdoor flight":
        for signal in [s for s in signals if s.startswith("velocity_")]:
            signals[signal] = signals[signal][OUTDOOR_LEAD_ROWS:]
        notes.append(
            f"velocity moved {OUTDOOR_LEAD_ROWS * DT:g} s back: it lags behind commands and attitude by so much"
        )
        notes.append(f"throttle + {OUTDOOR_THROTTLE_RAW:g} raw and battery {BATTERY_V:g} V, which the recording lacks")
    return prepare(path, name, {key: Track(time[: len(values)], values) for key, values in signals.items()}, notes, DT)
