"""The requests of a flight in its run folder: entries of ``injections.yaml``, and events."""

from __future__ import annotations

from qrsim.runs.writer import RunWriter
from qrsim.simulation.requests import entry_of, events_of
from qrsim.simulation.simulation import Simulation


class RequestLog:
    """Writes the requests of a simulation as they are made.

    Args:
        simulation: reset.
        writer: of the run.
    """

    def __init__(self, simulation: Simulation, writer: RunWriter):
        self._simulation, self._writer, self._count = simulation, writer, 0

    def write_new(self) -> None:
        """Write the requests made since the last call."""
        new, time_step = self._simulation.requests[self._count :], self._simulation.world.time_step
        self._count += len(new)
        for request in new:
            self._writer.note_injection(entry_of(request, time_step))
        for event in events_of(new, time_step):
            self._writer.append_event(**event)
