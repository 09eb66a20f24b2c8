"""Programs by the package's own code generator, for processors."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import DType, NumpyArray
from qrsim.core.garbage import uncollected
from qrsim.engine.cache import GENERATOR, Known, identity, keep, kept, look_up
from qrsim.engine.functions import Extent, Function
from qrsim.engine.layout import Buffers, Packer, Shared, aligned, aligned_copy
from qrsim.engine.llvm import (
    Binary,
    Input,
    LaneProgram,
    Lanes,
    Looks,
    Mode,
    Program,
    build,
    digest,
    printed,
    state_of,
    trace_of,
    trace_tick,
)
from qrsim.engine.llvm.compiler import vector_bytes
from qrsim.engine.llvm.refusal import refusing
from qrsim.engine.programs import compiled, discard_unused
from qrsim.engine.settings import available_cores, threads, tier

# What was traced last, because how large a state is, is asked before its start is compiled.
_TRACED: dict[Any, tuple[Any, Any]] = {}
_BYTES: dict[Any, int] = {}
# A world of at least this many vehicles is computed in strips of this many, which stay in the second cache of a core.
MANY_VEHICLES, STRIP = 1024, 256


def mode_of(vehicles: int, dtype: DType) -> Mode:
    """Return how a program of one world uses vectors: lanes over its vehicles, half vectors for a few vehicles."""
    # A few vehicles fill half a vector, which takes no longer than a whole one that is half empty.
    most = vector_bytes() // dtype.itemsize
    strip = STRIP if vehicles >= MANY_VEHICLES else 0
    return Mode(most // 2 if 1 < vehicles <= most // 2 else most, side_by_side=False, strip=strip)


def mode_of_many(count: int, vehicles: int, dtype: DType) -> Mode:
    """Return how a program of ``count`` worlds uses vectors: lanes over worlds, or over vehicles if worlds are few."""
    lanes = vector_bytes() // dtype.itemsize
    # Lanes without a world of their own would be computed for nothing.
    alone = count == 1 or (vehicles > lanes and count < lanes)
    return mode_of(vehicles, dtype) if alone else Mode(lanes, side_by_side=True)


def make(function: Function, shared: Shared, own: Packer, state: Packer | None, extent: Extent) -> LlvmProgram:
    """Return an LLVM program from memory or the user's cache, or compile it; see ``qrsim.engine.backend.compile``.

    Raises:
        UnsupportedError: the code generator does not take the function.
    """
    mode = mode_of_many(extent.worlds or 1, extent.vehicles, extent.dtype)
    layouts = [shared.layout, own] if state is None else [shared.layout, own, state]
    program = compiled(
        (function.name, function.of, *layouts, mode), lambda: _loaded(function, shared.layout, own, state, mode)
    )
    return LlvmProgram(program, shared, own, extent)


def make_look(function: Function, shared: Shared, state: Packer, found: Packer, extent: Extent) -> Looks:
    """Return a program that computes arrays on demand, such as camera pictures, from the states of worlds.

    Args:
        function: ``call(shared, state, arrays, tick)`` of one world returns the arrays, in place of zeros.
        shared: what all worlds have in common.
        state: layout of the state of one.
        found: layout of the arrays.
        extent: how many worlds.

    Raises:
        UnsupportedError: the code generator does not take the function.
    """
    among = mode_of_many(extent.worlds or 1, extent.vehicles, extent.dtype).worlds
    # Two vectors at once, because each operation waits for the one before.
    mode = Mode(2 * vector_bytes() // extent.dtype.itemsize, side_by_side=False, among=among)
    program = compiled(
        (function.name, function.of, shared.layout, state, found, mode),
        lambda: _loaded(function, shared.layout, state, found, mode),
    )
    return Looks(program, shared.buffers, threads())


def form_of(function: Function, shared: Packer, own: Packer, state: Packer | None, extent: Extent, form: str) -> str:
    """Return a program as text in one of the FORMS: graph, steps or LLVM; see ``qrsim.engine.llvm.printed``.

    Raises:
        UnsupportedError: the code generator does not take the function.
    """
    closed, layout = _traced_with_state(function, shared, own, state)
    mode = mode_of_many(extent.worlds or 1, extent.vehicles, extent.dtype)
    return printed(closed, _input_kinds(shared, own, layout), mode, form)


def state_layout(start: Function, shared: Packer, own: Packer) -> Packer:
    """Return the buffer layout of the state that ``start`` returns (``own``: layout of each world's inputs)."""
    with uncollected():
        return _traced_with_state(start, shared, own, None)[1]


def _loaded(function: Function, shared: Packer, own: Packer, state: Packer | None, mode: Mode) -> Program:
    """Load a program from the user's cache, or compile it (``own``: layout of each world's inputs)."""
    before = [shared, own] if state is None else [shared, own, state]
    what = None if function.text is None else (function.name, *function.text, *map(identity, before), mode)
    # A start runs once, so quick code is enough.
    wanted = "quick" if state is None and tier() == "auto" else tier()
    known: Known | None = None if what is None else look_up(what)
    binary = None if known is None else _kept_code(known.program, wanted)
    if known is None or binary is None:
        known, binary = _made(function, shared, own, state, mode, wanted)
        if what is not None and known.program:
            keep(what, known)
    layout, program = known.state or state, known.program
    assert layout is not None

    def keep_better(better: Binary) -> None:
        """Store the better machine code in the cache."""
        if program:
            keep(("code", program, "better"), better, GENERATOR)

    with refusing():
        # Code from the cache may not load on this machine after all, and then XLA has it too.
        return Program(binary, _input_kinds(shared, own, layout), mode, keep_better)


def _made(
    function: Function, shared: Packer, own: Packer, state: Packer | None, mode: Mode, wanted: str
) -> tuple[Known, Binary]:
    """Trace a function and compile it to the tier ``wanted``, unless cached; return its metadata and machine code."""
    closed, layout = _traced_with_state(function, shared, own, state)
    inputs, program = _input_kinds(shared, own, layout), digest(closed)
    # How the leaves lie in the buffers; of their structure the code knows nothing.
    lying = [(each.layout.shapes, each.layout.dtypes, each.own) for each in inputs]
    key = "" if program is None else hashlib.sha256(repr((program, lying, mode)).encode()).hexdigest()
    binary = _kept_code(key, wanted)
    if binary is None:
        binary = build(closed, inputs, mode, wanted)
        if key:
            keep(("code", key, wanted), binary, GENERATOR)
    return Known(key, layout if state is None else None), binary


def _traced_with_state(function: Function, shared: Packer, own: Packer, state: Packer | None) -> tuple[Any, Packer]:
    """Return a traced function and the layout of its state; errors of the function itself pass unchanged."""
    if state is not None:
        return trace_tick(function.call, _input_kinds(shared, own, state)), state
    closed, shape = _traced(function, shared, own)
    return closed, state_of(shape)


def _input_kinds(shared: Packer, own: Packer, state: Packer) -> tuple[Input, ...]:
    """Describe the inputs of a program by their layouts: what worlds share, what each has (``own``), and the state."""
    return Input(shared, own=False), Input(own, own=True), Input(state, own=True)


def _kept_code(program: str, wanted: str) -> Binary | None:
    """Return cached machine code of the ``wanted`` tier or an equivalent one; None if there is none."""
    if not program:
        return None
    for each in {"auto": ("better", "auto"), "quick": ("quick", "auto"), "better": ("better",)}[wanted]:
        found: Binary | None = look_up(("code", program, each), GENERATOR)
        if found is not None:
            return found
    return None


def _traced(function: Function, shared: Packer, own: Packer) -> tuple[Any, Any]:
    """Return the jaxpr and result shapes of a function, reused if ``state_bytes`` has traced it before."""
    found = _TRACED.pop((function, identity(shared), identity(own)), None)
    return found or trace_of(function.call, (Input(shared, own=False), Input(own, own=True)))


# Kept, because to trace a start only to see its size takes as long as a short flight.
def state_bytes(function: Function, shared: Packer, own: Packer) -> int:
    """Return the size [bytes] of the state of one world, from a trace of ``function`` without compiling it.

    Args:
        function: that makes a first state.
        shared, own: layouts of what it reads.
    """
    known = function.name, function.of
    found = _BYTES.get(known)
    if found is None:
        key = function, identity(shared), identity(own)

        def count() -> int:
            """Return the size [bytes] of the function's result."""
            _TRACED.clear()
            with uncollected():
                traced = _TRACED[key] = _traced(function, shared, own)
            return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(traced[1]))

        text = None if function.text is None else ("bytes per world", *function.text, *key[1:])
        discard_unused(_BYTES)
        found = _BYTES[known] = count() if text is None else kept(text, count)
    return found


class LlvmProgram:
    """A program of one world, its state two flat buffers, or of many, theirs ``Lanes``; see ``backend.Program``.

    Args:
        program: the machine code.
        shared: what all worlds have in common.
        own: layout of what each has for itself.
        extent: how many.
    """

    compiler, refused = "llvm", ""
    part = None

    def __init__(self, program: Program, shared: Shared, own: Packer, extent: Extent):
        self.layout, self._own_layout, self._extent = program.inputs[-1].layout, own, extent
        self._make = partial(LaneProgram, program, shared.buffers, workers=min(threads(), available_cores()))
        self._mode = program.mode
        self._program: LaneProgram | None = None
        self._flat: NumpyArray | None = None
        # First states of a few of many worlds, kept for the next few; None: those of other numbers of worlds.
        self._few: Lanes | None = None
        # The state that was advanced last, and the same as lanes.
        self._last: tuple[Any, Lanes | None] = (None, None)

    def give(self, leaves: Sequence[Any]) -> None:
        """Set the inputs that differ by world."""
        if self._flat is not None:
            np.concatenate([leaf.ravel() for leaf in leaves], out=self._flat)
            return
        worlds = self._extent.worlds
        count = 1 if worlds is None else len(leaves[0]) if leaves else worlds
        few = worlds is not None and count < worlds and count <= self._mode.worlds
        if few:
            # A few of many start again at every step: they share one vector, which is made once.
            count = self._mode.worlds
        if self._program is None or self._program.own.count != count or few is (self._few is None):
            self._program = self._make(own=Lanes(self._own_layout, count, self._mode))
            self._few = Lanes(self.layout, count, self._mode) if few else None
        own = self._program.own
        if worlds is not None:
            own.fill(leaves)
        else:
            own.fill_only(leaves)
            # A command for one world is handed over at every step, where a copy leaf by leaf would count.
            self._flat = own.flat

    @property
    def slot(self) -> NumpyArray | None:
        """Writable buffer of one world's inputs; None if they are not all floats."""
        return self._flat if self._own_layout.slices else np.zeros(0, self._extent.dtype)

    def start(self) -> Any:
        """Return the first state of each world that ``give`` has set inputs for.

        States of fewer worlds than all are those of a vector of them, and valid until the next start.
        """
        assert self._program is not None
        if self._few is not None:
            self._program.advance(self._few, 0, 1)
            return self._few
        if self._extent.worlds is not None:
            state = Lanes(self.layout, self._program.own.count, self._mode)
            self._program.advance(state, 0, 1)
            # Most starts are of other numbers of worlds, and this memory is not needed again.
            self._program = None
            return state
        floats, integers = (
            aligned(size, dtype)
            for size, dtype in zip(self.layout.sizes, (self.layout.dtype, np.dtype(np.int32)), strict=True)
        )
        return self.run((floats, integers), 0, 1)

    def hold(self, tree: object) -> Lanes | Buffers:
        """Convert the tree of one state, or of B states (B, ...), to this program's buffers or lanes."""
        if self._extent.worlds is None:
            return aligned_copy(self.layout.pack(tree))
        states = Lanes(self.layout, self._extent.worlds, self._mode)
        states.fill(tree)
        return states

    def run(self, state: Any, tick: int, count: int) -> Any:
        """Advance a state in place by ``count`` ticks, and return it."""
        assert self._program is not None
        self._program.advance(self._lanes(state), tick, count)
        return state

    def _lanes(self, state: Any) -> Lanes:
        """Return the state as ``Lanes``, converted once per state."""
        last, lanes = self._last
        if last is not state or lanes is None:
            lanes = state if isinstance(state, Lanes) else Lanes.of_one(self.layout, state)
            self._last = state, lanes
        return lanes

    def record(self, state: Any, tick: int, count: int, capacity: int) -> tuple[Any, Buffers]:
        """Advance one world by ``count`` <= capacity ticks; return its state and that after each tick (count, ...)."""
        assert self._program is not None
        floats, integers = (np.empty((count, part.size), part.dtype) for part in state)
        if count:
            self._program.keep(self._lanes(state), tick, (floats, integers))
        return state, (floats, integers)
