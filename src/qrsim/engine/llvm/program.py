"""A compiled tick: the text put together and compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jax.extend.core import ClosedJaxpr

from qrsim.core.arrays import DType
from qrsim.core.operators import make_jaxpr
from qrsim.engine.layout import SPARE, Packer, struct
from qrsim.engine.llvm import kernels
from qrsim.engine.llvm.background import packed
from qrsim.engine.llvm.compiler import TOPDOWN, machine_code, machine_triple
from qrsim.engine.llvm.emit import Emitter
from qrsim.engine.llvm.entries import for_each, head, keeping, seated
from qrsim.engine.llvm.graph import Graph, Node, Shape, View, squeezed
from qrsim.engine.llvm.in_state import InState
from qrsim.engine.llvm.refusal import UnsupportedError, refusing
from qrsim.engine.llvm.schedule import Arena, Scheduler, all_nodes, in_place, materialised
from qrsim.engine.llvm.sharing import Sharing
from qrsim.engine.llvm.simplify import live_nodes
from qrsim.engine.llvm.strips import Grouping, Lifetimes, strip_pointer
from qrsim.engine.llvm.text import stored_bytes
from qrsim.engine.llvm.tracing import Tracer
from qrsim.engine.llvm.waiting import ALONE, NESTED
from qrsim.engine.llvm.writing import Place, Writer

# What lies in a buffer of integers.
_WHOLE = ("int32", "uint32", "bool")


@dataclass(frozen=True)
class Input:
    """One of the trees that a tick reads.

    Attributes:
        layout: how its leaves lie in two buffers.
        own: each world has its own; otherwise it is the same for all.
    """

    layout: Packer
    own: bool


@dataclass(frozen=True)
class Mode:
    """How a program uses vectors.

    Attributes:
        lanes: elements of a vector; 1 for scalars.
        side_by_side: the lanes are worlds; otherwise they are elements of the arrays of one world.
        strip: elements of the last axis of longer arrays that are computed together (see ``strips``), a multiple of
            the lanes; 0: all of them.
        among: worlds whose numbers lie side by side where one world reads its own; its result lies by itself.
    """

    lanes: int
    side_by_side: bool
    strip: int = 0
    among: int = 1

    @property
    def worlds(self) -> int:
        """Number of worlds that one call of the program advances."""
        return self.lanes if self.side_by_side else 1


@dataclass(frozen=True)
class Binary:
    """A program as it is kept.

    Attributes:
        code: machine code.
        scratch_bytes: of working memory.
        text: of better code, by ``background.packed``; empty where there is none, or where ``code`` is it.
        local_bytes: of working memory that each thread needs in addition; 0: one thread runs the program.
    """

    code: bytes
    scratch_bytes: int
    text: bytes = b""
    local_bytes: int = 0


def trace_tick(function: Callable[..., object], inputs: Sequence[Input]) -> ClosedJaxpr:
    """Trace ``function(*trees, tick)`` to a jaxpr; its result has the structure of the last of the trees.

    Args:
        function: called as function(*trees, tick) of one world.
        inputs: the trees; the last one is the state.
    """
    closed: ClosedJaxpr = make_jaxpr(function)(
        *(each.layout.template() for each in inputs), struct((), np.dtype(np.int32))
    )
    return closed


def build(
    function: Callable[..., object] | ClosedJaxpr, inputs: Sequence[Input], mode: Mode, tier: str = "quick"
) -> Binary:
    """Compile ``function(*trees, tick)``, which returns the last tree after a tick, to machine code of a ``tier``.

    Args:
        function: see ``trace_tick``, or the same traced, which then may read fewer of the trees and no tick.
        inputs: the trees; the last one is the state.
        mode: how vectors are used.
        tier: of the code, "quick" or "better"; "auto": quick code with the text of better code.

    Raises:
        UnsupportedError: the function does what this code generator cannot do.
    """
    closed = function if isinstance(function, ClosedJaxpr) else trace_tick(function, inputs)
    with refusing():
        # One text for all ticks of a call: the loop over ticks is inside, so that the state stays in the cache.
        draft = Draft(closed, inputs, mode)
        if tier == "better":
            code, text = machine_code(draft.text(kernels_inside=True)), b""
        else:
            code = machine_code(draft.text(), "quick")
            text = packed(draft.text(kernels_inside=True)) if tier == "auto" else b""
        local_bytes = draft.local.size + SPARE * 8 if draft.strip else 0
        return Binary(code, draft.arena.size + SPARE * 8, text, local_bytes)


class Draft:
    """A program on its way from a traced function to LLVM's text.

    Args:
        closed, inputs, mode: see ``build``.

    Attributes:
        graph: the operations.
        prologue, body: steps before the first tick, and those of every tick.
    """

    def __init__(self, closed: ClosedJaxpr, inputs: Sequence[Input], mode: Mode):
        self.inputs, self.lanes, self.side_by_side = tuple(inputs), mode.lanes, mode.side_by_side
        self.strip = mode.strip
        self.among = mode.among
        self.graph = Graph()
        # Memory that threads share, and of each thread.
        self.arena, self.local = Arena(), Arena()
        self.places: dict[int, Place] = {}
        self.leaves: list[list[Node]] = []
        self._trace(closed)
        self._schedule()

    def _trace(self, closed: ClosedJaxpr) -> None:
        """Build the graph of the jaxpr ``closed``, with a node for each leaf of the inputs and one for the tick."""
        views: list[View] = []
        for which, given in enumerate(self.inputs):
            layout, nodes = given.layout, []
            parts = zip(layout.shapes, layout.dtypes, layout.slices, layout.is_float, strict=True)
            for shape, dtype, part, is_float in parts:
                node = self._input(which, given, shape, dtype, part, is_float)
                nodes.append(node)
                views.append(View.whole(node, shape))
            self.leaves.append(nodes)
        self.tick = self.graph.node("input", (), (), np.dtype(np.int32), ("tick",), invariant=False, uniform=True)
        views.append(View.whole(self.tick, ()))
        alone = not self.side_by_side and self.lanes > 1
        found = Tracer(self.graph, alone).run(closed.jaxpr, closed.consts, views[: len(closed.jaxpr.invars)])
        self.results = [view.access() for view in found]

    def _input(self, which: int, given: Input, shape: Shape, dtype: DType, part: slice, is_float: bool) -> Node:
        """Return the graph node of a leaf of input number ``which``, and note its place (``part``) in the buffer."""
        # As they lie in the buffers; others would be taken for what they are not.
        if np.dtype(dtype) != given.layout.dtype if is_float else np.dtype(dtype).name not in _WHOLE:
            raise UnsupportedError(f"numbers of type {np.dtype(dtype)} from tick to tick")
        own = given.own and self.side_by_side
        # Only the state changes from tick to tick; what depends on nothing else is computed before the first.
        is_state = which == len(self.inputs) - 1
        node = self.graph.node(
            "input", (), squeezed(shape), dtype, (which, part.start, is_float), invariant=not is_state, uniform=not own
        )
        apart = self.lanes if own else self.among if given.own and not is_state else 1
        element = stored_bytes(np.dtype(dtype)) * apart
        strides = _row_major(node.shape, element)
        pointer = f"%{'floats' if is_float else 'integers'}{which}"
        self.places[node.number] = Place(pointer, part.start * element, strides, own, tight=is_state)
        return node

    def _schedule(self) -> None:
        """Order the graph nodes into steps, once before the first tick and for each tick, and place them in memory."""
        live = live_nodes(self.graph.region, self.results)
        scheduler = Scheduler(live)
        nodes = self.graph.region.nodes
        # A start depends on no tick; its loops are cut into strips as those of a tick are.
        once = self.strip and all(node.invariant or node.op == "input" for node in nodes if node.number in live)
        # The body reads the prologue from memory or registers, and never computes it again.
        self.prologue = scheduler.steps([node for node in nodes if node.invariant and not once])
        self.body = scheduler.steps([node for node in nodes if once or not node.invariant])
        self.grouping = Grouping(self.strip, {leaf.number for leaf in self.leaves[-1]})
        if self.strip:
            self.body = self.grouping.of(self.body)
            # Where nothing is cut, one thread runs the program as any other.
            self.strip = self.strip if self.grouping.extents else 0
        # A value that only its own loop reads needs no memory.
        whole, self.short = materialised([*self.prologue, *self.body], self.results)
        every, computed = whole | self.short, all_nodes([*self.prologue, *self.body])
        self.stored = {node.number for node in computed if node.number in every and not _in_register(node)}
        self.in_place = in_place([*self.prologue, *self.body])
        # These live through all ticks, so none of their places is given back.
        for node in all_nodes(self.prologue):
            if node.number in self.stored and node.number not in self.in_place:
                self.places[node.number] = self._take(node)
        in_state = InState(self.body, self.stored, self.short, self.places, self.side_by_side)
        self.late = self.grouping.late(in_state.place(self.leaves[-1], self.results), self.body, self.places)
        self._place(Lifetimes(self.body, in_state.read, self.late))
        self._place_carries()

    def _place(self, lifetimes: Lifetimes) -> None:
        """Assign memory to each stored value of the tick's body, reused after its last read (``lifetimes``)."""
        ending: dict[int, list[tuple[Arena, int, int]]] = {}
        for i, step in enumerate(self.body):
            for node in all_nodes([step]):
                if node.number in self.stored and node.number not in self.places and node.number not in self.in_place:
                    # What a branch makes for itself is not needed after the branching.
                    inner = node not in step.nodes
                    group = step.group if inner or node.number in self.short or lifetimes.local(node, i) else 0
                    place = self._take(node, group=group)
                    self.places[node.number] = place
                    end = i if inner else lifetimes.end(node, i, local=group > 0)
                    size = self._bytes(self._kept_shape(node, group), node)
                    ending.setdefault(end, []).append((self.local if group else self.arena, place.offset, size))
            for arena, offset, size in ending.pop(i, []):
                arena.give(offset, size)

    def _place_carries(self) -> None:
        """Place while loops' carries, and arrays changed in place, in the memory of their results."""
        for node in all_nodes([*self.prologue, *self.body]):
            if node.op == "while":
                for carry, output in zip(*node.attributes, strict=True):
                    self.places[carry.number] = self.places[output.number]
        for number, output in self.in_place.items():
            self.places[number] = self.places[output.number]

    def _bytes(self, shape: Shape, node: Node) -> int:
        """Return the size [bytes] of a node's value of this shape in memory, in whole vectors."""
        lanes = self.lanes if self.side_by_side and not node.uniform else 1
        return _padded(shape, self.lanes, self.side_by_side) * stored_bytes(node.dtype) * lanes

    def _spare_bytes(self, size: int) -> int:
        """Return the offset of ``size`` bytes of working memory that overlap no other value."""
        # Schedules do not know of this memory, so it must not be any that they have planned with.
        self.arena.free.clear()
        return self.arena.take(size)

    def _spare(self, node: Node, shape: Shape, group: int) -> Place:
        """Return a memory place for a temporary copy of a node's value, per thread if ``group`` is not 0."""
        (self.local if group else self.arena).free.clear()
        return self._take(node, shape, group)

    def _take(self, node: Node, shape: Shape | None = None, group: int = 0) -> Place:
        """Reserve working memory for a node's value, in each thread's own memory if its strip ``group`` is not 0."""
        whole = node.shape if shape is None else shape
        shape = self._kept_shape(node, group) if shape is None else self._cut(shape, group)
        own = self.side_by_side and not node.uniform
        element = stored_bytes(node.dtype) * (self.lanes if own else 1)
        rows = (*shape[:-1], _whole(shape[-1], self.lanes)) if shape and not self.side_by_side else shape
        arena, short = self.local if group else self.arena, node.number in self.short
        offset, pointer = arena.take(self._bytes(shape, node)), "%local" if group else "%scratch"
        if shape != whole and not short:
            pointer = strip_pointer(group, element)
        return Place(pointer, offset, _row_major(rows, element), own, short=short)

    def _kept_shape(self, node: Node, group: int) -> Shape:
        """Return the shape of a node's value that is in memory at one time: one strip if ``group`` is not 0."""
        return (*node.shape[:-1], 1) if node.number in self.short else self._cut(node.shape, group)

    def _cut(self, shape: Shape, group: int) -> Shape:
        """Return a shape with its last axis cut to a strip's length, unchanged if ``group`` is 0."""
        return (*shape[:-1], self.strip) if group and shape[-1:] == (self.grouping.extents[group],) else shape

    def text(self, kernels_inside: bool = False) -> str:
        """Return the LLVM text of the program; ``kernels_inside``: kernels are inlined, else functions."""
        writer = Emitter(self.places, self.lanes, self.side_by_side, self._spare, self._spare_bytes)
        writer.kernels_inside = kernels_inside
        shared = [f"%{kind}{i}" for i in range(len(self.inputs)) for kind in ("floats", "integers")]
        shared.append("%scratch")
        sharing = Sharing(writer, self.strip, self.grouping.extents, shared) if self.strip else None
        writer.operations.expect(access.node for access in self.results)
        before_all, after_all = flushing(writer)
        for line in before_all:
            writer.do(line)
        if sharing:
            sharing.steps(self.prologue, self.stored)
        else:
            writer.steps(self.prologue, self.stored)
        before = writer.block
        writer.do("br label %tick")
        writer.start_block("tick")
        place = len(writer.lines)
        writer.lines.append("")
        writer.do("%tick.now = add i32 %first, %done")
        writer.scalars[self.tick.number] = "%tick.now", 1
        # Copies to the state are last, when nobody reads the old state any more.
        if sharing:
            sharing.steps(self.body, self.stored, self.late)
        else:
            writer.steps(self.body, self.stored)
            for late in self.late:
                writer.move_all(late.moves)
        writer.do("%done.next = add i32 %done, 1")
        writer.do("%more = icmp ult i32 %done.next, %count")
        writer.lines[place] = f"  %done = phi i32 [0, %{before}], [%done.next, %{writer.block}]"
        writer.do("br i1 %more, label %tick, label %end")
        writer.start_block("end")
        for line in after_all:
            writer.do(line)
        writer.do("ret void")
        writer.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
        functions = [kernels.function(name, lanes) for name, lanes in sorted(writer.kernels)]
        return "\n".join(
            [
                *([TOPDOWN] if writer.topdown else []),
                writer.constants.text(),
                *sorted(writer.declarations.union(*(declared for _, declared in functions))),
                *(line for lines, _ in functions for line in lines),
                *(seated(shared, machine_triple()) if self.strip else ()),
                head(shared, self.strip > 0),
                "entry:",
                writer.constants.entry,
                *writer.entry,
                *writer.lines,
                "}",
                # The stack is aligned for vectors that are spilled to it, and vectors of 512 bits are not cut in two.
                *for_each(2 * len(self.inputs)),
                *keeping(2 * len(self.inputs), self.strip > 0),
                'attributes #0 = { nounwind "stackrealign" "prefer-vector-width"="512" '
                '"denormal-fp-math"="preserve-sign,preserve-sign" }',
            ]
        )


def flushing(writer: Writer) -> tuple[list[str], list[str]]:
    """Return LLVM lines for begin and end of a function that flush subnormal numbers to 0, as XLA does."""
    processor = machine_triple().split("-")[0]
    if processor in ("x86_64", "i686", "amd64"):
        writer.declarations |= {f"declare void @llvm.x86.sse.{name}(ptr)" for name in ("stmxcsr", "ldmxcsr")}
        writer.entry += ["  %rounding.before = alloca i32, align 4", "  %rounding.here = alloca i32, align 4"]
        begin = [
            "call void @llvm.x86.sse.stmxcsr(ptr %rounding.before)",
            "%rounding = load i32, ptr %rounding.before, align 4",
            "%rounding.flush = or i32 %rounding, 32832",
            "store i32 %rounding.flush, ptr %rounding.here, align 4",
            "call void @llvm.x86.sse.ldmxcsr(ptr %rounding.here)",
        ]
        return begin, ["call void @llvm.x86.sse.ldmxcsr(ptr %rounding.before)"]
    if processor in ("aarch64", "arm64"):
        writer.declarations |= {"declare i64 @llvm.aarch64.get.fpcr()", "declare void @llvm.aarch64.set.fpcr(i64)"}
        begin = [
            "%rounding = call i64 @llvm.aarch64.get.fpcr()",
            "%rounding.flush = or i64 %rounding, 16777216",
            "call void @llvm.aarch64.set.fpcr(i64 %rounding.flush)",
        ]
        return begin, ["call void @llvm.aarch64.set.fpcr(i64 %rounding)"]
    return [], []


def _in_register(node: Node) -> bool:
    """Return whether a graph node needs no memory, because it is a scalar computed by one instruction."""
    return node.shape == () and node.op not in ("reduce", "output", *ALONE, *NESTED)


def _row_major(shape: Shape, element: int) -> tuple[int, ...]:
    """Return the strides [bytes] of a shape with elements of ``element`` bytes, last axis fastest."""
    strides, size = [], element
    for extent in reversed(shape):
        strides.append(size)
        size *= extent
    return tuple(reversed(strides))


def _whole(extent: int, lanes: int) -> int:
    """Return an extent rounded up to a multiple of ``lanes``, for whole vectors."""
    return -(-extent // lanes) * lanes


def _padded(shape: Shape, lanes: int, side_by_side: bool) -> int:
    """Return how many elements an array takes in memory; ``side_by_side``: the lanes are worlds, else elements."""
    size = 1
    for axis, extent in enumerate(shape):
        size *= _whole(extent, lanes) if axis == len(shape) - 1 and not side_by_side else extent
    return size + (0 if side_by_side else lanes)
