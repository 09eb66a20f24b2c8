"""From steps to LLVM's text: one function that advances some worlds by any number of ticks.

Either 16 worlds lie side by side in the lanes of a vector and every array is walked element by element (``worlds``), or
there is one world and the last axis of an array is walked 16 elements at a time (``elements``). All sums run in the
same order in both, so both give the same numbers to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from qrsim.native.graph import Access, Node, Shape, UnsupportedError
from qrsim.native.neighbours import Neighbours
from qrsim.native.operations import Operations
from qrsim.native.schedule import Step
from qrsim.native.text import literal, scalar_type, splat, stored_bytes, stored_type, suffix, vector


@dataclass(frozen=True)
class Place:
    """Where an array lies: a pointer, a byte offset, and bytes from element to element along each axis.

    Attributes:
        own: each world has its own elements, side by side.
        tight: nothing may be written behind the last element of a row.
    """

    pointer: str
    offset: int
    strides: tuple[int, ...]
    own: bool
    tight: bool = False


@dataclass
class Scope:
    """A loop nest being written."""

    domain: Shape
    variables: list[str]
    lane_axis: int | None
    values: dict[int, str]
    offsets: dict[Any, Any]


class Emitter:
    """Writes the text of steps.

    Args:
        places: of every node that is in memory.
        lanes: of a vector.
        side_by_side: the lanes are worlds, not elements.
    """

    def __init__(self, places: dict[int, Place], lanes: int, side_by_side: bool):
        self.places, self.lanes, self.side_by_side = places, lanes, side_by_side
        self.lines: list[str] = []
        self.entry: list[str] = []
        self.declarations: set[str] = set()
        self.constants: list[str] = []
        self.count = 0
        self.block = "entry"
        self.scalars: dict[int, tuple[str, int]] = {}
        self.operations = Operations(self.emit, self.declarations)
        self.scope = Scope((), [], None, {}, {})
        self._constant_places: dict[int, Place] = {}

    # Text

    def name(self, prefix: str = "v") -> str:
        """Return a fresh name."""
        self.count += 1
        return f"%{prefix}{self.count}"

    def emit(self, text: str) -> str:
        """Write an instruction with a result, and return the result's name."""
        name = self.name()
        self.lines.append(f"  {name} = {text}")
        return name

    def do(self, text: str) -> None:
        """Write an instruction without a result."""
        self.lines.append(f"  {text}")

    def start_block(self, label: str) -> None:
        """Begin a block of instructions."""
        self.lines.append(f"{label}:")
        self.block = label

    @contextmanager
    def loop(self, extent: int, step: int = 1) -> Any:
        """Write a loop over [0, extent) around what is written inside; gives the name of its counter."""
        if extent <= step:
            yield "0"
            return
        before, head, number = self.block, f"loop{self.count}", self.name("i")
        self.do(f"br label %{head}")
        self.start_block(head)
        place = len(self.lines)
        self.lines.append("")
        self.scope.offsets.clear()
        yield number
        following = self.emit(f"add nuw nsw i64 {number}, {step}")
        more = self.emit(f"icmp ult i64 {following}, {extent}")
        self.lines[place] = f"  {number} = phi i64 [0, %{before}], [{following}, %{self.block}]"
        after = f"after{self.count}"
        self.do(f"br i1 {more}, label %{head}, label %{after}")
        self.start_block(after)
        self.scope.offsets.clear()

    @contextmanager
    def counted(self, extent: str) -> Any:
        """Write a loop over [0, extent) for an extent (i32) that the program computes; gives the counter (i64)."""
        label, number = f"some{self.count}", self.name("i")
        wide = self.emit(f"zext i32 {extent} to i64")
        before = self.block
        self.do(f"br label %{label}")
        self.start_block(label)
        place = len(self.lines)
        self.lines.append("")
        more = self.emit(f"icmp ult i64 {number}, {wide}")
        self.do(f"br i1 {more}, label %{label}.one, label %{label}.after")
        self.start_block(f"{label}.one")
        self.scope.offsets.clear()
        yield number
        following = self.emit(f"add nuw nsw i64 {number}, 1")
        self.do(f"br label %{label}")
        self.lines[place] = f"  {number} = phi i64 [0, %{before}], [{following}, %{self.block}]"
        self.start_block(f"{label}.after")
        self.scope.offsets.clear()

    # Memory

    def _lanes_of(self, node: Node) -> int:
        """Return the lanes of a value of a node where it stands for itself, outside of any vector of elements."""
        return self.lanes if self.side_by_side and not node.uniform else 1

    def _address(self, place: Place, index: Sequence[tuple[str | None, int]]) -> str:
        """Return a pointer to an element; each axis is at a counter (None: none) plus an offset."""
        fixed, terms = place.offset, []
        for (variable, offset), stride in zip(index, place.strides, strict=True):
            fixed += offset * stride
            if variable is not None and variable != "0":
                terms.append((variable, stride))
        pointer = place.pointer
        for term in terms:
            pointer = self._moved(pointer, *term)
        return pointer if fixed == 0 else self.emit(f"getelementptr i8, ptr {pointer}, i64 {fixed}")

    def _moved(self, pointer: str, variable: str, stride: int) -> str:
        key = (pointer, variable, stride)
        if key not in self.scope.offsets:
            distance = self.emit(f"mul nuw nsw i64 {variable}, {stride}")
            self.scope.offsets[key] = self.emit(f"getelementptr i8, ptr {pointer}, i64 {distance}")
        return self.scope.offsets[key]

    def _load(self, dtype: Any, address: str, lanes: int) -> str:
        stored, align = stored_type(dtype), stored_bytes(dtype)
        value = self.emit(f"load {vector(stored, lanes)}, ptr {address}, align {align}")
        if dtype.kind != "b":
            return value
        return self.emit(f"icmp ne {vector('i32', lanes)} {value}, {splat('0', 'i32', lanes)}")

    def _store(self, dtype: Any, address: str, value: str, lanes: int, mask: str | None = None) -> None:
        of, align = vector(stored_type(dtype), lanes), stored_bytes(dtype)
        if dtype.kind == "b":
            value = self.emit(f"zext {vector('i1', lanes)} {value} to {of}")
        if mask is None:
            self.do(f"store {of} {value}, ptr {address}, align {align}")
            return
        name = f"llvm.masked.store.{suffix(stored_type(dtype), lanes)}.p0"
        self.declarations.add(f"declare void @{name}({of}, ptr, i32, {vector('i1', lanes)})")
        self.do(f"call void @{name}({of} {value}, ptr {address}, i32 {align}, {vector('i1', lanes)} {mask})")

    # Values

    def value(self, access: Access) -> tuple[str, int]:
        """Return the value of an access in the present loop, and its lanes."""
        node, scope = access.node, self.scope
        if node.number in self.scalars:
            return self.scalars[node.number]
        if node.number in scope.values and access.identical(scope.domain):
            return scope.values[node.number], self._width(node)
        if node.op == "constant" and node.shape == ():
            number = np.frombuffer(node.attributes[0], node.dtype)[0]
            return literal(number, node.dtype), 0
        key = (node.number, access.index)
        if key not in scope.offsets:
            scope.offsets[key] = self._read(access, self.place(node))
        found: tuple[str, int] = scope.offsets[key]
        return found

    def open_scope(self, domain: Shape, lane_axis: int | None = None) -> None:
        """Begin a loop nest that is written element by element, or in vectors along an axis."""
        self.scope = Scope(domain, ["0"] * len(domain), lane_axis, {}, {})

    def read(self, access: Access) -> tuple[str, int]:
        """Return what lies in memory at an access of the present loop, read anew."""
        return self._read(access, self.place(access.node))

    def _read(self, access: Access, place: Place) -> tuple[str, int]:
        """Return what lies in memory at an access of the present loop, and its lanes."""
        node, scope = access.node, self.scope
        index = [(None if a is None else scope.variables[a], offset) for a, offset in access.index]
        across = [i for i, (axis, _) in enumerate(access.index) if axis is not None and axis == scope.lane_axis]
        if not across:
            lanes = self._lanes_of(node)
            return self._load(node.dtype, self._address(place, index), lanes), lanes
        if len(across) == 1 and place.strides[across[0]] == stored_bytes(node.dtype):
            return self._load(node.dtype, self._address(place, index), self.lanes), self.lanes
        return self._gathered(node, place, index, across), self.lanes

    def _dynamic(self, node: Node, lanes: int) -> str:
        """Return a part of an array that begins where the program computes it."""
        access, place = node.args[0], self.place(node.args[0].node)
        starts = [self.value(start) for start in node.args[1:]]
        if all(have <= 1 for _, have in starts):
            moved = self._begun(place, node, [text for text, _ in starts])
            return self.widened(self._read(access, moved), node.dtype, lanes)
        element, result = scalar_type(node.dtype), "poison"
        own = self._lanes_of(access.node) > 1
        for lane in range(lanes):
            texts = []
            for (text, have), start in zip(starts, node.args[1:], strict=True):
                of = vector(scalar_type(start.node.dtype), have)
                texts.append(self.emit(f"extractelement {of} {text}, i32 {lane}") if have > 1 else text)
            begun = self._begun(place, node, texts)
            offset = begun.offset + (lane * stored_bytes(node.dtype) if own else 0)
            index = [(None if a is None else self.scope.variables[a], o) for a, o in access.index]
            address = self._address(Place(begun.pointer, offset, place.strides, False), index)
            one = self._load(node.dtype, address, 1)
            result = self.emit(f"insertelement {vector(element, lanes)} {result}, {element} {one}, i32 {lane}")
        return result

    def _begun(self, place: Place, node: Node, starts: list[str]) -> Place:
        """Return a place moved by starts, each brought into its range."""
        pointer = place.pointer
        for axis, moved in enumerate(node.attributes):
            if moved is None:
                continue
            which, largest = moved
            dtype = node.args[1 + which].node.dtype
            of, sign = scalar_type(dtype), "s" if dtype.kind == "i" else "u"
            text = starts[which]
            for how, limit in (("max", 0), ("min", largest)):
                self.declarations.add(f"declare {of} @llvm.{sign}{how}.{of}({of}, {of})")
                text = self.emit(f"call {of} @llvm.{sign}{how}.{of}({of} {text}, {of} {limit})")
            wide = text if of == "i64" else self.emit(f"zext {of} {text} to i64")
            distance = self.emit(f"mul i64 {wide}, {place.strides[axis]}")
            pointer = self.emit(f"getelementptr i8, ptr {pointer}, i64 {distance}")
        return Place(pointer, place.offset, place.strides, place.own)

    def _width(self, node: Node) -> int:
        if self.side_by_side:
            return self._lanes_of(node)
        return 1 if self.scope.lane_axis is None else self.lanes

    def _gathered(self, node: Node, place: Place, index: list[tuple[str | None, int]], across: list[int]) -> str:
        """Return elements that do not lie side by side as a vector; behind the last one it is read again."""
        element = scalar_type(node.dtype)
        of, result = vector(element, self.lanes), "poison"
        extent = self.scope.domain[self.scope.lane_axis]  # type: ignore[index]
        counter = self.scope.variables[self.scope.lane_axis]  # type: ignore[index]
        for lane in range(self.lanes):
            at = self.emit(f"add i64 {counter}, {lane}")
            self.declarations.add("declare i64 @llvm.umin.i64(i64, i64)")
            at = self.emit(f"call i64 @llvm.umin.i64(i64 {at}, i64 {extent - 1})")
            moved = [(at if i in across else variable, offset) for i, (variable, offset) in enumerate(index)]
            one = self._load(node.dtype, self._address(place, moved), 1)
            result = self.emit(f"insertelement {of} {result}, {element} {one}, i32 {lane}")
        return result

    def widened(self, found: tuple[str, int], dtype: Any, lanes: int) -> str:
        """Return a value in all lanes."""
        text, have = found
        if have == lanes or (have == 0 and lanes == 1):
            return text
        element = scalar_type(dtype)
        if have == 0:
            return splat(text, element, lanes)
        if have != 1:
            raise UnsupportedError("a value of one world that depends on all of them")
        of = vector(element, lanes)
        first = self.emit(f"insertelement {of} poison, {element} {text}, i32 0")
        return self.emit(f"shufflevector {of} {first}, {of} poison, <{lanes} x i32> zeroinitializer")

    def place(self, node: Node) -> Place:
        """Return where a node lies; a constant array is put into the program."""
        if node.op != "constant":
            return self.places[node.number]
        if node.number not in self._constant_places:
            array = np.frombuffer(node.attributes[0], node.dtype).reshape(node.shape)
            if array.dtype.kind == "b":
                array = array.astype(np.int32)
            # Rows are read in whole vectors.
            padded = np.zeros((*array.shape[:-1], array.shape[-1] + 2 * self.lanes), array.dtype)
            padded[..., : array.shape[-1]] = array
            element = stored_type(node.dtype)
            body = ", ".join(f"{element} {literal(v, np.dtype(array.dtype))}" for v in padded.ravel())
            symbol = f"@constant{node.number}"
            self.constants.append(f"{symbol} = private constant [{padded.size} x {element}] [{body}], align 64")
            strides = tuple(int(s) for s in padded.strides)
            self._constant_places[node.number] = Place(symbol, 0, strides, own=False)
        return self._constant_places[node.number]

    # Steps

    def steps(self, steps: list[Step], stored: set[int]) -> None:
        """Write steps; ``stored`` are the numbers of the nodes that need memory."""
        for step in steps:
            if step.kind == "cond":
                self._branching(step, stored)
            elif step.kind == "concatenate":
                self._concatenation(step.nodes[0])
            elif step.kind == "nearest":
                Neighbours(self).write(step.nodes[0])
            elif step.domain == ():
                self._straight(step)
            elif 0 not in step.domain or any(node.op == "reduce" for node in step.nodes):
                self._nest(step, stored)

    def _compute(self, node: Node, lanes: int) -> str:
        if node.op == "iota":
            return self._iota(node, lanes)
        if node.op == "dynamic_slice":
            return self._dynamic(node, lanes)
        values = [self.widened(self.value(access), access.node.dtype, lanes) for access in node.args]
        return self.operations.compute(node, values, lanes)

    def _straight(self, step: Step) -> None:
        self.scope = Scope((), [], None, {}, {})
        for node in step.nodes:
            lanes = self._lanes_of(node)
            self.scalars[node.number] = self._compute(node, lanes), lanes

    def _iota(self, node: Node, lanes: int) -> str:
        axis = node.attributes[0]
        element, counter = scalar_type(node.dtype), self.scope.variables[axis]
        if node.dtype.kind not in "iu":
            raise UnsupportedError("an iota of floating-point numbers")
        number = self.emit(f"trunc i64 {counter} to {element}") if element != "i64" else counter
        if axis != self.scope.lane_axis:
            return self.widened((number, 1), node.dtype, lanes)
        of = vector(element, lanes)
        ramp = "<" + ", ".join(f"{element} {lane}" for lane in range(lanes)) + ">"
        return self.emit(f"add {of} {self.widened((number, 1), node.dtype, lanes)}, {ramp}")

    def _nest(self, step: Step, stored: set[int]) -> None:
        """Write a loop over the kept axes, in it one over the reduced axes."""
        last = len(step.domain) - 1
        ordered = any(node.op == "reduce" and node.attributes[0] in ("add", "mul") for node in step.nodes)
        lane_axis: int | None = last
        # A sum along the vector's own axis would be taken in another order.
        if self.side_by_side or self.lanes == 1 or (last in step.reduced and ordered):
            lane_axis = None
        together = 1 if step.reduced else _together(step, lane_axis)
        scopes = [Scope(step.domain, ["0"] * len(step.domain), lane_axis, {}, {}) for _ in range(together)]
        self.scope = scopes[0]
        with self._over(step.kept, step.domain, lane_axis, together):
            self._spread_counters(scopes, lane_axis)
            accumulators = {node.number: self._accumulator(node) for node in step.nodes if node.op == "reduce"}
            with self._over(step.reduced, step.domain, lane_axis):
                if 0 not in step.domain:
                    self._body(step, scopes, accumulators, stored)
            for node in step.nodes:
                if node.op == "reduce":
                    self._finish(node, accumulators[node.number])

    def _spread_counters(self, scopes: list[Scope], lane_axis: int | None) -> None:
        """Let the further ones of several scopes stand beside the first along the axis that they share."""
        axis = _shared_axis(scopes[0].domain, lane_axis)
        for i, scope in enumerate(scopes[1:], 1):
            scope.variables[:] = scopes[0].variables
            assert axis is not None
            counter = scopes[0].variables[axis]
            scope.variables[axis] = self.emit(f"add nuw nsw i64 {counter}, {i}")
            scope.offsets.clear()

    def _body(self, step: Step, scopes: list[Scope], accumulators: dict[int, str], stored: set[int]) -> None:
        """Write one turn of a loop, or several at once, operation by operation."""
        for node in step.nodes:
            for scope in scopes:
                self.scope = scope
                if node.op == "reduce":
                    self._accumulate(node, accumulators[node.number])
                else:
                    scope.values[node.number] = self._compute(node, self._width(node))
        for scope in scopes:
            self.scope = scope
            self._keep(step, stored)
        self.scope = scopes[0]

    @contextmanager
    def _over(self, axes: Sequence[int], domain: Shape, lane_axis: int | None, together: int = 1) -> Any:
        """Write loops over some axes of the domain, ``together`` turns of one of them at once."""
        if not axes:
            yield
            return
        axis = axes[0]
        turns = together if axis == _shared_axis(domain, lane_axis) else 1
        with self.loop(domain[axis], self.lanes if axis == lane_axis else turns) as counter:
            self.scope.variables[axis] = counter
            with self._over(axes[1:], domain, lane_axis, together):
                yield

    def _keep(self, step: Step, stored: set[int]) -> None:
        # At the end, so that every read of a place comes before what is written to it.
        for node in step.nodes:
            if node.number in stored and node.op != "reduce":
                value = self.scope.values[node.number]
                self.write(self.places[node.number], node.dtype, value, self._width(node), self.scope.variables)

    def write(self, place: Place, dtype: Any, value: str, lanes: int, variables: Sequence[str]) -> None:
        """Store a value of the present loop at its element of a place."""
        wanted = self.lanes if place.own and self.side_by_side else lanes
        value = self.widened((value, lanes), dtype, wanted)
        address = self._address(place, [(v, 0) for v in variables])
        mask = None
        axis = self.scope.lane_axis
        if place.tight and axis is not None and lanes > 1 and self.scope.domain[axis] % lanes:
            mask = self.inside(self.scope.variables[axis], self.scope.domain[axis])
        self._store(dtype, address, value, wanted, mask)

    def inside(self, counter: str, extent: int) -> str:
        """Return which lanes are elements of an axis."""
        ramp = "<" + ", ".join(f"i64 {lane}" for lane in range(self.lanes)) + ">"
        of = vector("i64", self.lanes)
        at = self.emit(f"add {of} {self.widened((counter, 1), np.dtype(np.int64), self.lanes)}, {ramp}")
        return self.emit(f"icmp ult {of} {at}, {splat(str(extent), 'i64', self.lanes)}")

    # Reductions

    def _reduced_width(self, node: Node) -> int:
        operand = node.args[0].node
        if self.side_by_side:
            return self._lanes_of(operand) if operand.op != "constant" else 1
        return 1 if self.scope.lane_axis is None else self.lanes

    def _accumulator(self, node: Node) -> str:
        lanes, pointer = self._reduced_width(node), self.name("sum")
        of = vector(stored_type(node.dtype), lanes)
        self.entry.append(f"  {pointer} = alloca {of}, align 64")
        self._store(node.dtype, pointer, splat(self._neutral(node), scalar_type(node.dtype), lanes), lanes)
        return pointer

    @staticmethod
    def _neutral(node: Node) -> str:
        how, dtype = node.attributes[0], node.dtype
        if how in ("add", "or"):
            return literal(0, dtype)
        if how == "mul":
            return literal(1, dtype)
        if how == "and":
            return literal(True, dtype) if dtype.kind == "b" else "-1"
        if dtype.kind == "f":
            return literal(math.inf if how == "min" else -math.inf, dtype)
        if dtype.kind == "b":
            return literal(how == "min", dtype)
        limits = np.iinfo(dtype)
        return str(limits.max if how == "min" else limits.min)

    def _accumulate(self, node: Node, pointer: str) -> None:
        lanes = self._reduced_width(node)
        access = node.args[0]
        value = self.widened(self.value(access), node.dtype, lanes)
        axis = self.scope.lane_axis
        if axis is not None and axis in node.attributes[1] and self.scope.domain[axis] % lanes:
            inside = self.inside(self.scope.variables[axis], self.scope.domain[axis])
            of = vector(scalar_type(node.dtype), lanes)
            neutral = splat(self._neutral(node), scalar_type(node.dtype), lanes)
            value = self.emit(f"select {vector('i1', lanes)} {inside}, {of} {value}, {of} {neutral}")
        before = self._load(node.dtype, pointer, lanes)
        self._store(
            node.dtype, pointer, self.operations.combine(node.attributes[0], node.dtype, lanes, before, value), lanes
        )

    def _finish(self, node: Node, pointer: str) -> None:
        lanes, axis = self._reduced_width(node), self.scope.lane_axis
        value = self._load(node.dtype, pointer, lanes)
        if axis is not None and axis in node.attributes[1]:
            of, element = vector(scalar_type(node.dtype), lanes), scalar_type(node.dtype)
            parts = [self.emit(f"extractelement {of} {value}, i32 {lane}") for lane in range(lanes)]
            value, lanes = parts[0], 1
            for part in parts[1:]:
                value = self.operations.combine(node.attributes[0], node.dtype, 1, value, part)
            assert element
        kept = [v for a, v in enumerate(self.scope.variables) if a not in node.attributes[1]]
        place = self.places[node.number]
        wanted = self.lanes if place.own and self.side_by_side else lanes
        self._store(
            node.dtype,
            self._address(place, [(v, 0) for v in kept]),
            self.widened((value, lanes), node.dtype, wanted),
            wanted,
        )

    # Moves

    def _concatenation(self, node: Node) -> None:
        axis, begins, shapes = node.attributes
        place = self.places[node.number]
        for access, begin, shape in zip(node.args, begins, shapes, strict=False):
            # A part of one element has no axis here; the others have all of the whole's.
            whole = len(shape) == len(node.shape)
            moved = Place(
                place.pointer, place.offset + begin * place.strides[axis],
                place.strides if whole else tuple(s for a, s in enumerate(place.strides) if a != axis),
                place.own, place.tight,
            )  # fmt: skip
            # Parts are written in order, so that what is written behind one is overwritten by the next.
            self.copy(access, shape, moved)

    def copy(self, access: Access, shape: Shape, to: Place) -> None:
        """Write a loop that copies an array to a place."""
        if 0 in shape:
            return
        lane_axis = len(shape) - 1 if shape and not self.side_by_side and self.lanes > 1 else None
        if lane_axis is not None and to.strides[lane_axis] != stored_bytes(access.node.dtype):
            lane_axis = None
        self.scope = Scope(shape, ["0"] * len(shape), lane_axis, {}, {})
        with self._over(range(len(shape)), shape, lane_axis):
            found, lanes = self.value(access)
            wide = max(1, lanes) if lane_axis is None else self.lanes
            value = self.widened((found, lanes), access.node.dtype, wide)
            self.write(to, access.node.dtype, value, wide, self.scope.variables)

    def move_all(self, moves: list[tuple[Access, Shape, Place]], spare: Callable[[Node, Shape], Place]) -> None:
        """Write copies that all read before any of them writes; ``spare`` gives places for what must wait."""
        targets = {(to.pointer, to.offset) for _, _, to in moves}
        later: list[tuple[Access, Shape, Place]] = []
        for access, shape, to in moves:
            source = None if self._in_register(access.node) else self.place(access.node)
            if source is not None and source == to and access.identical(shape):
                continue
            if source is not None and (source.pointer, source.offset) in targets:
                place = spare(access.node, shape)
                self.copy(access, shape, place)
                later.append((self._stand_in(access.node, shape, place), shape, to))
            else:
                later.append((access, shape, to))
        for access, shape, to in later:
            self.copy(access, shape, to)

    def _in_register(self, node: Node) -> bool:
        return node.number in self.scalars or (node.op == "constant" and node.shape == ())

    def _stand_in(self, node: Node, shape: Shape, place: Place) -> Access:
        self.count += 1
        copy = Node("input", (), shape, node.dtype, uniform=node.uniform, number=-self.count)
        self.places[copy.number] = place
        return Access(copy, tuple((axis, 0) for axis in range(len(shape))))

    # Branches

    def _branching(self, step: Step, stored: set[int]) -> None:
        cond, outputs = step.nodes[0], step.nodes[1:]
        self.scope = Scope((), [], None, {}, {})
        which, lanes = self.value(cond.args[0])
        if lanes > 1:
            raise UnsupportedError("a branch that each world takes for itself")
        dtype = cond.args[0].node.dtype
        taken = which if dtype.kind == "b" else self.emit(f"icmp ne {scalar_type(dtype)} {which}, 0")
        label = f"branch{self.count}"
        self.count += 1
        self.do(f"br i1 {taken}, label %{label}.true, label %{label}.false")
        outside = dict(self.scalars)
        for place, (region, steps) in enumerate(zip(cond.regions, step.branches, strict=True)):
            self.start_block(f"{label}.{'true' if place else 'false'}")
            self.steps(steps, stored)
            moves = [
                (region.results[node.attributes[0]], node.shape, self.places[node.number])
                for node in outputs if node.op == "output"
            ]  # fmt: skip
            self.move_all(moves, self.spare)
            self.do(f"br label %{label}.after")
            self.scalars = dict(outside)
        self.start_block(f"{label}.after")

    def spare_bytes(self, size: int) -> int:
        """Return the offset of working memory; replaced by whoever owns the memory."""
        raise NotImplementedError

    def spare(self, node: Node, shape: Shape) -> Place:
        """Return memory for a copy that waits; replaced by whoever owns the memory."""
        raise NotImplementedError


def _shared_axis(domain: Shape, lane_axis: int | None) -> int | None:
    """Return the axis along which several turns of a loop can be taken at once: the last but the vector's own."""
    axes = [axis for axis in range(len(domain)) if axis != lane_axis]
    return axes[-1] if axes else None


def _together(step: Step, lane_axis: int | None) -> int:
    """Return how many turns of a loop are written as one.

    One turn of a body of some hundred operations that wait for each other fills what the processor looks ahead, and
    few of them run at once. A shorter body needs no help, and a longer one no more of it than its registers hold.
    """
    axis = _shared_axis(step.domain, lane_axis)
    if axis is None or not 100 <= len(step.nodes) <= 200:
        return 1
    return next((turns for turns in (4, 2) if step.domain[axis] % turns == 0), 1)
