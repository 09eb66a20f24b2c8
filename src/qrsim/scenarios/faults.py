"""The faults of a scenario: checked against sensors, vehicles and readings, and built."""

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
from qrsim.models.sensors.faults import Fault
from qrsim.models.vehicles.faults import RotorFault
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.fault_schema import FaultSpec, RotorFaultSpec
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.spans import moment_problems, span_problems
from qrsim.scenarios.timing import is_multiple

LAST_TICK = 2**31 - 1
# An autopilot that looks at its motors' currents or speeds knows of a failed rotor after so long [s].
NOTICED_S = 0.1
# Rotors of a fleet that may fail; its mixer is prepared for every set of them.
MOST_FAILED_ROTORS = 4


def vehicle_names(fleet_name: str, fleet: FleetSpec) -> tuple[str, ...]:
    """Return the name of each vehicle of a fleet."""
    return tuple(vehicle.name or f"{fleet_name}_{i}" for i, vehicle in enumerate(fleet.vehicles))


def faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[Fault, ...]:
    """Build the faults of a fleet."""
    names = vehicle_names(fleet_name, fleet)

    def ticks(seconds: float | None) -> Any:
        if seconds is None:
            return np.array(LAST_TICK, np.int32)
        return np.array(min(round(seconds / scenario.time_step), LAST_TICK), np.int32)

    return tuple(
        Fault(
            start_tick=ticks(spec.start),
            end_tick=ticks(spec.end),
            affected=_mask(names, spec.vehicles),
            bias=_number(spec.bias),
            sensor=spec.sensor,
            kind=spec.kind,
            field=spec.field or "",
        )
        for spec in fleet.faults
        if isinstance(spec, FaultSpec)
    )


def rotor_faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[RotorFault, ...]:
    """Build the faults of a fleet's rotors."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = []
    for spec in fleet.faults:
        if isinstance(spec, RotorFaultSpec):
            ticks = [min(round(seconds / dt), LAST_TICK) for seconds in (spec.at, spec.at + NOTICED_S)]
            start, known_ = (np.array(tick, np.int32) for tick in ticks)
            found.append(
                record_of(RotorFault, start, known_, _mask(names, spec.vehicles), _number(spec.health), spec.rotor)
            )
    return tuple(found)


def _mask(names: tuple[str, ...], chosen: list[str] | None) -> Any:
    return np.array([chosen is None or name in chosen for name in names])


def _number(value: float | None) -> Any:
    return 0.0 if value is None else value


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


def _name_problems(path: str, chosen: list[str] | None, names: tuple[str, ...]) -> Iterator[str]:
    for name in chosen or []:
        if name not in names:
            yield f"{path}.vehicles: no vehicle of the fleet is called '{name}'{did_you_mean(name, names)}"


def _rotor_problems(path: str, fault: RotorFaultSpec, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield what is wrong with the fault of a rotor."""
    if not is_multiple(fault.at, scenario.time_step, math.inf):
        yield f"{path}.at: {fault.at:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from moment_problems(f"{path}.at", fault.at, scenario.duration)
    if not issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor):
        yield f"{path}.type: a '{fleet.vehicle.type}' has no rotors of its own that could fail; a 'multirotor' has"
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
    if fault.kind != "biased":
        for extra in ("field", "bias"):
            if getattr(fault, extra) is not None:
                yield f"{path}.{extra}: only for kind 'biased', not '{fault.kind}'"
        return
    fields = reading_fields(fleet.sensors[fault.sensor].type)
    if not fields:
        sensor = known.SENSORS[fleet.sensors[fault.sensor].type].__name__
        yield f"{path}.sensor: {sensor}.step does not say what it reports; expected '-> tuple[State, Reading]'"
        return
    if fault.bias is None:
        yield f"{path}.bias: missing; kind 'biased' needs it"
    if fault.field is None:
        yield f"{path}.field: missing; kind 'biased' needs one of {', '.join(fields)}"
    elif fault.field not in fields:
        yield f"{path}.field: the sensor does not report '{fault.field}'{did_you_mean(fault.field, fields)}"
