"""Vectors of a recorded stream, read as a whole."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.runs import Run
from qrsim.runs.stream_arrays import Batch

# Times of vehicles that are kept in memory; of longer logs only every so-many-th tick is shown.
MOST_POSES = 3_000_000


class Columns:
    """Vectors of one stream at the times that are kept.

    Args:
        run: what is read.
        stream: its name.
        vectors: name -> its three columns; one of None is NaN.

    Attributes:
        time: (T,) [s].
        stride: every so-many-th tick is kept.
        names: of the vectors that are known.
    """

    def __init__(self, run: Run, stream: str, vectors: Mapping[str, tuple[str, ...] | None]):
        self._size = len(run.vehicles)
        known = {name: columns for name, columns in vectors.items() if columns}
        self.time, self.stride, self.names = np.zeros(0), 1, tuple(known)
        if known:
            whole = run[stream].time
            self.stride = max(1, math.ceil(len(whole) * self._size / MOST_POSES))
            self.time = whole[:: self.stride].copy()
        # Filled piece by piece: of a long log there is room for one copy only.
        self._vectors = {
            name: np.empty((len(columns), len(self.time), self._size), np.float32) for name, columns in known.items()
        }
        if known:
            self._read(run[stream].batches([column for columns in known.values() for column in columns]), known)

    def _read(self, batches: Iterable[Batch], known: dict[str, tuple[str, ...]]) -> None:
        """Copy every ``stride``-th row of logged batches into vectors; ``known``: vector name -> its columns."""
        seen = kept = 0
        for batch in batches:
            chosen = slice(-seen % self.stride, None, self.stride)
            rows = slice(kept, kept + len(batch.time[chosen]))
            seen, kept = seen + len(batch.time), rows.stop
            for name, columns in known.items():
                for part, column in enumerate(columns):
                    self._vectors[name][part, rows] = batch.arrays[column][chosen]

    def at(self, name: str, time: Any) -> Floats:
        """Return last logged values (..., n, k) of a vector up to times (...) [s], else the first; NaN if unknown."""
        shape = (*np.shape(time), self._size, 3)
        if name not in self._vectors or not len(self.time):
            return np.full(shape, np.nan, np.float32)
        # A time that was typed, or comes from a slider, may be a rounding below that of its tick.
        rows = np.searchsorted(self.time, np.asarray(time) + 1e-6, side="right") - 1
        return np.stack([part[np.maximum(rows, 0)] for part in self._vectors[name]], axis=-1)


def vector(run: Run, stream: str, name: str, parts: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the column names of a vector's ``parts`` (such as x, y, z) in a log's stream, None if one is missing."""
    columns = tuple(f"{name}.{part}" for part in parts)
    return columns if stream in run and all(column in run[stream] for column in columns) else None
