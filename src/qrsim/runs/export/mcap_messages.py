"""A message of an MCAP file, and those that hold the columns of a log as they are: commands, set-points, sensors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from qrsim.files import Content
from qrsim.runs import Column, Run
from qrsim.runs.export import foxglove
from qrsim.runs.export.output import is_readable
from qrsim.runs.export.place import Place
from qrsim.runs.export.tracks import Samples, read_samples
from qrsim.runs.layout import INDEX

SETPOINT, ESTIMATE = "setpoint", "estimate"


class Message(NamedTuple):
    """A message: time [ns since 1970], topic, name of its schema, content without its timestamp."""

    time_ns: int
    topic: str
    schema: str
    content: Content


class Group(NamedTuple):
    """Columns of a stream that are one message: a command, a set-point, a sensor's reading.

    Attributes:
        name: last part of the topic.
        stream: where they are.
        prefix: of their names, "" or with a dot at the end.
        columns: all of them.
    """

    name: str
    stream: str
    prefix: str
    columns: tuple[Column, ...]

    @property
    def schema(self) -> str:
        """Name of the MCAP schema of this group's messages."""
        return f"qrsim.{self.name}"

    def describe(self) -> foxglove.Schema:
        """Return the JSON schema of this group's messages, with units and meanings of the columns."""
        found: foxglove.Schema = {"type": "object", "properties": {"timestamp": foxglove.TIME}}
        for column in self.columns:
            at = found
            for word in column.name.removeprefix(self.prefix).split("."):
                at = at.setdefault("properties", {}).setdefault(word, {"type": "object"})
            kinds = {"b": "boolean", "i": "integer", "u": "integer"}
            at["type"] = kinds.get(np.dtype(column.dtype).kind, "number")
            at.update({key: text for key, text in (("unit", column.unit), ("description", column.doc)) if text})
        return found


def groups_of(run: Run) -> list[Group]:
    """Return the groups of columns that each become a kind of message: commands, estimates, sensor readings, ..."""
    found: list[Group] = []
    if is_readable(run, "commands"):
        columns = run.describe("commands")[len(INDEX) :]
        for name in (SETPOINT, ESTIMATE):
            found.append(Group(name, "commands", f"{name}.", _columns_with(columns, f"{name}.")))
        parts = {column.name for group in found for column in group.columns}
        found.append(Group("command", "commands", "", tuple(c for c in columns if c.name not in parts)))
    if is_readable(run, "measurements"):
        columns = run.describe("measurements")[len(INDEX) :]
        for sensor in dict.fromkeys(column.name.partition(".")[0] for column in columns):
            found.append(Group(sensor, "measurements", f"{sensor}.", _columns_with(columns, f"{sensor}.")))
    return [group for group in found if group.columns]


def _columns_with(columns: Sequence[Column], prefix: str) -> tuple[Column, ...]:
    """Return those columns of a stream that have names with a prefix."""
    return tuple(column for column in columns if column.name.startswith(prefix))


def messages_of(run: Run, place: Place, every: int, group: Group) -> Iterator[Message]:
    """Yield a message for each row in which the group's values changed; NaN values are left out."""
    topics = topics_of(run, quote(group.name, safe=""))
    names = [column.name for column in group.columns]
    paths = [tuple(name.removeprefix(group.prefix).split(".")) for name in names]
    kinds = [{"b": bool, "i": int, "u": int}.get(np.dtype(column.dtype).kind, float) for column in group.columns]
    last = np.full((len(run.vehicles), len(names)), np.nan)
    for samples in read_samples(run, group.stream, names, lambda ticks: ticks % every == 0):
        rows = changed_rows(samples, last)
        times = place.nanoseconds(samples.times[rows]).tolist()
        for i, row in enumerate(rows.tolist()):
            values = samples.values[row].tolist()
            content: Content = {}
            for path, kind, value in zip(paths, kinds, values, strict=True):
                if math.isfinite(value):
                    _put(content, path, kind(value))
            if content:
                yield Message(times[i], topics[samples.vehicles[row]], group.schema, content)


def _put(content: Content, path: tuple[str, ...], value: object) -> None:
    """Set a value at a path of keys in nested dicts, in place; missing dicts are created."""
    for word in path[:-1]:
        content = content.setdefault(word, {})
    content[path[-1]] = value


def changed_rows(samples: Samples, last: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return indices of rows that differ from the same vehicle's row before; updates ``last`` (n, k), in place."""
    fresh = np.zeros(len(samples.ticks), bool)
    for vehicle in range(len(last)):
        rows = np.flatnonzero(samples.vehicles == vehicle)
        if len(rows):
            values = samples.values[rows]
            before = np.concatenate([last[vehicle][None], values[:-1]])
            same = (values == before) | (np.isnan(values) & np.isnan(before))
            fresh[rows] = ~same.all(axis=1)
            last[vehicle] = values[-1]
    return np.flatnonzero(fresh)


def topics_of(run: Run, *words: str) -> list[str]:
    """Return one topic name per vehicle of the run; ``words`` are its last parts."""
    return ["/".join(("", quote(vehicle, safe=""), *words)) for vehicle in run.vehicles]
