"""LLVM's text under construction: blocks, loops, and what lies in memory.

Either worlds lie side by side in the lanes of a vector and every array is walked element by element (``worlds``), or
there is one world and the last axis of an array is walked a vector at a time (``elements``). All sums run in the
same order in both, so both give the same numbers to the bit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qrsim.core.arrays import DType
from qrsim.engine.llvm.compiler import vector_bytes
from qrsim.engine.llvm.constants import Constants
from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.text import literal, scalar_type, splat, stored_bytes, stored_type, suffix, vector

# For each axis of an array: which start moves it and the largest that it may be, None where it stands still.
Moves = tuple[tuple[int, int] | None, ...]


@dataclass(frozen=True)
class Place:
    """Where an array lies: a pointer, a byte offset, and bytes from element to element along each axis.

    Attributes:
        own: each world has its own elements, side by side.
        tight: nothing may be written behind the last element of a row.
        short: only the present element, or vector of elements, of the last axis lies there.
    """

    pointer: str
    offset: int
    strides: tuple[int, ...]
    own: bool
    tight: bool = False
    short: bool = False

    @property
    def local(self) -> bool:
        """Whether the place is in the working memory of one thread."""
        return self.pointer.startswith("%local")


@dataclass
class Scope:
    """A loop nest being written; ``row`` has values (n,) of the present element of the last axis, made before it."""

    domain: Shape
    variables: list[str]
    lane_axis: int | None
    values: dict[int, str]
    offsets: dict[Any, Any]
    row: dict[int, str] = field(default_factory=dict)


class Writer:
    """Writes instructions, loops over elements, and reads and writes of arrays.

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
        self.constants = Constants()
        # Kernels that are called, each with its lanes; none where they are written out.
        self.kernels: set[tuple[str, int]] = set()
        self.kernels_inside = False
        # Whether LLVM should keep the order of the text more than it does by default.
        self.topdown = False
        self.count = 0
        self.block = "entry"
        self.scalars: dict[int, tuple[str, int]] = {}
        self.scope = Scope((), [], None, {}, {})
        # Whether loads in turn are so far from each other that the processor does not foresee them.
        self.far = False
        self._constant_places: dict[int, Place] = {}
        # Instructions of the present block whose results may be used again, by their text.
        self._written: dict[str, str] = {}

    # Text

    def name(self, prefix: str = "v") -> str:
        """Return a fresh LLVM name that begins with ``prefix``."""
        self.count += 1
        return f"%{prefix}{self.count}"

    def emit(self, text: str) -> str:
        """Append an LLVM instruction with a result, and return the result's name."""
        name = self.name()
        self.lines.append(f"  {name} = {text}")
        return name

    def once(self, text: str) -> str:
        """Return the name of the result of an instruction without side effects, emitted at most once per block."""
        if text not in self._written:
            self._written[text] = self.emit(text)
        return self._written[text]

    def do(self, text: str) -> None:
        """Append an LLVM instruction without a result."""
        self.lines.append(f"  {text}")

    def start_block(self, label: str) -> None:
        """Begin a basic block of LLVM instructions with this label."""
        self.lines.append(f"{label}:")
        self.block = label
        self._written.clear()

    @contextmanager
    def loop(self, extent: int, step: int = 1, part: tuple[str, str] | None = None) -> Iterator[str]:
        """Emit a loop over [0, extent), or its ``part`` (begin, end), around the context's code; yield its counter."""
        if extent <= step and part is None:
            yield "0"
            return
        before, head, number, (begin, end) = self.block, f"loop{self.count}", self.name("i"), part or ("0", str(extent))
        self.do(f"br label %{head}")
        self.start_block(head)
        place = len(self.lines)
        self.lines.append("")
        self.scope.offsets.clear()
        yield number
        following = self.emit(f"add nuw nsw i64 {number}, {step}")
        more = self.emit(f"icmp ult i64 {following}, {end}")
        self.lines[place] = f"  {number} = phi i64 [{begin}, %{before}], [{following}, %{self.block}]"
        after = f"after{self.count}"
        self.do(f"br i1 {more}, label %{head}, label %{after}")
        self.start_block(after)
        self.scope.offsets.clear()

    # Memory

    def _lanes_of(self, node: Node) -> int:
        """Return the lanes of a graph node's scalar value: one for each world side by side, or 1."""
        return self.lanes if self.side_by_side and not node.uniform else 1

    def address(self, place: Place, index: Sequence[tuple[str | None, int]]) -> str:
        """Emit the address of an element of a place; ``index``: (loop counter or None, offset) for each axis."""
        fixed, pointer = place.offset, place.pointer
        if place.short:
            index = [*index[:-1], (None, 0)]
        for (variable, offset), stride in zip(index, place.strides, strict=True):
            fixed += offset * stride
            if variable is not None and variable != "0":
                pointer = self._moved(pointer, variable, stride)
        return pointer if fixed == 0 else self.once(f"getelementptr i8, ptr {pointer}, i64 {fixed}")

    def _moved(self, pointer: str, variable: str, stride: int) -> str:
        """Emit, at most once, the pointer that is ``variable`` times ``stride`` bytes further, and return its name."""
        key = (pointer, variable, stride)
        # What lies in one row is read from one address, which is computed once.
        if key not in self.scope.offsets:
            self.scope.offsets[key] = self.emit(f"getelementptr [{stride} x i8], ptr {pointer}, i64 {variable}")
        return self.scope.offsets[key]

    def load(self, dtype: DType, address: str, lanes: int) -> str:
        """Emit a load of ``lanes`` elements from an address, and return the value's name."""
        stored, align = stored_type(dtype), stored_bytes(dtype)
        value = self.emit(f"load {vector(stored, lanes)}, ptr {address}, align {align}")
        if dtype.kind != "b":
            return value
        return self.emit(f"icmp ne {vector('i32', lanes)} {value}, {splat('0', 'i32', lanes)}")

    def store(self, dtype: DType, address: str, value: str, lanes: int, mask: str | None = None) -> None:
        """Emit a store of a value to an address, only of the lanes in ``mask`` if given."""
        of, align = vector(stored_type(dtype), lanes), stored_bytes(dtype)
        if dtype.kind == "b":
            value = self.emit(f"zext {vector('i1', lanes)} {value} to {of}")
        if mask is None:
            self.do(f"store {of} {value}, ptr {address}, align {align}")
            return
        # The lanes behind the end belong to whatever lies next.
        if mask.startswith("<") and vector_bytes() < 64:
            self._store_first(stored_type(dtype), address, value, lanes, mask.count("true"), align)
            return
        name = f"llvm.masked.store.{suffix(stored_type(dtype), lanes)}.p0"
        self.declarations.add(f"declare void @{name}({of}, ptr, i32, {vector('i1', lanes)})")
        self.do(f"call void @{name}({of} {value}, ptr {address}, i32 {align}, {vector('i1', lanes)} {mask})")

    def _store_first(self, element: str, address: str, value: str, lanes: int, count: int, align: int) -> None:
        """Emit the store of the first ``count`` lanes of type ``element`` in pieces, faster than a masked one."""
        of, begin = vector(element, lanes), 0
        while begin < count:
            size = 1 << ((count - begin).bit_length() - 1)
            which = ", ".join(f"i32 {lane}" for lane in range(begin, begin + size))
            piece = self.emit(f"shufflevector {of} {value}, {of} poison, <{size} x i32> <{which}>")
            to = self.once(f"getelementptr i8, ptr {address}, i64 {begin * align}") if begin else address
            self.do(f"store <{size} x {element}> {piece}, ptr {to}, align {align}")
            begin += size

    # Values

    def value(self, access: Access) -> tuple[str, int]:
        """Return the name and lanes of an array's value in the present loop; a loaded value is reused."""
        node, scope = access.node, self.scope
        if node.number in self.scalars:
            return self.scalars[node.number]
        # Of another element the value is in another turn of the loop, so it is read from memory.
        if node.number in scope.values and access.identical(scope.domain):
            return scope.values[node.number], self._width(node)
        if node.number in scope.row and access.index == ((len(scope.domain) - 1, 0),):
            return scope.row[node.number], self._width(node)
        if node.op == "constant" and node.shape == ():
            number = np.frombuffer(node.attributes[0], node.dtype)[0]
            return literal(number, node.dtype), 0
        key = (node.number, access.index)
        if key not in scope.offsets:
            scope.offsets[key] = self._read(access, self.place(node))
        found: tuple[str, int] = scope.offsets[key]
        return found

    def open_scope(self, domain: Shape, lane_axis: int | None = None) -> None:
        """Begin a loop nest over ``domain``, scalar or in vectors along ``lane_axis``."""
        self.scope = Scope(domain, ["0"] * len(domain), lane_axis, {}, {})

    def read(self, access: Access) -> tuple[str, int]:
        """Emit a load of an array's value in the present loop, even if it was loaded before; return name and lanes."""
        return self._read(access, self.place(access.node))

    def _read(self, access: Access, place: Place) -> tuple[str, int]:
        """Emit a load of an array's value in the present loop from its place; return its name and lanes."""
        node, scope = access.node, self.scope
        index = [(None if a is None else scope.variables[a], offset) for a, offset in access.index]
        across = [i for i, (axis, _) in enumerate(access.index) if axis is not None and axis == scope.lane_axis]
        if not across:
            lanes = self._lanes_of(node)
            return self.load(node.dtype, self.address(place, index), lanes), lanes
        # Elements side by side are one load.
        if len(across) == 1 and place.strides[across[0]] == stored_bytes(node.dtype):
            address = self.address(place, index)
            if self.vectors_ahead(node, place):
                self.fetch(address, self.vectors_ahead(node, place) * self.lanes * stored_bytes(node.dtype) - 1)
            return self.load(node.dtype, address, self.lanes), self.lanes
        return self._gathered(node, place, index, across), self.lanes

    def vectors_ahead(self, node: Node, place: Place) -> int:
        """Return how many vectors ahead of its use an array is prefetched; 0: it is not."""
        return 2 if self.far and len(node.shape) > 1 and not place.short else 0

    def fetch(self, address: str, distance: int, written: bool = False) -> None:
        """Emit a prefetch of the memory ``distance`` [bytes] after an address; ``written``: for a store."""
        self.declarations.add("declare void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        ahead = self.emit(f"getelementptr i8, ptr {address}, i64 {distance}")
        # To be read or written, and kept close; data, not code.
        self.do(f"call void @llvm.prefetch.p0(ptr {ahead}, i32 {int(written)}, i32 3, i32 1)")

    def _pick(self, node: Node, lanes: int) -> str:
        """Emit loads of an array's elements at run-time indices, and return the value's name."""
        access, place, (moved,) = node.args[0], self.place(node.args[0].node), node.attributes
        starts = [self.value(start) for start in node.args[1:]]
        dtypes = [start.node.dtype for start in node.args[1:]]
        if all(have <= 1 for _, have in starts):
            begun = self.begun(place, moved, starts, dtypes)
            return self.widened(self._read(access, begun), node.dtype, lanes)
        wide = [self.widened(start, dtype, lanes) for start, dtype in zip(starts, dtypes, strict=True)]
        return self._picked(node, place, wide, lanes)

    def begun(self, place: Place, moved: Moves, starts: list[tuple[str, int]], dtypes: Sequence[DType]) -> Place:
        """Return a memory place offset along the axes ``moved`` by run-time ``starts``, each clipped to its range."""
        pointer = place.pointer
        for axis, move in enumerate(moved):
            if move is not None:
                start = starts[move[0]][0]
                distance = self._distance(start, dtypes[move[0]], move[1], place.strides[axis], "i64")
                pointer = self.emit(f"getelementptr i8, ptr {pointer}, i64 {distance}")
        return Place(pointer, place.offset, place.strides, place.own)

    def _distance(self, start: str, dtype: DType, largest: int, stride: int, element: str, lanes: int = 1) -> str:
        """Emit the byte offset of a run-time index, clipped to [0, largest], times ``stride``, in type ``element``."""
        of, sign = vector(scalar_type(dtype), lanes), "s" if dtype.kind == "i" else "u"
        for how, limit in (("max", 0), ("min", largest)):
            name = f"llvm.{sign}{how}.{suffix(scalar_type(dtype), lanes)}"
            self.declarations.add(f"declare {of} @{name}({of}, {of})")
            bound = splat(str(limit), scalar_type(dtype), lanes)
            start = self.emit(f"call {of} @{name}({of} {start}, {of} {bound})")
        wide = vector(element, lanes)
        if of != wide:
            start = self.emit(f"zext {of} {start} to {wide}")
        return self.emit(f"mul {wide} {start}, {splat(str(stride), element, lanes)}")

    def _picked(self, node: Node, place: Place, starts: list[str], lanes: int) -> str:
        """Emit a load of a vector of elements, each lane at its run-time indices ``starts``, and return its name."""
        access, (moved,), wide = node.args[0], node.attributes, vector("i64", lanes)
        # From lane to lane: to the next world, or to the next element along the vector's axis.
        step = stored_bytes(node.dtype) if self._lanes_of(access.node) > 1 else 0
        if self.scope.lane_axis is not None:
            step = sum(s for (a, _), s in zip(access.index, place.strides, strict=True) if a == self.scope.lane_axis)
        moves = [(*move, place.strides[axis]) for axis, move in enumerate(moved) if move is not None]
        dtypes = [access.node.dtype for access in node.args[1:]]
        # Offsets of 32 bits take half as many vectors.
        short = sum(largest * stride for _, largest, stride in moves) + lanes * step < 2**31
        element = "i32" if short and all(dtypes[which].itemsize == 4 for which, _, _ in moves) else "i64"
        offsets = "<" + ", ".join(f"{element} {lane * step}" for lane in range(lanes)) + ">"
        for which, largest, stride in moves:
            far = self._distance(starts[which], dtypes[which], largest, stride, element, lanes)
            offsets = self.emit(f"add {vector(element, lanes)} {offsets}, {far}")
        if element != "i64":
            offsets = self.emit(f"sext {vector(element, lanes)} {offsets} to {wide}")
        index = [(None if a is None else self.scope.variables[a], offset) for a, offset in access.index]
        first = self.address(place, index)
        pointers = self.emit(f"getelementptr i8, ptr {first}, {wide} {offsets}")
        found = self.gathered(pointers, stored_type(node.dtype), stored_bytes(node.dtype), lanes)
        if node.dtype.kind != "b":
            return found
        return self.emit(f"icmp ne {vector('i32', lanes)} {found}, {splat('0', 'i32', lanes)}")

    def gathered(self, pointers: str, element: str, align: int, lanes: int) -> str:
        """Emit loads of LLVM type ``element`` from a vector of pointers, and return the name of the vector."""
        of, places, mask = vector(element, lanes), vector("ptr", lanes), vector("i1", lanes)
        name = f"llvm.masked.gather.{suffix(element, lanes)}.v{lanes}p0"
        self.declarations.add(f"declare {of} @{name}({places}, i32, {mask}, {of})")
        every = splat("true", "i1", lanes)
        return self.emit(f"call {of} @{name}({places} {pointers}, i32 {align}, {mask} {every}, {of} poison)")

    def _width(self, node: Node) -> int:
        """Return the number of lanes in which the present loop computes a graph node."""
        if self.side_by_side:
            return self._lanes_of(node)
        return 1 if self.scope.lane_axis is None else self.lanes

    def _gathered(self, node: Node, place: Place, index: list[tuple[str | None, int]], across: list[int]) -> str:
        """Emit a load of elements apart in memory as a vector; lanes past the end repeat the last element."""
        element = scalar_type(node.dtype)
        of, result = vector(element, self.lanes), "poison"
        axis = self.scope.lane_axis
        assert axis is not None
        extent, counter = self.scope.domain[axis], self.scope.variables[axis]
        for lane in range(self.lanes):
            at = self.emit(f"add i64 {counter}, {lane}")
            self.declarations.add("declare i64 @llvm.umin.i64(i64, i64)")
            # Behind the last element the last one is read again, so that no lane reads foreign memory.
            at = self.emit(f"call i64 @llvm.umin.i64(i64 {at}, i64 {extent - 1})")
            moved = [(at if i in across else variable, offset) for i, (variable, offset) in enumerate(index)]
            one = self.load(node.dtype, self.address(place, moved), 1)
            result = self.emit(f"insertelement {of} {result}, {element} {one}, i32 {lane}")
        return result

    def widened(self, found: tuple[str, int], dtype: DType, lanes: int) -> str:
        """Emit a value repeated in all lanes, and return its name; ``found``: its name and lanes."""
        text, have = found
        if have == lanes or (have == 0 and lanes == 1):
            return text
        element = scalar_type(dtype)
        if have == 0:
            return splat(text, element, lanes)
        # Nothing says which of the worlds would be meant.
        if have != 1:
            raise UnsupportedError("a value of one world that depends on all of them")
        of = vector(element, lanes)
        first = self.once(f"insertelement {of} poison, {element} {text}, i32 0")
        return self.once(f"shufflevector {of} {first}, {of} poison, <{lanes} x i32> zeroinitializer")

    def place(self, node: Node) -> Place:
        """Return the memory place of a graph node; a constant array is added to the program."""
        if node.op != "constant":
            return self.places[node.number]
        if node.number not in self._constant_places:
            array = np.frombuffer(node.attributes[0], node.dtype).reshape(node.shape)
            # Rows are read in whole vectors, so the last one needs something behind it.
            offset = self.constants.add(array, 2 * self.lanes)
            element = stored_bytes(node.dtype) // array.dtype.itemsize
            strides = tuple(element * stride for stride in array.strides)
            self._constant_places[node.number] = Place(self.constants.pointer, offset, strides, own=False)
        return self._constant_places[node.number]

    def write(self, place: Place, dtype: DType, value: str, lanes: int, variables: Sequence[str]) -> None:
        """Emit a store of a value to a memory place at the element of the present loop (``variables``: counters)."""
        wanted = self.lanes if place.own and self.side_by_side else lanes
        value = self.widened((value, lanes), dtype, wanted)
        address = self.address(place, [(v, 0) for v in variables])
        mask = None
        axis = self.scope.lane_axis
        if place.tight and axis is not None and lanes > 1 and self.scope.domain[axis] % lanes:
            mask = self.inside(self.scope.variables[axis], self.scope.domain[axis])
        self.store(dtype, address, value, wanted, mask)

    def inside(self, counter: str, extent: int) -> str:
        """Emit the mask of the lanes with an index (``counter`` plus lane) below ``extent``, and return its name."""
        if counter == "0":
            return "<" + ", ".join(f"i1 {'true' if lane < extent else 'false'}" for lane in range(self.lanes)) + ">"
        ramp = "<" + ", ".join(f"i64 {lane}" for lane in range(self.lanes)) + ">"
        of = vector("i64", self.lanes)
        at = self.once(f"add {of} {self.widened((counter, 1), np.dtype(np.int64), self.lanes)}, {ramp}")
        return self.once(f"icmp ult {of} {at}, {splat(str(extent), 'i64', self.lanes)}")
