"""One instant of a world as the page draws it (from a State), and its constant parts (from a World)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.core.noise import StreamKeys
from qrsim.models.gnss.receivers import GnssReading
from qrsim.models.scene.contents import ContentsState
from qrsim.models.sensors.camera import CameraReading
from qrsim.models.vehicles.contracts import Outline
from qrsim.tasks.places import Places
from qrsim.view.details import Details, details_of_state
from qrsim.view.reasons import code_in_words
from qrsim.world.air import weather_at
from qrsim.world.state import Fleet, FleetState, State, World, position_of

# Of a vehicle that says nothing of its looks: that of the AscTec Pelican [m].
PELICAN_SPAN = 0.65
# Vehicles that do not fly, by their looks.
NOT_FLYING = {"car": "rover", "mast": "station"}
# Places of routes and paths that a view is chosen by; a route that ends this near to its start [m] is none.
MOST_WAYS, NO_WAY = 300, 1.0


@dataclass(frozen=True)
class Beside:
    """Contents of the world besides vehicles, and the cameras' pictures of them.

    Attributes:
        world: as it is now.
        drawn: what the episode has drawn for the ranges of the world.
        contents: plume, cover of the ground, persons.
        fleet_keys: keys of each fleet's randomness.
        cameras: (number of the fleet, number of the sensor) -> where and when its last pictures were taken.
        field: what the gusts of the episode share; None where they share nothing.
    """

    world: World
    drawn: tuple[Any, ...]
    contents: ContentsState
    fleet_keys: tuple[StreamKeys, ...]
    cameras: dict[tuple[int, int], CameraReading]
    field: object = None


@dataclass(frozen=True)
class Links:
    """Links of the radio in its last period, from the K nearest to each vehicle.

    Attributes:
        sender: (K, n) number of a vehicle; -1: nobody sent.
        error: (K, n) chance that the packet is lost if nobody else sends.
        outcome: (K, n) what became of it (models/radio/links.py).
    """

    sender: Floats
    error: Floats
    outcome: Floats


@dataclass(frozen=True)
class Frame:
    """State of all n vehicles at one time; NaN where a quantity is unknown.

    Attributes:
        time: simulated time [s].
        position_ned: (n, 3) [m].
        attitude: (n, 3) roll, pitch, yaw [rad].
        estimate_ned: (n, 3) where the controllers believe the vehicles to be [m].
        ghost_ned: (n, 3) where GNSS says that they are [m].
        wind_ned, gust_ned: (n, 3) mean wind and gusts at the vehicles [m/s].
        valid: (n,) whether each still flies.
        reasons: vehicle -> why it has stopped.
        beside: what there is beside vehicles; None where that is not known.
        links: those of the radio; None where there is none.
        details: returns further quantities, which only some layers draw; None where they are not known.
    """

    time: float
    position_ned: Floats
    attitude: Floats
    estimate_ned: Floats
    ghost_ned: Floats
    wind_ned: Floats
    gust_ned: Floats
    valid: Floats
    reasons: dict[int, str] = field(default_factory=dict)
    beside: Beside | None = None
    links: Links | None = None
    details: Callable[[], Details] | None = None


@dataclass(frozen=True)
class Cast:
    """Vehicles and other constant parts of a scene.

    Attributes:
        names: (n,) of the vehicles.
        fleets: (n,) number of the fleet of each.
        start_ned: (n, 3) where they are at first [m].
        around: (K, 3) corners of what is to be seen beside them [m]; None: nothing.
        outlines: looks of the vehicles of each fleet; none: all are quadrotors.
        places: that a task is about; None: none are known.
        routes: of each vehicle its start and the places (P, 3) that it is sent to [m]; P is 0 where there are none.
        flown: (K, 3) places along the paths of a recording [m]; None: it has not been flown yet.
        runs: what each of several runs is called; none: there is one only.
        run_of: (n,) number of the run of each vehicle; None: there is one only.
        site: latitude [deg], longitude [deg] and height [m] of the origin on WGS 84; None where it is not known.
        counts: waypoints or legs of each vehicle; none: those of ``routes``.
    """

    names: tuple[str, ...]
    fleets: Floats
    start_ned: Floats
    around: Floats | None = None
    outlines: tuple[Outline | None, ...] = ()
    places: Places | None = None
    routes: tuple[Floats, ...] = ()
    flown: Floats | None = None
    runs: tuple[str, ...] = ()
    run_of: Floats | None = None
    site: tuple[float, float, float] | None = None
    counts: tuple[int, ...] = ()

    @property
    def kinds(self) -> list[tuple[Outline | None, Floats]]:
        """Shapes of vehicles (None: quadrotor), each with the numbers (k,) of its vehicles."""
        of_fleets = self.outlines or (None,) * (int(self.fleets.max(initial=0)) + 1)
        each = [of_fleets[number] for number in self.fleets]
        return [(kind, np.array([i for i, own in enumerate(each) if own == kind])) for kind in dict.fromkeys(each)]

    @property
    def fliers(self) -> Floats:
        """Which vehicles are aircraft, (n,) bool: neither cars nor masts."""
        of_fleets = self.outlines or (None,) * (int(self.fleets.max(initial=0)) + 1)
        flies = np.array([look is None or bool(look.rotors) or look.kind == "plane" for look in of_fleets])
        return np.asarray(flies[self.fleets])

    @property
    def others(self) -> str:
        """Count of the vehicles that do not fly, in words, such as "2 rovers, 1 station"; "" if all fly."""
        of_fleets = self.outlines or (None,) * (int(self.fleets.max(initial=0)) + 1)
        kinds = [None if look is None or look.rotors else look.kind for look in of_fleets]
        counts = {word: sum(kinds[own] == kind for own in self.fleets.tolist()) for kind, word in NOT_FLYING.items()}
        return ", ".join(f"{count} {word}{'s' * (count > 1)}" for word, count in counts.items() if count)

    @property
    def waypoints(self) -> tuple[int, ...]:
        """Number of waypoints or legs of each vehicle's route, (n,); 0 without a route."""
        return self.counts or tuple(max(0, len(route) - 1) for route in self.routes) or (0,) * self.size

    @property
    def true_span(self) -> float:
        """Size [m] of the largest vehicle."""
        spans = [
            2.0 * (math.hypot(x, y) + outline.rotor_radius)
            for outline in self.outlines
            if outline is not None
            for x, y, _ in outline.rotors
        ] + [outline.size for outline in self.outlines if outline is not None and outline.size > 0.0]
        return max(spans, default=PELICAN_SPAN)

    @property
    def size(self) -> int:
        """Number of vehicles."""
        return len(self.names)

    @property
    def extent(self) -> float:
        """Diagonal [m] of the box around all that the initial view contains, and the ground below."""
        corners = np.vstack([self._seen, self._seen * [1.0, 1.0, 0.0]])
        return max(10.0, float(np.linalg.norm(np.ptp(corners, axis=0))))

    @property
    def _seen(self) -> Floats:
        """Positions (k, 3) NED [m] that the initial view must contain."""
        parts = [self.start_ned, self.ways]
        parts += [] if self.around is None else [self.around]
        return np.vstack(parts if self.places is None else [*parts, self.places.goals])

    @property
    def ways(self) -> Floats:
        """Positions (K, 3) NED [m] along routes and flown paths that the initial view should contain; K may be 0."""
        found = np.vstack([np.zeros((0, 3)), *self.routes, *(() if self.flown is None else (self.flown,))])
        found = found[np.isfinite(found).all(axis=1)]
        return found[:: 1 + len(found) // MOST_WAYS]

    @property
    def centre(self) -> Floats:
        """Centre (3,) NED [m] of the box around all that the initial view contains."""
        middle: Floats = 0.5 * (self._seen.min(axis=0) + self._seen.max(axis=0))
        return middle


def cast_of(world: World, start_ned: Floats, places: Places | None = None) -> Cast:
    """Return a scene's fixed content: vehicles' names and shapes, starts (n, 3) NED [m], routes, the task's places."""
    return Cast(
        tuple(name for fleet in world.fleets for name in fleet.vehicle_names),
        np.repeat(np.arange(len(world.fleets)), [fleet.size for fleet in world.fleets]),
        np.nan_to_num(start_ned).astype(np.float64),
        _contents_corners(world),
        tuple(fleet.vehicle.outline() for fleet in world.fleets),
        places,
        tuple(route for fleet in world.fleets for route in _routes(fleet)),
    )


def _routes(fleet: Fleet) -> Iterator[Floats]:
    """Yield for each vehicle its start and its waypoints or ends of legs, (P, 3) NED [m]; (0, 3) without a route."""
    starts, places = axes_of(fleet.start.position_ned), axes_of(fleet.route.position_ned)
    for i, count in enumerate(np.ravel(np.asarray(fleet.route.count)).tolist()):
        way = np.vstack([starts[i], places[:count, i]]).astype(np.float64)
        # A landing leads on through the ground.
        way[:, 2] = np.minimum(way[:, 2], max(0.0, way[0, 2]))
        yield way if np.ptp(way, axis=0).max() > NO_WAY else way[:0]


def _contents_corners(world: World) -> Floats | None:
    """Return two opposite corners (2, 3) [m] of a box area if the world has ground cover, persons, plume; else None."""
    area = world.area
    if not (area.is_box and world.contents.random):
        return None
    return np.array([[float(getattr(area, f"{axis}_{end}")) for axis in "xyz"] for end in ("min", "max")])


def frame_of(state: State, time: float, world: World) -> Frame:
    """Return what the page draws of a state (NumPy arrays) at a simulated time [s]."""

    def gather(pick: Any) -> Floats:
        """Return a vector (n, 3) of all vehicles; ``pick`` selects it from the state of one fleet."""
        return np.concatenate([axes_of(pick(fleet)) for fleet in state.fleets])

    models = [fleet.vehicle for fleet in world.fleets]
    poses = [model.pose(fleet.vehicle) for model, fleet in zip(models, state.fleets, strict=True)]

    codes = np.concatenate([np.asarray(fleet.violation.code) for fleet in state.fleets])
    values = np.concatenate([np.asarray(fleet.violation.value) for fleet in state.fleets])
    tick: Any = np.int32(round(time / world.time_step))
    return Frame(
        time,
        gather(position_of),
        np.concatenate([axes_of(pose.attitude) for pose in poses]),
        gather(lambda fleet: fleet.estimate.position_ned),
        gather(_fix),
        gather(lambda fleet: fleet.mean_wind_ned),
        gather(lambda fleet: fleet.gust_ned),
        codes == 0,
        {int(i): code_in_words(int(codes[i]), float(values[i]), world.area) for i in np.flatnonzero(codes)},
        Beside(weather_at(world, tick), state.drawn, state.contents, state.fleet_keys, _pictures(state), state.field),
        _links(state, world),
        cache(lambda: details_of_state(state, world)),
    )


def _links(state: State, world: World) -> Links | None:
    """Return the radio links of the last period in a state; None if the world has no radio."""
    if world.radio is None:
        return None
    links: Any = world.radio.links(state.radio)
    return Links(np.asarray(links.sender), np.asarray(links.error), np.asarray(links.outcome))


def _pictures(state: State) -> dict[tuple[int, int], CameraReading]:
    """Return (fleet number, sensor number) -> last reading, for all cameras."""
    return {
        (number, index): reading
        for number, fleet in enumerate(state.fleets)
        for index, reading in enumerate(fleet.readings)
        if isinstance(reading, CameraReading)
    }


def axes_of(vector: object) -> Floats:
    """Return a Vec3 or Euler of arrays (n,) as (n, 3)."""
    return np.stack([np.asarray(axis) for axis in vars(vector).values()], axis=-1)


def _fix(fleet: FleetState) -> object:
    """Return the position NED that a fleet's first GNSS receiver reports; NaN without a receiver."""
    for reading in fleet.readings:
        if isinstance(reading, GnssReading):
            return reading.position_ned
    position = fleet.vehicle.position_ned
    return type(position)(*(np.full_like(axis, np.nan) for axis in vars(position).values()))
