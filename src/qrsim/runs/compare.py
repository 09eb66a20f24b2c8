"""Differences of the logs of two runs: vehicles, streams, ticks, and every quantity at common ticks.

Ticks are matched by their time, so that logs of different decimation or step can be compared too; a value that is not
a number equals another that is not. The logs are read part by part.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.runs.layout import EVENTS, INDEX, Event
from qrsim.runs.reader import Run
from qrsim.runs.settings import Setting, setting_differences
from qrsim.runs.stream_arrays import Stream

Names = tuple[str, ...]


@dataclass(frozen=True)
class Moment:
    """A time [s], a vehicle, and the values of a quantity in the first and the second run."""

    time: float
    vehicle: str
    values: tuple[float, float]


@dataclass(frozen=True)
class Difference:
    """Difference of one quantity between two runs.

    Attributes:
        quantity: stream and column.
        unit: of the quantity.
        first: where the values differ for the first time by more than the tolerance.
        largest: where they differ most; None where never both are a number.
        largest_difference, rms: of the values that are a number in both, of all vehicles; NaN where there is none.
        unmatched: how many values are a number in one run only.
        share: rms over the range of the values, to compare quantities of different units.
    """

    quantity: str
    unit: str
    first: Moment
    largest: Moment | None
    largest_difference: float
    rms: float
    unmatched: int
    share: float


@dataclass(frozen=True)
class StreamComparison:
    """Comparison of a stream that both runs have.

    Attributes:
        stream: its name.
        ticks: how many both have.
        ticks_only: how many only the first, only the second has.
        columns_only: those that only the first, only the second has.
        other_units: columns whose unit is another, which are not compared.
        equal: how many quantities are the same at all common ticks.
        differences: the others, what differs first and most in front.
        bit_identical: whether all of it is the same to the last bit.
    """

    stream: str
    ticks: int
    ticks_only: tuple[int, int]
    columns_only: tuple[Names, Names]
    other_units: Names
    equal: int
    differences: tuple[Difference, ...]
    bit_identical: bool

    @property
    def same(self) -> bool:
        """Whether both runs logged the same ticks and quantities of the stream, equal within the tolerance."""
        return not (any(self.ticks_only) or any(self.columns_only) or self.other_units or self.differences)


@dataclass(frozen=True)
class EventComparison:
    """Number of events in both runs, and the events in only one of them."""

    equal: int
    only: tuple[tuple[Event, ...], tuple[Event, ...]]


@dataclass(frozen=True)
class InjectionComparison:
    """Number of injections in both runs, and the entries in only one of them; ``asked_by`` is ignored."""

    equal: int
    only: tuple[tuple[Content, ...], tuple[Content, ...]]


@dataclass(frozen=True)
class Comparison:
    """All differences of two runs.

    Attributes:
        settings: differences of seed, versions, scenario and the like.
        vehicles: those that both have.
        vehicles_only, streams_only: those that only the first, only the second has.
        streams: the streams that both have.
        events: None where they were not asked for.
        injections: what was injected in flight; as settings, they do not count.
        tolerance: up to which floating-point values are the same, in their own units.
    """

    settings: tuple[Setting, ...]
    vehicles: Names
    vehicles_only: tuple[Names, Names]
    streams_only: tuple[Names, Names]
    streams: tuple[StreamComparison, ...]
    events: EventComparison | None
    injections: InjectionComparison
    tolerance: float

    @property
    def differences(self) -> list[Difference]:
        """All logged quantities that differ between two runs, by time of first difference, then by size."""
        return _by_time([item for stream in self.streams for item in stream.differences])

    @property
    def same(self) -> bool:
        """Whether all differences of the two runs' logs are within the tolerance; settings do not count."""
        missing = any(self.vehicles_only) or any(self.streams_only)
        other_events = self.events is not None and any(self.events.only)
        return not missing and not other_events and all(stream.same for stream in self.streams)

    @property
    def bit_identical(self) -> bool:
        """Whether the two runs' logs are the same to the last bit."""
        return self.same and all(stream.bit_identical for stream in self.streams)


def compare_runs(first: Run, second: Run, tolerance: float = 0.0, streams: Sequence[str] = ()) -> Comparison:
    """Compare settings, logs, events and injections of two runs; numbers within ``tolerance`` of each other are equal.

    Args:
        first, second: the runs.
        tolerance: up to which floating-point values are the same, in their own units; flags and counts must be equal.
        streams: those to compare; none for all, events included.

    Raises:
        UsageError: neither run has such a stream.
        RunError: a log is damaged.
    """
    known = tuple(dict.fromkeys([*first.streams, *second.streams]))
    for name in streams:
        if name not in known:
            raise UsageError(f"neither run has a stream '{name}'{did_you_mean(name, known)}")
    wanted = tuple(name for name in known if not streams or name in streams)
    both = [name for name in wanted if name in first and name in second]
    vehicles = tuple(name for name in first.vehicles if name in second.vehicles)
    return Comparison(
        settings=tuple(setting_differences(first, second)),
        vehicles=vehicles,
        vehicles_only=_only(first.vehicles, second.vehicles),
        streams_only=_only([name for name in wanted if name in first], [name for name in wanted if name in second]),
        streams=tuple(_compare_stream(first, second, name, vehicles, tolerance) for name in both if name != EVENTS),
        events=_compare_events(first.events, second.events, tolerance) if EVENTS in both else None,
        injections=_compare_injections(first.injections, second.injections),
        tolerance=tolerance,
    )


def _only(first: Sequence[str], second: Sequence[str]) -> tuple[Names, Names]:
    """Return (names in ``first`` but not in ``second``, names in ``second`` but not in ``first``)."""
    return tuple(name for name in first if name not in second), tuple(name for name in second if name not in first)


def _by_time(found: list[Difference]) -> list[Difference]:
    """Sort the differences of logged quantities by the time of first difference, then by size."""
    return sorted(found, key=lambda item: (item.first.time, -item.share))


def _compare_stream(first: Run, second: Run, name: str, vehicles: Names, tolerance: float) -> StreamComparison:
    """Compare all columns of a stream that two runs share, for ``vehicles`` and the ticks that both runs logged."""
    own, other = first.describe(name)[len(INDEX) :], second.describe(name)[len(INDEX) :]
    units = {column.name: column.unit for column in other}
    other_units = tuple(c.name for c in own if c.name in units and units[c.name] != c.unit)
    shared = [c for c in own if c.name in units and c.name not in other_units]
    tallies = {c.name: _Tally(f"{name}.{c.name}", c.unit, vehicles, tolerance) for c in shared}
    pair = _Pair(*(_Side(run[name], list(tallies), vehicles) for run in (first, second)))
    ticks = 0
    for times, mine, others in pair.pieces():
        ticks += len(times)
        for column, tally in tallies.items():
            tally.add(times, mine[column], others[column])
    differences = [found for tally in tallies.values() if (found := tally.difference())]
    return StreamComparison(
        stream=name,
        ticks=ticks,
        ticks_only=(pair.only[0], pair.only[1]),
        columns_only=_only([c.name for c in own], [c.name for c in other]),
        other_units=other_units,
        equal=len(tallies) - len(differences),
        differences=tuple(_by_time(differences)),
        bit_identical=all(tally.bit_identical for tally in tallies.values()),
    )


class _Side:
    """One run's side of a stream, read part by part and given away up to a time."""

    def __init__(self, stream: Stream, names: list[str], vehicles: Names):
        self._batches = stream.batches(names)
        self._columns = [stream.vehicles.index(name) for name in vehicles]
        self.keys: NumpyArray = np.zeros(0, np.int64)
        self._times: NumpyArray = np.zeros(0)
        self._arrays: dict[str, NumpyArray] = {}

    def fill(self) -> bool:
        """Read the next batch of one run's stream once the last is used up; return False at the end of the stream."""
        while not len(self.keys):
            batch = next(self._batches, None)
            if batch is None:
                return False
            # Whole nanoseconds: two times that are the same were computed from steps that may differ.
            self.keys, self._times = np.rint(batch.time * 1e9).astype(np.int64), batch.time
            self._arrays = {name: array[:, self._columns] for name, array in batch.arrays.items()}
        return True

    def take(self, until: int) -> tuple[NumpyArray, NumpyArray, dict[str, NumpyArray]]:
        """Remove and return ticks up to a time [ns]: times [ns] (T,), times [s] (T,), and column -> values (T, n)."""
        count = int(np.searchsorted(self.keys, until, side="right"))
        taken = self.keys[:count], self._times[:count], {name: a[:count] for name, a in self._arrays.items()}
        self.keys, self._times = self.keys[count:], self._times[count:]
        self._arrays = {name: array[count:] for name, array in self._arrays.items()}
        return taken


class _Pair:
    """Both sides of a stream; ``only`` counts the ticks that one side has and the other lacks."""

    def __init__(self, first: _Side, second: _Side):
        self._sides = (first, second)
        self.only = [0, 0]

    def pieces(self) -> Iterator[tuple[NumpyArray, dict[str, NumpyArray], dict[str, NumpyArray]]]:
        """Yield times (T,) [s] and each run's columns by name (T, n), in batches of the ticks that both runs logged."""
        first, second = self._sides
        while first.fill() & second.fill():
            until = int(min(first.keys[-1], second.keys[-1]))
            (keys, times, mine), (other_keys, _, others) = first.take(until), second.take(until)
            _, rows, other_rows = np.intersect1d(keys, other_keys, assume_unique=True, return_indices=True)
            self.only[0] += len(keys) - len(rows)
            self.only[1] += len(other_keys) - len(rows)
            if len(rows):
                yield (
                    times[rows],
                    {name: array[rows] for name, array in mine.items()},
                    {name: array[other_rows] for name, array in others.items()},
                )
        for i, side in enumerate(self._sides):
            while side.fill():
                self.only[i] += len(side.take(int(side.keys[-1]))[0])


@dataclass
class _Tally:
    """Adds up how a quantity differs."""

    quantity: str
    unit: str
    vehicles: Names
    tolerance: float
    first: Moment | None = None
    largest: Moment | None = None
    bit_identical: bool = True
    _squares: float = 0.0
    _count: int = 0
    _unmatched: int = 0
    _range: list[float] = field(default_factory=lambda: [math.inf, -math.inf])

    def add(self, times: NumpyArray, mine: NumpyArray, others: NumpyArray) -> None:
        """Add values (T, n) of one quantity in the first (``mine``) and second (``others``) run to the statistics."""
        if not mine.size:
            return
        self.bit_identical &= _same_bits(mine, others)
        exact = mine.dtype.kind != "f" and others.dtype.kind != "f"
        x, y = mine.astype(np.float64), others.astype(np.float64)
        there = ~(np.isnan(x) | np.isnan(y))
        unmatched = np.isnan(x) != np.isnan(y)
        with np.errstate(invalid="ignore"):
            # Where both are infinite, they are equal, though their difference is not a number.
            apart = np.where(x == y, 0.0, np.abs(x - y))
        over = unmatched | (there & (apart > (0.0 if exact else self.tolerance)))
        if self.first is None and over.any():
            self.first = self._moment(times, x, y, int(np.argmax(over)))
        self._unmatched += int(unmatched.sum())
        if not there.any():
            return
        apart = np.where(there, apart, -1.0)
        place = int(np.argmax(apart))
        if self.largest is None or apart.flat[place] > self.largest_difference:
            self.largest = self._moment(times, x, y, place)
        self._squares += float(np.square(apart[there]).sum())
        self._count += int(there.sum())
        self._range[0] = min(self._range[0], float(x[there].min()), float(y[there].min()))
        self._range[1] = max(self._range[1], float(x[there].max()), float(y[there].max()))

    @property
    def largest_difference(self) -> float:
        """The largest difference of the quantity between the two runs so far; NaN if nothing was compared."""
        if self.largest is None:
            return math.nan
        x, y = self.largest.values
        return 0.0 if x == y else abs(x - y)

    def difference(self) -> Difference | None:
        """Return the statistics of the quantity's differences; None if no value differs by more than the tolerance."""
        if self.first is None:
            return None
        rms = math.sqrt(self._squares / self._count) if self._count else math.nan
        extent = self._range[1] - self._range[0]
        share = rms / extent if self._count and 0.0 < extent < math.inf else math.inf
        return Difference(
            self.quantity, self.unit, self.first, self.largest, self.largest_difference, rms, self._unmatched, share
        )

    def _moment(self, times: NumpyArray, x: NumpyArray, y: NumpyArray, place: int) -> Moment:
        """Return time, vehicle and both runs' values ``x`` and ``y`` (T, n) at the flat index ``place``."""
        row, column = divmod(place, x.shape[1])
        return Moment(float(times[row]), self.vehicles[column], (float(x[row, column]), float(y[row, column])))


def _same_bits(first: NumpyArray, second: NumpyArray) -> bool:
    """Return whether two arrays have the same type and bits, counting NaN as equal to NaN."""
    if first.dtype != second.dtype:
        return False
    if first.dtype.kind != "f":
        return bool(np.array_equal(first, second))
    whole = f"i{first.dtype.itemsize}"
    same = np.ascontiguousarray(first).view(whole) == np.ascontiguousarray(second).view(whole)
    return bool((same | (np.isnan(first) & np.isnan(second))).all())


def _compare_injections(first: Sequence[Content], second: Sequence[Content]) -> InjectionComparison:
    """Compare two runs' lists of in-flight injections: return how many are equal, and those that only one run has."""
    left = Counter(map(_injection_key, second))
    only = [entry for entry in first if not _taken(left, entry)]
    rest = Counter(map(_injection_key, first))
    return InjectionComparison(
        len(first) - len(only), (tuple(only), tuple(entry for entry in second if not _taken(rest, entry)))
    )


def _taken(left: Counter[str], entry: Content) -> bool:
    """Remove one injection from a multiset of injections; return False if the multiset has no equal one."""
    asked = _injection_key(entry)
    left[asked] -= 1
    return left[asked] >= 0


def _injection_key(entry: Content) -> str:
    """Return an injection as text for comparison, without the name of its sender."""
    return json.dumps({name: value for name, value in entry.items() if name != "asked_by"}, sort_keys=True)


def _compare_events(first: Sequence[Event], second: Sequence[Event], tolerance: float) -> EventComparison:
    """Pair two runs' events of equal time, vehicle, kind and field in order; return how many agree, and the others."""
    groups: dict[tuple[int, str, str, str], tuple[list[Event], list[Event]]] = {}
    for side, events in enumerate((first, second)):
        for event in events:
            key = (round(event.time * 1e9), event.vehicle or "", event.kind, event.field or "")
            groups.setdefault(key, ([], []))[side].append(event)
    equal = 0
    only: tuple[list[Event], list[Event]] = ([], [])
    for key in sorted(groups):
        mine, others = groups[key]
        for a, b in zip(mine, others, strict=False):
            if _is_close(a.value, b.value, tolerance):
                equal += 1
            else:
                only[0].append(a)
                only[1].append(b)
        only[0].extend(mine[len(others) :])
        only[1].extend(others[len(mine) :])
    return EventComparison(equal, (tuple(only[0]), tuple(only[1])))


def _is_close(first: float | None, second: float | None, tolerance: float) -> bool:
    """Return whether two numbers are equal within a tolerance; NaN equals NaN, None equals None."""
    if first is None or second is None:
        return first is second
    return first == second or abs(first - second) <= tolerance or (math.isnan(first) and math.isnan(second))
