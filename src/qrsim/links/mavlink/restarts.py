"""Restarts of single vehicles while the world flies on: after a reboot, and of wrecks, at their start."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.mavlink.stack.codes import FIXED_WING, Severity
from qrsim.links.mavlink.stack.contracts import Text
from qrsim.links.mavlink.system import System
from qrsim.links.shared.latches import Latches
from qrsim.links.shared.replay import put_back
from qrsim.simulation.simulation import Simulation

# Time from a crash to a respawn, and between two attempts [s].
LIES_FOR_S = 3.0


class Restarts:
    """Restarts vehicles.

    Args:
        simulation: reset; the present states are those that wrecks are put back to.
        latches: orders of the vehicles.
        systems: row in the world and system of each vehicle.
        respawn: put wrecks back without a reboot.
        noted: called with the row of each vehicle that was put back.
    """

    def __init__(
        self,
        simulation: Simulation,
        latches: Latches,
        systems: Sequence[tuple[int, System]],
        respawn: bool,
        noted: Callable[[int], None],
    ):
        self._simulation, self._latches, self._systems = simulation, latches, systems
        self._respawn, self._noted = respawn, noted
        self._begins = np.array(simulation.truth.state)
        self._due: dict[int, float] = {}

    def look(self) -> None:
        """Restart every vehicle that was asked to reboot or has been wrecked for long enough; call it between two
        ticks."""
        requests = self._simulation.requests
        if requests and requests[-1].tick == self._simulation.tick:
            # A recording repeats restarts before the requests of their tick.
            return
        for row, system in self._systems:
            asked, system.reboots = system.reboots, False
            stopped = bool(system.view.seen.stopped)
            if not (asked or (stopped and self._is_due(row, system))):
                continue
            why = self._put_back(row, system) if stopped else ""
            if not why:
                self._due.pop(row, None)
                system.restart()
                # What was injected ends with the boot, as in PX4.
                self._simulation.clear(vehicles=system.name)
                system.booted()
            elif asked:
                system.text(Text(Severity.WARNING, why))
            else:
                system.tell_once("way", Text(Severity.WARNING, why))

    def _is_due(self, row: int, system: System) -> bool:
        """Return whether a wrecked vehicle has waited long enough to be put back without a reboot command."""
        now = system.view.seen.time
        if not self._respawn or now < self._due.setdefault(row, now + LIES_FOR_S):
            return False
        self._due[row] = now + LIES_FOR_S
        return True

    def _put_back(self, row: int, system: System) -> str:
        """Put a wrecked vehicle (at ``row`` of the world) back to its start with a new battery; return "", or why it
        failed."""
        try:
            put_back(self._simulation, self._begins, row)
        except UsageError as error:
            return f"Not put back to where it began: {str(error).partition('invalid: ')[2] or error}"
        self._noted(row)
        if system.stack.heartbeat().mav_type == FIXED_WING:
            # It is in the air at once, and flies by its guidance.
            self._latches.clear(system.name)
        system.view.order = None
        return ""
