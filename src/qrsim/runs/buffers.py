"""Buffers of the streams of a run, and the Parquet parts written from them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from qrsim.core.arrays import DType, NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.files.atomic import write_atomically
from qrsim.runs.arrow import column, names, numbers, strings
from qrsim.runs.layout import (
    EVENTS,
    INDEX,
    NAME,
    Column,
    RunInfo,
    check_every,
    numpy_dtype,
    part_name,
    stream_schema,
)

# Plain pages under snappy are what every Parquet reader knows; noise does not compress much better with the
# others (zstd on split bytes: 25 % smaller, 1.7 times the time). Checksums let the reader tell a damaged page.
_PARQUET = {"compression": "snappy", "write_statistics": ["time", "tick"], "write_page_checksum": True}


class Buffer:
    """One stream's rows since its last part, and the number of the next part."""

    def __init__(self, folder: Path, schema: pa.Schema):
        self.folder = folder
        self.schema = schema
        self.dictionaries = [f.name for f in schema if pa.types.is_dictionary(f.type)]
        self.number = 0
        self.pending: list[Any] = []
        self.last_time: float | None = None

    def table(self, pending: Sequence[Any]) -> pa.Table:
        """Convert buffered rows to an Arrow table; each subclass defines the form of its rows."""
        raise NotImplementedError

    def write(self, count: int) -> None:
        """Write the first ``count`` buffered entries to the stream's next Parquet file; another thread may append
        meanwhile."""
        sink = pa.BufferOutputStream()
        pq.write_table(self.table(self.pending[:count]), sink, use_dictionary=self.dictionaries, **_PARQUET)
        write_atomically(self.folder / part_name(self.number), sink.getvalue())
        self.number += 1
        # In place, because the list may grow at its end at this moment.
        del self.pending[:count]


class VehicleRows(Buffer):
    """Rows of a stream that has a value for every vehicle at every tick."""

    def __init__(self, stream: str, folder: Path, schema: pa.Schema, vehicles: Sequence[str], every: int):
        super().__init__(folder, schema)
        self.stream, self.every = stream, every
        self.vehicles = strings(vehicles)
        index = {column.name for column in INDEX}
        self.dtypes = {f.name: numpy_dtype(f.type) for f in schema if f.name not in index}

    def add(self, ticks: npt.ArrayLike, times: npt.ArrayLike, values: Mapping[str, npt.ArrayLike]) -> tuple[int, int]:
        """Buffer every Nth tick, with ticks and times [s] (T,) and values by column (T, n); return (rows added, last
        tick)."""
        if values.keys() != self.dtypes.keys():
            raise UsageError(self._wrong_names(values))
        own_ticks = self._checked_copy("tick", ticks, np.dtype(np.int64), None)
        shape = (len(own_ticks), len(self.vehicles))
        own_times = self._checked_copy("time", times, np.dtype(np.float64), shape[:1])
        columns = [self._checked_copy(name, values[name], dtype, shape) for name, dtype in self.dtypes.items()]
        if not shape[0]:
            return 0, 0
        self.last_time = float(own_times[-1])
        last_tick = int(own_ticks[-1])
        if self.every > 1:
            kept = own_ticks % self.every == 0
            own_ticks, own_times, columns = own_ticks[kept], own_times[kept], [column[kept] for column in columns]
        if len(own_ticks):
            self.pending.append((own_ticks, own_times, columns))
        return len(own_ticks) * shape[1], last_tick

    def table(self, pending: Sequence[Any]) -> pa.Table:
        """Convert buffered ticks to an Arrow table, one row per (time, vehicle), vehicles varying fastest."""
        count = len(self.vehicles)
        ticks = np.concatenate([chunk[0] for chunk in pending] or [np.zeros(0, np.int64)])
        times = np.concatenate([chunk[1] for chunk in pending] or [np.zeros(0)])
        codes = column(np.tile(np.arange(count, dtype=np.int32), len(ticks)))
        arrays = [
            column(np.repeat(times, count)),
            column(np.repeat(ticks, count)),
            pa.DictionaryArray.from_arrays(codes, self.vehicles),
        ]
        for i, dtype in enumerate(self.dtypes.values()):
            chunks = [chunk[2][i] for chunk in pending]
            arrays.append(column(np.concatenate(chunks).reshape(-1) if chunks else np.zeros(0, dtype)))
        return pa.Table.from_arrays(arrays, schema=self.schema)

    def _checked_copy(
        self, name: str, values: npt.ArrayLike, dtype: DType, shape: tuple[int, ...] | None
    ) -> NumpyArray:
        """Return a copy of a column's values; raise UsageError unless they have the given type and shape (None: any
        1-D)."""
        array = np.asarray(values)
        expected = f"shape {shape}" if shape is not None else "shape (T,)"
        if array.shape != shape if shape is not None else array.ndim != 1:
            raise UsageError(f"stream '{self.stream}', column '{name}': shape {array.shape}, expected {expected}")
        try:
            return array.astype(dtype, casting="same_kind", copy=True)
        except TypeError:
            raise UsageError(
                f"stream '{self.stream}', column '{name}': declared as {dtype}, got {array.dtype}"
            ) from None

    def _wrong_names(self, values: Mapping[str, object]) -> str:
        """Return the error message about the first undeclared column in ``values``; else about all missing columns."""
        for name in values:
            if name not in self.dtypes:
                return f"stream '{self.stream}': no column '{name}' was declared{did_you_mean(name, self.dtypes)}"
        missing = [name for name in self.dtypes if name not in values]
        return f"stream '{self.stream}': no values for {', '.join(missing)}"


class EventRows(Buffer):
    """Rows of the events stream, pending as tuples in the order of its columns."""

    def table(self, pending: Sequence[Any]) -> pa.Table:
        """Convert buffered events to an Arrow table, one row per event."""
        columns = list(zip(*pending, strict=True)) or [()] * len(self.schema)
        arrays = []
        for item, values in zip(self.schema, columns, strict=True):
            if item.type == NAME:
                arrays.append(names(values))
            else:
                arrays.append(strings(values) if item.type == pa.string() else numbers(values, item.type))
        return pa.Table.from_arrays(arrays, schema=self.schema)


def make_buffers(folder: Path, info: RunInfo, columns: Mapping[str, Sequence[Column]]) -> dict[str, Buffer]:
    """Check the names of vehicles, streams and columns; return stream name -> its write buffer, that of events last."""
    if not info.vehicles or len(set(info.vehicles)) != len(info.vehicles):
        raise UsageError(f"a run needs vehicles of different names, got {list(info.vehicles)}")
    check_every(info.every, columns.keys())
    buffers: dict[str, Buffer] = {}
    for stream, declared in columns.items():
        if stream == EVENTS or not re.fullmatch(r"[a-z][a-z0-9_]*", stream):
            raise UsageError(
                f"'{stream}' cannot name a stream: it becomes a folder, in lower case with digits and underscores, "
                f"and '{EVENTS}' is taken"
            )
        schema = stream_schema(stream, declared, info)
        buffers[stream] = VehicleRows(stream, folder / stream, schema, info.vehicles, info.every.get(stream, 1))
    buffers[EVENTS] = EventRows(folder / EVENTS, stream_schema(EVENTS, (), info))
    return buffers
