"""A block of worlds in flight, computed by this package's own machine code, or by XLA."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.configuration import FEW_VEHICLES, threads, uses_llvm
from qrsim.core.pack import Buffers, Packer, struct
from qrsim.native import Input, Mode, Program, Start, UnsupportedError, build, build_start, identity, once
from qrsim.rollout_parts import Carry, Setup, begin_world, programs, tick_of_world
from qrsim.ticking import mode_of
from qrsim.world import WorldKeys

Array = np.ndarray[Any, Any]


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
        self._run(self._call(program, (own, host_keys)), 0, 1)
        self._last: tuple[Any, _Call] | None = None

    def _many(self, program: Program, which: int) -> list[Buffers]:
        """Return an input's buffers, one pair for each tile."""
        return [program.buffers(which) for _ in range(self._tiles)]

    def _call(self, program: Program, tree: Any) -> _Call:
        call = _Call(program, self._shared, self._many(program, 1), min(threads(), self._tiles))
        self._fill(call, tree)
        return call

    def _fill(self, call: _Call, tree: Any) -> None:
        """Give a call the numbers of a tree, each leaf (B, ...), as what is each world's own."""
        layout, lanes = call.program.inputs[1].layout, self._mode.worlds
        whole = self._tiles * lanes
        for leaf, part, is_float in zip(jax.tree.leaves(tree), layout.slices, layout.is_float, strict=True):
            rows = np.asarray(leaf).reshape(self._count, -1)
            if rows.dtype.kind != "f":
                rows = rows.view(np.int32) if rows.dtype == np.uint32 else rows.astype(np.int32)
            if whole != self._count:
                # Lanes without a world of their own repeat the last one.
                rows = rows[np.minimum(np.arange(whole), self._count - 1)]
            for tile, pair in enumerate(call.own):
                mine = pair[0 if is_float else 1].reshape(-1, lanes)
                mine[part] = rows[tile * lanes : (tile + 1) * lanes].T

    def advance(self, tick: int, count: int, given: Any) -> None:
        """Run ``count`` ticks."""
        leaves, structure = jax.tree.flatten(given)
        tree = (self._own_leaves, given)
        # As text, because to JAX two structures are equal whose records differ in nothing but their type.
        kind = repr(structure), [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves]
        if self._last is None or self._last[0] != kind:
            program = _advance(self._setup, self._fixed, layout_of(tree), self._layout, self._mode)
            self._last = kind, self._call(program, tree)
        elif leaves:
            self._fill(self._last[1], tree)
        self._run(self._last[1], tick, count)

    def _run(self, call: _Call, tick: int, count: int) -> None:
        workers = len(call.scratches)

        def run(worker: int, workers: int) -> None:
            for tile in range(worker, self._tiles, workers):
                call(worker, tile, self._state[tile], tick, count)

        if workers == 1 or count * self._tiles < 8:
            run(0, 1)
            return
        for _ in _pool(workers).map(run, range(workers), [workers] * workers):
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


class _Call:
    """A program with what it reads and its working memory.

    Args:
        program: what is called.
        shared: values of what all worlds share.
        own: for each tile, buffers of what is each world's own.
        workers: threads that may call at the same time.
    """

    def __init__(self, program: Program, shared: Buffers, own: list[Buffers], workers: int):
        self.program, self.own = program, own
        self._shared = program.buffers(0)
        for mine, values in zip(self._shared, shared, strict=True):
            mine[...] = values
        self._first = _addresses(self._shared)
        self.scratches = [program.scratch() for _ in range(workers)]

    def __call__(self, worker: int, tile: int, state: Buffers, tick: int, count: int) -> None:
        """Advance the state of a tile."""
        addresses = [*self._first, *_addresses(self.own[tile]), *_addresses(state)]
        self.program(addresses, self.scratches[worker].ctypes.data, tick, count)


def _addresses(buffers: Sequence[Array]) -> list[int]:
    return [part.ctypes.data for part in buffers]


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


def _once(what: str, setup: Setup, layouts: tuple[Packer, ...], mode: Mode, make: Any, load: Any) -> Any:
    # Only what is made of this package alone can be told by its structure in another process.
    text = (what, setup.types, setup.varied, *map(identity, layouts), mode) if setup.plain else None
    return once((what, setup, layouts, mode), text, make, load)


def _begin(setup: Setup, fixed: Packer, own: Packer, mode: Mode) -> tuple[Packer, Program]:
    inputs = (Input(fixed, own=False), Input(own, own=True))

    def load(start: Start) -> tuple[Packer, Program]:
        layout = start.layout
        return layout, Program(start.binary, (*inputs, Input(layout, own=True)), mode)

    def make() -> Start:
        return build_start(partial(_begin_tree, setup), inputs, mode)

    found: tuple[Packer, Program] = _once("begin", setup, (fixed, own), mode, make, load)
    return found


def _advance(setup: Setup, fixed: Packer, own: Packer, carry: Packer, mode: Mode) -> Program:
    inputs = (Input(fixed, own=False), Input(own, own=True), Input(carry, own=True))
    found: Program = _once(
        "advance",
        setup,
        (fixed, own, carry),
        mode,
        lambda: build(partial(_tick_tree, setup), inputs, mode),
        lambda binary: Program(binary, inputs, mode),
    )
    return found
