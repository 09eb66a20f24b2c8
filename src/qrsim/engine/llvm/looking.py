"""Arrays that are computed from the states of many worlds, one world after the other, and only when they are asked for.

Where worlds lie side by side in the lanes of vectors, a loop takes as many turns as the world with the most of them. An
array of which each world fills another part is therefore computed for one world at a time, straight from the tile in
which its state lies, with the elements of the array in the lanes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import DType, NumpyArray
from qrsim.engine.layout import SPARE, Buffers
from qrsim.engine.llvm.calling import Program
from qrsim.engine.llvm.lanes import Lanes
from qrsim.engine.llvm.team import worker_pool

# Worlds that one thread computes before a second is worth waking.
FEW_WORLDS = 16


class Looks:
    """A program that fills arrays of zeros from the states of worlds.

    Args:
        program: reads what all worlds share and the state of one, and changes arrays, which are its last input.
        shared: values of what they share.
        workers: threads, at most.
    """

    def __init__(self, program: Program, shared: Buffers, workers: int):
        self._program, self._workers = program, workers
        self._shared = program.buffers(0)
        for mine, values in zip(self._shared, shared, strict=True):
            mine[...] = values
        self._scratches: list[NumpyArray] = []

    def __call__(self, states: Lanes, rows: NumpyArray | None = None) -> Any:
        """Return the arrays of all worlds (B, ...), or of some of them (b, ...), in memory of their own."""
        count = states.count if rows is None else len(rows)
        layout = self._program.inputs[-1].layout
        found = zeros((count, layout.sizes[0]), layout.dtype), zeros((count, layout.sizes[1]), np.dtype(np.int32))
        table = np.empty((count, 6), np.uint64)
        table[:, :2] = [part.ctypes.data for part in self._shared]
        table[:, 2:4] = states.places(np.arange(count) if rows is None else np.asarray(rows))
        for number, part in enumerate(found, 4):
            table[:, number] = part.ctypes.data + np.arange(count) * part.strides[0]
        self._run(table)
        return layout.unpack(found)

    def _run(self, table: NumpyArray) -> None:
        """Run the program for the worlds in a table of buffer addresses, on several threads for many worlds."""
        workers = min(self._workers, -(-len(table) // FEW_WORLDS))
        while len(self._scratches) < workers:
            self._scratches.append(self._program.scratch())
        parts = np.array_split(table, workers) if workers else []
        pool = worker_pool(self._workers) if workers > 1 else None
        others = [
            pool.submit(self._program.each, part, scratch.ctypes.data, 0, 1)
            for part, scratch in zip(parts[1:], self._scratches[1:], strict=False)
            if pool is not None
        ]
        if parts:
            self._program.each(parts[0], self._scratches[0].ctypes.data, 0, 1)
        for done in others:
            done.result()


def zeros(shape: tuple[int, int], dtype: DType) -> NumpyArray:
    """Return zeros in this shape, with room for one vector after the last element."""
    size = shape[0] * shape[1]
    return np.zeros(size + SPARE, dtype)[:size].reshape(shape)
