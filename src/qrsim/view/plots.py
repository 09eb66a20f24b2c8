"""Plots of a recorded run: the catalogue of quantities, and their values over time, thinned with their extremes."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.errors import QrsimError
from qrsim.runs.layout import Event
from qrsim.view.gnss_events import search_words
from qrsim.view.highlights import Highlight, highlights_of
from qrsim.view.recording import Recording
from qrsim.view.satellite_events import first_lost
from qrsim.view.series import Quantity, Series, rows_at
from qrsim.view.server import packed
from qrsim.view.several import Several

# Halves of a normal distribution beyond this many standard deviations hold 2.5 % each.
BAND = 1.96
ESTIMATE, STD, SETPOINT, TRUTH = "commands.estimate.", "commands.estimate_std.", "commands.setpoint.", "truth."
HEIGHT = "derived.height"
# What is plotted together, by the words that people search for: the ending of their columns.
TOGETHER = {
    "north": "position_ned.x",
    "east": "position_ned.y",
    "down": "position_ned.z",
    "velocity north": "velocity_ned.x",
    "velocity east": "velocity_ned.y",
    "velocity down": "velocity_ned.z",
    "roll": "attitude.roll",
    "pitch": "attitude.pitch",
    "yaw": "attitude.yaw",
}
# Levels that plots of these quantities mark.
LEVELS = {"derived.estimate_error_sigmas": BAND, "derived.fence_distance": 0.0}
# Bins of one answer, lines of one request, and events that a page lists.
FEWEST_BINS, MOST_BINS, MOST_LINES, MOST_EVENTS = 10, 2000, 400, 3000
# Losses of satellites in that list.
MOST_LOST = 500
# Values of a page without a server, over all quantities and vehicles; and how many a second of each at most.
MOST_VALUES, FASTEST_HZ = 8_000_000, 10.0


class Plots:
    """The values of a page's plots.

    Args:
        recording: a run, or several.
    """

    def __init__(self, recording: Recording | Several):
        self._recording = recording
        # Browsers ask in threads.
        self._lock = threading.Lock()
        members = recording.members
        self._series = [Series(member, members[0]) for member in members]
        # Number of the run, and of the vehicle in it.
        self._places = [(number, i) for number, member in enumerate(members) for i in range(member.recording.cast.size)]
        self.quantities: dict[str, Quantity] = {}
        on_demand: dict[str, Quantity] = {}
        for series in reversed(self._series):
            self.quantities = {**series.quantities, **self.quantities}
            on_demand = {**series.on_demand, **on_demand}
        self._offered = [*self.quantities.values(), *on_demand.values()]

    def about(self) -> dict[str, object]:
        """Return what the page's plots need, for JSON: quantities, vehicles, runs, events, end [s], groups."""
        recording = self._recording
        return {
            "quantities": [[own.name, own.unit, own.doc] for own in self._offered],
            "together": self._together(),
            "vehicles": list(recording.cast.names),
            "runs": list(recording.cast.runs),
            "runOf": [number for number, _ in self._places],
            "levels": LEVELS,
            "events": listed(sorted([*recording.events, *first_lost(recording.members, MOST_LOST)], key=_time)),
            "end": recording.end,
        }

    def _together(self) -> list[tuple[str, list[str]]]:
        """Return (title, names of quantities) for each set of quantities to plot together."""
        found = []
        for words, ending in TOGETHER.items():
            measured = [name for name in self.quantities if _is_fix(name, ending)]
            own = [f"{part}{ending}" for part in (SETPOINT, ESTIMATE, TRUTH)]
            names = [name for name in own if name in self.quantities] + measured[:1]
            if len(names) > 1:
                found.append((f"{words}: {', '.join(map(_part, names))}", names))
        heights = [name for name in self.quantities if _is_fix(name, "height")]
        if HEIGHT in self.quantities and heights:
            found.append((f"height: truth, {', '.join(map(_part, heights))}", [HEIGHT, *heights]))
        return found

    def highlights(self) -> list[Highlight]:
        """Return the notable moments of all runs: (time [s] or None, text, section of the list)."""
        with self._lock:
            return highlights_of(self._series)

    def answer(self, wish: object) -> bytes | None:
        """Return the plot lines that a browser requests, as bytes; None for a malformed request or empty time span.

        Args:
            wish: ``number``, which the answer repeats; ``lines``, pairs of a quantity and a vehicle; ``from`` and
                ``to`` [s]; ``bins``. With ``highlights``, the head has the highlights of the runs, and nothing follows.

        Returns:
            The length of a head in 4 bytes, the head as JSON, and float32: two times a bin, and for each line two
            values a bin; for a line with a band, its lower and upper end after these.
        """
        if not isinstance(wish, dict) or not isinstance(wish.get("lines"), list):
            return None
        if wish.get("highlights") is True:
            return packed({"number": wish.get("number"), "lines": [], "highlights": self.highlights()})
        wished = [wish.get(name) for name in ("from", "to", "bins")]
        numbers = [float(value) for value in wished if isinstance(value, int | float) and abs(value) < 1e12]
        if len(numbers) < len(wished):
            return None
        start, end, bins = numbers
        count = int(min(MOST_BINS, max(FEWEST_BINS, bins)))
        start, end = max(0.0, start), min(self._recording.end, end)
        if not start < end:
            return None
        edges = np.linspace(start, end, count + 1)
        times = np.repeat(edges[:-1], 2)
        times[1::2] += 0.5 * np.diff(edges)
        lines, parts = [], [times]
        for line in wish["lines"][:MOST_LINES]:
            found = None
            # A damaged part of a log has no line, but other lines have theirs.
            with self._lock, suppress(QrsimError):
                found = self._line(line, edges)
            lines.append(None if found is None else found[0])
            parts += [] if found is None else found[1]
        return packed({"number": wish.get("number"), "lines": lines}, np.concatenate(parts))

    def _line(self, line: object, edges: Floats) -> tuple[dict[str, object], list[Floats]] | None:
        """Return extremes and binned values of ``line``: [quantity, vehicle], between ``edges``; None if unknown."""
        if not (isinstance(line, list) and len(line) == 2 and isinstance(line[0], str) and isinstance(line[1], int)):
            return None
        name, vehicle = line
        if not 0 <= vehicle < len(self._places):
            return None
        run, i = self._places[vehicle]
        series = self._series[run]
        if name not in series.quantities and name not in series.on_demand:
            return None
        time, every = series.values(name)
        values = every[:, i]
        std_name = name.replace(ESTIMATE, STD, 1)
        std = None
        if name.startswith(ESTIMATE) and std_name in series.quantities:
            std = series.values(std_name)[1][:, i]
        head: dict[str, object] = {**extremes(time, values, edges), "band": std is not None}
        parts = [binned(time, values, edges)]
        if std is not None:
            ends = (binned(time, values + side * BAND * std, edges).reshape(-1, 2) for side in (-1.0, 1.0))
            parts += [np.repeat(pick(pair), 2) for pick, pair in zip((_lower, _upper), ends, strict=True)]
        return head, parts

    # ---- pages without a server ----

    def times(self) -> Floats:
        """Return the times (K,) [s] of plotted values in an exported page: evenly spaced, at least two."""
        count = sum(len(own.quantities) * len(own.member.recording.run.vehicles) for own in self._series)
        end = self._recording.end
        return np.linspace(0.0, end, max(2, min(MOST_VALUES // max(1, count), int(end * FASTEST_HZ) + 1)))

    def of_vehicles(self) -> Iterator[Floats]:
        """Yield for each vehicle its plotted values (Q, K), one row per quantity; NaN if its run lacks it."""
        time = self.times()
        for series in self._series:
            kept = series.sampled(time)
            for i in range(len(series.member.recording.run.vehicles)):
                nothing = np.full(len(time), np.nan, np.float32)
                yield np.stack([kept[name][:, i] if name in kept else nothing for name in self.quantities])


def _time(event: Event) -> float:
    """Return the time [s] of an event of a run."""
    return event.time


def listed(events: Sequence[Event]) -> list[tuple[float, str, str, str]]:
    """Return (time [s], kind, text, further words for searches) of each event, at most the first MOST_EVENTS."""
    words = zip(events, search_words(events), strict=True)
    return [(round(own.time, 4), own.kind, own.message or own.kind, more) for own, more in words][:MOST_EVENTS]


def extremes(time: Floats, values: Floats, edges: Floats) -> dict[str, float | None]:
    """Return the smallest and largest value between the outer edges, with times [s]; None if none is finite."""
    first, last = np.searchsorted(time, [edges[0] - 1e-6, edges[-1] + 1e-6])
    part = values[first:last]
    if not np.isfinite(part).any():
        return {"low": None, "high": None, "lowAt": None, "highAt": None}
    low, high = int(np.nanargmin(part)), int(np.nanargmax(part))
    return {
        "low": float(part[low]),
        "high": float(part[high]),
        "lowAt": float(time[first + low]),
        "highAt": float(time[first + high]),
    }


def binned(time: Floats, values: Floats, edges: Floats) -> Floats:
    """Return two values per bin (2 B,): min and max in order of time; with few samples those at start and middle.

    Args:
        time: (T,) sorted [s].
        values: (T,).
        edges: (B + 1,) of the bins [s].
    """
    count = len(edges) - 1
    middles = 0.5 * (edges[:-1] + edges[1:])
    times = np.stack([edges[:-1], middles], axis=1).ravel()
    if not len(time):
        return np.full(2 * count, np.nan)
    starts = np.searchsorted(time, edges - 1e-6)
    # The last bin has both of its ends.
    starts[-1] = np.searchsorted(time, edges[-1] + 1e-6)
    if starts[-1] - starts[0] <= 2 * count:
        found = np.asarray(values[rows_at(time, times)], np.float64)
    else:
        part = values[: starts[-1]]
        firsts = np.minimum(starts[:-1], len(part) - 1)
        low, high = np.fmin.reduceat(part, firsts), np.fmax.reduceat(part, firsts)
        rises = np.abs(part[firsts] - low) <= np.abs(part[firsts] - high)
        found = np.where(rises[:, None], np.stack([low, high], axis=1), np.stack([high, low], axis=1)).ravel()
        found = found.astype(np.float64)
    # The last value holds for as long as the one before did.
    held = time[-1] - time[-2] if len(time) > 1 else 0.0
    found[(times < time[0] - 1e-6) | (times > time[-1] + held)] = np.nan
    return found


def _lower(pairs: Floats) -> Floats:
    """Return the smaller of each pair (B, 2); NaN counts as missing."""
    return np.asarray(np.fmin(pairs[:, 0], pairs[:, 1]))


def _upper(pairs: Floats) -> Floats:
    """Return the larger of each pair (B, 2); NaN counts as missing."""
    return np.asarray(np.fmax(pairs[:, 0], pairs[:, 1]))


def _is_fix(name: str, ending: str) -> bool:
    """Return whether a quantity is a sensor reading with a name that ends so, such as ``position_ned.x``."""
    return name.startswith("measurements.") and name.endswith(f".{ending}")


def _part(name: str) -> str:
    """Return the word for a quantity in a plot's title: the sensor's name for a reading, else such as "truth"."""
    known = {SETPOINT: "set-point", ESTIMATE: "estimate with its 95 % band", TRUTH: "truth"}
    return next((words for start, words in known.items() if name.startswith(start)), name.split(".")[1])
