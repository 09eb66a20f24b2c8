"""Battery voltage, which limits a vehicle's thrust."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log
from qrsim.core.tree import parameter, quantity, record
from qrsim.models.vehicles.contracts import Battery, Load

# Range of voltages [V] that the published thrust model was identified for; where the sag of other packs ends, of empty.
LOWEST, HIGHEST, SAGGED = 9.0, 12.0, 0.9375


@record
class NoCharge:
    """Nothing to remember."""


@record
class GivenVoltage(Battery):
    """The commanded voltage: that of the controller, or of your command."""

    def init(self, like: Array) -> NoCharge:
        """Return the empty state of a battery that is not simulated."""
        return NoCharge()

    def step(self, state: NoCharge, load: Load, dt: float) -> NoCharge:
        """Return the empty state of a battery that is not simulated."""
        return state

    def voltage(self, state: NoCharge, load: Load) -> None:
        """Return None: each command gives the voltage itself."""


@record
class Charge:
    """State of a battery."""

    charge: Array = quantity(unit="1", doc="state of charge, 1 full, 0 empty")


@record
class LithiumPolymer(Battery):
    """A pack that is drained by thrust and sags under load.

    Current grows with thrust to the power 3/2 and in thin air with one over the root of the density (the induced power
    of a rotor in hover, momentum theory); it is set by the endurance at hover at sea level. The open-circuit voltage
    falls linearly with the charge. The defaults are the AscTec Pelican's data sheet (6.25 Ah, 16 minutes) and the
    voltage range its thrust model was identified for; the resistance is that of a three-cell pack of this size.
    """

    capacity: Array = parameter(default=6.25, unit="Ah", doc="charge of the full pack", above=0.0)
    endurance: Array = parameter(
        default=960.0, unit="s", doc="time from full to empty at hover thrust, at sea level", above=0.0
    )
    voltage_full: Array = parameter(
        default=12.0, unit="V", doc="open-circuit voltage when full", above=0.0, maximum=100.0
    )
    voltage_empty: Array = parameter(
        default=9.6, unit="V", doc="open-circuit voltage when empty", above=0.0, maximum=100.0
    )
    resistance: Array = parameter(default=0.02, unit="ohm", doc="internal resistance", minimum=0.0)
    initial_charge: Array = parameter(default=1.0, unit="1", doc="state of charge at the start", above=0.0, maximum=1.0)

    drains: ClassVar[bool] = True

    def init(self, like: Array) -> Charge:
        """Return the state (n,) at the initial charge; ``like``: any array (n,), for the shape."""
        return Charge(jnp.broadcast_to(jnp.asarray(self.initial_charge), like.shape))

    def step(self, state: Charge, load: Load, dt: float) -> Charge:
        """Return the state after dt [s] of discharge by the thrust in ``load`` (n,)."""
        drain = _current(load) * (dt / self.endurance)
        return Charge(jnp.maximum(state.charge - drain, 0.0))

    def voltage(self, state: Charge, load: Load) -> Array:
        """Return the battery voltage (n,) [V] under a load.

        Of packs of three cells within the range that the thrust model is identified for; of others the sag ends in
        proportion, at 0.9375 of the voltage of the empty pack.
        """
        open_circuit = self.voltage_empty + (self.voltage_full - self.voltage_empty) * state.charge
        hover_current = self.capacity * 3600.0 / self.endurance
        lowest = jnp.where(_within(self.voltage_empty), LOWEST, SAGGED * self.voltage_empty)
        highest = jnp.where(_within(self.voltage_full), HIGHEST, self.voltage_full)
        return jnp.clip(open_circuit - self.resistance * hover_current * _current(load), lowest, highest)


def _within(voltage: Array) -> Array:
    """Return whether a voltage [V] is in the range for which the quadrotor's thrust model was identified."""
    return (jnp.asarray(voltage) >= LOWEST) & (jnp.asarray(voltage) <= HIGHEST)


def _current(load: Load) -> Array:
    """Return the battery current over that in hover at sea level, for a load (n,)."""
    current = exp(1.5 * log(jnp.maximum(load.thrust / load.weight, 1e-6)))
    return current if load.density_ratio is None else current / jnp.sqrt(load.density_ratio)
