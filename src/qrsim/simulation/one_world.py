"""How the ticks of one world are computed: by this package's own machine code, or by XLA.

Both take and return the state in two flat NumPy buffers, see ``qrsim.engine.layout``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from qrsim.engine.cache import identity
from qrsim.engine.layout import Buffers, Packer
from qrsim.engine.llvm import Input, Mode, Program, Start, UnsupportedError, aligned, build, build_start, trace_of
from qrsim.engine.programs import once
from qrsim.engine.settings import FEW_VEHICLES, quick_jit, uses_llvm
from qrsim.simulation.placing import place
from qrsim.world import tick as ticks_of
from qrsim.world.tick import State, World, WorldKeys


def mode_of(vehicles: int, dtype: np.dtype[Any]) -> Mode:
    """Return how a world on its own is computed: side by side its vehicles, or a single one's draws and satellites."""
    most = 64 // dtype.itemsize
    return Mode(most // 2 if 1 < vehicles <= most // 2 else most, side_by_side=False)


def mode_of_many(count: int, vehicles: int, dtype: np.dtype[Any]) -> Mode:
    """Return how ``count`` worlds are computed: side by side where there are enough, or vehicles too few."""
    lanes = 64 // dtype.itemsize
    alone = count == 1 or (vehicles > lanes and count < lanes)
    return mode_of(vehicles, dtype) if alone else Mode(lanes, side_by_side=True)


class NativeTicks:
    """One world, computed by our own machine code; by XLA where that cannot be had.

    Args:
        world: the parameters.
    """

    def __init__(self, world: World):
        self.world = world
        host = jax.tree.map(np.asarray, world)
        self.layout = Packer(host)
        self.parameters = self.layout.pack(host)
        self._size = sum(fleet.size for fleet in world.fleets)
        self._mode = mode_of(self._size, self.layout.dtype)
        self._instead: XlaTicks | None = None
        self._ready: dict[Any, _Call | None] = {}
        self._last: tuple[Packer, Any, _Call | None] | None = None

    @property
    def instead(self) -> XlaTicks:
        """XLA's way of computing this world."""
        if self._instead is None:
            self._instead = XlaTicks(self.world)
        return self._instead

    def reset(self, keys: WorldKeys) -> tuple[Packer, Buffers]:
        """Return the first state and its layout."""
        keys = jax.tree.map(np.asarray, keys)
        key_layout = Packer(keys)
        inputs = (Input(self.layout, own=False), Input(key_layout, own=True))
        try:
            layout, program = _start(inputs, self._mode)
        except UnsupportedError:
            return self.instead.reset(keys)
        call = _Call(program, [self.parameters, key_layout.pack(keys)])
        state = call.state()
        call(state, 0, 1)
        return layout, state

    def adopt(self, layout: Packer, state: Buffers) -> Buffers:
        """Return a state as ``advance`` takes it: a copy where vectors may begin."""
        buffers = tuple(aligned(part.size, np.dtype(part.dtype)) for part in state)
        for mine, given in zip(buffers, state, strict=True):
            mine[...] = given
        return buffers

    def advance(self, layout: Packer, state: Buffers, tick: int, count: int, given: Any) -> Buffers:
        """Run ``count`` ticks; the state is overwritten, and returned.

        Args:
            layout: of the state.
            state: what ``reset``, ``adopt`` or this returned.
            tick: the first one.
            count: ticks.
            given: actions and estimates of each fleet.
        """
        call = self._call(layout, given)
        if call is None:
            return self.adopt(layout, self.instead.advance(layout, state, tick, count, given))
        call(state, tick, count)
        return state

    def record(
        self, layout: Packer, state: Buffers, tick: int, count: int, given: Any, capacity: int
    ) -> tuple[Buffers, Buffers]:
        """Run ``count`` ticks; return the state and those of all ticks, each buffer (count, ...)."""
        call = self._call(layout, given)
        if call is None:
            after, rows = self.instead.record(layout, state, tick, count, given, capacity)
            return self.adopt(layout, after), rows
        kept_rows = tuple(np.empty((count, part.size), part.dtype) for part in state)
        for i in range(count):
            call(state, tick + i, 1)
            for rows_of, part in zip(kept_rows, state, strict=True):
                rows_of[i] = part
        return state, kept_rows  # type: ignore[return-value]

    def place(self, layout: Packer, state: Buffers, tick: int, given: Any) -> Buffers:
        """Return another state, with vehicles put somewhere; see ``qrsim.simulation.placing.place``."""
        call = self._found(layout, given, "place")
        if call is None:
            return self.adopt(layout, self.instead.place(layout, state, tick, given))
        changed = self.adopt(layout, state)
        call.fill(1, list(given))
        call(changed, tick, 1)
        return changed

    def _call(self, layout: Packer, given: Any) -> _Call | None:
        leaves, structure = jax.tree.flatten(given)
        # Compared with the last one first, because to make a layout takes as long as a tick.
        leaves = [np.asarray(leaf) for leaf in leaves]
        kind = (repr(structure), [(leaf.shape, leaf.dtype) for leaf in leaves])
        if self._last is None or self._last[0] is not layout or self._last[1] != kind:
            self._last = layout, kind, self._found(layout, jax.tree.map(np.asarray, given))
        call = self._last[2]
        if call is not None and leaves:
            call.fill(1, leaves)
        return call

    def _found(self, layout: Packer, given: Any, what: str = "tick") -> _Call | None:
        given_layout = Packer(given)
        key = (what, layout, given_layout)
        if key not in self._ready:
            inputs = (Input(self.layout, own=False), Input(given_layout, own=True), Input(layout, own=True))
            try:
                self._ready[key] = _Call(_program(what, inputs, self._mode), [self.parameters, None])
            except UnsupportedError:
                self._ready[key] = None
        return self._ready[key]


class _Call:
    """A program with its working memory and the addresses of what it reads."""

    def __init__(self, program: Program, parts: list[Buffers | None]):
        self._program = program
        self._scratch = program.scratch()
        self._inputs = [program.buffers(i) for i in range(len(parts))]
        self._addresses = [part.ctypes.data for buffers in self._inputs for part in buffers]
        self._state: tuple[Any, list[int]] = (None, [])
        for i, part in enumerate(parts):
            if part is not None:
                self.give(i, part)
        self._scratch_address = self._scratch.ctypes.data

    def give(self, which: int, values: Buffers) -> None:
        """Take other values of an input."""
        for mine, given in zip(self._inputs[which], values, strict=True):
            mine[...] = given

    def fill(self, which: int, leaves: list[Any]) -> None:
        """Take other values of an input, leaf by leaf."""
        if all(self._program.inputs[which].layout.is_float):
            np.concatenate([leaf.ravel() for leaf in leaves], out=self._inputs[which][0])
        else:
            layout = self._program.inputs[which].layout
            self.give(which, layout.pack(jax.tree.unflatten(layout.structure, leaves)))

    def state(self) -> Buffers:
        """Return an empty state."""
        return self._program.buffers(len(self._inputs))

    def __call__(self, state: Buffers, tick: int, count: int) -> None:
        """Advance a state in place."""
        if self._state[0] is not state:
            self._state = state, [part.ctypes.data for part in state]
        self._program([*self._addresses, *self._state[1]], self._scratch_address, tick, count)


def _tick(world: World, given: Any, state: State, tick: Any) -> State:
    return ticks_of.step(world, state, tick, *given)


_CHANGES: dict[str, Callable[[World, Any, State, Any], State]] = {"tick": _tick, "place": place}


def _program(what: str, inputs: tuple[Input, ...], mode: Mode) -> Program:
    """Return the program of a change of the state, a tick or vehicles put somewhere."""
    found: Program = once(
        (what, inputs, mode),
        (what, *(identity(given.layout) for given in inputs), mode),
        lambda: build(_CHANGES[what], inputs, mode),
        lambda binary: Program(binary, inputs, mode),
    )
    return found


def _start(inputs: tuple[Input, ...], mode: Mode) -> tuple[Packer, Program]:
    def load(start: Start) -> tuple[Packer, Program]:
        layout = start.layout
        return layout, Program(start.binary, (*inputs, Input(layout, own=True)), mode)

    found: tuple[Packer, Program] = once(
        ("start", inputs, mode),
        ("start", *(identity(given.layout) for given in inputs), mode),
        lambda: build_start(trace_of(ticks_of.reset, inputs), inputs, mode),
        load,
    )
    return found


class _Compiled:
    """A function compiled by XLA with the options that suit the number of vehicles."""

    def __init__(self, function: Callable[..., Any], **options: Any):
        self._few = quick_jit(function, **options)
        self._many = jax.jit(function, **options)

    def __call__(self, vehicles: int, *arguments: Any) -> Any:
        return (self._few if vehicles <= FEW_VEHICLES else self._many)(*arguments)


def _reset_world(world_layout: Packer, world: Buffers, keys: WorldKeys) -> State:
    return ticks_of.reset(world_layout.unpack(world), keys)


def _advance_world(
    world_layout: Packer, layout: Packer, world: Buffers, state: Buffers, tick: Any, count: Any, given: Any
) -> Buffers:
    """Run ``count`` ticks and return the packed state."""
    parameters = world_layout.unpack(world)

    def body(i: Any, current: State) -> State:
        return ticks_of.step(parameters, current, tick + i, *given)

    return layout.pack(lax.fori_loop(jnp.int32(0), count, body, layout.unpack(state)))


def _record_world(
    world_layout: Packer, layout: Packer, world: Buffers, state: Buffers, tick: Any, count: Any, given: Any,
    capacity: int,
) -> tuple[Buffers, Buffers]:  # fmt: skip
    """Run ``count`` <= capacity ticks; return the packed state and every packed state on the way."""
    parameters = world_layout.unpack(world)
    rows = tuple(jnp.zeros((capacity, buffer.shape[0]), buffer.dtype) for buffer in state)

    def body(i: Any, carry: tuple[State, Buffers]) -> tuple[State, Buffers]:
        current = ticks_of.step(parameters, carry[0], tick + i, *given)
        packed = layout.pack(current)
        kept_rows = tuple(lax.dynamic_update_index_in_dim(r, p, i, 0) for r, p in zip(carry[1], packed, strict=True))
        return current, kept_rows

    final, kept_rows = lax.fori_loop(jnp.int32(0), count, body, (layout.unpack(state), rows))
    return layout.pack(final), kept_rows


def _place_world(
    world_layout: Packer, layout: Packer, world: Buffers, state: Buffers, tick: Any, given: Any
) -> Buffers:
    return layout.pack(place(world_layout.unpack(world), given, layout.unpack(state), tick))


_reset = _Compiled(_reset_world, static_argnums=0)
_place = _Compiled(_place_world, static_argnums=(0, 1))
_advance = _Compiled(_advance_world, static_argnums=(0, 1))
_record = _Compiled(_record_world, static_argnums=(0, 1, 7))


class XlaTicks:
    """One world, computed by XLA; the methods are those of ``NativeTicks``.

    Args:
        world: the parameters.
    """

    def __init__(self, world: World):
        self.layout = Packer(world)
        self.parameters = self.layout.pack(jax.tree.map(np.asarray, world))
        self._parameters: Buffers = jax.device_put(self.parameters)
        self._size = sum(fleet.size for fleet in world.fleets)

    def reset(self, keys: WorldKeys) -> tuple[Packer, Buffers]:
        """Return the first state and its layout."""
        # Packed on the host, because a program for it would cost more to compile than it ever saves.
        state = jax.tree.map(np.asarray, _reset(self._size, self.layout, self._parameters, keys))
        layout = Packer(state)
        return layout, layout.pack(state)

    def adopt(self, layout: Packer, state: Buffers) -> Buffers:
        """Return a state as ``advance`` takes it."""
        return state

    def advance(self, layout: Packer, state: Buffers, tick: int, count: int, given: Any) -> Buffers:
        """Run ``count`` ticks and return the state."""
        first, number = np.int32(tick), np.int32(count)
        after = _advance(self._size, self.layout, layout, self._parameters, state, first, number, given)
        return np.asarray(after[0]), np.asarray(after[1])

    def place(self, layout: Packer, state: Buffers, tick: int, given: Any) -> Buffers:
        """Return another state, with vehicles put somewhere; see ``qrsim.simulation.placing.place``."""
        after = _place(self._size, self.layout, layout, self._parameters, state, np.int32(tick), given)
        return np.asarray(after[0]), np.asarray(after[1])

    def record(
        self, layout: Packer, state: Buffers, tick: int, count: int, given: Any, capacity: int
    ) -> tuple[Buffers, Buffers]:
        """Run ``count`` ticks; return the state and those of all ticks, each buffer (count, ...)."""
        after, rows = _record(
            self._size, self.layout, layout, self._parameters, state, np.int32(tick), np.int32(count), given, capacity
        )
        floats, integers = (np.asarray(part)[:count] for part in rows)
        return (np.asarray(after[0]), np.asarray(after[1])), (floats, integers)


def ticks(world: World) -> NativeTicks | XlaTicks:
    """Return what computes a world on this machine."""
    return NativeTicks(world) if uses_llvm() else XlaTicks(world)
