"""Rows of CSV files, as programs of every country write them: the reader of all CSV files with a header."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from itertools import chain

# Tabs and semicolons are what spreadsheets separate fields by where the decimal mark is a comma.
OTHER_DELIMITERS = (";", "\t")
_QUOTED = re.compile(r'"[^"]*"')
_WITH_UNIT = re.compile(r"\s*(\w+)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+(?:[eE][+-]?\d+)?\s*", re.ASCII)


def delimiter_of(header: str) -> str:
    """Return the delimiter of a CSV file by its header: a comma, or the semicolon or tab if more frequent."""
    bare = _QUOTED.sub("", header)
    return max((",", *OTHER_DELIMITERS), key=bare.count)


def name_and_unit(column: str) -> tuple[str, str | None]:
    """Split a column name such as ``roll [deg]`` or ``roll (deg)`` into name and unit; the unit is None without one."""
    found = _WITH_UNIT.fullmatch(column)
    return (found[1], found[2]) if found else (column, None)


class CsvRows:
    """The rows under the header of a CSV file, as text.

    Fields are separated by commas, semicolons or tabs. Between semicolons or tabs a decimal comma becomes a point.

    Attributes:
        header: names of the columns, without spaces around them.
        delimiter: what separates the fields.
    """

    def __init__(self, lines: Iterable[str], strict: bool = True):
        """Read the header.

        Args:
            lines: of the file, with their ends.
            strict: whether a stray quote is an error.

        Raises:
            csv.Error: there is no header, or it is no CSV.
        """
        found = iter(lines)
        first = next(found, "")
        if not first.strip():
            raise csv.Error(
                "the file is empty" if not first else "its first line is empty; expected the names of columns"
            )
        self.delimiter = delimiter_of(first)
        self._reader = csv.reader(chain([first], found), delimiter=self.delimiter, strict=strict)
        self.header = [name.strip() for name in next(self._reader, [])]

    @property
    def line_num(self) -> int:
        """Number, from 1, of the line read last."""
        return self._reader.line_num

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the fields of each row; raises ``csv.Error``."""
        for fields in self._reader:
            yield fields if self.delimiter == "," else [_with_point(field) for field in fields]


def _with_point(field: str) -> str:
    """Replace the decimal comma of a number by a point; other texts are returned unchanged."""
    return field.replace(",", ".") if _DECIMAL_COMMA.fullmatch(field) else field
