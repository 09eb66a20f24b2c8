"""Reads SP3 orbit files to a regular grid of epochs, without interpolation.

SP3-a is described by Spofford and Remondi (1994), SP3-c by Hilla (NGS, 2010) and SP3-d by Hilla (NGS, 2016). Times
are those of the epoch lines: the header's number of epochs and seconds of week are stale in trimmed products. The
satellites are those that have position lines; others that the header lists are remembered for a warning.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError, readable
from qrsim.files.user_files import LARGEST_TABLE, read_bytes
from qrsim.models.site import GPS_EPOCH, Float64, gps_minus_utc

VERSIONS = ("a", "c", "d")
# Letters of the satellite systems, the same in RINEX.
SYSTEMS = {
    "G": "GPS",
    "R": "GLONASS",
    "E": "Galileo",
    "C": "BeiDou",
    "J": "QZSS",
    "I": "NavIC",
    "S": "SBAS",
    "L": "LEO",
}

# GPS time minus a file's time system [s]; UTC and GLO have leap seconds, and SP3-a says CCC, which is GPS time.
_GPS_MINUS = {"GPS": 0.0, "GAL": 0.0, "QZS": 0.0, "IRN": 0.0, "TAI": -19.0, "BDT": 14.0, "CCC": 0.0}
_LEAPING = ("UTC", "GLO")
_MISSING_CLOCK_US = 999999.0
# Outside these radii [km] lies no navigation satellite, but a damaged or misread line.
_LEAST_RADIUS_KM, _LARGEST_RADIUS_KM = 6400.0, 100000.0
MOST_EPOCHS = 100_000
# Beyond the calendar's last day nothing can be added to a time.
_LATEST = datetime(9999, 1, 1, tzinfo=GPS_EPOCH.tzinfo)
_COORDINATES_END, _CLOCK_END, _MANOEUVRE = 46, 60, 78


@dataclass(frozen=True)
class Sp3File:
    """Content of an SP3 file, on a grid of evenly spaced epochs.

    Attributes:
        path: the file as it was asked for.
        version: a, c or d.
        satellites: S names such as G05, in alphabetical order.
        first_gps_seconds: time of the first epoch [GPS s].
        interval: spacing of the epochs, whole [s].
        positions_ecef: (E, S, 3) Earth-fixed [m], NaN where the file has none.
        clocks: (E, S) satellite clock minus the file's time [s], NaN where the file has none.
        manoeuvre: (E, S) bool, the satellite was moved since the epoch before.
        notes: what is unusual about the file as a whole, with line numbers, one sentence each.
        gaps: the same for single satellites, by name.
        unlocated: satellites of the header that have no position line, in alphabetical order.
        cut_off: what to say where no EOF line ends the file, "" where one does; also among the notes.
    """

    path: str
    version: str
    satellites: tuple[str, ...]
    first_gps_seconds: float
    interval: int
    positions_ecef: Float64
    clocks: Float64
    manoeuvre: npt.NDArray[np.bool_]
    notes: tuple[str, ...]
    gaps: dict[str, str]
    unlocated: tuple[str, ...]
    cut_off: str

    @property
    def gps_seconds(self) -> Float64:
        """Times (E,) of the file's E epochs [GPS s]."""
        return self.first_gps_seconds + self.interval * np.arange(len(self.clocks), dtype=np.float64)


class _Record(NamedTuple):
    line: int
    xyz_km: tuple[float, float, float]
    clock_us: float
    moved: bool


class _Epoch(NamedTuple):
    line: int
    gps_seconds: float
    records: dict[str, _Record]


class _Lines:
    """The lines of a file, and errors that name its path and a line."""

    def __init__(self, path: str):
        self.path = path
        with readable(path):
            data = read_bytes(path, LARGEST_TABLE)
        if data[:2] in (b"\x1f\x8b", b"\x1f\x9d", b"PK"):
            raise UsageError(f"{path}: is compressed; unpack it first")
        self.text = data.decode("latin-1").splitlines()

    def fail(self, line: int, words: str) -> NoReturn:
        """Raise UsageError with ``words``, file and line number in front."""
        raise UsageError(f"{self.path}, line {line}: {words}")

    def number(self, line: int, first: int, end: int, what: str) -> float:
        """Return the number in columns first + 1 to end of a line; raise UsageError, naming ``what``, if it is none."""
        words = self.text[line - 1][first:end]
        try:
            value = float(words)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.fail(line, f"{what} in columns {first + 1} to {end} is no number: '{words.strip()}'")
        return value


def read_sp3(path: str | Path) -> Sp3File:
    """Return the content (satellites, epochs, positions) of an SP3 file of version a, c or d.

    A position of zeros and a clock of 999999 us mean a missing value; a satellite without a line at an epoch has
    none there, and an epoch left out of the regular spacing has none of any satellite. Notes and gaps record these.

    Raises:
        UsageError: the file cannot be read, is of another version or kind, has a line that is cut off or damaged, has
            no or one epoch, or epochs that repeat, go back or are unevenly spaced; with the path and the line.
    """
    lines = _Lines(str(path))
    version = _version(lines)
    epochs, ended = _epochs(lines)
    if len(epochs) < 2:
        count = "one epoch, too few to interpolate" if epochs else "no epoch (a line that starts with '*')"
        lines.fail(max(1, len(lines.text)), f"the file ends after {count}")
    interval, places = _grid(lines, epochs)
    names = sorted({name for epoch in epochs for name in epoch.records})
    if not names:
        lines.fail(epochs[0].line, "no satellite has a position line")
    column = {name: i for i, name in enumerate(names)}
    shape = (places[-1] + 1, len(names))
    positions, clocks, moved = np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.zeros(shape, bool)
    for place, epoch in zip(places, epochs, strict=True):
        for name, found in epoch.records.items():
            at = place, column[name]
            if any(found.xyz_km):
                positions[at] = 1000.0 * np.array(found.xyz_km)
            if abs(found.clock_us) < _MISSING_CLOCK_US:
                clocks[at] = 1e-6 * found.clock_us
            moved[at] = found.moved
    cut_off = "" if ended else f"{path}: no EOF line; the file may be cut off after line {len(lines.text)}"
    notes = [cut_off] if cut_off else []
    notes += [
        f"{path}, line {after.line}: {high - low - 1} epochs are missing between this one and line {before.line}"
        for (before, after), (low, high) in zip(pairwise(epochs), pairwise(places), strict=True)
        if high - low > 1
    ]
    gaps = {name: note for name in names if (note := _gap(str(path), epochs, name))}
    first = epochs[0].gps_seconds
    unlocated = tuple(sorted(_header_satellites(lines) - set(names)))
    return Sp3File(
        str(path),
        version,
        tuple(names),
        first,
        interval,
        positions,
        clocks,
        moved,
        tuple(notes),
        gaps,
        unlocated,
        cut_off,
    )


def _version(lines: _Lines) -> str:
    """Return the version letter in the file's first line; raise UsageError for unsupported versions."""
    head = lines.text[0] if lines.text else ""
    if not head.startswith("#") or len(head) < 2:
        lines.fail(1, f"'{head[:20]}' is not the start of an SP3 file, which is '#c' or the like")
    if head[1] not in VERSIONS:
        lines.fail(1, f"SP3 version '{head[1]}' is not supported; supported: {', '.join(VERSIONS)}")
    return head[1]


def _epochs(lines: _Lines) -> tuple[list[_Epoch], bool]:
    """Return the epochs in the file's order, and whether an EOF line ends the file."""
    found: list[_Epoch] = []
    time_system = ""
    for line, text in enumerate(lines.text, 1):
        if text.startswith("EOF"):
            return found, True
        if text.startswith("%c"):
            time_system = time_system or _time_system(lines, line)
        elif text.startswith("*"):
            found.append(_Epoch(line, _epoch_time(lines, line, time_system or "GPS"), {}))
        elif text.startswith("P"):
            if not found:
                lines.fail(line, "a position line before the first epoch")
            records = found[-1].records
            name, position = _position(lines, line)
            if name in records:
                lines.fail(line, f"{name} has a position at this epoch already, in line {records[name].line}")
            records[name] = position
        elif text.strip() and not text.startswith(("#", "+", "%", "/*", "V", "EP", "EV")):
            lines.fail(line, f"'{text[:20].rstrip()}' is no SP3 record")
    return found, False


def _header_satellites(lines: _Lines) -> set[str]:
    """Return the satellites in the header's '+' lines: 17 to a line, in columns of three from the tenth on."""
    found = set()
    for text in lines.text:
        if text.startswith("*"):
            break
        if text.startswith("+ "):
            for entry in (text[i : i + 3].strip() for i in range(9, 60, 3)):
                letter, digits = (entry[:1], entry[1:]) if entry[:1] in SYSTEMS else ("G", entry)
                # Places that are not used hold 0.
                if digits.strip().isdecimal() and int(digits):
                    found.add(f"{letter}{int(digits):02}")
    return found


def _time_system(lines: _Lines, line: int) -> str:
    """Return the time system in columns 10 to 12 of header line ``line``, such as GPS; raise UsageError for others."""
    name = lines.text[line - 1][9:12].strip().upper() or "CCC"
    known = (*_GPS_MINUS, *_LEAPING)
    if name not in known:
        lines.fail(line, f"time system '{name}' is not known; known: {', '.join(known)}")
    return name


def _epoch_time(lines: _Lines, line: int, time_system: str) -> float:
    """Return the time [GPS s] of an epoch line, by its number and the file's time system."""
    words = lines.text[line - 1][1:].split()
    try:
        year, month, day, hour, minute = (int(word) for word in words[:5])
        (second,) = (float(word) for word in words[5:])
        midnight = datetime(year, month, day, tzinfo=GPS_EPOCH.tzinfo)
        fits = 0 <= hour <= 24 and 0 <= minute <= 60 and 0.0 <= second < 61.0 and GPS_EPOCH <= midnight < _LATEST
    except (ValueError, OverflowError):
        fits = False
    if not fits:
        lines.fail(line, f"'{lines.text[line - 1].strip()}' is no epoch; expected '*  YYYY MM DD hh mm ss.ssssssss'")
    seconds = (midnight - GPS_EPOCH).days * 86400.0 + hour * 3600.0 + minute * 60.0 + second
    if time_system in _LEAPING:
        return seconds + gps_minus_utc(midnight + timedelta(hours=hour, minutes=minute, seconds=second))
    return seconds + _GPS_MINUS[time_system]


def _position(lines: _Lines, line: int) -> tuple[str, _Record]:
    """Return satellite name, and position and clock, of a position line; raise UsageError for a damaged line."""
    text = lines.text[line - 1].rstrip()
    letter, digits = text[1:2].strip() or "G", text[2:4].strip()
    if letter not in SYSTEMS or not digits.isdecimal():
        lines.fail(line, f"'{text[1:4]}' is no satellite; expected a number after one of {', '.join(SYSTEMS)}")
    name = f"{letter}{int(digits):02}"
    if len(text) < _COORDINATES_END:
        lines.fail(line, f"the position of {name} is cut off at column {len(text)}; x, y, z take columns 5 to 46")
    x, y, z = (lines.number(line, 4 + 14 * i, 18 + 14 * i, f"{axis} of {name}") for i, axis in enumerate("xyz"))
    radius = math.hypot(x, y, z)
    if radius and not _LEAST_RADIUS_KM < radius < _LARGEST_RADIUS_KM:
        lines.fail(
            line,
            f"{name} is {radius:.6g} km from the Earth's centre; "
            f"expected {_LEAST_RADIUS_KM:.0f} to {_LARGEST_RADIUS_KM:.0f} km",
        )
    clock = math.inf
    if text[_COORDINATES_END:_CLOCK_END].strip():
        clock = lines.number(line, _COORDINATES_END, _CLOCK_END, f"clock of {name}")
    return name, _Record(line, (x, y, z), clock, text[_MANOEUVRE : _MANOEUVRE + 1] == "M")


def _grid(lines: _Lines, epochs: list[_Epoch]) -> tuple[int, list[int]]:
    """Return the epochs' spacing [s], and each one's index on an even grid; raise UsageError if not even."""
    for before, after in pairwise(epochs):
        if after.gps_seconds <= before.gps_seconds:
            which = "repeats" if after.gps_seconds == before.gps_seconds else "is before"
            lines.fail(after.line, f"epoch {gps_text(after.gps_seconds)} {which} that of line {before.line}")
    first = epochs[0].gps_seconds
    steps = Counter(round(after.gps_seconds - before.gps_seconds, 6) for before, after in pairwise(epochs))
    step = min(steps, key=lambda seconds: (-steps[seconds], seconds))
    if step != round(step):
        lines.fail(epochs[1].line, f"epochs are {step:g} s apart; expected a whole number of seconds")
    places = []
    for epoch in epochs:
        places.append(round((epoch.gps_seconds - first) / step))
        if places[-1] >= MOST_EPOCHS:
            lines.fail(
                epoch.line,
                f"epoch {gps_text(epoch.gps_seconds)} is {places[-1]} times {step:g} s, the spacing of the epochs, "
                f"after the first; allowed: {MOST_EPOCHS} epochs",
            )
        if abs(epoch.gps_seconds - first - places[-1] * step) > 1e-5:
            lines.fail(
                epoch.line,
                f"epoch {gps_text(epoch.gps_seconds)} is no multiple of {step:g} s, the spacing of the epochs, "
                f"after the first, {gps_text(first)}",
            )
    return round(step), places


def _gap(path: str, epochs: list[_Epoch], name: str) -> str:
    """Return a text that describes a satellite's missing data, "" if they are complete."""
    absent = [epoch for epoch in epochs if name not in epoch.records or not any(epoch.records[name].xyz_km)]
    moved = [epoch for epoch in epochs if name in epoch.records and epoch.records[name].moved]
    found = []
    for which, words in ((absent, "no position at"), (moved, "a manoeuvre before")):
        if which:
            line = which[0].records[name].line if name in which[0].records else which[0].line
            when = gps_text(which[0].gps_seconds)
            found.append(f"{words} {len(which)} of {len(epochs)} epochs, first {when}, line {line}")
    return f"{path}: {name} has {' and '.join(found)}" if found else ""


def gps_text(gps_seconds: float) -> str:
    """Return a GPS time [s] as text to the second, such as "2024-05-01 00:00:00 GPS"."""
    return f"{GPS_EPOCH + timedelta(seconds=round(gps_seconds)):%Y-%m-%d %H:%M:%S} GPS"
