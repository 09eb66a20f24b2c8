"""The sky over a vehicle as its receiver has seen it: where its satellites went, and how strong they were."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.gnss.constellations import satellite_name
from qrsim.runs.picture import new_figure, title_of
from qrsim.runs.reader import Run

SKY = "sky"
COLOURS = {"G": "tab:blue", "E": "tab:orange", "R": "tab:red", "C": "tab:green"}
# How satellites are drawn that are hidden, and lost to jammers, by their state.
LOST = {3.0: ("_", "0.45", "hidden"), 4.0: ("x", "0.1", "lost to jammers")}
# C/N0 [dB-Hz] of the thinnest and of the thickest line.
_WEAK, _STRONG = 25.0, 50.0
_FIELDS = ("satellite", "satellite_state", "cn0", "azimuth", "elevation")


def draw_sky(run: Run, vehicles: Sequence[str] = (), start: float | None = None, end: float | None = None) -> Figure:
    """Draw the GNSS satellites over one vehicle in a polar plot, zenith in the middle, north up; needs no display.

    Args:
        run: of a scenario whose receiver has ``per_satellite: true``.
        vehicles: the name of one; none for the first.
        start, end: span of time [s], both included; None for the whole run.

    Raises:
        UsageError: no receiver says anything of its satellites, an unknown vehicle or several, no tick in the span.
    """
    name = vehicles[0] if vehicles else run.vehicles[0]
    if len(vehicles) > 1:
        raise UsageError(f"--panel {SKY} is of one vehicle; give --vehicle once")
    if name not in run.vehicles:
        raise UsageError(f"no vehicle is called '{name}'{did_you_mean(name, run.vehicles)}")
    seen = _seen(run, run.vehicles.index(name))
    time = run["measurements"].time
    chosen = (time >= (-np.inf if start is None else start)) & (time <= (np.inf if end is None else end))
    if not chosen.any():
        raise UsageError(f"no tick was logged in that span; the run is from {time[0]:g} to {time[-1]:g} s")
    figure = new_figure(7.5, 7.5)
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set(ylim=(0.0, 90.0), yticks=[0, 30, 60, 90], yticklabels=["90°", "60°", "30°", "0°"])
    systems = set()
    for number in np.unique(seen["satellite"][chosen]):
        if number >= 0:
            systems.add(_draw(axes, satellite_name(int(number)), seen, (seen["satellite"] == number) & chosen[:, None]))
    for system in sorted(systems):
        axes.plot([], [], color=COLOURS.get(system, "black"), label=system)
    axes.plot([], [], ".", color="0.75", label="not tracked")
    states = seen["satellite_state"][chosen]
    if (states == 2.0).any():
        axes.plot([], [], "o", color="0.3", mfc="white", ms=4, label="by a reflection alone")
    for value, (marker, shade, words) in LOST.items():
        if (states == value).any():
            axes.plot([], [], marker, color=shade, ms=4, label=words)
    axes.legend(loc="lower left", bbox_to_anchor=(-0.08, -0.08), fontsize=8)
    shown = f"{time[chosen][0]:g} to {time[chosen][-1]:g} s; the thicker, the stronger"
    figure.suptitle(f"{title_of(run, [name], 0, float(time[-1]))}\n{shown}")
    return figure


def _seen(run: Run, vehicle: int) -> dict[str, Floats]:
    """Return field -> values (T, K) of K satellites, from a vehicle's first receiver that logs them."""
    stream = run["measurements"]
    columns = stream.columns()
    sensor = next((column.removesuffix(".cn0.0") for column in columns if column.endswith(".cn0.0")), None)
    if sensor is None:
        raise UsageError(
            f"--panel {SKY}: no receiver of this run says anything of its satellites; "
            "give a sensor of type gnss per_satellite: true"
        )
    slots = sum(column.startswith(f"{sensor}.cn0.") for column in columns)
    found = {}
    for field in _FIELDS:
        arrays = stream.arrays([f"{sensor}.{field}.{k}" for k in range(slots)])
        found[field] = np.stack([np.asarray(array, np.float64)[:, vehicle] for array in arrays.values()], axis=-1)
    return found


def _draw(axes: Axes, name: str, seen: dict[str, Floats], where: NumpyArray) -> str:
    """Draw the track of the satellite ``name`` in a sky plot; ``where`` selects it in ``seen``. Return its system's
    letter."""
    system = name[0]
    turn, low = seen["azimuth"][where], 90.0 - np.degrees(seen["elevation"][where])
    state = seen["satellite_state"][where]
    tracked = (state == 1.0) | (state == 2.0)
    colour = COLOURS.get(system, "black")
    size = 2.0 + 28.0 * np.clip((seen["cn0"][where] - _WEAK) / (_STRONG - _WEAK), 0.0, 1.0) ** 2
    axes.scatter(turn[state == 0.0], low[state == 0.0], s=4.0, color="0.75", lw=0)
    for value, (marker, shade, _) in LOST.items():
        if (lost := state == value).any():
            axes.scatter(turn[lost], low[lost], s=9.0, marker=marker, color=shade, lw=0.8)
    axes.scatter(turn[tracked], low[tracked], s=size[tracked], color=colour, lw=0)
    if (reflected := state == 2.0).any():
        axes.scatter(turn[reflected], low[reflected], s=4.0, color="white", lw=0)
    axes.annotate(name, (turn[-1], low[-1]), fontsize=7, xytext=(4, 4), textcoords="offset points")
    return system
