"""geojson: tracks and events for maps and GIS programs (RFC 7946)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from qrsim.runs.export.output import Written, replacing
from qrsim.runs.export.place import Floats
from qrsim.runs.export.tracks import Mark, Segment, Track, Tracks


def write(content: Tracks, path: Path) -> Written:
    """Write tracks and events as GeoJSON: a feature per unbroken piece of a track, with times, and one per event.

    Positions are longitude and latitude [deg] to 0.1 mm, and height above the WGS-84 ellipsoid [m]. A piece of a
    single position is a Point; an event of unknown place has no geometry.

    Raises:
        RunError: the file cannot be written.
    """
    with replacing(path) as file:
        file.write(b'{"type": "FeatureCollection", "features": [')
        separator = b"\n"
        for feature in _features(content):
            file.write(separator + json.dumps(feature, allow_nan=False).encode())
            separator = b",\n"
        file.write(b"\n]}\n")
    return Written(path, content.counts)


def _features(content: Tracks) -> Iterator[dict[str, object]]:
    """Yield the GeoJSON features of all tracks and events."""
    for track in content.tracks:
        for number, segment in enumerate(track.segments):
            yield _segment_feature(track, number, segment)
    for mark in content.marks:
        yield _event_feature(mark)


def _segment_feature(track: Track, number: int, segment: Segment) -> dict[str, object]:
    """Return the ``number``-th unbroken piece of a vehicle's track as a GeoJSON feature, with a time per position."""
    line = [_coordinates(place) for place in segment.geodetic]
    geometry: dict[str, object] = {"type": "LineString", "coordinates": line}
    if len(line) == 1:  # a LineString has two positions or more
        geometry = {"type": "Point", "coordinates": line[0]}
    properties = {
        "feature": "track",
        "name": track.vehicle,
        "kind": track.kind,
        "sensor": track.sensor,
        "segment": number,
        "start": segment.utc[0],
        "end": segment.utc[-1],
        "times": segment.utc,
    }
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _event_feature(mark: Mark) -> dict[str, object]:
    """Return an event as a GeoJSON feature."""
    point = None if mark.geodetic is None else {"type": "Point", "coordinates": _coordinates(mark.geodetic)}
    event = asdict(mark.event)
    seconds, name = event.pop("time"), event.pop("vehicle")
    if event["value"] is not None and not math.isfinite(event["value"]):
        event["value"] = None  # JSON has no NaN
    properties = {"feature": "event", "name": name, "time": mark.utc, "seconds": seconds, **event}
    return {"type": "Feature", "geometry": point, "properties": properties}


def _coordinates(geodetic: Floats) -> list[float]:
    """Return a GeoJSON position: longitude, latitude [deg] and height [m], rounded."""
    latitude, longitude, height = geodetic.tolist()
    return [round(longitude, 9), round(latitude, 9), round(height, 4)]
