"""Vectors of a recorded stream, read as a whole."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from qrsim.runs import Run

Floats = np.ndarray[Any, Any]
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
    """

    def __init__(self, run: Run, stream: str, vectors: dict[str, tuple[str, ...] | None]):
        self._size = len(run.vehicles)
        wanted = [column for columns in vectors.values() if columns for column in columns]
        times, parts = [np.zeros(0)], {name: [np.zeros((0, self._size), np.float32)] for name in wanted}
        if wanted:
            self.stride = max(1, math.ceil(len(run[stream].time) * self._size / MOST_POSES))
            seen = 0
            for batch in run[stream].batches(wanted):
                chosen = slice(-seen % self.stride, None, self.stride)
                seen += len(batch.time)
                times.append(batch.time[chosen])
                for name in wanted:
                    parts[name].append(batch.arrays[name][chosen].astype(np.float32))
        self.time = np.concatenate(times)
        arrays = {name: np.concatenate(found) for name, found in parts.items()}
        self._vectors = {
            name: np.stack([arrays[column] for column in columns], axis=-1)
            for name, columns in vectors.items()
            if columns
        }

    def at(self, name: str, time: Any) -> Floats:
        """Return the last values (..., n, k) up to times (...) [s]; NaN where there are none."""
        shape = (*np.shape(time), self._size, 3)
        if name not in self._vectors or not len(self.time):
            return np.full(shape, np.nan, np.float32)
        # A time that was typed, or comes from a slider, may be a rounding below that of its tick.
        rows = np.searchsorted(self.time, np.asarray(time) + 1e-6, side="right") - 1
        return self._vectors[name][np.maximum(rows, 0)]


def vector(run: Run, stream: str, name: str, parts: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the columns of a vector, None if one of them was not recorded."""
    columns = tuple(f"{name}.{part}" for part in parts)
    return columns if stream in run and all(column in run[stream] for column in columns) else None
