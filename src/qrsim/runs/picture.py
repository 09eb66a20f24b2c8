"""Shared by all figures of runs: files, colours, titles and the time axis."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.files.atomic import write_atomically
from qrsim.runs.reader import Run

Floats = np.ndarray[Any, Any]
FORMATS = ("png", "pdf", "svg")
# More vehicles have the range over all of them in place of single noisy lines, and no legend.
MOST_NAMED = 10
_ENDED = {
    "running": "still running or killed, drawn up to",
    "interrupted": "interrupted at",
    "failed": "failed at",
}


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches; it needs no display."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_picture(draw: Callable[[], Figure], path: Path) -> None:
    """Draw into a file; its format is checked first.

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
    try:
        write_atomically(path, picture.getvalue())
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from None


def colours_of(count: int) -> Floats:
    """Return colours (count, 4), one per vehicle; neighbours differ clearly while vehicles are few."""
    numbers = np.arange(count)
    return mpl.colormaps["tab10"](numbers) if count <= MOST_NAMED else mpl.colormaps["turbo"](numbers / count)


def title_of(run: Run, vehicles: Sequence[str], stopped: int, end: float, mark: str = " (X)") -> str:
    """Return the title: scenario, vehicles drawn, number stopped, and how the run ended at ``end`` [s]."""
    who = f"{len(vehicles)} vehicle{'s' if len(vehicles) > 1 else ''}"
    if len(vehicles) == 1 < len(run.vehicles):
        who = vehicles[0]
    state = _ENDED.get(run.info.state)
    told = f"{state} {end:g} s" if state else f"{end:g} s"
    return f"{run.info.scenario}, seed {run.info.seed}: {who}{f', {stopped} stopped{mark}' if stopped else ''}, {told}"


def name_vehicles(figure: Figure, handles: Sequence[Any], names: Sequence[str]) -> None:
    """Add a legend of the vehicles' names below the panels."""
    columns = math.ceil(len(names) / 2) if sum(map(len, names)) > 100 else len(names)
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=9)


def spread(axes: Any, time: Floats, values: Floats, colour: Any, style: Any = "-") -> Any:
    """Draw the range and the median of (T, n) values over many vehicles; return the line of the median."""
    # Once all vehicles have stopped there is no value left, and no range; the gap stays a gap.
    some = np.isfinite(values).any(axis=1)
    low, middle, high = (np.full(len(time), np.nan) for _ in range(3))
    low[some], high[some] = np.nanmin(values[some], axis=1), np.nanmax(values[some], axis=1)
    middle[some] = np.nanmedian(values[some], axis=1)
    axes.fill_between(time, low, high, color=colour, alpha=0.25, lw=0)
    return axes.plot(time, middle, linestyle=style, color=colour, lw=1.6)[0]


def time_limits(axes: Any, first: float, last: float) -> None:
    """Set the same time span in every panel; a single tick gets a small span."""
    axes.set_xlim(first, max(last, first + 1e-3))


def from_zero(axes: Any) -> None:
    """Start the vertical axis just below 0, so that a line at 0 stays visible."""
    # Not the digits of nothing where all is zero.
    largest = axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) and axes.dataLim.y1 > 1e-6 else 1.0
    axes.set_ylim(-0.02 * largest, 1.05 * largest)
