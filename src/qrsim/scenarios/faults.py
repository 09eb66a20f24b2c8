"""The faults of a scenario, and slots of more in flight: checked against sensors, vehicles and readings, and built."""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterator
from typing import Any

import numpy as np

from qrsim.core.tree import record_of
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import did_you_mean
from qrsim.models.sensors.contracts import Memoryless
from qrsim.models.sensors.fault_numbers import (
    NAMES,
    TAKES,
    chosen_fields,
    empty_slot,
    fault_numbers,
    kind_of,
    number_problems,
)
from qrsim.models.sensors.faults import LAST_TICK, Fault, FaultSlot
from qrsim.models.vehicles.faults import BatteryFault, RotorFault
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.fault_schema import ALL, MOST_FAILED_ROTORS, FaultSpec, InjectableSpec, RotorFaultSpec
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.spans import moment_problems, span_problems
from qrsim.scenarios.timing import is_multiple
from qrsim.world.state import period_ticks

# An autopilot that looks at its motors' currents or speeds knows of a failed rotor after so long [s].
NOTICED_S = 0.1
# Readings that a delay keeps at most; each is part of what is compiled.
MOST_READINGS = 50


def vehicle_names(fleet_name: str, fleet: FleetSpec) -> tuple[str, ...]:
    """Return the name of each vehicle of a fleet."""
    return tuple(vehicle.name or f"{fleet_name}_{i}" for i, vehicle in enumerate(fleet.vehicles))


def faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[Fault, ...]:
    """Build the faults of a fleet."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = []
    for spec in fleet.faults:
        if isinstance(spec, FaultSpec):
            fields = tuple(reading_fields(fleet.sensors[spec.sensor].type))
            chosen = chosen_fields(spec.field, fields)
            ticks = period_ticks(fleet.sensors[spec.sensor].period, dt)
            numbers = fault_numbers(spec.kind, _given(spec), chosen, fields, dt, ticks)
            found.append(
                Fault(
                    start_tick=_tick(spec.start, dt),
                    end_tick=_tick(spec.end, dt),
                    affected=_mask(names, spec.vehicles),
                    numbers=numbers,
                    sensor=spec.sensor,
                    kind=kind_of(spec.kind),
                    fields=fields,
                    ticks=ticks,
                    time_step=dt,
                    remembered=int(numbers.readings),
                    only=chosen,
                )
            )
    return tuple(found)


def _given(spec: FaultSpec) -> dict[str, float | None]:
    return {name: getattr(spec, name) for name in NAMES}


def _tick(seconds: float | None, dt: float) -> Any:
    return np.array(LAST_TICK if seconds is None else min(round(seconds / dt), LAST_TICK), np.int32)


def rotor_faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[RotorFault, ...]:
    """Build the faults of a fleet's rotors."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = []
    for spec in fleet.faults:
        if isinstance(spec, RotorFaultSpec):
            times = (_tick(spec.at, dt), _tick(NOTICED_S, dt), _tick(spec.end, dt))
            found.append(record_of(RotorFault, *times, _mask(names, spec.vehicles), spec.health, spec.rotor))
    return tuple(found)


# Of a fault's numbers, where a World has those that an episode may draw; times are ticks there.
_SENSOR_PATHS: dict[str, tuple[str, ...]] = {
    "start": ("start_tick",), "end": ("end_tick",), "limit": ("numbers", "limit"), "share": ("numbers", "share"),
}  # fmt: skip
_OF_FIELDS = {"bias": "amounts", "rate": "amounts", "std": "amounts", "range": "amounts", "scale": "scales"}
_ROTOR_PATHS = {"at": "start_tick", "end": "end_tick", "health": "health"}
TIMES = ("start", "end", "at")


def drawn_paths(fleet: FleetSpec, number: int, name: str) -> list[tuple[str | int, ...]]:
    """Return where a Fleet has a number of one of its faults that an episode may draw; nowhere if it may not."""
    chosen = fleet.faults[number]
    place = sum(isinstance(fault, type(chosen)) for fault in fleet.faults[:number])
    if isinstance(chosen, RotorFaultSpec):
        return [("rotor_faults", place, _ROTOR_PATHS[name])] if name in _ROTOR_PATHS else []
    if name in _SENSOR_PATHS:
        return [("faults", place, *_SENSOR_PATHS[name])]
    fields = reading_fields(fleet.sensors[chosen.sensor].type)
    places = [fields.index(field) for field in chosen_fields(chosen.field, fields)]
    return [("faults", place, "numbers", _OF_FIELDS[name], i) for i in places] if name in _OF_FIELDS else []


def injectable_of(fleet: FleetSpec) -> InjectableSpec:
    """Return what of a fleet may be made to fail in flight; of all, what it has."""
    spec = fleet.injectable or InjectableSpec.model_validate({})
    if spec.sensors != [ALL]:
        return spec
    rotors = [rotor for rotor in spec.rotors if rotor < rotors_of(fleet)]
    battery = spec.battery and bool(known.BATTERIES[fleet.battery.type].drains)
    return spec.model_copy(update={"sensors": list(fleet.sensors), "rotors": rotors, "battery": battery})


def rotors_of(fleet: FleetSpec) -> int:
    """Return how many rotors a vehicle of a fleet has that could fail; 0 where its model has none of its own."""
    return len(fleet.vehicle.rotors) if issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor) else 0


def slots(
    fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec
) -> tuple[tuple[FaultSlot, ...], tuple[RotorFault, ...], BatteryFault | None]:
    """Build the slots of a fleet for faults of sensors, rotors and battery in flight, all empty."""
    spec, dt, count = injectable_of(fleet), scenario.time_step, len(fleet.vehicles)
    sensors = []
    for name in spec.sensors:
        fields = tuple(reading_fields(fleet.sensors[name].type))
        ticks = period_ticks(fleet.sensors[name].period, dt)
        sensors.append(
            empty_slot(
                count, name, fields, ticks, dt, min(MOST_READINGS, math.ceil(spec.delay_max / dt / ticks - 1e-6))
            )
        )
    broken = tuple(RotorFault.empty(count, rotor, _tick(NOTICED_S, dt)) for rotor in spec.rotors)
    return tuple(sensors), broken, BatteryFault.empty(count) if spec.battery else None


def _mask(names: tuple[str, ...], chosen: list[str] | None) -> Any:
    return np.array([chosen is None or name in chosen for name in names])


def reading_fields(sensor_type: str) -> list[str]:
    """Return the dotted names of what a type of sensor reports; none of one from outside whose step does not say it."""
    sensor: Any = known.SENSORS[sensor_type]
    says = sensor.init if sensor.step is Memoryless.step else sensor.step
    pair = typing.get_args(typing.get_type_hints(says).get("return"))
    if len(pair) != 2 or not dataclasses.is_dataclass(pair[1]):
        return []
    reading = pair[1]
    found: list[str] = []
    # What only some sensors of the type report has no value in the others.
    optional = {field.name for field in dataclasses.fields(reading) if field.default is None}
    for name, hint in typing.get_type_hints(reading).items():
        if name in optional:
            continue
        if typing.get_origin(hint) is tuple:
            # A fault is one of all its parts.
            hint = typing.get_args(hint)[0]
        if hint in (Vec3, Euler):
            found += [f"{name}.{field.name}" for field in dataclasses.fields(hint)]
        else:
            found.append(name)
    return found


def fault_problems(scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors in the faults of a scenario."""
    for fleet_name, fleet in scenario.fleets.items():
        for i, fault in enumerate(fleet.faults):
            path, names = f"fleets.{fleet_name}.faults.{i}", vehicle_names(fleet_name, fleet)
            yield from _name_problems(path, fault.vehicles, names)
            if isinstance(fault, RotorFaultSpec):
                yield from _rotor_problems(path, fault, fleet, scenario)
            else:
                yield from _time_problems(path, fault, scenario)
                yield from _problems(path, fault, fleet)
        rotors = {fault.rotor for fault in fleet.faults if isinstance(fault, RotorFaultSpec)}
        if len(rotors) > MOST_FAILED_ROTORS:
            yield f"fleets.{fleet_name}.faults: {len(rotors)} rotors fail; allowed: at most {MOST_FAILED_ROTORS}"
        yield from _injectable_problems(f"fleets.{fleet_name}.injectable", fleet)


def _injectable_problems(path: str, fleet: FleetSpec) -> Iterator[str]:
    """Yield what is wrong with what of a fleet may be made to fail in flight."""
    spec = injectable_of(fleet)
    for name in spec.sensors:
        if name not in fleet.sensors:
            yield f"{path}.sensors: no sensor is called '{name}'{did_you_mean(name, fleet.sensors)}"
    count = rotors_of(fleet)
    rotors = set(spec.rotors)
    broken = {fault.rotor for fault in fleet.faults if isinstance(fault, RotorFaultSpec)}
    if spec.rotors and not count:
        yield f"{path}.rotors: a '{fleet.vehicle.type}' has no rotors that could fail; a 'multirotor' has"
    elif rotors - set(range(count)):
        yield f"{path}.rotors: the vehicle has no rotor {max(rotors)}; allowed: 0 to {count - 1}"
    elif len(rotors | broken) > MOST_FAILED_ROTORS:
        yield f"{path}.rotors: {len(rotors | broken)} rotors may fail; allowed: at most {MOST_FAILED_ROTORS}"
    if spec.battery and not known.BATTERIES[fleet.battery.type].drains:
        yield f"{path}.battery: a battery of type '{fleet.battery.type}' has no charge that it could lose"


def _name_problems(path: str, chosen: list[str] | None, names: tuple[str, ...]) -> Iterator[str]:
    for name in chosen or []:
        if name not in names:
            yield f"{path}.vehicles: no vehicle of the fleet is called '{name}'{did_you_mean(name, names)}"


def _rotor_problems(path: str, fault: RotorFaultSpec, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield what is wrong with the fault of a rotor."""
    for name, seconds in (("at", fault.at), ("end", fault.end)):
        if seconds and not is_multiple(seconds, scenario.time_step, math.inf):
            yield f"{path}.{name}: {seconds:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from moment_problems(f"{path}.at", fault.at, scenario.duration)
    if fault.end is not None and fault.end <= fault.at:
        yield f"{path}.end: {fault.end:g} s is not after the start, {fault.at:g} s"
    if not issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor):
        yield f"{path}.type: a '{fleet.vehicle.type}' has no rotors that could fail; a 'multirotor' has"
    elif fault.rotor >= len(fleet.vehicle.rotors):
        last = len(fleet.vehicle.rotors) - 1
        yield f"{path}.rotor: the vehicle has no rotor {fault.rotor}; allowed: 0 to {last}"


def _time_problems(path: str, fault: FaultSpec, scenario: ScenarioSpec) -> Iterator[str]:
    for name, seconds in (("start", fault.start), ("end", fault.end)):
        # An end beyond all steps is that of the run.
        if seconds and not is_multiple(seconds, scenario.time_step, math.inf):
            yield f"{path}.{name}: {seconds:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from span_problems(path, fault.start, fault.end, scenario.duration)


def _problems(path: str, fault: FaultSpec, fleet: FleetSpec) -> Iterator[str]:
    if fault.sensor not in fleet.sensors:
        yield f"{path}.sensor: no sensor is called '{fault.sensor}'{did_you_mean(fault.sensor, fleet.sensors)}"
        return
    fields = reading_fields(fleet.sensors[fault.sensor].type)
    if TAKES[kind_of(fault.kind)].field and not fields:
        sensor = known.SENSORS[fleet.sensors[fault.sensor].type].__name__
        yield f"{path}.sensor: {sensor}.step does not declare its return type; expected '-> tuple[State, Reading]'"
        return
    for name, problem in number_problems(fault.kind, fault.field, _given(fault), fields):
        yield f"{path}.{name}: {problem}"
    period = fleet.sensors[fault.sensor].period
    if (fault.by or 0.0) > MOST_READINGS * period:
        yield f"{path}.by: {fault.by:g} s; allowed: at most {MOST_READINGS * period:g} s, {MOST_READINGS} readings"
