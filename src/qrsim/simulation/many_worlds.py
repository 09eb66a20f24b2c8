"""A block of worlds in flight, computed by this package's own machine code, or by XLA."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.engine.cache import identity
from qrsim.engine.layout import Packer
from qrsim.engine.llvm import (
    Input,
    Lanes,
    Mode,
    Program,
    Start,
    Together,
    UnsupportedError,
    build,
    build_start,
    layout_of,
    trace_of,
)
from qrsim.engine.programs import once
from qrsim.engine.settings import FEW_VEHICLES, threads, uses_llvm
from qrsim.simulation.block_parts import Carry, Setup, begin_world, programs, tick_of_world
from qrsim.simulation.one_world import mode_of_many
from qrsim.world.tick import WorldKeys


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
        self._mode = mode_of_many(self._count, vehicles, dtype)
        self._fixed = Packer(shared)
        self._shared = self._fixed.pack(shared)
        self._own_leaves = own
        host_keys = jax.tree.map(np.asarray, keys)
        self._layout, program = _begin(setup, self._fixed, layout_of((own, host_keys)), self._mode)
        self._state = Lanes(self._layout, self._count, self._mode)
        self._together(program, (own, host_keys)).advance(0, 1)
        self._last: tuple[Any, Together] | None = None

    def _together(self, program: Program, tree: Any) -> Together:
        own = Lanes(program.inputs[1].layout, self._count, self._mode)
        own.fill(tree)
        return Together(program, self._shared, own, self._state, threads())

    def advance(self, tick: int, count: int, given: Any) -> None:
        """Run ``count`` ticks."""
        leaves, structure = jax.tree.flatten(given)
        tree = (self._own_leaves, given)
        # As text, because to JAX two structures are equal whose records differ in nothing but their type.
        kind = repr(structure), [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves]
        if self._last is None or self._last[0] != kind:
            program = _advance(self._setup, self._fixed, layout_of(tree), self._layout, self._mode)
            self._last = kind, self._together(program, tree)
        elif leaves:
            self._last[1].own.fill(tree)
        self._last[1].advance(tick, count)

    def get(self, select: Callable[[Carry], Any]) -> Any:
        """Return a part of the worlds' Carry."""
        return self._state.get(select)


# What was traced last: how large it is, is asked before it is compiled.
_TRACED: dict[Any, tuple[Any, Any]] = {}


def traced_start(setup: Setup, fixed: Packer, own: Packer) -> tuple[Any, Any]:
    """Return the closed jaxpr of the start of one world, and the shapes of its Carry.

    Args:
        setup: what the rollout is made of.
        fixed: leaves that all worlds share.
        own: leaves and keys that they do not.
    """
    key = setup, identity(fixed), identity(own)
    if key not in _TRACED:
        _TRACED.clear()
        _TRACED[key] = trace_of(partial(_begin_tree, setup), (Input(fixed, own=False), Input(own, own=True)))
    return _TRACED[key]


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
        return build_start(traced_start(setup, fixed, own), inputs, mode)

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
