"""Writes a run folder; a crash, a kill or a full disk loses at most the data since the last flush."""

from __future__ import annotations

import contextlib
import errno
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy.typing as npt

from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean
from qrsim.files.atomic import write_atomically
from qrsim.files.interruptions import ending, word
from qrsim.files.yaml_text import dump_line
from qrsim.runs.buffers import Buffer, VehicleRows, make_buffers
from qrsim.runs.layout import (
    EVENTS,
    INJECTIONS_FILE,
    RUN_FILE,
    SCENARIO_FILE,
    Column,
    FinalState,
    RunInfo,
    utc_now,
)

_NO_SPACE = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


@dataclass(frozen=True)
class _Batch:
    """What is written at a time.

    Attributes:
        pending: stream -> how many of its pending entries.
        injections: how many entries of ``injections.yaml``, from the first one on.
        last_tick: tick up to which the streams then are on disk.
        time: time up to which they are [s]; None without any rows.
        info: of the run, when the batch was complete.
    """

    pending: Mapping[str, int]
    injections: int
    last_tick: int
    time: float | None
    info: RunInfo


class RunWriter:
    """Records one run, by a thread that writes while the caller flies on; to be called from one thread.

    As a context manager it ends the run by itself: "finished", "interrupted" on Ctrl-C, "failed" on any
    other exception. What was buffered is written in all three cases.
    """

    def __init__(
        self, folder: Path, info: RunInfo, buffers: Mapping[str, Buffer], flush_rows: int, flush_seconds: float
    ):
        """Use ``RunWriter.create``."""
        self.folder = folder
        self._info = info
        self._buffers = buffers
        self._flush_rows, self._flush_seconds = flush_rows, flush_seconds
        self._rows = 0
        self._last_tick = 0
        self._time_on_disk: float | None = None
        self._injections: list[str] = []
        self._injections_on_disk = 0
        self._held = False
        self._flushed_at = time.monotonic()
        self._closed = False
        # What a thread writes at present, and what it is doing; the next batch waits for it, so that memory is bounded.
        self._writing: tuple[_Batch, Future[None]] | None = None
        self._doing = ""
        self._thread = ThreadPoolExecutor(1, "run-writer")

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
        """Create a run folder, with its parents, and return its writer, which flushes after some rows or seconds.

        Every stream gets an empty first part, so that its columns are known however early the run ends.

        Args:
            folder: must not exist.
            info: see ``RunInfo.collect``; the writer keeps its state, ticks, parts and end up to date. Of what is
                appended, it keeps the ticks that ``info.every`` says.
            scenario_yaml: the resolved scenario.
            columns: stream -> its columns beside time, tick and vehicle; "events" is there anyhow.
            flush_rows: rows, over all streams, after which the thread begins to write the buffers.
            flush_seconds: wall time after which it does at the next append.

        Raises:
            UsageError: the folder exists, or names are wrong.
            RunError: the folder cannot be written.
        """
        folder = Path(folder)
        info = replace(info, state="running", ticks=0, parts={}, ended=None, message="")
        buffers = make_buffers(folder, info, columns)
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
                buffer.write(0)
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
        """Record some ticks of one stream: ticks and times (T,), values (T, n) by column. The arrays are copied.

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
        if not isinstance(buffer, VehicleRows):
            known = [name for name in self._buffers if name != EVENTS]
            raise UsageError(f"no stream '{stream}' was declared for this run{did_you_mean(stream, known)}")
        rows, last_tick = buffer.add(ticks, times, values)
        self._count_rows(rows, last_tick)

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
        self._count_rows(1, int(tick))

    def note_score(self, score: Mapping[str, object]) -> None:
        """Keep the flight's score in its task for ``run.json``; it is written with the next flush, or at the end."""
        self._check_open()
        self._info = replace(self._info, score=dict(score))

    def note_injection(self, entry: Mapping[str, object]) -> None:
        """Keep a request made in flight as an entry of ``injections.yaml``; it is written with the next flush."""
        self._check_open()
        self._injections.append(f"- {dump_line(entry)}\n")

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Context manager: delay due writes until the block ends, so that all streams reach the same tick on disk.

        Raises as ``append``, when the block ends.
        """
        self._held = True
        try:
            yield
        finally:
            self._held = False
        if not self._closed:
            self._count_rows(0, self._last_tick)

    def flush(self) -> None:
        """Write all buffered rows as one Parquet file per stream, then ``run.json``; return when they are on disk.

        Raises:
            RunError: it could not be written; the run is closed as failed, its earlier parts stay readable.
        """
        self._check_open()
        self._begin_writing()
        self._finish_writing()

    def _begin_writing(self) -> None:
        """Start a thread that writes the buffered rows, after the previous thread has ended; raises as ``flush``."""
        self._finish_writing()
        pending = {stream: len(buffer.pending) for stream, buffer in self._buffers.items()}
        times = [buffer.last_time for buffer in self._buffers.values() if buffer.last_time is not None]
        batch = _Batch(pending, len(self._injections), self._last_tick, max(times, default=None), self._info)
        self._rows = 0
        self._flushed_at = time.monotonic()
        self._writing = batch, self._thread.submit(self._write, batch)

    def _write(self, batch: _Batch) -> None:
        """Write a batch of buffered rows to disk; runs in a thread, while the caller may append."""
        for stream, buffer in self._buffers.items():
            if batch.pending[stream]:
                self._doing = f"recording '{stream}'"
                buffer.write(batch.pending[stream])
        self._time_on_disk = batch.time
        if batch.injections > self._injections_on_disk:
            self._doing = f"writing {INJECTIONS_FILE}"
            text = "".join(self._injections[: batch.injections])
            write_atomically(self.folder / INJECTIONS_FILE, text.encode())
            self._injections_on_disk = batch.injections
        self._doing = "updating run.json"
        self._write_json(replace(batch.info, ticks=batch.last_tick, parts=self._parts()))

    def _finish_writing(self) -> None:
        """Wait until the writing thread has finished its batch; raises as ``flush``."""
        if self._writing is None:
            return
        batch, writing = self._writing
        try:
            # After an interruption here, the end of the run waits again.
            writing.result()
        except OSError as error:
            raise self._fail(error, self._doing) from error
        self._writing = None
        self._info = replace(self._info, ticks=batch.last_tick, parts=self._parts())

    def close(self, state: FinalState = "finished", message: str = "") -> None:
        """Write all buffered rows and the run's final state; does nothing on a closed run. Raises as ``flush``."""
        if self._closed:
            return
        self.flush()
        self._closed = True
        self._thread.shutdown(wait=False)
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
            # A second signal does not keep the end of the run from disk.
            with ending():
                self.close(
                    "interrupted", "stopped by the user" if word(error) == "interrupted" else "stopped by SIGTERM"
                )
        else:
            reason = str(error) if isinstance(error, QrsimError) else f"{type(error).__name__}: {error}"
            try:
                self.close("failed", reason)
            except QrsimError as second:
                error.add_note(f"While ending the run: {second}")

    def _count_rows(self, rows: int, last_tick: int) -> None:
        """Count appended rows, and begin to write them once enough are buffered or enough time has passed."""
        self._rows += rows
        self._last_tick = max(self._last_tick, last_tick)
        if self._held:
            return
        if self._rows >= self._flush_rows or time.monotonic() - self._flushed_at >= self._flush_seconds:
            self._begin_writing()

    def _check_open(self) -> None:
        """Raise RunError if the run is closed for writing."""
        if self._closed:
            raise RunError(f"the log in {self.folder} is closed (state: {self._info.state}); nothing more can be added")

    def _write_info(self, **changes: Any) -> None:
        """Change some fields of the run's info, and write run.json."""
        self._info = replace(self._info, parts=self._parts(), **changes)
        self._write_json(self._info)

    def _write_json(self, info: RunInfo) -> None:
        """Write run.json atomically, by renaming a temporary file."""
        text = json.dumps(info.to_json(), indent=2, ensure_ascii=False)
        write_atomically(self.folder / RUN_FILE, f"{text}\n".encode())

    def _parts(self) -> dict[str, int]:
        """Return stream -> number of its Parquet files on disk."""
        return {stream: buffer.number for stream, buffer in self._buffers.items()}

    def _fail(self, error: OSError, doing: str) -> RunError:
        """Mark the run as failed, if the disk still allows it; return the error to raise, which says what failed
        (``doing``)."""
        self._closed = True
        self._writing = None
        self._thread.shutdown(wait=False)
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
