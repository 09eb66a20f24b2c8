"""A simulation whose vehicles are flown by autopilots in lock-step: the part that all autopilots share.

A tick has four parts. Each fleet sends readings to its autopilots, and waits for the speeds of the motors. The world
advances, and autopilots that wait for the end of a step get their answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar, Self

import numpy as np

from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.sensing import FleetSight
from qrsim.models.vehicles.multirotor.commands import MotorCommand
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet, Piloted


def chosen(simulation: Simulation, names: Sequence[str]) -> list[Fleet]:
    """Return the simulation's fleets with the given names, in the order of the names."""
    return [next(fleet for fleet in simulation.world.fleets if fleet.name == name) for name in names]


class FlownFleet:
    """The vehicles of a fleet, each with an autopilot.

    Args:
        simulation: reset, at tick 0.
        fleet: of multirotors.
        order: for each rotor the number of its motor at the autopilot, from 0.
        losses: of its vehicles.

    Attributes:
        fed_with_truth: whether autopilots get true rates and forces where the fleet's controller is fed with the truth.
    """

    fed_with_truth: ClassVar[bool] = True

    def __init__(self, simulation: Simulation, fleet: Fleet, order: Sequence[int], losses: Losses):
        self.simulation, self.fleet, self.losses = simulation, fleet, losses
        number = [each.name for each in simulation.world.fleets].index(fleet.name)
        self.sight = FleetSight(simulation, number, self.fed_with_truth)
        self.order = list(order)
        self._command = MotorCommand.of_count(len(self.order))

    def tell(self) -> None:
        """Send sensor readings to the fleet's autopilots before a tick; nothing here, subclasses override it."""

    def speeds(self, number: int) -> Sequence[float]:
        """Return the motor speeds of vehicle ``number`` for this tick, 0 to 1; raises RunError if its autopilot is
        gone."""
        raise NotImplementedError

    def answer(self) -> None:
        """Send sensor readings to the fleet's autopilots after a tick; nothing here, subclasses override it."""

    def piloted(self) -> Piloted:
        """Return the fleet's motor command for this tick, from its autopilots; motors stop where the autopilot is
        gone."""
        table = np.zeros((self.fleet.size, len(self.order)), self.simulation.dtype)
        for number in self.losses.left(self.fleet.size):
            with self.losses.watched(number):
                table[number] = self.speeds(number)
        columns = np.clip(table[:, self.order], 0.0, 1.0).T
        return Piloted(self._command(*np.ascontiguousarray(columns)))


class LockstepFlight:
    """Flies a simulation by autopilots.

    Args:
        simulation: reset, at tick 0.

    Attributes:
        simulation: in flight.
        fleets: those that are flown so; the others fly as ever.
        closing: closes sockets and processes of the autopilots.
    """

    def __init__(self, simulation: Simulation):
        self.simulation = simulation
        self.fleets: list[Any] = []
        self.closing = ExitStack()

    def opened(self, build: Callable[[], None]) -> None:
        """Call ``build``, which opens sockets and processes, and close all of them if it raises an error."""
        try:
            build()
        except BaseException:
            self.close()
            raise

    def advance(self, ticks: int = 1) -> None:
        """Fly ``ticks`` ticks with the autopilots in lock-step; raises RunError if a lost autopilot ends the flight."""
        for _ in range(ticks):
            for fleet in self.fleets:
                fleet.tell()
            self.simulation.advance({fleet.fleet.name: fleet.piloted() for fleet in self.fleets})
            for fleet in self.fleets:
                fleet.answer()

    def record(self, ticks: int, capacity: int = 50) -> History:
        """Fly ``ticks`` ticks and return the state of each; ``capacity`` is ignored."""
        simulation = self.simulation
        layout, _ = simulation.packed
        first, rows = simulation.tick, []
        for _ in range(ticks):
            self.advance()
            rows.append([np.array(part) for part in simulation.packed[1]])
        stacked: Any = tuple(np.stack(part) for part in zip(*rows, strict=True))
        numbers = np.arange(first + 1, first + ticks + 1)
        return History(numbers, simulation.world.time_step, layout, stacked)

    def close(self) -> None:
        """Close all sockets, and end the autopilot processes that this flight started."""
        self.closing.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
