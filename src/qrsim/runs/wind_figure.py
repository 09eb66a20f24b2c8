"""A picture of the mean wind over height, for ``qrsim show --wind``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qrsim.core.arrays import Floats
from qrsim.core.host import on_host
from qrsim.core.series import split_seconds
from qrsim.core.tree import cast, record_of
from qrsim.core.vectors import Vec3
from qrsim.models.atmosphere.wind import mean_wind_at
from qrsim.runs.picture import new_figure, save_picture
from qrsim.scenarios.build import wind_of
from qrsim.scenarios.ground import top_of
from qrsim.scenarios.scenario import Scenario
from qrsim.scenarios.schema import ScenarioSpec
from qrsim.scenarios.weather import start_levels
from qrsim.scenarios.wind_limits import gust_sigma
from qrsim.scenarios.wind_schema import PROFILE

# Height of the picture in an area without a ceiling [m], and heights that are drawn.
USUAL_TOP, HEIGHTS = 120.0, 241
# Speeds below this have no bearing worth drawing [m/s]; bearings span at least this [deg].
STILL, LEAST_SPAN = 0.05, 30.0


def save_wind_picture(scenario: Scenario, path: Path) -> None:
    """Draw a scenario's mean wind at the origin over height, at start, middle and end of its run; save the figure.

    Raises:
        UsageError: the name has another ending than .png, .pdf or .svg.
        RunError: the file cannot be written.
    """
    save_picture(lambda: _draw_profile(scenario.spec), path)


def _draw_profile(scenario: ScenarioSpec) -> Figure:
    """Draw the scenario's mean wind over height: speed and bearing at the start, middle and end of the run."""
    top = top_of(scenario.world.area)
    heights = np.linspace(0.0, USUAL_TOP if top is None or top <= 0.0 else top, HEIGHTS)
    winds = _winds(scenario, heights)
    figure = new_figure(8.5, 4.6)
    left, right = figure.subplots(1, 2, sharey=True)
    bearings: list[Floats] = []
    sigma = gust_sigma(scenario, heights) if scenario.world.turbulence.type != "still" else np.zeros(HEIGHTS)
    for number, (label, north, east) in enumerate(winds):
        speed, bearing = np.hypot(north, east), np.degrees(np.arctan2(-east, -north)) % 360.0
        look = {"color": f"C{number}", "label": label}
        left.plot(speed, heights, **look)
        if number == 0 and sigma.any():
            low = np.maximum(speed - sigma, 0.0)
            left.fill_betweenx(heights, low, speed + sigma, color="C0", alpha=0.15, label="± 1 std of the gusts")
        bearings.append(_unbroken(bearing, speed, bearings[0] if bearings else bearing))
        right.plot(bearings[-1], heights, **look)
    _mark_levels(scenario, left, heights[-1])
    left.set(xlabel="speed [m/s]", ylabel="height above the ground [m]", ylim=(0.0, heights[-1]))
    left.set_xlim(0.0, max(1.0, left.get_xlim()[1]))
    right.set(xlabel="bearing the wind comes from [deg]")
    _widen(right, np.concatenate(bearings))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    left.legend(fontsize=8, loc="upper left")
    figure.suptitle(f"{scenario.name}: mean wind of type {scenario.world.wind.type}", fontsize=11)
    return figure


def _winds(scenario: ScenarioSpec, heights: Floats) -> list[tuple[str, Floats, Floats]]:
    """Return (label, north [m/s], east [m/s]) over ``heights`` [m] at several times, or at one for a steady wind."""
    wind = cast(wind_of(scenario), np.float32)
    zero = np.zeros(HEIGHTS, np.float32)
    place = record_of(Vec3, zero, zero, -heights.astype(np.float32))
    speeds = on_host(mean_wind_at)
    found: list[tuple[str, Floats, Floats]] = []
    for label, time in (("start", 0.0), ("middle", 0.5 * scenario.duration), ("end", scenario.duration)):
        seconds, fraction = split_seconds(np.array(time))
        air = speeds(wind, heights.astype(np.float32), place, (seconds, np.float32(fraction)))
        velocity = np.asarray(air.x, np.float64), np.asarray(air.y, np.float64)
        if not found or not np.allclose(velocity, found[-1][1:], atol=0.02):
            found.append((f"{label} of the run", *velocity))
    return found if len(found) > 1 else [("mean wind", *found[0][1:])]


def _unbroken(bearing: Floats, speed: Floats, near: Floats) -> Floats:
    """Return bearings [deg] of winds unwrapped across 360 and close to those in ``near``; NaN in calm."""
    there, found = speed >= STILL, np.full(len(bearing), np.nan)
    if there.any():
        found[there] = np.unwrap(bearing[there], period=360.0)
        if np.isfinite(near).any():
            found += 360.0 * np.round((np.nanmean(near) - np.nanmean(found)) / 360.0)
    return found


def _widen(axes: Axes, bearings: Floats) -> None:
    """Widen the axis of bearings [deg] to some tens of degrees, so that rounding errors do not show."""
    if not np.isfinite(bearings).any():
        axes.set_xlim(0.0, 360.0)
        return
    low, high = float(np.nanmin(bearings)), float(np.nanmax(bearings))
    half = max(0.5 * LEAST_SPAN, 0.55 * (high - low))
    axes.set_xlim(0.5 * (low + high) - half, 0.5 * (low + high) + half)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value % 360.0:.0f}")


def _mark_levels(scenario: ScenarioSpec, axes: Axes, top: float) -> None:
    """Draw the levels of a wind profile up to ``top`` [m], at its first time, as lines with their names."""
    if scenario.world.wind.type != PROFILE:
        return
    for height, name in zip(*start_levels(scenario.world.wind), strict=True):
        if height <= top:
            axes.axhline(height, color="0.6", linewidth=0.8, linestyle=":")
            side = "top" if height > 0.96 * top else "bottom"
            axes.annotate(name, (0.99, height), xycoords=("axes fraction", "data"), ha="right", va=side, fontsize=7)
