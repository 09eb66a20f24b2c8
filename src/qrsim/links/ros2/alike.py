"""Messages of one kind of many vehicles, of equal length: their numbers are put into all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2.vehicle import Publication

# Fewest messages that are filled together; fewer take less time one by one.
MANY = 4

Slot = tuple[int, str, int]


@dataclass
class _Run:
    """Numbers of one type at equal distances, of columns that follow each other.

    Attributes:
        offset: of the first byte.
        code: their type, as ``struct`` has it.
        column: of the first number.
        count: how many there are.
        stride: bytes from one to the next; 0: there is only one.
    """

    offset: int
    code: str
    column: int
    count: int = 1
    stride: int = 0

    def takes(self, offset: int, code: str, column: int) -> bool:
        """Add a number, and return True; return False if it does not continue this run."""
        stride = self.stride or offset - self.offset
        if code != self.code or column != self.column + self.count or offset != self.offset + stride * self.count:
            return False
        self.count, self.stride = self.count + 1, stride
        return True


def _runs(puts: Sequence[tuple[Slot, Sequence[int]]]) -> list[_Run]:
    """Return the numbers of slots as few runs; the columns of each slot are as many as its numbers."""
    found: list[_Run] = []
    for (offset, code, _), columns in puts:
        for place, column in enumerate(columns):
            at = offset + place * np.dtype(code).itemsize
            if not (found and found[-1].takes(at, code, column)):
                found.append(_Run(at, code, column))
    return found


class Alike:
    """Publications whose messages have their numbers at the same places.

    Args:
        publications: with equal ``Publication.form``.
        rows: of their vehicles.
    """

    def __init__(self, publications: Sequence[Publication], rows: Sequence[int]):
        first = publications[0]
        self.rows, self._needs = np.array(rows), list(first.needs)
        # A part of the vehicles one after the other needs no copy of their numbers.
        follow = self.rows.tolist() == list(range(rows[0], rows[0] + len(rows)))
        self._taken: slice | NumpyArray = slice(rows[0], rows[0] + len(rows)) if follow else self.rows
        self._bytes = np.array([np.frombuffer(bytes(each.cdr), np.uint8) for each in publications])
        size = self._bytes.shape[1]
        self._ends = [(i * size, (i + 1) * size) for i in range(len(rows))]
        self._stamps = [self._view(_Run(offset, code, 0))[:, 0] for offset, code, _ in first.stamp]
        self._puts = [(self._view(run), slice(run.column, run.column + run.count)) for run in _runs(first.puts)]
        self._status = None if first.status is None else self._view(_Run(*first.status[:2], 0))[:, 0]

    def _view(self, run: _Run) -> NumpyArray:
        """Return a writable array (k, count) on the numbers of a run in all k messages."""
        kind, (length, size) = np.dtype(f"<{run.code}"), self._bytes.shape
        return np.ndarray((length, run.count), kind, self._bytes, run.offset, (size, run.stride or kind.itemsize))

    def messages(self, numbers: NumpyArray, stamps: NumpyArray | Sequence[tuple[int, int]]) -> Sequence[bytes | None]:
        """Return the serialised messages of k publications from a row of numbers each, and their stamps (s, ns); None
        for no message.

        Args:
            numbers: (n, WIDTH) of all vehicles.
            stamps: (n, 2) of all vehicles.
        """
        own = numbers[self._taken]
        if self._stamps:
            times = np.asarray(stamps)[self._taken]
            for i, view in enumerate(self._stamps):
                view[...] = times[:, i]
        for view, columns in self._puts:
            view[...] = own[:, columns]
        if self._status is not None:
            self._status[...] = own[:, n.FIX_STATUS]
        data = self._bytes.tobytes()
        found = [data[begin:end] for begin, end in self._ends]
        unknown = np.isnan(own[:, self._needs])
        if not np.logical_or.reduce(unknown, axis=None):
            return found
        lacking = np.logical_or.reduce(unknown, axis=1).tolist()
        return [None if lacks else each for each, lacks in zip(found, lacking, strict=True)]
