"""WORLD: what a world is made of, for clients that have not seen its scenario."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from qrsim.core.tree import field_info
from qrsim.files import Content
from qrsim.interface.arrays import as_array
from qrsim.interface.readings import FleetReading
from qrsim.links.reference.kinds import TYPES
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.shared.kinds import kinds_of
from qrsim.scenarios import catalogue
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.simulation import Simulation
from qrsim.tasks.agents import Axis
from qrsim.world.state import Fleet, World

Part = pb.World.Part


def description(scenario: Scenario, simulation: Simulation) -> pb.World:
    """Return the protobuf message WORLD, which describes area, obstacles, weather and fleets of a simulation."""
    world, reading = simulation.world, simulation.reading
    spec = scenario.spec.model_dump(mode="json")
    air = spec["world"]
    origin = [math.degrees(scenario.site.latitude_rad), math.degrees(scenario.site.longitude_rad), scenario.site.height]
    found = pb.World(
        scenario=scenario.name,
        time_step=world.time_step,
        collision_distance=float(np.asarray(world.collision_distance)),
        area=_part(air["area"], catalogue.AREAS),
        obstacle=[_part(each, catalogue.OBSTACLES) for each in air["obstacles"]],
        ground=_part(air["ground"], catalogue.GROUNDS),
        wind=_part(air["wind"], catalogue.WINDS),
        turbulence=_part(air["turbulence"], catalogue.TURBULENCES),
        gust=_part(air["gust"], catalogue.GUSTS),
        origin=origin,
    )
    if world.radio is not None:
        found.radio.CopyFrom(_part({"type": "radio"} | air["radio"], {"radio": type(world.radio)}))
    for fleet in world.fleets:
        _add_fleet(found, spec["fleets"][fleet.name], fleet, world, reading[fleet.name])
    return found


def _add_fleet(found: pb.World, spec: Mapping[str, Any], fleet: Fleet, world: World, reading: FleetReading) -> None:
    """Append a fleet's description to the message WORLD (``found``): vehicles, sensors, and commands with their
    limits."""
    start = as_array(fleet.start.position_ned)
    added = found.fleet.add(
        name=fleet.name,
        vehicle=fleet.vehicle_names,
        model=_part(spec["vehicle"], catalogue.VEHICLES),
        controller=spec["controller"]["type"],
        guidance=spec["guidance"]["type"],
        radius=float(np.asarray(world.radius_of(fleet))),
        limits=_limits_message(fleet),
        start=[pb.Arrayd(value=np.asarray(row, np.float64).tolist()) for row in start],
    )
    for name, sensor in zip(fleet.sensor_names, fleet.sensors, strict=True):
        of_sensor = spec["sensors"][name]
        period = float(sensor.period) or world.time_step
        added.sensor.add(name=name, type=of_sensor["type"], period=period, field=getattr(reading, name).fields)
    for kind, fields in kinds_of(fleet).items():
        command = added.command.add(type=pb.Step.Type.Name(TYPES[kind]), name=kind)
        for field in fields:
            command.field.add(name=field.name, unit=field.unit, low=field.low, high=field.high)


def _limits_message(fleet: Fleet) -> Part:
    """Return a fleet's limits on the state, beyond which a flight ends, as a protobuf message."""
    limits = fleet.limits
    message = Part(type=type(limits).__name__)
    for field in dataclasses.fields(limits):
        value = getattr(limits, field.name)
        if value is not None:
            numbers = np.asarray(value, np.float64).ravel().tolist()
            message.quantity.add(name=field.name, unit=field_info(field).unit, value=numbers)
    return message


def _part(spec: str | Content, known: Mapping[str, object]) -> Part:
    """Return a component of a scenario as a protobuf message: its type, parameters and units; ``known``: type ->
    class."""
    content = {"type": spec} if isinstance(spec, str) else dict(spec)
    kind = str(content.pop("type"))
    units = _units_by_field(known.get(kind))
    found = Part(type=kind)
    for name, value in _values(content, ""):
        unit = units.get(name.partition(".")[0], "")
        if isinstance(value, str):
            found.quantity.add(name=name, text=value)
        else:
            found.quantity.add(name=name, value=value, **({"unit": unit} if unit else {}))
    return found


def _units_by_field(kind: object) -> dict[str, str]:
    """Return field -> unit of a component's class; {} for anything else."""
    if not dataclasses.is_dataclass(kind):
        return {}
    return {field.name: field_info(field).unit for field in dataclasses.fields(kind)}


def _values(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, object]]:
    """Yield (dotted name, text or flat list of numbers) for each entry, at any depth, of a part of a scenario.

    Lists of points are flattened. Several such lists, such as the courtyards of a building, are numbered, and so are
    parts, such as the zones of an area.
    """
    for key, value in content.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _values(value, f"{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for i, part in enumerate(value):
                yield from _values(part, f"{name}.{i}.")
        elif isinstance(value, str):
            yield name, value
        elif _is_several(value):
            yield from ((f"{name}.{i}", np.asarray(part, np.float64).ravel().tolist()) for i, part in enumerate(value))
        elif value is not None:
            try:
                yield name, np.asarray(value, np.float64).ravel().tolist()
            except (TypeError, ValueError):
                yield name, str(value)


def _is_several(value: object) -> bool:
    """Return whether a value is a list of lists of points."""
    return bool(isinstance(value, list) and value and isinstance(value[0], list) and isinstance(value[0][0], list))


def axis_message(axis: Axis) -> pb.Episode.Axis:
    """Return the description of a number of an action as a message."""
    neutral = None if axis.neutral is None else float(axis.neutral)
    return pb.Episode.Axis(name=axis.name, unit=axis.unit, low=axis.low, high=axis.high, neutral=neutral)
