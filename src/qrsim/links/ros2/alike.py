"""Messages of one kind of many vehicles, of equal length: their numbers are put into all of them at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2.vehicle import Publication

# Fewest messages that are filled together; fewer take less time one by one.
MANY = 4


Slot = tuple[int, str, int]


def _runs(puts: Sequence[tuple[Slot, Sequence[int]]]) -> list[tuple[Slot, list[int]]]:
    """Join slots whose numbers and columns follow each other; return (slot, columns) of each run."""
    found: list[tuple[Slot, list[int]]] = []
    for (offset, code, count), columns in puts:
        if found:
            (begin, kind, size), known = found[-1]
            if kind == code and offset == begin + size * np.dtype(code).itemsize:
                found[-1] = (begin, kind, size + count), [*known, *columns]
                continue
        found.append(((offset, code, count), list(columns)))
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
        self._bytes = np.array([np.frombuffer(bytes(each.cdr), np.uint8) for each in publications])
        self._stamps = [self._view(*slot) for slot in first.stamp]
        self._puts = [(self._view(*slot), columns) for slot, columns in _runs(first.puts)]
        self._status = None if first.status is None else self._view(*first.status)

    def _view(self, offset: int, code: str, count: int) -> NumpyArray:
        """Return a writable array (k, count) on the numbers at a byte offset of all k messages; ``code``: their struct
        code."""
        kind, (length, size) = np.dtype(f"<{code}"), self._bytes.shape
        return np.ndarray((length, count), kind, self._bytes, offset, (size, kind.itemsize))

    def messages(self, numbers: NumpyArray, stamps: Sequence[tuple[int, int]]) -> list[bytes | None]:
        """Return the serialised messages of k publications from a row of numbers each, and their stamps (s, ns); None
        for no message.

        Args:
            numbers: (n, WIDTH) of all vehicles.
            stamps: of all vehicles.
        """
        own = numbers[self.rows]
        if self._stamps:
            times = np.array(stamps)[self.rows]
            for i, view in enumerate(self._stamps):
                view[:, 0] = times[:, i]
        for view, columns in self._puts:
            view[...] = own[:, columns]
        if self._status is not None:
            self._status[:, 0] = own[:, n.FIX_STATUS]
        data, size = self._bytes.tobytes(), self._bytes.shape[1]
        sent = ~np.isnan(own[:, self._needs]).any(axis=1)
        return [data[i * size : (i + 1) * size] if sends else None for i, sends in enumerate(sent.tolist())]
