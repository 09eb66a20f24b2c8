"""Writes a run folder; a crash, a kill or a full disk loses at most the data since the last flush."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean
from qrsim.interruptions import word
from qrsim.runs.layout import (
    EVENTS,
    INDEX,
    NAME,
    RUN_FILE,
    SCENARIO_FILE,
    Column,
    FinalState,
    RunInfo,
    check_every,
    numpy_dtype,
    part_name,
    stream_schema,
    utc_now,
)

# Plain pages under snappy are what every Parquet reader knows; noise does not compress much better with the
# others (zstd on split bytes: 25 % smaller, 1.7 times the time). Checksums let the reader tell a damaged page.
_PARQUET = {"compression": "snappy", "write_statistics": ["time", "tick"], "write_page_checksum": True}
_NO_SPACE = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


def write_atomically(path: Path, data: Any) -> None:
    """Write bytes to a path atomically.

    The temporary name starts with a dot, so other tools that read a folder of Parquet files ignore it too.

    Raises:
        OSError: nothing was written and nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


class _Buffer:
    """One stream's rows since its last part, and the number of the next part."""

    def __init__(self, folder: Path, schema: pa.Schema):
        self.folder = folder
        self.schema = schema
        self.dictionaries = [f.name for f in schema if pa.types.is_dictionary(f.type)]
        self.number = 0
        self.pending: list[Any] = []
        self.last_time: float | None = None

    def table(self) -> pa.Table:
        """Return the pending rows; the subclasses know their form."""
        raise NotImplementedError

    def write(self) -> None:
        """Write the pending rows as the next part."""
        sink = pa.BufferOutputStream()
        pq.write_table(self.table(), sink, use_dictionary=self.dictionaries, **_PARQUET)
        write_atomically(self.folder / part_name(self.number), sink.getvalue())
        # One statement, between whose halves Python handles no signal: after Ctrl-C during the write above, the
        # same rows are written to the same part again; after it, they are gone from here.
        self.number, self.pending = self.number + 1, []


class _VehicleRows(_Buffer):
    """Rows of a stream that has a value for every vehicle at every tick."""

    def __init__(self, stream: str, folder: Path, schema: pa.Schema, vehicles: Sequence[str], every: int):
        super().__init__(folder, schema)
        self.stream, self.every = stream, every
        self.vehicles = pa.array(vehicles, pa.string())
        index = {column.name for column in INDEX}
        self.dtypes = {f.name: numpy_dtype(f.type) for f in schema if f.name not in index}

    def add(self, ticks: npt.ArrayLike, times: npt.ArrayLike, values: Mapping[str, npt.ArrayLike]) -> tuple[int, int]:
        """Copy what is kept of (T,) ticks and times and (T, n) values into the buffer; return (rows, last tick)."""
        if values.keys() != self.dtypes.keys():
            raise UsageError(self._wrong_names(values))
        own_ticks = self._copy("tick", ticks, np.dtype(np.int64), None)
        shape = (len(own_ticks), len(self.vehicles))
        own_times = self._copy("time", times, np.dtype(np.float64), shape[:1])
        columns = [self._copy(name, values[name], dtype, shape) for name, dtype in self.dtypes.items()]
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

    def table(self) -> pa.Table:
        """Return the pending rows, one per (time, vehicle), vehicles varying fastest."""
        count = len(self.vehicles)
        ticks = np.concatenate([chunk[0] for chunk in self.pending] or [np.zeros(0, np.int64)])
        times = np.concatenate([chunk[1] for chunk in self.pending] or [np.zeros(0)])
        codes = pa.array(np.tile(np.arange(count, dtype=np.int32), len(ticks)))
        arrays = [
            pa.array(np.repeat(times, count)),
            pa.array(np.repeat(ticks, count)),
            pa.DictionaryArray.from_arrays(codes, self.vehicles),
        ]
        for i, dtype in enumerate(self.dtypes.values()):
            chunks = [chunk[2][i] for chunk in self.pending]
            arrays.append(pa.array(np.concatenate(chunks).reshape(-1) if chunks else np.zeros(0, dtype)))
        return pa.Table.from_arrays(arrays, schema=self.schema)

    def _copy(
        self, name: str, values: npt.ArrayLike, dtype: np.dtype[Any], shape: tuple[int, ...] | None
    ) -> npt.NDArray[Any]:
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

    def _wrong_names(self, values: Mapping[str, Any]) -> str:
        for name in values:
            if name not in self.dtypes:
                return f"stream '{self.stream}': no column '{name}' was declared{did_you_mean(name, self.dtypes)}"
        missing = [name for name in self.dtypes if name not in values]
        return f"stream '{self.stream}': no values for {', '.join(missing)}"


class _EventRows(_Buffer):
    """Rows of the events stream, pending as tuples in the order of its columns."""

    def table(self) -> pa.Table:
        """Return the pending events."""
        columns = list(zip(*self.pending, strict=True)) or [()] * len(self.schema)
        arrays = []
        for item, values in zip(self.schema, columns, strict=True):
            if item.type == NAME:
                arrays.append(pa.array(values, pa.string()).dictionary_encode())
            else:
                arrays.append(pa.array(values, item.type))
        return pa.Table.from_arrays(arrays, schema=self.schema)


class RunWriter:
    """Records one run; not thread-safe.

    As a context manager it ends the run by itself: "finished", "interrupted" on Ctrl-C, "failed" on any
    other exception. What was buffered is written in all three cases.
    """

    def __init__(
        self, folder: Path, info: RunInfo, buffers: Mapping[str, _Buffer], flush_rows: int, flush_seconds: float
    ):
        """Use ``RunWriter.create``."""
        self.folder = folder
        self._info = info
        self._buffers = buffers
        self._flush_rows, self._flush_seconds = flush_rows, flush_seconds
        self._rows = 0
        self._last_tick = 0
        self._time_on_disk: float | None = None
        self._held = False
        self._flushed_at = time.monotonic()
        self._closed = False

    @classmethod
    def create(
        cls,
        folder: Path | str,
        *,
        info: RunInfo,
        scenario_yaml: str,
        columns: Mapping[str, Sequence[Column]],
        flush_rows: int = 200_000,
        flush_seconds: float = 2.0,
    ) -> RunWriter:
        """Create a run folder, with its parents.

        Every stream gets an empty first part, so that its columns are known however early the run ends.

        Args:
            folder: must not exist.
            info: see ``RunInfo.collect``; the writer keeps its state, ticks, parts and end up to date. Of what is
                appended, it keeps the ticks that ``info.every`` says.
            scenario_yaml: the resolved scenario.
            columns: stream -> its columns beside time, tick and vehicle; "events" is there anyhow.
            flush_rows: rows, over all streams, after which the buffers are written.
            flush_seconds: wall time after which the next append writes the buffers.

        Raises:
            UsageError: the folder exists, or names are wrong.
            RunError: the folder cannot be written.
        """
        folder = Path(folder)
        info = replace(info, state="running", ticks=0, parts={}, ended=None, message="")
        buffers = _make_buffers(folder, info, columns)
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise UsageError(
                f"{folder} exists already, and a run is never overwritten: choose another folder with --out"
            ) from None
        except OSError as error:
            raise RunError(f"cannot create the run folder {folder}: {error.strerror or error}") from error
        writer = cls(folder, info, buffers, flush_rows, flush_seconds)
        try:
            write_atomically(folder / SCENARIO_FILE, scenario_yaml.encode())
            for buffer in buffers.values():
                buffer.folder.mkdir()
                buffer.write()
            writer._write_info()
        except BaseException as error:
            # The folder is ours and holds nothing yet; left there, it would refuse the next attempt.
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, OSError):
                raise RunError(f"cannot write in the run folder {folder}: {error.strerror or error}") from error
            raise
        return writer

    @property
    def info(self) -> RunInfo:
        """The content of ``run.json`` now."""
        return self._info

    def append(
        self, stream: str, ticks: npt.ArrayLike, times: npt.ArrayLike, values: Mapping[str, npt.ArrayLike]
    ) -> None:
        """Record some ticks of one stream; the arrays are copied and may be reused.

        Args:
            stream: one of those given to ``create``.
            ticks: (T,) integers, increasing.
            times: (T,) simulated time [s].
            values: column -> (T, n_vehicles); exactly the columns declared.

        Raises:
            UsageError: unknown or missing names, a wrong shape or type.
            RunError: the buffers were due and could not be written (disk full); the run is closed as failed.
        """
        self._check_open()
        buffer = self._buffers.get(stream)
        if not isinstance(buffer, _VehicleRows):
            known = [name for name in self._buffers if name != EVENTS]
            raise UsageError(f"no stream '{stream}' was declared for this run{did_you_mean(stream, known)}")
        rows, last_tick = buffer.add(ticks, times, values)
        self._added(rows, last_tick)

    def append_event(
        self,
        time: float,
        tick: int,
        vehicle: str | None,
        kind: str,
        field: str | None = None,
        value: float | None = None,
        message: str = "",
    ) -> None:
        """Record one event, with the fields of ``qrsim.runs.Event``; raises as ``append``."""
        self._check_open()
        if vehicle is not None and vehicle not in self._info.vehicles:
            raise UsageError(f"event '{kind}': no vehicle '{vehicle}'{did_you_mean(vehicle, self._info.vehicles)}")
        number = None if value is None else float(value)
        events = self._buffers[EVENTS]
        events.pending.append((float(time), int(tick), vehicle, kind, field, number, message))
        events.last_time = float(time)
        self._added(1, int(tick))

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Delay due writes until the block ends, so that all streams reach the same tick on disk.

        Raises as ``append``, when the block ends.
        """
        self._held = True
        try:
            yield
        finally:
            self._held = False
        if not self._closed:
            self._added(0, self._last_tick)

    def flush(self) -> None:
        """Write what is buffered as one part per stream, then ``run.json``.

        Raises:
            RunError: it could not be written; the run is closed as failed, its earlier parts stay readable.
        """
        self._check_open()
        try:
            for stream, buffer in self._buffers.items():
                if buffer.pending:
                    doing = f"recording '{stream}'"
                    buffer.write()
            times = [buffer.last_time for buffer in self._buffers.values() if buffer.last_time is not None]
            self._time_on_disk = max(times, default=None)
            doing = "updating run.json"
            self._write_info(ticks=self._last_tick)
        except OSError as error:
            raise self._fail(error, doing) from error
        self._rows = 0
        self._flushed_at = time.monotonic()

    def close(self, state: FinalState = "finished", message: str = "") -> None:
        """Write what is buffered and the run's final state; does nothing on a closed run. Raises as ``flush``."""
        if self._closed:
            return
        self.flush()
        self._closed = True
        try:
            self._write_info(state=state, message=message, ended=utc_now())
        except OSError as error:
            raise self._fail(error, "updating run.json") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.close("finished")
        elif isinstance(error, KeyboardInterrupt):
            self.close("interrupted", "stopped by the user" if word(error) == "interrupted" else "stopped by SIGTERM")
        else:
            reason = str(error) if isinstance(error, QrsimError) else f"{type(error).__name__}: {error}"
            try:
                self.close("failed", reason)
            except QrsimError as second:
                error.add_note(f"While ending the run: {second}")

    def _added(self, rows: int, last_tick: int) -> None:
        self._rows += rows
        self._last_tick = max(self._last_tick, last_tick)
        if self._held:
            return
        if self._rows >= self._flush_rows or time.monotonic() - self._flushed_at >= self._flush_seconds:
            self.flush()

    def _check_open(self) -> None:
        if self._closed:
            raise RunError(f"the log in {self.folder} is closed (state: {self._info.state}); nothing more can be added")

    def _write_info(self, **changes: Any) -> None:
        counts = {stream: buffer.number for stream, buffer in self._buffers.items()}
        self._info = replace(self._info, parts=counts, **changes)
        text = json.dumps(self._info.to_json(), indent=2, ensure_ascii=False)
        write_atomically(self.folder / RUN_FILE, f"{text}\n".encode())

    def _fail(self, error: OSError, doing: str) -> RunError:
        """Close the run as failed, as far as the disk still lets it, and return the error to raise."""
        self._closed = True
        why = "disk full" if error.errno in _NO_SPACE else f"cannot write ({error.strerror or error})"
        rest = (
            f"the log in {self.folder} is readable, but empty"
            if self._time_on_disk is None
            else f"the log up to t = {self._time_on_disk:.10g} s in {self.folder} is readable"
        )
        message = f"{why} while {doing}: {rest}"
        with contextlib.suppress(OSError):
            self._write_info(state="failed", message=message, ended=utc_now())
        return RunError(message)


def _make_buffers(folder: Path, info: RunInfo, columns: Mapping[str, Sequence[Column]]) -> dict[str, _Buffer]:
    """Check all names and return the streams' buffers, the events last."""
    if not info.vehicles or len(set(info.vehicles)) != len(info.vehicles):
        raise UsageError(f"a run needs vehicles of different names, got {list(info.vehicles)}")
    check_every(info.every, columns.keys())
    buffers: dict[str, _Buffer] = {}
    for stream, declared in columns.items():
        if stream == EVENTS or not re.fullmatch(r"[a-z][a-z0-9_]*", stream):
            raise UsageError(
                f"'{stream}' cannot name a stream: it becomes a folder, in lower case with digits and underscores, "
                f"and '{EVENTS}' is taken"
            )
        schema = stream_schema(stream, declared, info)
        buffers[stream] = _VehicleRows(stream, folder / stream, schema, info.vehicles, info.every.get(stream, 1))
    buffers[EVENTS] = _EventRows(folder / EVENTS, stream_schema(EVENTS, (), info))
    return buffers
