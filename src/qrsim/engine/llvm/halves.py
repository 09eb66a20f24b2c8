"""Operations of symmetric matrices that are kept as their upper halves (``qrsim.core.symmetric``).

A loop over the vehicles holds each operation written out number by number, so that what is read is used while it is in
a register, and a half changes where it lies. Worlds side by side are taken as many at a time as the processor's vectors
hold: a wider vector would be cut in two, and twice as many registers are not there.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from qrsim.core.symmetric import Term, place_of, size_of
from qrsim.engine.llvm.compiler import vector_bytes
from qrsim.engine.llvm.graph import Access, Node
from qrsim.engine.llvm.loops import Loops
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.text import literal, scalar_type, splat, suffix, vector
from qrsim.engine.llvm.writing import Place

HALVES = ("half_times", "half_lowered", "half_transformed")


def write_half(writer: Loops, node: Node) -> None:
    """Emit LLVM code of an operation on each vehicle's symmetric matrix, stored as its upper half."""
    _Half(writer, node).write()


@dataclass(frozen=True)
class _Rows:
    """Where the rows of an array of the present vehicle lie.

    Attributes:
        pointer: to the first row.
        stride: bytes from row to row.
        lanes: of a value in memory; 1 where it is the same for all lanes.
    """

    pointer: str
    stride: int
    lanes: int


class _Half:
    """Writes one operation.

    Args:
        writer: of the program.
        node: one of HALVES.
    """

    def __init__(self, writer: Loops, node: Node):
        self.writer, self.node, self.dtype = writer, node, node.dtype
        self.size = size_of(node.attributes[0])
        self.vehicles = node.shape[1] if len(node.shape) == 2 else 1
        self.place = writer.places[node.number]
        self.by_world = writer.side_by_side and self.place.own
        # Lanes are worlds, or vehicles of one world; a single vehicle has none.
        lanes = writer.lanes if self.by_world or (not writer.side_by_side and self.vehicles > 1) else 1
        few = vector_bytes() // self.dtype.itemsize
        self.width = min(lanes, few) if self.by_world and self.vehicles > 1 else lanes
        self.parts = lanes // self.width
        self.of = vector(scalar_type(self.dtype), self.width)
        self.vehicle = self.part = "0"

    def write(self) -> None:
        """Emit the loop over the vehicles with the operation as its body."""
        writer, alone = self.writer, not self.writer.side_by_side
        writer.open_scope((self.vehicles,) if self.vehicles > 1 else (), 0 if alone and self.width > 1 else None)
        with writer.loop(self.vehicles, self.width if alone else 1) as self.vehicle:
            if self.vehicles > 1:
                writer.scope.variables[0] = self.vehicle
            with writer.loop(self.parts) as self.part:
                # A name that a loop gives is known inside it only, so rows are found again in each.
                self.to, self.half = self._result(), self._rows(self.node.args[0])
                getattr(self, f"_{self.node.op}")()

    # Values

    def _rows(self, access: Access) -> _Rows:
        """Return where the rows of an argument lie in memory: pointer, stride and lanes."""
        place, index = self.writer.place(access.node), access.index
        by_row = bool(index) and index[0][0] == 0 and all(axis != 0 for axis, _ in index[1:])
        # From vehicle to vehicle; nothing where all have the same numbers.
        across = [stride for (axis, _), stride in zip(index, place.strides, strict=True) if axis == 1]
        alone = not self.writer.side_by_side and self.width > 1
        if not by_row or place.short or (alone and across not in ([], [self.dtype.itemsize])):
            raise UnsupportedError(f"'{self.node.op}' of an array that does not lie row by row")
        offsets = [(None, offset) if axis != 1 else (self.vehicle, offset) for axis, offset in index]
        own = bool(across) if alone else place.own
        return _Rows(self.writer.address(self._moved(place), offsets), place.strides[0], self.width if own else 1)

    def _result(self) -> _Rows:
        """Return where the rows of the result lie in memory: pointer, stride and lanes."""
        axes = [(None, 0), (self.vehicle, 0)][: len(self.node.shape)]
        return _Rows(self.writer.address(self._moved(self.place), axes), self.place.strides[0], self.width)

    def _moved(self, place: Place) -> Place:
        """Return a memory place offset to the vehicles that this turn of the loop computes."""
        if self.parts == 1 or not place.own:
            return place
        size = self.width * self.dtype.itemsize
        pointer = self.writer.once(f"getelementptr [{size} x i8], ptr {place.pointer}, i64 {self.part}")
        return replace(place, pointer=pointer)

    def _address(self, rows: _Rows, row: int) -> str:
        """Emit the pointer to row number ``row`` of an array, and return its name."""
        if row == 0:
            return rows.pointer
        return self.writer.emit(f"getelementptr i8, ptr {rows.pointer}, i64 {row * rows.stride}")

    def _at(self, rows: _Rows, row: int, counter: str) -> str:
        """Emit the address of row number ``row`` at a loop counter, and return its name."""
        if counter == "0":
            return self._address(rows, row)
        first = self.writer.emit(f"getelementptr [{rows.stride} x i8], ptr {rows.pointer}, i64 {counter}")
        return self.writer.emit(f"getelementptr i8, ptr {first}, i64 {row * rows.stride}")

    def _load(self, rows: _Rows, address: str) -> str:
        """Emit a load of one number per lane from an address in an array, and return the value's name."""
        found = self.writer.load(self.dtype, address, rows.lanes)
        return self.writer.widened((found, rows.lanes), self.dtype, self.width)

    def _number(self, row: int, column: int) -> str:
        """Emit the load of a matrix element as it was before the operation, and return its name."""
        return self._load(self.half, self._address(self.half, place_of(row, column, self.size)))

    def _store(self, address: str, value: str) -> None:
        """Emit a store of a value to an address of the result, without lanes past the last vehicle."""
        mask = None
        if self.place.tight and not self.writer.side_by_side and self.vehicles % self.width:
            mask = self.writer.inside(self.vehicle, self.vehicles)
        self.writer.store(self.dtype, address, value, self.width, mask)

    def _factor(self, access: Access) -> str:
        """Emit the load of a factor (n,) of the present vehicle, and return its name."""
        writer = self.writer
        if not writer.side_by_side or access.node.number in writer.scalars or access.node.op == "constant":
            return writer.widened(writer.value(access), self.dtype, self.width)
        place = writer.place(access.node)
        index = [(None if axis is None else self.vehicle, offset) for axis, offset in access.index]
        lanes = self.width if place.own else 1
        found = writer.load(self.dtype, writer.address(self._moved(place), index), lanes)
        return writer.widened((found, lanes), self.dtype, self.width)

    def _plus(self, factor: str, value: str, total: str) -> str:
        """Emit factor * value + total, rounded once, and return the result's name."""
        name = f"llvm.fma.{suffix(scalar_type(self.dtype), self.width)}"
        self.writer.declarations.add(f"declare {self.of} @{name}({self.of}, {self.of}, {self.of})")
        return self.writer.emit(f"call {self.of} @{name}({self.of} {factor}, {self.of} {value}, {self.of} {total})")

    def _minus(self, value: str) -> str:
        """Emit the negation of a value, and return its name."""
        return self.writer.emit(f"fneg {self.of} {value}")

    # Operations

    def _half_times(self) -> None:
        """Emit the product of the symmetric matrix with a sparse row of factors."""
        rows, factors = self.node.attributes[1], self.node.args[1:]
        known = ["" if _is_one(factor) else self._factor(factor) for factor in factors]
        for i in range(self.size):
            total = ""
            for row, factor in zip(rows, known, strict=True):
                total = self._sum(factor, self._number(i, row), total)
            self._store(self._address(self.to, i), total)

    def _sum(self, factor: str, number: str, total: str) -> str:
        """Emit factor * number + total and return its name; an empty factor is 1, an empty total is 0."""
        if factor and total:
            return self._plus(factor, number, total)
        if factor:
            return self.writer.emit(f"fmul {self.of} {factor}, {number}")
        return self.writer.emit(f"fadd {self.of} {total}, {number}") if total else number

    def _half_lowered(self) -> None:
        """Emit the symmetric matrix minus the outer products of columns."""
        columns = [self._rows(access) for access in self.node.args[1:]]
        for i in range(self.size):
            first = place_of(i, i, self.size)
            shares = [self._minus(self._load(column, self._address(column, i))) for column in columns]
            with self.writer.loop(self.size - i) as counter:
                value = self._load(self.half, self._at(self.half, first, counter))
                for column, share in zip(columns, shares, strict=True):
                    value = self._plus(share, self._load(column, self._at(column, i, counter)), value)
                self._store(self._at(self.to, first, counter), value)

    def _half_transformed(self) -> None:
        """Emit the congruence transform F P F' of the matrix, with additions to its diagonal."""
        rows, terms = self.node.attributes[1:]
        given = [self._factor(access) for access in self.node.args[1:]]
        factors, added = given[: len(given) - len(rows)], dict(zip(rows, given[len(given) - len(rows) :], strict=True))
        into: dict[int, list[tuple[int, str]]] = defaultdict(list)
        for term in map(Term._make, terms):
            into[term.row].append((term.column, self._coefficient(term, factors)))
        same = self.writer.places.get(self.node.args[0].node.number) == self.place
        # Each row needs those after it as they were, so it may be written as soon as it is done.
        for i in range(self.size):
            found, changed = self._row(i, into)
            if i in added:
                own = found.get(i) or self._number(i, i)
                found[i] = self.writer.emit(f"fadd {self.of} {own}, {added[i]}")
                changed.add(i)
            for j in range(i, self.size):
                if j in changed or not same:
                    self._store(self._address(self.to, place_of(i, j, self.size)), found.get(j) or self._number(i, j))

    def _row(self, i: int, into: dict[int, list[tuple[int, str]]]) -> tuple[dict[int, str], set[int]]:
        """Emit row ``i`` plus factor times row k for (k, factor) of ``into[i]``; return values and changed columns."""
        found: dict[int, str] = {}
        if i in into:
            for j in range(i, self.size):
                found[j] = self._number(i, j)
                for k, factor in into[i]:
                    found[j] = self._plus(factor, self._number(k, j), found[j])
        changed = set(found)
        for j in range(i, self.size):
            for k, factor in into.get(j, ()):
                for each in (j, k):
                    if each not in found:
                        found[each] = self._number(i, each)
                found[j] = self._plus(factor, found[k], found[j])
                changed.add(j)
        return found, changed

    def _coefficient(self, term: Term, factors: list[str]) -> str:
        """Emit a term's coefficient, its scale times its factor, and return the name."""
        number = np.float32(term.scale) if self.dtype.itemsize == 4 else term.scale
        scale = splat(literal(number, self.dtype), scalar_type(self.dtype), self.width)
        if term.factor is None:
            return scale
        if abs(term.scale) == 1.0:
            return factors[term.factor] if term.scale > 0.0 else self._minus(factors[term.factor])
        return self.writer.once(f"fmul {self.of} {scale}, {factors[term.factor]}")


def _is_one(access: Access) -> bool:
    """Return whether a factor of the matrix operation is the constant 1."""
    node = access.node
    return node.op == "constant" and bool((np.frombuffer(node.attributes[0], node.dtype) == 1.0).all())
