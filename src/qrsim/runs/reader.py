"""Read a run folder: finished, still running, or killed."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
from pydantic import TypeAdapter, ValidationError

from qrsim.core.tables import Table, Tabled
from qrsim.errors import RunError, ScenarioError, UsageError, did_you_mean, os_error_as, shortened
from qrsim.files import Content
from qrsim.files.user_files import LARGEST_DATA, read_text
from qrsim.files.yaml_text import parse_yaml
from qrsim.runs.episodes import EPISODES_FILE, episode_folders, holds_episodes, which_one
from qrsim.runs.layout import (
    EVENTS,
    FORMAT,
    INDEX,
    INJECTIONS_FILE,
    RUN_FILE,
    SCENARIO_FILE,
    Column,
    Event,
    RunInfo,
    stream_schema,
)
from qrsim.runs.parts import StreamParts
from qrsim.runs.stream_arrays import Stream

if TYPE_CHECKING:
    from qrsim.scenarios.scenario import Scenario

_INFO = TypeAdapter(RunInfo)
# Columns of every stream.
_EVERYWHERE = tuple(column.name for column in INDEX)
# A part is written every few seconds: a run of a year has as many.
MOST_PARTS = 10_000_000


def open_run(path: Path | str, *, skip_damaged: bool = False, code: bool = False) -> Run:
    """Open a run folder for reading, as it is now; reopen it to see newer data. ``code``: load its scenario's files.

    Args:
        path: the run folder; or a folder of the episodes of a server's session, which is the run of its episode where
            there is one, and otherwise has nothing but ``episodes``.
        skip_damaged: leave damaged and missing parts out, with a warning for each, instead of raising.
        code: load the Python files and modules that the recorded scenario names, where it has to be built again;
            they can do anything, so only where you trust who wrote the folder.

    Raises:
        UsageError: there is no run folder at ``path``; and where one of several episodes is to be read as a run.
        RunError: ``run.json`` is damaged, or of a later version of qrsim.
    """
    folder = Path(path)
    try:
        folder.exists()
    except (OSError, ValueError) as error:  # a name that is too long, or has a null byte
        words = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"no run at {shortened(str(folder), 100)}: {words}") from None
    if holds_episodes(folder):
        found = episode_folders(folder)
        if len(found) == 1:
            return open_run(found[0], skip_damaged=skip_damaged, code=code)
        return _Episodes(folder, found, skip_damaged, code)
    if not (folder / RUN_FILE).is_file():
        raise UsageError(_not_a_run_message(folder))
    # Before the parts are listed: these are then at least as many as the counts in it.
    info = _read_info(folder / RUN_FILE)
    with os_error_as(RunError, f"cannot read {folder / SCENARIO_FILE}"):
        scenario_yaml = read_text(folder / SCENARIO_FILE, LARGEST_DATA)
    return Run(folder, info, scenario_yaml, skip_damaged, code)


class Run(Tabled):
    """One recorded run. ``run["truth"]["position_ned.x"]`` is an array of shape (T, n).

    Attributes:
        folder: where it lies.
        info: the content of ``run.json``.
        scenario_yaml: the resolved scenario, as text.
    """

    def __init__(self, folder: Path, info: RunInfo, scenario_yaml: str, skip_damaged: bool = False, code: bool = False):
        """Use ``open_run``."""
        self.folder, self.info, self.scenario_yaml, self._code = folder, info, scenario_yaml, code
        self._parts = {
            stream: StreamParts(stream, folder / stream, _part_numbers(folder / stream), count, skip_damaged)
            for stream, count in info.parts.items()
        }
        self._streams: dict[str, Stream] = {}

    def _table(self) -> Table:
        """Return the table of the run's streams that notebooks and printing show."""
        rows = []
        for stream, parts in self._parts.items():
            columns = [column.name for column in parts.columns]
            rows.append((stream, str(len(columns)), ", ".join(name for name in columns if name not in _EVERYWHERE)))
        time, count = self.info.ticks * self.info.time_step, len(self.vehicles)
        title = f"run {self.folder}: '{self.info.scenario}', {self.info.state}, {time:.10g} s, {count} vehicles"
        return Table(title, ("stream", "columns", "names"), rows)

    def _ipython_key_completions_(self) -> list[str]:
        """Return the names of streams for completion in notebooks."""
        return list(self.streams)

    @cached_property
    def scenario(self) -> Any:
        """The resolved scenario, a dict. Raises RunError if the file is not YAML."""
        source = self.folder / SCENARIO_FILE
        try:
            return parse_yaml(self.scenario_yaml, str(source), own=True)
        except ScenarioError as error:
            raise RunError(f"{source} is damaged: {error.problems[0]}") from error

    def built(self) -> Scenario:
        """Return the recorded scenario as a ``Scenario``, checked but without warnings.

        Raises:
            ScenarioError: it cannot be flown any more, or names code that is not loaded (see ``open_run``).
            RunError: the file is not YAML.
        """
        from qrsim.scenarios.scenario import load_scenario

        if not isinstance(self.scenario, dict):
            raise ScenarioError(str(self.folder / SCENARIO_FILE), ["expected keys and values such as name: hover"])
        return load_scenario(self.scenario, quiet=True, named_code=self._code)

    @property
    def injections(self) -> list[Content]:
        """Entries of ``injections.yaml``, the faults and other requests made in flight; empty without the file.

        Raises:
            RunError: the file is no list of entries.
        """
        path = self.folder / INJECTIONS_FILE
        if not path.exists():
            return []
        with os_error_as(RunError, f"cannot read {path}"):
            text = read_text(path, LARGEST_DATA)
        try:
            found = parse_yaml(text, str(path), own=True)
        except ScenarioError as error:
            raise RunError(f"{path} is damaged: {error.problems[0]}") from error
        if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
            raise RunError(f"{path} is damaged: it is no list of injections")
        return found

    @property
    def episodes(self) -> tuple[Run, ...]:
        """Runs in the folder of a server session, in order; for a single run only itself."""
        return (self,)

    @property
    def unfinished(self) -> str:
        """Text which says that the run is still being written or was killed; "" for a finished run."""
        if self.info.state != "running":
            return ""
        return f"{self.folder}: the run has not ended, or was killed; the data end at its last flush"

    @property
    def streams(self) -> tuple[str, ...]:
        """Names of the recorded streams, "events" included."""
        return tuple(self._parts)

    @property
    def vehicles(self) -> tuple[str, ...]:
        """Names of the vehicles, in the order of the arrays' last axis."""
        return self.info.vehicles

    def __getitem__(self, stream: str) -> Stream:
        """Return a stream as (T, n) arrays, read on demand. Raises UsageError for an unknown name."""
        if stream == EVENTS:
            raise UsageError("events are not one per vehicle and tick: use run.events or run.table('events')")
        if stream not in self._streams:
            self._streams[stream] = Stream(self._stream_parts(stream), self.vehicles)
        return self._streams[stream]

    def __iter__(self) -> Iterator[str]:
        return iter(self.streams)

    def __contains__(self, stream: object) -> bool:
        return stream in self._parts

    def table(self, stream: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a stream as recorded: one row per time and vehicle, or per event (``columns`` None: all).

        Args:
            stream: its name.
            columns: those to read, in this order; None for all. Units are in the fields' metadata.

        Raises:
            UsageError: unknown stream or column.
            RunError: a part is damaged or missing; the message names it.
        """
        return self._stream_parts(stream).table(columns)

    def batches(self, stream: str, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the rows of ``table`` in batches, for logs larger than memory; raises as ``table``."""
        return self._stream_parts(stream).tables(columns)

    def describe(self, stream: str) -> tuple[Column, ...]:
        """Return the description of each column of a stream, with time, tick and vehicle; raises as ``table``."""
        return self._stream_parts(stream).columns

    def units(self, stream: str) -> dict[str, str]:
        """Return column -> unit ("" without one) of a stream, with time, tick and vehicle; raises as ``table``."""
        return {column.name: column.unit for column in self.describe(stream)}

    @property
    def events(self) -> list[Event]:
        """All events in the order of recording, read once; raises as ``table``."""
        return list(self._events)

    @cached_property
    def _events(self) -> list[Event]:
        """All events in the order of recording; raises as ``table``."""
        table = self.table(EVENTS)
        expected = stream_schema(EVENTS, (), self.info)
        if not table.schema.equals(expected, check_metadata=False):
            raise RunError(
                f"{self.folder / EVENTS}: holds no events; its columns are {', '.join(table.column_names)[:200]}; "
                f"expected {', '.join(expected.names)}"
            )
        if any(table[name].null_count for name in ("time", "tick", "kind")):
            raise RunError(f"{self.folder / EVENTS}: an event has no time, tick or kind")
        return [Event(**row) for row in table.to_pylist()]

    def _stream_parts(self, stream: str) -> StreamParts:
        """Return the reader of a stream's Parquet files; raises UsageError for an unknown stream."""
        if stream not in self._parts:
            raise UsageError(f"{self.folder} has no stream '{stream}'{did_you_mean(str(stream), self._parts)}")
        return self._parts[stream]


class _Episodes(Run):
    """Several runs in one folder, which have to be told apart before anything is read."""

    def __init__(self, folder: Path, found: list[Path], skip_damaged: bool, code: bool):
        self.folder, self._found, self._skip_damaged, self._code = folder, found, skip_damaged, code

    def _table(self) -> Table:
        """Return the table of episodes that notebooks and printing show for a folder of episodes."""
        names = [(folder.name,) for folder in self._found]
        return Table(f"{self.folder}: {len(names)} episodes", ("episode",), names)

    @property
    def episodes(self) -> tuple[Run, ...]:
        """Return each episode of the folder as an opened run."""
        return tuple(open_run(folder, skip_damaged=self._skip_damaged, code=self._code) for folder in self._found)

    def __getattr__(self, name: str) -> Any:
        # All else that a run has is that of one episode.
        if name.startswith("__"):
            raise AttributeError(name)
        raise which_one(self.folder, self._found)


def _part_numbers(folder: Path) -> list[int]:
    """Return the numbers of the Parquet files in a stream's folder, ascending; temporary files do not count."""
    if not folder.is_dir():
        return []
    matches = (re.fullmatch(r"part-(\d{5,9})\.parquet", path.name) for path in folder.iterdir())
    # What has a larger number is no part that a run wrote.
    return sorted(number for match in matches if match and (number := int(match[1])) < MOST_PARTS)


def _not_a_run_message(folder: Path) -> str:
    """Return the error message for a folder that is no run folder."""
    if not folder.exists():
        return f"no run at {folder}: there is no such folder"
    hint = ""
    if (folder.parent / RUN_FILE).is_file():
        hint = f"; the run is {folder.parent}"
    elif folder.is_dir():
        inside = sorted(path.parent.name for name in (RUN_FILE, EPISODES_FILE) for path in folder.glob(f"*/{name}"))
        hint = f"; runs inside it: {', '.join(inside[:8])}{', ...' if len(inside) > 8 else ''}" if inside else ""
    return f"{folder} is not a run folder: it has no {RUN_FILE}{hint}"


# Of scenarios and vehicles.
LONGEST_NAME = 200


def _problem(info: RunInfo) -> str:
    """Return a text about the first impossible value in a run's run.json; "" if all are possible."""
    if not info.vehicles:
        return "vehicles: there are none"
    # They may be anybody's, and are shown on pages and terminals.
    for name, text in (("scenario", info.scenario), *(("vehicles", vehicle) for vehicle in info.vehicles)):
        if not text.isprintable() or not 0 < len(text) <= LONGEST_NAME:
            return f"{name}: {text!r:.60} is no name"
    if len(set(info.vehicles)) < len(info.vehicles):
        return "vehicles: a name is there twice"
    if not (math.isfinite(info.time_step) and info.time_step > 0.0):
        return f"time_step: {info.time_step:g}; expected above 0"
    for name, counts in (("every", info.every), ("parts", info.parts)):
        for stream, count in counts.items():
            if not re.fullmatch(r"[A-Za-z0-9_.-]+", stream) or stream in (".", ".."):
                return f"{name}: {stream!r:.60} is no name of a stream"
            if not 0 <= count <= MOST_PARTS:
                return f"{name}.{stream}: {count}; expected 0 to {MOST_PARTS}"
    return "" if 0 <= info.ticks < 2**63 else f"ticks: {info.ticks}; expected at least 0"


def _read_info(path: Path) -> RunInfo:
    """Read and check the run.json of a run folder; raises RunError."""
    try:
        data = json.loads(read_text(path))
        version = data["format"]
        if version == FORMAT:
            info = _INFO.validate_python(data)
            if problem := _problem(info):
                raise RunError(f"{path} is damaged: {problem}")
            return info
    except OSError as error:
        raise RunError(f"cannot read {path}: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"])
        raise RunError(f"{path} is damaged: {where}: {first['msg']}") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise RunError(f"{path} is damaged: {error!r}") from error
    raise RunError(f"{path} has the run folder format {version}; this version of qrsim reads format {FORMAT}")
