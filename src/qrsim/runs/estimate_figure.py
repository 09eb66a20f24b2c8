"""Errors of an estimate over time within three of the standard deviations stated, and what else is estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qrsim.core.arrays import Floats
from qrsim.errors import UsageError
from qrsim.runs.panels import read_data
from qrsim.runs.picture import (
    MOST_NAMED,
    binned_text,
    colours_of,
    name_vehicles,
    new_figure,
    spread,
    time_limits,
    title_of,
    trace,
)
from qrsim.runs.quantities import quantities
from qrsim.runs.reader import Run

Row = tuple[tuple[str, ...], tuple[str, ...], str]
# Rows of the figure: what is estimated, its axes, and its unit.
ROWS: dict[str, Row] = {
    "position_ned": (("x", "y", "z"), ("north", "east", "down"), "m"),
    "velocity_ned": (("x", "y", "z"), ("north", "east", "down"), "m/s"),
    "attitude": (("roll", "pitch", "yaw"), ("roll", "pitch", "yaw"), "rad"),
}
# What only some estimators have: wind beside the truth, biases as they are, as the log does not know the true ones.
WIND = (("wind_north", "wind_east"), ("north", "east"), "m/s")
BIASES = {
    "gyroscope_bias": (("x", "y", "z"), ("x", "y", "z"), "rad/s"),
    "accelerometer_bias": (("x", "y", "z"), ("x", "y", "z"), "m/s²"),
    "earth_field_ned": (("x", "y", "z"), ("north", "east", "down"), "µT"),
    "field_bias": (("x", "y", "z"), ("x", "y", "z"), "µT"),
}
WIDE = 3.0


def draw_estimate(
    run: Run, vehicles: Sequence[str] = (), start: float | None = None, end: float | None = None
) -> Figure:
    """Draw each vehicle's state estimate minus the truth with +-3 reported standard deviations, then estimated biases.

    Args:
        run: the run.
        vehicles: names of those to draw; none for all.
        start, end: span of time [s], both included; None for the whole run.

    Raises:
        UsageError: unknown names, a span without a tick, or a run whose log has no estimate.
        RunError: nothing was recorded yet, or a part of the log is damaged.
    """
    wanted = {item.name: item for item in quantities(run)}
    if "commands.estimate.position_ned.x" not in wanted:
        raise UsageError(
            f"{run.folder}: no estimate was recorded; a fleet has one with an estimator, as in "
            "--set fleets.NAME.estimator=ekf, or with a cascade fed with its filter"
        )
    used = [wanted[name] for name in _column_names() if name in wanted]
    data = read_data(run, used, vehicles, start, end)
    series = {item.name: found for item, found in data.series.items()}
    time = series["truth.position_ned.x"][0]
    values = {name: array for name, (_, array) in series.items()}
    errors, stds = _errors(values)
    rows = _rows(errors, values)
    figure = new_figure(13, 2.5 * len(rows) + 1.0)
    every = figure.subplots(len(rows), 3, sharex=True)
    for row, (what, (axes, titles, unit)) in zip(every, rows.items(), strict=True):
        for panel in row[len(axes) :]:
            panel.set_visible(False)
        for panel, axis, title in zip(row, axes, titles, strict=False):
            name = axis if what == "wind" else f"{what}.{axis}"
            if what in BIASES:
                _draw_value(panel, time, values[f"commands.estimate.{name}"], values[f"commands.estimate_std.{name}"])
            else:
                _draw_errors(panel, time, errors[name], stds.get(name))
            text = what.removesuffix("_ned").replace("_", " ")
            panel.set_title(f"{text}, {title} [{unit}]", loc="left", fontsize=10)
    for panel in every[-1]:
        panel.set_xlabel("time [s]")
        time_limits(panel, *data.span)
    names = data.names
    beside = "" if len(rows) == len(ROWS) else "; biases and fields as estimated"
    stated = "; shaded: 3 std as stated" if stds else ""
    many = "" if len(names) <= MOST_NAMED else "; median, quartiles, range"
    title = title_of(run, names, len(data.stops), data.last, "")
    figure.suptitle(f"{title}: estimate minus truth{beside}{stated}{many}{binned_text(time)}")
    if 1 < len(names) <= MOST_NAMED:
        name_vehicles(figure, [Line2D([], [], color=c) for c in colours_of(len(names))], names)
    return figure


def _column_names() -> list[str]:
    """Return the names of the logged columns that the figure of estimation errors needs."""
    parts = [f"{what}.{axis}" for what, (axes, _, _) in ROWS.items() for axis in axes]
    truth = [f"truth.{what}.{axis}" for what in ("position_ned", "velocity_body") for axis in "xyz"]
    truth += [f"truth.attitude.{axis}" for axis in ("roll", "pitch", "yaw")]
    truth += [f"wind.{kind}.{axis}" for kind in ("mean_ned", "gust_ned") for axis in "xy"]
    parts += [f"{what}.{axis}" for what, (axes, _, _) in BIASES.items() for axis in axes]
    parts += list(WIND[0])
    return truth + [f"commands.{kind}.{part}" for kind in ("estimate", "estimate_std") for part in parts]


def _rows(errors: dict[str, Floats], values: dict[str, Floats]) -> dict[str, Row]:
    """Return name -> row of panels (such as position, wind, a sensor bias) for which the run has data."""
    rows = dict(ROWS)
    if WIND[0][0] in errors:
        rows["wind"] = WIND
    return rows | {what: row for what, row in BIASES.items() if f"commands.estimate.{what}.x" in values}


def _errors(values: dict[str, Floats]) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Return two dicts, name -> array (T, n): estimate minus truth, and its reported standard deviation."""
    truth = {name.removeprefix("truth."): array for name, array in values.items() if name.startswith("truth.")}
    truth |= dict(zip((f"velocity_ned.{axis}" for axis in "xyz"), _velocity_ned(truth), strict=True))
    errors, stds = {}, {}
    for what, (axes, _, _) in ROWS.items():
        for axis in axes:
            name = f"{what}.{axis}"
            error = values[f"commands.estimate.{name}"] - truth[name]
            errors[name] = (error + np.pi) % (2.0 * np.pi) - np.pi if what == "attitude" else error
            if f"commands.estimate_std.{name}" in values:
                stds[name] = values[f"commands.estimate_std.{name}"]
    for name, axis in zip(WIND[0], "xy", strict=True):
        if f"commands.estimate.{name}" in values:
            true = values[f"wind.mean_ned.{axis}"] + values[f"wind.gust_ned.{axis}"]
            errors[name] = values[f"commands.estimate.{name}"] - true
            stds[name] = values[f"commands.estimate_std.{name}"]
    return errors, stds


def _velocity_ned(truth: dict[str, Floats]) -> tuple[Floats, Floats, Floats]:
    """Return the true velocity over ground, north, east and down, each (T, n) [m/s]."""
    u, v, w = (truth[f"velocity_body.{axis}"] for axis in "xyz")
    angles = [truth[f"attitude.{name}"] for name in ("roll", "pitch", "yaw")]
    (sr, sp, sy), (cr, cp, cy) = map(np.sin, angles), map(np.cos, angles)
    return (
        cp * cy * u + (sr * sp * cy - cr * sy) * v + (cr * sp * cy + sr * sy) * w,
        cp * sy * u + (sr * sp * sy + cr * cy) * v + (cr * sp * sy - sr * cy) * w,
        -sp * u + sr * cp * v + cr * cp * w,
    )


def _draw_value(axes: Axes, time: Floats, values: Floats, stds: Floats) -> None:
    """Draw an estimated value (T, n) over time with a band of +-3 standard deviations."""
    count = values.shape[1]
    if count > MOST_NAMED:
        spread(axes, time, values, colours_of(1)[0])
    else:
        for i, colour in enumerate(colours_of(count)):
            trace(axes, time, values[:, i], color=colour, lw=1.0)
            low, high = values[:, i] - WIDE * stds[:, i], values[:, i] + WIDE * stds[:, i]
            axes.fill_between(time, low, high, color=colour, alpha=0.1, lw=0)
    axes.grid(alpha=0.3)


def _draw_errors(axes: Axes, time: Floats, errors: Floats, stds: Floats | None) -> None:
    """Draw estimation errors (T, n) over time, with bounds at +-3 standard deviations if ``stds`` is given."""
    count = errors.shape[1]
    if count > MOST_NAMED:
        spread(axes, time, errors, colours_of(1)[0])
        if stds is not None:
            bound = WIDE * np.nanmedian(stds, axis=1)
            axes.fill_between(time, -bound, bound, color="gray", alpha=0.25, lw=0)
    else:
        for i, colour in enumerate(colours_of(count)):
            trace(axes, time, errors[:, i], color=colour, lw=1.0)
            if stds is not None:
                bound = WIDE * stds[:, i]
                axes.fill_between(time, -bound, bound, color=colour if count == 1 else "gray", alpha=0.12, lw=0)
    axes.axhline(0.0, color="gray", lw=0.6)
    axes.grid(alpha=0.3)
