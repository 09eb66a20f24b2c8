"""Plain CSV: a header of names with units, one row per time."""

from __future__ import annotations

import array
import csv
import math
from pathlib import Path

import numpy as np

from qrsim.errors import LogError, did_you_mean
from qrsim.files.csv_rows import CsvRows, name_and_unit
from qrsim.files.user_files import open_text
from qrsim.models.vehicles.quadrotor import PITCH_ROLL_RAD_PER_RAW, THROTTLE_RAW_PER_UNIT, YAW_RATE_RAD_S_PER_RAW
from qrsim.studies.flight_logs.preparing import prepare
from qrsim.studies.flight_logs.signals import SIGNALS, FlightLog, Floats, Track

_DEG = math.pi / 180.0
# Factor to SI of each unit that a column may be in, by the SI unit.
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "rad": {"rad": 1.0, "deg": _DEG, "cdeg": 0.01 * _DEG},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3},
    "m/s": {"m/s": 1.0, "cm/s": 0.01, "km/h": 1 / 3.6, "ft/s": 0.3048, "kn": 1852.0 / 3600.0},
    "N": {"N": 1.0, "mN": 1e-3, "kgf": 9.80665, "gf": 9.80665e-3},
    "1": {"1": 1.0, "%": 0.01},
    "V": {"V": 1.0, "mV": 1e-3},
}
# The integers that the radio of the published vehicle sends.
RAW = {
    "roll_command": PITCH_ROLL_RAD_PER_RAW,
    "pitch_command": PITCH_ROLL_RAD_PER_RAW,
    "yaw_rate_command": YAW_RATE_RAD_S_PER_RAW,
    "throttle": 1.0 / THROTTLE_RAW_PER_UNIT,
}


def read_table(path: Path) -> FlightLog:
    """Read a flight log from a CSV with column names such as 'roll [deg]'; ignored columns are noted.

    Raises:
        LogError: no time, a column without a unit or with an unknown one, twice the same, a row of wrong length.
    """
    with open_text(path, errors="replace") as stream:
        reader: CsvRows | None = None
        try:
            reader = CsvRows(stream, strict=False)
            wanted, ignored = _parsed_header(path, reader.header)
            values = _parsed_columns(path, reader, wanted)
        except csv.Error as error:
            raise LogError(f"{path}: line {reader.line_num if reader else 1}: not CSV: {error}") from None
    time = values.pop("time")
    notes = [f"columns left out: {', '.join(ignored)}"] if ignored else []
    return prepare(path, "CSV", {name: Track(time, column) for name, column in values.items()}, notes)


def _parsed_header(path: Path, header: list[str]) -> tuple[dict[str, tuple[int, float]], list[str]]:
    """Parse a CSV header: return signal name -> (column index, factor to SI), and the names of other columns."""
    wanted: dict[str, tuple[int, float]] = {}
    ignored: list[str] = []
    known = ["time", *SIGNALS]
    for place, text in enumerate(header):
        name, given = name_and_unit(text)
        if name not in known:
            ignored.append(text)
            continue
        unit = "s" if name == "time" else SIGNALS[name].unit
        factors = UNITS[unit] | ({"raw": RAW[name]} if name in RAW else {})
        if given is None:
            raise LogError(
                f"{path}: line 1: '{name}' has no unit; write '{name} [{unit}]', or one of {', '.join(factors)}"
            )
        if given not in factors:
            raise LogError(f"{path}: line 1: '{text}': unknown unit{did_you_mean(given, factors)}")
        if name in wanted:
            raise LogError(f"{path}: line 1: '{name}' is there twice, columns {wanted[name][0] + 1} and {place + 1}")
        wanted[name] = (place, factors[given])
    if "time" not in wanted:
        raise LogError(f"{path}: line 1: no column 'time [s]'; there: {', '.join(header)}")
    if len(wanted) == 1:
        raise LogError(
            f"{path}: line 1: no column of a vehicle; there: {', '.join(ignored)}; known: {', '.join(SIGNALS)}"
        )
    return wanted, ignored


def _parsed_columns(path: Path, reader: CsvRows, wanted: dict[str, tuple[int, float]]) -> dict[str, Floats]:
    """Read the wanted columns of a CSV in SI; an empty field and 'nan' are NaN."""
    header = reader.header
    table = {name: array.array("d") for name in wanted}
    for fields in reader:
        if not fields:
            continue
        line = reader.line_num
        if len(fields) != len(header):
            raise LogError(f"{path}: line {line}: {len(fields)} fields, the header has {len(header)}")
        for name, (place, factor) in wanted.items():
            text = fields[place].strip()
            try:
                table[name].append(factor * float(text) if text else math.nan)
            except ValueError:
                raise LogError(
                    f"{path}: line {line}: column '{header[place]}': '{text[:40]}' is not a number"
                ) from None
    return {name: np.array(column) for name, column in table.items()}
