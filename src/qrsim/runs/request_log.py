"""The requests of a flight in its run folder: entries of ``injections.yaml``, and events."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from qrsim.simulation.requests import entry_of, events_of
from qrsim.simulation.simulation import Simulation


class RequestLog:
    """Writes the requests of a simulation as they are made.

    Args:
        simulation: reset.
        note: keeps an entry, as ``RunWriter.note_injection``.
        append: keeps an event, as ``RunWriter.append_event``.
    """

    def __init__(
        self, simulation: Simulation, note: Callable[[Mapping[str, object]], None], append: Callable[..., None]
    ):
        self._simulation, self._note, self._append, self._count = simulation, note, append, 0

    @property
    def has_new(self) -> bool:
        """Whether in-flight requests (faults, weather changes) were made since the last ``write_new``."""
        return len(self._simulation.requests) > self._count

    def write_new(self) -> None:
        """Write the in-flight requests (faults, weather changes) made since the last call, and their events."""
        new, time_step = self._simulation.requests[self._count :], self._simulation.world.time_step
        self._count += len(new)
        for request in new:
            self._note(entry_of(request, time_step))
        for event in events_of(new, time_step):
            self._append(**event)
