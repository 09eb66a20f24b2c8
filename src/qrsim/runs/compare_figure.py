"""The figure of two runs: both plan views, and the distance of each vehicle between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qrsim.core.arrays import Floats
from qrsim.errors import RunError
from qrsim.runs.picture import MOST_NAMED, colours_of, from_zero, name_vehicles, new_figure, spread, time_limits
from qrsim.runs.reader import Run
from qrsim.runs.summary import vectors

POSITION = "position_ned"


@dataclass(frozen=True)
class _Data:
    """Data of the figure: n vehicles that both runs have, at the T ticks of the truth that both have.

    Attributes:
        names: (n,) of the vehicles.
        time: (T,) [s].
        paths: whole true path in each run, (T1, n, 3) and (T2, n, 3) [m], NED.
        apart: (T, n) distance between the positions in the two runs [m].
    """

    names: tuple[str, ...]
    time: Floats
    paths: tuple[Floats, Floats]
    apart: Floats


def draw_comparison(first: Run, second: Run) -> Figure:
    """Draw the paths of two runs in plan view, and the distance between them over time; needs no display.

    Raises:
        RunError: they have no vehicle or no tick of the truth in common, or a log is damaged.
    """
    data = _read_paths(first, second)
    few = len(data.names) <= MOST_NAMED
    figure = new_figure(13, 6.5)
    plan, distance = figure.subplots(1, 2, width_ratios=(1, 1.1))
    colours = colours_of(len(data.names))
    _draw_plan(plan, data, colours, 1.6 if few else 0.9)
    _draw_distance(distance, data, colours)
    names = [f"A: {first.info.scenario}, seed {first.info.seed}", f"B: {second.info.scenario}, seed {second.info.seed}"]
    folders = [f" ({run.folder})" for run in (first, second)]
    figure.suptitle("\n".join(name + folder for name, folder in zip(names, folders, strict=True)), fontsize=11)
    if few:
        name_vehicles(figure, [Line2D([], [], color=colour) for colour in colours], data.names)
    return figure


def _read_paths(first: Run, second: Run) -> _Data:
    """Return the true positions of the vehicles and ticks that two runs share; raises RunError."""
    for run in (first, second):
        if "truth" not in run or f"{POSITION}.x" not in run["truth"]:
            raise RunError(f"{run.folder} has no truth.{POSITION} to draw")
    names = tuple(name for name in first.vehicles if name in second.vehicles)
    times = [run["truth"].time for run in (first, second)]
    keys = [np.rint(time * 1e9) for time in times]
    _, *rows = np.intersect1d(keys[0], keys[1], assume_unique=True, return_indices=True)
    if not names or not len(rows[0]):
        missing = "vehicle" if not names else "tick of the truth"
        raise RunError(f"{first.folder} and {second.folder} have no {missing} in common: nothing to draw")
    columns = [[run.vehicles.index(name) for name in names] for run in (first, second)]
    paths = [vectors(run["truth"], POSITION)[:, own] for run, own in zip((first, second), columns, strict=True)]
    apart = np.linalg.norm(paths[0][rows[0]] - paths[1][rows[1]], axis=-1)
    return _Data(names, times[0][rows[0]], (paths[0], paths[1]), apart)


def _draw_plan(axes: Axes, data: _Data, colours: Floats, width: float) -> None:
    """Draw the paths of both runs in plan view, in a colour (n, 4) for each vehicle and lines ``width`` points wide."""
    for i, colour in enumerate(colours):
        for path, style in zip(data.paths, ("-", "--"), strict=True):
            axes.plot(path[:, i, 1], path[:, i, 0], style, color=colour, lw=width)
        axes.plot(data.paths[0][:1, i, 1], data.paths[0][:1, i, 0], "o", color=colour, ms=6, mec="white")
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", adjustable="datalim")
    axes.set_title("true paths from above: A solid, B dashed, start o")
    axes.grid(alpha=0.3)


def _draw_distance(axes: Axes, data: _Data, colours: Floats) -> None:
    """Draw the distance [m] between each vehicle's true positions in both runs over time."""
    title = f"distance between the true positions in A and B, at most {np.nanmax(data.apart):.3g} m"
    if len(data.names) <= MOST_NAMED:
        for i, colour in enumerate(colours):
            axes.plot(data.time, data.apart[:, i], color=colour, lw=1.3)
    else:
        spread(axes, data.time, data.apart, colours_of(1)[0])
        title += "; median, range"
    axes.set(xlabel="time [s]", ylabel="distance [m]", title=title)
    time_limits(axes, data.time[0], data.time[-1])
    from_zero(axes)
    axes.grid(alpha=0.3)
