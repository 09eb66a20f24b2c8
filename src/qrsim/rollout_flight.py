"""A block of worlds in flight, computed by this package's own machine code, or by XLA."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.configuration import FEW_VEHICLES, threads, uses_llvm
from qrsim.core.pack import Buffers, Packer, struct
from qrsim.native import Binary, Input, Mode, Program, Start, UnsupportedError, build, build_start, identity, kept
from qrsim.rollout_parts import Carry, Setup, begin_world, programs, tick_of_world
from qrsim.ticking import mode_of
from qrsim.world import WorldKeys

log = logging.getLogger(__name__)
Array = np.ndarray[Any, Any]
# Programs of this process, by all that they depend on; None where the generator cannot make one.
_PROGRAMS: dict[Any, Any] = {}


class Flight:
    """Some worlds between two ticks.

    Args:
        setup: what the rollout is made of.
        fixed: leaves of the World that all worlds share.
        own: leaves (B, ...) that they do not.
        keys: of all randomness, each leaf (B, ...).
        vehicles: of one world.
        devices: of JAX, that B is a multiple of.
    """

    def __init__(self, setup: Setup, fixed: list[Any], own: list[Any], keys: WorldKeys, vehicles: int, devices: int):
        count = len(jax.tree.leaves(keys)[0])
        self._setup, self._fixed, self._own = setup, fixed, own
        self._few = vehicles * count <= FEW_VEHICLES * devices
        self._native: NativeFlight | None = None
        self._carry: Any = None
        if uses_llvm():
            with contextlib.suppress(UnsupportedError):
                self._native = NativeFlight(setup, fixed, own, keys, vehicles)
        if self._native is None:
            self._carry = programs(setup, self._few).begin(fixed, keys, own)

    @property
    def is_native(self) -> bool:
        """Whether it is computed by this package's own machine code."""
        return self._native is not None

    def advance(self, tick: int, count: int, given: Any) -> None:
        """Run ``count`` ticks; ``given`` holds actions and estimates that were asked for, each leaf (B, ...)."""
        if self._native is not None:
            try:
                self._native.advance(tick, count, given)
                return
            except UnsupportedError:
                self._carry = self._native.get(lambda carry: carry)
                self._native = None
        program = programs(self._setup, self._few).advance
        self._carry = program(self._fixed, self._own, self._carry, np.int32(tick), np.int32(count), given)

    def get(self, select: Callable[[Carry], Any]) -> Any:
        """Return a part of the worlds' Carry, each leaf (B, ...)."""
        return select(self._carry) if self._native is None else self._native.get(select)


class NativeFlight:
    """A flight computed by our own machine code: a few worlds at a time, for as many ticks as nobody looks.

    Args:
        setup: what the rollout is made of.
        fixed: leaves of the World that all worlds share.
        own: leaves (B, ...) that they do not.
        keys: of all randomness, each leaf (B, ...).
        vehicles: of one world.

    Raises:
        UnsupportedError: XLA has to compute it.
    """

    def __init__(self, setup: Setup, fixed: list[Any], own: list[Any], keys: WorldKeys, vehicles: int):
        self._setup = setup
        self._count = len(jax.tree.leaves(keys)[0])
        shared = [np.asarray(leaf) for leaf in fixed]
        dtype = next((leaf.dtype for leaf in [*shared, *own] if leaf.dtype.kind == "f"), np.dtype(np.float32))
        self._mode = _mode(self._count, vehicles, dtype)
        self._tiles = -(-self._count // self._mode.worlds)
        self._fixed = Packer(shared)
        self._shared = self._fixed.pack(shared)
        self._own_leaves = own
        host_keys = jax.tree.map(np.asarray, keys)
        self._layout, program = _begin(setup, self._fixed, layout_of((own, host_keys)), self._mode)
        self._state = self._many(program, 2)
        self._scratches: dict[int, list[Any]] = {}
        self._run(program, self._filled(program, 1, (own, host_keys)), 0, 1)
        self._given: tuple[Any, Any, Any] = (None, None, None)

    def _many(self, program: Program, which: int) -> list[Buffers]:
        """Return an input's buffers, one pair for each tile."""
        return [program.buffers(which) for _ in range(self._tiles)]

    def _filled(self, program: Program, which: int, tree: Any) -> list[Buffers]:
        """Return an input's buffers for all tiles with the numbers of a tree, each leaf (B, ...)."""
        layout, lanes = program.inputs[which].layout, self._mode.worlds
        buffers = self._many(program, which)
        whole = self._tiles * lanes
        for leaf, part, is_float in zip(jax.tree.leaves(tree), layout.slices, layout.is_float, strict=True):
            rows = np.asarray(leaf).reshape(self._count, -1)
            if rows.dtype.kind != "f":
                rows = rows.view(np.int32) if rows.dtype == np.uint32 else rows.astype(np.int32)
            if whole != self._count:
                # Lanes without a world of their own repeat the last one.
                rows = rows[np.minimum(np.arange(whole), self._count - 1)]
            for tile, pair in enumerate(buffers):
                mine = pair[0 if is_float else 1].reshape(-1, lanes)
                mine[part] = rows[tile * lanes : (tile + 1) * lanes].T
        return buffers

    def advance(self, tick: int, count: int, given: Any) -> None:
        """Run ``count`` ticks."""
        leaves, structure = jax.tree.flatten(given)
        tree = (self._own_leaves, given)
        if leaves or self._given[0] is None or self._given[0] != structure:
            layout = layout_of(tree)
            program = _advance(self._setup, self._fixed, layout, self._layout, self._mode)
            self._given = structure, program, self._filled(program, 1, tree)
        _, program, own = self._given
        self._run(program, own, tick, count)

    def _run(self, program: Program, own: Any, tick: int, count: int) -> None:
        shared = program.buffers(0)
        for mine, values in zip(shared, self._shared, strict=True):
            mine[...] = values
        first = [part.ctypes.data for part in shared]

        def run(tiles: range) -> None:
            scratch = program.scratch()
            for tile in tiles:
                parts = (*own[tile], *self._state[tile])
                program([*first, *(part.ctypes.data for part in parts)], scratch.ctypes.data, tick, count)

        workers = min(threads(), self._tiles)
        if workers == 1 or count * self._tiles < 8:
            run(range(self._tiles))
            return
        shares = [range(worker, self._tiles, workers) for worker in range(workers)]
        for _ in _pool(workers).map(run, shares):
            pass

    def get(self, select: Callable[[Carry], Any]) -> Any:
        """Return a part of the worlds' Carry."""
        return jax.tree.map(self._leaf, select(self._layout.numbers()))

    def _leaf(self, number: int) -> Array:
        layout, lanes = self._layout, self._mode.worlds
        which, part = (0 if layout.is_float[number] else 1), layout.slices[number]
        rows = np.concatenate([pair[which].reshape(-1, lanes)[part].T for pair in self._state])[: self._count]
        shaped = rows.reshape(self._count, *layout.shapes[number])
        dtype = layout.dtypes[number]
        if dtype == np.uint32:
            return np.ascontiguousarray(shaped).view(np.uint32)
        return shaped if shaped.dtype == dtype else shaped.astype(dtype)


def _mode(count: int, vehicles: int, dtype: np.dtype[Any]) -> Mode:
    """Return how vectors are used: worlds side by side where there are enough, or vehicles too few for a vector."""
    lanes = 64 // dtype.itemsize
    alone = count == 1 or (vehicles > lanes and count < lanes)
    return mode_of(vehicles, dtype) if alone else Mode(lanes, side_by_side=True)


def layout_of(tree: Any) -> Packer:
    """Return the layout of one world's part of a tree, each leaf (B, ...)."""
    return Packer(jax.tree.map(lambda leaf: struct(np.shape(leaf)[1:], np.asarray(leaf).dtype), tree))


_POOLS: dict[int, ThreadPoolExecutor] = {}


def _pool(workers: int) -> ThreadPoolExecutor:
    if workers not in _POOLS:
        _POOLS[workers] = ThreadPoolExecutor(workers, thread_name_prefix="qrsim-rollout")
    return _POOLS[workers]


def _begin_tree(setup: Setup, fixed: list[Any], own: tuple[list[Any], WorldKeys]) -> Carry:
    return begin_world(setup, fixed, own[1], own[0])


def _tick_tree(setup: Setup, fixed: list[Any], own: tuple[list[Any], Any], carry: Carry, tick: Any) -> Carry:
    return tick_of_world(setup, fixed, own[0], carry, tick, own[1])


def _made(what: str, setup: Setup, layouts: tuple[Packer, ...], mode: Mode, make: Callable[[], Any]) -> Any:
    """Return a program from this process, from the cache, or made anew.

    Raises:
        UnsupportedError: it cannot be made.
    """
    key = (what, setup, layouts, mode)
    if key not in _PROGRAMS:
        # Only what is made of this package alone can be told by its structure in another process.
        parts = (what, setup.types, setup.varied, *map(identity, layouts), mode)
        try:
            _PROGRAMS[key] = kept(parts, make) if setup.plain else make()
        except UnsupportedError as why:
            log.debug("%s compiled by XLA, because of %s", what, why)
            _PROGRAMS[key] = why
    found = _PROGRAMS[key]
    if isinstance(found, UnsupportedError):
        raise found
    return found


_LOADED: dict[Any, Any] = {}


def _begin(setup: Setup, fixed: Packer, own: Packer, mode: Mode) -> tuple[Packer, Program]:
    inputs = (Input(fixed, own=False), Input(own, own=True))
    start: Start = _made(
        "begin", setup, (fixed, own), mode, lambda: build_start(partial(_begin_tree, setup), inputs, mode)
    )
    if id(start) not in _LOADED:
        layout = start.layout
        _LOADED[id(start)] = start, layout, Program(start.binary, (*inputs, Input(layout, own=True)), mode)
    return _LOADED[id(start)][1:]


def _advance(setup: Setup, fixed: Packer, own: Packer, carry: Packer, mode: Mode) -> Program:
    inputs = (Input(fixed, own=False), Input(own, own=True), Input(carry, own=True))
    binary: Binary = _made(
        "advance", setup, (fixed, own, carry), mode, lambda: build(partial(_tick_tree, setup), inputs, mode)
    )
    if id(binary) not in _LOADED:
        _LOADED[id(binary)] = binary, Program(binary, inputs, mode)
    found: Program = _LOADED[id(binary)][1]
    return found
