"""kml: tracks and events for Google Earth and other globes (OGC KML 2.2 with Google's gx:Track)."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import matplotlib as mpl

from qrsim.runs.export.output import Written, replacing
from qrsim.runs.export.place import Floats
from qrsim.runs.export.tracks import Mark, Segment, Track, Tracks
from qrsim.runs.export.xml_text import XmlText

# As in the figure of a run: a colour per vehicle, the true track thick and the reported one thin.
PALETTE = "tab10"
WIDTHS = {"true": 3, "gnss": 1}


def write(content: Tracks, path: Path) -> Written:
    """Write a folder per vehicle with its tracks, which play over time, and a folder of events.

    KML's absolute altitudes are above the geoid; here they are heights above the WGS-84 ellipsoid, because qrsim has
    no geoid: give the scenario's site its height above the sea, and the tracks stand where they should.

    Raises:
        RunError: the file cannot be written.
    """
    with replacing(path) as file:
        xml = XmlText(file)
        spaces = {"xmlns": "http://www.opengis.net/kml/2.2", "xmlns:gx": "http://www.google.com/kml/ext/2.2"}
        with xml.element("kml", spaces), xml.element("Document"):
            xml.leaf("name", content.name)
            vehicles = [list(tracks) for _, tracks in groupby(content.tracks, key=lambda track: track.number)]
            for tracks in vehicles:
                for kind in {track.kind: None for track in tracks}:
                    _style(xml, tracks[0].number, kind)
            for tracks in vehicles:
                with xml.element("Folder"):
                    xml.leaf("name", tracks[0].vehicle)
                    for track in tracks:
                        _track(xml, track)
            with xml.element("Folder"):
                xml.leaf("name", "events")
                for mark in content.marks:
                    _event(xml, mark)
    return Written(path, content.counts)


def _style(xml: XmlText, number: int, kind: str) -> None:
    colours = mpl.colormaps[PALETTE]
    red, green, blue, _ = colours(number % colours.N, bytes=True)
    with xml.element("Style", {"id": f"{kind}-{number}"}):
        with xml.element("IconStyle"):
            xml.leaf("scale", "0.6")
        with xml.element("LineStyle"):
            xml.leaf("color", f"ff{blue:02x}{green:02x}{red:02x}")
            xml.leaf("width", str(WIDTHS[kind]))


def _track(xml: XmlText, track: Track) -> None:
    with xml.element("Placemark"):
        xml.leaf("name", track.title)
        xml.leaf("styleUrl", f"#{track.kind}-{track.number}")
        with xml.element("gx:MultiTrack"):
            xml.leaf("altitudeMode", "absolute")
            xml.leaf("gx:interpolate", "0")
            for segment in track.segments:
                _segment(xml, segment)


def _segment(xml: XmlText, segment: Segment) -> None:
    with xml.element("gx:Track"):
        xml.leaf("altitudeMode", "absolute")
        for utc in segment.utc:
            xml.leaf("when", utc)
        for geodetic in segment.geodetic:
            xml.leaf("gx:coord", _coordinates(geodetic, " "))


def _event(xml: XmlText, mark: Mark) -> None:
    with xml.element("Placemark"):
        xml.leaf("name", mark.title)
        xml.leaf("description", mark.event.message)
        with xml.element("TimeStamp"):
            xml.leaf("when", mark.utc)
        if mark.geodetic is not None:
            with xml.element("Point"):
                xml.leaf("altitudeMode", "absolute")
                xml.leaf("coordinates", _coordinates(mark.geodetic, ","))


def _coordinates(geodetic: Floats, separator: str) -> str:
    latitude, longitude, height = geodetic
    return separator.join((f"{longitude:.9f}", f"{latitude:.9f}", f"{height:.4f}"))
