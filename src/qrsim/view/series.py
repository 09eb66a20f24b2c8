"""Logged and derived quantities of one run over time, read where they are asked for."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.runs.layout import EVENTS, INDEX
from qrsim.view.derived import ALWAYS, Derived, gnss_error, to_fence
from qrsim.view.readings import sampled
from qrsim.view.recording import Member
from qrsim.view.sky import of_satellites

# Bytes of columns of one run that are kept.
MOST_KEPT = 150_000_000
# Of a derived quantity, in place of the stream.
DERIVED = "derived"
BETWEEN = f"{DERIVED}.run_distance"


@dataclass(frozen=True)
class Quantity:
    """Name (STREAM.COLUMN), unit and meaning of what can be plotted."""

    name: str
    unit: str
    doc: str


class Series:
    """The quantities of a run that can be plotted.

    Args:
        member: the run.
        first: the run that others are compared with.

    Attributes:
        quantities: by name.
    """

    def __init__(self, member: Member, first: Member):
        self.member, self._first, self._run = member, first, member.recording.run
        self._kept: OrderedDict[str, tuple[Floats, Floats]] = OrderedDict()
        logged: list[Quantity] = []
        for stream in self._run.streams:
            # Of a damaged stream there is nothing to plot.
            with suppress(QrsimError):
                columns = self._run.describe(stream)[len(INDEX) :] if stream != EVENTS else ()
                plain = [own for own in columns if own.dtype != "str" and not of_satellites(own.name)]
                logged += [Quantity(f"{stream}.{own.name}", own.unit, own.doc) for own in plain]
        known = {quantity.name: quantity for quantity in logged}
        self._derived = {f"{DERIVED}.{own.name}": own for own in self._possible(set(known))}
        found = {name: Quantity(name, own.unit, own.doc) for name, own in self._derived.items()}
        if member is not first:
            doc = "distance to the vehicle of the same name in the first run, at the time shown"
            found[BETWEEN] = Quantity(BETWEEN, "m", doc)
        self.quantities = {**found, **known}

    def _possible(self, known: set[str]) -> list[Derived]:
        """Return the derived quantities for which the run has the logged columns ``known``."""
        world = self.member.recording.world
        fence = None if world is None else to_fence(world.area)
        ending = ".position_ned.x"
        sensors = [name for name in known if name.startswith("measurements.") and name.endswith(ending)]
        errors = [gnss_error(name.removeprefix("measurements.").removesuffix(ending)) for name in sorted(sensors)]
        every = [*ALWAYS, *errors, *([] if fence is None else [fence])]
        return [own for own in every if known.issuperset(own.needs)]

    def values(self, name: str) -> tuple[Floats, Floats]:
        """Return times (T,) [s] on the page and values (T, n) of a quantity by name; recent results are cached."""
        if name in self._kept:
            self._kept.move_to_end(name)
        else:
            self._kept[name] = self._read(name)
            while sum(values.nbytes for _, values in self._kept.values()) > MOST_KEPT and len(self._kept) > 1:
                self._kept.popitem(last=False)
        return self._kept[name]

    def _read(self, name: str) -> tuple[Floats, Floats]:
        """Read or compute a quantity: return times (T,) [s] on the page and its values (T, n)."""
        shift = self.member.shift
        if name == BETWEEN:
            return self._between()
        if name in self._derived:
            time = self._run["truth"].time
            values = self._derived[name].compute(lambda column: self._at(column, time))
            return time + shift, np.asarray(values, np.float32)
        stream, _, column = name.partition(".")
        times: list[Any] = [np.zeros(0)]
        parts: list[Any] = [np.zeros((0, len(self._run.vehicles)), np.float32)]
        for batch in self._run[stream].batches([column]):
            times.append(batch.time)
            parts.append(batch.arrays[column].astype(np.float32))
        return np.concatenate(times) + shift, np.concatenate(parts)

    def _at(self, name: str, time: Floats) -> Floats:
        """Return a logged column (T, n), with its last value at each of the run's own times (T,) [s]."""
        known, values = self.values(name)
        if len(known) == len(time):
            return values
        return values[rows_at(known - self.member.shift, time)]

    def _between(self) -> tuple[Floats, Floats]:
        """Return times (T,) [s] and distances (T, n) [m] to the same vehicles of the first run, or NaN."""
        recording, other = self.member.recording, self._first.recording
        time = recording.time + self.member.shift
        numbers = {name: i for i, name in enumerate(other.run.vehicles)}
        pairs = [(i, numbers[name]) for i, name in enumerate(self._run.vehicles) if name in numbers]
        found = np.full((len(time), len(self._run.vehicles)), np.nan, np.float32)
        if pairs:
            mine, theirs = (list(numbers) for numbers in zip(*pairs, strict=True))
            places = recording.positions(recording.time)[:, mine] + self.member.offset
            found[:, mine] = np.linalg.norm(places - other.positions(time)[:, theirs], axis=-1)
            found[(time < -1e-6) | (time > self._first.end + 1e-6)] = np.nan
        return time, found

    def sampled(self, time: Floats) -> dict[str, Floats]:
        """Return name -> last values (K, n) up to each time (K,) [s], for all quantities; NaN outside the run."""
        found: dict[str, Floats] = {}
        names = [name for name in self.quantities if name not in self._derived and name != BETWEEN]
        for stream in dict.fromkeys(name.partition(".")[0] for name in names):
            columns = [name.partition(".")[2] for name in names if name.partition(".")[0] == stream]
            with suppress(QrsimError):
                values = sampled(self._run, stream, columns, time - self.member.shift)
                found |= {f"{stream}.{column}": values[column] for column in columns}
        for name in (name for name in self.quantities if name in self._derived or name == BETWEEN):
            with suppress(QrsimError):
                known, own = self.values(name)
                found[name] = own[rows_at(known, time)].copy()
        outside = (time < self.member.shift - 1e-6) | (time > self.member.end + 1e-6)
        for own in found.values():
            own[outside] = np.nan
        return found


def rows_at(known: Floats, time: Floats) -> Any:
    """Return the indices (K,) of the last of the sorted times ``known`` up to each time (K,) [s], at least 0."""
    return np.maximum(0, np.searchsorted(known, np.asarray(time) + 1e-6, side="right") - 1)
