"""The nearest other point within reach, by cells of space: work that grows with the number of points, not of pairs.

Space is cut into cubes a little more than twice as wide as the reach, so what is in reach of a point lies in its own
cube or in the seven that its position within the cube leans to.

Most points have nobody near. They are told first, many at a time: every point marks the bit of its column of cubes,
two in one column mark a second bit, and whoever finds no mark but its own in the four columns around is alone. If two
are in reach of each other, neither is alone. The others are put into chains by a hash of their cubes, and each looks at
the eight chains around it. That two columns share a bit, or two cubes a chain, costs time and changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np

from qrsim.engine.llvm.graph import Access, Node
from qrsim.engine.llvm.loops import Loops
from qrsim.engine.llvm.text import literal, scalar_type, splat, suffix, vector

# Half a cube is wider than the reach by more than rounding.
_WIDTH_IN_REACHES = 2.02
_SMALLEST_WIDTH = 0.1
# Of 64 bits for each point, 3 foreign ones are looked at: one in twenty is taken for near without being so.
_BITS_FOR_A_POINT = 64
_PRIMES = (73856093, 19349663, 83492791)


class Neighbours:
    """Writes the search into a program of one world.

    Args:
        writer: of the program.
    """

    def __init__(self, writer: Loops):
        self.writer, self.emit, self.do = writer, writer.emit, writer.do

    # What threads share is written by SharedNeighbours: here one thread does it all.

    def _alone(self) -> AbstractContextManager[None]:
        """Return a context for code that a single thread runs."""
        return nullcontext()

    def _meet(self) -> None:
        """Emit a barrier of all threads."""

    def _parted(self, count: int) -> AbstractContextManager[tuple[str, str] | None]:
        """In the context, emit code for one thread's part of ``count`` points; yield its bounds, or None: all."""
        return nullcontext()

    def write(self, node: Node) -> None:
        """Emit the search of each point's nearest other point within reach: x, y, z (n,) to squared distance (n,)."""
        writer, count = self.writer, node.shape[0]
        self.of, self.dtype = scalar_type(node.dtype), node.dtype
        writer.open_scope((count,))
        self._measure(writer.widened(writer.value(node.args[3]), node.dtype, 1))
        self.mask = (1 << (2 * count - 1).bit_length()) - 1
        self.heads = self._memory(4 * (self.mask + 1))
        self.following = self._memory(4 * count)
        near, number = self._near(node)
        with self._alone():
            self._fill(self.heads, -1, 4 * (self.mask + 1))
            with self._each(near, number) as point:
                self._put(node, point)
        self._meet()
        with self._each(near, number, shared=True) as point:
            self._search(node, point)

    # Who is near anybody

    def _near(self, node: Node) -> tuple[str, str]:
        """Emit a list of the points that may have a neighbour; return the addresses of the list and its length."""
        writer, count, lanes = self.writer, node.shape[0], self.writer.lanes
        words = 1 << (_BITS_FOR_A_POINT * count // 32 - 1).bit_length()
        marks, near = self._memory(8 * words), self._memory(4 * (count + lanes))
        columns, number = self._memory(4 * (count + lanes)), self._memory(4)
        with self._alone():
            self._fill(marks, 0, 8 * words)
        with self._vectors(count) as first:
            cubes = [self._cube(self._coordinate(access, first), lanes)[0] for access in node.args[:2]]
            column = self._column([self._hash(cube, axis, lanes) for axis, cube in enumerate(cubes)], words)
            place = self.emit(f"getelementptr i32, ptr {columns}, i64 {first}")
            self.do(f"store {vector('i32', lanes)} {column}, ptr {place}, align 4")
        writer.open_scope((count,))
        self._meet()
        with self._alone():
            with writer.loop(count) as point:
                self._mark(columns, marks, words, point)
            self.do(f"store i32 0, ptr {number}, align 4")
        self._meet()
        with self._vectors(count) as first:
            self._tell(node, first, marks, words, near, number)
        writer.open_scope((count,))
        self._meet()
        return near, self.emit(f"load i32, ptr {number}, align 4")

    @contextmanager
    def _vectors(self, count: int) -> Iterator[str]:
        """Emit a loop over ``count`` points in vectors; yield the index of a vector's first point."""
        self.writer.open_scope((count,), lane_axis=0)
        with self._parted(count) as part, self.writer.loop(count, self.writer.lanes, part) as first:
            yield first

    def _column(self, hashes: list[str], words: int) -> str:
        """Emit the hash of a column of grid cubes to a bit number among 32 * ``words``; return its name."""
        of = vector("i32", self.writer.lanes)
        both = self.emit(f"xor {of} {hashes[0]}, {hashes[1]}")
        # The products' upper bits depend on all bits of both numbers, the lower ones do not.
        upper = self.emit(f"lshr {of} {both}, {splat('15', 'i32', self.writer.lanes)}")
        mixed = self.emit(f"xor {of} {both}, {upper}")
        return self.emit(f"and {of} {mixed}, {splat(str(32 * words - 1), 'i32', self.writer.lanes)}")

    def _mark(self, columns: str, marks: str, words: int, point: str) -> None:
        """Emit code that sets the bit of a point's column, or a second bit if the first one is already set."""
        place = self.emit(f"getelementptr i32, ptr {columns}, i64 {point}")
        column = self.emit(f"load i32, ptr {place}, align 4")
        bit = self.emit(f"shl i32 1, {self.emit(f'and i32 {column}, 31')}")
        word = self.emit(f"zext i32 {self.emit(f'lshr i32 {column}, 5')} to i64")
        first = self.emit(f"getelementptr i32, ptr {marks}, i64 {word}")
        second = self.emit(f"getelementptr i32, ptr {first}, i64 {words}")
        once, twice = (self.emit(f"load i32, ptr {where}, align 4") for where in (first, second))
        again = self.emit(f"and i32 {once}, {bit}")
        self.do(f"store i32 {self.emit(f'or i32 {once}, {bit}')}, ptr {first}, align 4")
        self.do(f"store i32 {self.emit(f'or i32 {twice}, {again}')}, ptr {second}, align 4")

    def _tell(self, node: Node, first: str, marks: str, words: int, near: str, number: str) -> None:
        """Emit infinite distances for a vector of points; append those that may have neighbours to list ``near``."""
        writer, lanes, of = self.writer, self.writer.lanes, vector("i32", self.writer.lanes)
        choices = []
        for axis, access in enumerate(node.args[:2]):
            cube, within = self._cube(self._coordinate(access, first), lanes)
            choices.append(
                [self._hash(number_of, axis, lanes) for number_of in (cube, self._leant(cube, within, lanes))]
            )
        found = None
        for corner in range(4):
            column = self._column([choices[0][corner & 1], choices[1][corner >> 1]], words)
            word = self.emit(f"lshr {of} {column}, {splat('5', 'i32', lanes)}")
            # Of its own column, whether anybody else is in it.
            read = self._gathered(marks, word, words if corner == 0 else 0)
            bit = self.emit(f"and {of} {column}, {splat('31', 'i32', lanes)}")
            marked = self.emit(f"lshr {of} {read}, {bit}")
            found = marked if found is None else self.emit(f"or {of} {found}, {marked}")
        lowest = self.emit(f"trunc {of} {found} to {vector('i1', lanes)}")
        inside = writer.inside(first, node.shape[0])
        flags = self.emit(f"and {vector('i1', lanes)} {lowest}, {inside}")
        infinity = splat(literal(float("inf"), self.dtype), self.of, lanes)
        writer.write(writer.places[node.number], self.dtype, infinity, lanes, [first])
        self._append(flags, first, near, number)

    def _gathered(self, marks: str, word: str, offset: int) -> str:
        """Emit loads of 32-bit words of the bit set at a vector of indices, ``offset`` words further on."""
        lanes, of = self.writer.lanes, vector("i32", self.writer.lanes)
        wide = self.emit(f"zext {of} {word} to {vector('i64', lanes)}")
        begin = self.emit(f"getelementptr i32, ptr {marks}, i64 {offset}")
        places = self.emit(f"getelementptr i32, ptr {begin}, {vector('i64', lanes)} {wide}")
        return self.writer.gathered(places, "i32", 4, lanes)

    def _append(self, flags: str, first: str, near: str, number: str) -> None:
        """Emit code that appends the numbers of the flagged points of a vector to the list ``near``."""
        before = self.emit(f"load i32, ptr {number}, align 4")
        self._put_in_list(flags, first, near, before)
        after = self.emit(f"add i32 {before}, {self._counted(flags)}")
        self.do(f"store i32 {after}, ptr {number}, align 4")

    def _put_in_list(self, flags: str, first: str, near: str, before: str) -> None:
        """Emit stores of the flagged points' numbers to the list ``near`` from index ``before`` on."""
        lanes, of, mask = self.writer.lanes, vector("i32", self.writer.lanes), vector("i1", self.writer.lanes)
        place = self.emit(f"getelementptr i32, ptr {near}, i64 {self.emit(f'zext i32 {before} to i64')}")
        ramp = "<" + ", ".join(f"i32 {lane}" for lane in range(lanes)) + ">"
        start = self.writer.widened((self.emit(f"trunc i64 {first} to i32"), 1), np.dtype(np.int32), lanes)
        points = self.emit(f"add {of} {start}, {ramp}")
        name = f"llvm.masked.compressstore.v{lanes}i32"
        self.writer.declarations.add(f"declare void @{name}({of}, ptr, {mask})")
        self.do(f"call void @{name}({of} {points}, ptr {place}, {mask} {flags})")

    def _counted(self, flags: str) -> str:
        """Emit the count of set flags in a vector, and return its name."""
        lanes = self.writer.lanes
        bits = self.emit(f"bitcast {vector('i1', lanes)} {flags} to i{lanes}")
        self.writer.declarations.add(f"declare i{lanes} @llvm.ctpop.i{lanes}(i{lanes})")
        counted = self.emit(f"call i{lanes} @llvm.ctpop.i{lanes}(i{lanes} {bits})")
        return self.emit(f"zext i{lanes} {counted} to i32")

    @contextmanager
    def _each(self, near: str, number: str, shared: bool = False) -> Iterator[str]:
        """Emit a loop over the points of a list, or over a thread's part of them; yield the point's number."""
        writer = self.writer
        with writer.counted(*(self._some(number) if shared else (number,))) as counter:
            place = self.emit(f"getelementptr i32, ptr {near}, i64 {counter}")
            yield self.emit(f"zext i32 {self.emit(f'load i32, ptr {place}, align 4')} to i64")

    def _some(self, number: str) -> tuple[str, ...]:
        """Return the end of a thread's part of a list of ``number`` points, and its start if that is not 0."""
        return (number,)

    # Cells of space

    def _memory(self, size: int) -> str:
        """Emit the address of ``size`` bytes of scratch memory and return its name."""
        return self.emit(f"getelementptr i8, ptr %scratch, i64 {self.writer.spare_bytes(size)}")

    def _fill(self, place: str, byte: int, size: int) -> None:
        """Emit a call that sets ``size`` bytes from an address on to the value ``byte``."""
        self.writer.declarations.add("declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)")
        self.do(f"call void @llvm.memset.p0.i64(ptr {place}, i8 {byte}, i64 {size}, i1 false)")

    def _measure(self, reach: str) -> None:
        """Emit the factor that scales a coordinate to grid cubes, from the search radius."""
        smallest = literal(_SMALLEST_WIDTH if self.dtype.itemsize == 8 else np.float32(_SMALLEST_WIDTH), self.dtype)
        factor = literal(_WIDTH_IN_REACHES if self.dtype.itemsize == 8 else np.float32(_WIDTH_IN_REACHES), self.dtype)
        width = self.emit(f"fmul {self.of} {reach}, {factor}")
        larger = self.emit(f"fcmp ogt {self.of} {width}, {smallest}")
        width = self.emit(f"select i1 {larger}, {self.of} {width}, {self.of} {smallest}")
        self.scale = self.emit(f"fdiv {self.of} {literal(1.0, self.dtype)}, {width}")

    def _coordinate(self, access: Access, point: str) -> str:
        """Emit the load of one coordinate of a point and return its name."""
        self.writer.scope.variables[0] = point
        found: str = self.writer.read(access)[0]
        return found

    def _cube(self, coordinate: str, lanes: int = 1) -> tuple[str, str]:
        """Emit the number of the grid cube along an axis, and the position within it [0, 1); return both names."""
        of, floor = vector(self.of, lanes), f"llvm.floor.{suffix(self.of, lanes)}"
        self.writer.declarations.add(f"declare {of} @{floor}({of})")
        scale = self.writer.widened((self.scale, 1), self.dtype, lanes)
        place = self.emit(f"fmul {of} {coordinate}, {scale}")
        whole = self.emit(f"call {of} @{floor}({of} {place})")
        # A point that is nowhere, or too far away, lies in some cube, and always in the same.
        cube = self.writer.operations.whole_part(self.dtype, np.dtype(np.int32), of, whole, lanes)
        return cube, self.emit(f"fsub {of} {place}, {whole}")

    def _leant(self, cube: str, within: str, lanes: int = 1) -> str:
        """Emit the number of the adjacent grid cube along an axis that is nearer to a point, and return its name."""
        of, number = vector(self.of, lanes), vector("i32", lanes)
        low = self.emit(f"fcmp olt {of} {within}, {splat(literal(0.5, self.dtype), self.of, lanes)}")
        below, above = (splat(text, "i32", lanes) for text in ("-1", "1"))
        side = self.emit(f"select {vector('i1', lanes)} {low}, {number} {below}, {number} {above}")
        return self.emit(f"add {number} {cube}, {side}")

    def _hash(self, cube: str, axis: int, lanes: int = 1) -> str:
        """Emit one axis' contribution to the hash of a grid cube, and return its name."""
        return self.emit(f"mul {vector('i32', lanes)} {cube}, {splat(str(_PRIMES[axis]), 'i32', lanes)}")

    def _chain(self, parts: list[str]) -> str:
        """Emit the address of the head of the linked list of a cube's points; ``parts``: hashes of its axes."""
        both = self.emit(f"xor i32 {parts[0]}, {parts[1]}")
        whole = self.emit(f"xor i32 {both}, {parts[2]}")
        number = self.emit(f"and i32 {whole}, {self.mask}")
        wide = self.emit(f"zext i32 {number} to i64")
        return self.emit(f"getelementptr i32, ptr {self.heads}, i64 {wide}")

    def _put(self, node: Node, point: str) -> None:
        """Emit code that inserts a point at the head of its grid cube's linked list."""
        cubes = [self._cube(self._coordinate(access, point))[0] for access in node.args[:3]]
        head = self._chain([self._hash(cube, axis) for axis, cube in enumerate(cubes)])
        before = self.emit(f"load i32, ptr {head}, align 4")
        after = self.emit(f"getelementptr i32, ptr {self.following}, i64 {point}")
        self.do(f"store i32 {before}, ptr {after}, align 4")
        number = self.emit(f"trunc i64 {point} to i32")
        self.do(f"store i32 {number}, ptr {head}, align 4")

    def _search(self, node: Node, point: str) -> None:
        """Emit the search for a point's nearest other point in the eight nearest grid cubes."""
        position = [self._coordinate(access, point) for access in node.args[:3]]
        choices = []
        for axis, coordinate in enumerate(position):
            cube, within = self._cube(coordinate)
            choices.append([self._hash(number, axis) for number in (cube, self._leant(cube, within))])
        best = literal(float("inf"), self.dtype)
        for corner in range(8):
            head = self._chain([choices[axis][corner >> axis & 1] for axis in range(3)])
            best = self._walk(node, point, position, head, best)
        self.writer.scope.variables[0] = point
        self.writer.write(self.writer.places[node.number], node.dtype, best, 1, [point])

    def _walk(self, node: Node, point: str, position: list[str], head: str, best: str) -> str:
        """Emit the minimum of ``best`` and the squared distances to points of the list at ``head``; return it."""
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
        """Emit ``apart`` squared plus ``rest``, rounded once, and return its name."""
        fma = f"llvm.fma.{suffix(self.of, 1)}"
        self.writer.declarations.add(f"declare {self.of} @{fma}({self.of}, {self.of}, {self.of})")
        return self.emit(f"call {self.of} @{fma}({', '.join(f'{self.of} {v}' for v in (apart, apart, rest))})")
