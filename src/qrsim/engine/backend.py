"""Where programs come from: one way to ask for one, whichever compiler makes it.

Whoever computes worlds writes pure functions of one world (``Function``) and asks for a ``Program`` of them. Machine
code by the package's own generator is the first choice on a processor; what that refuses, and every other device, is
XLA's. Nobody outside this room knows which of the two it is, except to tell the user.

Two forms of a state go with it. That of one world is two flat buffers on the host, so that a step of a small world
costs no more than its arithmetic. Those of many worlds are a ``States``, which each compiler lays out as it likes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax
import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.engine import by_llvm, by_xla, forked
from qrsim.engine.by_llvm import state_bytes
from qrsim.engine.functions import Extent, Function
from qrsim.engine.layout import Buffers, Packer, Shared, layout_of_each
from qrsim.engine.llvm import FORMS, Looks, UnsupportedError
from qrsim.engine.settings import chosen_compiler
from qrsim.errors import UsageError

forked.watch()

__all__ = [
    "FORMS",
    "Extent",
    "Function",
    "Program",
    "Specialised",
    "States",
    "Worlds",
    "compile",
    "form_of",
    "state_bytes",
]

Tree = Any
IntArray = npt.NDArray[np.int_]


class States(Protocol):
    """The states of B worlds, as a compiler wants them to lie."""

    def get(self, select: Callable[[Tree], Tree], first: int | None = None) -> Tree:
        """Return the part of the tree of states that ``select`` picks, leaves (B, ...); of the ``first``, a copy."""

    def take(self, worlds: IntArray, other: States) -> None:
        """Overwrite the states of the worlds with these indices by the first len(worlds) of other states."""


class Program(Protocol):
    """A compiled function, bound to what all of its worlds share."""

    @property
    def compiler(self) -> str:
        """Name of the compiler that made the program, "llvm" or "xla"."""

    @property
    def refused(self) -> str:
        """Reason why XLA compiled the program although LLVM was wanted; "" otherwise."""

    @property
    def layout(self) -> Packer | None:
        """Layout of one world's state in buffers, known after the first start; None if the compiler hides it."""

    @property
    def part(self) -> int | None:
        """Number of worlds that one call of ``start`` starts; None: any number."""

    @property
    def slot(self) -> NumpyArray | None:
        """Writable buffer of the inputs set by ``give``, leaf after leaf; None if the program has no such buffer."""

    def give(self, leaves: Sequence[object]) -> None:
        """Set the inputs that differ by world, as leaves, until the next call of it; required before any other call."""

    def start(self) -> Any:
        """Return the first state of one world, or of all worlds that ``give`` has set inputs for."""

    def hold(self, tree: Tree) -> Any:
        """Convert the tree of one state, or of B states (B, ...), to the form that the program runs on."""

    def run(self, state: Any, tick: int, count: int) -> Any:
        """Advance a state by ``count`` ticks from tick number ``tick`` and return it; the old state becomes invalid."""

    def record(self, state: Buffers, tick: int, count: int, capacity: int) -> tuple[Buffers, Buffers]:
        """Advance one world by ``count`` <= capacity ticks; return its state, and those after each tick (count, ...).

        Args:
            state, tick, count: see ``run``.
            capacity: the most ticks, by which XLA compiles.
        """


def compile(
    function: Function, shared: Shared, own: Packer, state: Packer | None, extent: Extent, compiler: str
) -> Program:
    """Compile a function to a program, or take the program from memory or from the user's cache on disk.

    Args:
        function: of one world; what goes wrong inside it is raised as it is.
        shared: what all worlds have in common.
        own: layout of what each world has for itself.
        state: layout of the state that is advanced; None: the function makes a first one.
        extent: how many worlds.
        compiler: "llvm", with XLA for what that refuses, after one CompilerWarning; or "xla".
    """
    refused = ""
    if compiler == "llvm":
        try:
            return by_llvm.make(function, shared, own, state, extent)
        except UnsupportedError as why:
            refused = str(why)
    return by_xla.make(function, shared, own, state, extent, refused)


def form_of(
    function: Function, world: Tree, own: Tree, extent: Extent, form: str, start: Function | None = None
) -> str:
    """Return the program of a function for one world as text in a ``form``: graph, steps or llvm.

    Args:
        function: of one world.
        world: what all worlds have in common.
        own: what one has for itself; with ``start`` a pair, what the start is given and what the function is.
        extent: how many worlds.
        form: one of FORMS: "graph" of operations, "steps" in their order, or "llvm", the text that LLVM compiles.
        start: makes the state that the function advances; None: the function makes a first state itself.

    Raises:
        UsageError: XLA has been chosen, or the code generator does not take the function.
    """
    shared = Shared.of(world).layout
    if chosen_compiler() != "llvm":
        raise UsageError(f"the form '{form}' is one of qrsim's own compiler, and XLA is chosen")
    try:
        if start is None:
            return by_llvm.form_of(function, shared, Packer(own), None, extent, form)
        state = by_llvm.state_layout(start, shared, Packer(own[0]))
        return by_llvm.form_of(function, shared, Packer(own[1]), state, extent, form)
    except UnsupportedError as why:
        raise UsageError(f"{function.name}: qrsim's own compiler does not take {why}") from None


class Specialised:
    """The programs of one function: one for each kind of what its worlds are given.

    A kind is a structure with shapes and types: set-points of another sort, or none, make another program.

    Args:
        function: of one world; what it has for itself is a pair (``constant``, what is given).
        shared: what all worlds have in common.
        extent: how many worlds.
        compiler: that is tried.
        constant: what each world has for itself and never changes.
    """

    def __init__(self, function: Function, shared: Shared, extent: Extent, compiler: str, constant: Tree = ()):
        self.function, self.shared, self.extent, self.compiler = function, shared, extent, compiler
        self._constant, self._constant_leaves = constant, jax.tree.leaves(constant)
        self._made: dict[tuple[Packer | None, Packer], Program] = {}
        self._last: tuple[Packer | None, object, Program] | None = None

    def program(self, given: Tree, state: Packer | None = None) -> Program:
        """Return the program for the structure and types of the inputs ``given``, with these inputs set."""
        leaves, structure = jax.tree.flatten(given)
        # On the host, where what a user gave may be numbers of Python.
        leaves = [np.asarray(leaf) for leaf in leaves]
        # As text too, because to JAX structures of dataclasses that it registers itself are equal whatever their type;
        # text alone would take classes of one name for each other. Compared with
        # the last kind first, because to make a layout takes as long as a tick.
        # How many worlds are given something is no part of it: those that start again are others in every step.
        own = 0 if self.extent.worlds is None else 1
        kind = structure, repr(structure), [(leaf.shape[own:], leaf.dtype) for leaf in leaves]
        last = self._last
        if last is not None and last[0] is state and last[1] == kind:
            if leaves:
                last[2].give([*self._constant_leaves, *leaves] if self._constant_leaves else leaves)
            return last[2]
        program = self._program_of(jax.tree.unflatten(structure, leaves), state)
        program.give([*self._constant_leaves, *leaves])
        self._last = state, kind, program
        return program

    @property
    def last(self) -> Program:
        """Program that was requested last."""
        assert self._last is not None
        return self._last[2]

    def become_xla(self) -> None:
        """Use XLA, and not LLVM, for all programs from now on."""
        if self.compiler != "xla":
            self.compiler, self._last = "xla", None
            self._made.clear()

    def share(self, shared: Shared) -> None:
        """Replace the values that all worlds share by other values in a tree of the same structure."""
        self.shared, self._last = shared, None
        self._made.clear()

    def _program_of(self, given: Tree, state: Packer | None) -> Program:
        """Return the program for given inputs and a state's layout, compiled at the first call."""
        own = (self._constant, given)
        layout = Packer(own) if self.extent.worlds is None else layout_of_each(own)
        key = state, layout
        if key not in self._made:
            self._made[key] = compile(self.function, self.shared, layout, state, self.extent, self.compiler)
        return self._made[key]


class Worlds:
    """Many worlds side by side, between two ticks.

    Args:
        start: makes the first state of one, of what all share and a pair (``constant``, what the start is given).
        tick: makes the next one, of the same with what the ticks are given.
        shared: what all have in common.
        extent: how many.
        constant: what each has for itself, leaves (B, ...).
        look: fills arrays of zeros from a state, where that is asked for; ``call(shared, state, arrays, tick)``.
        looked: the arrays of one world, as shapes and types.

    Attributes:
        looks: whether there is a program of ``look``, which XLA makes none of.
        refused: why they are XLA's although machine code was wanted, "" where they are not.
    """

    def __init__(
        self,
        start: Function,
        tick: Function,
        shared: Tree,
        extent: Extent,
        constant: Tree = (),
        look: Function | None = None,
        looked: Tree = (),
    ):
        packed, compiler = Shared.of(shared), chosen_compiler()
        self._shared, self._look, self._looked = packed, look, looked
        self._looks: Looks | None = None
        self._start = Specialised(start, packed, extent, compiler, constant)
        self._tick = Specialised(tick, packed, extent, compiler, constant)
        self._extent, self.refused = extent, ""
        self._layout: Packer | None = None
        self._states: States | None = None

    @property
    def compiler(self) -> str:
        """Name of the compiler of these worlds' programs, "llvm" or "xla"."""
        return self._tick.compiler

    @property
    def started(self) -> bool:
        """Whether any world has started."""
        return self._states is not None

    def prepare(self, begins: Tree, given: Tree) -> None:
        """Compile start (inputs ``begins``) and tick (``given``) for examples (1, ...), both by the same compiler."""
        self._layout = self._checked_program(self._start, begins).layout
        self._checked_program(self._tick, given, self._layout)
        if self._look is not None and self.compiler == "llvm" and self._layout is not None:
            with contextlib.suppress(UnsupportedError):
                found = Packer(self._looked)
                self._looks = by_llvm.make_look(self._look, self._shared, self._layout, found, self._extent)

    @property
    def looks(self) -> bool:
        """Whether ``look`` is available, to compute arrays such as camera pictures."""
        return self._looks is not None

    def look(self, rows: IntArray | None = None) -> Tree:
        """Compute the on-demand arrays, such as pictures, of all worlds or those in ``rows``; leaves (b, ...)."""
        assert self._looks is not None
        states: Any = self._states
        return self._looks(states, rows)

    def _checked_program(self, function: Specialised, given: Tree, state: Packer | None = None) -> Program:
        """Return the program of a function; if LLVM cannot compile it, use XLA for all programs of these worlds."""
        program = function.program(given, state)
        if program.refused and not self.refused:
            # From here on all is XLA's: what starts again must start as before, to the last bit.
            self.refused = program.refused
            self._start.become_xla()
            self._tick.become_xla()
        return program

    def share_at_starts(self, shared: Tree) -> None:
        """Replace the values shared by worlds that start from now on; running worlds keep the old values."""
        self._start.share(Shared.of(shared))

    def begin(self, given: Tree) -> None:
        """Start all B worlds from their inputs, a tree with leaves (B, ...)."""
        program = self._checked_program(self._start, given)
        self._layout, self._states = program.layout, program.start()

    def begin_some(self, rows: IntArray, given: Tree, select: Callable[[Tree], Tree]) -> Tree:
        """Start the worlds ``rows`` (b,); return a copy of the part of their states (b, ...) that ``select`` picks.

        Args:
            rows: (b,) which.
            given: to each of them, leaves (b, ...).
            select: of a state, the part.
        """
        program = self._checked_program(self._start, given)
        self._layout = program.layout
        if program.part is None:
            return self._keep(program, rows, select)
        parts: list[Tree] = []
        for first in range(0, len(rows), program.part):
            # Parts are of one length, so that they share a program; the last one is filled up with its last world.
            filled = np.minimum(np.arange(first, first + program.part), len(rows) - 1)
            self._checked_program(self._start, jax.tree.map(lambda leaf, which=filled: leaf[which], given))
            parts.append(self._keep(program, rows[first : first + program.part], select))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def _keep(self, program: Program, rows: IntArray, select: Callable[[Tree], Tree]) -> Tree:
        """Start a program, store its first states as those of ``rows``, and return the part that ``select`` picks."""
        some: States = program.start()
        if self._states is None:
            count, tree = self._extent.worlds, some.get(lambda tree: tree)
            zeros = jax.tree.map(lambda leaf: np.zeros((count, *leaf.shape[1:]), leaf.dtype), tree)
            self._states = program.hold(zeros)
        self._states.take(rows, some)
        return some.get(select, len(rows))

    def restore(self, tree: Tree) -> None:
        """Replace the states of all worlds by a tree with leaves (B, ...), after ``prepare``."""
        self._states = self._start.last.hold(tree)

    def advance(self, tick: int, count: int, given: Tree) -> None:
        """Advance all worlds by ``count`` ticks from tick number ``tick``, with the inputs ``given`` (B, ...)."""
        program = self._checked_program(self._tick, given, self._layout)
        self._states = program.run(self._states, tick, count)

    def get(self, select: Callable[[Tree], Tree]) -> Tree:
        """Return the part of all states that ``select`` picks, each leaf (B, ...); valid until the next tick."""
        assert self._states is not None
        return self._states.get(select)

    def map(self, function: Callable[[Tree], Tree], select: Callable[[Tree], Tree]) -> Tree:
        """Apply a JAX ``function`` to the part of each world's state that ``select`` picks; return leaves (B, ...)."""
        mesh = self._extent.mesh if self.compiler == "xla" else None
        return by_xla.mapped(function, mesh, self._extent.few)(self.get(select))
