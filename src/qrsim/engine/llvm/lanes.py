"""Many worlds advanced by one program: side by side in the lanes of vectors, one vector of them after the other."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from qrsim.engine.layout import Buffers, Packer, struct
from qrsim.engine.llvm.program import Mode, Program, aligned

Array = np.ndarray[Any, Any]
# Fewer ticks than this are done before a thread has woken up.
FEW_TICKS = 8
_LINE = 64


def layout_of(tree: Any) -> Packer:
    """Return the layout of one world's part of a tree, each leaf (B, ...)."""
    return Packer(jax.tree.map(lambda leaf: struct(np.shape(leaf)[1:], np.asarray(leaf).dtype), tree))


class Lanes:
    """A tree of B worlds as programs take it: in tiles of as many worlds as a vector has lanes.

    Args:
        layout: of one world.
        count: B.
        mode: how programs use vectors.
    """

    def __init__(self, layout: Packer, count: int, mode: Mode):
        self.layout, self.count, self._lanes = layout, count, mode.worlds
        self.tiles = -(-count // self._lanes)
        self._buffers: list[Array] = []
        for size, dtype in zip(layout.sizes, (layout.dtype, np.dtype(np.int32)), strict=True):
            line = _LINE // dtype.itemsize
            row = -(-size * self._lanes // line) * line
            self._buffers.append(aligned(self.tiles * row, dtype).reshape(self.tiles, row))

    def addresses(self, tile: int) -> list[int]:
        """Return where the buffers of a tile begin."""
        return [buffer.ctypes.data + tile * buffer.strides[0] for buffer in self._buffers]

    def fill(self, tree: Any) -> None:
        """Take a tree, each leaf (B, ...)."""
        whole = self.tiles * self._lanes
        for number, leaf in enumerate(jax.tree.leaves(tree)):
            rows = self._stored(leaf)
            if whole != self.count:
                # Lanes without a world of their own repeat the last one.
                rows = rows[np.minimum(np.arange(whole), self.count - 1)]
            self._part(number)[...] = rows.reshape(self.tiles, self._lanes, -1).swapaxes(1, 2)

    def put(self, worlds: Array, tree: Any) -> None:
        """Take a tree of some worlds, each leaf (len(worlds), ...)."""
        tile, lane = np.divmod(worlds, self._lanes)
        for number, leaf in enumerate(jax.tree.leaves(tree)):
            self._part(number)[tile, :, lane] = self._stored(leaf)

    def get(self, select: Callable[[Any], Any]) -> Any:
        """Return a part of the tree, each leaf (B, ...), copied."""
        return jax.tree.map(self._leaf, select(self.layout.numbers()))

    def _part(self, number: int) -> Array:
        """Return a leaf's place (tiles, numbers of a world, lanes)."""
        layout = self.layout
        buffer, part = self._buffers[0 if layout.is_float[number] else 1], layout.slices[number]
        begin, end = part.start * self._lanes, part.stop * self._lanes
        return buffer[:, begin:end].reshape(self.tiles, part.stop - part.start, self._lanes)

    @staticmethod
    def _stored(leaf: Any) -> Array:
        array = np.asarray(leaf)
        rows = array.reshape(len(array), -1)
        if rows.dtype.kind == "f":
            return rows
        return rows.view(np.int32) if rows.dtype == np.uint32 else rows.astype(np.int32)

    def _leaf(self, number: int) -> Array:
        part, dtype = self._part(number), self.layout.dtypes[number]
        shape = (self.tiles * self._lanes, *self.layout.shapes[number])
        rows = np.ascontiguousarray(part.swapaxes(1, 2)).reshape(shape)[: self.count]
        if dtype == np.uint32:
            return rows.view(np.uint32)
        # A view of the buffers would change under whoever holds it.
        return rows.astype(dtype, copy=np.may_share_memory(rows, part))


class Together:
    """A program, what its worlds read, and their state.

    Args:
        program: called with what all worlds share, what is each one's own, and the state.
        shared: values of what they share.
        own: of each world, read.
        state: of each world, advanced.
        workers: threads.
    """

    def __init__(self, program: Program, shared: Buffers, own: Lanes, state: Lanes, workers: int):
        self.own, self._program, self._workers = own, program, min(workers, state.tiles)
        self._shared = program.buffers(0)
        for mine, values in zip(self._shared, shared, strict=True):
            mine[...] = values
        self._scratches = [program.scratch() for _ in range(self._workers)]
        first = [part.ctypes.data for part in self._shared]
        self._addresses = [[*first, *own.addresses(tile), *state.addresses(tile)] for tile in range(state.tiles)]
        # Addresses hold nothing alive.
        self._state = state

    def advance(self, tick: int, count: int) -> None:
        """Run ``count`` ticks of all worlds."""
        if self._workers == 1 or count * len(self._addresses) < FEW_TICKS:
            self._run(0, self._addresses, tick, count)
            return
        shares = [self._addresses[worker :: self._workers] for worker in range(self._workers)]
        for done in [_pool(self._workers).submit(self._run, i, share, tick, count) for i, share in enumerate(shares)]:
            done.result()

    def _run(self, worker: int, tiles: Sequence[list[int]], tick: int, count: int) -> None:
        scratch = self._scratches[worker].ctypes.data
        for addresses in tiles:
            self._program(addresses, scratch, tick, count)


_POOLS: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, "register_at_fork"):
    # A process that is forked off has none of the threads.
    os.register_at_fork(after_in_child=_POOLS.clear)


def _pool(workers: int) -> ThreadPoolExecutor:
    if workers not in _POOLS:
        _POOLS[workers] = ThreadPoolExecutor(workers, thread_name_prefix="qrsim-worlds")
    return _POOLS[workers]
