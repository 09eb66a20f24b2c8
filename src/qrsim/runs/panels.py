"""Plots of any logged quantities over time, one panel below the other; vectors have one for each axis."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.runs.layout import Event
from qrsim.runs.picture import (
    MOST_NAMED,
    binned_text,
    colours_of,
    is_long,
    name_vehicles,
    new_figure,
    spread,
    time_limits,
    title_of,
    trace,
)
from qrsim.runs.quantities import Quantity, find_quantities
from qrsim.runs.reader import Run
from qrsim.runs.summary import stops_of

STYLES: tuple[Any, ...] = ("-", "--", ":", "-.", (0, (6, 1)), (0, (1, 3)), (0, (4, 1, 1, 1, 1, 1)), (0, (9, 3)))
DIRECTIONS = {"x": "north", "y": "east", "z": "down"}


@dataclass(frozen=True)
class Panel:
    """Quantities of one unit that share an axis; ``text`` is the user's request."""

    text: str
    quantities: tuple[Quantity, ...]

    @property
    def label(self) -> str:
        """Axis label with unit: the end that the names of the panel's quantities share, or their common vector."""
        names = [item.column.name.split(".") for item in self.quantities]
        ends = {".".join(name[-2:]) for name in names}
        vectors = {name[-2] if len(name) > 1 else "" for name in names}
        text = ends.pop() if len(ends) == 1 else vectors.pop() if len(vectors) == 1 else ""
        if text[:-2].endswith("_ned") and text[-1] in DIRECTIONS:
            text += f" ({DIRECTIONS[text[-1]]})"
        unit = next((item.column.unit for item in self.quantities if item.column.unit), "")
        return f"{text} [{unit}]".strip() if unit else text


@dataclass(frozen=True)
class Data:
    """Data of the figure.

    Attributes:
        names: (n,) of the vehicles.
        series: quantity -> its times (T,) [s] and values (T, n), NaN from the tick after a vehicle's stop.
        stops: index in ``names`` -> the event that ended its flight, where that is in the span.
        span: first and last time [s].
        last: time of the last tick that was recorded [s].
    """

    names: tuple[str, ...]
    series: dict[Quantity, tuple[Floats, Floats]]
    stops: dict[int, Event]
    span: tuple[float, float]
    last: float


def parse_panel(run: Run, text: str) -> Panel:
    """Parse the quantities of a panel from text, such as "measurements.gnss.position_ned.x, truth.position_ned.x".

    Raises:
        UsageError: unknown or repeated quantities, too many, or different units.
    """
    found: list[Quantity] = []
    for word in text.split(","):
        found += find_quantities(run, word.strip())
    where = f"panel '{text}'"
    for item in found:
        if found.count(item) > 1:
            raise UsageError(f"{where}: {item.name} is given twice")
        # A count or a flag has no unit, a ratio has 1.
        if (item.column.unit or "1") != (found[0].column.unit or "1"):
            units = [f"{other.name} is in {other.column.unit or '1'}" for other in (found[0], item)]
            raise UsageError(f"{where}: {' and '.join(units)}; give each unit its own panel")
    panel = Panel(text, tuple(found))
    most = max(len(axis.quantities) for axis in per_axis(panel))
    if most > len(STYLES):
        raise UsageError(f"{where}: {most} quantities are too many to distinguish; at most {len(STYLES)}")
    return panel


def per_axis(panel: Panel) -> list[Panel]:
    """Split a panel into one for each axis of its vectors; a panel without vectors stays whole."""
    asked = [word.strip() for word in panel.text.split(",")]
    if all(item.name in asked for item in panel.quantities):
        return [panel]
    axes = dict.fromkeys(item.name.rpartition(".")[2] for item in panel.quantities)
    return [
        Panel(f"{panel.text}: {axis}", tuple(item for item in panel.quantities if item.name.endswith(f".{axis}")))
        for axis in axes
    ]


def draw_panels(
    run: Run,
    panels: Sequence[str],
    vehicles: Sequence[str] = (),
    start: float | None = None,
    end: float | None = None,
) -> Figure:
    """Draw logged quantities over time: one panel per text in ``panels``, or per axis of vectors; needs no display.

    Args:
        run: the run.
        panels: one or several quantities each, with commas between; see ``parse_panel``.
        vehicles: names of those to draw; none for all.
        start, end: span of time [s], both included; None for the whole run.

    Raises:
        UsageError: unknown names, different units in a panel, or a span without a tick.
        RunError: nothing was recorded yet, or a part of the log is damaged.
    """
    parsed = [axis for text in panels for axis in per_axis(parse_panel(run, text))]
    data = read_data(run, [item for panel in parsed for item in panel.quantities], vehicles, start, end)
    figure = new_figure(12, max(4.0, 1.2 + 2.4 * len(parsed)))
    every = figure.subplots(len(parsed), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(every, parsed, strict=True):
        _draw_panel(axes, panel, data)
    every[-1].set_xlabel("time [s]")
    time_limits(every[-1], *data.span)
    few = len(data.names) <= MOST_NAMED
    title = title_of(run, data.names, len(data.stops), data.last, " (X)" if few else "")
    shown = "" if start is None and end is None else f"; shown: {data.span[0]:g} to {data.span[1]:g} s"
    binned = max((binned_text(time) for time, _ in data.series.values()), key=len)
    figure.suptitle(f"{title}{'' if few else '; median, quartiles, range'}{shown}{binned}")
    figure.align_ylabels(every)
    if 1 < len(data.names) <= MOST_NAMED:
        name_vehicles(figure, [Line2D([], [], color=c) for c in colours_of(len(data.names))], data.names)
    return figure


def read_data(
    run: Run, wanted: Sequence[Quantity], vehicles: Sequence[str], start: float | None, end: float | None
) -> Data:
    """Read logged quantities in a span of time [s], for the named vehicles or all; raises as ``draw_panels``."""
    for name in vehicles:
        if name not in run.vehicles:
            raise UsageError(f"{run.folder} has no vehicle '{name}'{did_you_mean(name, run.vehicles)}")
    names = tuple(dict.fromkeys(vehicles)) or run.vehicles
    columns = [run.vehicles.index(name) for name in names]
    every_stop = stops_of(run)
    stops = {i: every_stop[column] for i, column in enumerate(columns) if column in every_stop}
    streams = {stream: run[stream] for stream in dict.fromkeys(item.stream for item in wanted)}
    rows = {name: _rows(run, stream.time, start, end) for name, stream in streams.items()}
    series = {}
    for name, stream in streams.items():
        own = [item for item in dict.fromkeys(wanted) if item.stream == name]
        arrays = stream.arrays([item.column.name for item in own])
        flown = np.array([[stops[i].tick if i in stops else np.inf for i in range(len(names))]])
        flying = np.where(stream.tick[rows[name]][:, None] <= flown, 1.0, np.nan)
        for item in own:
            values = arrays[item.column.name][rows[name]][:, columns].astype(np.float64)
            series[item] = (stream.time[rows[name]], values * flying)
    times = [stream.time for stream in streams.values()]
    last = float(max(time[-1] for time in times))
    span = (float(min(time[0] for time in times)) if start is None else start, last if end is None else end)
    seen = {i: stop for i, stop in stops.items() if span[0] <= stop.time <= span[1]}
    return Data(names, series, seen, span, last)


def _rows(run: Run, time: Floats, start: float | None, end: float | None) -> NumpyArray:
    """Return a mask (T,) of the ticks with times in a span, ends included; None is no limit."""
    if not len(time):
        raise RunError(f"{run.folder}: nothing to draw, because no tick was recorded (state: {run.info.state})")
    slack = 1e-6 * run.info.time_step  # for the digits of a time that is a number of steps
    rows = (time >= (time[0] if start is None else start) - slack) & (
        time <= (time[-1] if end is None else end) + slack
    )
    if not rows.any():
        asked = " ".join(f"{word} {t:g} s" for word, t in (("from", start), ("to", end)) if t is not None)
        raise UsageError(f"{run.folder}: no tick {asked}; the log goes from {time[0]:g} s to {time[-1]:g} s")
    return rows


def _draw_panel(axes: Axes, panel: Panel, data: Data) -> None:
    """Draw the quantities of a panel over time, with legend and labels."""
    handles = [line for i, item in enumerate(panel.quantities) for line in _lines(axes, i, item, data)]
    if len(panel.quantities) > 1:
        names = [item.name for item in panel.quantities]
        axes.legend(handles, names, loc="best", fontsize=8, framealpha=0.8)
    axes.set_ylabel(panel.label)
    axes.set_title(textwrap.fill(panel.text, 130), loc="left", fontsize=10)
    types = {np.dtype(item.column.dtype).kind for item in panel.quantities}
    if not types & set("f"):
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    if types == {"b"}:
        axes.set_yticks([0.0, 1.0], ["no", "yes"])
        axes.set_ylim(-0.1, 1.1)
    axes.grid(alpha=0.3)


def _lines(axes: Axes, number: int, item: Quantity, data: Data) -> Iterator[Any]:
    """Draw the ``number``-th quantity of a panel for each vehicle, or its spread; yield one line for the legend."""
    time, values = data.series[item]
    colour = colours_of(MOST_NAMED)[number]
    if len(data.names) > MOST_NAMED:
        yield spread(axes, time, values, colour, STYLES[number])
        return
    # What is counted or switched jumps; a line between two such values would show some that never were.
    form: dict[str, Any] = {"drawstyle": "default" if item.column.dtype.startswith("float") else "steps-post"}
    several = len(data.names) > 1
    form |= {"linestyle": STYLES[number] if several else "-", "lw": 1.2}
    for i, own in enumerate(colours_of(len(data.names))):
        shade = own if several else colour
        trace(axes, time, values[:, i], color=shade, **form)
        if not is_long(time):
            lone = _lone(values[:, i])
            axes.plot(time[lone], values[lone, i], ".", color=shade, ms=4)
        there = np.flatnonzero(np.isfinite(values[:, i]))
        if i in data.stops and len(there):
            axes.plot(data.stops[i].time, values[there[-1], i], "X", color=shade, ms=9, mec="black", zorder=5)
    yield Line2D([], [], color="black" if several else colour, **form)


def _lone(values: Floats) -> Any:
    """Return a mask (T,) of finite values that have NaN on both sides, which a line plot would not show."""
    there = np.concatenate([[False], np.isfinite(values), [False]])
    return there[1:-1] & ~there[:-2] & ~there[2:]
