"""Vehicles that start again while the world flies on: those that reboot; wrecks return to where they began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.mavlink.stack.codes import FIXED_WING, Severity
from qrsim.links.mavlink.stack.contracts import Text
from qrsim.links.mavlink.system import System
from qrsim.links.shared.latches import Latches
from qrsim.simulation.simulation import Simulation

# A wreck lies for so long before it is put back by itself, and again where it could not be [s].
LIES_FOR_S = 3.0


class Restarts:
    """Starts vehicles again.

    Args:
        simulation: reset; what it is told now is where vehicles begin.
        latches: of the orders that they fly by.
        systems: row in the world and system of each vehicle.
        respawn: whether wrecks are put back without a reboot.
    """

    def __init__(self, simulation: Simulation, latches: Latches, systems: Sequence[tuple[int, System]], respawn: bool):
        self._simulation, self._latches, self._systems = simulation, latches, systems
        self._respawn = respawn
        self._begins = np.array(simulation.truth.state)
        self._due: dict[int, float] = {}

    def look(self) -> None:
        """Start again who is to, between two ticks."""
        for row, system in self._systems:
            seen = system.view.seen
            if seen.stopped and self._respawn:
                due = self._due.setdefault(row, seen.time + LIES_FOR_S)
                if seen.time >= due:
                    self._due[row] = seen.time + LIES_FOR_S
                    system.reboots = True
            if system.reboots:
                system.reboots = False
                if not seen.stopped or self._put_back(row, system):
                    self._due.pop(row, None)
                    system.restart()

    def _put_back(self, row: int, system: System) -> bool:
        """Put a wreck back to where it began, with a new battery; return whether nothing is in the way there."""
        rows = np.full_like(self._begins, np.nan)
        rows[row] = self._begins[row]
        try:
            self._simulation.set_state(rows, new_battery=True)
        except UsageError as error:
            why = str(error).partition("invalid: ")[2] or str(error)
            system.tell_once("way", Text(Severity.WARNING, f"Not put back to where it began: {why}"))
            return False
        if system.view.stack.heartbeat().mav_type == FIXED_WING:
            # In the air at once, it goes by its guidance.
            self._latches.clear(system.name)
        system.view.order = None
        return True
