"""One stream of a run as arrays of shape (T, n)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from qrsim.core.arrays import NumpyArray
from qrsim.core.tables import Table, Tabled
from qrsim.errors import RunError
from qrsim.runs.arrow import to_numpy
from qrsim.runs.layout import INDEX, Column
from qrsim.runs.parts import StreamParts

if TYPE_CHECKING:
    pass


class Batch(NamedTuple):
    """Some ticks of a stream: times (T,) [s], their numbers (T,), and columns of shape (T, n)."""

    time: npt.NDArray[np.float64]
    tick: npt.NDArray[np.int64]
    arrays: dict[str, NumpyArray]


class Stream(Tabled):
    """One stream of a run as arrays of shape (T, n), n vehicles in the run's order.

    A column is read from disk each time it is asked for: keep it in a variable, or take many with ``arrays``.
    """

    def __init__(self, parts: StreamParts, vehicles: Sequence[str]):
        """Use ``run[stream]``."""
        self._parts = parts
        self.vehicles = tuple(vehicles)

    def _table(self) -> Table:
        """Return the table of the stream's columns that notebooks and printing show."""
        count = len(self.vehicles)
        title = f"stream '{self._parts.stream}' of {count} vehicle{'s' * (count != 1)}, at {len(self.time)} times"
        rows = [(column.name, column.unit, column.dtype, column.doc) for column in self._parts.columns[len(INDEX) :]]
        return Table(title, ("column", "unit", "type", "meaning"), rows)

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names of columns for completion in notebooks."""
        return list(self.columns())

    @cached_property
    def _grid(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """Times [s] and ticks, each (T,); raises RunError unless every tick has a row for each vehicle."""
        # Piece by piece: of all rows only the ticks are kept.
        steps = [self._steps(table) for table in self._parts.tables([column.name for column in INDEX])]
        times, ticks = (np.concatenate(found) for found in zip(*steps, strict=True))
        return times, ticks

    def _steps(self, table: pa.Table) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
        """Return times [s] and ticks, each (T,), of a table with a row per tick and vehicle; raises as ``_grid``."""
        count = len(self.vehicles)
        order = _codes(table["vehicle"], self.vehicles)
        times: npt.NDArray[np.float64] = to_numpy(table["time"])
        ticks: npt.NDArray[np.int64] = to_numpy(table["tick"])
        if count and len(ticks) % count == 0:
            steps = ticks.reshape(-1, count)[:, :1]
            if (order.reshape(-1, count) == np.arange(count)).all() and (ticks.reshape(-1, count) == steps).all():
                return times[::count].copy(), steps[:, 0].copy()
        raise RunError(
            f"{self._parts.folder}: its rows are not one per vehicle at each tick, so there are no (T, n) arrays; "
            "use run.table"
        )

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Simulated time [s], shape (T,)."""
        return self._grid[0]

    @property
    def tick(self) -> npt.NDArray[np.int64]:
        """Number of the simulation step, shape (T,)."""
        return self._grid[1]

    def columns(self) -> tuple[str, ...]:
        """Return the names of the stream's columns."""
        return tuple(column.name for column in self._parts.columns[len(INDEX) :])

    def column(self, name: str) -> Column:
        """Return unit, meaning and type of a column. Raises UsageError for an unknown name."""
        return self._parts.column(name)

    def __getitem__(self, name: str) -> NumpyArray:
        """Return a column, shape (T, n), in its own dtype; raises as ``arrays``."""
        return self.arrays([name])[name]

    def arrays(self, names: Sequence[str] | None = None) -> dict[str, NumpyArray]:
        """Read several columns (None: all), each of shape (T, n), in one pass over the files.

        Raises:
            UsageError: unknown column.
            RunError: a part is damaged or missing; the message names it.
        """
        names = self._checked_names(names)
        shape = (len(self.time), len(self.vehicles))
        table = self._parts.table(names)
        return {name: to_numpy(table[name]).reshape(shape) for name in names}

    def batches(
        self, names: Sequence[str] | None = None, *, start: float = -math.inf, end: float = math.inf
    ) -> Iterator[Batch]:
        """Yield the arrays of ``arrays`` in batches of ticks, for logs larger than memory; raises as ``arrays``.

        Args:
            names: of columns; None: all.
            start, end: times [s]; batches without any between them are left out, and not read.
        """
        names = self._checked_names(names)
        whole = start == -math.inf and end == math.inf
        if whole and names and "_grid" in vars(self):
            yield from self._on_the_grid(names)
            return
        columns = [*(column.name for column in INDEX), *names]
        for table in self._parts.tables(columns) if whole else self._parts.tables_between(columns, start, end):
            if not table.num_rows:
                continue
            time, tick = self._steps(table)
            shape = (len(time), len(self.vehicles))
            yield Batch(time, tick, {name: to_numpy(table[name]).reshape(shape) for name in names})

    def _on_the_grid(self, names: Sequence[str]) -> Iterator[Batch]:
        """Yield all batches of columns, with times and ticks from memory, which takes half as long as to read them."""
        first, count = 0, len(self.vehicles)
        changed = RunError(f"{self._parts.folder}: its files have changed since they were opened")
        for table in self._parts.tables(names):
            ticks = slice(first, first + table.num_rows // count)
            first, time = ticks.stop, self.time[ticks]
            if len(time) * count != table.num_rows:
                raise changed
            if len(time):
                arrays = {name: to_numpy(table[name]).reshape(len(time), count) for name in names}
                yield Batch(time, self.tick[ticks], arrays)
        if first != len(self.time):
            raise changed

    def _checked_names(self, names: Sequence[str] | None) -> Sequence[str]:
        """Return the names of columns to read, by default all; raises UsageError for an unknown one."""
        if names is None:
            return self.columns()
        for name in names:
            if name not in self:
                raise self._parts.unknown(name)
        return names

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns())

    def __contains__(self, name: object) -> bool:
        return name in self.columns()


def _codes(vehicle: pa.ChunkedArray, vehicles: Sequence[str]) -> npt.NDArray[np.int64]:
    """Return each row's vehicle as an index into ``vehicles``; -1 for an unknown vehicle."""
    index = {name: i for i, name in enumerate(vehicles)}
    chunks = [np.zeros(0, np.int64)]
    # In a file that was damaged it may be plain text, or something else.
    coded = vehicle if pa.types.is_dictionary(vehicle.type) else vehicle.dictionary_encode()
    for chunk in coded.chunks:
        # The last entry stands for an absent name, which the index -1 finds.
        lookup = np.array([*(index.get(name, -1) for name in chunk.dictionary.to_pylist()), -1])
        indices = chunk.indices.fill_null(-1) if chunk.null_count else chunk.indices
        chunks.append(lookup[to_numpy(indices)])
    return np.concatenate(chunks)
