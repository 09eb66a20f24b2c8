"""ArduPilot DataFlash, by pymavlink's DFReader: messages ATT, CTUN, RATE, BAT and XKF1."""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qrsim import extras
from qrsim.errors import LogError
from qrsim.flight_logs.preparing import prepare
from qrsim.flight_logs.signals import FlightLog, Track

_DEG = math.pi / 180.0
MOST_COMPLAINTS = 3
# Signal, message, field, factor to SI.
FIELDS: tuple[tuple[str, str, str, float], ...] = (
    ("roll", "ATT", "Roll", _DEG),
    ("pitch", "ATT", "Pitch", _DEG),
    ("yaw", "ATT", "Yaw", _DEG),
    ("roll_command", "ATT", "DesRoll", _DEG),
    ("pitch_command", "ATT", "DesPitch", _DEG),
    ("roll_rate", "RATE", "R", _DEG),
    ("pitch_rate", "RATE", "P", _DEG),
    ("yaw_rate", "RATE", "Y", _DEG),
    ("yaw_rate_command", "RATE", "YDes", _DEG),
    ("throttle", "CTUN", "ThO", 1.0),
    ("battery", "BAT", "Volt", 1.0),
    ("velocity_north", "XKF1", "VN", 1.0),
    ("velocity_east", "XKF1", "VE", 1.0),
    ("velocity_down", "XKF1", "VD", 1.0),
)
MESSAGES = tuple(dict.fromkeys(message for _, message, _, _ in FIELDS))
# Messages of several batteries or estimators: the first counts.
_INSTANCES = ("C", "I", "Inst", "Instance")


def read_dataflash(path: Path) -> FlightLog:
    """Read an ArduPilot .bin log.

    Raises:
        LogError: no DataFlash log, or none of the messages.
        RunError: pymavlink is not installed.
    """
    reader = extras.load("identify", "reading a DataFlash log", "pymavlink.DFReader")
    said = io.StringIO()
    times: dict[str, list[float]] = {}
    values: dict[str, list[float]] = {}
    try:
        # The library prints its complaints, and its part in C past Python.
        with _no_standard_error(), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            log = reader.DFReader_binary(str(path))
            while (message := log.recv_match(type=list(MESSAGES))) is not None:
                _take(message, times, values)
    except Exception as error:  # the library raises whatever its parsing runs into
        raise LogError(f"{path}: a DataFlash log that cannot be read: {error or type(error).__name__}") from None
    if not values:
        raise LogError(f"{path}: none of the messages {', '.join(MESSAGES)}")
    lines = [line for line in dict.fromkeys(said.getvalue().splitlines()) if line.strip()]
    notes = [f"the reader says: {line}" for line in lines[:MOST_COMPLAINTS]]
    if len(lines) > MOST_COMPLAINTS:
        notes.append(f"the reader says {len(lines) - MOST_COMPLAINTS} more of the kind: the file is damaged")
    tracks = {name: Track(np.array(times[name]), np.array(values[name])) for name in values}
    return prepare(path, "ArduPilot DataFlash", tracks, notes)


@contextlib.contextmanager
def _no_standard_error() -> Iterator[None]:
    """Let nothing of this process reach its standard error, whatever writes it."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _take(message: Any, times: dict[str, list[float]], values: dict[str, list[float]]) -> None:
    """Append the signals of one message."""
    kind = message.get_type()
    there = message.get_fieldnames()
    if any(name in there and getattr(message, name) not in (0, None) for name in _INSTANCES):
        return
    for name, of, field, factor in FIELDS:
        if of == kind and field in there:
            times.setdefault(name, []).append(message.TimeUS * 1e-6)
            values.setdefault(name, []).append(factor * float(getattr(message, field)))
