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
from qrsim.models.radio.faults import RadioFault
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
from qrsim.models.vehicles.faults import BatteryFault, Push, RotorFault
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.scenarios import catalogue as known
from qrsim.scenarios.components import component
from qrsim.scenarios.fault_schema import (
    ALL,
    MOST_FAILED_ROTORS,
    BatteryFaultSpec,
    FaultSpec,
    InjectableSpec,
    PushSpec,
    RadioFaultSpec,
    RotorFaultSpec,
)
from qrsim.scenarios.schema import FleetSpec, ScenarioSpec
from qrsim.scenarios.spans import moment_problems, span_problems
from qrsim.scenarios.timing import is_multiple
from qrsim.world.state import period_ticks

# An autopilot that looks at its motors' currents or speeds knows of a failed rotor after so long [s].
NOTICED_S = 0.1
# Readings that a delay keeps at most; each is part of what is compiled.
MOST_READINGS = 50


def vehicle_names(fleet_name: str, fleet: FleetSpec) -> tuple[str, ...]:
    """Return the names of all vehicles of a fleet."""
    return tuple(vehicle.name or f"{fleet_name}_{i}" for i, vehicle in enumerate(fleet.vehicles))


def faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[Fault, ...]:
    """Build the sensor faults of a fleet."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found, earlier = [], list[FaultSpec]()
    for spec in fleet.faults:
        if isinstance(spec, FaultSpec):
            fields = tuple(reading_fields(fleet.sensors[spec.sensor].type))
            chosen = chosen_fields(spec.field, fields)
            ticks = period_ticks(fleet.sensors[spec.sensor].period, dt)
            white = _white_noise(fleet, spec.sensor, scenario) if spec.times is not None else None
            numbers = fault_numbers(spec.kind, _numbers_given(spec), chosen, fields, dt, ticks, white)
            found.append(
                Fault(
                    start_tick=tick_of(spec.start, dt),
                    end_tick=tick_of(spec.end, dt),
                    affected=mask_of(names, spec.vehicles),
                    numbers=numbers,
                    sensor=spec.sensor,
                    kind=kind_of(spec.kind),
                    fields=fields,
                    ticks=ticks,
                    time_step=dt,
                    remembered=int(numbers.readings),
                    only=chosen,
                    order=sum(_draw_alike(spec, other) for other in earlier),
                )
            )
            earlier.append(spec)
    return tuple(found)


def _draw_alike(one: FaultSpec, other: FaultSpec) -> bool:
    """Return whether two sensor faults draw the same random numbers: equal sensor, kind, start, a vehicle in common."""
    shared = one.vehicles is None or other.vehicles is None or set(one.vehicles) & set(other.vehicles)
    return bool(shared) and (one.sensor, one.start, kind_of(one.kind)) == (
        other.sensor,
        other.start,
        kind_of(other.kind),
    )


def _white_noise(fleet: FleetSpec, sensor: str, scenario: ScenarioSpec) -> dict[str, Any]:
    """Return reading field -> white noise, as the sensor's class declares it."""
    return component(fleet.sensors[sensor], known.SENSORS, scenario).white_noise()


def _numbers_given(spec: FaultSpec) -> dict[str, float | None]:
    """Return the numbers of a sensor fault by name; None for each that the scenario leaves out."""
    return {name: getattr(spec, name) for name in NAMES}


def tick_of(seconds: float | None, dt: float) -> Any:
    """Convert a time [s] to ticks of ``dt`` [s], an int32 scalar array; None becomes a tick that never comes."""
    return np.array(LAST_TICK if seconds is None else min(round(seconds / dt), LAST_TICK), np.int32)


def rotor_faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[RotorFault, ...]:
    """Build the rotor faults of a fleet."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = []
    for spec in fleet.faults:
        if isinstance(spec, RotorFaultSpec):
            times = (tick_of(spec.at, dt), tick_of(NOTICED_S, dt), tick_of(spec.end, dt))
            # A stuck rotor keeps its speed, so its health has no effect.
            health = spec.health if spec.speed is None else 1.0
            fault = record_of(RotorFault, *times, mask_of(names, spec.vehicles), health, spec.rotor, speed=spec.speed)
            found.append(fault)
    return tuple(found)


def battery_faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[BatteryFault, ...]:
    """Build the battery faults of a fleet."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    found = []
    for spec in fleet.faults:
        if isinstance(spec, BatteryFaultSpec):
            left = (1.0 if spec.charge is None else spec.charge, 1.0 if spec.health is None else spec.health)
            times = (tick_of(spec.at, dt), tick_of(spec.end, dt))
            found.append(record_of(BatteryFault, *times, mask_of(names, spec.vehicles), *left))
    return tuple(found)


def radio_faults(fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec) -> tuple[RadioFault, ...]:
    """Build the radio faults of a fleet."""
    names, dt = vehicle_names(fleet_name, fleet), scenario.time_step
    return tuple(
        record_of(
            RadioFault,
            tick_of(spec.at, dt),
            tick_of(spec.end, dt),
            mask_of(names, spec.vehicles),
            np.array(spec.kind == "off"),
            spec.share or 0.0,
        )
        for spec in fleet.faults
        if isinstance(spec, RadioFaultSpec)
    )


# Of a fault's numbers, where a World has those that an episode may draw; times are ticks there.
_SENSOR_PATHS: dict[str, tuple[str, ...]] = {
    "start": ("start_tick",), "end": ("end_tick",), "limit": ("numbers", "limit"), "share": ("numbers", "share"),
}  # fmt: skip
_OF_FIELDS = {"bias": "amounts", "rate": "amounts", "std": "amounts", "range": "amounts", "scale": "scales"}
_OTHER_PATHS = {
    name: {"at": "start_tick", "end": "end_tick"} | {number: number for number in numbers}
    for name, numbers in (
        ("rotor_faults", ("health", "speed")),
        ("battery_faults", ("charge", "health")),
        ("radio_faults", ("share",)),
        ("pushes", ()),
    )
}
_OTHER_PLACES: dict[type, str] = {
    RotorFaultSpec: "rotor_faults",
    BatteryFaultSpec: "battery_faults",
    RadioFaultSpec: "radio_faults",
    PushSpec: "pushes",
}
TIMES = ("start", "end", "at")


def drawn_paths(fleet: FleetSpec, number: int, name: str) -> list[tuple[str | int, ...]]:
    """Return the paths in a ``Fleet`` at which episodes may draw parameter ``name`` of a fault; [] if none may."""
    chosen = fleet.faults[number]
    place = sum(isinstance(fault, type(chosen)) for fault in fleet.faults[:number])
    if not isinstance(chosen, FaultSpec):
        where = _OTHER_PLACES[type(chosen)]
        return [(where, place, _OTHER_PATHS[where][name])] if name in _OTHER_PATHS[where] else []
    if name in _SENSOR_PATHS:
        return [("faults", place, *_SENSOR_PATHS[name])]
    fields = reading_fields(fleet.sensors[chosen.sensor].type)
    places = [fields.index(field) for field in chosen_fields(chosen.field, fields)]
    return [("faults", place, "numbers", _OF_FIELDS[name], i) for i in places] if name in _OF_FIELDS else []


def injectable_of(fleet: FleetSpec, has_radio: bool = True) -> InjectableSpec:
    """Return the parts of a fleet's vehicles that may fail in flight, all that can if the scenario has "all".

    Without ``has_radio``, whether the world has a radio, no radio is among them.
    """
    spec = fleet.injectable or InjectableSpec.model_validate({})
    if spec.sensors != [ALL]:
        return spec
    rotors = [rotor for rotor in spec.rotors if rotor < rotors_of(fleet)]
    battery = spec.battery and bool(known.BATTERIES[fleet.battery.type].drains)
    radio = spec.radio and has_radio and (fleet.radio is None or fleet.radio.works)
    body = spec.body and is_pushable(fleet)
    parts = {"sensors": list(fleet.sensors), "rotors": rotors, "battery": battery, "radio": radio, "body": body}
    return spec.model_copy(update=parts)


def is_pushable(fleet: FleetSpec) -> bool:
    """Return whether external pushes can act on the vehicles of a fleet."""
    return bool(known.VEHICLES[fleet.vehicle.type].pushable)


def rotors_of(fleet: FleetSpec) -> int:
    """Return how many rotors of a fleet's vehicle can fail; 0 for a vehicle model without separate rotors."""
    return len(fleet.vehicle.rotors) if issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor) else 0


def slots(
    fleet_name: str, fleet: FleetSpec, scenario: ScenarioSpec
) -> tuple[tuple[FaultSlot, ...], tuple[RotorFault, ...], BatteryFault | None, RadioFault | None, Push | None]:
    """Build a fleet's empty slots for faults injected in flight: (sensors, rotors, battery, radio, push)."""
    spec = injectable_of(fleet, scenario.world.radio is not None)
    dt, count = scenario.time_step, len(fleet.vehicles)
    sensors = []
    for name in spec.sensors:
        fields = tuple(reading_fields(fleet.sensors[name].type))
        ticks = period_ticks(fleet.sensors[name].period, dt)
        sensors.append(
            empty_slot(
                count, name, fields, ticks, dt, min(MOST_READINGS, math.ceil(spec.delay_max / dt / ticks - 1e-6))
            )
        )
    broken = tuple(RotorFault.empty(count, rotor, tick_of(NOTICED_S, dt)) for rotor in spec.rotors)
    battery = BatteryFault.empty(count) if spec.battery else None
    radio, push = RadioFault.empty(count) if spec.radio else None, Push.empty(count) if spec.body else None
    return tuple(sensors), broken, battery, radio, push


def mask_of(names: tuple[str, ...], chosen: list[str] | None) -> Any:
    """Return a bool array (n,) that marks the ``chosen`` ones of all vehicle names; all True for None."""
    return np.array([chosen is None or name in chosen for name in names])


def reading_fields(sensor_type: str) -> list[str]:
    """Return dotted field names of the reading of a sensor type; [] if its ``step`` has no return annotation."""
    sensor = known.SENSORS[sensor_type]
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
    """Yield the errors in the faults of a scenario's fleets."""
    for fleet_name, fleet in scenario.fleets.items():
        for i, fault in enumerate(fleet.faults):
            path, names = f"fleets.{fleet_name}.faults.{i}", vehicle_names(fleet_name, fleet)
            yield from _vehicle_problems(path, fault.vehicles, names)
            if isinstance(fault, RotorFaultSpec):
                yield from _moment_problems(path, fault, scenario)
                yield from _rotor_problems(path, fault, fleet)
            elif isinstance(fault, BatteryFaultSpec):
                yield from _moment_problems(path, fault, scenario)
                yield from _battery_problems(path, fault, fleet)
            elif isinstance(fault, RadioFaultSpec):
                yield from _moment_problems(path, fault, scenario)
                yield from _radio_problems(f"{path}.type", fleet, scenario)
            elif isinstance(fault, PushSpec):
                yield from _moment_problems(path, fault, scenario)
                yield from push_problems(path, f"{path}.type", fault, fleet)
            else:
                yield from _span_problems(path, fault, scenario)
                yield from _sensor_fault_problems(path, fault, fleet, scenario)
        rotors = {fault.rotor for fault in fleet.faults if isinstance(fault, RotorFaultSpec)}
        if len(rotors) > MOST_FAILED_ROTORS:
            yield f"fleets.{fleet_name}.faults: {len(rotors)} rotors fail; allowed: at most {MOST_FAILED_ROTORS}"
        yield from _injectable_problems(f"fleets.{fleet_name}.injectable", fleet, scenario)


def _radio_problems(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield an error for a radio fault of a fleet that has no radio it can act on."""
    if scenario.world.radio is None:
        yield f"{path}: there is no world.radio that could fail"
    elif fleet.radio is not None and not fleet.radio.works:
        yield f"{path}: the fleet has no radio that could fail (radio: none)"


def push_problems(path: str, where: str, push: Any, fleet: FleetSpec) -> Iterator[str]:
    """Yield an error for a push that a fleet's vehicles cannot get; ``where`` is the path that chose the vehicles."""
    if not is_pushable(fleet):
        yield f"{where}: a '{fleet.vehicle.type}' cannot be pushed"
    if push.acceleration_ned is None and push.acceleration_body is None:
        yield f"{path}.acceleration_ned: missing; a push needs it, or acceleration_body"


def _injectable_problems(path: str, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a fleet's ``injectable``: parts that its vehicles lack, or too many rotors."""
    spec = injectable_of(fleet, scenario.world.radio is not None)
    if spec.radio:
        yield from _radio_problems(f"{path}.radio", fleet, scenario)
    if spec.body and not is_pushable(fleet):
        yield f"{path}.body: a '{fleet.vehicle.type}' cannot be pushed"
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


def _vehicle_problems(path: str, chosen: list[str] | None, names: tuple[str, ...]) -> Iterator[str]:
    """Yield an error for each chosen name that is not a vehicle of the fleet; ``names`` are the fleet's."""
    for name in chosen or []:
        if name not in names:
            yield f"{path}.vehicles: no vehicle of the fleet is called '{name}'{did_you_mean(name, names)}"


def _moment_problems(
    path: str, fault: RotorFaultSpec | BatteryFaultSpec | RadioFaultSpec | PushSpec, scenario: ScenarioSpec
) -> Iterator[str]:
    """Yield the errors in the times ``at`` and ``end`` of a push, or of a rotor, battery or radio fault."""
    for name, seconds in (("at", fault.at), ("end", fault.end)):
        if seconds and not is_multiple(seconds, scenario.time_step, math.inf):
            yield f"{path}.{name}: {seconds:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from moment_problems(f"{path}.at", fault.at, scenario.duration)
    if fault.end is not None and fault.end <= fault.at:
        yield f"{path}.end: {fault.end:g} s is not after the start, {fault.at:g} s"


def _battery_problems(path: str, fault: BatteryFaultSpec, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a battery fault."""
    if not known.BATTERIES[fleet.battery.type].drains:
        yield f"{path}.type: a battery of type '{fleet.battery.type}' has no charge that it could lose"
    if fault.charge is None and fault.health is None:
        yield f"{path}.charge: missing; a fault of a battery needs it, or health"
    if fault.end is not None and fault.health is None:
        yield f"{path}.end: only with health; a charge that is lost does not come back"


def _rotor_problems(path: str, fault: RotorFaultSpec, fleet: FleetSpec) -> Iterator[str]:
    """Yield the errors of a rotor fault."""
    if fault.speed is not None and fault.health > 0.0:
        yield f"{path}.health: a rotor that is stuck at a speed has none"
    if not issubclass(known.VEHICLES[fleet.vehicle.type], Multirotor):
        yield f"{path}.type: a '{fleet.vehicle.type}' has no rotors that could fail; a 'multirotor' has"
    elif fault.rotor >= len(fleet.vehicle.rotors):
        last = len(fleet.vehicle.rotors) - 1
        yield f"{path}.rotor: the vehicle has no rotor {fault.rotor}; allowed: 0 to {last}"


def _span_problems(path: str, fault: FaultSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the problems of a sensor fault's start and end: off the time step, or outside the run."""
    for name, seconds in (("start", fault.start), ("end", fault.end)):
        # An end beyond all steps is that of the run.
        if seconds and not is_multiple(seconds, scenario.time_step, math.inf):
            yield f"{path}.{name}: {seconds:g} s is not a multiple of the time step {scenario.time_step:g} s"
    yield from span_problems(path, fault.start, fault.end, scenario.duration)


def _sensor_fault_problems(path: str, fault: FaultSpec, fleet: FleetSpec, scenario: ScenarioSpec) -> Iterator[str]:
    """Yield the errors of a sensor fault: its sensor, kind and parameters."""
    if fault.sensor not in fleet.sensors:
        yield f"{path}.sensor: no sensor is called '{fault.sensor}'{did_you_mean(fault.sensor, fleet.sensors)}"
        return
    fields = reading_fields(fleet.sensors[fault.sensor].type)
    if TAKES[kind_of(fault.kind)].field and not fields:
        sensor = known.SENSORS[fleet.sensors[fault.sensor].type].__name__
        yield f"{path}.sensor: {sensor}.step does not declare its return type; expected '-> tuple[State, Reading]'"
        return
    white = _white_noise(fleet, fault.sensor, scenario) if fault.times is not None else None
    for name, problem in number_problems(fault.kind, fault.field, _numbers_given(fault), fields, white):
        yield f"{path}.{name}: {problem}"
    period = fleet.sensors[fault.sensor].period
    if (fault.by or 0.0) > MOST_READINGS * period:
        yield f"{path}.by: {fault.by:g} s; allowed: at most {MOST_READINGS * period:g} s, {MOST_READINGS} readings"
