"""CSV files with a header that users name, row by row; every fault is one line with the file, line and column."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from qrsim.errors import UsageError, did_you_mean_file
from qrsim.files.csv_rows import CsvRows
from qrsim.files.user_files import open_text


class CsvFile:
    """The rows of an open CSV file.

    Args:
        path: of the file, for messages.
        rows: of the file.

    Attributes:
        header: names of the columns.
    """

    def __init__(self, path: Path, rows: CsvRows):
        self._path, self._rows = path, rows
        self.header = rows.header

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the fields of each row, as many as the header has."""
        for fields in self._rows:
            if len(fields) != len(self.header):
                self.fail(f"{len(fields)} fields, the header has {len(self.header)}")
            yield fields

    def number(self, name: str, field: str, hint: str = "") -> float:
        """Return the text of a field as a finite number; raises UsageError, with column ``name`` and ``hint``, for
        others."""
        text = field.strip()
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or "_" in text:
            self.fail(f"column '{name}': {text[:40]!r} is not a finite number{hint}")
        return number

    def fail(self, problem: str) -> NoReturn:
        """Raise UsageError with the file's path and the number of the present line in front of ``problem``."""
        raise UsageError(f"{self._path}: line {self._rows.line_num}: {problem}")


@contextmanager
def open_csv(path: Path, most_bytes: int) -> Iterator[CsvFile]:
    """Open a CSV file of at most ``most_bytes`` [bytes] while the context lasts, and yield its reader.

    Raises:
        UsageError: it cannot be read, or is no CSV, also while its rows are read.
    """
    rows: CsvRows | None = None
    try:
        with open_text(path, most_bytes) as file:
            rows = CsvRows(file)
            yield CsvFile(path, rows)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}{did_you_mean_file(path)}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: byte 0x{error.object[error.start]:02x} is not UTF-8 text") from error
    except csv.Error as error:
        raise UsageError(f"{path}: line {rows.line_num if rows else 1}: not CSV: {error}") from error
