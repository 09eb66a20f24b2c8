"""Figures of the page of a brief."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from qrsim.core.arrays import NumpyArray
from qrsim.runs.picture import colours_of, new_figure
from qrsim.runs.plan import draw_surroundings
from qrsim.runs.surroundings import Surroundings, fixed_parts
from qrsim.scenarios.scenario import Scenario
from qrsim.studies.brief.boundary import Boundary
from qrsim.studies.brief.judging import Row
from qrsim.studies.brief.operation import WindSpec
from qrsim.studies.brief.runs import Runs
from qrsim.studies.brief.sky import Sky

DPI = 100
# Runs whose tracks are drawn, cells of the map's longer side, smallest cell [m], and points between two records.
MOST_TRACKS, CELLS, SMALLEST_M, BETWEEN = 512, 200, 2.0, 8
COLOURS = {"go": "#146c2e", "marginal": "#b26a00", "no-go": "#b3261e"}


def png(figure: Figure) -> bytes:
    """Render a figure to PNG bytes; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, format="png", metadata={"Software": None})
    return buffer.getvalue()


def map_figure(scenario: Scenario, tracks: NumpyArray, worst: Sequence[int], lost: NumpyArray) -> Figure:
    """Draw the density of all tracks (E, R, n, 4) over fence and planned routes, the worst runs, and places of losses.

    Args:
        scenario: of the flights.
        tracks: of the runs.
        worst: numbers of runs that are drawn as lines.
        lost: (L, 2) places where vehicles were lost [m].
    """
    around = Surroundings(**fixed_parts(scenario.spec.world.model_dump(mode="json")))
    corners = around.outline
    low, high = corners.min(axis=0) - 5.0, corners.max(axis=0) + 5.0
    points = _dense(tracks)
    if len(points):
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    # As high as the area is long, within a page.
    figure = new_figure(7.2, float(np.clip(5.4 * (high[0] - low[0]) / max(high[1] - low[1], 1.0) + 0.7, 2.5, 7.5)))
    axes = figure.subplots()
    cell = max(SMALLEST_M, float(np.max(high - low)) / CELLS)
    edges = [np.arange(low[axis], high[axis] + cell, cell) for axis in (0, 1)]
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=edges)
    if counts.any():
        shown = np.where(counts > 0.0, counts / counts.sum(), np.nan)
        drawn = axes.pcolormesh(edges[1], edges[0], shown, norm=LogNorm(), cmap="Blues", rasterized=True)
        figure.colorbar(drawn, ax=axes, label="share of the flight time (dark: often flown over)", shrink=0.7)
    draw_surroundings(axes, around)
    for number, vehicle in enumerate(_vehicles(scenario)):
        line = _route(vehicle)
        axes.plot(line[:, 1], line[:, 0], color="black", lw=0.8, ls="--", label=None if number else "planned route")
        axes.plot(line[0, 1], line[0, 0], "^", color="black", ms=6, label=None if number else "start")
        if len(_vehicles(scenario)) == 1:
            _number_legs(axes, vehicle, line)
    for number, run in enumerate(worst):
        for vehicle in range(tracks.shape[2]):
            path = tracks[run, :, vehicle]
            label = None if number or vehicle else f"worst runs ({len(worst)})"
            axes.plot(path[:, 1], path[:, 0], color="#b26a00", lw=0.6, label=label)
    if len(lost):
        axes.plot(lost[:, 1], lost[:, 0], "x", color=COLOURS["no-go"], ms=6, mew=1.5, label="last record of a lost run")
    axes.set_aspect("equal")
    axes.set(xlim=(low[1], high[1]), ylim=(low[0], high[0]), xlabel="east [m]", ylabel="north [m]")
    marks = {str(artist.get_label()): artist for artist in (*axes.lines, *axes.patches)}
    named = [mark for label, mark in marks.items() if label and not label.startswith("_")]
    axes.legend(handles=named, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, fontsize=8)
    return figure


def losses(runs: Runs, tracks: NumpyArray) -> NumpyArray:
    """Return the place (L, 2), north and east [m], of the first loss in each lost run: the last one in ``tracks``
    (E, R, n, 4)."""
    found = []
    for run in np.flatnonzero(np.isfinite(runs["stopped_vehicle"][: len(tracks)])):
        track = tracks[run, :, int(runs["stopped_vehicle"][run]), :2]
        known = track[np.isfinite(track).all(axis=1)]
        found += [known[-1]] if len(known) else []
    return np.array(found).reshape(-1, 2)


def _dense(tracks: NumpyArray) -> NumpyArray:
    """Return places (K, 2), north and east [m], along all tracks, interpolated between their records."""
    one, other = tracks[:, :-1, :, :2], tracks[:, 1:, :, :2]
    parts = [one + (other - one) * (step / BETWEEN) for step in range(BETWEEN)]
    found = np.concatenate([part.reshape(-1, 2) for part in parts])
    return found[np.isfinite(found).all(axis=1)]


def _route(vehicle: Any) -> NumpyArray:
    """Return the planned places (K, 3) NED [m] of a vehicle: start, end of each leg, and place of the landing."""
    places = [vehicle.position_ned, *vehicle.places_ned.values()]
    last = vehicle.legs[-1]
    if last.type == "land" and last.at_ned is not None:
        places.append([*last.at_ned, 0.0])
    return np.array(places)


def _number_legs(axes: Axes, vehicle: Any, line: NumpyArray) -> None:
    """Write the number of each leg next to its middle; legs that share a middle get one text."""
    middles: dict[tuple[int, int], list[str]] = {}
    for number, (one, other) in enumerate(itertools.pairwise(line), 1):
        north, east = 0.5 * (one[:2] + other[:2])
        middles.setdefault((round(north), round(east)), []).append(str(number))
    for (north, east), numbers in middles.items():
        axes.annotate(", ".join(numbers), (east, north), xytext=(4, 4), textcoords="offset points", fontsize=8)


def _vehicles(scenario: Scenario) -> list[Any]:
    """Return the specifications of those of a scenario's vehicles that fly a mission."""
    return [vehicle for fleet in scenario.spec.fleets.values() for vehicle in fleet.vehicles if vehicle.legs]


def margins_figure(runs: Runs, rows: Sequence[Row]) -> Figure | None:
    """Draw each safety margin of the runs: median, 5 to 95 %, extremes and its criterion; None without margins."""
    values = {
        "fence": np.fmin(runs["fence_horizontal_min_m"], runs["ceiling_min_m"]),
        "ground": runs["ground_min_m"],
        "obstacle": runs["obstacle_min_m"],
        "separation": runs["air_separation_min_m"],
    }
    shown = [row for row in rows if row.name in values]
    if not shown:
        return None
    figure = new_figure(7.2, 0.8 + 0.55 * len(shown))
    axes = figure.subplots()
    for number, row in enumerate(shown):
        known = values[row.name][np.isfinite(values[row.name])]
        low, median, high = np.quantile(known, [0.05, 0.5, 0.95])
        colour = COLOURS[row.verdict]
        axes.plot([known.min(), known.max()], [number, number], color=colour, lw=1.0)
        axes.plot([low, high], [number, number], color=colour, lw=6.0, solid_capstyle="butt")
        axes.plot([median], [number], "|", color="white", ms=9, mew=2)
        axes.plot([row.limit or 0.0], [number], marker="D", color="black", ms=5)
    axes.set_yticks(range(len(shown)), [row.name for row in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("smallest distance of a run [m]; thick: 5 to 95 %, diamond: criterion")
    return figure


def time_figure(
    runs: Runs, tracks: NumpyArray, low_battery: float, reserve: float, sky: Sky | None, every_s: float
) -> Figure:
    """Draw each vehicle's charge and height over time, median and 5 to 95 % of runs, and satellites and PDOP below."""
    figure = new_figure(7.2, 6.4 if sky is not None else 4.6)
    panels = figure.subplots(3 if sky is not None else 2, 1)
    ends = runs["flown_s"]
    last = float(np.nanmax(ends)) if len(ends) else every_s
    time = np.arange(tracks.shape[1]) * every_s
    used = time <= last + every_s
    for vehicle, colour in enumerate(colours_of(max(1, tracks.shape[2]))):
        for axes, values in ((panels[0], tracks[:, used, vehicle, 3]), (panels[1], -tracks[:, used, vehicle, 2])):
            known = np.isfinite(values).sum(axis=0) > 0
            band = np.nanquantile(values[:, known], [0.05, 0.5, 0.95], axis=0)
            axes.plot(time[used][known], band[1], color=colour, lw=1.2, label=runs.names[vehicle])
            axes.fill_between(time[used][known], band[0], band[2], color=colour, alpha=0.25, lw=0)
    panels[0].axhline(reserve, color=COLOURS["marginal"], lw=0.9, ls="--")
    panels[0].axhline(low_battery, color=COLOURS["no-go"], lw=0.9, ls="--")
    panels[0].text(0.0, reserve, " reserve", fontsize=8, va="bottom")
    panels[0].text(0.0, low_battery, " low battery", fontsize=8, va="top")
    panels[0].set_ylim(0.0, 1.02)
    panels[0].set_ylabel("charge [1]")
    panels[1].set_ylabel("height [m]")
    panels[1].set_xlabel("time of the flight [s]")
    for axes in panels[:2]:
        axes.set_xlim(0.0, max(last, 1.0))
    if tracks.shape[2] <= 10:
        panels[1].legend(fontsize=8, loc="upper right")
    if sky is not None:
        _draw_sky(panels[2], sky, last)
    return figure


def _draw_sky(axes: PolarAxes, sky: Sky, last_s: float) -> None:
    """Draw the number of satellites and the PDOP over time up to ``last_s`` [s], at the place with the worst sky."""
    place, hours = sky.worst_place(), sky.seconds / 3600.0
    axes.axvspan(0.0, last_s / 3600.0, color="#dddddd", lw=0)
    axes.plot(hours, sky.count[:, place], color="#1f4e8c", lw=1.0)
    axes.set_ylabel("satellites", color="#1f4e8c")
    axes.set_ylim(0, max(12, math.ceil(1.1 * sky.count.max())))
    other = axes.twinx()
    other.plot(hours, sky.pdop[:, place], color="#b26a00", lw=1.0)
    other.set_ylabel("PDOP", color="#b26a00")
    other.set_ylim(0.0, 8.0)
    axes.set_xlim(hours[0], hours[-1])
    axes.set_xlabel("hours after the start of the flights; at the place with the worst sky")


def polar_figure(boundary: Boundary, wind: WindSpec) -> Figure:
    """Draw the wind boundary over the direction the wind comes from, with its interval, and the forecast's spread."""
    figure = new_figure(5.4, 5.2)
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    order = sorted(boundary.flown, key=lambda i: boundary.bearings[i])
    angles = np.radians([boundary.bearings[i] for i in order])
    low, middle, high = (each[order] for each in (boundary.low, boundary.speed, boundary.high))
    random = np.random.default_rng(0)
    speeds = np.maximum(0.0, random.normal(wind.speed or 0.0, wind.std, 300))
    cloud = np.radians(random.normal(wind.from_deg or 0.0, wind.from_std, 300))
    axes.plot(cloud, speeds, ".", ms=3, color="#1f4e8c", alpha=0.4, label="forecast with its error")
    if len(order) > 2:
        ring = [*range(len(order)), 0]
        around = np.append(angles, angles[0] + math.tau)
        axes.fill_between(around, low[ring], high[ring], color="#b26a00", alpha=0.3)
        axes.plot(angles[ring], middle[ring], color="#b26a00", lw=1.5, marker="o", ms=4, label="90 % succeed")
    else:
        bars = np.array([middle - low, high - middle])
        axes.errorbar(angles, middle, bars, fmt="o", ms=4, color="#b26a00", capsize=3, label="90 % succeed")
    axes.set_rlim(0.0, 1.1 * max(float(high.max()), float(speeds.max())))
    axes.set_xticks(np.radians(np.arange(0, 360, 45)), ["N", "NE", "E", "SE", "S", "SW", "W", "NW"])
    axes.set_xlabel(f"mean wind [m/s] at {wind.height:g} m, by the bearing that it comes from")
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(-0.15, 1.1))
    return figure
