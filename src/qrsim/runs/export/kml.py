"""kml: tracks and events for Google Earth and other globes (OGC KML 2.2 with Google's gx:Track), by simplekml."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

import numpy as np

from qrsim.runs.colours import VEHICLES
from qrsim.runs.export.output import Written, replacing
from qrsim.runs.export.place import Floats
from qrsim.runs.export.tracks import Mark, Track, Tracks, said_in_xml

if TYPE_CHECKING:
    import simplekml

# As in the figure of a run: a colour per vehicle, the true track thick and the reported one thin.
WIDTHS = {"true": 3, "gnss": 1}
Heights = Literal["ground", "sea", "ellipsoid"]
MODES: dict[Heights, str] = {"ground": "relativeToGround", "sea": "absolute", "ellipsoid": "absolute"}
DATUMS: dict[Heights, str] = {
    "ground": "the ground",
    "sea": "mean sea level, by the geoid of the scenario (EGM96 by default)",
    "ellipsoid": "the WGS-84 ellipsoid",
}


def write(content: Tracks, path: Path, heights: Heights = "ground") -> Written:
    """Write a KML file: a folder per vehicle with tracks that play over time, and a folder of events.

    Args:
        content: what to write.
        path: the file.
        heights: "ground": above the run's ground, drawn by the globe above its own; "sea": absolute, above mean sea
            level, as KML defines it; "ellipsoid": absolute, above the WGS-84 ellipsoid, for programs that expect this.
            A comment of the file names it.

    Raises:
        RunError: the file cannot be written.
    """
    import simplekml

    if heights == "sea":
        content = content.over_sea()
    document = simplekml.Kml(name=said_in_xml(content.name))
    for _, tracks in groupby(content.tracks, key=lambda track: track.number):
        own = list(tracks)
        # A document, because simplekml keeps shared styles there, where KML wants them.
        folder = document.newdocument(name=said_in_xml(own[0].vehicle))
        styles = {kind: _track_style(simplekml, own[0].number, kind) for kind in {track.kind: None for track in own}}
        for track in own:
            _add_track(folder, track, styles[track.kind], heights)
    events = document.newfolder(name="events")
    for mark in content.marks:
        _add_event(events, mark, heights)
    with replacing(path) as file:
        file.write(b'<?xml version="1.0" encoding="UTF-8"?>\n')
        file.write(f"<!-- Heights are above {DATUMS[heights]}. -->\n".encode())
        file.write(document.kml(format=False).encode())
    return Written(path, content.counts)


def _track_style(simplekml: ModuleType, number: int, kind: str) -> object:
    """Return the KML line style of a track: the colour of vehicle ``number``, and a width for true or GNSS tracks."""
    red, green, blue = VEHICLES[number % len(VEHICLES)].tolist()
    style = simplekml.Style()
    style.iconstyle.scale = 0.6
    style.linestyle.color = f"ff{blue:02x}{green:02x}{red:02x}"
    style.linestyle.width = WIDTHS[kind]
    return style


def _add_track(folder: simplekml.Folder, track: Track, style: object, heights: Heights) -> None:
    """Add the pieces of a vehicle's track to a KML folder, animated over time; ``heights`` is their reference."""
    found = folder.newgxmultitrack(name=said_in_xml(track.title), gxinterpolate=0)
    found.style = style
    for segment in track.segments:
        piece = found.newgxtrack(altitudemode=MODES[heights])
        piece.newwhen(segment.utc)
        piece.newgxcoord(_coordinates(segment.geodetic, segment.above_ground, heights))


def _add_event(folder: simplekml.Folder, mark: Mark, heights: Heights) -> None:
    """Add an event to a KML folder as a point; ``heights`` selects the height's reference."""
    said = {"name": said_in_xml(mark.title), "description": said_in_xml(mark.event.message)}
    # Without a place it has no geometry, which is not the same as one at 0, 0.
    found = folder.newmultigeometry(**said) if mark.geodetic is None else folder.newpoint(**said)
    found.timestamp.when = mark.utc
    if mark.geodetic is not None:
        found.altitudemode = MODES[heights]
        found.coords = _coordinates(mark.geodetic[None], np.array([mark.above_ground]), heights)


def _coordinates(geodetic: Floats, above_ground: Floats, heights: Heights) -> list[tuple[float, float, float]]:
    """Return longitude, latitude [deg] and height [m], to 0.1 mm, of places (T, 3); ``heights`` is the reference."""
    chosen = above_ground if heights == "ground" else geodetic[:, 2]
    rows = zip(geodetic[:, 1].tolist(), geodetic[:, 0].tolist(), chosen.tolist(), strict=True)
    return [(round(longitude, 9), round(latitude, 9), round(height, 4)) for longitude, latitude, height in rows]
