"""The Parquet parts of one stream, read as one table."""

from __future__ import annotations

import bisect
import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from qrsim.errors import RunError, UsageError, did_you_mean, shortened
from qrsim.files.user_files import check_file
from qrsim.runs.layout import Column, column_of, part_name

# What pyarrow raises where bytes are not what they were; texts of the footer are decoded without care.
DAMAGES = (OSError, pa.ArrowException, ValueError, KeyError, TypeError, OverflowError, MemoryError)


def _first_line(error: BaseException) -> str:
    """Return the first line of an error's message, shortened."""
    words = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return shortened(str(words).partition("\n")[0], 300)


@dataclass
class StreamParts:
    """The parts of one stream as of the opening of the run.

    Attributes:
        stream: its name.
        folder: where the parts lie.
        found: numbers of the parts, ascending.
        count: how many parts run.json speaks of; a part that came after it was written is valid too.
        skip_damaged: leave damaged and missing parts out with a warning, instead of raising.
    """

    stream: str
    folder: Path
    found: list[int]
    count: int
    skip_damaged: bool

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """All columns of the stream: time, tick and vehicle first."""
        return tuple(column_of(item) for item in self._arrow_schema)

    def column(self, name: str) -> Column:
        """Return the description of one column by name. Raises UsageError for an unknown name."""
        for column in self.columns:
            if column.name == name:
                return column
        raise self.unknown(name)

    def unknown(self, name: str) -> UsageError:
        """Return the error for an unknown column name, with the nearest name or a vector's axes."""
        known = [column.name for column in self.columns]
        axes = [each for each in known if each.rpartition(".")[0] == name]
        hint = f"; its columns are {', '.join(axes)}" if axes else did_you_mean(str(name), known)
        return UsageError(f"stream '{self.stream}' has no column '{name}'{hint}")

    def table(self, names: Sequence[str] | None = None) -> pa.Table:
        """Read all rows of the stream with the named columns, in that order (None: all columns).

        Raises:
            UsageError: unknown column.
            RunError: a part is damaged or missing.
        """
        return pa.concat_tables(self.tables(names))

    def tables(self, names: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the tables of the stream's Parquet files in order, each read on demand; raises as ``table``."""
        chosen = [column.name for column in self.columns] if names is None else [self.column(n).name for n in names]
        return (self._read_part(number, self._arrow_schema, chosen) for number in self._usable)

    def tables_between(self, names: Sequence[str], start: float, end: float) -> Iterator[pa.Table]:
        """Yield whole Parquet files that have rows from time ``start`` to ``end`` [s]; raises as ``table``."""
        chosen = [self.column(name).name for name in names]
        # Parts follow each other in time, so only a few are opened.
        first = bisect.bisect_left(self._usable, start, key=lambda number: self._span(number)[1])
        for number in self._usable[first:]:
            if self._span(number)[0] > end:
                return
            yield self._read_part(number, self._arrow_schema, chosen)

    def _span(self, number: int) -> tuple[float, float]:
        """Return the first and last time [s] in the stream's Parquet file ``number``."""
        if number not in self._spans:
            times = self._read_part(number, self._arrow_schema, ["time"])["time"]
            self._spans[number] = (times[0].as_py(), times[-1].as_py()) if len(times) else (-math.inf, -math.inf)
        return self._spans[number]

    @cached_property
    def _spans(self) -> dict[int, tuple[float, float]]:
        """Cache: number of a Parquet file -> its first and last time [s]."""
        return {}

    @cached_property
    def _arrow_schema(self) -> pa.Schema:
        """Arrow schema of the stream's first readable Parquet file."""
        return self._open_part(self._usable[0]).schema_arrow

    @cached_property
    def _usable(self) -> list[int]:
        """Numbers of the stream's readable Parquet files, ascending; raises RunError if no file is readable."""
        expected = range(max(self.count, 1, *(number + 1 for number in self.found[-1:])))
        usable, schema = [], None
        for number in expected:
            try:
                if number not in self._found_set:
                    raise self._damage_error(number, "it is missing")
                # Where parts may be left out, all columns must leave out the same ones: so each is read whole, once.
                if self.skip_damaged:
                    schema = schema or self._open_part(number).schema_arrow
                    self._read_part(number, schema, schema.names)
            except RunError as error:
                if not self.skip_damaged:
                    raise
                warnings.warn(f"left out: {error}", stacklevel=2)
            else:
                usable.append(number)
        if not usable:
            raise RunError(f"{self.folder}: no part can be read")
        return usable

    @cached_property
    def _found_set(self) -> set[int]:
        """Numbers of the stream's Parquet files that exist, as a set."""
        return set(self.found)

    def _open_part(self, number: int) -> pq.ParquetFile:
        """Open one of the stream's Parquet files with checksums; raises RunError if it is damaged."""
        try:
            file = check_file(self.folder / part_name(number))
            found = pq.ParquetFile(file, page_checksum_verification=True)
            # The schema is decoded only when it is asked for.
            _ = found.schema_arrow
            return found
        except DAMAGES as error:
            raise self._damage_error(number, _first_line(error)) from error

    def _read_part(self, number: int, schema: pa.Schema, names: Sequence[str]) -> pa.Table:
        """Read some columns of one of the stream's Parquet files; raises RunError if it is damaged."""
        with self._open_part(number) as file:
            if not file.schema_arrow.equals(schema):
                raise self._damage_error(number, "its columns are not those of the parts before it")
            try:
                return file.read(columns=list(names)).select(list(names))
            except DAMAGES as error:
                raise self._damage_error(number, _first_line(error)) from error

    def _damage_error(self, number: int, reason: str) -> RunError:
        """Return the error for a damaged Parquet file of the stream, with the reason."""
        total = max(self.count, len(self.found))
        error = RunError(
            f"{self.folder / part_name(number)} (part {number + 1} of {total} of '{self.stream}') "
            f"cannot be read: {reason}"
        )
        if not self.skip_damaged:
            # Of use in Python, where notes are shown with the error; commands print its message alone.
            error.add_note("open_run(..., skip_damaged=True) reads the others")
        return error
