"""Faults of rotors, batteries and radios, and pushes, written into the slots of a fleet.

Each function returns a slot in which the ``chosen`` vehicles (n,) bool have a fault of a kind, or none for kind ``ok``.
It begins at the first of two ``ticks`` and ends before the second. A kind or number that does not suit is a UsageError.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import map_tree, replace
from qrsim.core.vectors import Vec3
from qrsim.models.radio.faults import RadioFault
from qrsim.models.vehicles.fault_numbers import PUSH, number_of, push_numbers
from qrsim.models.vehicles.faults import FREE, BatteryFault, Push, RotorFault


def rotor_fault_in(
    slot: RotorFault, kind: str, chosen: NumpyArray, ticks: tuple[int, int], numbers: Mapping[str, object]
) -> RotorFault:
    """Return ``slot``, the parameters of an injected rotor fault, with a fault in the ``chosen`` vehicles, (n,) bool,
    during ``ticks``."""
    if kind == "ok":
        empty = replace(RotorFault.empty(len(chosen), slot.rotor, slot.noticed_ticks), noticed_ticks=slot.noticed_ticks)
        return map_tree(lambda old, new: put(old, chosen, new[chosen]) if np.ndim(old) else old, slot, empty)
    number = number_of("rotor", kind, numbers)
    return replace(
        slot,
        start_tick=put(slot.start_tick, chosen, ticks[0]),
        end_tick=put(slot.end_tick, chosen, ticks[1]),
        affected=slot.affected | chosen,
        # A stuck rotor keeps its speed, so its health has no effect.
        health=put(slot.health, chosen, 1.0 if kind == "stuck" else number),
        speed=put(slot.speed, chosen, number if kind == "stuck" else FREE),
    )


def radio_fault_in(
    slot: RadioFault, kind: str, chosen: NumpyArray, ticks: tuple[int, int], numbers: Mapping[str, object]
) -> RadioFault:
    """Return ``slot``, the parameters of an injected radio fault, with a fault in the ``chosen`` vehicles, (n,) bool,
    during ``ticks``."""
    if kind == "ok":
        return map_tree(lambda old, new: put(old, chosen, new[chosen]), slot, RadioFault.empty(len(chosen)))
    share = number_of("radio", kind, numbers)
    return replace(
        slot,
        start_tick=put(slot.start_tick, chosen, ticks[0]),
        end_tick=put(slot.end_tick, chosen, ticks[1]),
        affected=slot.affected | chosen,
        off=put(slot.off, chosen, kind == "off"),
        share=put(slot.share, chosen, share),
    )


def push_in(slot: Push, kind: str, chosen: NumpyArray, ticks: tuple[int, int], numbers: Mapping[str, object]) -> Push:
    """Return ``slot``, the parameters of an injected push, with a push of the ``chosen`` vehicles, (n,) bool, during
    ``ticks``."""
    if kind == "ok":
        return map_tree(lambda old, new: put(old, chosen, new[chosen]), slot, Push.empty(len(chosen)))
    found = push_numbers(kind, numbers)
    ned, body = (Vec3(*found.get(name, (0.0,) * 3)) for name in PUSH)
    return replace(
        slot,
        start_tick=put(slot.start_tick, chosen, ticks[0]),
        end_tick=put(slot.end_tick, chosen, ticks[1]),
        affected=slot.affected | chosen,
        ned=map_tree(lambda old, new: put(old, chosen, new), slot.ned, ned),
        body=map_tree(lambda old, new: put(old, chosen, new), slot.body, body),
    )


def battery_fault_in(
    slot: BatteryFault, kind: str, chosen: NumpyArray, ticks: tuple[int, int], numbers: Mapping[str, object]
) -> BatteryFault:
    """Return ``slot``, the parameters of an injected battery fault, with a fault in the ``chosen`` vehicles, (n,) bool,
    during ``ticks``."""
    if kind == "ok":
        return map_tree(lambda old, new: put(old, chosen, new[chosen]), slot, BatteryFault.empty(len(chosen)))
    number = number_of("battery", kind, numbers)
    return replace(
        slot,
        start_tick=put(slot.start_tick, chosen, ticks[0]),
        end_tick=put(slot.end_tick, chosen, ticks[1]),
        affected=slot.affected | chosen,
        charge=put(slot.charge, chosen, number if kind == "drop" else 1.0),
        health=put(slot.health, chosen, 1.0 if kind == "drop" else number),
    )


def put(array: object, chosen: NumpyArray, value: object) -> Any:
    """Return a copy of an array (n,) with ``value`` at the ``chosen`` elements, (n,) bool."""
    changed = np.array(array)
    changed[chosen] = value
    return changed
