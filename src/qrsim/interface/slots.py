"""Commands of one kind, bound to the numbers that a compiled tick reads them from."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.control import SETPOINTS
from qrsim.core.tree import walk
from qrsim.interface.actions import ActionChecker, CommandKind
from qrsim.world.state import Action

Numbers = npt.NDArray[np.floating]
# Set-points whose ``z`` is a height above the ground, and not a place.
_HEIGHTS = (SETPOINTS["velocity_height"], SETPOINTS["attitude_height"])


class Slot:
    """Takes commands of one kind for all vehicles, where they are as they usually are: arrays (n,) in their range.

    Args:
        leaves: returns the arrays of a command, in the order of its fields.
        numbers: where they lie, the arrays of each fleet after those of the fleet before.
        sizes: of the fleets.
        limits: lowest and highest value of each array.
    """

    def __init__(
        self,
        leaves: Callable[[Any], Sequence[Any]],
        numbers: Numbers,
        sizes: Sequence[int],
        limits: Sequence[tuple[float, float]],
    ):
        self._leaves, self._numbers, self._shape, self._count = leaves, numbers, (sum(sizes),), len(limits)
        self._rows: list[tuple[int, slice, Numbers]] = []
        self._limited = not np.isinf(limits).all()
        self._low, self._high = np.empty_like(numbers), np.empty_like(numbers)
        place, first = 0, 0
        for size in sizes:
            for number, (low, high) in enumerate(limits):
                part = slice(place, place + size)
                self._rows.append((number, slice(first, first + size), numbers[part]))
                self._low[part], self._high[part] = low, high
                place += size
            first += size

    def take(self, command: object) -> bool:
        """Write a user's command into the compiled program's inputs and return True; return False if it needs the full
        check."""
        try:
            leaves = self._leaves(command)
        except (TypeError, ValueError, OverflowError):
            return False
        if len(leaves) != self._count:
            return False
        for leaf in leaves:
            if type(leaf) is not np.ndarray or leaf.shape != self._shape or leaf.dtype.kind not in "fiu":
                return False
        for number, part, place in self._rows:
            place[...] = leaves[number][part]
        fine = np.isfinite(self._numbers)
        if self._limited:
            fine &= (self._numbers >= self._low) & (self._numbers <= self._high)
        return bool(np.logical_and.reduce(fine))


def slot_of(command: object, actions: Sequence[Action], numbers: Numbers, checker: ActionChecker) -> Slot | None:
    """Return a Slot, which writes later commands of the same form straight into a program; None if each needs the full
    check.

    Args:
        command: as the user passed it, for all vehicles.
        actions: the action of each fleet that it became.
        numbers: the arrays from which the program reads commands.
        checker: the checker of the command.
    """
    sizes = [fleet.size for fleet in checker.fleets]
    kind = type(actions[0])
    limits: Sequence[tuple[float, float]]
    leaves: Callable[[Any], Sequence[Any]]
    if kind in checker.kinds:
        limits = _limits(checker.kinds[kind])
    elif kind in SETPOINTS.values():
        limits = [(-np.inf, 0.0 if name == "z" and kind in _HEIGHTS else np.inf) for name, _, _ in walk(actions[0])]
    else:
        return None
    if isinstance(command, np.ndarray | list):
        leaves = _columns
    elif type(command) is kind and len(limits) > 1:
        leaves = operator.attrgetter(*(name for name, _, _ in walk(command)))
    else:
        return None
    return Slot(leaves, numbers, sizes, limits) if len(limits) * sum(sizes) == numbers.size else None


def _limits(kind: CommandKind) -> list[tuple[float, float]]:
    """Return (lowest, highest) allowed value of each number of a command kind."""
    return list(zip(kind.lowest.tolist(), kind.highest.tolist(), strict=True))


def _columns(command: object) -> Any:
    """Return a command's fields as an array (fields, n)."""
    return np.asarray(command).T
