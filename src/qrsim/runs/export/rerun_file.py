"""rerun: a whole run for the viewer of rerun (.rrd), in its chunks of columns.

``world`` is east, north, up from the run's origin, as in MCAP files, and vehicles have axes forward, left, up.
Entities, with V a vehicle: world/V (pose), world/paths/V (the whole
true path), world/gnss/V (reported positions), world/area and world/obstacles, map/V (latitude and longitude), events
(log), and STREAM/V/COLUMN (a number of the log). Columns keep their names and axes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from qrsim.core.arrays import Floats
from qrsim.errors import RunError
from qrsim.interface.arrays import quaternion_of
from qrsim.runs import Run
from qrsim.runs.colours import GREY, KEEP_OUT, VEHICLES
from qrsim.runs.export.output import Written, is_readable, replacing
from qrsim.runs.export.place import Place
from qrsim.runs.export.tracks import axes, position_sensors
from qrsim.runs.layout import EVENTS, INDEX
from qrsim.runs.summary import NOT_A_STOP
from qrsim.runs.surroundings import surroundings_of

TIMELINE = "time"
# Corners of a whole path; size of a vehicle as it is drawn [m].
MOST_CORNERS, SIZE = 5000, 1.0


def write(run: Run, place: Place, path: Path, every: int) -> Written:
    """Write the run to a Rerun file: every ``every``-th tick of all streams, and all events.

    Raises:
        RunError: the file cannot be written, or there is nothing to write.
    """
    streams = [name for name in run.streams if name != EVENTS and is_readable(run, name)]
    if not any(len(run[name].time) for name in streams):
        raise RunError(f"{run.folder}: nothing to export, because no tick was recorded (state: {run.info.state})")
    with replacing(path) as file:
        out = rr.RecordingStream("qrsim", recording_id=f"{run.info.scenario} {run.info.seed}", send_properties=False)
        out.save(file.name)
        out.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        _log_surroundings(out, run)
        count = sum(_log_stream(out, run, place, stream, every) for stream in streams)
        if EVENTS in run and is_readable(run, EVENTS):
            _log_events(out, run)
        out.flush()
        out.disconnect()
    return Written(path, {"series": count})


def _enu(ned: Any) -> Floats:
    """Convert vectors (..., 3) from NED to ENU: east, north, up."""
    ned = np.asarray(ned, np.float64)
    return np.stack([ned[..., 1], ned[..., 0], -ned[..., 2]], axis=-1)


def _log_stream(out: rr.RecordingStream, run: Run, place: Place, stream: str, every: int) -> int:
    """Write a stream's time series to Rerun, and its poses and fixes as 3-D objects; return the number of series."""
    columns = [
        column.name
        for column in run.describe(stream)[len(INDEX) :]
        if column.dtype.startswith(("float", "int", "uint", "bool"))
    ]
    paths: list[Floats] = []
    for batch in run[stream].batches(columns):
        rows = np.flatnonzero(np.asarray(batch.tick) % every == 0)
        if not len(rows):
            continue
        time = rr.TimeColumn(TIMELINE, duration=batch.time[rows])
        arrays = {name: np.asarray(batch.arrays[name], np.float64)[rows] for name in columns}
        for i, vehicle in enumerate(run.vehicles):
            for name, values in arrays.items():
                entity = rr.new_entity_path([stream, vehicle, name])
                out.send_columns(entity, [time], rr.Scalars.columns(scalars=values[:, i]))
        if stream == "truth":
            paths.append(_log_poses(out, run, place, time, arrays))
    if paths:
        _log_paths(out, run, np.concatenate(paths))
    if stream == "measurements":
        for sensor in position_sensors(run)[:1]:
            _log_fixes(out, run, sensor, every)
    return len(columns) * len(run.vehicles)


def _vectors(arrays: dict[str, Floats], name: str) -> Floats | None:
    """Stack NAME.x, NAME.y, NAME.z, arrays (T, n), to vectors (T, n, 3); None if one axis was not recorded."""
    names = axes(name)
    return np.stack([arrays[part] for part in names], axis=-1) if all(part in arrays for part in names) else None


def _log_poses(
    out: rr.RecordingStream, run: Run, place: Place, time: rr.TimeColumn, arrays: dict[str, Floats]
) -> Floats:
    """Write each vehicle's pose and location on the map to Rerun; return their positions (T, n, 3) in ENU [m]."""
    position = _vectors(arrays, "position_ned")
    angles = [arrays.get(f"attitude.{angle}") for angle in ("roll", "pitch", "yaw")]
    if position is None:
        return np.zeros((0, len(run.vehicles), 3))
    where = _enu(position)
    for i, vehicle in enumerate(run.vehicles):
        entity = rr.new_entity_path(["world", vehicle])
        parts: dict[str, Any] = {"translation": where[:, i]}
        known = [angle[:, i] for angle in angles if angle is not None]
        if len(known) == 3:
            roll, pitch, yaw = known
            turned = quaternion_of(np.stack((roll, -pitch, np.pi / 2 - yaw), axis=-1))
            parts["quaternion"] = turned[:, [1, 2, 3, 0]]
        out.send_columns(entity, [time], rr.Transform3D.columns(**parts))
        latitude_longitude = place.geodetic(position[:, i])[:, :2]
        out.send_columns(
            rr.new_entity_path(["map", vehicle]), [time], rr.GeoPoints.columns(positions=latitude_longitude)
        )
    return where


def _log_fixes(out: rr.RecordingStream, run: Run, sensor: str, every: int) -> None:
    """Write the positions that a GNSS receiver reports to Rerun."""
    names = axes(f"{sensor}.position_ned")
    for batch in run["measurements"].batches(names):
        rows = np.flatnonzero(np.asarray(batch.tick) % every == 0)
        reported = np.stack([np.asarray(batch.arrays[name], np.float64)[rows] for name in names], axis=-1)
        for i, vehicle in enumerate(run.vehicles):
            known = np.isfinite(reported[:, i]).all(axis=1)
            if known.any():
                time = rr.TimeColumn(TIMELINE, duration=batch.time[rows][known])
                points = rr.Points3D.columns(positions=_enu(reported[known, i]))
                out.send_columns(rr.new_entity_path(["world", "gnss", vehicle]), [time], points)


def _log_paths(out: rr.RecordingStream, run: Run, where: Floats) -> None:
    """Write each vehicle's body and whole path to Rerun; ``where`` are true positions (T, n, 3) in ENU [m]."""
    step = 1 + len(where) // MOST_CORNERS
    for i, vehicle in enumerate(run.vehicles):
        path = where[::step, i]
        colour = VEHICLES[i % len(VEHICLES)].tolist()
        line = rr.LineStrips3D([path[np.isfinite(path).all(axis=1)]], colors=[colour])
        out.log(rr.new_entity_path(["world", "paths", vehicle]), line, static=True)
        body = rr.Arrows3D(vectors=[[SIZE, 0.0, 0.0]], colors=[colour], labels=[vehicle], radii=[0.1 * SIZE])
        out.log(rr.new_entity_path(["world", vehicle]), body, static=True)


def _log_surroundings(out: rr.RecordingStream, run: Run) -> None:
    """Write area, zones and obstacles of a run to Rerun as lines."""
    around = surroundings_of(run)
    top, bottom = around.down
    rings = [(around.outline, GREY, top, bottom)] if len(around.outline) and not around.zones else []
    for zone in around.zones:
        low, high = bottom if zone.floor <= 0.0 else -zone.floor, max(top, -zone.ceiling)
        rings += [(np.asarray(ring), GREY if zone.keep else KEEP_OUT, high, low) for ring in zone.rings]
    for number, (ring, colour, high, low) in enumerate(rings):
        out.log(f"world/area/{number}", _prism(ring, high, low, colour), static=True)
    for number, item in enumerate(around.obstacles):
        out.log(f"world/obstacles/{number}", _prism(_outline(item), item["z_min"], item["z_max"], GREY), static=True)


def _outline(item: Any) -> Floats:
    """Return the corners (V, 2), north and east [m], of an obstacle's outline from above."""
    if "corners_ned" in item:
        return np.asarray(item["corners_ned"], float)[:, :2]
    if "radius" in item:
        turn = np.arange(24) * (2.0 * np.pi / 24)
        round_it = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return np.array([item["x"], item["y"]]) + item["radius"] * round_it
    (south, north), (west, east) = ((item[f"{axis}_min"], item[f"{axis}_max"]) for axis in "xy")
    return np.array([(south, west), (south, east), (north, east), (north, west)], float)


def _prism(ring: Floats, high: float, low: float, colour: Any) -> rr.LineStrips3D:
    """Return the edges of a prism as Rerun lines: corners (V, 2), from down coordinate ``high`` to ``low`` [m]."""
    levels = [_enu(np.column_stack([ring, np.full(len(ring), level)])) for level in (high, low)]
    strips = [np.concatenate([level, level[:1]]) for level in levels]
    return rr.LineStrips3D([*strips, *np.stack(levels, axis=1)], colors=[list(colour)])


def _log_events(out: rr.RecordingStream, run: Run) -> None:
    """Write the events of a run to Rerun as a text log."""
    for event in sorted(run.events, key=lambda event: event.time):
        out.set_time(TIMELINE, duration=event.time)
        level = rr.TextLogLevel.INFO if event.kind in NOT_A_STOP else rr.TextLogLevel.ERROR
        words = f"{event.vehicle or ''} {event.message or event.kind}".strip()
        out.log("events", rr.TextLog(words, level=level))
