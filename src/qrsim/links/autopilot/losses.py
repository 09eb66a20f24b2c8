"""Vehicles that have lost their autopilot in flight."""

from __future__ import annotations

from collections.abc import Callable

from qrsim.errors import RunError


class Losses:
    """The vehicles of a fleet, by number, whose autopilot has ended; their motors stand still.

    Args:
        say: told a line for each while the others fly on; None: the first loss ends the flight of all.
    """

    def __init__(self, say: Callable[[str], None] | None):
        self._say = say
        self._numbers: set[int] = set()

    def __contains__(self, number: int) -> bool:
        return number in self._numbers

    def add(self, number: int, error: RunError) -> None:
        """Note the loss of a vehicle's autopilot; raises the error that reports it where all flights are to end."""
        if self._say is None:
            raise error
        self._numbers.add(number)
        self._say(f"{error}; its motors stop, and the others fly on")
