"""Shared by all figures of runs: files, colours, titles and the time axis."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import RunError, UsageError, did_you_mean, os_error_as
from qrsim.files.atomic import write_atomically
from qrsim.runs.colours import VEHICLES
from qrsim.runs.reader import Run

FORMATS = ("png", "pdf", "svg")
# More vehicles have the range over all of them in place of single noisy lines, and no legend.
MOST_NAMED = 10
# A line of more ticks than these is drawn as mean and range in so many bins, about one to two pixels of a panel.
MOST_TICKS, BINS = 2000, 400
_ENDED = {
    "running": "still running or killed, drawn up to",
    "interrupted": "interrupted at",
    "failed": "failed at",
}


def new_figure(width: float, height: float) -> Figure:
    """Return an empty Matplotlib figure of a size in inches; it needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_picture(draw: Callable[[], Figure], path: Path) -> None:
    """Check the picture format of ``path``, then call ``draw`` and save its figure there.

    Raises:
        UsageError: the ending of the name is none that can be drawn.
        RunError: the file cannot be written; what was there before is then left alone.
    """
    ending = path.suffix.removeprefix(".").lower()
    if ending not in FORMATS:
        found = f"cannot draw '{path.suffix}'" if ending else "the name of a picture needs an ending"
        raise UsageError(f"{path}: {found}{did_you_mean(ending, FORMATS)}")
    picture = io.BytesIO()
    draw().savefig(picture, dpi=110, format=ending)
    with os_error_as(RunError, f"cannot write {path}"):
        write_atomically(path, picture.getvalue())


def colours_of(count: int) -> Floats:
    """Return colours (count, 4), one per vehicle; neighbours differ clearly while vehicles are few."""
    if count > MOST_NAMED:
        return mpl.colormaps["viridis"](np.arange(count) / count)
    return np.column_stack([VEHICLES[:count] / 255.0, np.ones(count)])


def title_of(run: Run, vehicles: Sequence[str], stopped: int, end: float, mark: str = " (X)") -> str:
    """Return a figure's title: scenario, vehicles drawn, number stopped, and how the run ended at ``end`` [s]."""
    who = f"{len(vehicles)} vehicle{'s' if len(vehicles) > 1 else ''}"
    if len(vehicles) == 1 < len(run.vehicles):
        who = vehicles[0]
    state = _ENDED.get(run.info.state)
    told = f"{state} {end:g} s" if state else f"{end:g} s"
    return f"{run.info.scenario}, seed {run.info.seed}: {who}{f', {stopped} stopped{mark}' if stopped else ''}, {told}"


def name_vehicles(figure: Figure, handles: Sequence[Artist], names: Sequence[str]) -> None:
    """Add a legend of the vehicles' names below the panels of a figure."""
    columns = math.ceil(len(names) / 2) if sum(map(len, names)) > 100 else len(names)
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=9)


class Bins(NamedTuple):
    """Values in bins of time: lowest, mean and highest, (B, n) each, at the middles (B,) [s]; NaN in empty bins."""

    time: Floats
    low: Floats
    mean: Floats
    high: Floats


def binned(time: Floats, values: Floats) -> Bins:
    """Summarise values (T, n) at times (T,) in BINS bins of equal numbers of ticks, for drawing long runs.

    No value is lost to a picture by this: the lowest and the highest of each bin stay what they were.
    """
    first = np.linspace(0, len(time), BINS, endpoint=False).astype(int)
    last = np.append(first[1:], len(time)) - 1
    there = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        mean = np.add.reduceat(np.where(there, values, 0.0), first) / np.add.reduceat(there, first, dtype=np.int64)
    low, high = (over.reduceat(np.where(there, values, np.nan), first) for over in (np.fmin, np.fmax))
    return Bins(0.5 * (time[first] + time[last]), low, mean, high)


def is_long(time: Floats) -> bool:
    """Return whether a line over these times is drawn as bins, because there are many ticks."""
    return len(time) > MOST_TICKS


def binned_text(time: Floats) -> str:
    """Return the note, for a title, that a line over these times shows bins of ticks; "" if it shows every tick."""
    return f"; lines: mean and range of {(time[-1] - time[0]) / BINS:.2g} s each" if is_long(time) else ""


def trace(axes: Axes, time: Floats, values: Floats, **look: Any) -> Any:
    """Draw values (T,) as a line, or many as mean and range in bins, in style ``look``; return the line."""
    if not is_long(time):
        return axes.plot(time, values, **look)[0]
    bins = binned(time, values[:, None])
    # What jumps does so at the ticks, not at the middles of bins.
    look.pop("drawstyle", None)
    [line] = axes.plot(bins.time, bins.mean[:, 0], **look)
    band = {"color": look.get("color"), "alpha": 0.3 * look.get("alpha", 1.0), "lw": 0}
    axes.fill_between(bins.time, bins.low[:, 0], bins.high[:, 0], **band)
    return line


def path_rows(points: Floats, most: int) -> NumpyArray:
    """Return the indices of about ``most`` points of a path (T, 2) that keep its shape and extremes.

    Every so-many-th point would cut the corners off.
    """
    count = len(points)
    if count <= most:
        return np.arange(count)
    width = -(-count // max(1, most // 4))
    # The last point again, where the last bin is not full.
    rows = np.minimum(np.arange(-(-count // width) * width), count - 1).reshape(-1, width)
    inside = points[rows]
    there = np.isfinite(inside)
    ends = [np.where(there, inside, np.inf).argmin(axis=1), np.where(there, inside, -np.inf).argmax(axis=1)]
    kept = [np.take_along_axis(rows, end, axis=1).ravel() for end in ends]
    return np.unique(np.concatenate([*kept, [0, count - 1]]))


def spread(axes: Axes, time: Floats, values: Floats, colour: Any, style: Any = "-") -> Any:
    """Draw median, quartiles and range of values (T, n) over the vehicles against time; return the median's line."""
    # Once all vehicles have stopped there is no value left, and no range; the gap stays a gap.
    some = np.isfinite(values).any(axis=1)
    five = np.full((5, len(time)), np.nan)
    if some.any():
        five[:, some] = np.nanpercentile(values[some], [0, 25, 50, 75, 100], axis=1)
    if is_long(time):
        bins = binned(time, five.T)
        time = bins.time
        five = np.concatenate([bins.low[:, :1], bins.mean[:, 1:4], bins.high[:, 4:]], axis=1).T
    axes.fill_between(time, five[0], five[4], color=colour, alpha=0.18, lw=0)
    axes.fill_between(time, five[1], five[3], color=colour, alpha=0.3, lw=0)
    return axes.plot(time, five[2], linestyle=style, color=colour, lw=1.6)[0]


def time_limits(axes: Axes, first: float, last: float) -> None:
    """Set the limits of a time axis to ``first`` and ``last`` [s]; a single tick gets a small span."""
    axes.set_xlim(first, max(last, first + 1e-3))


def from_zero(axes: Axes) -> None:
    """Start the vertical axis just below 0, so that a line at 0 stays visible."""
    # Not the digits of nothing where all is zero.
    largest = axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) and axes.dataLim.y1 > 1e-6 else 1.0
    axes.set_ylim(-0.02 * largest, 1.05 * largest)
