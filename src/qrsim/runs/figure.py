"""The figure of a run: plan view in its surroundings, height, GNSS error and wind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from qrsim.core.arrays import Floats
from qrsim.errors import RunError
from qrsim.runs.layout import Event
from qrsim.runs.picture import (
    MOST_NAMED,
    binned_text,
    colours_of,
    from_zero,
    name_vehicles,
    new_figure,
    save_picture,
    spread,
    time_limits,
    title_of,
    trace,
)
from qrsim.runs.plan import Paths, draw_plan, held_places, span
from qrsim.runs.reader import Run
from qrsim.runs.summary import (
    STREAMS,
    common_rows,
    gnss_error,
    gnss_sensor,
    score_text,
    stops_of,
    vectors,
    waypoints_of,
)
from qrsim.runs.surroundings import Surroundings, surroundings_of
from qrsim.runs.terrain import Terrain, terrain_of

# Of what interferes with receivers, so many are named.
MOST_SAID = 6
# More vehicles than these have no line of their own anywhere.
MOST_LINES = 60
# What is drawn of very many vehicles: what is, and what was wanted.
FIRST, SECOND = colours_of(2)
# Signed errors of a position, as a person names them: (axis of NED, sign, name).
ERRORS = ((0, 1.0, "north"), (1, 1.0, "east"), (2, -1.0, "up"))


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
        around: what there was besides vehicles.
        terrain: the ground.
        places: of each vehicle, (K, 2) where its legs lead, north and east [m].
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
    around: Surroundings
    terrain: Terrain
    places: tuple[Floats, ...]

    @property
    def few(self) -> bool:
        """Whether there are few enough vehicles to draw each as its own line."""
        return len(self.names) <= MOST_NAMED

    @property
    def span(self) -> tuple[float, float]:
        """Times [s] of the first and the last tick of any stream."""
        return min(float(time[0]) for time in self.time.values()), max(float(time[-1]) for time in self.time.values())

    def flying(self, stream: str) -> Floats:
        """Array (T, n) over a stream's ticks: 1 while a vehicle flies, NaN after its flight has ended."""
        ends = [self.stops[i].time if i in self.stops else np.inf for i in range(len(self.names))]
        # Half a step of tolerance, because the two times were rounded on different ways.
        return np.where(self.time[stream][:, None] <= np.add(ends, self.time_step / 2), 1.0, np.nan)


def draw_run(run: Run) -> Figure:
    """Draw a run's summary figure: plan view, heights, wind and GNSS errors over time; needs no display.

    Its axes: plan, height, wind where there is any, and with a receiver one each for the error of GNSS north, east, up.

    Raises:
        RunError: nothing was recorded yet, or a part of the log is damaged.
    """
    data = _read_data(run)
    figure = new_figure(13, 9)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1))
    windy, received = bool(np.any(data.mean) or np.any(data.gust)), data.reported is not None
    plan = figure.add_subplot(grid[0, 0] if received else grid[:, 0])
    draw_plan(plan, _plan_paths(data), data.around, data.terrain)
    _draw_height(figure.add_subplot(grid[0, 1] if windy else grid[:, 1]), data)
    if windy:
        _draw_wind(figure.add_subplot(grid[1, 1]), data)
    if received:
        errors: Any = grid[1, 0].subgridspec(len(ERRORS), 1, hspace=0.05).subplots(sharex=True, sharey=True)
        _gnss(errors, data)
        figure.align_ylabels(list(errors))
    title = title_of(run, data.names, len(data.stops), data.span[1]) + binned_text(data.time["truth"])
    task = _task_text(run, data)
    if task and run.info.score is not None:
        task = f"{task}; score {score_text(run.info.score)}"
    figure.suptitle(f"{title}\n{task}" if task else title)
    if data.few:
        # In the legend of the plan are other things too.
        handles, labels = plan.get_legend_handles_labels()
        named = dict(zip(labels, handles, strict=True))
        name_vehicles(figure, [named[name] for name in data.names], data.names)
    return figure


def save_figure(run: Run, path: Path) -> None:
    """Draw the summary figure of a run and save it.

    Raises:
        UsageError: the ending of the name is none that can be drawn.
        RunError: nothing was recorded yet, or the file cannot be written; what was there before is then left alone.
    """
    save_picture(lambda: draw_run(run), path)


def _read_data(run: Run) -> _Data:
    """Read everything that the summary figure of a run draws; raises RunError for a run without ticks."""
    rows = {stream: common_rows(run, stream)[0] for stream in STREAMS}
    if not all(map(len, rows.values())):
        raise RunError(f"{run.folder}: nothing to draw, because no tick was recorded (state: {run.info.state})")
    measured, sensor = run["measurements"], gnss_sensor(run)
    height = next((name for name in measured.columns() if name.endswith(".height")), None)
    gnss_time, error = gnss_error(run)
    terrain, setpoint = terrain_of(run), waypoints_of(run, rows["commands"])
    return _Data(
        names=run.vehicles,
        time={stream: run[stream].time[rows[stream]] for stream in STREAMS},
        position=vectors(run["truth"], "position_ned", rows["truth"]),
        setpoint=setpoint,
        reported=vectors(measured, f"{sensor}.position_ned", rows["measurements"]) if sensor else None,
        barometer=measured[height][rows["measurements"]] if height else None,
        gnss_time=gnss_time,
        gnss_error=error,
        mean=vectors(run["wind"], "mean_ned", rows["wind"]),
        gust=vectors(run["wind"], "gust_ned", rows["wind"]),
        stops=stops_of(run),
        time_step=run.info.time_step,
        colours=colours_of(len(run.vehicles)),
        around=surroundings_of(run),
        terrain=terrain,
        places=_places(run, setpoint),
    )


def _places(run: Run, setpoint: Floats) -> tuple[Floats, ...]:
    """Return places (K, 2) [m] for each vehicle: where its mission's legs end, or where its set-point stayed."""
    planned: list[Any] = []
    fleets = run.scenario.get("fleets") if isinstance(run.scenario, dict) else None
    for fleet in fleets.values() if isinstance(fleets, dict) else ():
        try:
            on_mission = fleet["guidance"]["type"] == "mission"
            planned += [_legs_of(vehicle) if on_mission else None for vehicle in fleet["vehicles"]]
        except (KeyError, TypeError, ValueError):  # of another version of qrsim
            planned = []
            break
    if len(planned) != len(run.vehicles):
        planned = [None] * len(run.vehicles)
    return tuple(held_places(setpoint[:, i]) if legs is None else legs for i, legs in enumerate(planned))


def _legs_of(vehicle: Any) -> Floats:
    """Return the places (K, 2), north and east [m], to which the legs or waypoints of a scenario's vehicle lead."""
    places = [leg.get("to_ned") or leg.get("at_ned") for leg in vehicle.get("legs") or ()]
    places = [place[:2] for place in (*places, *(vehicle.get("waypoints_ned") or ())) if place]
    return np.asarray(places, float).reshape(-1, 2)


def _plan_paths(data: _Data) -> Paths:
    """Return the paths, set-points and stops of the vehicles for the plan view."""
    wind = np.nanmean(data.mean * data.flying("wind")[..., None], axis=(0, 1))
    return Paths(
        data.names, data.position, data.setpoint, data.places, data.reported, tuple(data.stops), wind, data.colours
    )


def _task_text(run: Run, data: _Data) -> str:
    """Return the outcome of the run's task as text for the title; "" without a task."""
    around = data.around
    if around.task == "search" and len(around.persons):
        found = int(np.isfinite(around.found).sum())
        return f"task search: {found} of {len(around.persons)} persons found"
    if around.task == "plume_mapping" and len(around.locations):
        return f"task plume_mapping: {len(around.locations)} locations, scored by the answer for them"
    if around.task == "pursuit" and (distances := _nearest_prey(run, data)):
        told = ", ".join(f"{distance:.1f}" for distance in distances)
        return f"task pursuit: at the end the cats are {told} m from the nearest mouse"
    return f"task {around.task}" if around.task else ""


def _nearest_prey(run: Run, data: _Data) -> list[float]:
    """Return each hunter's distance [m] from the nearest prey at the last tick."""
    task, fleets = run.scenario["task"], run.scenario["fleets"]
    own = np.repeat(list(fleets), [len(fleet["vehicles"]) for fleet in fleets.values()])
    if len(own) != len(data.names):
        return []
    hunters, prey = (data.position[-1, own == task[role]] for role in ("fleet", "prey"))
    return [float(np.linalg.norm(prey - place, axis=-1).min()) for place in hunters] if len(prey) else []


def _draw_height(axes: Axes, data: _Data) -> None:
    """Draw the vehicles' true heights, and those of their set-points, over time."""
    ground = [data.terrain.down(each[..., 0], each[..., 1]) for each in (data.position, data.setpoint)]
    if data.terrain.level:
        ground = [np.zeros_like(each) for each in ground]
    height = (ground[0] - data.position[..., 2]) * data.flying("truth")
    wanted = ground[1] - data.setpoint[..., 2]
    label = "height [m]" if data.terrain.level else "height above ground [m]"
    if len(data.names) > MOST_LINES:
        spread(axes, data.time["commands"], wanted, SECOND, "--")
        spread(axes, data.time["truth"], height, FIRST)
        _label_time_axis(axes, data, label, "height: true (blue), set-point (orange); quartiles, range")
        return
    # A barometer knows of no ground.
    barometer = data.barometer if data.few and data.terrain.level else None
    for i, colour in enumerate(data.colours):
        trace(axes, data.time["commands"], wanted[:, i], ls="--", color=colour, lw=0.8, alpha=0.5)
        if barometer is not None:
            trace(axes, data.time["measurements"], barometer[:, i], color=colour, lw=0.7, alpha=0.7)
        trace(axes, data.time["truth"], height[:, i], color=colour, lw=1.6 if data.few else 0.9)
        if i in data.stops:
            axes.plot(
                data.stops[i].time,
                ground[0][-1, i] - data.position[-1, i, 2],
                "X",
                color=colour,
                ms=11,
                mec="black",
                zorder=5,
            )
    lines = "true (solid)" if barometer is None else "true (thick), barometer (thin)"
    _label_time_axis(axes, data, label, f"height: {lines}, set-point (dashed)")
    seen = [height, wanted, *([] if barometer is None else [barometer])]
    axes.set_ylim(span(np.concatenate(seen), 1.0))


def _gnss(panels: Any, data: _Data) -> None:
    """Draw the vehicles' GNSS errors over time, in one panel each for north, east and up."""
    for axes, (axis, sign, name) in zip(panels, ERRORS, strict=True):
        axes.axhline(0.0, color="gray", lw=0.8)
        for item in data.around.interference:
            axes.axvspan(item.start, min(item.end, data.span[1]), color="0.5", alpha=0.12, lw=0, zorder=0)
        _lines(axes, data, data.gnss_time, sign * data.gnss_error[..., axis])
        axes.set_ylabel(f"{name} [m]")
        time_limits(axes, *data.span)
        axes.grid(alpha=0.3)
    what = "reported minus true position at the time of the fix"
    panels[0].set_title(f"GNSS error: {what if data.few else 'at the time of the fix; median, quartiles and range'}")
    for row, item in enumerate(data.around.interference[:MOST_SAID]):
        # Each on a line of its own, where it begins.
        place = (max(item.start, data.span[0]), 1.0)
        panels[0].annotate(
            item.text,
            place,
            (2, -2 - 9 * row),
            xycoords=panels[0].get_xaxis_transform(),
            textcoords="offset points",
            fontsize=7,
            va="top",
            color="0.25",
        )
    panels[-1].set_xlabel("time [s]")


def _draw_wind(axes: Axes, data: _Data) -> None:
    """Draw the speed of the wind with gusts, and of the mean wind, over time."""
    flying = data.flying("wind")
    mean = np.linalg.norm(data.mean, axis=-1) * flying
    total = np.linalg.norm(data.mean + data.gust, axis=-1) * flying
    _lines(axes, data, data.time["wind"], mean, ":", SECOND)
    _lines(axes, data, data.time["wind"], total)
    key = "with gusts (solid), mean (dotted)"
    if not data.few:
        key = "with gusts (blue), mean (orange); quartiles, range"
    _label_time_axis(axes, data, "wind speed [m/s]", f"wind: {key}")
    from_zero(axes)


def _lines(axes: Axes, data: _Data, time: Floats, values: Floats, style: str = "-", colour: object = FIRST) -> None:
    """Draw a quantity (E, n) over times (E,), as one line per vehicle, or as the spread over many vehicles."""
    if not data.few:
        spread(axes, time, values, colour, style)
        return
    for i, own in enumerate(data.colours):
        trace(axes, time, values[:, i], ls=style, color=own, lw=1.1)


def _label_time_axis(axes: Axes, data: _Data, label: str, title: str) -> None:
    """Set label, title, grid and limits of a panel with time as its horizontal axis."""
    axes.set(xlabel="time [s]", ylabel=label, title=title)
    time_limits(axes, *data.span)
    axes.grid(alpha=0.3)
