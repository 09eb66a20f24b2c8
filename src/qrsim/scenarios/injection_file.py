"""Files of injections, as ``qrsim run --inject`` takes them and as runs record them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from qrsim.core.arrays import is_number
from qrsim.errors import LONGEST_NAME, ScenarioError, UsageError, did_you_mean, did_you_mean_file
from qrsim.files import Content
from qrsim.files.user_files import read_text
from qrsim.files.yaml_text import parse_yaml
from qrsim.models.sensors.fault_numbers import NAMES
from qrsim.models.sensors.faults import LAST_TICK
from qrsim.models.vehicles.fault_numbers import number_of, push_numbers
from qrsim.scenarios import catalogue
from qrsim.scenarios.faults import is_pushable, rotors_of, vehicle_names
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.schema import FleetSpec, WorldSpec
from qrsim.scenarios.timing import is_multiple
from qrsim.simulation.changing import JAM, TAKES, WIND
from qrsim.simulation.injections import BODY, LINK, OK, WORLD, Injection, plain_target
from qrsim.simulation.requests import after_request

LARGEST_BYTES, MOST_ENTRIES = 2**24, 10_000
# Keys of an entry that are no numbers of its kind.
KEYS = ("target", "kind", "tick", "at", "end", "vehicles", "asked_by")
BATTERY, RADIO = "battery", "radio"
# Targets of which a vehicle has one, and that are no sensor.
PLAIN = (BATTERY, RADIO, BODY, LINK)


def read_injections(scenario: Scenario, path: Path) -> tuple[Scenario, tuple[Injection, ...]]:
    """Read a file of injections; return the scenario extended to allow them, and the requests to make in flight.

    A file is a list of entries with ``target`` (a sensor, ``rotor N``, ``battery``, ``radio``, ``body``, ``link`` or
    ``world``), ``kind``, ``at`` [s], perhaps ``end`` [s] and ``vehicles``, and the numbers of the kind. Entries of a
    recorded flight have a ``tick`` too, at which they were asked for. Where a file has such entries, or ends faults
    (kind ``ok``), all of its faults are requests, for which the scenario gets room: a fault takes the place of the one
    before it. Otherwise its faults are added to those of the scenario. Changes of the world are always requests.

    Args:
        scenario: what is flown.
        path: of the file.

    Raises:
        UsageError: the file cannot be read, is too large, or an entry is not possible in the scenario.
    """
    entries = [
        (f"{path}: entry {number}", _checked(entry, f"{path}: entry {number}"))
        for number, entry in enumerate(_entries(path), 1)
    ]
    in_flight = any(_in_flight(entry) for _, entry in entries)
    content = scenario.spec.model_dump(mode="json")
    requests, wheres, written = [], [], dict[str, str]()
    for where, entry in entries:
        fleets = [] if entry["target"] == WORLD else _fleets(scenario, where, entry)
        if in_flight or entry["target"] == WORLD:
            requests.append(_request(scenario, where, entry))
            wheres.append(where)
            _make_room(content, entry, fleets)
        else:
            for name, mine in fleets:
                faults = content["fleets"][name]["faults"]
                written[f"fleets.{name}.faults.{len(faults)}."] = where.removeprefix(f"{path}: ")
                faults.append(_fault(where, entry, mine))
    try:
        scenario = load_scenario(content, quiet=True)
    except ScenarioError as error:
        raise ScenarioError(str(path), _of_entries(error.problems, written)) from None
    return scenario, tuple(_possible(scenario, requests, wheres))


def _of_entries(problems: Sequence[str], written: Mapping[str, str]) -> Iterator[str]:
    """Yield error texts with a fault's scenario path replaced by its entry in the injection file, each text once."""
    told = set[str]()
    for problem in problems:
        found = re.match(r"fleets\.[^.]+\.faults\.\d+\.", problem)
        entry = written.get(found[0]) if found else None
        if found and entry:
            rest = problem[found.end() :]
            problem = f"{entry}: {'at' + rest.removeprefix('start') if rest.startswith('start:') else rest}"
        if problem not in told:
            told.add(problem)
            yield problem


def _in_flight(entry: Content) -> bool:
    """Return whether an entry must be injected in flight, because faults in a scenario cannot express it."""
    by_field = any(isinstance(value, dict) for value in entry.values())
    return "tick" in entry or entry["kind"] == OK or entry["target"] == LINK or by_field


def _possible(scenario: Scenario, requests: Sequence[Injection], wheres: Sequence[str]) -> Iterator[Injection]:
    """Yield the requests by tick, with vehicle names filled in; raises UsageError for one that the world cannot take.

    Raises:
        UsageError: one is not possible.
    """
    world = scenario.world() if requests else None
    for request, where in sorted(zip(requests, wheres, strict=True), key=lambda pair: pair[0].tick):
        assert world is not None
        try:
            world, request = after_request(world, request)
        except UsageError as error:
            raise UsageError(f"{where}: {error}") from None
        yield request


def _entries(path: Path) -> list[object]:
    """Read the entries of a YAML file that lists injections; raises UsageError for any other content."""
    try:
        text = read_text(path, LARGEST_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}{did_you_mean_file(path)}") from None
    content = parse_yaml(text, str(path))
    if not isinstance(content, list):
        found = "nothing" if content is None else type(content).__name__
        raise UsageError(f"{path}: expected a list of injections, found {found}")
    if len(content) > MOST_ENTRIES:
        raise UsageError(f"{path}: {len(content)} entries; allowed: at most {MOST_ENTRIES}")
    return content


def _checked(entry: object, where: str) -> Content:
    """Check an entry, and return it with "rotor 2" for "rotor_2" and "ok" for "clear"; raises UsageError."""
    if not isinstance(entry, dict):
        raise UsageError(f"{where}: expected target, kind, at and others, not {type(entry).__name__}")
    for name in ("target", "kind", "at"):
        if name not in entry:
            raise UsageError(f"{where}: {name} is missing")
    for name in ("target", "kind", "asked_by"):
        if not isinstance(entry.get(name, ""), str):
            raise UsageError(f"{where}: {name}: {entry[name]!r:.60}; allowed: a text")
    if len(by := entry.get("asked_by", "")) > LONGEST_NAME or not by.isprintable():
        raise UsageError(f"{where}: asked_by: {by!r:.60}; allowed: a name of at most {LONGEST_NAME} characters")
    for name in ("at", "end"):
        if entry.get(name) is not None and not (is_number(entry[name]) and 0.0 <= entry[name] <= 1e9):
            raise UsageError(f"{where}: {name}: {entry[name]!r:.60}; allowed: a time [s]")
    tick, vehicles = entry.get("tick", 0), entry.get("vehicles")
    if type(tick) is not int or not 0 <= tick < LAST_TICK:
        raise UsageError(f"{where}: tick: {tick!r:.60}; allowed: a whole number from 0")
    if vehicles is not None and not (
        vehicles and isinstance(vehicles, list) and all(isinstance(one, str) for one in vehicles)
    ):
        raise UsageError(f"{where}: vehicles: expected a list of names")
    for name in ("end", "vehicles"):
        if entry.get(name) is not None and entry["target"] == WORLD:
            raise UsageError(f"{where}: {name}: the world changes for all, until it is changed again")
    if entry.get("end") is not None and entry["kind"] in (OK, "clear"):
        raise UsageError(f"{where}: end: kind 'ok' ends a fault at once")
    # The name of the method that ends faults is accepted too.
    kind = OK if entry["kind"] == "clear" else entry["kind"]
    return entry | {"target": plain_target(entry["target"]), "kind": kind}


def _rotor(target: str) -> int | None:
    """Return the rotor number N if a target is "rotor N"; None for any other target."""
    found = re.fullmatch(r"rotor ([0-9]{1,3})", target)
    return int(found[1]) if found else None


def _has(fleet: FleetSpec, target: str, world: WorldSpec) -> bool:
    """Return whether a fleet has a target of injections, such as a rotor, a sensor, the radio or the battery."""
    rotor = _rotor(target)
    if rotor is not None:
        return rotor < rotors_of(fleet)
    if target in fleet.sensors or target == LINK:
        return True
    if target == RADIO:
        return world.radio is not None and (fleet.radio is None or fleet.radio.works)
    if target == BODY:
        return is_pushable(fleet)
    return target == BATTERY and bool(catalogue.BATTERIES[fleet.battery.type].drains)


def _fleets(scenario: Scenario, where: str, entry: Content) -> list[tuple[str, list[str] | None]]:
    """Return (fleet, chosen vehicles or None: all) of the fleets that an entry affects; raises UsageError if none."""
    target, vehicles = entry["target"], entry.get("vehicles")
    found, placed = [], set[str]()
    for name, fleet in scenario.spec.fleets.items():
        known = set(vehicle_names(name, fleet))
        mine = None if vehicles is None else [each for each in vehicles if each in known]
        placed = placed.union(mine or ())
        if mine != [] and _has(fleet, target, scenario.spec.world):
            found.append((name, mine))
    unknown = [one for one in vehicles or () if one not in placed]
    if unknown:
        everybody = [one for name, fleet in scenario.spec.fleets.items() for one in vehicle_names(name, fleet)]
        raise UsageError(f"{where}: no vehicle is called '{unknown[0]}'{did_you_mean(unknown[0], everybody)}")
    if not found:
        whom = "" if vehicles is None else f" of {', '.join(map(str, vehicles))}"
        raise UsageError(f"{where}: there is no target '{target}'{whom}{did_you_mean(target, _targets(scenario))}")
    return found


def _targets(scenario: Scenario) -> list[str]:
    """Return the names of all targets that may fail in any fleet of the scenario."""
    fleets = scenario.spec.fleets.values()
    sensors = {sensor for fleet in fleets for sensor in fleet.sensors}
    rotors = [f"rotor {i}" for i in range(max(map(rotors_of, fleets)))]
    parts = [part for part in PLAIN if any(_has(fleet, part, scenario.spec.world) for fleet in fleets)]
    return [*sorted(sensors), *rotors, *parts, WORLD]


# ---- as faults of the scenario ----


def _numbers(entry: Content) -> Content:
    """Return the parameters of an entry's fault: the entry without the keys that every entry has."""
    return {name: value for name, value in entry.items() if name not in KEYS and value is not None}


def _fault(where: str, entry: Content, vehicles: list[str] | None) -> Content:
    """Convert an entry of an injection file to a fault of a fleet, as scenario content; raises UsageError."""
    target, kind, numbers = entry["target"], entry["kind"], _numbers(entry)
    rest = {"end": entry["end"]} if "end" in entry else {}
    rest |= {} if vehicles is None else {"vehicles": vehicles}
    rotor = _rotor(target)
    if rotor is None and target not in PLAIN:
        for name in numbers:
            if name not in (*NAMES, "field"):
                known = did_you_mean(name, (*NAMES, "field"))
                raise UsageError(f"{where}: {name:.60}: there is no such number{known}")
        return numbers | rest | {"sensor": target, "kind": kind, "start": entry["at"]}
    what = target if rotor is None else "rotor"
    try:
        if what == BODY:
            return push_numbers(kind, numbers) | rest | {"type": what, "at": entry["at"]}
        number_of(what, kind, numbers)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    rest |= {"type": what, "at": entry["at"]} | ({} if rotor is None else {"rotor": rotor})
    if what == RADIO:
        return numbers | rest | {"kind": kind}
    return ({"health": 0.0} if kind == "off" else {}) | numbers | rest


# ---- as requests in flight ----


def _request(scenario: Scenario, where: str, entry: Content) -> Injection:
    """Convert an entry to a request to make in flight, as late as possible if it has no ``tick``; raises UsageError."""
    dt, target = scenario.spec.time_step, entry["target"]
    for name in ("at", "end"):
        if entry.get(name) and not is_multiple(entry[name], dt, math.inf):
            raise UsageError(f"{where}: {name}: {entry[name]:g} s is not a multiple of the time step {dt:g} s")
    at, end = round(entry["at"] / dt), entry.get("end")
    # The first reading that a request can change is that of the next tick.
    soonest = int(entry["kind"] == JAM if target == WORLD else target not in PLAIN and _rotor(target) is None)
    tick = entry.get("tick", max(0, at - soonest))
    start = max(at, tick if entry["kind"] == OK else tick + soonest)
    last = LAST_TICK if end is None else min(round(end / dt), LAST_TICK)
    if last <= start:
        raise UsageError(f"{where}: end: {end:g} s is not after the start, {start * dt:g} s")
    # A recorded flight may have been longer than its scenario, as those of servers are.
    if "tick" not in entry and tick >= scenario.ticks:
        raise UsageError(
            f"{where}: at: {entry['at']:g} s is not within the run; allowed: from 0 s to before its end at "
            f"{scenario.duration:g} s (duration)"
        )
    vehicles, by = tuple(entry.get("vehicles") or ()), entry.get("asked_by", "file")
    return Injection(0, target, entry["kind"], vehicles, start, last, _numbers(entry), by, tick)


def _make_room(content: Content, entry: Content, fleets: list[tuple[str, list[str] | None]]) -> None:
    """Extend the scenario's ``injectable`` parts, in place, so that ``fleets`` can take an entry's request."""
    target, rotor = entry["target"], _rotor(entry["target"])
    if target == WORLD and entry["kind"] in TAKES and (entry["kind"] != WIND or entry.get("over")):
        world = content["world"]
        world["injectable"] = [kind for kind in TAKES if kind in {*world["injectable"], entry["kind"]}]
    for name, _ in fleets:
        fleet = content["fleets"][name]
        spec = fleet["injectable"] or {"sensors": [], "rotors": [], "battery": False, "delay_max": 0.0}
        if rotor is not None:
            spec["rotors"] = sorted({*spec["rotors"], rotor})
        elif target in (BATTERY, RADIO, BODY):
            spec[target] = True
        elif target != LINK and spec["sensors"] != ["all"]:
            spec["sensors"] = [sensor for sensor in fleet["sensors"] if sensor in {*spec["sensors"], target}]
        by = entry.get("by")
        if is_number(by) and by is not None:
            spec["delay_max"] = max(spec["delay_max"], by)
        fleet["injectable"] = spec
