"""The nearest other point within reach, by cells of space: work that grows with the number of points, not of pairs.

Space is cut into cubes a little more than twice as wide as the reach, so what is in reach of a point lies in its own
cube or in the seven that its position within the cube leans to. Cubes are numbered by a hash into chains; that two of
them share a chain costs time and changes nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from qrsim.native.graph import Access, Node
from qrsim.native.operations import literal, scalar_type

if TYPE_CHECKING:
    from qrsim.native.emit import Emitter

# Half a cube is wider than the reach by more than rounding.
_WIDTH_IN_REACHES = 2.002
_SMALLEST_WIDTH = 0.1
_PRIMES = (73856093, 19349663, 83492791)


class Neighbours:
    """Writes the search into a program of one world.

    Args:
        writer: of the program.
    """

    def __init__(self, writer: Emitter):
        self.writer, self.emit, self.do = writer, writer.emit, writer.do

    def write(self, node: Node) -> None:
        """Write the search of a node: from x, y, z (n,) and the reach, the least squared distance of each point."""
        writer, count = self.writer, node.shape[0]
        self.of, self.dtype = scalar_type(node.dtype), node.dtype
        writer.open_scope((count,))
        reach = writer.widened(writer.value(node.args[3]), node.dtype, 1)
        self._measure(reach)
        self.mask = (1 << (2 * count - 1).bit_length()) - 1
        self.heads = self._memory(4 * (self.mask + 1))
        self.following = self._memory(4 * count)
        writer.declarations.add("declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)")
        self.do(f"call void @llvm.memset.p0.i64(ptr {self.heads}, i8 -1, i64 {4 * (self.mask + 1)}, i1 false)")
        with writer.loop(count) as point:
            self._put(node, point)
        with writer.loop(count) as point:
            self._search(node, point)

    def _memory(self, size: int) -> str:
        return self.emit(f"getelementptr i8, ptr %scratch, i64 {self.writer.spare_bytes(size)}")

    def _measure(self, reach: str) -> None:
        """Compute what turns a coordinate into cubes."""
        smallest = literal(_SMALLEST_WIDTH if self.dtype.itemsize == 8 else np.float32(_SMALLEST_WIDTH), self.dtype)
        factor = literal(_WIDTH_IN_REACHES if self.dtype.itemsize == 8 else np.float32(_WIDTH_IN_REACHES), self.dtype)
        width = self.emit(f"fmul {self.of} {reach}, {factor}")
        larger = self.emit(f"fcmp ogt {self.of} {width}, {smallest}")
        width = self.emit(f"select i1 {larger}, {self.of} {width}, {self.of} {smallest}")
        self.scale = self.emit(f"fdiv {self.of} {literal(1.0, self.dtype)}, {width}")

    def _coordinate(self, access: Access, point: str) -> str:
        self.writer.scope.variables[0] = point
        found: str = self.writer.read(access)[0]
        return found

    def _cube(self, coordinate: str) -> tuple[str, str]:
        """Return the cube's number along an axis, and where in it the point is."""
        letter = "f32" if self.of == "float" else "f64"
        self.writer.declarations.add(f"declare {self.of} @llvm.floor.{letter}({self.of})")
        place = self.emit(f"fmul {self.of} {coordinate}, {self.scale}")
        whole = self.emit(f"call {self.of} @llvm.floor.{letter}({self.of} {place})")
        converted = self.emit(f"fptosi {self.of} {whole} to i32")
        # Frozen: a point that is nowhere lies in some cube.
        return self.emit(f"freeze i32 {converted}"), self.emit(f"fsub {self.of} {place}, {whole}")

    def _chain(self, parts: list[str]) -> str:
        """Return where the chain of a cube begins, from the hashes of its three numbers."""
        both = self.emit(f"xor i32 {parts[0]}, {parts[1]}")
        whole = self.emit(f"xor i32 {both}, {parts[2]}")
        number = self.emit(f"and i32 {whole}, {self.mask}")
        wide = self.emit(f"zext i32 {number} to i64")
        return self.emit(f"getelementptr i32, ptr {self.heads}, i64 {wide}")

    def _put(self, node: Node, point: str) -> None:
        """Put a point at the beginning of its cube's chain."""
        cubes = [self._cube(self._coordinate(access, point))[0] for access in node.args[:3]]
        hashes = [self.emit(f"mul i32 {cube}, {prime}") for cube, prime in zip(cubes, _PRIMES, strict=True)]
        head = self._chain(hashes)
        before = self.emit(f"load i32, ptr {head}, align 4")
        after = self.emit(f"getelementptr i32, ptr {self.following}, i64 {point}")
        self.do(f"store i32 {before}, ptr {after}, align 4")
        number = self.emit(f"trunc i64 {point} to i32")
        self.do(f"store i32 {number}, ptr {head}, align 4")

    def _search(self, node: Node, point: str) -> None:
        """Find the nearest other point in the eight cubes around a point."""
        position = [self._coordinate(access, point) for access in node.args[:3]]
        choices = []
        for coordinate, prime in zip(position, _PRIMES, strict=True):
            cube, within = self._cube(coordinate)
            low = self.emit(f"fcmp olt {self.of} {within}, {literal(0.5, self.dtype)}")
            side = self.emit(f"select i1 {low}, i32 -1, i32 1")
            other = self.emit(f"add i32 {cube}, {side}")
            choices.append([self.emit(f"mul i32 {number}, {prime}") for number in (cube, other)])
        best = literal(float("inf"), self.dtype)
        for corner in range(8):
            head = self._chain([choices[axis][corner >> axis & 1] for axis in range(3)])
            best = self._walk(node, point, position, head, best)
        self.writer.scope.variables[0] = point
        self.writer.write(self.writer.places[node.number], node.dtype, best, 1, [point])

    def _walk(self, node: Node, point: str, position: list[str], head: str, best: str) -> str:
        """Return the least of ``best`` and the squared distances of the points of a chain."""
        writer = self.writer
        first = self.emit(f"load i32, ptr {head}, align 4")
        before, label = writer.block, f"chain{writer.count}"
        current, least = writer.name("at"), writer.name("least")
        self.do(f"br label %{label}")
        writer.start_block(label)
        place = len(writer.lines)
        writer.lines.extend(("", ""))
        ended = self.emit(f"icmp slt i32 {current}, 0")
        self.do(f"br i1 {ended}, label %{label}.end, label %{label}.look")
        writer.start_block(f"{label}.look")
        writer.scope.offsets.clear()
        there = self.emit(f"zext nneg i32 {current} to i64")
        squared = None
        for access, coordinate in zip(node.args[:3], position, strict=True):
            apart = self.emit(f"fsub {self.of} {coordinate}, {self._coordinate(access, there)}")
            square = self.emit(f"fmul {self.of} {apart}, {apart}")
            squared = square if squared is None else self._fused(apart, squared)
        itself = self.emit(f"icmp eq i64 {there}, {point}")
        nearer = self.emit(f"fcmp olt {self.of} {squared}, {least}")
        other = self.emit(f"xor i1 {itself}, true")
        taken = self.emit(f"and i1 {nearer}, {other}")
        found = self.emit(f"select i1 {taken}, {self.of} {squared}, {self.of} {least}")
        following = self.emit(f"getelementptr i32, ptr {self.following}, i64 {there}")
        after = self.emit(f"load i32, ptr {following}, align 4")
        self.do(f"br label %{label}")
        writer.lines[place] = f"  {current} = phi i32 [{first}, %{before}], [{after}, %{label}.look]"
        writer.lines[place + 1] = f"  {least} = phi {self.of} [{best}, %{before}], [{found}, %{label}.look]"
        writer.start_block(f"{label}.end")
        writer.scope.offsets.clear()
        return least

    def _fused(self, apart: str, rest: str) -> str:
        letter = "f32" if self.of == "float" else "f64"
        self.writer.declarations.add(f"declare {self.of} @llvm.fma.{letter}({self.of}, {self.of}, {self.of})")
        return self.emit(
            f"call {self.of} @llvm.fma.{letter}({', '.join(f'{self.of} {v}' for v in (apart, apart, rest))})"
        )
