"""Faults of rotors at given times."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.tree import parameter, quantity, record, setting


@record
class RotorFault:
    """One rotor of some vehicles (n,) of a fleet that turns slower than it is told, or stands still."""

    start_tick: Array = quantity(doc="() int32 first tick of the fault")
    known_tick: Array = quantity(doc="() int32 first tick at which the autopilot knows of it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    health: Array = parameter(unit="1", doc="the part of its speed that the rotor still reaches; 0: it stands still")
    rotor: int = setting(doc="number of the rotor, from 0")


def failed_rotors(faults: tuple[RotorFault, ...], tick: Array) -> tuple[tuple[int, Array, Array], ...]:
    """Return, of each rotor that a fault may concern, its number, its health (n,) and whether that is known (n,)."""
    found: dict[int, tuple[Array, Array]] = {}
    for fault in faults:
        failed = fault.affected & (tick >= fault.start_tick)
        left = jnp.where(failed, fault.health, 1.0)
        known = fault.affected & (tick >= fault.known_tick)
        if fault.rotor in found:
            before, knew = found[fault.rotor]
            left, known = jnp.minimum(before, left), known | knew
        found[fault.rotor] = (left, known)
    return tuple((number, left, known) for number, (left, known) in sorted(found.items()))
