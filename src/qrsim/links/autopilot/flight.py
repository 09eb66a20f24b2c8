"""A simulation whose vehicles are flown by an autopilot's firmware, tick by tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.links.autopilot.firmware import Firmware
from qrsim.links.autopilot.fleet import checked_fleet, rotor_order
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.packets import Sensed
from qrsim.links.autopilot.sensing import FleetSight
from qrsim.links.autopilot.sticks import channels
from qrsim.models.vehicles.multirotor.commands import MotorCommand
from qrsim.simulation.history import History
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet, Piloted

# From what is asked of vehicles (n, 4: pitch, roll, throttle, yaw rate) at a time [s] to the same.
Override = Callable[[float, list[Sequence[float]]], list[Sequence[float]]]
# Who turns faster than this at the start does not stand still while the firmware learns the zero of its gyroscope.
STILL_RAD_S = 0.05


def flown_history(simulation: Simulation, advance: Callable[[], None], ticks: int) -> History:
    """Return the states of so many ticks, each flown by ``advance``."""
    layout, _ = simulation.packed
    first, rows = simulation.tick, []
    for _ in range(ticks):
        advance()
        rows.append([np.array(part) for part in simulation.packed[1]])
    stacked: Any = tuple(np.stack(part) for part in zip(*rows, strict=True))
    numbers = np.arange(first + 1, first + ticks + 1)
    return History(numbers, simulation.world.time_step, layout, stacked)


class FlownFleet:
    """The vehicles of a fleet and their firmware."""

    def __init__(
        self, simulation: Simulation, fleet: Fleet, program: Path, eeprom: bytes, close: ExitStack, losses: Losses
    ):
        number = [each.name for each in simulation.world.fleets].index(fleet.name)
        self.fleet = fleet
        self._order = list(rotor_order(fleet))
        vehicle: Any = fleet.vehicle
        curve = np.broadcast_to(np.asarray(vehicle.throttle_curve, np.float64), (fleet.size,))
        self._curves: list[float] = curve.tolist()
        self._dtype = simulation.dtype
        self._command = MotorCommand.of_count(4)
        self.sight = FleetSight(simulation, number)
        self._losses = losses
        self.firmware = [close.enter_context(Firmware(program, eeprom, name)) for name in fleet.vehicle_names]

    def arm(self, dt: float) -> float:
        """Arm all at rest; return the time [s] that their clocks then have."""
        _, sensed = self.sight.look()
        reached = 0.0
        for firmware, first in zip(self.firmware, sensed, strict=True):
            rates = first.rates_body if math.hypot(*first.rates_body) < STILL_RAD_S else (0.0, 0.0, 0.0)
            rest = Sensed(rates, attitude=first.attitude, place=first.place, pressure=first.pressure)
            reached = firmware.arm(dt, rest)
        return reached

    def tell(self, time: float, override: Callable[[list[Sequence[float]]], list[Sequence[float]]]) -> None:
        """Let all go on to a time [s] of their clocks."""
        asked, sensed = self.sight.look()
        wanted = override(asked)
        for i in self._losses.left(len(self.firmware)):
            pitch, roll, throttle, yaw_rate = wanted[i]
            with self._losses.watched(i):
                self.firmware[i].tell(time, sensed[i], channels(pitch, roll, throttle, yaw_rate, self._curves[i]))

    def answer(self) -> Piloted:
        """Return what their motors are to do; those of a vehicle without its firmware stand still."""
        table = np.zeros((len(self.firmware), len(self._order)), self._dtype)
        for i in self._losses.left(len(self.firmware)):
            with self._losses.watched(i):
                table[i] = self.firmware[i].motors()
        columns = np.clip(table[:, self._order], 0.0, 1.0).T
        return Piloted(self._command(*np.ascontiguousarray(columns)))


class Flight:
    """Flies a simulation by firmware, which is started and armed at once.

    Args:
        simulation: reset, at tick 0.
        fleets: names of those that are flown so; the others fly as ever.
        program, eeprom: the firmware and its configuration.
        override: what is asked of the first of these fleets in place of what its controller asks; None: that.
        lost: told a line when a firmware ends in flight, whose vehicle's motors then stop; None: all flights end.

    Raises:
        UsageError: a fleet cannot be flown.
        RunError: a firmware does not start, answer or arm.

    Attributes:
        simulation: in flight.
    """

    def __init__(
        self,
        simulation: Simulation,
        fleets: Sequence[str],
        program: Path,
        eeprom: bytes,
        override: Override | None = None,
        lost: Callable[[str], None] | None = None,
    ):
        self.simulation = simulation
        self._override = override
        chosen = [checked_fleet(simulation.world, name) for name in fleets]
        self._dt = simulation.world.time_step
        with ExitStack() as close:
            self._fleets = [FlownFleet(simulation, fleet, program, eeprom, close, Losses(lost)) for fleet in chosen]
            self._armed = [fleet.arm(self._dt) for fleet in self._fleets]
            self._close = close.pop_all()

    def advance(self, ticks: int = 1) -> None:
        """Fly so many ticks; raises RunError where a firmware ends or is silent, and all flights end with it."""
        for _ in range(ticks):
            simulation = self.simulation
            for fleet, armed in zip(self._fleets, self._armed, strict=True):
                fleet.tell(armed + (simulation.tick + 1) * self._dt, self._asked)
            simulation.advance({fleet.fleet.name: fleet.answer() for fleet in self._fleets})

    def record(self, ticks: int, capacity: int = 50) -> History:
        """Fly so many ticks and return their states; ``capacity`` is not needed here."""
        return flown_history(self.simulation, self.advance, ticks)

    def _asked(self, asked: list[Sequence[float]]) -> list[Sequence[float]]:
        return asked if self._override is None else self._override(self.simulation.time, asked)

    def close(self) -> None:
        """End the firmware."""
        self._close.close()

    def __enter__(self) -> Flight:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
