"""The quantities of a run by name: ``truth.position_ned.z``, or ``truth.position_ned`` for its three axes."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from qrsim.errors import RunError, UsageError, did_you_mean, nearest
from qrsim.runs.layout import EVENTS, INDEX, Column
from qrsim.runs.reader import Run


@dataclass(frozen=True)
class Quantity:
    """A column of a stream that has a value for every vehicle at every tick."""

    stream: str
    column: Column

    @property
    def name(self) -> str:
        """Name of the logged quantity, STREAM.COLUMN."""
        return f"{self.stream}.{self.column.name}"


def quantities(run: Run) -> list[Quantity]:
    """Return all logged quantities of a run in the order in which they were recorded."""
    streams = [stream for stream in run.streams if stream != EVENTS]
    return [each for stream in streams for each in _of_stream(run, stream)]


def readable_quantities(run: Run) -> list[Quantity]:
    """Return the logged quantities of all streams, without streams with columns that cannot be read."""
    found: list[Quantity] = []
    for stream in run.streams:
        with suppress(RunError):
            found += _of_stream(run, stream) if stream != EVENTS else []
    return found


def _of_stream(run: Run, stream: str) -> list[Quantity]:
    """Return the logged quantities of a stream; raise RunError if its columns cannot be read."""
    return [Quantity(stream, column) for column in run.describe(stream)[len(INDEX) :]]


def find_quantities(run: Run, name: str) -> list[Quantity]:
    """Return the logged quantities that a name means: one, or the components of a vector or other group.

    Raises:
        UsageError: there is none of this name.
    """
    every = quantities(run)
    found = [item for item in every if item.name == name]
    if found:
        return found
    groups = _groups(every)
    if name in groups:
        return groups[name]
    raise UsageError(_unknown_quantity(run, name, [*groups, *(item.name for item in every)]))


def _groups(every: list[Quantity]) -> dict[str, list[Quantity]]:
    """Return group name -> its quantities, for groups (such as vectors) with only numbers as members.

    ``truth.position_ned`` is a group of three; a sensor with a vector among its quantities is none.
    """
    names = dict.fromkeys(item.name.rpartition(".")[0] for item in every if "." in item.column.name)
    members = {name: [item for item in every if item.name.startswith(f"{name}.")] for name in names}
    return {
        name: parts for name, parts in members.items() if all("." not in part.name[len(name) + 1 :] for part in parts)
    }


def _unknown_quantity(run: Run, name: str, known: list[str]) -> str:
    """Return the error message for a quantity that the run did not log, with near names."""
    if not name:
        return "a panel needs the name of a quantity before, between and after its commas; --list shows all quantities"
    stream, _, column = name.partition(".")
    streams = [own for own in run.streams if own != EVENTS]
    advice = "; --list shows all quantities"
    if stream == EVENTS:
        return f"'{name}': events are not one per vehicle and tick and cannot be drawn; known: {', '.join(streams)}"
    if stream in streams:
        inside = [own for own in known if own.startswith(f"{name}.") and own.rpartition(".")[0] not in known]
        if inside:
            return f"'{name}' is not one quantity but several, such as {', '.join(inside[:3])}{advice}"
        match = nearest(name, [own for own in known if own.startswith(f"{stream}.")])
        what = f"stream '{stream}' has no quantity '{column}'" if column else f"'{name}' names no quantity"
        return what + (f"; did you mean '{match}'?" if match else advice)
    match = nearest(name, known)
    return f"no stream '{stream}' in '{name}'" + (
        f"; did you mean '{match}'?" if match else did_you_mean(stream, streams)
    )
