"""A pack of lithium cells that is drained by electrical power."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp
from jax import Array

from qrsim.core.fastmath import exp
from qrsim.core.tree import parameter, quantity, record
from qrsim.models.scene.area import reason_code
from qrsim.models.vehicles.contracts import Battery, Check, Load


@record
class CellsState:
    """State of a pack."""

    charge: Array = quantity(unit="1", doc="state of charge, 1 full, 0 empty")
    current: Array = quantity(unit="A", doc="current that it supplies")
    overload: Array = quantity(unit="W", doc="power demand beyond its capability; else 0")


@record
class LithiumCells(Battery):
    """Cells in series behind an internal resistance.

    The open-circuit voltage is that of M. Chen and G. A. Rincon-Mora, "Accurate electrical battery model capable of
    predicting runtime and I-V performance", IEEE Trans. Energy Conversion 21(2), 2006. The defaults are those of a pack
    of four cells and 5 Ah, as an X500 carries.
    """

    cells: Array = parameter(default=4.0, unit="1", doc="cells in series", above=0.0)
    capacity: Array = parameter(default=5.0, unit="Ah", doc="charge of the full pack", above=0.0)
    cell_resistance: Array = parameter(default=0.004, unit="ohm", doc="internal resistance of a cell", above=0.0)
    initial_charge: Array = parameter(default=1.0, unit="1", doc="state of charge at the start", above=0.0, maximum=1.0)

    drains: ClassVar[bool] = True
    needs_power: ClassVar[bool] = True

    def init(self, like: Array) -> CellsState:
        """Return the state (n,) at the initial charge; ``like``: any array (n,), for the shape."""
        zero = jnp.zeros_like(like)
        return CellsState(jnp.broadcast_to(jnp.asarray(self.initial_charge), like.shape), zero, zero)

    def open_circuit(self, charge: Array) -> Array:
        """Return the open-circuit voltage (n,) [V] of the pack at a state of charge (n,), 0 to 1 (eq. V26)."""
        s = charge
        cell = 3.685 - 1.031 * exp(-35.0 * s) + s * (0.2156 + s * (-0.1178 + s * 0.3201))
        return self.cells * cell

    def step(self, state: CellsState, load: Load, dt: float) -> CellsState:
        """Return the state after dt [s] of discharge at the electric power of a load (n,) (eq. V27)."""
        asked = _power(load)
        current = asked / self.voltage(state, load)
        charge = state.charge - current * (dt / 3600.0) / self.capacity
        overload = jnp.where(asked > self._most(state), asked, 0.0)
        return CellsState(jnp.maximum(charge, 0.0), current, overload)

    def voltage(self, state: CellsState, load: Load) -> Array:
        """Return the voltage (n,) [V] under load; half the open-circuit voltage if the power demanded is too large."""
        open_circuit = self.open_circuit(state.charge)
        resistance = self.cells * self.cell_resistance
        root = jnp.sqrt(jnp.maximum(open_circuit * open_circuit - 4.0 * resistance * _power(load), 0.0))
        return 0.5 * (open_circuit + root)

    def own_checks(self, state: CellsState) -> list[Check]:
        """Return the stop condition (n,) of a pack that cannot deliver the power demanded: (code, value, broken)."""
        return [(reason_code("brown_out", "power"), state.overload, state.overload > 0.0)]

    def _most(self, state: CellsState) -> Array:
        """Return the largest power (n,) [W] that the pack can deliver now."""
        open_circuit = self.open_circuit(state.charge)
        return open_circuit * open_circuit / (4.0 * self.cells * self.cell_resistance)


def _power(load: Load) -> Array:
    """Return the electric power (n,) [W] of a load; raise an error for a load without power."""
    # A scenario with another vehicle is refused.
    assert load.power is not None
    return load.power
