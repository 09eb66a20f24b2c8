"""Tables of numbers over time in CSV files: columns by name, times that increase, no gaps."""

from __future__ import annotations

import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from qrsim.errors import UsageError, nearest
from qrsim.files.csv_file import CsvFile, open_csv
from qrsim.files.csv_rows import name_and_unit
from qrsim.files.user_files import LARGEST_TABLE

TIME = "time"
HINTS = {TIME: "; give seconds since the start"}
# A row every simulation step at the smallest step; in single precision rows much closer would coincide.
SHORTEST_INTERVAL_S = 1e-4
# Whole seconds are kept as int32.
LARGEST_TIME_S = 2e9


def read_series(
    path: Path,
    columns: Mapping[str, str],
    max_gap: float,
    optional: Mapping[str, str] = MappingProxyType({}),
    instead: Mapping[str, str] = MappingProxyType({}),
) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[np.float64]]]:
    """Read times (K,) [s] and columns, name -> (K,), from a CSV file with K >= 2 rows, at most ``max_gap`` [s] apart.

    Columns are found by name, alone or with its unit: ``north`` or ``north [m/s]``. Others are ignored.

    Args:
        path: the file.
        columns: required names other than ``time``, with their units.
        max_gap: longest interval allowed between two rows [s].
        optional: names that it may have, with their units.
        instead: required names, with their units, of a file that has one of them and none of ``columns``.

    Raises:
        UsageError: no such file, not CSV, a missing column, another unit, a field that is no finite number, times that
            do not increase, a gap; names the line and the column.
    """
    rows, before = array.array("d"), None
    with open_csv(path, LARGEST_TABLE) as file:
        header = _without_units(file, {TIME: "s", **columns, **optional, **instead})
        expected = " or ".join(", ".join([TIME, *names]) for names in (columns, instead) if names)
        if instead.keys() & set(header) and not columns.keys() & set(header):
            columns = instead
        names = [TIME, *columns, *(name for name in optional if name in header)]
        places = _places(file, header, names, expected)
        for fields in file:
            row = [file.number(name, fields[place], HINTS.get(name, "")) for name, place in places.items()]
            _check_time(file, before, row[0], max_gap)
            rows.extend(row)
            before = row[0]
    table = np.array(rows).reshape(-1, len(names))
    if len(table) < 2:
        raise UsageError(f"{path}: {len(table)} rows under the header; at least 2 are needed to interpolate")
    return table[:, 0], {name: table[:, i] for i, name in enumerate(names) if i}


def check_covers(what: str, times: npt.NDArray[np.float64], duration: float) -> None:
    """Raise UsageError, beginning with ``what``, if a series does not last from 0 s to ``duration`` [s].

    Args:
        what: it is, for the message.
        times: of its rows (K,) [s].
        duration: length of the run [s].

    Raises:
        UsageError: it begins later, or ends before.
    """
    if times[0] > 0.0 or times[-1] < duration:
        raise UsageError(
            f"{what} goes from {times[0]:g} s to {times[-1]:g} s, which does not cover the run, 0 s to {duration:g} s"
        )


def _without_units(file: CsvFile, units: Mapping[str, str]) -> list[str]:
    """Return the header's names with ``[unit]`` removed from the columns in ``units``; raises UsageError for other
    units."""
    names = []
    for written in file.header:
        name, unit = name_and_unit(written)
        if unit is None or name not in units:
            names.append(written)
        elif unit == units[name]:
            names.append(name)
        else:
            file.fail(f"column '{name}' is in {unit}; expected {units[name]}")
    return names


def _places(file: CsvFile, header: list[str], names: Sequence[str], expected: str) -> dict[str, int]:
    """Return name -> index in the header; raises UsageError, with the ``expected`` columns, for missing or repeated
    ones."""
    for name in names:
        if name not in header:
            match = nearest(name, [other for other in header if other])
            hint = f"did you mean '{match}'?" if match else f"found {', '.join(header)[:80]}; expected {expected}"
            file.fail(f"no column '{name}'; {hint}")
        if header.count(name) > 1:
            file.fail(f"the column '{name}' is there {header.count(name)} times")
    return {name: header.index(name) for name in names}


def _check_time(file: CsvFile, before: float | None, time: float, max_gap: float) -> None:
    """Raise UsageError unless a row's time is later than that of the row before, by at most ``max_gap`` [s]."""
    if abs(time) > LARGEST_TIME_S:
        file.fail(f"column 'time': {time:g} s is beyond {LARGEST_TIME_S:g} s; give seconds since the start")
    if before is None:
        return
    if time <= before:
        file.fail(f"column 'time': {time:g} s does not come after {before:g} s; times must increase")
    if time - before < SHORTEST_INTERVAL_S:
        file.fail(f"column 'time': {time:.9g} s follows within {SHORTEST_INTERVAL_S:g} s of {before:.9g} s")
    if time - before > max_gap:
        file.fail(f"column 'time': a gap of {time - before:g} s after {before:g} s; allowed: {max_gap:g} s (max_gap)")
