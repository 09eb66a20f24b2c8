"""Many worlds advanced by one program: side by side in the lanes of vectors, one vector of them after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from qrsim.engine.layout import Buffers, Packer, aligned
from qrsim.engine.llvm.calling import Program
from qrsim.engine.llvm.program import Mode
from qrsim.engine.llvm.team import NUMBERS_OF_A_THREAD, Team, worker_pool

Array = np.ndarray[Any, Any]
# Fewer ticks than this are done before a thread has woken up.
FEW_TICKS = 8
# Ticks of a vector of worlds in a call, some hundredths of a second, because nobody can interrupt one.
AT_ONCE = 4096
# A few numbers of each world are copied by their places, which is then twice as fast, if there are no more in all.
FEW_NUMBERS, MOST_PLACES = range(2, 8), 1 << 13
_LINE = 64


class Lanes:
    """A tree of B worlds as programs take it: in tiles of as many worlds as a vector has lanes.

    Args:
        layout: of one world.
        count: B.
        mode: how programs use vectors.
    """

    def __init__(self, layout: Packer, count: int, mode: Mode):
        self._set_layout(layout, count, mode.worlds)
        self._buffers: list[Array] = []
        for size, dtype in zip(layout.sizes, (layout.dtype, np.dtype(np.int32)), strict=True):
            # Each tile begins at a line of the cache, so that two threads never write to the same one.
            line = _LINE // dtype.itemsize
            row = -(-size * self._lanes // line) * line
            self._buffers.append(aligned(self.tiles * row, dtype).reshape(self.tiles, row))

    @classmethod
    def of_one(cls, layout: Packer, buffers: Buffers) -> Lanes:
        """Wrap the buffers of one world's state, made by ``aligned``, as ``Lanes`` without a copy."""
        found = cls.__new__(cls)
        found._set_layout(layout, 1, 1)
        found._buffers = [part.reshape(1, -1) for part in buffers]
        return found

    def _set_layout(self, layout: Packer, count: int, lanes: int) -> None:
        """Set the layout of one world's state, the number of worlds, and the lanes of a vector."""
        self.layout, self.count, self._lanes = layout, count, lanes
        # Views of leaves that were read or set before, and of those of an only world, its numbers in a row.
        self._parts: dict[int, Array] = {}
        self._rows: list[Array] = []
        self._reads: dict[int, tuple[Any, ...]] = {}
        # Views of all floats and of all integers, worlds first (tiles, lanes, numbers of a world).
        self._blocks: list[Any] = [None, None]
        # What was selected last: the function, how each leaf is read, and their structure.
        self._selected: tuple[Callable[[Any], Any], list[tuple[Any, ...]], Any] | None = None
        self.tiles = -(-count // self._lanes)

    def addresses(self, tile: int) -> list[int]:
        """Return the buffer addresses of a tile: as many worlds as a vector has lanes."""
        return [buffer.ctypes.data + tile * buffer.strides[0] for buffer in self._buffers]

    def places(self, worlds: Array) -> Array:
        """Return the addresses (b, 2) uint64 of the first float and the first integer of the worlds (b,)."""
        tile, lane = np.divmod(worlds, self._lanes)
        columns = [part.ctypes.data + tile * part.strides[0] + lane * part.itemsize for part in self._buffers]
        return np.stack(columns, axis=1).astype(np.uint64)

    def fill(self, tree: object) -> None:
        """Set the states of all worlds from a tree, each leaf (B, ...); of fewer worlds the last one is repeated."""
        leaves, whole = jax.tree.leaves(tree), self.tiles * self._lanes
        for kind, (buffer, size) in enumerate(zip(self._buffers, self.layout.sizes, strict=True)):
            of_kind = zip(leaves, self.layout.is_float, strict=True)
            parts = [self._stored(leaf) for leaf, is_float in of_kind if is_float is (kind == 0)]
            if not parts:
                continue
            # All leaves at once: leaf by leaf the same would take as long as the start of a few worlds.
            rows = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
            if whole != len(rows):
                # Lanes without a world of their own repeat the last one.
                rows = rows[np.minimum(np.arange(whole), len(rows) - 1)]
            if self._blocks[kind] is None:
                block = buffer[:, : size * self._lanes].reshape(self.tiles, size, self._lanes)
                self._blocks[kind] = block.swapaxes(1, 2)
            self._blocks[kind][...] = rows.reshape(self.tiles, self._lanes, size)

    def fill_only(self, leaves: Sequence[Array]) -> None:
        """Set the only world, whose numbers lie one after the other, from its leaves."""
        if not self._rows:
            self._rows = [self._view(number).reshape(-1) for number in range(len(self.layout.slices))]
        for row, leaf in zip(self._rows, leaves, strict=True):
            # The bits of a key, not its value, which int32 may not hold.
            row[...] = (leaf.view(np.int32) if leaf.dtype == np.uint32 else leaf).reshape(-1)

    @property
    def flat(self) -> Array | None:
        """Writable view of one world's state as floats in leaf order; None if not all leaves are floats."""
        layout = self.layout
        if self.count != 1 or self._lanes != 1 or not layout.is_float or not all(layout.is_float):
            return None
        found: Array = self._buffers[0][0, : layout.sizes[0]]
        return found

    def put(self, worlds: Array, tree: object) -> None:
        """Set the states of the worlds (b,) from the first b rows of each leaf of a tree."""
        tile, lane = np.divmod(worlds, self._lanes)
        for number, leaf in enumerate(jax.tree.leaves(tree)):
            self._part(number)[tile, :, lane] = self._stored(leaf)[: len(worlds)]

    def take(self, worlds: Array, other: Any) -> None:
        """Overwrite the states of the worlds with these indices by the first len(worlds) of other states."""
        if not isinstance(other, Lanes):
            self.put(worlds, other.get(lambda tree: tree))
            return
        there, here = np.divmod(np.arange(len(worlds)), other._lanes), np.divmod(worlds, self._lanes)
        for number, size in enumerate(self.layout.sizes):
            source, target = (each._buffers[number][:, : size * each._lanes] for each in (other, self))
            # Leaf by leaf the same would take as long as a tick of a thousand worlds.
            numbers = source.reshape(other.tiles, size, other._lanes)[there[0], :, there[1]]
            target.reshape(self.tiles, size, self._lanes)[here[0], :, here[1]] = numbers

    def get(self, select: Callable[[Any], Any], first: int | None = None) -> Any:
        """Return a copy of the part of the states that ``select`` picks, each leaf (B, ...), or (first, ...)."""
        if self._selected is None or self._selected[0] is not select:
            numbers, structure = jax.tree.flatten(select(self.layout.numbers))
            self._selected = select, [self._reads.get(number) or self._read(number) for number in numbers], structure
        _, reads, structure = self._selected
        count, leaves = self.count if first is None else first, []
        # Always copies, because a view of the buffers would change at the next step.
        for part, stored, dtype, shape, places in reads:
            copy = (
                part.astype(stored, order="C").reshape(shape)[:count] if places is None else part.take(places[:count])
            )
            # The bits of a key, not its value, which int32 may not hold.
            leaves.append(copy.view(dtype))
        return structure.unflatten(leaves)

    def _part(self, number: int) -> Array:
        """Return a view of the memory of leaf ``number``: (tiles, numbers of a world, lanes)."""
        if number not in self._parts:
            self._parts[number] = self._view(number)
        return self._parts[number]

    def _view(self, number: int) -> Array:
        """Return a new view of the memory of leaf ``number``: (tiles, numbers of a world, lanes)."""
        layout = self.layout
        buffer, part = self._buffers[0 if layout.is_float[number] else 1], layout.slices[number]
        begin, end = part.start * self._lanes, part.stop * self._lanes
        return buffer[:, begin:end].reshape(self.tiles, part.stop - part.start, self._lanes)

    @staticmethod
    def _stored(leaf: object) -> Array:
        """Return a leaf (B, ...) as rows (B, size) of the dtype it is stored in."""
        array = np.asarray(leaf)
        rows = array.reshape(len(array), -1)
        if rows.dtype.kind == "f":
            return rows
        # The bits of a key, not its value, which int32 may not hold.
        return rows.view(np.int32) if rows.dtype == np.uint32 else rows.astype(np.int32)

    def _read(self, number: int) -> tuple[Any, ...]:
        """Return how leaf ``number`` is read: memory, dtype there, dtype and shape (B, ...), and places or None.

        Without places the memory is that of the leaf, worlds first; with places (B, ...) that of all leaves.
        """
        layout, dtype = self.layout, self.layout.dtypes[number]
        shape, part = (self.tiles * self._lanes, *layout.shapes[number]), self._part(number).swapaxes(1, 2)
        stored, places = np.dtype(np.int32) if dtype == np.uint32 else dtype, None
        if stored == part.dtype and part.shape[2] in FEW_NUMBERS and part.size <= MOST_PLACES:
            buffer, size = self._buffers[0 if layout.is_float[number] else 1], layout.slices[number]
            first = buffer.shape[1] * np.arange(self.tiles)[:, None, None] + np.arange(self._lanes)[:, None]
            places = (first + np.arange(size.start, size.stop) * self._lanes).reshape(shape)
            part = buffer.reshape(-1)
        self._reads[number] = part, stored, dtype, shape, places
        return self._reads[number]


class LaneProgram:
    """A program with what its worlds read, and the threads that share them out among themselves.

    Args:
        program: called with what all worlds share, what is each one's own, and the state.
        shared: values of what they share.
        own: of each world, read.
        workers: threads, at most.
    """

    def __init__(self, program: Program, shared: Buffers, own: Lanes, workers: int):
        self.own, self._program, self._workers = own, program, workers
        self._shared = program.buffers(0)
        for mine, values in zip(self._shared, shared, strict=True):
            mine[...] = values
        self._scratches: list[Array] = []
        # Addresses hold nothing alive, so the state that they are of is kept beside them.
        self._state: Lanes | None = None
        self._addresses: list[list[int]] = []
        self._tables: list[Array] = []
        self._scratch = 0
        # For a world that is large enough for several threads.
        self._team: Team | None = None

    def advance(self, state: Lanes, tick: int, count: int) -> None:
        """Advance all worlds by ``count`` ticks from tick number ``tick``; their state is overwritten."""
        if self._state is not state:
            self._set_addresses(state)
        tiles = len(self._addresses)
        if tiles == 1:
            advance = self._program if self._team is None else self._team.advance
            advance(self._addresses[0], self._scratch, tick, count)
            return
        if len(self._tables) == 1 or count * tiles < FEW_TICKS:
            for worker in range(len(self._tables)):
                self._run_worker(worker, tick, count)
            return
        # All others are begun before the first, which is this thread's.
        pool = worker_pool(self._workers)
        others = [pool.submit(self._run_worker, worker, tick, count) for worker in range(1, len(self._tables))]
        self._run_worker(0, tick, count)
        for done in others:
            done.result()

    def keep(self, state: Lanes, tick: int, rows: Buffers) -> None:
        """Advance one world by one tick per row, and write its state after each tick to that row."""
        if self._state is not state:
            self._set_addresses(state)
        keep = self._program.keeping if self._team is None else self._team.keep
        keep(self._addresses[0], self._scratch, tick, rows)

    def _set_addresses(self, state: Lanes) -> None:
        """Note the addresses of all buffers for the next call of the program."""
        # To look an address up takes longer than to run a tick of a small world.
        first = [part.ctypes.data for part in self._shared]
        own = self.own.addresses
        self._addresses = [[*first, *own(tile), *state.addresses(tile)] for tile in range(state.tiles)]
        while len(self._scratches) < min(self._workers, state.tiles):
            self._scratches.append(self._program.scratch())
        self._scratch = self._scratches[0].ctypes.data
        table, workers = np.array(self._addresses, np.uint64), len(self._scratches)
        self._tables = [np.ascontiguousarray(table[worker::workers]) for worker in range(workers)]
        self._state = state
        numbers = state.layout.sizes[0]
        threads = min(self._workers, numbers // NUMBERS_OF_A_THREAD) if self._program.local_bytes else 1
        if self._team is None and state.tiles == 1 and threads > 1:
            self._team = Team(self._program, threads, self._workers, numbers)

    def _run_worker(self, worker: int, tick: int, count: int) -> None:
        """Advance the tiles of worlds assigned to thread number ``worker`` by ``count`` ticks."""
        table, scratch = self._tables[worker], self._scratches[worker].ctypes.data
        rows = max(1, AT_ONCE // count)
        for first in range(0, len(table), rows):
            self._program.each(table[first : first + rows], scratch, tick, count)
