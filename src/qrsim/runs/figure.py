"""The figure of a run: plan view, height, GNSS error and wind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from qrsim.errors import RunError
from qrsim.runs.layout import Event
from qrsim.runs.picture import (
    MOST_NAMED,
    Floats,
    colours_of,
    from_zero,
    name_vehicles,
    new_figure,
    save_picture,
    spread,
    time_limits,
    title_of,
)
from qrsim.runs.reader import Run
from qrsim.runs.summary import STREAMS, common_rows, gnss_error, gnss_sensor, stops_of, vectors, waypoints_of

MOST_NUMBERED = 60


@dataclass(frozen=True)
class _Data:
    """Data of the figure: n vehicles at the T ticks of each stream, which differ where streams were decimated.

    Attributes:
        names: (n,) of the vehicles.
        time: stream -> (T,) [s].
        position, setpoint: (T, n, 3) [m], NED.
        reported: (T, n, 3) [m], what GNSS says; None without a receiver.
        barometer: (T, n) height [m]; None without a barometer.
        gnss_time, gnss_error: (E,) [s] and (E, n, 3) [m], at the epochs of new fixes.
        mean, gust: (T, n, 3) [m/s], NED.
        stops: vehicle -> the event that ended its flight.
        time_step: [s].
        colours: (n, 4).
    """

    names: tuple[str, ...]
    time: dict[str, Floats]
    position: Floats
    setpoint: Floats
    reported: Floats | None
    barometer: Floats | None
    gnss_time: Floats
    gnss_error: Floats
    mean: Floats
    gust: Floats
    stops: dict[int, Event]
    time_step: float
    colours: Floats

    @property
    def few(self) -> bool:
        """Whether each vehicle can have a line of its own in every panel."""
        return len(self.names) <= MOST_NAMED

    @property
    def span(self) -> tuple[float, float]:
        """Time of the first and last tick of any stream [s]."""
        return min(float(time[0]) for time in self.time.values()), max(float(time[-1]) for time in self.time.values())

    def flying(self, stream: str) -> Floats:
        """(T, n), 1 until a vehicle stops, NaN after."""
        ends = [self.stops[i].time if i in self.stops else np.inf for i in range(len(self.names))]
        # Half a step of tolerance, because the two times were rounded on different ways.
        return np.where(self.time[stream][:, None] <= np.add(ends, self.time_step / 2), 1.0, np.nan)


def draw_run(run: Run) -> Figure:
    """Draw the figure of a run (needs no display).

    Raises:
        RunError: nothing was recorded yet, or a part of the log is damaged.
    """
    data = _read(run)
    figure = new_figure(13, 9)
    axes = figure.subplots(2, 2, width_ratios=(1.15, 1))
    _plan(axes[0, 0], data)
    _height(axes[0, 1], data)
    _gnss(axes[1, 0], data)
    _wind(axes[1, 1], data)
    figure.suptitle(title_of(run, data.names, len(data.stops), data.span[1]))
    if data.few:
        name_vehicles(figure, *axes[0, 0].get_legend_handles_labels())
    return figure


def save_figure(run: Run, path: Path) -> None:
    """Draw a run into a file.

    Raises:
        UsageError: the ending of the name is none that can be drawn.
        RunError: nothing was recorded yet, or the file cannot be written; what was there before is then left alone.
    """
    save_picture(lambda: draw_run(run), path)


def _read(run: Run) -> _Data:
    rows = {stream: common_rows(run, stream)[0] for stream in STREAMS}
    if not all(map(len, rows.values())):
        raise RunError(f"{run.folder}: nothing to draw, because no tick was recorded (state: {run.info.state})")
    measured, sensor = run["measurements"], gnss_sensor(run)
    height = next((name for name in measured.columns() if name.endswith(".height")), None)
    gnss_time, error = gnss_error(run)
    return _Data(
        names=run.vehicles,
        time={stream: run[stream].time[rows[stream]] for stream in STREAMS},
        position=vectors(run["truth"], "position_ned", rows["truth"]),
        setpoint=waypoints_of(run, rows["commands"]),
        reported=vectors(measured, f"{sensor}.position_ned", rows["measurements"]) if sensor else None,
        barometer=measured[height][rows["measurements"]] if height else None,
        gnss_time=gnss_time,
        gnss_error=error,
        mean=vectors(run["wind"], "mean_ned", rows["wind"]),
        gust=vectors(run["wind"], "gust_ned", rows["wind"]),
        stops=stops_of(run),
        time_step=run.info.time_step,
        colours=colours_of(len(run.vehicles)),
    )


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
    south_north, west_east = (_span(np.concatenate(seen)[..., axis], 4.0) for axis in (0, 1))
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
    height = -data.position[..., 2] * data.flying("truth")
    for i, colour in enumerate(data.colours):
        axes.plot(data.time["commands"], -data.setpoint[:, i, 2], "--", color=colour, lw=0.8, alpha=0.5)
        if data.few and data.barometer is not None:
            axes.plot(data.time["measurements"], data.barometer[:, i], color=colour, lw=0.7, alpha=0.7)
        axes.plot(data.time["truth"], height[:, i], color=colour, lw=1.6 if data.few else 0.9)
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
    horizontal, vertical = np.linalg.norm(data.gnss_error[..., :2], axis=-1), np.abs(data.gnss_error[..., 2])
    _lines(axes, data, data.gnss_time, horizontal, vertical)
    _over_time(axes, data, "reported minus true [m]", f"GNSS error: {_key(data, 'horizontal', 'vertical')}")
    from_zero(axes)


def _wind(axes: Any, data: _Data) -> None:
    flying = data.flying("wind")
    mean = np.linalg.norm(data.mean, axis=-1) * flying
    total = np.linalg.norm(data.mean + data.gust, axis=-1) * flying
    if not np.nansum(total):
        axes.text(0.5, 0.5, "still air", transform=axes.transAxes, ha="center", fontsize=12)
    _lines(axes, data, data.time["wind"], total, mean)
    _over_time(axes, data, "wind speed [m/s]", f"wind: {_key(data, 'with gusts', 'mean')}")
    from_zero(axes)


def _lines(axes: Any, data: _Data, time: Floats, solid: Floats, dotted: Floats) -> None:
    """Draw two quantities (E, n): per vehicle, or the range and median over many vehicles."""
    if data.few:
        for i, colour in enumerate(data.colours):
            axes.plot(time, dotted[:, i], ":", color=colour, lw=1.1)
            axes.plot(time, solid[:, i], color=colour, lw=1.1)
        return
    spread(axes, time, dotted, "tab:orange", ":")
    spread(axes, time, solid, "tab:blue")


def _key(data: _Data, solid: str, dotted: str) -> str:
    if data.few:
        return f"{solid} (solid), {dotted} (dotted)"
    return f"median, range; {solid} (blue), {dotted} (orange)"


def _over_time(axes: Any, data: _Data, label: str, title: str) -> None:
    axes.set(xlabel="time [s]", ylabel=label, title=title)
    time_limits(axes, *data.span)
    axes.grid(alpha=0.3)
