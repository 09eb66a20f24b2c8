"""Summary of a run, per vehicle, from its log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.runs.layout import OVERFULL, ZONE_ENTERED, ZONE_LEFT, Event
from qrsim.runs.reader import Run
from qrsim.runs.stream_arrays import Stream
from qrsim.runs.terrain import terrain_of

Rows = NumpyArray
STREAMS = ("truth", "measurements", "commands", "wind")
CHARGE = "battery.charge"
# What a failsafe noticed, with the number of its action (control/failsafes.py).
FAILSAFE = "failsafe"
# A set-point so far below the ground [m] is one of a landing.
BELOW_M = 0.05
# Without a contact that reports it, a vehicle is in the air at this height [m], or under way at this speed [m/s].
AIRBORNE_M, AIRBORNE_M_S = 0.1, 0.1
NOT_A_STOP = (
    "waypoint_reached",
    "command_clipped",
    "fault_begins",
    "fault_ends",
    "no_fix",
    "fix_lost",
    "fix_found",
    "injected",
    "cleared",
    "wind_changed",
    "gusts_changed",
    "jammer_changed",
    "person_found",
    "leg_timeout",
    "mission_finished",
    "mission_unfinished",
    "landed",
    "took_off",
    ZONE_LEFT,
    ZONE_ENTERED,
    FAILSAFE,
    "failsafe_ends",
    OVERFULL,
)


@dataclass(frozen=True)
class VehicleSummary:
    """Summary of one vehicle; NaN where a quantity was not recorded.

    Each number is of the ticks at which all streams that it needs were logged.

    Attributes:
        vehicle: name.
        distance_m: length of the true path.
        tracking_error_rms_m: distance of the true position from the leg being flown (a point while it is held); NaN
            where no waypoint was.
        gnss_horizontal_rms_m, gnss_vertical_rms_m: reported position minus the true one at the time of the fix, over
            the epochs at which a new fix was reported.
        worst_wind_m_s: largest speed of the air at the vehicle while it flies, gusts included.
        waypoints: how many it reached.
        stopped: why it stopped flying, "" if it did not.
        height_error_rms_m: true height minus that of the waypoint, or of the point of a path; NaN without one.
        charge_least: lowest charge of the battery before a stop, 1 full and 0 empty; NaN without one that drains.
        endurance_s: how long the battery would last, from its charge at the start, at the mean consumption in the air;
            NaN without one that drains, or without a flight.
        failsafes: how many times a failsafe took over.
    """

    vehicle: str
    distance_m: float
    tracking_error_rms_m: float
    gnss_horizontal_rms_m: float
    gnss_vertical_rms_m: float
    worst_wind_m_s: float
    waypoints: int
    stopped: str
    height_error_rms_m: float = math.nan
    charge_least: float = math.nan
    endurance_s: float = math.nan
    failsafes: int = 0

    def to_json(self) -> dict[str, object]:
        """Return the summary of a vehicle's flight as a dict for JSON, with None in place of NaN."""
        return {
            name: None if isinstance(value, float) and not np.isfinite(value) else value
            for name, value in asdict(self).items()
        }


# More agents than this are not told one by one.
MOST_TOLD = 6


def score_text(score: Mapping[str, Any]) -> str:
    """Return a flight's score in its task (``RunInfo.score``) as text."""
    returns, steps = dict(score["agents"]), f"step {score['steps']} of {score['of_steps']}"
    ends = {
        "flown_to_the_end": "flown to the end",
        "crashed": f"a vehicle stopped in {steps}, which ended the episode",
        "unfinished": f"unfinished, {steps}",
        "not_finite": f"not finite, after {steps}",
    }
    words = [ends.get(score["outcome"], str(score["outcome"]))]
    if score.get("handed_in") is False:
        words.append("nothing was handed in, which counts as zeros")
    if score["return"] is None:
        return f"none, {'; '.join(words)}"
    told = f"{score['return']:.4g}"
    fleets = score.get("fleets") or {}
    if fleets:
        first, *others = fleets
        means = [f"{fleet} {'none' if fleets[fleet] is None else format(fleets[fleet], '.4g')}" for fleet in others]
        told += f", mean of {first}; {', '.join(means)}"
    elif len(returns) > 1:
        values = [value for value in returns.values() if value is not None]
        if min(values) == max(values):
            told += f", the same for all {len(returns)} agents"
        elif len(returns) <= MOST_TOLD:
            told += f", mean of {', '.join(f'{name} {value:.4g}' for name, value in returns.items())}"
        else:
            told += f", mean of {len(returns)} agents, {min(values):.4g} to {max(values):.4g}"
    return f"{told} ({'; '.join(words)})"


def common_rows(run: Run, *streams: str) -> list[Rows]:
    """Return, for each stream, the row indices of the ticks that all of the streams have.

    Streams of different decimation have different ticks. Where a disk ran full or the process was killed, some streams
    are longer than others: the rows end where the first of all ends.
    """
    ends = [run[name].tick[-1:] + run.info.every.get(name, 1) for name in STREAMS]
    ticks = [run[name].tick for name in streams]
    common = reduce(np.intersect1d, ticks)
    common = common[common < min(int(end[0]) if len(end) else 0 for end in ends)]
    return [np.searchsorted(own, common) for own in ticks]


def vectors(stream: Stream, name: str, rows: Rows | slice = slice(None)) -> Floats:
    """Read a vector quantity logged as NAME.x, NAME.y, NAME.z as an array (T, n, 3), at some rows or all."""
    arrays = stream.arrays([f"{name}.{axis}" for axis in "xyz"])
    return np.stack([np.asarray(array, np.float64)[rows] for array in arrays.values()], axis=-1)


def waypoints_of(run: Run, rows: Rows | slice = slice(None)) -> Floats:
    """Return each vehicle's target waypoint (T, n, 3) NED [m]; NaN under other commands and after landings."""
    commands = run["commands"]
    if "setpoint.position_ned.x" in commands:
        found = vectors(commands, "setpoint.position_ned", rows)
        # A landing ends on the ground, but the point that it follows goes on, through it.
        below = found[..., 2] > terrain_of(run).down(found[..., 0], found[..., 1]) + BELOW_M
        return np.where(below[..., None], np.nan, found)
    return np.full((len(commands.time[rows]), len(run.vehicles), 3), np.nan)


def stops_of(run: Run) -> dict[int, Event]:
    """Return vehicle index -> the event that ended the vehicle's flight, for each stopped vehicle."""
    stops = [event for event in run.events if event.kind not in NOT_A_STOP and event.vehicle is not None]
    return {run.vehicles.index(str(event.vehicle)): event for event in reversed(stops)}


def gnss_sensor(run: Run) -> str | None:
    """Return the name of the first sensor that reports a position, None where there is none."""
    for column in run["measurements"].columns():
        if column.endswith(".position_ned.x"):
            return column.removesuffix(".position_ned.x")
    return None


def gnss_error(run: Run) -> tuple[Floats, Floats]:
    """Return times (E,) [s] and GNSS errors (E, n, 3) NED [m] at the E epochs at which any receiver had a new fix.

    An error is the reported position minus the true one at the time of the fix, so the latency of a receiver is none.
    Epochs at which the last receiver loses its fix are there too, as NaN. Epochs at which the truth was not logged are
    left out.
    """
    sensor = gnss_sensor(run)
    if sensor is None:
        return np.zeros(0), np.zeros((0, len(run.vehicles), 3))
    reported = vectors(run["measurements"], f"{sensor}.position_ned")
    fresh = np.ones(len(reported), bool)
    changed = (reported[1:] != reported[:-1]) & np.isfinite(reported[1:])
    # Where all have lost it there is no error, and no line between the fixes before and after.
    known: Floats = np.asarray(np.isfinite(reported).any(axis=(1, 2)))
    fresh[1:] = changed.any(axis=(1, 2)) | (known[:-1] & ~known[1:])
    _, rows = common_rows(run, "truth", "measurements")
    rows = rows[fresh[rows]]
    time = run["measurements"].time[rows]
    return time, reported[rows] - _truth_at(run, time, gnss_latency(run, sensor))


def gnss_latency(run: Run, sensor: str) -> Floats:
    """Return the latency (n,) [s] of a receiver's fixes for each vehicle, from the run's scenario."""
    found: list[float] = []
    fleets = run.scenario.get("fleets") if isinstance(run.scenario, dict) else None
    for fleet in fleets.values() if isinstance(fleets, dict) else ():
        try:
            own = (fleet.get("sensors") or {}).get(sensor) or {}
            latency = float(own.get("delay") or 0.0) * float(own.get("period") or run.info.time_step)
            found += [latency if math.isfinite(latency) else 0.0] * len(fleet["vehicles"])
        except (AttributeError, KeyError, TypeError, ValueError):  # of another version of qrsim
            return np.zeros(len(run.vehicles))
    return np.array(found) if len(found) == len(run.vehicles) else np.zeros(len(run.vehicles))


def _truth_at(run: Run, time: Floats, latency: Floats) -> Floats:
    """Return true positions (E, n, 3) [m] at times (E,) [s] minus a latency (n,) [s]."""
    truth, known = vectors(run["truth"], "position_ned"), run["truth"].time
    found = np.empty((len(time), *truth.shape[1:]))
    # A run that was killed at once has no ticks, and one with a damaged part may have no truth.
    for vehicle, axis in np.ndindex(*truth.shape[1:]) if len(time) else ():
        found[:, vehicle, axis] = np.interp(time - latency[vehicle], known, truth[:, vehicle, axis])
    return found


def radii_of(run: Run, rows: Rows | slice = slice(None)) -> Floats:
    """Return each vehicle's circling radius (T, n) [m] about its waypoint; 0 or NaN if it does not circle."""
    commands = run["commands"]
    if "setpoint.radius" in commands:
        return np.asarray(commands["setpoint.radius"], np.float64)[rows]
    return np.zeros((len(commands.time[rows]), len(run.vehicles)))


def circling_error(position: Floats, centre: Floats, radius: Floats) -> Floats:
    """Return the distance (T, n) [m] of positions (T, n, 3) from level circles about centres (T, n, 3)."""
    away = position - centre
    return np.hypot(np.hypot(away[..., 0], away[..., 1]) - np.abs(radius), away[..., 2])


def tracking_error(position: Floats, waypoint: Floats) -> Floats:
    """Return the distance (T, n) [m] of positions (T, n, 3) from the leg that leads to each waypoint (T, n, 3)."""
    error = np.empty(position.shape[:2])
    # A run that was killed at once has no ticks.
    for vehicle in range(position.shape[1]) if len(position) else ():
        target, place = waypoint[:, vehicle], position[:, vehicle]
        same = (target[1:] == target[:-1]) | np.isnan(target[1:]) & np.isnan(target[:-1])
        changes = 1 + np.flatnonzero(~np.all(same, axis=1))
        bounds = [0, *changes, len(target)]
        origin = place[0]
        for begin, end in pairwise(bounds):
            goal = target[begin]
            leg, offset = goal - origin, place[begin:end] - origin
            length_squared = float(leg @ leg)
            along = np.clip(offset @ leg / length_squared, 0.0, 1.0) if length_squared > 0 else np.zeros(end - begin)
            error[begin:end, vehicle] = np.linalg.norm(offset - along[:, None] * leg, axis=1)
            origin = goal if np.isfinite(goal).all() else place[end - 1]
    return error


def _rms(values: Floats, axis: int | tuple[int, ...] = 0) -> Floats:
    """Return the root mean square along axes, ignoring NaN; NaN if all values are NaN."""
    count = np.sum(np.isfinite(values), axis=axis)
    total = np.nansum(np.square(values), axis=axis)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _without_start(waypoints: Floats, flying: Floats) -> Floats:
    """Return waypoints (T, n, 3) with NaN for vehicles whose only waypoint is the start."""
    replaced = np.isfinite(waypoints[1:, :, 2]).sum(axis=0) == 0
    return np.where((replaced & (np.nansum(flying, axis=0) > 1.0))[:, None], np.nan, waypoints)


def summarise(run: Run) -> list[VehicleSummary]:
    """Return a summary of each vehicle's flight (errors, distances, battery), in the order of the run's vehicles."""
    position = vectors(run["truth"], "position_ned")
    flying = np.where(run["truth"]["valid"].astype(bool), 1.0, np.nan)
    [rows] = common_rows(run, "truth")
    distance = np.linalg.norm(np.diff(position[rows], axis=0), axis=-1).sum(axis=0)
    rows, commanded = common_rows(run, "truth", "commands")
    waypoints = _without_start(waypoints_of(run, commanded), flying[rows])
    radius = radii_of(run, commanded)
    on_legs, on_circles = tracking_error(position[rows], waypoints), circling_error(position[rows], waypoints, radius)
    tracking = _rms(np.where(np.abs(radius) > 0.0, on_circles, on_legs) * flying[rows])
    too_low = _rms((position[rows, :, 2] - waypoints[..., 2]) * flying[rows])
    _, gnss = gnss_error(run)
    horizontal, vertical = _rms(np.linalg.norm(gnss[..., :2], axis=-1)), _rms(gnss[..., 2])
    rows, windy = common_rows(run, "truth", "wind")
    air = vectors(run["wind"], "mean_ned", windy) + vectors(run["wind"], "gust_ned", windy)
    wind = np.linalg.norm(air, axis=-1) * flying[rows]
    charge, endurance = _battery(run, position, run["truth"]["valid"].astype(bool))
    events = run.events
    summaries = []
    for i, name in enumerate(run.vehicles):
        own = [event for event in events if event.vehicle == name]
        stops = [event for event in own if event.kind not in NOT_A_STOP]
        summaries.append(
            VehicleSummary(
                name,
                float(distance[i]),
                float(tracking[i]),
                float(horizontal[i]),
                float(vertical[i]),
                float(np.nanmax(wind[:, i], initial=0.0)),
                sum(event.kind == "waypoint_reached" for event in own),
                f"{stops[0].kind} at {stops[0].time:.2f} s" if stops else "",
                float(too_low[i]),
                float(charge[i]),
                float(endurance[i]),
                sum(event.kind == FAILSAFE and (event.value or 0.0) > 0.0 for event in own),
            )
        )
    return summaries


def _battery(run: Run, position: Floats, flying: Rows) -> tuple[Floats, Floats]:
    """Return each vehicle's lowest charge (0 to 1) and endurance [s], each (n,); NaN without a battery that drains."""
    truth = run["truth"]
    if CHARGE not in truth or not len(position):
        none = np.full(len(run.vehicles), math.nan)
        return none, none
    charge = np.asarray(truth[CHARGE], np.float64)
    airborne = (flying & _airborne(run, position))[1:]
    used = np.sum(np.maximum(-np.diff(charge, axis=0), 0.0) * airborne, axis=0)
    time = np.sum(np.diff(truth.time)[:, None] * airborne, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        endurance = np.where(used > 0.0, charge[0] * time / used, math.nan)
    # The charge of a vehicle that has stopped goes on falling.
    return np.fmin.reduce(np.where(flying, charge, math.nan), axis=0, initial=math.nan), endurance


def _airborne(run: Run, position: Floats) -> Rows:
    """Return a mask (T, n) of vehicles in the air, or, for ground vehicles, in motion."""
    truth = run["truth"]
    height = terrain_of(run).down(position[..., 0], position[..., 1]) - position[..., 2]
    found = height > AIRBORNE_M
    if "velocity_body.x" in truth:
        found = found | (np.linalg.norm(vectors(truth, "velocity_body"), axis=-1) > AIRBORNE_M_S)
    return found & ~truth["on_ground"].astype(bool) if "on_ground" in truth else found
