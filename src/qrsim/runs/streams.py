"""From a History to the streams of a run folder: columns and values."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.host import on_host
from qrsim.core.tree import walk
from qrsim.files import Content
from qrsim.interface.crowds import crowds_of
from qrsim.models.gnss.receivers import FEWEST_SATELLITES, GnssReading
from qrsim.models.scene.area import REASONS, reason_text
from qrsim.models.vehicles.faults import RotorFault
from qrsim.runs import Column
from qrsim.runs.failsafe_events import FailsafeWatch
from qrsim.runs.layout import OVERFULL, PERSON_FOUND
from qrsim.runs.mission_events import Found, MissionWatch
from qrsim.runs.poses import poses_of
from qrsim.runs.radio_columns import radio_columns
from qrsim.runs.weather_events import weather_events
from qrsim.runs.zone_events import ZoneWatch
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.world.standing import on_ground
from qrsim.world.state import Fleet, FleetState, World, position_of

Values = dict[str, NumpyArray]
STREAMS = ("truth", "measurements", "commands", "wind")
OF_RADIO = "measurements"  # stream with the columns of the radio
VOLTAGE = "battery.voltage"

_load = on_host(lambda vehicle, states: vehicle.load(states))
_voltage = on_host(lambda battery, states, load: battery.voltage(states, load))

_UNITS = {
    "specific_force.": "m/s^2",
    "mean_ned.": "m/s",
    "gust_ned.": "m/s",
    "gust_rates_ned.": "rad/s",
    "estimate.position_ned.": "m",
    "estimate.velocity_ned.": "m/s",
    "estimate.attitude.": "rad",
    "estimate_std.position_ned.": "m",
    "estimate_std.velocity_ned.": "m/s",
    "estimate_std.attitude.": "rad",
}


def _tree(stream: str, fleet: Fleet, state: FleetState) -> list[tuple[str, Any, str, str]]:
    """Return (column, array (T, n), unit, doc) of each quantity that one fleet logs to a stream."""
    roots: list[tuple[str, Any]]
    if stream == "truth":
        poses = poses_of(fleet, state.vehicle)
        roots = [("", poses), ("", state.vehicle), ("specific_force.", state.specific_force)]
        if fleet.battery.drains:
            roots.append(("battery.", state.battery))
    elif stream == "measurements":
        roots = [(f"{name}.", reading) for name, reading in zip(fleet.sensor_names, state.readings, strict=True)]
    elif stream == "commands":
        roots = [("", state.command), ("setpoint.", state.setpoint), *_believed(fleet, state)]
    else:
        roots = [("mean_ned.", state.mean_wind_ned), ("gust_ned.", state.gust_ned)]
        if state.gust_rates_ned is not None:
            roots.append(("gust_rates_ned.", state.gust_rates_ned))
    items = [
        (name, leaf, info.unit or _UNITS.get(prefix, ""), info.doc)
        for prefix, root in roots
        for name, leaf, info in walk(root, prefix)
    ]
    # A state may have what its pose has, under the same name.
    items = list({item[0]: item for item in items}.values())
    if stream == "truth":
        whole = position_of(state)
        exact = {f"position_ned.{axis}": getattr(whole, axis) for axis in "xyz"}
        items = [(name, exact.get(name, leaf), unit, doc) for name, leaf, unit, doc in items]
        items.append(("valid", state.violation.code == 0, "", "whether the vehicle still flies"))
        items += loads(fleet, state, {name for name, *_ in items})
        standing = on_ground(fleet, state)
        if standing is not None:
            items.append(("on_ground", np.asarray(standing), "", "whether the vehicle is on the ground"))
    if stream == "commands":
        items.append(("clipped", state.command_clipped, "", "the command was outside its range and was clipped"))
        items.append(("waypoint", state.guidance.index, "", "index of the waypoint flown to"))
    return items


def _believed(fleet: Fleet, state: FleetState) -> list[tuple[str, Any]]:
    """Return (column prefix, record) of a fleet's estimate, deviations and innovations; [] without an estimator."""
    belief = state.belief
    if belief is None:
        return []
    # Without an estimator of its own a controller is fed with the readings, which are logged. A fleet's estimator
    # is logged as it is at this tick, a controller's own as it fed the command of this tick.
    parts = ("position_ned", "velocity_ned", "attitude")
    fed = state.estimate if fleet.estimator is None else belief.estimate
    roots = [(f"estimate.{part}.", getattr(fed, part)) for part in parts]
    if belief.std is not None:
        roots += [(f"estimate_std.{part}.", getattr(belief.std, part)) for part in parts]
    estimator = fleet.own_estimator
    inner = None if estimator is None else estimator.inner(belief.memory)
    if inner is not None:
        roots += [("estimate.", inner[0]), ("estimate_std.", inner[1])]
    innovations = None if estimator is None else estimator.innovations(belief.memory)
    if innovations is not None:
        roots.append(("innovation.", innovations))
    return roots


def loads(fleet: Fleet, state: FleetState, has: set[str]) -> list[tuple[str, Any, str, str]]:
    """Return (column, array (T, n), unit, doc) of electric vehicles' thrust, power and voltage, if not in ``has``."""
    if not fleet.vehicle.gives_power:
        return []
    load = _load(fleet.vehicle, state.vehicle)
    items = [
        ("thrust", load.thrust, "N", "collective thrust of the rotors at their speeds"),
        ("power", load.power, "W", "electrical power of motors and avionics"),
    ]
    if fleet.battery.drains:
        items.append((VOLTAGE, _voltage(fleet.battery, state.battery, load), "V", "under load"))
    shape = state.violation.code.shape
    return [
        (name, np.broadcast_to(np.asarray(leaf), shape), unit, doc)
        for name, leaf, unit, doc in items
        if name not in has
    ]


def columns(world: World, history: History) -> dict[str, list[Column]]:
    """Return stream -> its columns; a quantity that only some fleets have is one column for all vehicles."""
    found: dict[str, dict[str, Column]] = {stream: {} for stream in STREAMS}
    for stream in STREAMS:
        for fleet, state in zip(world.fleets, history.state.fleets, strict=True):
            for name, leaf, unit, doc in _tree(stream, fleet, state):
                found[stream].setdefault(name, Column(name, unit, doc, leaf.dtype.name))
    for name, leaf, unit, doc in radio_columns(world, history):
        found[OF_RADIO].setdefault(name, Column(name, unit, doc, leaf.dtype.name))
    return {stream: list(by_name.values()) for stream, by_name in found.items()}


def values(world: World, history: History, wanted: dict[str, list[Column]]) -> dict[str, Values]:
    """Return stream -> column -> array (T, n) over all vehicles; NaN where a fleet lacks the quantity."""
    result: dict[str, Values] = {}
    for stream in STREAMS:
        parts = []
        for fleet, state in zip(world.fleets, history.state.fleets, strict=True):
            own = {name: leaf for name, leaf, _, _ in _tree(stream, fleet, state)}
            for fault in fleet.all_battery_faults if VOLTAGE in own else ():
                own[VOLTAGE] = np.asarray(fault.sagged(own[VOLTAGE], history.ticks[:, None]))  # type: ignore[arg-type]
            shape = (len(history.ticks), fleet.size)
            parts.append({c.name: own[c.name] if c.name in own else _absent(shape, c) for c in wanted[stream]})
        result[stream] = {c.name: _side_by_side([part[c.name] for part in parts]) for c in wanted[stream]}
    for name, leaf, _, _ in radio_columns(world, history):
        result[OF_RADIO][name] = leaf
    return result


def _side_by_side(parts: list[NumpyArray]) -> NumpyArray:
    """Concatenate the fleets' arrays (T, size) to (T, n); the array of a single fleet is not copied."""
    return np.concatenate(parts, axis=1) if len(parts) > 1 else np.asarray(parts[0])


def _absent(shape: tuple[int, int], column: Column) -> NumpyArray:
    """Return an array of the value logged for a quantity that a fleet lacks: NaN, or 0 for types without NaN."""
    return np.full(shape, np.nan if column.dtype.startswith("float") else 0, column.dtype)


class EventFinder:
    """Detects events: a vehicle becomes invalid, reaches a waypoint, loses a sensor, and the like."""

    def __init__(self, simulation: Simulation):
        self.world = simulation.world
        self.names = simulation.vehicle_names
        self.time_step = simulation.world.time_step
        self.standing: list[Any] = [None] * len(self.world.fleets)
        self.crowded: set[str] = set()
        start = simulation.history
        self.before = {key: pick(start)[-1] for key, pick in self._sources().items()}
        self.missions = MissionWatch(self.world, start)
        self.failsafes = FailsafeWatch(self.world, start)
        self.zones = ZoneWatch(self.world)

    @staticmethod
    def _sources() -> dict[str, Callable[[History], Any]]:
        """Return name -> function of a history that gives an array (T, n), in which each increase is an event."""

        def together(pick: Callable[[FleetState], Any]) -> Callable[[History], Any]:
            """Return a function of a history that joins the value ``pick`` of all fleets to (T, n)."""
            return lambda history: np.concatenate([pick(fleet) for fleet in history.state.fleets], axis=1)

        return {
            "code": together(lambda fleet: fleet.violation.code),
            "reached": together(lambda fleet: fleet.guidance.reached),
            "clipped": together(lambda fleet: fleet.command_clipped),
        }

    def find(self, history: History) -> list[Content]:
        """Return the events in a history, in order of time, as keyword arguments of ``RunWriter.append_event``."""
        found: list[tuple[int, int, Content]] = []
        for key, pick in self._sources().items():
            now = pick(history)
            previous = np.concatenate([self.before[key][None], now[:-1]])
            self.before[key] = now[-1]
            for row, vehicle in np.argwhere(now > previous):
                found.append((int(row), int(vehicle), self._event(key, history, int(row), int(vehicle))))
        found += [*self._faults(history), *self._losses(history), *self._persons(history)]
        found += self._of_missions(history, self.missions.events(history))
        found += [*self._of_watches(history), *self._landings(history), *self._crowds(history)]
        found += [(row, 0, event) for row, event in weather_events(self.world, history)]
        found.sort(key=lambda item: item[:2])
        return [event for _, _, event in found]

    def ending(self, history: History) -> list[Content]:
        """Return events at the end of a run: unfinished missions, totals of readings with too many neighbours."""
        found = [event for _, _, event in self._of_missions(history, self.missions.ending(history))]
        for crowd in crowds_of(self.world, history.state):
            looks = int(crowd.looks[-1].sum())
            if looks:
                event = self._at(history, len(history.ticks) - 1, 0) | {"vehicle": None, "kind": OVERFULL}
                found.append({**event, "field": crowd.path, "value": float(looks), "message": crowd.text(looks)})
        return found

    def _crowds(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) when a radio's, sensor's or guidance's neighbour list first overflowed."""
        found = []
        for crowd in crowds_of(self.world, history.state):
            rows = np.argwhere(crowd.looks > 0)
            if crowd.path in self.crowded or not len(rows):
                continue
            self.crowded.add(crowd.path)
            row, vehicle = int(rows[0, 0]), crowd.first + int(rows[0, 1])
            event = self._at(history, row, vehicle)
            message = (
                f"{event['vehicle']}: {crowd.path} had more others around it than are looked at, first at"
                f" {event['time']:.2f} s"
            )
            found.append((row, vehicle, {**event, "kind": OVERFULL, "field": crowd.path, "message": message}))
        return found

    def _of_missions(self, history: History, found: Iterable[tuple[int, Found]]) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) of each mission event in ``found``, given by fleet number."""
        firsts = np.cumsum([0, *(fleet.size for fleet in self.world.fleets)])
        events = []
        for number, (row, own, kind, value, message) in found:
            vehicle = int(firsts[number]) + own
            event = self._at(history, row, vehicle)
            message = f"{message}, at {event['time']:.2f} s"
            events.append((row, vehicle, {**event, "kind": kind, "field": "leg", "value": value, "message": message}))
        return events

    def _of_watches(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) of each failsafe and zone event in a history."""
        events, found = [], [*self.failsafes.events(history), *self.zones.events(history)]
        for row, vehicle, kind, field, value, message in found:
            event = self._at(history, row, vehicle)
            message = f"{event['vehicle']}: {message} at {event['time']:.2f} s"
            events.append((row, vehicle, {**event, "kind": kind, "field": field, "value": value, "message": message}))
        return events

    def _faults(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) of each scheduled fault that begins or ends in a history."""
        found, first = [], 0
        world = self.world
        if world.ranges:
            # When a fault begins may be drawn.
            world = world.with_drawn(tuple(np.asarray(drawn)[0] for drawn in history.state.drawn))
        for fleet in world.fleets:
            edges: list[tuple[Any, Any, str, str, str]] = []
            broken: Any
            for fault in fleet.faults:
                told = f"{fault.sensor} {fault.kind}"
                edges.append((fault.start_tick, fault.affected, "fault_begins", fault.sensor, f"{told}, begins"))
                edges.append((fault.end_tick, fault.affected, "fault_ends", fault.sensor, f"{told}, ends"))
            for broken in (*fleet.rotor_faults, *fleet.battery_faults):
                part = f"rotor_{broken.rotor}" if isinstance(broken, RotorFault) else "battery"
                told = part.replace("_", " ")
                edges.append((broken.start_tick, broken.affected, "fault_begins", part, f"{told} fails"))
                edges.append((broken.end_tick, broken.affected, "fault_ends", part, f"{told} is well again"))
            for radio in fleet.radio_faults:
                told = "radio fails" if radio.off else "radio loses packets"
                edges.append((radio.start_tick, radio.affected, "fault_begins", "radio", told))
                edges.append((radio.end_tick, radio.affected, "fault_ends", "radio", "radio is well again"))
            for push in fleet.pushes:
                edges.append((push.start_tick, push.affected, "fault_begins", "body", "push begins"))
                edges.append((push.end_tick, push.affected, "fault_ends", "body", "push ends"))
            for edge, affected, kind, part, words in edges:
                for row in np.flatnonzero(history.ticks == int(edge)):
                    for i in np.flatnonzero(affected):
                        event = self._at(history, int(row), first + int(i))
                        message = f"{event['vehicle']}: {words} at {event['time']:.2f} s"
                        event |= {"kind": kind, "field": part, "message": message}
                        found.append((int(row), first + int(i), event))
            first += fleet.size
        return found

    def _losses(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) when a flying vehicle's GNSS receiver loses its fix or regains it."""
        found, first = [], 0
        for fleet, state in zip(self.world.fleets, history.state.fleets, strict=True):
            for sensor, reading in zip(fleet.sensor_names, state.readings, strict=True):
                if not isinstance(reading, GnssReading):
                    continue
                key = f"{fleet.name}/{sensor}"
                lost = np.isnan(reading.position_ned.x) & (reading.satellites < FEWEST_SATELLITES)
                from_the_start = key not in self.before
                before = self.before.get(key, np.zeros(fleet.size, bool))
                previous = np.concatenate([before[None], lost[:-1]])
                self.before[key] = lost[-1]
                for row, i in np.argwhere(lost != previous):
                    event = self._at(history, int(row), first + int(i))
                    count = float(reading.satellites[row, i])
                    kind = "fix_found" if not lost[row, i] else "no_fix" if from_the_start and row == 0 else "fix_lost"
                    counted = f"{count:.0f} satellites" if np.isfinite(count) else "the vehicle has stopped"
                    message = (
                        f"{event['vehicle']}: {sensor} {kind.replace('_', ' ')} at {event['time']:.2f} s, {counted}"
                    )
                    value = count if np.isfinite(count) else None
                    event |= {"kind": kind, "field": f"{sensor}.satellites", "value": value, "message": message}
                    found.append((int(row), first + int(i), event))
            first += fleet.size
        return found

    def _persons(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, nearest vehicle, event) of each person found in a history."""
        persons = history.state.contents.persons
        if persons is None:
            return []
        found = []
        for row, number in np.argwhere(persons.found_tick == history.ticks[:, None]):
            where = np.array([persons.north[row, number], persons.east[row, number], 0.0])
            vehicle = self._nearest_to(history, int(row), where)
            event = self._at(history, int(row), vehicle)
            message = f"{event['vehicle']} found person {number} at {event['time']:.2f} s"
            event |= {"kind": PERSON_FOUND, "field": "persons", "value": float(number), "message": message}
            found.append((int(row), vehicle, event))
        return found

    def _landings(self, history: History) -> list[tuple[int, int, Content]]:
        """Return (row, vehicle, event) of each landing and take-off in a history."""
        found, first = [], 0
        for number, (fleet, state) in enumerate(zip(self.world.fleets, history.state.fleets, strict=True)):
            standing = on_ground(fleet, state)
            if standing is not None:
                now = np.asarray(standing)
                before = self.standing[number] if self.standing[number] is not None else now[0]
                previous = np.concatenate([before[None], now[:-1]])
                self.standing[number] = now[-1]
                for row, i in np.argwhere(now != previous):
                    event = self._at(history, int(row), first + int(i))
                    kind, words = ("landed", "landed") if now[row, i] else ("took_off", "took off")
                    message = f"{event['vehicle']} {words} at {event['time']:.2f} s"
                    found.append((int(row), first + int(i), {**event, "kind": kind, "message": message}))
            first += fleet.size
        return found

    def _at(self, history: History, row: int, vehicle: int) -> Content:
        """Return the fields time, tick and vehicle of an event at a row of a history."""
        return {"time": float(history.time[row]), "tick": int(history.ticks[row]), "vehicle": self.names[vehicle]}

    def _event(self, key: str, history: History, row: int, vehicle: int) -> Content:
        """Return the event at a row of a history; ``key`` names its source: stop, waypoint or clipped command."""
        event = self._at(history, row, vehicle)
        name, time = event["vehicle"], event["time"]
        if key == "reached":
            count = int(self._sources()["reached"](history)[row, vehicle])
            message = f"{name} reached its waypoint number {count} at {time:.2f} s"
            return {**event, "kind": "waypoint_reached", "field": "waypoint", "value": float(count), "message": message}
        if key == "clipped":
            return {**event, "kind": "command_clipped", "message": f"{name}: command clipped at {time:.2f} s"}
        code = int(self._sources()["code"](history)[row, vehicle])
        value = float(np.concatenate([f.violation.value for f in history.state.fleets], axis=1)[row, vehicle])
        kind, field = REASONS[code]
        message = f"{name} stopped at {time:.2f} s, {reason_text(code, value)}"
        if kind == "collision" and field == "distance":
            message += f" to {self._nearest(history, row, vehicle)}"
        if field == "fence":
            message += self.zones.name(history, row, vehicle)
        return {**event, "kind": kind, "field": field, "value": value, "message": message}

    def _nearest(self, history: History, row: int, vehicle: int) -> str:
        """Return the name of the vehicle nearest to vehicle ``vehicle`` at a row of a history."""
        own = self._positions(history, row)[vehicle]
        return self.names[self._nearest_to(history, row, own, vehicle)]

    def _nearest_to(self, history: History, row: int, where: NumpyArray, but: int | None = None) -> int:
        """Return the index of the vehicle nearest to a place (3,) [m] at a row, ignoring vehicle ``but``."""
        distance = np.linalg.norm(self._positions(history, row) - where, axis=1)
        if but is not None:
            distance[but] = np.inf
        return int(np.argmin(distance))

    @staticmethod
    def _positions(history: History, row: int) -> NumpyArray:
        """Return the positions (n, 3) NED [m] of all vehicles at a row of a history."""
        positions = [position_of(fleet) for fleet in history.state.fleets]
        return np.stack([np.concatenate([getattr(each, axis)[row] for each in positions]) for axis in "xyz"], axis=1)
