"""The picture of a run: plan view, height, GNSS error and wind."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from qrsim.errors import RunError, UsageError, did_you_mean
from qrsim.logs.layout import Event
from qrsim.logs.reader import Run
from qrsim.logs.summary import NOT_A_STOP, gnss_sensor, vectors, waypoints_of
from qrsim.logs.writer import write_atomically

Floats = np.ndarray[Any, Any]
FORMATS = ("png", "pdf", "svg")
STREAMS = ("truth", "measurements", "commands", "wind")
# More vehicles have numbers in place of a legend, and the range over all of them in place of single noisy lines.
MOST_NAMED = 10
MOST_NUMBERED = 60
_ENDED = {
    "running": "still running or killed, drawn up to",
    "interrupted": "interrupted at",
    "failed": "failed at",
}


@dataclass(frozen=True)
class _Data:
    """What is drawn: T ticks of n vehicles.

    Attributes:
        names: (n,) of the vehicles.
        time: (T,) [s].
        flying: (T, n), 1 until a vehicle stops, NaN after.
        position, setpoint: (T, n, 3) [m], NED.
        reported: (T, n, 3) [m], what GNSS says; None without a receiver.
        barometer: (T, n) height [m]; None without a barometer.
        mean, gust: (T, n, 3) [m/s], NED.
        stops: vehicle -> the event that ended its flight.
        colours: (n, 4).
    """

    names: tuple[str, ...]
    time: Floats
    flying: Floats
    position: Floats
    setpoint: Floats
    reported: Floats | None
    barometer: Floats | None
    mean: Floats
    gust: Floats
    stops: dict[int, Event]
    colours: Floats

    @property
    def few(self) -> bool:
        """Whether each vehicle can have a line of its own in every panel."""
        return len(self.names) <= MOST_NAMED


def draw_run(run: Run) -> Figure:
    """Return the figure of a run (needs no display).

    Raises:
        RunError: nothing was recorded yet, or a part of the log is damaged.
    """
    data = _read(run)
    figure = Figure(figsize=(13, 9), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2, width_ratios=(1.15, 1))
    _plan(axes[0, 0], data)
    _height(axes[0, 1], data)
    _gnss(axes[1, 0], data)
    _wind(axes[1, 1], data)
    figure.suptitle(_title(run, data))
    if data.few:
        columns = math.ceil(len(data.names) / 2) if sum(map(len, data.names)) > 100 else len(data.names)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=columns, fontsize=9)
    return figure


def save_figure(run: Run, path: Path) -> None:
    """Draw a run into a file.

    Raises:
        UsageError: the ending of the name is none that can be drawn.
        RunError: nothing was recorded yet, or the file cannot be written; what was there before is then left alone.
    """
    ending = path.suffix.removeprefix(".").lower()
    if ending not in FORMATS:
        found = f"cannot draw '{path.suffix}'" if ending else "the name of a picture needs an ending"
        raise UsageError(f"{path}: {found}{did_you_mean(ending, FORMATS)}")
    picture = io.BytesIO()
    draw_run(run).savefig(picture, dpi=110, format=ending)
    try:
        write_atomically(path, picture.getvalue())
    except OSError as error:
        raise RunError(f"cannot write {path}: {error.strerror or error}") from None


def _read(run: Run) -> _Data:
    # The streams are written one after the other: where the process was killed, some are longer than others.
    ticks = min(len(run[stream].time) for stream in STREAMS)
    if not ticks:
        raise RunError(f"{run.folder}: nothing to draw, because no tick was recorded (state: {run.info.state})")
    measured, sensor = run["measurements"], gnss_sensor(run)
    height = next((name for name in measured.columns() if name.endswith(".height")), None)
    stops = [event for event in run.events if event.kind not in NOT_A_STOP and event.vehicle is not None]
    stop_of = {run.vehicles.index(str(event.vehicle)): event for event in reversed(stops)}
    time = run["truth"].time[:ticks]
    ends = [stop_of[i].time if i in stop_of else np.inf for i in range(len(run.vehicles))]
    numbers = np.arange(len(run.vehicles))
    few = len(numbers) <= MOST_NAMED
    return _Data(
        names=run.vehicles,
        time=time,
        # Half a step of tolerance, because the two times were rounded on different ways.
        flying=np.where(time[:, None] <= np.add(ends, run.info.time_step / 2), 1.0, np.nan),
        position=vectors(run["truth"], "position_ned")[:ticks],
        setpoint=waypoints_of(run, ticks),
        reported=vectors(measured, f"{sensor}.position_ned")[:ticks] if sensor else None,
        barometer=measured[height][:ticks] if height else None,
        mean=vectors(run["wind"], "mean_ned")[:ticks],
        gust=vectors(run["wind"], "gust_ned")[:ticks],
        stops=stop_of,
        colours=mpl.colormaps["tab10"](numbers) if few else mpl.colormaps["turbo"](numbers / len(numbers)),
    )


def _title(run: Run, data: _Data) -> str:
    count = f"{len(data.names)} vehicle{'s' if len(data.names) > 1 else ''}"
    end = f"{data.time[-1]:g} s"
    state = _ENDED.get(run.info.state)
    stopped = f", {len(data.stops)} stopped (X)" if data.stops else ""
    return f"{run.info.scenario}, seed {run.info.seed}: {count}{stopped}, {f'{state} {end}' if state else end}"


def _plan(axes: Any, data: _Data) -> None:
    """Draw the paths from above, and the legs that were flown."""
    for i, name in enumerate(data.names):
        colour = data.colours[i]
        north, east = data.position[:, i, 0], data.position[:, i, 1]
        legs = _without_repeats(data.setpoint[:, i, :2])
        axes.plot(legs[:, 1], legs[:, 0], "--", color=colour, lw=0.8, alpha=0.4)
        axes.plot(legs[:, 1], legs[:, 0], "+", color=colour, ms=10 if data.few else 5, zorder=3)
        if data.few and data.reported is not None:
            axes.plot(data.reported[:, i, 1], data.reported[:, i, 0], color=colour, lw=0.7, alpha=0.7)
        axes.plot(east, north, color=colour, lw=1.8 if data.few else 1.0, label=name)
        axes.plot(east[:1], north[:1], "o", color=colour, ms=7 if data.few else 4, mec="white")
        if not data.few and len(data.names) <= MOST_NUMBERED:
            axes.annotate(
                str(i), (east[0], north[0]), (4, 3), textcoords="offset points", fontsize=8, color="black", zorder=6
            )
        if i in data.stops:
            axes.plot(east[-1:], north[-1:], "X", color=colour, ms=11 if data.few else 7, mec="black", zorder=5)
    _wind_arrow(axes, data)
    path = "true path (thick), GNSS (thin)" if data.few and data.reported is not None else "true path"
    numbers = ", numbers: order" if not data.few and len(data.names) <= MOST_NUMBERED else ""
    title = f"plan: {path}, start o, waypoints +{numbers}"
    seen = [data.position, data.setpoint, *([] if data.reported is None or not data.few else [data.reported])]
    south_north, west_east = (_span(np.stack(seen)[..., axis], 4.0) for axis in (0, 1))
    axes.update_datalim(list(zip(west_east, south_north, strict=True)))
    axes.margins(0.0)
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal", adjustable="datalim", title=title)
    axes.grid(alpha=0.3)


def _span(values: Floats, least: float) -> tuple[float, float]:
    """Return limits around all values, at least so far apart that noise does not fill the panel."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    half = 0.55 * max(high - low, least)
    return (low + high) / 2 - half, (low + high) / 2 + half


def _without_repeats(points: Floats) -> Floats:
    """Return (L, 2) points in the order in which they were flown to."""
    points = points[np.isfinite(points).all(axis=1)]
    fresh = np.ones(len(points), bool)
    fresh[1:] = np.any(points[1:] != points[:-1], axis=1)
    return np.asarray(points[fresh])


def _wind_arrow(axes: Any, data: _Data) -> None:
    """Show where the mean wind blows to, in the corner of the plan."""
    mean = data.mean.mean(axis=(0, 1))
    speed = float(np.hypot(mean[0], mean[1]))
    if speed == 0.0:
        axes.text(0.02, 0.98, "no mean wind", transform=axes.transAxes, va="top", fontsize=9)
        return
    # In inches from the upper left corner: in fractions of the axes, the arrow would turn with their shape.
    inches = axes.figure.dpi_scale_trans + ScaledTranslation(0.0, 1.0, axes.transAxes)
    step = 0.45 * np.array([mean[1], mean[0]]) / speed
    middle = np.array([0.7, -0.55])
    arrow = {"arrowstyle": "-|>", "lw": 2, "color": "dimgray"}
    axes.annotate("", middle + step / 2, middle - step / 2, xycoords=inches, textcoords=inches, arrowprops=arrow)
    white = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 2}
    text = f"mean wind {speed:.1f} m/s"
    axes.text(0.7, -0.08, text, transform=inches, ha="center", va="top", fontsize=9, bbox=white)


def _height(axes: Any, data: _Data) -> None:
    height = -data.position[..., 2] * data.flying
    for i, colour in enumerate(data.colours):
        axes.plot(data.time, -data.setpoint[:, i, 2], "--", color=colour, lw=0.8, alpha=0.5)
        if data.few and data.barometer is not None:
            axes.plot(data.time, data.barometer[:, i], color=colour, lw=0.7, alpha=0.7)
        axes.plot(data.time, height[:, i], color=colour, lw=1.6 if data.few else 0.9)
        if i in data.stops:
            axes.plot(data.stops[i].time, -data.position[-1, i, 2], "X", color=colour, ms=11, mec="black", zorder=5)
    lines = "true (thick), barometer (thin)" if data.few and data.barometer is not None else "true (solid)"
    _over_time(axes, data, "height [m]", f"height: {lines}, set-point (dashed)")
    seen = [height, -data.setpoint[..., 2], *([] if data.barometer is None or not data.few else [data.barometer])]
    axes.set_ylim(_span(np.concatenate(seen), 1.0))


def _gnss(axes: Any, data: _Data) -> None:
    if data.reported is None:
        axes.text(0.5, 0.5, "no GNSS receiver", transform=axes.transAxes, ha="center", fontsize=12)
        _over_time(axes, data, "reported minus true [m]", "GNSS error")
        return
    # Where a new fix was reported, as in qrsim.logs.summary.
    fresh = np.ones(len(data.time), bool)
    changed = (data.reported[1:] != data.reported[:-1]) & np.isfinite(data.reported[1:])
    fresh[1:] = changed.any(axis=(1, 2))
    error = (data.reported - data.position)[fresh]
    horizontal, vertical = np.linalg.norm(error[..., :2], axis=-1), np.abs(error[..., 2])
    _lines(axes, data, data.time[fresh], horizontal, vertical)
    _over_time(axes, data, "reported minus true [m]", f"GNSS error: {_key(data, 'horizontal', 'vertical')}", low=0.0)


def _wind(axes: Any, data: _Data) -> None:
    mean = np.linalg.norm(data.mean, axis=-1) * data.flying
    total = np.linalg.norm(data.mean + data.gust, axis=-1) * data.flying
    if not np.nansum(total):
        axes.text(0.5, 0.5, "still air", transform=axes.transAxes, ha="center", fontsize=12)
    _lines(axes, data, data.time, total, mean)
    _over_time(axes, data, "wind speed [m/s]", f"wind: {_key(data, 'with gusts', 'mean')}", low=0.0)


def _lines(axes: Any, data: _Data, time: Floats, solid: Floats, dotted: Floats) -> None:
    """Draw two quantities (E, n): per vehicle, or the range and median over many vehicles."""
    if data.few:
        for i, colour in enumerate(data.colours):
            axes.plot(time, dotted[:, i], ":", color=colour, lw=1.1)
            axes.plot(time, solid[:, i], color=colour, lw=1.1)
        return
    # Once all vehicles have stopped there is no value left, and no range.
    some = np.isfinite(solid).any(axis=1) & np.isfinite(dotted).any(axis=1)
    time = time[some]
    for values, colour, style in ((dotted[some], "tab:orange", ":"), (solid[some], "tab:blue", "-")):
        low, high = np.nanmin(values, axis=1), np.nanmax(values, axis=1)
        axes.fill_between(time, low, high, color=colour, alpha=0.25, lw=0)
        axes.plot(time, np.nanmedian(values, axis=1), style, color=colour, lw=1.6)


def _key(data: _Data, solid: str, dotted: str) -> str:
    if data.few:
        return f"{solid} (solid), {dotted} (dotted)"
    return f"median, range; {solid} (blue), {dotted} (orange)"


def _over_time(axes: Any, data: _Data, label: str, title: str, low: float | None = None) -> None:
    axes.set(xlabel="time [s]", ylabel=label, title=title)
    # The same span in every panel, and some span where there is a single tick.
    axes.set_xlim(data.time[0], max(data.time[-1], data.time[0] + 1e-3))
    if low is not None:
        # A little below, so that a line along the bottom is seen; and not the digits of nothing where all is zero.
        largest = axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) and axes.dataLim.y1 > low + 1e-6 else low + 1.0
        axes.set_ylim(low - 0.02 * (largest - low), low + 1.05 * (largest - low))
    axes.grid(alpha=0.3)
