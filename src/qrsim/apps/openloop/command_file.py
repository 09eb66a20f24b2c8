"""Reading a CSV file of commands.

A plain file goes through pyarrow's reader. Whatever that does not take is read again by the slow, strict reader
here, which decides what is allowed and says where a fault is.
"""

from __future__ import annotations

import csv
import io
import math
import re
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.files.csv_rows import CsvRows
from qrsim.files.user_files import read_bytes

Units = Literal["raw", "si"]
COLUMNS = ("pitch", "roll", "throttle", "yaw", "battery")
# Other names of a column, by units.
ALIASES: dict[Units, dict[str, str]] = {"raw": {}, "si": {"yaw_rate": "yaw"}}

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True)
class CommandTable:
    """The commands of a file.

    Attributes:
        source: the file.
        values: (T, 5) finite numbers in the file's units, in the order of COLUMNS.
        names: the file's own names of these columns.
        lines: (T,) the line of each row in the file, counted from 1.
        ignored: names of the columns that are not commands.
    """

    source: Path
    values: NumpyArray
    names: tuple[str, ...]
    lines: NumpyArray
    ignored: tuple[str, ...]


@dataclass(frozen=True)
class _Header:
    names: list[str]
    wanted: list[int]
    delimiter: str


def read_commands(path: Path, units: Units) -> CommandTable:
    """Read times and commands from a CSV file with a header; columns are found by name, and others are ignored.

    Raises:
        UsageError: no such file, not CSV, a missing column, a field that is not a finite number; names the line.
    """
    content = _read_bytes(path)
    header = _read_header(path, content, units)
    values = None if b'"' in content else _read_fast(content, header)
    if values is None:
        values, lines = _read_slow(path, content, header)
    else:
        lines = np.arange(2, 2 + len(values))
    names = tuple(header.names[i] for i in header.wanted)
    ignored = tuple(name for i, name in enumerate(header.names) if i not in header.wanted)
    return CommandTable(path, values, names, lines, ignored)


def _read_bytes(path: Path) -> bytes:
    """Return a file's bytes without a byte-order mark; raises UsageError if it is empty or unreadable."""
    try:
        content = read_bytes(path)
    except FileNotFoundError as error:
        raise UsageError(f"{path}: no such file{_nearest_file(path)}") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    content = content.removeprefix(b"\xef\xbb\xbf").rstrip()
    if not content:
        raise UsageError(f"{path}: the file is empty; expected a header with the columns {', '.join(COLUMNS)}")
    return content


def _nearest_file(path: Path) -> str:
    """Return a hint at a CSV file with a similar name in the same folder; "" without one."""
    hint = did_you_mean(path.name, sorted(found.name for found in path.parent.glob("*.csv")))
    return hint if hint.startswith("; did you mean") else ""


def _read_header(path: Path, content: bytes, units: Units) -> _Header:
    """Return the names, positions and delimiter of the columns in the header line; raises UsageError if one is
    missing."""
    first_line = _decode(path, content.partition(b"\n")[0].rstrip(b"\r"))
    try:
        rows = CsvRows([first_line])
        names = rows.header
    except csv.Error as error:
        raise UsageError(f"{path}: line 1: not CSV: {error}") from error
    if any(_NUMBER.fullmatch(name) for name in names):
        _fail(path, 1, f"numbers where the names of the columns should be; expected {', '.join(COLUMNS)}")
    aliases = ALIASES[units]
    meanings = [aliases.get(name, name) for name in names]
    wanted = []
    for column in COLUMNS:
        places = [i for i, meaning in enumerate(meanings) if meaning == column]
        if not places:
            _fail(path, 1, f"no column '{column}'{_missing_column_hint(column, names, units)}")
        if len(places) > 1:
            given = " and ".join(f"'{names[i]}' (column {i + 1})" for i in places)
            _fail(path, 1, f"the column '{column}' is there more than once: {given}")
        wanted.append(places[0])
    return _Header(names, wanted, rows.delimiter)


def _missing_column_hint(column: str, names: list[str], units: Units) -> str:
    """Return a hint on a missing column: wrong delimiter, a column in other units, or the nearest name."""
    if len(names) == 1 and re.search(r"[| ]", names[0]):
        return f"; the fields must be separated by commas, semicolons or tabs, found {_shown(names[0])}"
    if units == "raw" and column in ALIASES["si"].values() and set(names) & set(ALIASES["si"]):
        return "; 'yaw_rate' is SI: '--units si' reads it"
    return did_you_mean(column, [name for name in names if name and name not in COLUMNS])


def _read_fast(content: bytes, header: _Header) -> NumpyArray | None:
    """Return the values (T, 5) of a regular CSV file, read fast; None if anything in it is irregular."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    places = [str(i) for i in range(len(header.names))]
    wanted = [places[i] for i in header.wanted]
    try:
        table = arrow_csv.read_csv(
            pa.BufferReader(content),
            read_options=arrow_csv.ReadOptions(column_names=places, skip_rows=1),
            parse_options=arrow_csv.ParseOptions(
                delimiter=header.delimiter, quote_char=False, ignore_empty_lines=False
            ),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64()), null_values=[]
            ),
        )
    except pa.ArrowException:
        return None
    values = np.column_stack([table[name].to_numpy() for name in wanted])
    return values if len(values) and np.isfinite(values).all() else None


def _read_slow(path: Path, content: bytes, header: _Header) -> tuple[NumpyArray, NumpyArray]:
    """Return the values (T, 5) and line numbers (T,), read row by row; raises UsageError at the first error."""
    reader = CsvRows(io.StringIO(_decode(path, content), newline=""))
    # Flat arrays: a million small lists would keep the garbage collector busy.
    numbers, lines = array("d"), array("q")
    line = 1
    try:
        line = reader.line_num + 1
        for fields in reader:
            numbers.extend(_numbers(path, line, fields, header))
            lines.append(line)
            line = reader.line_num + 1
    except csv.Error as error:
        raise UsageError(f"{path}: line {line}: not CSV: {error}") from error
    if not lines:
        raise UsageError(f"{path}: no rows under the header")
    return np.array(numbers).reshape(-1, len(COLUMNS)), np.array(lines)


def _numbers(path: Path, line: int, fields: list[str], header: _Header) -> list[float]:
    """Return the five numbers of one row; raises UsageError, naming the line, for others."""
    if not fields:
        _fail(path, line, "the line is empty")
    if len(fields) != len(header.names):
        plural = "" if len(fields) == 1 else "s"
        between = "" if header.delimiter == "," else f", separated by {_shown(header.delimiter)}"
        _fail(path, line, f"{len(fields)} field{plural}, the header has {len(header.names)}{between}")
    numbers = []
    for place in header.wanted:
        text = fields[place].strip()
        number = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(number):
            _fail(path, line, f"column '{header.names[place]}' (column {place + 1}): {_number_problem(text)}")
        numbers.append(number)
    return numbers


def _number_problem(text: str) -> str:
    """Return why a field is not a finite number, for a message."""
    if not text:
        return "the field is empty"
    if _NUMBER.fullmatch(text):
        return f"{_shown(text)} is too large"
    finite = "finite " if _NOT_FINITE.fullmatch(text) else ""
    return f"{_shown(text)} is not a {finite}number"


def _decode(path: Path, content: bytes) -> str:
    """Decode a file's bytes as UTF-8; raises UsageError with the line of the first invalid byte."""
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise UsageError(f"{path}: line {line}: byte 0x{content[error.start]:02x} is not UTF-8 text") from error


def _shown(text: str) -> str:
    """Return a text in quotes, cut to 40 characters, for a message."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _fail(path: Path, line: int, problem: str) -> NoReturn:
    """Raise UsageError about a file: its path, line and the problem."""
    raise UsageError(f"{path}: line {line}: {problem}")
