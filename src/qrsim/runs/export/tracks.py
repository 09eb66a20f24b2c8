"""Tracks and events on the Earth, as geojson, gpx and kml show them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from qrsim.errors import QrsimError, RunError
from qrsim.models.geoid import above_sea
from qrsim.models.site import Site
from qrsim.runs import Event, Run
from qrsim.runs.export.output import is_readable
from qrsim.runs.export.place import Floats, Place

AXES = "xyz"
# Positions (R, 3) -> the down coordinate (R,) of the ground there.
Ground = Callable[[Floats], Floats]
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Samples:
    """Rows of a stream.

    Attributes:
        vehicles: (R,) index of each row's vehicle.
        ticks: (R,) number of the step.
        times: (R,) simulated time [s].
        values: (R, k) of k columns.
    """

    vehicles: npt.NDArray[np.int64]
    ticks: npt.NDArray[np.int64]
    times: Floats
    values: Floats


@dataclass(frozen=True)
class Segment:
    """An unbroken piece of a track.

    Attributes:
        utc: (T,) times.
        geodetic: (T, 3) latitude [deg], longitude [deg], height above the ellipsoid [m].
        above_ground: (T,) height above the run's ground [m].
    """

    utc: list[str]
    geodetic: Floats
    above_ground: Floats


@dataclass(frozen=True)
class Track:
    """The path of a vehicle: true, or as a GNSS receiver reported it.

    Attributes:
        vehicle: its name.
        number: its index in the run.
        sensor: name of the receiver, None for the true track.
        segments: in order of time; a new one begins after every gap.
    """

    vehicle: str
    number: int
    sensor: str | None
    segments: list[Segment]

    @property
    def kind(self) -> str:
        """Source of the track, as exported files name it: "true" or "gnss"."""
        return "true" if self.sensor is None else "gnss"

    @property
    def title(self) -> str:
        """Name of the track in exported files."""
        return f"{self.vehicle} {self.sensor or 'true'}"


@dataclass(frozen=True)
class Mark:
    """An event: its UTC time, the true place (3,) [deg, deg, m] of its vehicle, None where that is unknown, and its
    height above the run's ground [m].
    """

    event: Event
    utc: str
    geodetic: Floats | None
    above_ground: float = 0.0

    @property
    def title(self) -> str:
        """Name of the event in exported files."""
        return self.event.kind if self.event.vehicle is None else f"{self.event.vehicle} {self.event.kind}"


@dataclass(frozen=True)
class Tracks:
    """Content of geojson, gpx and kml: tracks, the true one of each vehicle first, and events in order of time."""

    name: str
    site: Site
    tracks: list[Track]
    marks: list[Mark]

    def over_sea(self) -> Tracks:
        """Return the tracks with heights above mean sea level in place of the ellipsoid."""
        tracks = [
            replace(
                track, segments=[replace(each, geodetic=above_sea(each.geodetic, self.site)) for each in track.segments]
            )
            for track in self.tracks
        ]
        marks = [
            mark if mark.geodetic is None else replace(mark, geodetic=above_sea(mark.geodetic, self.site))
            for mark in self.marks
        ]
        return replace(self, tracks=tracks, marks=marks)

    @property
    def counts(self) -> dict[str, int]:
        """Number of "points" of all tracks, and of "events"."""
        points = sum(len(segment.utc) for track in self.tracks for segment in track.segments)
        return {"points": points, "events": len(self.marks)}


def read_tracks(run: Run, place: Place, every: int) -> Tracks:
    """Return each vehicle's true and GNSS tracks, every ``every``-th tick, and all events, in geodetic coordinates.

    A receiver's track has the ticks at which its report differs from the one before. Where a position is not a
    number or ticks are missing, a new segment begins.

    Raises:
        RunError: there is nothing to show.
    """
    sources: list[tuple[str, str | None, str]] = [("truth", None, "position_ned")] if is_readable(run, "truth") else []
    sources += [("measurements", sensor, f"{sensor}.position_ned") for sensor in position_sensors(run)]
    ground = ground_of(run)
    found: list[Track] = []
    for stream, sensor, column in sources:
        samples = _joined(read_samples(run, stream, axes(column), lambda ticks: ticks % every == 0))
        for number, vehicle in enumerate(run.vehicles):
            rows = samples.vehicles == number
            own = Samples(samples.vehicles[rows], samples.ticks[rows], samples.times[rows], samples.values[rows])
            segments = _segments(own, place, every, ground, fresh_only=sensor is not None)
            if segments:
                found.append(Track(vehicle, number, sensor, segments))
    marks = _event_marks(run, place, ground)
    if not found and not marks:
        raise RunError(f"{run.folder}: nothing to export, because no tick was recorded (state: {run.info.state})")
    return Tracks(run.info.scenario, place.site, sorted(found, key=lambda track: track.number), marks)


def ground_of(run: Run) -> Ground:
    """Return a function that maps positions (R, 3) NED [m] to the ground's z coordinate (R,) [m, down] below them.

    Where the scenario's ground is not known any more, it is z = 0, with a warning.
    """
    content = run.scenario if isinstance(run.scenario, dict) else {}
    world = content.get("world")
    about = world.get("ground") if isinstance(world, dict) else None
    if not isinstance(about, dict):
        return lambda position: np.zeros(len(position))
    if about.get("type") == "flat":
        return lambda position: np.full(len(position), -float(about.get("height", 0.0)))
    from qrsim.core.vectors import Vec3

    try:
        surface = run.built().world("float64").ground
    except (QrsimError, OSError) as error:
        warnings.warn(f"heights are above z = 0, because the ground cannot be built: {error}", stacklevel=2)
        return lambda position: np.zeros(len(position))
    return lambda position: np.asarray(surface.down(Vec3(*position.T)), np.float64)


def said_in_xml(text: str) -> str:
    """Return a text with characters that XML does not allow replaced by U+FFFD."""
    return _NOT_XML.sub("\ufffd", text)


def axes(name: str) -> list[str]:
    """Return the column names NAME.x, NAME.y, NAME.z of a logged vector."""
    return [f"{name}.{axis}" for axis in AXES]


def position_sensors(run: Run) -> list[str]:
    """Return the names of the run's sensors that report a position."""
    if not is_readable(run, "measurements"):
        return []
    ending = ".position_ned.x"
    names = [column.name for column in run.describe("measurements")]
    return [name.removesuffix(ending) for name in names if name.endswith(ending)]


def read_samples(
    run: Run, stream: str, columns: Sequence[str], wanted: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.bool_]]
) -> Iterator[Samples]:
    """Yield rows of a stream batch by batch; ``wanted`` maps ticks (R,) to a mask (R,) of those to keep."""
    names = pa.array(run.vehicles, pa.string())
    for table in run.batches(stream, ["time", "tick", "vehicle", *columns]):
        kept = table.filter(pa.array(wanted(table["tick"].to_numpy())))
        vehicles = pc.index_in(kept["vehicle"].cast(pa.string()), value_set=names)
        if vehicles.null_count:
            raise RunError(f"{run.folder / stream}: it is damaged: it has rows of vehicles that the run has not")
        values = [kept[name].to_numpy().astype(np.float64) for name in columns]
        yield Samples(
            vehicles.to_numpy().astype(np.int64),
            kept["tick"].to_numpy(),
            kept["time"].to_numpy(),
            np.stack(values, axis=-1),
        )


def is_fresh(values: Floats, last: Floats) -> npt.NDArray[np.bool_]:
    """Return a mask (T,) of finite reports (T, 3) that differ from the one before; ``last`` (3,) precedes the first."""
    before = np.concatenate([last[None], values[:-1]])
    return np.asarray(np.isfinite(values).all(axis=1) & (values != before).any(axis=1))


def _joined(batches: Iterator[Samples]) -> Samples:
    """Concatenate batches of rows; there must be at least one batch."""
    parts = list(batches)
    return Samples(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("vehicles", "ticks", "times", "values"))
    )


def _segments(samples: Samples, place: Place, every: int, ground: Ground, fresh_only: bool) -> list[Segment]:
    """Cut a vehicle's track at gaps, NaN and longitude 180 deg; ``fresh_only`` keeps new GNSS reports only."""
    if not len(samples.ticks):
        return []
    valid = np.isfinite(samples.values).all(axis=1)
    pieces = np.cumsum(~valid | _is_gap(samples.ticks, every))
    kept = is_fresh(samples.values, np.full(3, np.nan)) if fresh_only else valid
    if not kept.any():
        return []
    times, pieces = samples.times[kept], pieces[kept]
    geodetic = place.geodetic(samples.values[kept])
    above = ground(samples.values[kept]) - samples.values[kept, 2]
    # RFC 7946, section 3.1.9: a line that crosses the antimeridian is cut there.
    cut = (np.diff(pieces) > 0) | (np.abs(np.diff(geodetic[:, 1])) > 180.0)
    bounds = [0, *(1 + np.flatnonzero(cut)), len(times)]
    return [Segment(place.utc(times[a:b]), geodetic[a:b], above[a:b]) for a, b in pairwise(bounds)]


def _is_gap(ticks: npt.NDArray[np.int64], every: int) -> npt.NDArray[np.bool_]:
    """Return a mask (T,) of ticks that follow a gap in a log of every ``every``-th tick."""
    steps = np.diff(ticks)
    usual = max(every, int(steps.min())) if len(steps) else every
    return np.concatenate([[False], steps > usual])


def _event_marks(run: Run, place: Place, ground: Ground) -> list[Mark]:
    """Return the run's events, each with the geodetic position of its vehicle at that time, or None if unknown."""
    if not is_readable(run, "events"):
        return []
    events = run.events
    # Where the truth was decimated: the last place that was logged before the event.
    every = run.info.every.get("truth", 1)
    ticks = {event.tick: event.tick // every * every for event in events}
    places = _true_places(run, set(ticks.values())) if is_readable(run, "truth") else {}
    marks = []
    for event, utc in zip(events, place.utc([event.time for event in events]), strict=True):
        position = places.get((ticks[event.tick], event.vehicle))
        if position is None:
            marks.append(Mark(event, utc, None))
        else:
            above = float(ground(position[None])[0] - position[2])
            marks.append(Mark(event, utc, place.geodetic(position), above))
    return marks


def _true_places(run: Run, ticks: set[int]) -> dict[tuple[int, object], Floats]:
    """Return (tick, vehicle) -> true position NED (3,) [m] at the given ticks, without NaN."""
    wanted = np.array(sorted(ticks), np.int64)
    found: dict[tuple[int, object], Floats] = {}
    for samples in read_samples(run, "truth", axes("position_ned"), lambda there: np.isin(there, wanted)):
        for vehicle, tick, position in zip(samples.vehicles, samples.ticks, samples.values, strict=True):
            if np.isfinite(position).all():
                found[int(tick), run.vehicles[vehicle]] = position
    return found
