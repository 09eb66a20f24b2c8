"""gpx: tracks and events for GPS tools (GPX 1.1, topografix.com/GPX/1/1), by gpxpy."""

from __future__ import annotations

import warnings
from datetime import datetime
from pathlib import Path
from typing import Any

from qrsim.core.arrays import NumpyArray
from qrsim.runs.export.output import Written, replacing
from qrsim.runs.export.tracks import Tracks, said_in_xml


def write(content: Tracks, path: Path) -> Written:
    """Write a GPX file: a track per vehicle and source (true, receiver), a trkseg per unbroken piece, events as
    waypoints.

    ``ele`` is the height above mean sea level, by the geoid of the scenario, EGM96 by default.
    A GPX waypoint has a place, so an event of unknown place is left out with a warning.

    Raises:
        RunError: the file cannot be written.
    """
    from gpxpy.gpx import GPX, GPXTrack, GPXTrackPoint, GPXTrackSegment, GPXWaypoint

    content = content.over_sea()
    placed = [(mark, mark.geodetic) for mark in content.marks if mark.geodetic is not None]
    if missing := len(content.marks) - len(placed):
        warnings.warn(f"{path}: events of unknown place left out: {missing}", stacklevel=2)
    document = GPX()
    document.creator, document.name = "qrsim", said_in_xml(content.name)
    for mark, geodetic in placed:
        point = GPXWaypoint(*_place(geodetic), time=_parsed_time(mark.utc), name=said_in_xml(mark.title))
        point.description, point.type = said_in_xml(mark.event.message), said_in_xml(mark.event.kind)
        document.waypoints.append(point)
    for track in content.tracks:
        found: Any = GPXTrack(name=said_in_xml(track.title))
        found.type = track.kind
        document.tracks.append(found)
        for segment in track.segments:
            points = zip(segment.geodetic.tolist(), segment.utc, strict=True)
            piece = [GPXTrackPoint(*_place(geodetic), time=_parsed_time(utc)) for geodetic, utc in points]
            found.segments.append(GPXTrackSegment(piece))
    with replacing(path) as file:
        file.write(document.to_xml("1.1").encode())
    return Written(path, {**content.counts, "events": len(placed)})


def _place(geodetic: NumpyArray) -> tuple[float, float, float]:
    """Convert a geodetic position (3,) to latitude, longitude [deg] rounded to 1e-9, and height [m]."""
    latitude, longitude, height = (float(value) for value in geodetic)
    return round(latitude, 9), round(longitude, 9), round(height, 4)


def _parsed_time(utc: str) -> datetime:
    """Parse a UTC time in ISO 8601 to a datetime."""
    return datetime.fromisoformat(utc)
