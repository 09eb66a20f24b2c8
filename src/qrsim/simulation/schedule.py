"""Requests of another flight, repeated at their ticks."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

from qrsim.simulation.injections import Injection
from qrsim.simulation.simulation import Simulation


class Schedule:
    """Repeats requests when a simulation reaches their ticks.

    Args:
        simulation: to which the requests are made.
        requests: in any order; those of one tick are made in the given order.
    """

    def __init__(self, simulation: Simulation, requests: Iterable[Injection]):
        self._simulation = simulation
        self._requests = sorted(requests, key=lambda request: request.tick)
        self._ticks = [request.tick for request in self._requests]
        self._made = 0

    def make(self) -> None:
        """Make the recorded injection requests that are due at the simulation's present tick."""
        due = bisect_right(self._ticks, self._simulation.tick)
        if due > self._made:
            self._simulation.repeat(self._requests[self._made : due])
            self._made = due

    def ticks(self, most: int) -> int:
        """Return the number of ticks until the next recorded request, at most ``most``."""
        return min(most, self._ticks[self._made] - self._simulation.tick) if self else most

    def __bool__(self) -> bool:
        return self._made < len(self._requests)
