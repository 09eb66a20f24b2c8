"""Layout of a run folder, shared by its writer and its reader."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import shlex
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa

from qrsim.core.arrays import DType
from qrsim.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from qrsim.scenarios.scenario import Scenario
    from qrsim.simulation.simulation import Simulation

FORMAT = 1
# Ticks are counted in 32 bits.
LARGEST_EVERY = 2**31 - 1
RUN_FILE, SCENARIO_FILE, EVENTS = "run.json", "scenario.yaml", "events"
# Requests made in flight, for ``qrsim run --inject``; absent if there were none.
INJECTIONS_FILE = "injections.yaml"
# Kind of the event that says that a person was found; its value is the number of the person.
PERSON_FOUND = "person_found"
# Kind of the events that say that others may have been missed; the last one of a run has how many looks that were.
OVERFULL = "neighbours_overfull"
# Kinds of the events of zones that end no flight; the field is the name of the zone.
ZONE_LEFT, ZONE_ENTERED = "zone_left", "zone_entered"

FinalState = Literal["finished", "failed", "interrupted"]
RunState = Literal["running", "finished", "failed", "interrupted"]


@dataclass(frozen=True)
class Column:
    """One quantity of a stream.

    Attributes:
        name: unique in its stream; not ``time``, ``tick`` or ``vehicle``, which every stream has.
        unit: SI unit, "" where there is none.
        doc: one sentence.
        dtype: NumPy name of a floating-point (32 or 64 bits), integer or boolean type.
    """

    name: str
    unit: str = ""
    doc: str = ""
    dtype: str = "float64"


INDEX = (
    Column("time", "s", "simulated time since the start of the run", "float64"),
    Column("tick", "", "number of the simulation step", "int64"),
    Column("vehicle", "", "name of the vehicle", "str"),
)
EVENT_COLUMNS = (
    *INDEX,
    Column("kind", "", "what happened", "str"),
    Column("field", "", "the quantity concerned, null where there is none", "str"),
    Column("value", "", "value of that quantity, in its own unit", "float64"),
    Column("message", "", "one sentence for people", "str"),
)
NAME, TEXT = pa.dictionary(pa.int32(), pa.string()), pa.string()


@dataclass(frozen=True)
class Event:
    """Something that happened once: a limit broken, a collision, a task done.

    Attributes:
        time: simulated time [s].
        tick: number of the simulation step.
        vehicle: name, None where the event concerns no single vehicle.
        kind: what happened, one word.
        field: the quantity concerned, None where there is none.
        value: its value in its own unit, None where there is none.
        message: one sentence.
    """

    time: float
    tick: int
    vehicle: str | None
    kind: str
    field: str | None
    value: float | None
    message: str


@dataclass(frozen=True)
class RunInfo:
    """Scenario, machine, versions and progress of a run: the content of ``run.json``.

    Attributes:
        scenario: name of the scenario.
        seed: seed of every random stream.
        precision: "float32" or "float64".
        time_step: simulation step [s].
        vehicles: names, in the order of every (T, n) array.
        state: "running" also where the process was killed: nobody was left to write another word.
        ticks: number of the last tick up to which all streams are on disk (0 before the first).
        every: stream -> N where only the ticks that N divides are kept; all are where a stream is not named.
        parts: stream -> Parquet parts that were on disk when this was written; a later part is valid too.
        versions: qrsim, python, jax and numpy.
        components: those from outside that the scenario needs: path, kind, type, class, file and its sha256, from.
        platform: operating system and processor.
        command_line: as typed, quoted for a shell.
        started, ended: wall time, UTC, ISO 8601; ``ended`` is None while running.
        message: why the run failed or was interrupted, "" otherwise.
        compiler: what made the program that flew, "llvm" (machine code by qrsim itself) or "xla"; "" where nobody said.
        compiler_refused: why it was XLA although machine code was wanted, "" otherwise.
        score: what the flight scored in the scenario's task, ``TaskScore.to_json``; None without a task.
    """

    scenario: str
    seed: int
    precision: str
    time_step: float
    vehicles: tuple[str, ...]
    state: RunState = "running"
    ticks: int = 0
    every: Mapping[str, int] = field(default_factory=dict)
    parts: Mapping[str, int] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    components: tuple[Mapping[str, str], ...] = ()
    platform: str = ""
    command_line: str = ""
    started: str = ""
    ended: str | None = None
    message: str = ""
    compiler: str = ""
    compiler_refused: str = ""
    score: Mapping[str, Any] | None = None

    @classmethod
    def collect(
        cls,
        *,
        scenario: str,
        seed: int,
        precision: str,
        time_step: float,
        vehicles: Sequence[str],
        every: Mapping[str, int] | None = None,
        command_line: Sequence[str] | None = None,
        components: Sequence[Mapping[str, str]] = (),
    ) -> RunInfo:
        """Collect the content of run.json for a run that starts now: versions, machine, time, and the given facts.

        Args:
            scenario, seed, precision, time_step, vehicles, every, components: see the class.
            command_line: words of the command; by default those of this process.
        """
        words = list(sys.argv if command_line is None else command_line)
        words[:1] = [Path(word).name for word in words[:1]]
        return cls(
            scenario=scenario,
            seed=seed,
            precision=precision,
            time_step=time_step,
            vehicles=tuple(vehicles),
            every=dict(every or {}),
            versions={
                "qrsim": installed_version("qrsim"),
                "python": platform.python_version(),
                "jax": installed_version("jax"),
                "numpy": np.__version__,
            },
            components=tuple(components),
            platform=platform.platform(),
            command_line=shlex.join(words),
            started=utc_now(),
        )

    @classmethod
    def of_flight(cls, scenario: Scenario, simulation: Simulation, **more: Any) -> RunInfo:
        """Collect the content of run.json for a flight of a scenario; ``more``: ``every`` and ``command_line`` of
        ``collect``."""
        return cls.collect(
            scenario=scenario.name,
            seed=simulation.seed,
            precision=simulation.precision,
            time_step=simulation.world.time_step,
            vehicles=simulation.vehicle_names,
            components=scenario.outside,
            **more,
        )

    def to_json(self) -> dict[str, object]:
        """Return the content of run.json as a dict, in reading order, without copying."""
        first = ("state", "message", "scenario", "seed", "ticks", "time_step", "every")
        names = [*first, *(item.name for item in fields(self) if item.name not in first)]
        return {"format": FORMAT, **{name: getattr(self, name) for name in names}}


def installed_version(package: str) -> str:
    """Return the version of an installed distribution without importing it, "unknown" if it has none."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def utc_now() -> str:
    """Return the wall-clock time as ISO 8601 in UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def check_every(every: Mapping[str, int], streams: Collection[str]) -> None:
    """Raise UsageError if ``every`` (stream -> decimation) has an unknown stream or no integer from 1."""
    for stream, number in every.items():
        if stream == EVENTS:
            raise UsageError(f"every: '{EVENTS}' are all kept; known: {', '.join(streams)}")
        if stream not in streams:
            raise UsageError(f"every: no stream '{stream}'{did_you_mean(stream, streams)}")
        if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= LARGEST_EVERY:
            raise UsageError(f"every: stream '{stream}': expected an integer from 1 to 2**31 - 1, got {number!r:.100}")


def part_name(number: int) -> str:
    """Return the file name of a stream's Parquet file by its number."""
    return f"part-{number:05d}.parquet"


def stream_schema(stream: str, columns: Sequence[Column], info: RunInfo) -> pa.Schema:
    """Return the Arrow schema of a stream, with units and docs as field metadata.

    Raises:
        UsageError: a column's name is taken twice, or its dtype cannot be stored.
    """
    every = EVENT_COLUMNS if stream == EVENTS else (*INDEX, *columns)
    seen: set[str] = set()
    for column in every:
        if column.name in seen or not column.name:
            raise UsageError(f"stream '{stream}': the column name '{column.name}' is empty or used twice")
        seen.add(column.name)
    metadata = {
        "qrsim.format": str(FORMAT),
        "qrsim.version": info.versions.get("qrsim", "unknown"),
        "qrsim.stream": stream,
        "qrsim.scenario": info.scenario,
        "qrsim.seed": str(info.seed),
    }
    return pa.schema([_arrow_field(stream, column) for column in every], metadata)


def _arrow_field(stream: str, column: Column) -> pa.Field:
    """Return the Arrow field of a column with unit and description; raises UsageError."""
    if column.dtype == "str":
        kind = NAME if column.name in ("vehicle", "kind", "field") else TEXT
        if stream != EVENTS and column not in INDEX:
            raise UsageError(f"stream '{stream}', column '{column.name}': text cannot be recorded here, use an event")
    else:
        try:
            dtype = np.dtype(column.dtype)
        except TypeError:
            dtype = np.dtype(object)
        if dtype.kind not in "fiub" or dtype.name in ("float16", "longdouble", "float128"):
            raise UsageError(
                f"stream '{stream}', column '{column.name}': no dtype '{column.dtype}' in a log; "
                "allowed: float32, float64, bool and the integer types"
            )
        kind = pa.from_numpy_dtype(dtype)
    return pa.field(column.name, kind, metadata={"unit": column.unit, "doc": column.doc})


def column_of(item: pa.Field) -> Column:
    """Parse the metadata of an Arrow field to the ``Column`` that describes it."""
    metadata = item.metadata or {}
    is_text = pa.types.is_dictionary(item.type) or pa.types.is_string(item.type)
    dtype = "str" if is_text else numpy_dtype(item.type).name
    # A damaged file can have anything there.
    unit, doc = (metadata.get(name, b"").decode("utf-8", "replace") for name in (b"unit", b"doc"))
    return Column(item.name, unit, doc, dtype)


def numpy_dtype(kind: pa.DataType) -> DType:
    """Return the NumPy type of an Arrow type of numbers."""
    # By name where names agree, because Arrow's own conversion imports pandas where that is installed.
    name = {"float": "float32", "double": "float64"}.get(str(kind), str(kind))
    if name in ("float32", "float64", "bool") or re.fullmatch(r"u?int(8|16|32|64)", name):
        return np.dtype(name)
    return pa.array([], kind).to_numpy(zero_copy_only=False).dtype
