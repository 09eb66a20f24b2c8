"""Ranges, drawn anew in every episode: checks, and places in a World."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from qrsim.core.tree import field_info
from qrsim.errors import did_you_mean
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.faults import TIMES, drawn_paths
from qrsim.scenarios.interference import world_path as interference_path
from qrsim.scenarios.problems import describe
from qrsim.scenarios.satellites import base_station
from qrsim.scenarios.schema import RangeSpec, ScenarioSpec
from qrsim.world.state import Range

# Where a World has the parts of a scenario; what is looked at while a scenario is loaded or flown on is not there.
IN_WORLD: dict[str, tuple[str, ...]] = {
    "world.wind": ("wind",),
    "world.turbulence": ("turbulence",),
    "world.gust": ("gust",),
    "world.sky.errors": ("sky", "errors"),
    "world.base_station": ("sky", "base"),
    "world.plume": ("contents", "plume"),
    "world.terrain": ("contents", "terrain"),
    "world.persons": ("contents", "persons"),
}
IN_FLEET = ("vehicle", "controller", "guidance", "limits", "battery", "placement", "estimator", "failsafes")
GROUPS = {
    "wind": known.WINDS,
    "turbulence": known.TURBULENCES,
    "gust": known.GUSTS,
    "errors": known.SKY_ERRORS,
    "plume": known.PLUMES,
    "terrain": known.TERRAINS,
    "persons": known.PERSONS,
}
Path = tuple[str | int, ...]


def range_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a scenario's ``ranges``, from which episodes draw parameters."""
    seen: set[str] = set()
    for i, item in enumerate(scenario.ranges):
        path = in_radians(item)[0]
        if path in seen:
            yield f"ranges.{i}.path: {item.path} has a range already"
        seen.add(path)
        if item.low > item.high:
            yield f"ranges.{i}.low: {item.low:g}; allowed: at most high, {item.high:g}"
            continue
        problem = _path_problem(scenario, path)
        if problem:
            yield f"ranges.{i}.path: {problem}"
            continue
        yield from _bound_problems(scenario, i, item, path)


def in_radians(item: RangeSpec) -> tuple[str, float, float]:
    """Return path, low and high of a range; those of an angle in degrees are converted to radians."""
    if item.path.endswith("_deg"):
        return item.path.removesuffix("_deg") + "_rad", math.radians(item.low), math.radians(item.high)
    return item.path, item.low, item.high


def _value_at(scenario: ScenarioSpec, parts: list[str]) -> tuple[object, str]:
    """Return (value at a path of the scenario, "") or, if the path is wrong, (None, error text)."""
    value = scenario
    for i, part in enumerate(parts):
        if isinstance(value, list):
            known_names = [str(number) for number in range(len(value))]
        else:
            known_names = list(value) if isinstance(value, Mapping) else list(getattr(type(value), "model_fields", ()))
        if part not in known_names:
            return None, f"{'.'.join(parts[: i + 1])}: there is no such number{did_you_mean(part, known_names)}"
        if isinstance(value, list):
            value = value[int(part)]
        else:
            value = value[part] if isinstance(value, Mapping) else getattr(value, part)
    return value, ""


def _path_problem(scenario: ScenarioSpec, path: str) -> str:
    """Return the reason why episodes cannot draw the number at a path; "" if they can."""
    parts = path.split(".")
    value, problem = _value_at(scenario, parts)
    if problem:
        return problem
    where = world_path(scenario, path)
    if where is None:
        parts_known = [
            *IN_WORLD,
            "world.updrafts.NUMBER",
            "world.interference.NUMBER",
            *(f"fleets.NAME.{part}" for part in IN_FLEET),
            "fleets.NAME.sensors.NAME",
            "fleets.NAME.faults.NUMBER",
        ]
        return f"{path} cannot be drawn; allowed: numbers of {', '.join(parts_known)}"
    if isinstance(value, bool) or not isinstance(value, int | float) or _is_setting(scenario, path):
        return f"{path} is not a number that can differ from episode to episode: it is compiled into the program"
    return ""


def _is_setting(scenario: ScenarioSpec, path: str) -> bool:
    """Return whether the number at a path is a setting that is compiled, and so cannot vary."""
    parts = path.split(".")
    for depth in range(len(parts) - 1, 0, -1):
        spec, _ = _value_at(scenario, parts[:depth])
        if isinstance(spec, BaseModel) and "type" in type(spec).model_fields:
            group = _group(parts[:depth])
            owner = group[spec.type] if group else None  # type: ignore[attr-defined]
            return owner is not None and _static(owner, parts[depth:])
    return False


def _group(parts: list[str]) -> Mapping[str, type] | None:
    """Return type name -> class of components that a path may have, such as fleets.NAME.battery; None for others."""
    if parts[:2] == ["world", "updrafts"]:
        return known.UPDRAFTS
    if parts[0] == "world":
        return GROUPS.get(parts[-1])
    names = {
        "vehicle": known.VEHICLES,
        "controller": known.CONTROLLERS,
        "guidance": known.GUIDANCE,
        "battery": known.BATTERIES,
        "placement": known.PLACEMENTS,
        "estimator": known.FILTERS,
    }
    return known.SENSORS if parts[2] == "sensors" else names.get(parts[2])


def _static(owner: Any, names: list[str]) -> bool:
    """Return whether a field of a component, or of one nested in it along ``names``, is compiled and cannot vary."""
    fields = {field.name: field for field in dataclasses.fields(owner)}
    # What a scenario says of every sensor, as its delay, is no field of the sensor and is compiled.
    if names[0] not in fields:
        return True
    field = fields[names[0]]
    return field_info(field).static if len(names) == 1 else _static(type(field.default), names[1:])


def _bound_problems(scenario: ScenarioSpec, i: int, item: RangeSpec, path: str) -> Iterator[str]:
    """Yield an error if a range, the ``i``-th of the scenario, exceeds the bounds of its parameter."""
    _, low, high = in_radians(item)
    for end, value in (("low", low), ("high", high)):
        content = copy.deepcopy(scenario.model_dump(mode="json"))
        target = content
        *way, last = path.split(".")
        for part in way:
            target = target[int(part) if isinstance(target, list) else part]
        target[last] = value
        try:
            ScenarioSpec.model_validate(content)
        except ValidationError as error:
            for problem in describe(error, ScenarioSpec, content):
                yield f"ranges.{i}.{end}: {problem}"


def world_path(scenario: ScenarioSpec, path: str) -> Path | None:
    """Return the path in a World of a scenario's parameter; None if episodes cannot draw it."""
    for prefix, where in IN_WORLD.items():
        if path.startswith(f"{prefix}.") and (prefix != "world.base_station" or base_station(scenario) is not None):
            return (*where, *path.removeprefix(f"{prefix}.").split("."))
    if path.startswith("world.updrafts."):
        _, _, number, *rest = path.split(".")
        return ("updrafts", int(number), *rest)
    if path.startswith("world.interference."):
        return interference_path(scenario, path)
    parts = path.split(".")
    if parts[0] != "fleets" or len(parts) < 4:
        return None
    fleet = list(scenario.fleets).index(parts[1])
    if parts[2] == "faults" and len(parts) == 5:
        paths = drawn_paths(scenario.fleets[parts[1]], int(parts[3]), parts[4])
        return ("fleets", fleet, *paths[0]) if paths else None
    if parts[2] in IN_FLEET:
        return ("fleets", fleet, *parts[2:])
    if parts[2] == "sensors" and len(parts) >= 5:
        sensor = list(scenario.fleets[parts[1]].sensors).index(parts[3])
        return ("fleets", fleet, "sensors", sensor, *parts[4:])
    return None


def is_time_of_fault(path: str) -> bool:
    """Return whether a scenario path is a fault's time, which a World stores in ticks."""
    parts = path.split(".")
    return len(parts) == 5 and parts[0] == "fleets" and parts[2] == "faults" and parts[-1] in TIMES


def ranges_of(scenario: ScenarioSpec) -> tuple[Range, ...]:
    """Build the ranges from which episodes draw parameters, of a checked scenario."""
    found = []
    for item in scenario.ranges:
        path, low, high = in_radians(item)
        where = world_path(scenario, path)
        assert where is not None
        if is_time_of_fault(path):
            low, high = low / scenario.time_step, high / scenario.time_step
        paths = (where, *_heirs(scenario, path))
        found.append(Range(low, high, path, paths))  # type: ignore[arg-type]
    return tuple(found)


def _heirs(scenario: ScenarioSpec, path: str) -> Iterator[Path]:
    """Yield the other paths in a World at which a scenario's parameter is inherited or repeated."""
    parts = path.split(".")
    if parts[0] == "fleets" and parts[2] == "faults":
        fleet = list(scenario.fleets).index(parts[1])
        for where in drawn_paths(scenario.fleets[parts[1]], int(parts[3]), parts[4])[1:]:
            yield ("fleets", fleet, *where)
    turbulence = scenario.world.turbulence
    for field in dataclasses.fields(known.TURBULENCES[turbulence.type]):
        if field_info(field).inherits == path and getattr(turbulence, field.name) is None:
            yield ("turbulence", field.name)
