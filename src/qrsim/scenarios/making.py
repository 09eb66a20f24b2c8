"""Scenarios written in Python: the same parts, checks and defaults as in YAML."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from qrsim.core.tree import field_info
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.scene.prisms import PrismObstacle
from qrsim.models.scene.zones import ZonesArea
from qrsim.scenarios import catalogue
from qrsim.scenarios.interference import KIND_OF
from qrsim.scenarios.registry import name_of
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.schema import SKY_KINDS
from qrsim.scenarios.zone_schema import content_of
from qrsim.world.state import World

SCENARIO_PARTS = ("name", "description", "duration", "time_step", "start_time", "site", "extends", "ranges", "task")
WORLD_PARTS = (
    "area", "ground", "wind", "turbulence", "gust", "updrafts", "sky", "plume", "terrain", "persons", "obstacles",
    "buildings", "base_station", "interference", "beacons", "collision_distance", "radio",
)  # fmt: skip
FLEET_PARTS = (
    "vehicle",
    "controller",
    "guidance",
    "limits",
    "sensors",
    "estimator",
    "battery",
    "faults",
    "failsafes",
    "injectable",
    "placement",
    "ground",
    "radius",
    "radio",
)
# With the vehicles of a single fleet these are the world's.
OF_THE_WORLD = ("ground", "radio")
# What a fleet does at the ground has the name of the ground itself, and is told from it by its value.
AT_THE_GROUND = ("stop", "parked")
_TYPES = {
    cls: name
    for group in vars(catalogue).values()
    if isinstance(group, dict) and group and all(isinstance(item, type) for item in group.values())
    for name, cls in group.items()
}


def make_scenario(
    vehicles: Sequence[object] | None = None,
    *,
    fleets: Mapping[str, Mapping[str, object]] | None = None,
    **parts: object,
) -> Scenario:
    """Make a checked scenario from Python objects; ``parts`` are further keys of a scenario file.

    Args:
        vehicles: those of a single fleet, ``vehicles``: positions NED (3,) [m], or dicts as in YAML.
        fleets: several fleets by name, each a dict with ``vehicles`` and any of the parts of a fleet.
        parts: what a scenario has in YAML, by its name there: of the scenario (name, duration, time_step, start_time,
            site, extends, ranges, task), of its world (area, ground, wind, turbulence, gust, updrafts, sky, plume,
            terrain, persons, obstacles, buildings, base_station, interference, beacons, collision_distance, radio), and
            with ``vehicles`` of the fleet (vehicle, controller, guidance, limits, sensors, battery, faults, failsafes,
            injectable, placement, and ground, which is the world's unless it is "stop" or "parked"). A component is the
            name of its type, a dict as in YAML, or an object such as ``LogShear(...)``. Sensors are
            "ideal" (the default), or given by name, or "noisy": a receiver, an IMU, a magnetometer and a barometer,
            with an estimator ``ekf``, and in a wind with a ``speed_20ft`` turbulence ``dryden_field``, unless others
            are given (estimator None for none). With ``extends``, ``fleets`` says what is different in them, and may be
            left out.

    Raises:
        UsageError: an unknown part, or an object that is no component of its kind.
        ScenarioError: what the parts say is wrong; the message lists every fault.
    """
    extends = "extends" in parts
    if extends and vehicles is not None:
        raise UsageError("make_scenario: with extends give fleets, by the names they have there, in place of vehicles")
    if not extends and (vehicles is None) == (fleets is None):
        raise UsageError("make_scenario: give either vehicles or fleets")
    known = (*SCENARIO_PARTS, *WORLD_PARTS, *(FLEET_PARTS if vehicles is not None else ()))
    if vehicles is not None and isinstance(parts.get("ground"), str) and parts["ground"] in AT_THE_GROUND:
        fleet_parts = {name: parts.pop(name) for name in FLEET_PARTS if name in parts and name != "radio"}
    else:
        fleet_parts = {name: parts[name] for name in FLEET_PARTS if name in parts and name not in OF_THE_WORLD}
    for name in parts:
        if name in FLEET_PARTS and name not in known:
            raise UsageError(f"make_scenario: {name} is a part of a fleet; give it in fleets")
        if name not in known:
            raise UsageError(f"make_scenario: no part is called '{name}'{did_you_mean(name, known)}")
    content: dict[str, object] = {"name": "experiment"}
    content |= {name: _plain(parts[name], name, name) for name in SCENARIO_PARTS if name in parts}
    world = {name: _part(parts[name], name) for name in WORLD_PARTS if name in parts}
    if world:
        content["world"] = world
    if vehicles is not None:
        fleets = {"vehicles": {"vehicles": vehicles, **fleet_parts}}
    if fleets is not None:
        content["fleets"] = {name: _fleet(name, fleet, extends) for name, fleet in fleets.items()}
    return load_scenario(content)


def make_world(
    vehicles: Sequence[object] | None = None,
    *,
    fleets: Mapping[str, Mapping[str, object]] | None = None,
    precision: str = "float32",
    **parts: object,
) -> World:
    """Make a World from Python objects; arguments as ``make_scenario``; ``precision`` is float32 or float64.

    A component of your own is given as an object, as the built-in ones are: ``wind=MyWind()``
    (docs/howto/own_component.md).

    Raises:
        UsageError, ScenarioError: as ``make_scenario``.
    """
    from qrsim.simulation.arguments import check_precision

    return make_scenario(vehicles, fleets=fleets, **parts).world(check_precision(precision))


def _fleet(name: str, fleet: object, extends: bool) -> dict[str, object]:
    """Convert a fleet given in Python to scenario content; with ``extends``, missing parts stay missing."""
    if not isinstance(fleet, Mapping):
        raise UsageError(f"make_scenario: fleets.{name}: expected a dict, found {fleet!r}")
    known = ("vehicles", *FLEET_PARTS)
    for part in fleet:
        if part not in known:
            raise UsageError(f"make_scenario: fleets.{name}: no part is called '{part}'{did_you_mean(part, known)}")
    content = {
        part: _part(value, part) for part, value in fleet.items() if part not in ("vehicles", "sensors", "ground")
    }
    if "ground" in fleet:
        content["ground"] = fleet["ground"]
    # What is left out of a fleet that is extended is as it is there.
    if "sensors" in fleet or not extends:
        content["sensors"] = _sensors(name, fleet.get("sensors", "ideal"))
    if "vehicles" in fleet or not extends:
        content["vehicles"] = _vehicles(name, fleet.get("vehicles", ()))
    return content


def _sensors(name: str, sensors: object) -> object:
    """Convert a fleet's sensors to scenario content: a dict by name, or the name of a sensor set."""
    if isinstance(sensors, Mapping):
        return {sensor: _part(value, sensor, "sensor") for sensor, value in sensors.items()}
    if not isinstance(sensors, str):
        raise UsageError(
            f"make_scenario: fleets.{name}.sensors: expected a dict or the name of a set, found {sensors!r:.80}"
        )
    return sensors


def _vehicles(name: str, vehicles: object) -> list[object]:
    """Convert vehicles to scenario content; one that is not a mapping is taken as its start position NED [m]."""
    if isinstance(vehicles, str | Mapping) or not hasattr(vehicles, "__iter__"):
        raise UsageError(f"make_scenario: fleets.{name}.vehicles: expected a list of vehicles, found {vehicles!r}")
    plain = [_plain(vehicle, "vehicles") for vehicle in vehicles]
    return [vehicle if isinstance(vehicle, Mapping) else {"position_ned": vehicle} for vehicle in plain]


def _part(value: object, name: str, kind: str = "") -> object:
    """Convert a component given in Python to scenario content: a dict with its type and parameters."""
    if name == "sky" and isinstance(value, Mapping):
        return {key: entry if key == "period" else _part(entry, f"sky.{key}") for key, entry in value.items()}
    if name == "radio" and isinstance(value, str):
        return value
    kinds = {f"sky.{part}": other for other, part in SKY_KINDS.items()}
    return {"type": value} if isinstance(value, str) else _plain(value, name, kind or kinds.get(name, name))


def _plain(value: object, name: str, kind: str = "") -> object:
    """Convert a Python value to one that YAML can express: components to dicts, arrays to lists."""
    if isinstance(value, Mapping):
        return {key: _plain(entry, f"{name}.{key}") for key, entry in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        given = [field.name for field in dataclasses.fields(value) if not field_info(field).derived]
        fields = {name: getattr(value, name) for name in given}
        if isinstance(value, PolygonArea):
            fields["corners_ned"] = np.column_stack([fields.pop("north"), fields.pop("east")])
        elif isinstance(value, ZonesArea):
            fields |= content_of(value.zones)
        elif isinstance(value, PrismObstacle):
            outline, *holes = value.rings()
            fields = {"corners_ned": outline, "holes_ned": holes, "z_min": value.z_min, "z_max": value.z_max}
        content = {key: _plain(entry, f"{name}.{key}") for key, entry in fields.items() if entry is not None}
        if type(value) in _TYPES:
            # A part of a component is of one type only, and a scenario does not name it.
            for part in content.values():
                if isinstance(part, dict):
                    part.pop("type", None)
            return {"type": _TYPES[type(value)], **content}
        if type(value) in KIND_OF:
            return {"kind": KIND_OF[type(value)], **content}
        if type(value).__module__.startswith("qrsim."):
            return content
        if kind in catalogue.KINDS:
            return {"type": name_of(kind, type(value)), **content}
        raise UsageError(f"make_scenario: {name}: {type(value).__name__} is no part of a scenario")
    if isinstance(value, np.ndarray | np.generic) or hasattr(value, "__array__"):
        return np.asarray(value).tolist()
    if isinstance(value, list | tuple):
        return [_plain(entry, name) for entry in value]
    return value
