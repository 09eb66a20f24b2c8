"""ArduPilot DataFlash, by pymavlink's DFReader: messages ATT, CTUN, RATE, BAT and XKF1."""

from __future__ import annotations

import contextlib
import io
import math
import os
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from qrsim import extras
from qrsim.errors import LogError, shortened
from qrsim.studies.flight_logs.preparing import prepare
from qrsim.studies.flight_logs.signals import FlightLog, Floats, Track

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
COLUMNS = {kind: [field for _, of, field, _ in FIELDS if of == kind] for _, kind, _, _ in FIELDS}
MESSAGES = tuple(COLUMNS)
# Fields with the number of a battery or of a core of the estimator.
_INSTANCES = ("C", "I", "Inst", "Instance")
# The clock counts from the boot: going back by more than this [s] is another boot. Medians of so many messages before
# and after decide, because a damaged message has any time.
_BACK_S, _MEDIAN_OF = 1.0, 21
# Instances with nearly as many usable messages as the fullest one are equally good, and the lowest of them is read.
_NEARLY = 0.9


def read_dataflash(path: Path, boot: int | None = None) -> FlightLog:
    """Read an ArduPilot .bin log; ``boot`` selects one of several boots, None the one with most messages.

    Of several batteries or cores of the estimator one is read; the notes say which, and which boot.

    Args:
        path: of the file.
        boot: number of the boot in the file, from 1; None: the one with the most messages.

    Raises:
        LogError: no DataFlash log, none of the messages, or no such boot.
        RunError: pymavlink is not installed.
    """
    reader = extras.load("identify", "reading a DataFlash log", "pymavlink.DFReader")
    said = io.StringIO()
    messages = _Messages()
    try:
        # The library prints its complaints, and its part in C past Python.
        with _no_standard_error(), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            log = reader.DFReader_binary(str(path))
            while (message := log.recv_match(type=list(MESSAGES))) is not None:
                messages.take(message)
    except Exception as error:  # the library raises whatever its parsing runs into
        raise LogError(f"{path}: a DataFlash log that cannot be read: {error or type(error).__name__}") from None
    if not messages.times:
        raise LogError(f"{path}: none of the messages {', '.join(MESSAGES)}")
    tracks, notes = messages.tracks(path, boot)
    lines = [line for line in dict.fromkeys(said.getvalue().splitlines()) if line.strip()]
    notes += [f"the reader says: {line}" for line in lines[:MOST_COMPLAINTS]]
    if len(lines) > MOST_COMPLAINTS:
        notes.append(f"the reader says {len(lines) - MOST_COMPLAINTS} more of the kind: the file is damaged")
    return prepare(path, "ArduPilot DataFlash", tracks, notes)


@contextlib.contextmanager
def _no_standard_error() -> Iterator[None]:
    """Context manager: discard everything written to the process's standard error."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class _Messages:
    """The messages of a log in the order of the file, by type and by instance."""

    def __init__(self) -> None:
        self.times = array("d")
        # By type and instance: the numbers of its messages in ``times``, and their fields one after the other.
        self.rows: dict[tuple[str, int], tuple[array[int], array[float]]] = {}

    def take(self, message: Any) -> None:
        """Append one message of the log; fields that it lacks are NaN."""
        kind = message.get_type()
        there = message.get_fieldnames()
        instance = next((getattr(message, name) for name in _INSTANCES if name in there), None)
        stamp = message.TimeUS * 1e-6
        fields = [float(getattr(message, field)) if field in there else math.nan for field in COLUMNS[kind]]
        numbers, values = self.rows.setdefault((kind, int(instance or 0)), (array("q"), array("d")))
        numbers.append(len(self.times))
        values.extend(fields)
        self.times.append(stamp)

    def tracks(self, path: Path, boot: int | None) -> tuple[dict[str, Track], list[str]]:
        """Return signal name -> track of one boot in SI, from one instance of each sensor, and notes on the choice."""
        times: Floats = np.array(self.times)
        notes: list[str] = []
        first, last = _boot_range(path, times, boot, notes)
        there: dict[str, dict[int, tuple[Floats, Floats]]] = {}
        for (kind, instance), (numbers, values) in self.rows.items():
            begin, end = np.searchsorted(numbers, (first, last))
            if begin < end:
                table = np.array(values).reshape(len(numbers), -1)[begin:end]
                there.setdefault(kind, {})[instance] = times[numbers[begin:end]], table
        tracks = {}
        for kind, instances in there.items():
            number = _best_instance({each: table for each, (_, table) in instances.items()})
            if len(instances) > 1 or number:
                notes.append(
                    f"{kind}: instance {number} is read, of {', '.join(map(str, sorted(instances)))} in the log"
                )
            when, table = instances[number]
            for name, of, field, factor in FIELDS:
                column = table[:, COLUMNS[kind].index(field)] if of == kind else np.array([math.nan])
                if np.isfinite(column).any():
                    tracks[name] = Track(when, factor * column)
        return tracks, notes


def _boot_range(path: Path, times: Floats, boot: int | None, notes: list[str]) -> tuple[int, int]:
    """Return the range of messages (begin, end) of the given boot, or of the boot with the most messages."""
    starts = [0]
    for i in np.flatnonzero(np.diff(times) < -_BACK_S) + 1:
        before, after = times[max(starts[-1], i - _MEDIAN_OF) : i], times[i : i + _MEDIAN_OF]
        if np.median(after) < np.median(before) - _BACK_S:
            starts.append(int(i))
    ends = [*starts[1:], len(times)]
    spans = [f"{times[a]:.2f} to {times[b - 1]:.2f} s" for a, b in zip(starts, ends, strict=True)]
    if boot is not None and not 1 <= boot <= len(starts):
        known = ", ".join(f"{number} ({span})" for number, span in enumerate(spans, 1))
        raise LogError(f"{path}: has no boot {boot}; known: {shortened(known, 200)}")
    which = int(np.argmax(np.subtract(ends, starts))) if boot is None else boot - 1
    if len(starts) > 1:
        why = "the one with the most messages (--boot N reads another)" if boot is None else "as asked"
        notes.append(f"boot {which + 1} of {len(starts)} is read, {spans[which]}, {why}")
    return starts[which], ends[which]


def _best_instance(instances: dict[int, Floats]) -> int:
    """Return the number of the first sensor instance with nearly the most usable messages; zeros do not count."""
    usable = {
        number: int((np.isfinite(table) & (table != 0.0)).any(axis=1).sum()) for number, table in instances.items()
    }
    return min(number for number, count in usable.items() if count >= _NEARLY * max(usable.values()))
