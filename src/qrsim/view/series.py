"""Logged and derived quantities of one run over time, read where they are asked for."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.runs.layout import EVENTS, INDEX, Event
from qrsim.view.derived import ALWAYS, CHARGE, FENCE, NEAREST, Derived, distance_to, gnss_error, to_fence
from qrsim.view.readings import sampled
from qrsim.view.reasons import LEFT, outside_by
from qrsim.view.recording import Member
from qrsim.view.sky import of_satellites

# Bytes of columns of one run that are kept.
MOST_KEPT = 150_000_000
# Of a derived quantity, in place of the stream.
DERIVED = "derived"
BETWEEN = f"{DERIVED}.run_distance"
# Says itself whether a vehicle flies, so it does not end with the flight.
VALID = "truth.valid"
# Kind and field of events of stops.
COLLISION, EMPTY = ("collision", "distance"), ("battery_empty", "charge")
# Times that differ by less [s] are the same.
SAME = 1e-6


@dataclass(frozen=True)
class Quantity:
    """Name (STREAM.COLUMN), unit and meaning of what can be plotted."""

    name: str
    unit: str
    doc: str


class Series:
    """The quantities of a run that can be plotted, while each vehicle flies: NaN from its stop on.

    At a stop itself, quantities that its event has a value for have that value, such as the depth outside the fence.

    Args:
        member: the run.
        first: the run that others are compared with.

    Attributes:
        quantities: by name.
        on_demand: further quantities, one for each vehicle, which pages without a server compute themselves.
        ends: (n,) times of the vehicles' stops [s] on the page; infinite for those that did not stop.
    """

    def __init__(self, member: Member, first: Member):
        self.member, self._first, self._run = member, first, member.recording.run
        self._kept: OrderedDict[str, tuple[Floats, Floats]] = OrderedDict()
        self.ends = _ends(member)
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
        own = [distance_to(name, i) for i, name in enumerate(self._run.vehicles) if len(self._run.vehicles) > 1]
        pairs = {f"{DERIVED}.{each.name}": each for each in own if known.keys() >= set(each.needs)}
        self.on_demand = {name: Quantity(name, each.unit, each.doc) for name, each in pairs.items()}
        self._computed = {**self._derived, **pairs}

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
            time, found = self._between()
            return time, self._flown(name, time, found)
        if name in self._computed:
            time = self._run["truth"].time
            values = self._computed[name].compute(lambda column: self._at(column, time))
            return time + shift, self._flown(name, time + shift, np.asarray(values, np.float32))
        stream, _, column = name.partition(".")
        times: list[Any] = [np.zeros(0)]
        parts: list[Any] = [np.zeros((0, len(self._run.vehicles)), np.float32)]
        for batch in self._run[stream].batches([column]):
            times.append(batch.time)
            parts.append(batch.arrays[column].astype(np.float32))
        time = np.concatenate(times) + shift
        return time, self._flown(name, time, np.concatenate(parts))

    def _flown(self, name: str, time: Floats, values: Floats) -> Floats:
        """Return a quantity's values (T, n) at times (T,) [s] on the page, with NaN from each vehicle's stop on.

        The first time from a stop on has what the stop's event says about the quantity.
        """
        if name == VALID or not len(time):
            return values
        found = values if values.flags.writeable else values.copy()
        for event, vehicle in self.member.recording.stops:
            row = int(np.searchsorted(time, self.ends[vehicle] - SAME))
            found[row:, vehicle] = np.nan
            said = self._said(name, event, vehicle)
            if row < len(time) and said is not None:
                found[row, vehicle] = said
        return found

    def _said(self, name: str, event: Event, vehicle: int) -> float | None:
        """Return the value of a quantity of a vehicle that the event of its stop has; None without one."""
        if name == FENCE and event.kind == LEFT:
            world = self.member.recording.world
            far = outside_by(event.field, event.value, None if world is None else world.area)
            # The distance is to sides and ceiling, not to the floor.
            return None if far is None or "floor" in far[1] else -far[0]
        what = (event.kind, event.field)
        if what == COLLISION and name in self.on_demand:
            other = self.nearest_at(vehicle, self.ends[vehicle], flying=False)
            return event.value if other is not None and name == self._distance_to(other) else None
        return event.value if (name, what) in ((NEAREST, COLLISION), (CHARGE, EMPTY)) else None

    def _distance_to(self, vehicle: int) -> str:
        """Return the name of the quantity "distance to this vehicle"."""
        return f"{DERIVED}.distance_to.{self._run.vehicles[vehicle]}"

    def nearest_at(self, vehicle: int, time: float, flying: bool = True) -> int | None:
        """Return the number of the vehicle nearest to another one at a time [s] on the page; None if there is none.

        Args:
            vehicle: number of the other one.
            time: on the page [s].
            flying: vehicles that stopped before do not count; False: they count where they stopped.
        """
        places = self.member.recording.positions(np.array([time - self.member.shift]))[0]
        apart = np.linalg.norm(places - places[vehicle], axis=-1)
        apart[vehicle] = np.inf
        apart[~np.isfinite(apart) | (flying & (self.ends < time - SAME))] = np.inf
        return int(np.argmin(apart)) if np.isfinite(apart).any() else None

    def _at(self, name: str, time: Floats) -> Floats:
        """Return a logged column (T, n), with its last value at each of the run's own times (T,) [s]."""
        known, values = self.values(name)
        if len(known) == len(time):
            return values
        return values[rows_at(known - self.member.shift, time)]

    def _between(self) -> tuple[Floats, Floats]:
        """Return times (T,) [s] and distances (T, n) [m] to the same vehicles of the first run, or NaN."""
        recording, other, ends = self.member.recording, self._first.recording, _ends(self._first)
        time = recording.time + self.member.shift
        numbers = {name: i for i, name in enumerate(other.run.vehicles)}
        pairs = [(i, numbers[name]) for i, name in enumerate(self._run.vehicles) if name in numbers]
        found = np.full((len(time), len(self._run.vehicles)), np.nan, np.float32)
        if pairs:
            mine, theirs = (list(numbers) for numbers in zip(*pairs, strict=True))
            places = recording.positions(recording.time)[:, mine] + self.member.offset
            found[:, mine] = np.linalg.norm(places - other.positions(time)[:, theirs], axis=-1)
            found[(time < -SAME) | (time > self._first.end + SAME)] = np.nan
            for i, number in pairs:
                found[time >= ends[number] - SAME, i] = np.nan
        return time, found

    def sampled(self, time: Floats) -> dict[str, Floats]:
        """Return name -> last values (K, n) up to each time (K,) [s], for all quantities; NaN outside the run."""
        found: dict[str, Floats] = {}
        names = [name for name in self.quantities if name not in self._derived and name != BETWEEN]
        for stream in dict.fromkeys(name.partition(".")[0] for name in names):
            columns = [name.partition(".")[2] for name in names if name.partition(".")[0] == stream]
            with suppress(QrsimError):
                values = sampled(self._run, stream, columns, time - self.member.shift)
                for column in columns:
                    found[f"{stream}.{column}"] = self._flown(f"{stream}.{column}", time, values[column])
        for name in (name for name in self.quantities if name in self._derived or name == BETWEEN):
            with suppress(QrsimError):
                known, own = self.values(name)
                found[name] = self._flown(name, time, own[rows_at(known, time)].copy())
        outside = (time < self.member.shift - SAME) | (time > self.member.end + SAME)
        for own in found.values():
            own[outside] = np.nan
        return found


def _ends(member: Member) -> Floats:
    """Return when each vehicle of a run stopped (n,) [s] on the page; infinite for those that did not."""
    ends = np.full(len(member.recording.run.vehicles), np.inf)
    for event, vehicle in member.recording.stops:
        ends[vehicle] = event.time + member.shift
    return ends


def rows_at(known: Floats, time: Floats) -> Any:
    """Return the indices (K,) of the last of the sorted times ``known`` up to each time (K,) [s], at least 0."""
    return np.maximum(0, np.searchsorted(known, np.asarray(time) + 1e-6, side="right") - 1)
