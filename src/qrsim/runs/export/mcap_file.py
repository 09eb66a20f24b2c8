"""mcap: a whole run for Foxglove and other robot viewers (MCAP, JSON messages).

qrsim's axes are north, east, down and, of a vehicle, forward, right, down. Foxglove draws z upwards, so poses are
given in frame "map", east, north, up, with the run's origin, of axes forward, left, up of the vehicle: position
(y, x, -z); Euler angles (roll, -pitch, 90 deg - yaw). Wind, commands and readings keep the names and axes of the log.

Topics, with V a vehicle and S a sensor: /V/pose and /tf (true pose), /V/location (true place, for the map),
/V/S/fix (each new report of a receiver), /V/wind, /V/command, /V/setpoint, /V/estimate, /V/S (readings), /V/waypoints,
/scene (what else there is), /events. In topics, characters of V and S other than letters,
digits and _.-~ are percent-encoded.
"""

from __future__ import annotations

import heapq
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
import numpy.typing as npt
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from qrsim.errors import RunError
from qrsim.interface.arrays import quaternion_of
from qrsim.runs import Event, Run
from qrsim.runs.export import foxglove
from qrsim.runs.export.mcap_messages import Group, Message, groups_of, messages_of, topics_of
from qrsim.runs.export.mcap_scene import scene
from qrsim.runs.export.output import Written, is_readable, replacing
from qrsim.runs.export.place import Floats, Place
from qrsim.runs.export.tracks import Samples, axes, is_fresh, position_sensors, read_samples
from qrsim.runs.layout import OVERFULL, ZONE_ENTERED, ZONE_LEFT
from qrsim.runs.summary import NOT_A_STOP
from qrsim.runs.surroundings import surroundings_of

WORLD = "map"
# Foxglove's timestamps count the seconds since 1970 in 32 bits.
LAST_START_US = 2**32 * 1_000_000
WARNINGS = (
    "command_clipped",
    "fault_begins",
    "injected",
    "no_fix",
    "fix_lost",
    "failsafe",
    OVERFULL,
    ZONE_LEFT,
    ZONE_ENTERED,
)


def write(run: Run, place: Place, path: Path, every: int) -> Written:
    """Write the run to an MCAP file for Foxglove in order of time, every ``every``-th tick, with all events.

    What is not a number is left out: JSON cannot say it.

    Raises:
        RunError: the file cannot be written, there is nothing to write, or the time does not fit into the format.
    """
    if not 0 <= place.start_us < LAST_START_US:
        raise RunError(f"{run.folder}: its start_time is outside 1970 to 2106, the range of MCAP")
    count = 0
    with replacing(path) as file:
        writer = Writer(file)
        writer.start(library="qrsim")
        groups = groups_of(run)
        channels = _Channels(writer, {group.schema: group.describe() for group in groups})
        for message in heapq.merge(*_sources(run, place, every, groups), key=lambda message: message.time_ns):
            content = {"timestamp": _timestamp(message.time_ns), **message.content}
            data = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
            writer.add_message(channels.number(message), message.time_ns, data, message.time_ns)
            count += 1
        if not count:
            raise RunError(f"{run.folder}: nothing to export, because no tick was recorded (state: {run.info.state})")
        writer.add_metadata("qrsim", _origin(run, place))
        writer.finish()
    return Written(path, {"messages": count})


class _Channels:
    """The numbers of the file's channels, which are made when they are first used."""

    def __init__(self, writer: Writer, schemas: dict[str, foxglove.Schema]):
        self._writer, self._known = writer, {**schemas, **foxglove.SCHEMAS}
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def number(self, message: Message) -> int:
        """Return the ID of the MCAP channel for a message's topic, registered in the file at first use."""
        topic, schema = message.topic, message.schema
        if schema not in self._schemas:
            data = json.dumps({"title": schema, **self._known[schema]}).encode()
            self._schemas[schema] = self._writer.register_schema(schema, SchemaEncoding.JSONSchema, data)
        if topic not in self._channels:
            number = self._writer.register_channel(topic, MessageEncoding.JSON, self._schemas[schema])
            self._channels[topic] = number
        return self._channels[topic]


def _sources(run: Run, place: Place, every: int, groups: list[Group]) -> list[Iterator[Message]]:
    """Return iterators over a run's MCAP messages, each by time: poses, scene, fixes, wind, events, ``groups``."""
    sources = [messages_of(run, place, every, group) for group in groups]
    sources.append(scene(run, place, surroundings_of(run), WORLD))
    sources += [_fixes(run, place, every, sensor) for sensor in position_sensors(run)]
    if is_readable(run, "truth"):
        sources.insert(0, _pose_messages(run, place, every))
    if is_readable(run, "wind"):
        sources.append(_wind_messages(run, place, every))
    if is_readable(run, "events"):
        sources.append(_event_messages(run.events, place))
    return sources


def _pose_messages(run: Run, place: Place, every: int) -> Iterator[Message]:
    """Yield Foxglove messages with pose and location of each vehicle."""
    columns = axes("position_ned") + [f"attitude.{angle}" for angle in ("roll", "pitch", "yaw")]
    topics = topics_of(run, "pose"), topics_of(run, "location")
    for samples in _finite(run, "truth", columns, every):
        north, east, down, roll, pitch, yaw = samples.values.T
        places = place.geodetic(samples.values[:, :3]).tolist()
        positions = np.stack((east, north, -down), axis=-1).tolist()
        rotations = quaternion_of(np.stack((roll, -pitch, np.pi / 2 - yaw), axis=-1)).tolist()
        times = place.nanoseconds(samples.times).tolist()
        for i, vehicle in enumerate(samples.vehicles.tolist()):
            name, position = run.vehicles[vehicle], dict(zip("xyz", positions[i], strict=True))
            rotation = dict(zip("wxyz", rotations[i], strict=True))
            pose = {"frame_id": WORLD, "pose": {"position": position, "orientation": rotation}}
            yield Message(times[i], topics[0][vehicle], foxglove.POSE, pose)
            frames = {"parent_frame_id": WORLD, "child_frame_id": name}
            yield Message(times[i], "/tf", foxglove.FRAME, {**frames, "translation": position, "rotation": rotation})
            yield Message(times[i], topics[1][vehicle], foxglove.FIX, _fix(name, places[i]))


def _fixes(run: Run, place: Place, every: int, sensor: str) -> Iterator[Message]:
    """Yield Foxglove location messages with a receiver's new fixes; repeated values between fixes are left out."""
    topics = topics_of(run, quote(sensor, safe=""), "fix")
    last = np.full((len(run.vehicles), 3), np.nan)
    known = {column.name for column in run.describe("measurements")}
    # What the receiver states itself, else its dilution of precision times the errors of its ranges.
    stated = [name for name in (f"{sensor}.horizontal_accuracy", f"{sensor}.vertical_accuracy") if name in known]
    dops = [name for name in (f"{sensor}.hdop", f"{sensor}.vdop") if name in known]
    spread = 1.0 if len(stated) == 2 else _range_spread(run, sensor) if len(dops) == 2 else math.nan
    wanted = [*axes(f"{sensor}.position_ned"), *(stated if len(stated) == 2 else dops)]
    for samples in read_samples(run, "measurements", wanted, lambda ticks: ticks % every == 0):
        places_ned = Samples(samples.vehicles, samples.ticks, samples.times, samples.values[:, :3])
        rows = _fresh_rows(places_ned, last)
        places = place.geodetic(samples.values[rows, :3]).tolist()
        times = place.nanoseconds(samples.times[rows]).tolist()
        factors = samples.values[rows, 3:].tolist()
        for i, vehicle in enumerate(samples.vehicles[rows].tolist()):
            errors = [spread * factor for factor in factors[i]] if math.isfinite(spread) else []
            yield Message(times[i], topics[vehicle], foxglove.FIX, _fix(run.vehicles[vehicle], places[i], errors))


def _range_spread(run: Run, sensor: str) -> float:
    """Return the standard deviation [m] of a receiver's pseudorange errors in the scenario; NaN if it has none.

    With fleets of different receivers it is the largest.
    """
    content = run.scenario if isinstance(run.scenario, dict) else {}
    try:
        shared = float(content["world"]["sky"]["errors"].get("std", math.nan))
        own = [
            float(fleet["sensors"][sensor].get("range_noise_std", 0.0))
            for fleet in content["fleets"].values()
            if sensor in fleet["sensors"]
        ]
        return math.hypot(shared, max(own))
    except (KeyError, TypeError, ValueError, AttributeError):
        return math.nan


def _fresh_rows(samples: Samples, last: Floats) -> npt.NDArray[np.int64]:
    """Return indices of rows with a receiver's new fix; updates ``last`` (n, 3), each vehicle's latest fix."""
    fresh = np.zeros(len(samples.ticks), bool)
    for vehicle in range(len(last)):
        rows = np.flatnonzero(samples.vehicles == vehicle)
        if len(rows):
            fresh[rows] = is_fresh(samples.values[rows], last[vehicle])
            last[vehicle] = samples.values[rows[-1]]
    return np.flatnonzero(fresh)


def _wind_messages(run: Run, place: Place, every: int) -> Iterator[Message]:
    """Yield messages with mean wind and gust at each vehicle, in NED [m/s]."""
    topics = topics_of(run, "wind")
    for samples in _finite(run, "wind", axes("mean_ned") + axes("gust_ned"), every):
        times, values = place.nanoseconds(samples.times).tolist(), samples.values.tolist()
        for i, vehicle in enumerate(samples.vehicles.tolist()):
            mean, gust = (dict(zip("xyz", part, strict=True)) for part in (values[i][:3], values[i][3:]))
            yield Message(times[i], topics[vehicle], foxglove.WIND, {"mean_ned": mean, "gust_ned": gust})


def _event_messages(events: list[Event], place: Place) -> Iterator[Message]:
    """Yield the events of a run as Foxglove log messages."""
    for event in sorted(events, key=lambda event: event.time):
        level = 4 if event.kind not in NOT_A_STOP else 3 if event.kind in WARNINGS else 2
        content = {"level": level, "message": event.message or event.kind, "name": event.vehicle or "", "file": ""}
        content |= {"line": 0, "tick": event.tick, "kind": event.kind, "field": event.field or ""}
        if event.value is not None and math.isfinite(event.value):
            content["value"] = event.value
        yield Message(int(place.nanoseconds(event.time)), "/events", foxglove.LOG, content)


def _finite(run: Run, stream: str, columns: list[str], every: int) -> Iterator[Samples]:
    """Yield the rows of a stream batch by batch, every ``every``-th tick, without rows that have a NaN or infinity."""
    for samples in read_samples(run, stream, columns, lambda ticks: ticks % every == 0):
        rows = np.isfinite(samples.values).all(axis=1)
        yield Samples(samples.vehicles[rows], samples.ticks[rows], samples.times[rows], samples.values[rows])


def _fix(frame: str, geodetic: list[float], errors: Sequence[float] = ()) -> dict[str, object]:
    """Return a Foxglove LocationFix; ``errors`` are horizontal and vertical standard deviations [m], () if unknown.

    The covariance is of east, north, up: the horizontal variance is shared evenly by its two axes, an approximation.
    """
    latitude, longitude, altitude = geodetic
    covariance = [0.0] * 9
    if known := len(errors) == 2 and all(map(math.isfinite, errors)):
        horizontal, vertical = errors
        covariance[0] = covariance[4] = 0.5 * horizontal * horizontal
        covariance[8] = vertical * vertical
    return {
        "frame_id": frame,
        "latitude": latitude,
        "longitude": longitude,
        "altitude": altitude,
        "position_covariance": covariance,
        "position_covariance_type": int(known),
    }


def _timestamp(time_ns: int) -> dict[str, int]:
    """Convert a time [ns] to a Foxglove timestamp of seconds and nanoseconds."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def _origin(run: Run, place: Place) -> dict[str, str]:
    """Return a run's scenario, seed, version, and geodetic origin as texts for the metadata of the MCAP file."""
    latitude, longitude, height = place.geodetic(np.zeros(3)).tolist()
    return {
        "scenario": run.info.scenario,
        "seed": str(run.info.seed),
        "version": run.info.versions.get("qrsim", "unknown"),
        "origin_latitude_deg": repr(latitude),
        "origin_longitude_deg": repr(longitude),
        "origin_height_m": repr(height),
    }
