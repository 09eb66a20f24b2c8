"""Columns of logs: of single vehicles over some time, and of all vehicles at some times; satellites of receivers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.models.gnss.fixes import OF_SATELLITES
from qrsim.runs import Run
from qrsim.runs.layout import INDEX
from qrsim.view.sky import columns_of

# Of satellites: at most so many values of all vehicles together, and so many a second of each.
MOST_OF_SKIES, SKY_HZ = 6_000_000, 1.0
# How far ahead a log is read [s], because time goes on; streams of single vehicles that are kept: of as many browsers
# as half of it with choices of their own.
AHEAD_S, MOST_KEPT = 120.0, 8


class Skies:
    """What receivers said of their satellites, for pages without a server.

    Args:
        run: that is read.
        end: last time [s].
        rate: most values a second of each satellite [Hz].

    Attributes:
        time: (K,) [s]; none where no receiver says anything of them.
    """

    def __init__(self, run: Run, end: float, rate: float = SKY_HZ):
        slots = columns_of(run["measurements"].columns()) if "measurements" in run else []
        self.time, self._names = np.zeros(0), slots
        if not slots:
            return
        values = len(slots) * len(OF_SATELLITES) * len(run.vehicles)
        self.time = np.linspace(0.0, end, max(2, min(MOST_OF_SKIES // values, int(end * rate) + 1)))
        columns = [name for slot in slots for name in slot.values()]
        self._sampled = sampled(run, "measurements", columns, self.time)

    def of_vehicles(self) -> Iterator[dict[str, Floats]]:
        """Yield for each vehicle field -> array (slots, K) of its satellites; angles in degrees, NaN as -1."""
        count = next(iter(self._sampled.values())).shape[1] if len(self.time) else 0
        for i in range(count):
            found = {
                field: np.stack([self._sampled[slot[field]][:, i] for slot in self._names]) for field in OF_SATELLITES
            }
            for field in ("azimuth", "elevation"):
                found[field] = np.degrees(found[field])
            # Whole numbers take little room.
            yield {field: np.nan_to_num(np.round(values), nan=-1.0) for field, values in found.items()}


class Excerpts:
    """What single vehicles measured over some time, read from a long log where it is asked for.

    Args:
        run: what is read.
    """

    def __init__(self, run: Run):
        self._run = run
        self._kept: dict[tuple[int, str], tuple[float, float, Floats, dict[str, Floats]]] = {}

    def of(self, vehicle: int, stream: str, start: float, end: float) -> tuple[Floats, dict[str, Floats]]:
        """Return times (T,) [s] and column -> values (T,) of a vehicle that cover ``start`` to ``end`` [s], cached."""
        kept = self._kept.pop((vehicle, stream), None)
        if kept is None or start < kept[0] or end > kept[1]:
            kept = self._read(vehicle, stream, start, end + AHEAD_S)
        while len(self._kept) >= MOST_KEPT:
            self._kept.pop(next(iter(self._kept)))
        self._kept[vehicle, stream] = kept
        return kept[2], kept[3]

    def _read(
        self, vehicle: int, stream: str, start: float, end: float
    ) -> tuple[float, float, Floats, dict[str, Floats]]:
        """Read a part of a log stream: return its start, end and times [s], and column -> values of a vehicle."""
        names = _numbers(self._run, stream)
        times, parts = [np.zeros(0)], {name: [np.zeros(0)] for name in names}
        for batch in self._run[stream].batches(names, start=start, end=end):
            times.append(batch.time)
            for name in names:
                parts[name].append(batch.arrays[name][:, vehicle].astype(np.float64))
        return start, end, np.concatenate(times), {name: np.concatenate(found) for name, found in parts.items()}


def _numbers(run: Run, stream: str) -> list[str]:
    """Return the names of a log stream's floating-point columns."""
    return [column.name for column in run.describe(stream)[len(INDEX) :] if column.dtype.startswith("float")]


def sampled(run: Run, stream: str, names: list[str], time: Floats) -> dict[str, Floats]:
    """Read columns of a log stream in one pass: name -> last values (K, n) up to each time (K,) [s]."""
    known = run[stream].time
    rows = np.maximum(0, np.searchsorted(known, time + 1e-6, side="right") - 1)
    found = {name: np.empty((len(time), len(run.vehicles)), np.float32) for name in names}
    seen = 0
    for batch in run[stream].batches(names):
        first, last = np.searchsorted(rows, [seen, seen + len(batch.time)])
        for name in names:
            found[name][first:last] = batch.arrays[name][rows[first:last] - seen]
        seen += len(batch.time)
    return found
