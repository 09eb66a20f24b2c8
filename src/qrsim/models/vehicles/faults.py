"""Faults of rotors and batteries, and pushes, at given times."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.tree import parameter, quantity, record, record_of, replace, setting
from qrsim.core.vectors import Vec3

LAST_TICK = 2**31 - 1
# Speed of a rotor that is not stuck.
FREE = -1.0


@record
class RotorFault:
    """One rotor of some vehicles (n,) of a fleet that turns slower than commanded, stops, or is stuck."""

    start_tick: Array = quantity(doc="() or (n,) int32 first tick of the fault")
    noticed_ticks: Array = quantity(doc="() int32 ticks after which the autopilot responds to it")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    health: Array = parameter(unit="1", doc="share of its speed that the rotor still reaches; 0: it stops")
    rotor: int = setting(doc="number of the rotor, from 0")
    speed: Array | None = quantity(
        default=None, unit="1", doc="share of its largest speed at which it is stuck; negative, or None: it is not"
    )

    @staticmethod
    def empty(count: int, rotor: int, noticed_ticks: Any) -> RotorFault:
        """Return a fault record for rotor number ``rotor`` of ``count`` vehicles that affects none of them."""
        never, nobody = np.full(count, LAST_TICK, np.int32), np.zeros(count, bool)
        free = np.full(count, FREE)
        return record_of(RotorFault, never, noticed_ticks, never, nobody, np.ones(count), rotor, speed=free)

    def active(self, tick: Array) -> Array:
        """Return (n,) bool: the fault acts on a vehicle's rotor at a tick."""
        return self.affected & (tick < self.end_tick) & (tick >= self.start_tick)


@record
class BatteryFault:
    """A battery that loses charge at once, or capacity and voltage, of some vehicles (n,) of a fleet."""

    start_tick: Array = quantity(doc="() or (n,) int32 tick at which it happens")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick at which capacity and voltage are back")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    charge: Array = parameter(unit="1", doc="remaining share of a full charge", minimum=0.0, maximum=1.0)
    health: Array = parameter(unit="1", doc="remaining share of capacity and voltage", above=0.0, maximum=1.0)

    @staticmethod
    def empty(count: int) -> BatteryFault:
        """Return a fault record for the batteries of ``count`` vehicles that affects none of them."""
        never, full = np.full(count, LAST_TICK, np.int32), np.ones(count)
        return record_of(BatteryFault, never, never, np.zeros(count, bool), full, full)

    def apply(self, before: Any, battery: Any, tick: Array) -> Any:
        """Return the battery state after a tick, ``battery``, with the fault's extra discharge since ``before``."""
        used = before.charge - battery.charge
        charge = jnp.where(self._weak(tick), jnp.maximum(before.charge - used / self.health, 0.0), battery.charge)
        happens = self.affected & (tick == self.start_tick)
        return replace(battery, charge=jnp.where(happens, jnp.minimum(self.charge, charge), charge))

    def sagged(self, voltage: Array | None, tick: Array) -> Array | None:
        """Return the battery voltage (n,) [V] reduced by the fault at a tick; None for a battery without voltage."""
        return None if voltage is None else jnp.where(self._weak(tick), voltage * self.health, voltage)

    def _weak(self, tick: Array) -> Array:
        """Return (n,) bool: the fault makes the battery weak at a tick."""
        return self.affected & (tick >= self.start_tick) & (tick < self.end_tick) & (self.health < 1.0)


@record
class Push:
    """A force per mass on some vehicles (n,) of a fleet, as from a hand or a rope; it acts at the centre of mass."""

    start_tick: Array = quantity(doc="() or (n,) int32 first tick of the push")
    end_tick: Array = quantity(doc="() or (n,) int32 first tick after it")
    affected: Array = quantity(doc="(n,) bool: the vehicles it concerns")
    ned: Vec3 = quantity(unit="m/s^2", doc="() or (n,) acceleration north, east, down")
    body: Vec3 = quantity(unit="m/s^2", doc="() or (n,) acceleration forward, right, down in body axes, in addition")

    @staticmethod
    def empty(count: int) -> Push:
        """Return a push record for ``count`` vehicles that pushes none of them."""
        never, nobody = np.full(count, LAST_TICK, np.int32), np.zeros(count, bool)
        return record_of(Push, never, never, nobody, *(Vec3(*np.zeros((3, count))) for _ in range(2)))

    def at(self, tick: Array) -> tuple[Vec3, Vec3]:
        """Return a push's accelerations (n,) [m/s^2] at a tick: those in NED, and those in body axes."""
        acts = self.affected & (tick >= self.start_tick) & (tick < self.end_tick)
        ned, body = (part.map(lambda axis: jnp.where(acts, axis, 0.0)) for part in (self.ned, self.body))
        return ned, body


def failed_rotors(faults: tuple[RotorFault, ...], tick: Array) -> tuple[tuple[int, Array, Array], ...]:
    """Return (number, health (n,) 0 to 1, noticed (n,) bool) of each rotor that a fault can weaken."""
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


def stuck_rotors(faults: tuple[RotorFault, ...], tick: Array) -> tuple[tuple[int, Array], ...]:
    """Return (rotor number, speed (n,) as a share of the largest) of each rotor that can be stuck; negative if free.

    Of two faults of a rotor the later one in the order of ``faults`` counts.
    """
    found: dict[int, Array] = {}
    for fault in faults:
        if fault.speed is not None:
            stuck = fault.active(tick) & (fault.speed >= 0.0)
            found[fault.rotor] = jnp.where(stuck, fault.speed, found.get(fault.rotor, jnp.full_like(fault.speed, FREE)))
    return tuple(sorted(found.items(), key=lambda item: item[0]))
