"""Faults injected in flight: requests, checked against the slots of a world and written into them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray, is_number
from qrsim.core.tables import Table, Tabled
from qrsim.core.tree import cast, map_tree, replace
from qrsim.errors import UsageError, did_you_mean
from qrsim.models.radio.faults import RadioFault
from qrsim.models.sensors.fault_numbers import (
    NAMES,
    OF_FIELDS,
    chosen_fields,
    empty_slot,
    fault_numbers,
    kind_of,
    number_problems,
)
from qrsim.models.sensors.faults import KINDS, LAST_TICK, OLD_NAMES, FaultNumbers, FaultSlot
from qrsim.models.vehicles.fault_numbers import number_of
from qrsim.models.vehicles.faults import BatteryFault, Push, RotorFault
from qrsim.models.vehicles.multirotor import Multirotor
from qrsim.simulation.part_slots import battery_fault_in, push_in, put, radio_fault_in, rotor_fault_in
from qrsim.world.state import Fleet, World

# What may be injected in one tick.
MOST_AT_ONCE = 64
# Target of what is changed for all, and the kind that ends a fault.
WORLD, OK = "world", "ok"
# The link of a vehicle to MAVLink and ROS 2. It is no part of the world, so it needs no slot.
LINK = "link"
# What a push acts on.
BODY = "body"
# Targets that are no sensors, so that no sensor can have these names, nor that of a rotor.
TARGETS = ("battery", "radio", BODY, LINK, WORLD)


@dataclass(frozen=True)
class Injection:
    """A fault that was injected, or another request of a flight: one that ends faults, or changes the world.

    Attributes:
        id: number of the fault, from 1; 0 for other requests.
        target: sensor, ``rotor N``, ``battery``, ``radio``, ``body``, ``link`` or ``world``.
        kind: kind of the fault; ``ok`` ends faults.
        vehicles: names; empty for the world.
        start_tick, end_tick: first tick of the fault, and first tick after it.
        numbers: of the fault by name, with its ``field``.
        asked_by: name of the client that made the request.
        tick: tick of the request.
    """

    id: int
    target: str
    kind: str
    vehicles: tuple[str, ...]
    start_tick: int
    end_tick: int
    numbers: Mapping[str, Any] = field(default_factory=dict)
    asked_by: str = "python"
    tick: int = 0

    @property
    def counts(self) -> tuple[int, ...]:
        """Number, first tick and last tick of the injection, and the tick at which it was requested."""
        return self.id, self.start_tick, self.end_tick, self.tick


class Injected(Tabled, tuple[Injection, ...]):
    """The injections that are there, or to come, as a table."""

    def __new__(cls, injections: Sequence[Injection], time_step: float) -> Injected:
        """Make the table; ``time_step`` [s]."""
        made = super().__new__(cls, injections)
        made.time_step = time_step
        return made

    time_step: float

    def __getnewargs__(self) -> tuple[object, ...]:
        return tuple(self), self.time_step

    def _table(self) -> Table:
        """Return the injections as a table for display, one in a row."""

        def seconds(tick: int) -> str:
            """Convert a tick to a time [s] as text; "" for the end of an injection that never ends."""
            return f"{tick * self.time_step:g} s" if tick < LAST_TICK else ""

        rows = [
            (
                str(one.id),
                one.target,
                one.kind,
                ", ".join(one.vehicles),
                seconds(one.start_tick),
                seconds(one.end_tick),
                ", ".join(f"{name} {value}" for name, value in one.numbers.items()),
            )
            for one in self
        ]
        return Table(
            f"{len(self)} injected faults", ("id", "target", "kind", "vehicles", "from", "to", "numbers"), rows
        )


def injected(
    world: World,
    target: str,
    kind: str,
    vehicles: Sequence[str] | None,
    ticks: tuple[int, int],
    numbers: Mapping[str, Any],
) -> tuple[World, tuple[str, ...]]:
    """Return a world with a fault of ``target`` injected from ``ticks[0]`` to ``ticks[1]``, and the names of the
    affected vehicles.

    Args:
        world: its parameters, on the host.
        target: sensor, ``rotor N``, ``battery``, ``radio``, ``body`` or ``link``.
        kind: what happens to it; ``ok``: no fault any more.
        vehicles: names, of ``named_vehicles``; None: all that have the target in a slot.
        ticks: first tick of the fault, and first tick after it.
        numbers: how large it is, and ``field``.

    Raises:
        UsageError: it cannot be injected; nothing has changed.
    """
    if kind == OK and numbers:
        raise UsageError(f"{next(iter(numbers)):.60}: kind 'ok' takes no numbers")
    if target == LINK:
        return world, _linked(world, kind, vehicles, numbers)
    if target == "radio" and world.radio is None and not any(_slot(fleet, target) for fleet in world.fleets):
        raise UsageError("target: there is no radio; give world.radio of the scenario")
    fleets, concerned, named = list(world.fleets), [], set(vehicles or ())
    for place, fleet in enumerate(world.fleets):
        chosen = np.array([vehicles is None or name in named for name in fleet.vehicle_names])
        if not chosen.any() or (vehicles is None and not _slot(fleet, target)):
            continue
        fleets[place] = _with_fault(fleet, target, kind, chosen, ticks, numbers, world.time_step)
        concerned += [name for name, has in zip(fleet.vehicle_names, chosen, strict=True) if has]
    if not concerned:
        raise _not_injectable(world.fleets, target)
    return replace(world, fleets=tuple(fleets)), tuple(concerned)


def _linked(world: World, kind: str, vehicles: Sequence[str] | None, numbers: Mapping[str, object]) -> tuple[str, ...]:
    """Return the names of the vehicles that a loss of links affects; raises UsageError for wrong numbers of the
    fault."""
    if kind != OK:
        number_of(LINK, kind, numbers)
    return tuple(name for fleet in world.fleets for name in fleet.vehicle_names if vehicles is None or name in vehicles)


def named_vehicles(world: World, vehicles: Iterable[str] | str | None) -> list[str] | None:
    """Return vehicle names as a list, from one name or several, None for None (all); raises UsageError for unknown
    names.

    Raises:
        UsageError: there is no vehicle of that name, or no name.
    """
    if vehicles is None:
        return None
    names = [vehicles] if isinstance(vehicles, str) or not isinstance(vehicles, Iterable) else list(vehicles)
    for name in names:
        if not isinstance(name, str):
            raise UsageError(f"vehicles: {name!r:.60}; allowed: names")
    # A dict, because a thousand names are looked up.
    everybody = dict.fromkeys(name for fleet in world.fleets for name in fleet.vehicle_names)
    if not names:
        raise UsageError("vehicles: none is named; None is all")
    for name in names:
        if name not in everybody:
            raise UsageError(f"vehicles: no vehicle is called '{name:.60}'{did_you_mean(name, everybody)}")
    return names


def without_faults(world: World) -> World:
    """Return a world without injected faults."""
    fleets = []
    for fleet in world.fleets:
        n, dtype = fleet.size, np.asarray(fleet.start.position_ned.x).dtype
        sensors = tuple(
            empty_slot(n, slot.sensor, slot.fields, slot.ticks, slot.time_step, slot.remembered)
            for slot in fleet.fault_slots
        )
        rotors = tuple(RotorFault.empty(n, slot.rotor, slot.noticed_ticks) for slot in fleet.rotor_slots)
        battery = None if fleet.battery_slot is None else BatteryFault.empty(n)
        radio = None if fleet.radio_slot is None else RadioFault.empty(n)
        push = None if fleet.push_slot is None else Push.empty(n)
        slots = {"fault_slots": sensors, "rotor_slots": rotors, "battery_slot": battery, "radio_slot": radio}
        fleets.append(replace(fleet, **cast(slots | {"push_slot": push}, dtype)))
    return replace(world, fleets=tuple(fleets))


def targets_of(fleet: Fleet) -> list[str]:
    """Return the names of a fleet's sensors and parts in which faults can be injected."""
    rotors = [f"rotor {slot.rotor}" for slot in fleet.rotor_slots]
    others = {"battery": fleet.battery_slot, "radio": fleet.radio_slot, BODY: fleet.push_slot}
    sensors = [slot.sensor for slot in fleet.fault_slots]
    return sensors + rotors + [name for name, slot in others.items() if slot is not None]


def _slot(fleet: Fleet, target: str) -> bool:
    """Return whether faults of a target (sensor or part) can be injected in a fleet."""
    return plain_target(target) in targets_of(fleet)


def plain_target(target: str) -> str:
    """Return a target's name with a space before its number: ``rotor_2`` becomes ``rotor 2``."""
    return target.replace("_", " ") if target.startswith("rotor_") else target


def _not_injectable(fleets: Sequence[Fleet], target: str) -> UsageError:
    """Return the error for a target in which no fault can be injected, with the scenario line that allows it."""
    known = sorted({name for fleet in fleets for name in targets_of(fleet)})
    if target == "battery" and not any(fleet.battery.drains for fleet in fleets):
        return UsageError("target: there is no battery that drains, so none can lose charge")
    if target == BODY and not any(fleet.vehicle.pushable for fleet in fleets):
        return UsageError("target: no vehicle here can be pushed; one of type 'fixed_point' cannot")
    if target.startswith("rotor ") and not any(isinstance(fleet.vehicle, Multirotor) for fleet in fleets):
        return UsageError(f"target: there is no '{target:.60}'; only a 'multirotor' has rotors of its own")
    having = [fleet.name for fleet in fleets if target in _parts(fleet)]
    if having:
        part = f"{target}: true" if target in ("battery", "radio", BODY) else f"sensors: [{target}]"
        part = "rotors: all" if target.startswith("rotor ") else part
        return UsageError(
            f"target: '{target}' is not injectable; write 'injectable: {{{part}}}' under fleets.{having[0]} of the "
            "scenario, or give the command --injectable"
        )
    there = sorted({name for fleet in fleets for name in (*_parts(fleet), LINK)})
    return UsageError(f"target: there is no '{target:.60}'{did_you_mean(target, known or there)}")


def _parts(fleet: Fleet) -> list[str]:
    """Return the names of a fleet's parts that its scenario may declare injectable."""
    rotors = range(len(fleet.vehicle.rotors)) if isinstance(fleet.vehicle, Multirotor) else ()
    others = {"battery": fleet.battery.drains, "radio": True, BODY: fleet.vehicle.pushable}
    return [*fleet.sensor_names, *(f"rotor {i}" for i in rotors), *(name for name, has in others.items() if has)]


def _with_fault(
    fleet: Fleet,
    target: str,
    kind: str,
    chosen: NumpyArray,
    ticks: tuple[int, int],
    numbers: Mapping[str, object],
    dt: float,
) -> Fleet:
    """Return a fleet with a fault of a target in the ``chosen`` vehicles, (n,) bool, from ``ticks[0]`` to ``ticks[1]``;
    ``dt`` [s]."""
    target = plain_target(target)
    for place, slot in enumerate(fleet.fault_slots):
        if slot.sensor == target:
            white = fleet.sensors[fleet.sensor_names.index(target)].white_noise()
            changed = _sensor_fault(slot, kind, chosen, ticks, numbers, dt, white)
            return replace(fleet, fault_slots=_swapped(fleet.fault_slots, place, changed))
    for place, rotor in enumerate(fleet.rotor_slots):
        if target == f"rotor {rotor.rotor}":
            broken = rotor_fault_in(rotor, kind, chosen, ticks, numbers)
            return replace(fleet, rotor_slots=_swapped(fleet.rotor_slots, place, broken))
    if target == "battery" and fleet.battery_slot is not None:
        return replace(fleet, battery_slot=battery_fault_in(fleet.battery_slot, kind, chosen, ticks, numbers))
    if target == "radio" and fleet.radio_slot is not None:
        return replace(fleet, radio_slot=radio_fault_in(fleet.radio_slot, kind, chosen, ticks, numbers))
    if target == BODY and fleet.push_slot is not None:
        return replace(fleet, push_slot=push_in(fleet.push_slot, kind, chosen, ticks, numbers))
    raise _not_injectable([fleet], target)


def _swapped(parts: tuple[object, ...], place: int, part: object) -> tuple[object, ...]:
    """Return a tuple with the element at index ``place`` replaced by ``part``."""
    return (*parts[:place], part, *parts[place + 1 :])


def _sensor_fault(
    slot: FaultSlot,
    kind: str,
    chosen: NumpyArray,
    ticks: tuple[int, int],
    numbers: Mapping[str, Any],
    dt: float,
    white: Mapping[str, Any] | None = None,
) -> FaultSlot:
    """Return ``slot``, the parameters of a sensor's injected fault, with a fault in the ``chosen`` vehicles, (n,) bool;
    "ok" removes it."""
    if kind == "ok":
        empty = empty_slot(len(chosen), slot.sensor, slot.fields, slot.ticks, slot.time_step, slot.remembered)
        return map_tree(lambda old, new: put(old, chosen, new[chosen]), slot, empty)
    if kind not in KINDS and kind not in OLD_NAMES:
        raise UsageError(f"kind: '{kind:.60}' is not known{did_you_mean(kind, KINDS)}")
    asked = _of_fields(slot, kind, numbers, dt, white)
    return replace(
        slot,
        start_tick=put(slot.start_tick, chosen, ticks[0]),
        end_tick=put(slot.end_tick, chosen, ticks[1]),
        affected=slot.affected | chosen,
        kinds=put(slot.kinds, chosen, KINDS.index(kind_of(kind))),
        numbers=map_tree(lambda old, new: put(old, chosen, new), slot.numbers, asked),
    )


def _of_fields(
    slot: FaultSlot, kind: str, numbers: Mapping[str, object], dt: float, white: Mapping[str, object] | None
) -> FaultNumbers:
    """Check a fault's numbers, some of them given for each field by name; return them as arrays; raises UsageError."""
    apart = {name: value for name, value in numbers.items() if isinstance(value, Mapping)}
    if not any(apart.values()):
        return _checked(slot, kind, numbers, dt, white)
    if "field" in numbers:
        raise UsageError(f"field: {', '.join(apart)} already names fields")
    common = {name: value for name, value in numbers.items() if name not in apart}
    fields: dict[str, dict[str, object]] = {}
    for name, value in apart.items():
        if name in NAMES and name not in OF_FIELDS:
            raise UsageError(f"{name}: {value!r:.60}; allowed: a number, which all fields share")
        for key, number in value.items():
            # What is no field is refused with the numbers.
            for one in chosen_fields(str(key), slot.fields) or (str(key),):
                own = fields.setdefault(one, {})
                if name in own:
                    raise UsageError(f"{name}: '{one}' is given twice")
                own[name] = number
    found = {one: _checked(slot, kind, {**common, **own, "field": one}, dt, white) for one, own in fields.items()}
    first, places = next(iter(found.values())), {one: slot.fields.index(one) for one in found}
    amounts, scales = list(first.amounts), list(first.scales)
    for one, part in found.items():
        amounts[places[one]], scales[places[one]] = part.amounts[places[one]], part.scales[places[one]]
    return replace(first, amounts=tuple(amounts), scales=tuple(scales))


def _checked(
    slot: FaultSlot, kind: str, numbers: Mapping[str, Any], dt: float, white: Mapping[str, Any] | None
) -> FaultNumbers:
    """Check a fault's numbers, each a single one; return them as arrays; raises UsageError for wrong ones."""
    for name in numbers:
        if name not in (*NAMES, "field"):
            raise UsageError(f"{name:.60}: there is no such number{did_you_mean(name, (*NAMES, 'field'))}")
    for name, value in numbers.items():
        if not isinstance(value, str) if name == "field" else not is_number(value):
            raise UsageError(f"{name}: {value!r:.60}; allowed: {'a text' if name == 'field' else 'a number'}")
    given = {name: value for name, value in numbers.items() if name != "field"}
    part = numbers.get("field")
    for name, problem in number_problems(kind, part, given, slot.fields, white):
        raise UsageError(f"{name}: {problem}")
    late = given.get("by", 0.0)
    if late > slot.remembered * slot.ticks * dt + 1e-9:
        raise UsageError(
            f"by: {late:g} s; allowed: at most {slot.remembered * slot.ticks * dt:g} s, "
            "injectable.delay_max of the scenario"
        )
    return fault_numbers(kind, given, chosen_fields(part, slot.fields), slot.fields, dt, slot.ticks, white)
