"""What happened in a run, per vehicle, from its log."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from qrsim.logs.reader import Run, Stream

Floats = np.ndarray[Any, Any]
NOT_A_STOP = ("waypoint_reached", "command_clipped", "fault_begins", "fault_ends", "fix_lost", "fix_found")


@dataclass(frozen=True)
class VehicleSummary:
    """One vehicle's run; NaN where a quantity was not recorded.

    Attributes:
        vehicle: name.
        distance_m: length of the true path.
        tracking_error_rms_m: distance of the true position from the leg being flown (a point while it is held); NaN
            where no waypoint was.
        gnss_horizontal_rms_m, gnss_vertical_rms_m: what the receiver reports minus the truth at that moment, so the
            delay of the fix counts, over the epochs at which a new fix was reported.
        worst_wind_m_s: largest speed of the air at the vehicle while it flies, gusts included.
        waypoints: how many it reached.
        stopped: why it stopped flying, "" if it did not.
    """

    vehicle: str
    distance_m: float
    tracking_error_rms_m: float
    gnss_horizontal_rms_m: float
    gnss_vertical_rms_m: float
    worst_wind_m_s: float
    waypoints: int
    stopped: str

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name, None in place of NaN (JSON has no NaN)."""
        return {
            name: None if isinstance(value, float) and not np.isfinite(value) else value
            for name, value in asdict(self).items()
        }


def vectors(stream: Stream, name: str, length: int | None = None) -> Floats:
    """Return (T, n, 3) of a quantity recorded as NAME.x, NAME.y, NAME.z; the first ``length`` rows, or all."""
    arrays = stream.arrays([f"{name}.{axis}" for axis in "xyz"])
    return np.stack([np.asarray(array, np.float64)[:length] for array in arrays.values()], axis=-1)


def waypoints_of(run: Run, length: int | None = None) -> Floats:
    """Return (T, n, 3) the waypoint each vehicle was asked to fly to [m], NaN where it was asked for something else."""
    commands = run["commands"]
    if "setpoint.position_ned.x" in commands:
        return vectors(commands, "setpoint.position_ned", length)
    return np.full((len(commands.time[:length]), len(run.vehicles), 3), np.nan)


def common_length(run: Run) -> int:
    """Return how many ticks all streams have; they differ by some where a disk ran full."""
    return min(len(run[stream].time) for stream in ("truth", "measurements", "commands", "wind"))


def gnss_sensor(run: Run) -> str | None:
    """Return the name of the first sensor that reports a position, None where there is none."""
    for column in run["measurements"].columns():
        if column.endswith(".position_ned.x"):
            return column.removesuffix(".position_ned.x")
    return None


def gnss_error(run: Run) -> tuple[Floats, Floats]:
    """Return (times (E,), errors (E, n, 3) [m] in NED) at the epochs E at which any receiver reported a new fix."""
    sensor, length = gnss_sensor(run), common_length(run)
    truth = vectors(run["truth"], "position_ned", length)
    if sensor is None:
        return np.zeros(0), np.zeros((0, truth.shape[1], 3))
    reported = vectors(run["measurements"], f"{sensor}.position_ned", length)
    fresh = np.ones(len(reported), bool)
    changed = (reported[1:] != reported[:-1]) & np.isfinite(reported[1:])
    fresh[1:] = changed.any(axis=(1, 2))
    return run["truth"].time[:length][fresh], (reported - truth)[fresh]


def tracking_error(position: Floats, waypoint: Floats) -> Floats:
    """Return the distance (T, n) [m] of positions (T, n, 3) from the leg that leads to each waypoint (T, n, 3)."""
    error = np.empty(position.shape[:2])
    for vehicle in range(position.shape[1]):
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
    """Root mean square without NaN; NaN where nothing is left."""
    count = np.sum(np.isfinite(values), axis=axis)
    total = np.nansum(np.square(values), axis=axis)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def summarise(run: Run) -> list[VehicleSummary]:
    """Return one summary per vehicle, in the order of the run's vehicles."""
    length = common_length(run)
    position = vectors(run["truth"], "position_ned", length)
    flying = np.where(run["truth"]["valid"][:length].astype(bool), 1.0, np.nan)
    tracking = _rms(tracking_error(position, waypoints_of(run, length)) * flying)
    _, gnss = gnss_error(run)
    horizontal, vertical = _rms(np.linalg.norm(gnss[..., :2], axis=-1)), _rms(gnss[..., 2])
    air = vectors(run["wind"], "mean_ned", length) + vectors(run["wind"], "gust_ned", length)
    wind = np.linalg.norm(air, axis=-1) * flying
    distance = np.linalg.norm(np.diff(position, axis=0), axis=-1).sum(axis=0)
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
            )
        )
    return summaries
