"""The orders that the vehicles of a world fly by now, as the actions of its next tick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qrsim.core.arrays import DType, NumpyArray
from qrsim.errors import UsageError, did_you_mean
from qrsim.links.contracts import Order
from qrsim.links.shared.kinds import NAMES, Field, checked, kinds_of, record_of
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet, Some

# The number of each kind of order.
_CODES = {name: number for number, name in enumerate(NAMES, 1)}


class Latches:
    """The last order of each vehicle, until it is replaced; vehicles without one fly by their scenario's guidance.

    Whatever the orders are, the actions are of one kind: a mixture of all kinds that a fleet takes. So nothing is
    compiled while a world flies, and what one vehicle is asked changes no bit of another's flight.

    Args:
        fleets: of the world.
        dtype: of the simulation's numbers.

    Attributes:
        names: of the n vehicles.
        codes: (n,) number of each order's kind, in NAMES from 1; 0: the guidance of the scenario.
        numbers: (n, V) of each order; NaN beyond those of its kind.
    """

    def __init__(self, fleets: Sequence[Fleet], dtype: DType):
        self.names = [name for fleet in fleets for name in fleet.vehicle_names]
        self._dtype = dtype
        kinds = [kinds_of(fleet) for fleet in fleets]
        self._kinds = {name: own for fleet, own in zip(fleets, kinds, strict=True) for name in fleet.vehicle_names}
        width = max((len(fields) for own in kinds for fields in own.values()), default=0)
        self.codes = np.zeros(len(self.names), np.int32)
        self.numbers = np.full((len(self.names), width), np.nan)
        self._none = (np.nan,) * width
        self._rows = {name: row for row, name in enumerate(self.names)}
        self._fleets, first = [], 0
        # The orders of the last tick that ``advance`` flew.
        self._flown = b""
        for fleet, own in zip(fleets, kinds, strict=True):
            if own:
                self._fleets.append(_FleetParts(fleet, own, slice(first, first + fleet.size), dtype))
            first += fleet.size
        self._actions = {fleet.name: fleet.action for fleet in self._fleets}

    def row(self, vehicle: str) -> int:
        """Return the index of a vehicle among all vehicles of the world; raises UsageError for an unknown name."""
        if vehicle not in self._rows:
            raise UsageError(f"no vehicle is called '{vehicle[:60]}'{did_you_mean(vehicle[:60], self.names)}")
        return self._rows[vehicle]

    def kinds(self, vehicle: str) -> Mapping[str, tuple[Field, ...]]:
        """Return the kinds of orders that a vehicle takes, each with its number fields; raises UsageError for an
        unknown name."""
        return self._kinds[self.names[self.row(vehicle)]]

    def checked(self, order: Order) -> Order:
        """Return an order unchanged; raises UsageError if its vehicle does not take it."""
        return checked(order, self.kinds(order.vehicle), self._dtype)

    def put(self, order: Order) -> None:
        """Store a checked order, which its vehicle then flies until the next order."""
        row, numbers = self.row(order.vehicle), order.numbers
        self.codes[row] = _CODES[order.kind]
        self.numbers[row] = (*numbers, *self._none[len(numbers) :])

    def clear(self, vehicle: str) -> None:
        """Return a vehicle to its scenario's guidance."""
        row = self.row(vehicle)
        self.codes[row] = 0
        self.numbers[row] = np.nan

    def actions(self) -> dict[str, Some]:
        """Return the action of each fleet, made of the stored orders, for ``Simulation.step``; the next call overwrites
        its arrays."""
        self._flown = b""
        for fleet in self._fleets:
            fleet.fill(self.codes, self.numbers)
        return self._actions

    def advance(self, simulation: Simulation) -> None:
        """Advance the simulation by a tick with the stored orders, which are handed over only if one has changed."""
        orders = self.codes.tobytes() + self.numbers.tobytes()
        same = orders == self._flown
        # Numbers of orders are finite and in range (``checked``), so that they are not checked once more.
        simulation.advance(self._actions if same else self.actions(), again="same" if same else "renewed")
        self._flown = orders


class _FleetParts:
    """Arrays of one fleet, allocated once: for each kind whom it is for and its numbers."""

    def __init__(self, fleet: Fleet, kinds: Mapping[str, tuple[Field, ...]], own: slice, dtype: DType):
        self.name, self._own = fleet.name, own
        self._parts = []
        for kind, fields in kinds.items():
            which, columns = np.zeros(fleet.size, bool), np.zeros((len(fields), fleet.size), dtype)
            self._parts.append((_CODES[kind], which, columns))
        command = fleet.vehicle.command_type
        parts: list[Any] = [
            (which, record_of(kind, columns, command))
            for kind, (_, which, columns) in zip(kinds, self._parts, strict=True)
        ]
        self.action = Some(tuple(parts))

    def fill(self, codes: NumpyArray, numbers: NumpyArray) -> None:
        """Set the fleet's action from the kind codes (n,) and numbers (n, V) of the orders of all vehicles in the
        world."""
        codes, numbers = codes[self._own], numbers[self._own]
        for code, which, columns in self._parts:
            np.equal(codes, code, out=which)
            # Nothing that is no number goes in, also where nobody looks.
            columns[...] = np.where(which, numbers[:, : len(columns)].T, 0.0)
