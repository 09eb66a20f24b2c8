"""Faults of rotors and batteries at given times."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import parameter, quantity, record, record_of, replace, setting

LAST_TICK = 2**31 - 1


@record
class RotorFault:
    """One rotor of some vehicles (n,) of a fleet that turns slower than it is told, or stands still."""

    start_tick: Array = quantity(doc="() or (n,) int32 first tick of the fault")
    noticed_ticks: Array = quantity(doc="() int32 ticks after which the autopilot responds to it")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    health: Array = parameter(unit="1", doc="share of its speed that the rotor still reaches; 0: it stops")
    rotor: int = setting(doc="number of the rotor, from 0")

    @staticmethod
    def empty(count: int, rotor: int, noticed_ticks: Any) -> RotorFault:
        """Return that of a rotor of ``count`` vehicles in which nothing is wrong."""
        never, nobody = np.full(count, LAST_TICK, np.int32), np.zeros(count, bool)
        return record_of(RotorFault, never, noticed_ticks, never, nobody, np.ones(count), rotor)


@record
class BatteryFault:
    """A battery that loses charge at once, of some vehicles (n,) of a fleet."""

    start_tick: Array = quantity(doc="(n,) int32 tick at which it happens")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    charge: Array = parameter(unit="1", doc="remaining share of a full charge", minimum=0.0, maximum=1.0)

    @staticmethod
    def empty(count: int) -> BatteryFault:
        """Return that of ``count`` vehicles in which nothing is wrong."""
        return record_of(BatteryFault, np.full(count, LAST_TICK, np.int32), np.zeros(count, bool), np.zeros(count))

    def apply(self, battery: Any, tick: Array) -> Any:
        """Return the state of batteries with a ``charge`` (n,) after a tick."""
        happens = self.affected & (tick == self.start_tick)
        return replace(battery, charge=jnp.where(happens, jnp.minimum(self.charge, battery.charge), battery.charge))


def failed_rotors(faults: tuple[RotorFault, ...], tick: Array) -> tuple[tuple[int, Array, Array], ...]:
    """Return, of each rotor that a fault may concern, its number, its health (n,) and whether that is known (n,)."""
    found: dict[int, tuple[Array, Array]] = {}
    for fault in faults:
        lasts = fault.affected & (tick < fault.end_tick)
        left = jnp.where(lasts & (tick >= fault.start_tick), fault.health, 1.0)
        known = lasts & (tick - fault.noticed_ticks >= fault.start_tick)
        if fault.rotor in found:
            before, knew = found[fault.rotor]
            left, known = jnp.minimum(before, left), known | knew
        found[fault.rotor] = (left, known)
    return tuple((number, left, known) for number, (left, known) in sorted(found.items()))
