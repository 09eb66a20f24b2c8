"""Readings of gyroscopes and accelerometers of a log, for what their noise is: PX4 ULog or CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from qrsim.errors import LogError, UsageError, did_you_mean, did_you_mean_file
from qrsim.files.csv_rows import CsvRows, name_and_unit
from qrsim.files.user_files import open_text
from qrsim.studies.flight_logs.signals import Floats
from qrsim.studies.flight_logs.ulog_messages import open_ulog

_G = 9.80665
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "gyroscope": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "mrad/s": 1e-3},
    "accelerometer": {"m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G},
}
KINDS = ("gyroscope", "accelerometer")
COLUMNS = ("time", *(f"{kind}_{axis}" for kind in KINDS for axis in "xyz"))
_ULOG = b"ULog\x01\x12\x35"
# Part of the readings that may be missing or late; beyond it there is no one rate.
UNEVEN = 0.05
# Fewest readings of a kind.
FEWEST = 100


@dataclass(frozen=True)
class Readings:
    """Readings of an inertial sensor.

    Attributes:
        period: [s] between them.
        values: by kind (T, 3), gyroscope [rad/s], accelerometer [m/s^2].
    """

    period: float
    values: Mapping[str, Floats]


def read_inertial(path: Path) -> Readings:
    """Read gyroscope and accelerometer from a PX4 ULog (``sensor_combined``), or a CSV with names and units.

    Raises:
        UsageError: no such file.
        LogError: it has neither, or no one rate.
        RunError: pyulog is not installed.
    """
    try:
        with path.open("rb") as stream:
            beginning = stream.read(len(_ULOG))
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file{did_you_mean_file(path)}") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    time, columns = _read_ulog(path) if beginning == _ULOG else _read_csv(path)
    return _uniform(path, time, columns)


def _read_ulog(path: Path) -> tuple[Floats, dict[str, Floats]]:
    """Return times (T,) [s] and columns by name of a ULog's topic sensor_combined; raises LogError."""
    log, _ = open_ulog(path, ["sensor_combined"])
    topic = next((each.data for each in log.data_list if each.name == "sensor_combined"), None)
    fields = {"gyroscope": "gyro_rad", "accelerometer": "accelerometer_m_s2"}
    names = {f"{kind}_{axis}": f"{field}[{i}]" for kind, field in fields.items() for i, axis in enumerate("xyz")}
    if topic is None or not {"timestamp", *names.values()} <= set(topic):
        raise LogError(f"{path}: no topic sensor_combined with timestamp, gyro_rad and accelerometer_m_s2")
    columns = {name: np.asarray(topic[field], np.float64) for name, field in names.items()}
    return np.asarray(topic["timestamp"], np.float64) * 1e-6, columns


def _read_csv(path: Path) -> tuple[Floats, dict[str, Floats]]:
    """Return times (T,) [s] and columns by name, in SI, of a CSV; raises LogError."""
    with open_text(path, errors="replace") as stream:
        try:
            rows = CsvRows(stream, strict=False)
            wanted = _columns_of(path, rows.header)
            values = [_parsed_row(path, rows.line_num, row, wanted) for row in rows if row]
        except csv.Error as error:
            raise LogError(f"{path}: not CSV: {error}") from None
    table = np.array(values, np.float64).reshape(len(values), len(wanted))
    columns = {name: factor * table[:, i] for i, (name, (_, factor)) in enumerate(wanted.items())}
    return columns.pop("time"), columns


def _columns_of(path: Path, header: list[str]) -> dict[str, tuple[int, float]]:
    """Return signal name -> (column index, factor to SI) from a CSV header; raises LogError for missing signals."""
    found: dict[str, tuple[int, float]] = {}
    for place, text in enumerate(header):
        name, unit = name_and_unit(text)
        if name not in COLUMNS:
            continue
        units = UNITS[name.partition("_")[0]]
        if unit not in units:
            first = f"'{name} [{next(iter(units))}]'"
            raise LogError(f"{path}: line 1: '{text}': expected a unit, {first} or one of {', '.join(units)}")
        found[name] = place, units[unit]
    kinds = [kind for kind in KINDS if any(name.startswith(kind) for name in found)]
    expected = ["time", *(f"{kind}_{axis}" for kind in kinds or KINDS for axis in "xyz")]
    missing = [name for name in expected if name not in found]
    if missing:
        names = [text.partition("[")[0].strip() for text in header]
        raise LogError(
            f"{path}: line 1: there is no column '{missing[0]}'{did_you_mean(missing[0], names)}; expected time and x, "
            "y and z of gyroscope, accelerometer or both, as 'gyroscope_x [rad/s]'"
        )
    return {name: found[name] for name in expected}


def _parsed_row(path: Path, line: int, row: list[str], wanted: dict[str, tuple[int, float]]) -> list[float]:
    """Parse the wanted columns of a CSV row to numbers in SI; raises LogError that names the line."""
    try:
        return [float(row[place]) for place, _ in wanted.values()]
    except (ValueError, IndexError):
        raise LogError(f"{path}: line {line}: expected a number in each of {', '.join(wanted)}") from None


def _uniform(path: Path, time: Floats, columns: dict[str, Floats]) -> Readings:
    """Resample gyroscope and accelerometer columns at a uniform rate.

    Raises:
        LogError: too few, not finite, or at no one rate.
    """
    if len(time) < FEWEST:
        raise LogError(f"{path}: {len(time)} readings; expected {FEWEST} and more")
    for name, values in {"time": time, **columns}.items():
        if not np.isfinite(values).all():
            raise LogError(f"{path}: {name}: reading {int(np.flatnonzero(~np.isfinite(values))[0]) + 1} is not finite")
    steps = np.diff(time)
    period = float(np.median(steps))
    late = int(np.sum(np.abs(steps - period) > 0.5 * period))
    if not period > 0.0 or late > UNEVEN * len(steps):
        raise LogError(
            f"{path}: {late} of {len(steps)} steps of time are off their median of {1e3 * period:.3g} ms by half of it "
            "and more; the readings need one rate"
        )
    # The mean, because stamps are rounded; a few lost readings do not count.
    kinds = {kind: [f"{kind}_{axis}" for axis in "xyz"] for kind in KINDS if f"{kind}_x" in columns}
    found = {kind: np.stack([columns[name] for name in names], axis=1) for kind, names in kinds.items()}
    return Readings(float(np.mean(steps[np.abs(steps - period) <= 0.5 * period])), found)
