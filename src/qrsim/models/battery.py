"""Where the battery voltage comes from that limits a vehicle's thrust."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp, log
from qrsim.core.tree import parameter, quantity, record


@record
class NoCharge:
    """Nothing to remember."""


@record
class GivenVoltage:
    """The voltage is what the command says (a controller's own parameter, or the user's)."""

    def init(self, thrust: Array) -> NoCharge:
        """Return the empty state."""
        return NoCharge()

    def step(self, state: NoCharge, thrust: Array, weight: Array, dt: float) -> NoCharge:
        """Return the empty state."""
        return state

    def voltage(self, state: NoCharge, thrust: Array, weight: Array, commanded: Array) -> Array:
        """Return the commanded voltage (n,) [V]."""
        return commanded


@record
class Charge:
    """What a battery remembers."""

    charge: Array = quantity(unit="1", doc="state of charge, 1 full, 0 empty")


@record
class LithiumPolymer:
    """A pack that is drained by thrust and sags under load.

    Current grows with thrust to the power 3/2 (the induced power of a rotor in hover, momentum theory) and is set by
    the endurance at hover. The open-circuit voltage falls linearly with the charge. The defaults are the AscTec
    Pelican's data sheet (6.25 Ah, 16 minutes) and the voltage range its thrust model was identified for; the
    resistance is that of a three-cell pack of this size.
    """

    capacity: Array = parameter(default=6.25, unit="Ah", doc="charge of the full pack", above=0.0)
    endurance: Array = parameter(default=960.0, unit="s", doc="time from full to empty at hover thrust", above=0.0)
    voltage_full: Array = parameter(
        default=12.0, unit="V", doc="open-circuit voltage when full", minimum=9.0, maximum=12.0
    )
    voltage_empty: Array = parameter(
        default=9.6, unit="V", doc="open-circuit voltage when empty", minimum=9.0, maximum=12.0
    )
    resistance: Array = parameter(default=0.02, unit="ohm", doc="internal resistance", minimum=0.0)
    initial_charge: Array = parameter(default=1.0, unit="1", doc="state of charge at the start", above=0.0, maximum=1.0)

    def init(self, thrust: Array) -> Charge:
        """Return the state at the start for vehicles with thrust (n,)."""
        return Charge(jnp.broadcast_to(jnp.asarray(self.initial_charge), thrust.shape))

    def step(self, state: Charge, thrust: Array, weight: Array, dt: float) -> Charge:
        """Drain for dt [s] at a thrust (n,) [N] of a vehicle of given weight [N]."""
        drain = _load(thrust, weight) * (dt / self.endurance)
        return Charge(jnp.maximum(state.charge - drain, 0.0))

    def voltage(self, state: Charge, thrust: Array, weight: Array, commanded: Array) -> Array:
        """Return the voltage under load (n,) [V], within the range the thrust model is identified for."""
        open_circuit = self.voltage_empty + (self.voltage_full - self.voltage_empty) * state.charge
        hover_current = self.capacity * 3600.0 / self.endurance
        return jnp.clip(open_circuit - self.resistance * hover_current * _load(thrust, weight), 9.0, 12.0)


def _load(thrust: Array, weight: Array) -> Array:
    """Return the current as a multiple of the hover current, (F / m g)^1.5."""
    return exp(1.5 * log(jnp.maximum(thrust / weight, 1e-6)))
