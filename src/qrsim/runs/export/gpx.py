"""gpx: tracks and events for GPS tools (GPX 1.1, topografix.com/GPX/1/1)."""

from __future__ import annotations

import warnings
from pathlib import Path

from qrsim.runs.export.output import Written, replacing
from qrsim.runs.export.place import Floats
from qrsim.runs.export.tracks import Mark, Segment, Tracks
from qrsim.runs.export.xml_text import XmlText


def write(content: Tracks, path: Path) -> Written:
    """Write one track per vehicle and source (true, receiver), one trkseg per unbroken piece, events as waypoints.

    GPX means heights above the sea; ``ele`` is the height above the WGS-84 ellipsoid, because qrsim has no geoid.
    A GPX waypoint has a place, so an event of unknown place is left out with a warning.

    Raises:
        RunError: the file cannot be written.
    """
    placed = [(mark, mark.geodetic) for mark in content.marks if mark.geodetic is not None]
    if missing := len(content.marks) - len(placed):
        warnings.warn(f"{path}: events of unknown place left out: {missing}", stacklevel=2)
    with replacing(path) as file:
        xml = XmlText(file)
        attributes = {"version": "1.1", "creator": "qrsim", "xmlns": "http://www.topografix.com/GPX/1/1"}
        with xml.element("gpx", attributes):
            with xml.element("metadata"):
                xml.leaf("name", content.name)
            for mark, geodetic in placed:
                _waypoint(xml, mark, geodetic)
            for track in content.tracks:
                with xml.element("trk"):
                    xml.leaf("name", track.title)
                    xml.leaf("type", track.kind)
                    for segment in track.segments:
                        _segment(xml, segment)
    return Written(path, {**content.counts, "events": len(placed)})


def _waypoint(xml: XmlText, mark: Mark, geodetic: Floats) -> None:
    with xml.element("wpt", _place(geodetic)):
        xml.leaf("ele", f"{geodetic[2]:.4f}")
        xml.leaf("time", mark.utc)
        xml.leaf("name", mark.title)
        xml.leaf("desc", mark.event.message)
        xml.leaf("type", mark.event.kind)


def _segment(xml: XmlText, segment: Segment) -> None:
    with xml.element("trkseg"):
        for utc, geodetic in zip(segment.utc, segment.geodetic, strict=True):
            with xml.element("trkpt", _place(geodetic)):
                xml.leaf("ele", f"{geodetic[2]:.4f}")
                xml.leaf("time", utc)


def _place(geodetic: Floats) -> dict[str, str]:
    return {"lat": f"{geodetic[0]:.9f}", "lon": f"{geodetic[1]:.9f}"}
