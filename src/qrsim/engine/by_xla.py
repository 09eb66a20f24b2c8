"""Programs by XLA: for other devices, and for what the package's own code generator does not take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from qrsim.core.arrays import NumpyArray
from qrsim.engine.forked import refuse
from qrsim.engine.functions import Extent, Function
from qrsim.engine.layout import Buffers, Packer, Shared, aligned_copy
from qrsim.engine.settings import WORLDS, quick_to_compile

_Layouts = tuple[Packer, Packer]
# So many functions keep what was compiled of them; there are a start and a tick for each kind of worlds.
KEPT = 16
# Rows are started a sixteenth of a batch in a call: a large part would be wasted on few, a small one take long.
PARTS = 16


def make(
    function: Function, shared: Shared, own: Packer, state: Packer | None, extent: Extent, refused: str
) -> XlaProgram | XlaWorldsProgram:
    """Return a program that JAX compiles at its first call; ``refused``: why LLVM did not compile it."""
    if extent.worlds is None:
        return XlaProgram(function, shared, own, state, extent, refused)
    return XlaWorldsProgram(function, shared, own, extent, refused)


def _jit_for(function: Callable[..., Any], few: bool, **options: Any) -> object:
    """Return a function wrapped in ``jax.jit``; ``few``: it is of few vehicles, so compile quickly."""
    return jax.jit(function, compiler_options=quick_to_compile() if few else None, **options)


# ---- one world, its parameters and state flat: to hand JAX a hundred small arrays takes longer than a tick ----


@lru_cache(maxsize=KEPT)
def _first_function(function: Function, few: bool) -> Any:
    """Return the jitted function that computes the first state of one world; ``few``: compile quickly."""

    # The layout is static: JAX compiles anew for another one, and knows it by its equality.
    def first(layout: Packer, shared: Buffers, own: object) -> Any:
        """Return the tree of the first state."""
        return function.call(layout.unpack(shared), own)

    return _jit_for(first, few, static_argnums=0)


@lru_cache(maxsize=KEPT)
def _advance_function(function: Function, few: bool) -> Any:
    """Return the jitted function that advances one world by some ticks; ``few``: compile quickly."""

    def advance(
        layouts: tuple[Packer, Packer], shared: Buffers, own: Any, state: Buffers, tick: Any, count: object
    ) -> Any:
        """Advance a packed state by ``count`` ticks; ``layouts``: of shared values and state, ``own``: inputs."""
        common = layouts[0].unpack(shared)

        def body(i: Any, current: Any) -> Any:
            """Advance the state ``current`` by one tick, number ``i`` of the call."""
            return function.call(common, own, current, tick + i)

        return layouts[1].pack(lax.fori_loop(jnp.int32(0), count, body, layouts[1].unpack(state)))

    return _jit_for(advance, few, static_argnums=0)


@lru_cache(maxsize=KEPT)
def _record_function(function: Function, few: bool, capacity: int) -> Any:
    """Return the jitted function that records at most ``capacity`` states of one world; ``few``: compile quickly."""

    def record(layouts: _Layouts, shared: Buffers, own: Any, state: Buffers, tick: Any, count: object) -> Any:
        """Run ``count`` <= capacity ticks from ``tick``; return the packed state, and those after each tick."""
        common, layout = layouts[0].unpack(shared), layouts[1]
        rows = tuple(jnp.zeros((capacity, buffer.shape[0]), buffer.dtype) for buffer in state)

        def body(i: Any, carry: tuple[Any, Buffers]) -> tuple[Any, Any]:
            """Advance the state in ``carry`` by one tick, and store it in row ``i`` of the record in ``carry``."""
            current = function.call(common, own, carry[0], tick + i)
            packed = layout.pack(current)
            return current, tuple(
                lax.dynamic_update_index_in_dim(rows_of, part, i, 0)
                for rows_of, part in zip(carry[1], packed, strict=True)
            )

        final, kept_rows = lax.fori_loop(jnp.int32(0), count, body, (layout.unpack(state), rows))
        return layout.pack(final), kept_rows

    return _jit_for(record, few, static_argnums=0)


class XlaProgram:
    """A program of one world, its state two flat buffers; see ``backend.Program``."""

    compiler = "xla"
    part = slot = None

    def __init__(
        self, function: Function, shared: Shared, own: Packer, state: Packer | None, extent: Extent, refused: str
    ):
        self.refused, self._function, self._shared, self._few = refused, function, shared, extent.few
        self._structure = own.structure
        self._own: Any = None
        self._layout = state

    @property
    def layout(self) -> Packer:
        """Layout of one world's state in two flat buffers, known once it has started."""
        assert self._layout is not None
        return self._layout

    def give(self, leaves: Sequence[object]) -> None:
        """Set the inputs of the world."""
        self._own = jax.tree.unflatten(self._structure, leaves)

    def start(self) -> Buffers:
        """Return the first state of the world as packed buffers."""
        refuse()
        shared = self._shared
        found = _first_function(self._function, self._few)(shared.layout, shared.device_buffers, self._own)
        # Packed on the host, because a program for it would cost more to compile than it ever saves.
        state = jax.tree.map(np.asarray, found)
        self._layout = Packer(state)
        return aligned_copy(self.layout.pack(state))

    def run(self, state: Buffers, tick: int, count: int) -> Buffers:
        """Return the packed state ``count`` ticks after ``state``, which is at tick number ``tick``."""
        return aligned_copy(self._call(_advance_function(self._function, self._few), state, tick, count))

    def record(self, state: Buffers, tick: int, count: int, capacity: int) -> tuple[Buffers, Buffers]:
        """Return the state ``count`` <= capacity ticks later, and those after each tick, as buffers (count, ...)."""
        after, rows = self._call(_record_function(self._function, self._few, capacity), state, tick, count)
        floats, integers = (np.asarray(part)[:count] for part in rows)
        return aligned_copy(after), (floats, integers)

    def hold(self, tree: object) -> Buffers:
        """Convert the tree of a state to packed buffers."""
        return aligned_copy(self.layout.pack(tree))

    def _call(self, program: Any, state: Buffers, tick: int, count: int) -> Any:
        """Call a compiled program on the shared values, this world's inputs and a packed state."""
        refuse()
        layouts = self._shared.layout, self.layout
        return program(layouts, self._shared.device_buffers, self._own, state, np.int32(tick), np.int32(count))


# ---- many worlds, as trees whose leaves have the worlds as first axis ----


@lru_cache(maxsize=KEPT)
def _first_of_many_function(function: Function, few: bool, mesh: Mesh | None) -> Any:
    """Return the jitted function of many worlds' first states, split over a mesh; ``few``: compile quickly."""
    return _over_devices(jax.vmap(function.call, (None, 0)), "sr", mesh, few)


@lru_cache(maxsize=KEPT)
def _advance_many_function(function: Function, few: bool, mesh: Mesh | None) -> Any:
    """Return the jitted function that advances many worlds, split over a mesh; ``few``: compile quickly."""
    one = jax.vmap(function.call, in_axes=(None, 0, 0, None))

    def advance(shared: object, own: object, states: object, tick: object, count: object) -> Any:
        """Advance all worlds by ``count`` ticks."""
        # The tick is the same for all, so that slow sensors are really skipped.
        return lax.fori_loop(jnp.int32(0), count, lambda i, now: one(shared, own, now, tick + i), states)

    return _over_devices(advance, "srrss", mesh, few, donate_argnums=2)


@lru_cache(maxsize=KEPT)
def mapped(function: Callable[[Any], Any], mesh: Mesh | None, few: bool) -> Any:
    """Return a function of one world's state, compiled for those of many worlds (B, ...); ``few``: quickly."""
    return _over_devices(jax.vmap(function), "r", mesh, few)


def _over_devices(function: Callable[..., Any], arguments: str, mesh: Mesh | None, few: bool, **more: object) -> object:
    """Compile a function for all devices; ``arguments`` has a letter for each: r: split by world, s: shared."""
    if mesh is not None:
        # No device needs anything of another, so nothing is exchanged during a tick.
        cut, same = PartitionSpec(WORLDS), PartitionSpec()
        specs = tuple(cut if kind == "r" else same for kind in arguments)
        function = jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=cut, check_vma=False)
    return _jit_for(function, few, **more)


@lru_cache(maxsize=1)
def _replace_rows_function() -> Any:
    """Return the jitted function that replaces the states of some worlds."""

    def put(whole: object, part: object, rows: object) -> Any:
        """Return the states ``whole`` with the worlds ``rows`` replaced by ``part``."""
        return jax.tree.map(lambda every, new: every.at[rows].set(new, mode="drop"), whole, part)

    return jax.jit(put, donate_argnums=0)


class Arrays:
    """States of B worlds as a tree of JAX's arrays, each leaf (B, ...)."""

    def __init__(self, tree: object):
        self.tree = tree

    def get(self, select: Callable[[Any], Any], first: int | None = None) -> Any:
        """Return the part of the states that ``select`` picks, leaves (B, ...); or a copy of the ``first`` worlds'."""
        found = select(self.tree)
        return found if first is None else jax.tree.map(lambda leaf: np.array(leaf[:first]), found)

    def put(self, worlds: NumpyArray, tree: object) -> None:
        """Overwrite the states of ``worlds`` by the first rows of a tree's leaves; further rows are ignored."""
        count, rows = (len(jax.tree.leaves(part)[0]) for part in (self.tree, tree))
        # What goes beyond the end is dropped, so that parts of one length share a program.
        target = np.concatenate([worlds, np.full(rows - len(worlds), count)])
        self.tree = _replace_rows_function()(self.tree, tree, target)

    def take(self, worlds: NumpyArray, other: Any) -> None:
        """Overwrite the states of the worlds with these indices by the first len(worlds) of other states."""
        self.put(worlds, other.get(lambda tree: tree))


class XlaWorldsProgram:
    """A program of many worlds, their states ``Arrays``; see ``backend.Program``."""

    compiler = "xla"
    # JAX knows the layout from the states themselves.
    layout = slot = None

    def __init__(self, function: Function, shared: Shared, own: Packer, extent: Extent, refused: str):
        assert extent.worlds is not None
        self.refused, self._function, self._shared, self._extent = refused, function, shared, extent
        self._structure = own.structure
        self._own: Any = None
        self.part = max(1, extent.worlds // PARTS)

    def give(self, leaves: Sequence[object]) -> None:
        """Set the inputs that differ by world, leaves (B, ...)."""
        self._own = jax.tree.unflatten(self._structure, leaves)

    def start(self) -> Arrays:
        """Return the first states of all worlds that ``give`` has set inputs for."""
        refuse()
        program = _first_of_many_function(self._function, self._extent.few, self._extent.mesh)
        return Arrays(program(self._shared.device_tree, self._own))

    def run(self, state: Any, tick: int, count: int) -> Arrays:
        """Return the states ``count`` ticks after ``state``, which becomes invalid."""
        refuse()
        # Where machine code made the start, the states lie in its own order.
        before = state.get(lambda tree: tree)
        program = _advance_many_function(self._function, self._extent.few, self._extent.mesh)
        return Arrays(program(self._shared.device_tree, self._own, before, np.int32(tick), np.int32(count)))

    def hold(self, tree: object) -> Arrays:
        """Convert a tree of the states of B worlds (B, ...) to ``Arrays``."""
        # So that the next tick may overwrite it, which JAX does not do with arrays of NumPy.
        return Arrays(jax.device_put(tree))

    def record(self, state: object, tick: int, count: int, capacity: int) -> Any:
        """Raise an error: only a single world can be recorded tick by tick."""
        raise TypeError("many worlds are not recorded tick by tick")
