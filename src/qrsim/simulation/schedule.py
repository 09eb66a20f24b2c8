"""Requests of another flight, made again at their ticks."""

from __future__ import annotations

from collections.abc import Iterable

from qrsim.simulation.injections import Injection
from qrsim.simulation.simulation import Simulation


class Schedule:
    """Requests that are made as a simulation comes to their ticks.

    Args:
        simulation: that flies.
        requests: of it, in any order; those of one tick are made in the order that is given.
    """

    def __init__(self, simulation: Simulation, requests: Iterable[Injection]):
        self._simulation = simulation
        self._left = sorted(requests, key=lambda request: request.tick)

    def make(self) -> None:
        """Make the requests that are due at the simulation's tick."""
        count = sum(request.tick <= self._simulation.tick for request in self._left)
        if count:
            due, self._left = self._left[:count], self._left[count:]
            self._simulation.repeat(due)

    def ticks(self, most: int) -> int:
        """Return how many ticks to fly until the next request, at most ``most``."""
        return min(most, self._left[0].tick - self._simulation.tick) if self._left else most

    def __bool__(self) -> bool:
        return bool(self._left)
