"""A simulation whose vehicles are flown by Betaflight, tick by tick."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qrsim.links.autopilot.firmware import Firmware
from qrsim.links.autopilot.fleet import checked_fleet, rotor_order
from qrsim.links.autopilot.lockstep import FlownFleet, LockstepFlight
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.packets import Sensed
from qrsim.links.autopilot.sticks import channels
from qrsim.simulation.simulation import Simulation
from qrsim.world.state import Fleet

# From commands of vehicles (n, 4: pitch, roll, throttle, yaw rate) at a time [s] to others.
Override = Callable[[float, list[Sequence[float]]], list[Sequence[float]]]
# A vehicle that turns faster than this at the start is not at rest while the firmware calibrates its gyroscope.
STILL_RAD_S = 0.05


class BetaflightFleet(FlownFleet):
    """The vehicles of a fleet and their firmware."""

    def __init__(
        self,
        simulation: Simulation,
        fleet: Fleet,
        firmware: Sequence[Firmware],
        override: Override | None,
        lost: Losses,
    ):
        super().__init__(simulation, fleet, rotor_order(fleet), lost)
        vehicle: Any = fleet.vehicle
        curve = np.broadcast_to(np.asarray(vehicle.throttle_curve, np.float64), (fleet.size,))
        self._curves: list[float] = curve.tolist()
        self._firmware, self._override = firmware, override
        self._armed = 0.0

    def arm(self) -> None:
        """Start and arm Betaflight for every vehicle, with the sensor values of a vehicle at rest."""
        _, sensed = self.sight.look()
        for firmware, first in zip(self._firmware, sensed, strict=True):
            rates = first.rates_body if math.hypot(*first.rates_body) < STILL_RAD_S else (0.0, 0.0, 0.0)
            rest = Sensed(rates, attitude=first.attitude, place=first.place, pressure=first.pressure)
            # The time [s] that their clocks then have.
            self._armed = firmware.arm(self.simulation.world.time_step, rest)

    def tell(self) -> None:
        """Send sensor readings and stick channels to each vehicle's Betaflight, which advances it by one tick."""
        asked, sensed = self.sight.look()
        wanted = asked if self._override is None else self._override(self.simulation.time, asked)
        time = self._armed + (self.simulation.tick + 1) * self.simulation.world.time_step
        for i in self.losses.left(self.fleet.size):
            pitch, roll, throttle, yaw_rate = wanted[i]
            with self.losses.watched(i):
                self._firmware[i].tell(time, sensed[i], channels(pitch, roll, throttle, yaw_rate, self._curves[i]))

    def speeds(self, number: int) -> Sequence[float]:
        """Return the motor speeds of vehicle ``number``, 0 to 1, in Betaflight's order."""
        return self._firmware[number].motors()


class Flight(LockstepFlight):
    """Flies a simulation by firmware, which is started and armed at once.

    Args:
        simulation: reset, at tick 0.
        fleets: names of those that are flown so; the others fly as ever.
        program, eeprom: the firmware and its configuration.
        override: replaces the commands of the fleets' controllers; None: they are flown.
        lost: told a line when a firmware ends in flight, whose vehicle's motors then stop; None: all flights end.

    Raises:
        UsageError: a fleet cannot be flown.
        RunError: a firmware does not start, answer or arm.
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
        super().__init__(simulation)
        flown = [checked_fleet(simulation.world, name) for name in fleets]

        def build() -> None:
            """Start Betaflight for every vehicle, and arm all fleets."""
            for fleet in flown:
                firmware = [self.closing.enter_context(Firmware(program, eeprom, name)) for name in fleet.vehicle_names]
                self.fleets.append(BetaflightFleet(simulation, fleet, firmware, override, Losses(lost)))
            for fleet in self.fleets:
                fleet.arm()

        self.opened(build)
