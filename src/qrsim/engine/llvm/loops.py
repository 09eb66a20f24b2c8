"""Loops over the elements of arrays: what copies, concatenations, searches and scatters are written with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from qrsim.core.arrays import DType
from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.operations import Operations
from qrsim.engine.llvm.text import scalar_type, stored_bytes, vector
from qrsim.engine.llvm.writing import Place, Scope, Writer

# Vectors from the one that is computed in a strip to the one that is fetched.
_AHEAD = 4


@dataclass(frozen=True)
class Strip:
    """A part of a last axis that is being written: its extent, first and end counter, and the group of its steps."""

    extent: int
    begin: str
    end: str
    group: int


class Loops(Writer):
    """A writer that knows the operations, and where there is room for copies.

    Args:
        places: of every node that is in memory.
        lanes: of a vector.
        side_by_side: the lanes are worlds, not elements.
        spare: gives memory for a copy of a node that waits, none of which was given out before; of a thread in a group.
        spare_bytes: gives the offset of so many bytes of it.
    """

    def __init__(
        self,
        places: dict[int, Place],
        lanes: int,
        side_by_side: bool,
        spare: Callable[[Node, Shape, int], Place],
        spare_bytes: Callable[[int], int],
    ):
        super().__init__(places, lanes, side_by_side)
        self.spare, self.spare_bytes = spare, spare_bytes
        self.operations = Operations(self.emit, self.declarations)
        # Which worlds take the branches and have not left the loops that are being written; None where all do.
        self.turning: str | None = None
        # The strip that the steps of a group are written for.
        self.strip: Strip | None = None

    def along(self, extent: int, step: int = 1) -> AbstractContextManager[str]:
        """Emit a loop over the last axis of arrays, or over the strip of it that is being computed."""
        strip = self.strip
        return self.loop(extent, step, (strip.begin, strip.end) if strip and strip.extent == extent else None)

    @contextmanager
    def over(self, axes: Sequence[int], domain: Shape, lane_axis: int | None, together: int = 1) -> Iterator[None]:
        """Emit nested loops over axes of ``domain``: vectors along ``lane_axis``, the last other one unrolled."""
        if not axes:
            yield
            return
        axis = axes[0]
        # Only one axis is unrolled; more would need more registers than there are.
        turns = together if axis == shared_axis(axes, lane_axis) else 1
        loop = self.along if axis == len(domain) - 1 else self.loop
        with loop(domain[axis], self.lanes if axis == lane_axis else turns) as counter:
            self.scope.variables[axis] = counter
            with self.over(axes[1:], domain, lane_axis, together):
                yield

    def vectors_ahead(self, node: Node, place: Place) -> int:
        """Return how many vectors ahead of its use an array is prefetched; inside a strip all arrays are."""
        return super().vectors_ahead(node, place) if self.strip is None else 0 if place.local else _AHEAD

    def write(self, place: Place, dtype: DType, value: str, lanes: int, variables: Sequence[str]) -> None:
        """Emit a store of a value to a memory place at the element of the present loop (``variables``: counters)."""
        if self.strip is not None and lanes > 1 and not place.local:
            address = self.address(place, [(v, 0) for v in variables])
            self.fetch(address, _AHEAD * self.lanes * stored_bytes(dtype) - 1, written=True)
        super().write(place, dtype, value, lanes, variables)

    @contextmanager
    def counted(self, extent: str, begin: str = "0") -> Iterator[str]:
        """Emit a loop from ``begin`` to a run-time ``extent`` (i32), exclusive; yield the counter's name (i64)."""
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
        self.lines[place] = f"  {number} = phi i64 [{begin}, %{before}], [{following}, %{self.block}]"
        self.start_block(f"{label}.after")
        self.scope.offsets.clear()

    def copy(self, access: Access, shape: Shape, to: Place, keep: str | None = None) -> None:
        """Emit a loop that copies an array to a memory place, except for worlds in the mask ``keep``."""
        if 0 in shape or (keep is None and self._copied_whole(access, shape, to)):
            return
        lane_axis = len(shape) - 1 if shape and not self.side_by_side and self.lanes > 1 else None
        # A vector is stored in one piece only where elements lie side by side.
        if lane_axis is not None and to.strides[lane_axis] != stored_bytes(access.node.dtype):
            lane_axis = None
        self.scope = Scope(shape, ["0"] * len(shape), lane_axis, {}, {})
        with self.over(range(len(shape)), shape, lane_axis):
            found, lanes = self.value(access)
            wide = max(1, lanes) if lane_axis is None else self.lanes
            value = self.widened((found, lanes), access.node.dtype, wide)
            if keep is not None:
                value, wide = self._kept(to, access.node.dtype, value, wide, keep), self.lanes
            self.write(to, access.node.dtype, value, wide, self.scope.variables)

    def _copied_whole(self, access: Access, shape: Shape, to: Place) -> bool:
        """Emit one block copy if source and target ``to`` have the same memory layout; return whether that was done."""
        if len(shape) < 2 or self.strip or not access.identical(shape):
            return False
        source, dtype = self.place(access.node), access.node.dtype
        if source.short or to.short or source.own != to.own or source.strides != to.strides:
            return False
        element = stored_bytes(dtype) * (self.lanes if to.own and self.side_by_side else 1)
        # Rows end with whole vectors, but where nothing may be written behind them.
        row = shape[-1] if to.tight or self.side_by_side else -(-shape[-1] // self.lanes) * self.lanes
        size = element
        for extent, stride in zip((row, *shape[-2::-1]), reversed(to.strides), strict=True):
            if stride != size:
                return False
            size *= extent
        origin = [(None, 0)] * len(shape)
        begins = ", ".join(f"ptr align {stored_bytes(dtype)} {self.address(each, origin)}" for each in (to, source))
        self.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
        self.do(f"call void @llvm.memcpy.p0.p0.i64({begins}, i64 {size}, i1 false)")
        return True

    def _kept(self, to: Place, dtype: DType, value: str, lanes: int, keep: str) -> str:
        """Emit a select between a new value and the one in memory at ``to``, for the worlds in the mask ``keep``."""
        of = vector(scalar_type(dtype), self.lanes)
        before = self.load(dtype, self.address(to, [(v, 0) for v in self.scope.variables]), self.lanes)
        value = self.widened((value, lanes), dtype, self.lanes)
        return self.emit(f"select {vector('i1', self.lanes)} {keep}, {of} {before}, {of} {value}")

    def move_all(self, moves: list[tuple[Access, Shape, Place]], keep: str | None = None) -> None:
        """Emit copies (source, shape, target), all loads before any store; worlds in the mask ``keep`` keep values."""
        # What lies there already is not moved.
        moves = [move for move in moves if not self._lies_there(*move)]
        targets = {(to.pointer, to.offset) for _, _, to in moves}
        # What another move of this set writes to is copied first, so that the order of the moves does not matter.
        later: list[tuple[Access, Shape, Place]] = []
        for access, shape, to in moves:
            source = None if self._in_register(access.node) else self.place(access.node)
            if source is not None and (source.pointer, source.offset) in targets:
                place = self.spare(access.node, shape, self.strip.group if self.strip else 0)
                self.copy(access, shape, place)
                later.append((self._stand_in(access.node, shape, place), shape, to))
            else:
                later.append((access, shape, to))
        for access, shape, to in later:
            self.copy(access, shape, to, keep)

    def _lies_there(self, access: Access, shape: Shape, to: Place) -> bool:
        """Return whether a value of this shape is already stored at the place, so that no copy is needed."""
        return not self._in_register(access.node) and self.place(access.node) == to and access.identical(shape)

    def _in_register(self, node: Node) -> bool:
        """Return whether a graph node's value is in a register, not in memory."""
        return node.number in self.scalars or (node.op == "constant" and node.shape == ())

    def _stand_in(self, node: Node, shape: Shape, place: Place) -> Access:
        """Return an access to a new node of this shape that stands for the value stored at a memory place."""
        self.count += 1
        # Numbers below zero are of no node of the graph.
        copy = Node("input", (), shape, node.dtype, uniform=node.uniform, number=-self.count)
        self.places[copy.number] = place
        return Access(copy, tuple((axis, 0) for axis in range(len(shape))))


def shared_axis(axes: Sequence[int], lane_axis: int | None) -> int | None:
    """Return the axis along which a loop can be unrolled: the last one except the vectors' (``lane_axis``)."""
    others = [axis for axis in axes if axis != lane_axis]
    return others[-1] if others else None
