"""The picture of a run: plan view, height, GNSS error and wind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.logs.reader import Run
from qrsim.logs.summary import NOT_A_STOP, gnss_error, gnss_sensor, vectors

MOST_NAMED = 10
FORMATS = ("png", "pdf", "svg")


def draw_run(run: Run) -> Figure:
    """Return the figure of a run (needs no display)."""
    figure = Figure(figsize=(13, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, width_ratios=(1.15, 1))
    colours = mpl.colormaps["tab10"](np.arange(len(run.vehicles)) % 10)
    _plan(axes[0, 0], run, colours)
    _height(axes[0, 1], run, colours)
    _gnss(axes[1, 0], run, colours)
    _wind(axes[1, 1], run, colours)
    figure.suptitle(f"{run.info.scenario}, seed {run.info.seed}: {len(run.vehicles)} vehicles")
    return figure


def save_figure(run: Run, path: Path) -> None:
    """Draw a run into a file.

    Raises:
        UsageError: the ending of the name is none that can be drawn.
        RunError: the file cannot be written.
    """
    ending = path.suffix.removeprefix(".").lower()
    if ending not in FORMATS:
        raise UsageError(f"{path}: cannot draw '{path.suffix}'{did_you_mean(ending, FORMATS)}")
    try:
        draw_run(run).savefig(path, dpi=110)
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from None


def _plan(axes: Any, run: Run, colours: Any) -> None:
    truth = vectors(run["truth"], "position_ned")
    targets = vectors(run["commands"], "setpoint.position_ned")
    sensor = gnss_sensor(run)
    reported = vectors(run["measurements"], f"{sensor}.position_ned") if sensor else None
    named = len(run.vehicles) <= MOST_NAMED
    for i, name in enumerate(run.vehicles):
        if reported is not None:
            axes.plot(reported[:, i, 1], reported[:, i, 0], color=colours[i], lw=0.7, alpha=0.55)
        axes.plot(truth[:, i, 1], truth[:, i, 0], color=colours[i], lw=1.6, label=name if named else None)
        axes.plot(truth[0, i, 1], truth[0, i, 0], "o", color=colours[i], ms=5)
        corners = np.unique(targets[:, i, :2], axis=0)
        axes.plot(corners[:, 1], corners[:, 0], "+", color=colours[i], ms=9)
    for event in run.events:
        if event.kind not in NOT_A_STOP and event.vehicle is not None:
            i = run.vehicles.index(event.vehicle)
            axes.plot(truth[-1, i, 1], truth[-1, i, 0], "X", color=colours[i], ms=10, mec="black")
    _wind_arrow(axes, run)
    axes.set(
        xlabel="east [m]", ylabel="north [m]", aspect="equal", title="paths: true (thick), GNSS (thin), waypoints +"
    )
    axes.set_adjustable("datalim")
    axes.grid(alpha=0.3)
    if named:
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _wind_arrow(axes: Any, run: Run) -> None:
    """Show where the mean wind blows to, in the corner of the plan."""
    mean = vectors(run["wind"], "mean_ned").mean(axis=(0, 1))
    speed = float(np.hypot(mean[0], mean[1]))
    if speed == 0.0:
        axes.text(0.02, 0.98, "no mean wind", transform=axes.transAxes, va="top", fontsize=9)
        return
    step = 0.1 * np.array([mean[1], mean[0]]) / speed
    middle = np.array([0.12, 0.86])
    axes.annotate(
        "", xy=middle + step / 2, xytext=middle - step / 2, xycoords="axes fraction",
        arrowprops={"arrowstyle": "-|>", "lw": 2, "color": "tab:gray"},
    )  # fmt: skip
    axes.text(0.12, 0.97, f"mean wind {speed:.1f} m/s", transform=axes.transAxes, ha="center", va="top", fontsize=9)


def _height(axes: Any, run: Run, colours: Any) -> None:
    truth = run["truth"]
    estimate = next((name for name in run["measurements"].columns() if name.endswith(".height")), None)
    for i in range(len(run.vehicles)):
        if estimate is not None:
            axes.plot(truth.time, run["measurements"][estimate][:, i], color=colours[i], lw=0.7, alpha=0.55)
        axes.plot(truth.time, -truth["position_ned.z"][:, i], color=colours[i], lw=1.4)
    axes.set(xlabel="time [s]", ylabel="height [m]", title="height: true (thick), barometer (thin)")
    axes.grid(alpha=0.3)


def _gnss(axes: Any, run: Run, colours: Any) -> None:
    time, error = gnss_error(run)
    for i in range(error.shape[1]):
        axes.plot(time, np.linalg.norm(error[:, i, :2], axis=-1), color=colours[i], lw=1.2)
        axes.plot(time, np.abs(error[:, i, 2]), color=colours[i], lw=0.9, ls=":")
    title = "GNSS error: horizontal (solid), vertical (dotted)" if len(time) else "no GNSS receiver"
    axes.set(xlabel="time [s]", ylabel="reported minus true [m]", title=title, ylim=(0, None))
    axes.grid(alpha=0.3)


def _wind(axes: Any, run: Run, colours: Any) -> None:
    time = run["wind"].time
    mean, gust = vectors(run["wind"], "mean_ned"), vectors(run["wind"], "gust_ned")
    for i in range(mean.shape[1]):
        axes.plot(time, np.linalg.norm((mean + gust)[:, i], axis=-1), color=colours[i], lw=0.9)
        axes.plot(time, np.linalg.norm(mean[:, i], axis=-1), color=colours[i], lw=0.9, ls=":")
    axes.set(
        xlabel="time [s]", ylabel="air speed over ground [m/s]", title="wind at the vehicle: with gusts, mean (dotted)"
    )
    axes.set_ylim(0, None)
    axes.grid(alpha=0.3)
