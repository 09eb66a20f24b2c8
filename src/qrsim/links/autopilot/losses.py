"""Vehicles that have lost their autopilot in flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from qrsim.errors import RunError


class Losses:
    """The vehicles of a fleet, by number, whose autopilot has ended; their motors stand still.

    Args:
        say: told a line for each while the others fly on; None: the first loss ends the flight of all.
    """

    def __init__(self, say: Callable[[str], None] | None):
        self._say = say
        self._numbers: set[int] = set()

    @contextmanager
    def watched(self, number: int) -> Iterator[None]:
        """Record a RunError in the ``with`` block as the loss of vehicle ``number``'s autopilot; re-raise it if one
        loss ends the run."""
        try:
            yield
        except RunError as error:
            if self._say is None:
                raise
            self._numbers.add(number)
            self._say(f"{error}; its motors stop, and the others fly on")

    def left(self, count: int) -> list[int]:
        """Return the numbers of the vehicles, among 0 to ``count - 1``, whose autopilot has not been lost."""
        return [number for number in range(count) if number not in self._numbers]
