"""Steps of a tick that several threads share: strips of the groups, and between them what one thread does for all.

Every thread runs the same function. Each computes all scalars, and its part of the strips. The first thread does all
else. Threads wait for each other where one reads what another one wrote, or overwrites what another one read. No sum is
cut into strips, so the number of threads changes no bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from itertools import groupby

from qrsim.engine.llvm.emit import Emitter
from qrsim.engine.llvm.loops import Strip
from qrsim.engine.llvm.neighbours import Neighbours
from qrsim.engine.llvm.schedule import Step
from qrsim.engine.llvm.strips import Late, strip_pointer

# Parts of threads begin where a vector may.
_VECTOR = 16
# Bytes of an element in memory.
_ELEMENTS = (4, 8)


class Sharing:
    """Writes steps for several threads.

    Args:
        writer: of the program.
        strip: elements of a strip.
        extents: of the last axis that each group cuts.
        pointers: of all that the threads share, which they may not keep in registers while they wait.
    """

    def __init__(self, writer: Emitter, strip: int, extents: Mapping[int, int], pointers: Sequence[str]):
        self.writer, self.do, self.emit = writer, writer.do, writer.emit
        self._strip, self._extents = strip, extents
        self._wait = f"call i1 @wait(ptr %seat, i1 false, {', '.join(f'ptr {pointer}' for pointer in pointers)})"
        # What happened since all threads waited: the first one wrote; strips were written; scalars read memory, and
        # arrays that strips may overwrite.
        self._alone = self._cut = self._read = self._read_cut = False
        self._ranges: dict[int, tuple[str, str]] = {}
        writer.entry.append("  %leads = icmp eq i64 %thread, 0")

    def steps(self, steps: Sequence[Step], stored: set[int], late: Sequence[Late] = ()) -> None:
        """Emit a tick's steps for several threads, then copies to the state (``late``) and a barrier."""
        after = {each.group: each.moves for each in late}
        for group, members in groupby(steps, key=lambda step: step.group):
            if group:
                with self._strips(group):
                    self.writer.steps(list(members), stored)
                    self.writer.move_all(after.pop(group, []))
                continue
            for kind, some in groupby(members, key=_kind_of):
                if kind == "scalars":
                    self._scalars(list(some), stored)
                elif kind == "nearest":
                    for step in some:
                        self.meet(self._alone or self._cut or self._read_cut)
                        SharedNeighbours(self.writer, self).write(step.nodes[0])
                        self._cut = True
                else:
                    with self.first_thread():
                        self.writer.steps(list(some), stored)
        for group, moves in after.items():
            with self._strips(group) if group else self.first_thread():
                self.writer.move_all(moves)
        self.meet(self._alone or self._cut or self._read)

    def meet(self, needed: bool) -> None:
        """Emit a barrier of all threads if ``needed``."""
        if needed:
            self.do(self._wait)
            self._alone = self._cut = self._read = self._read_cut = False

    def _scalars(self, steps: Iterable[Step], stored: set[int]) -> None:
        """Emit scalar steps, run by every thread, after a barrier if they need one (``stored``: nodes in memory)."""
        for step in steps:
            read = [access.node for node in step.nodes for access in node.args
                    if access.node.number not in self.writer.scalars and self._changes(access.node.number)]  # fmt: skip
            if read:
                self.meet(self._alone or self._cut)
                self._read = True
                self._read_cut |= any(node.shape and node.shape[-1] > self._strip for node in read)
            self.writer.steps([step], stored)

    def _changes(self, number: int) -> bool:
        """Return whether the program overwrites the memory of the graph node with this number."""
        place = self.writer.places.get(number)
        return place is not None and (place.tight or place.pointer == "%scratch")

    @contextmanager
    def first_thread(self, wait: bool = True) -> Iterator[None]:
        """Emit a condition, so that only the first thread runs the code in this context; ``wait``: after a barrier."""
        self.meet(wait and (self._cut or self._read))
        self._alone = True
        writer, label = self.writer, self.writer.name("alone")[1:]
        self.do(f"br i1 %leads, label %{label}, label %{label}.after")
        writer.start_block(label)
        yield
        self.do(f"br label %{label}.after")
        writer.start_block(f"{label}.after")

    @contextmanager
    def _strips(self, group: int) -> Iterator[None]:
        """Emit a loop over the strips of a group of steps that the present thread computes."""
        self.meet(self._alone or self._cut or self._read_cut)
        self._cut = True
        writer, extent = self.writer, self._extents[group]
        low, high = self._range(extent)
        before, label, begin, end = writer.block, f"strips{group}", f"%strip{group}.begin", f"%strip{group}.end"
        self.do(f"br label %{label}")
        writer.start_block(label)
        place = len(writer.lines)
        writer.lines.append("")
        self.do(f"%{label}.more = icmp ult i64 {begin}, {high}")
        self.do(f"br i1 %{label}.more, label %{label}.one, label %{label}.after")
        writer.start_block(f"{label}.one")
        self.do(f"%{label}.next = add nuw nsw i64 {begin}, {self._strip}")
        self.do(f"{end} = call i64 @llvm.umin.i64(i64 %{label}.next, i64 {high})")
        writer.declarations.add("declare i64 @llvm.umin.i64(i64, i64)")
        for element in _ELEMENTS:
            back = self.emit(f"mul i64 {begin}, -{element}")
            self.do(f"{strip_pointer(group, element)} = getelementptr i8, ptr %local, i64 {back}")
        writer.strip = Strip(extent, begin, end, group)
        yield
        writer.strip = None
        writer.lines[place] = f"  {begin} = phi i64 [{low}, %{before}], [{end}, %{writer.block}]"
        self.do(f"br label %{label}")
        writer.start_block(f"{label}.after")

    @contextmanager
    def part(self, extent: int) -> Iterator[tuple[str, str]]:
        """Emit a condition around each thread's part of an axis, run if not empty; yield its begin and end."""
        self._cut = True
        (low, high), label = self._range(extent), self.writer.name("part")[1:]
        some = self.emit(f"icmp ult i64 {low}, {high}")
        self.do(f"br i1 {some}, label %{label}, label %{label}.after")
        self.writer.start_block(label)
        yield low, high
        self.do(f"br label %{label}.after")
        self.writer.start_block(f"{label}.after")

    def _range(self, extent: int) -> tuple[str, str]:
        """Emit the begin and end (exclusive) of a thread's part of ``extent`` elements; return their names."""
        if extent not in self._ranges:
            vectors, lines = -(-extent // _VECTOR), self.writer.entry
            low, high = f"%low{extent}", f"%high{extent}"
            for name, turn in ((low, "%thread"), (high, "%thread.next")):
                lines.append(f"  {name}.all = mul i64 {turn}, {vectors}")
                lines.append(f"  {name}.vector = udiv i64 {name}.all, %threads")
                lines.append(f"  {name}.whole = mul i64 {name}.vector, {_VECTOR}")
                lines.append(f"  {name} = call i64 @llvm.umin.i64(i64 {name}.whole, i64 {extent})")
            self._ranges[extent] = low, high
        return self._ranges[extent]


class SharedNeighbours(Neighbours):
    """Writes the search of the nearest other point for several threads.

    The order of the list of points that have somebody near differs from run to run. Of distances the least is taken, so
    that changes no result.

    Args:
        writer: of the program.
        sharing: of its threads.
    """

    def __init__(self, writer: Emitter, sharing: Sharing):
        super().__init__(writer)
        self._sharing = sharing

    def _alone(self) -> AbstractContextManager[None]:
        """Return a context for code that only the first thread runs."""
        return self._sharing.first_thread(wait=False)

    def _meet(self) -> None:
        """Emit a barrier of all threads."""
        self._sharing.meet(needed=True)

    def _parted(self, count: int) -> AbstractContextManager[tuple[str, str] | None]:
        """Return a context for each thread's part of ``count`` elements; it yields begin and end, None for all."""
        return self._sharing.part(count)

    def _append(self, flags: str, first: str, near: str, number: str) -> None:
        """Emit code that appends the flagged points' numbers to the list ``near``, to which all threads append."""
        label, counted = self.writer.name("near")[1:], self._counted(flags)
        # Most vectors have none, and to append takes long where threads do so in turn.
        some = self.emit(f"icmp ne i32 {counted}, 0")
        self.do(f"br i1 {some}, label %{label}, label %{label}.after")
        self.writer.start_block(label)
        self._put_in_list(flags, first, near, self.emit(f"atomicrmw add ptr {number}, i32 {counted} monotonic"))
        self.do(f"br label %{label}.after")
        self.writer.start_block(f"{label}.after")

    def _some(self, number: str) -> tuple[str, ...]:
        """Return the end (i32) and the start (i64) of a thread's part of a list of ``number`` points."""
        wide, bounds = self.emit(f"zext i32 {number} to i64"), []
        for turn in ("%thread", "%thread.next"):
            bounds.append(self.emit(f"udiv i64 {self.emit(f'mul i64 {wide}, {turn}')}, %threads"))
        return self.emit(f"trunc i64 {bounds[1]} to i32"), bounds[0]


def _kind_of(step: Step) -> str:
    """Return the threads for a step outside groups: "scalars" (each), "nearest" (all together), "alone" (first)."""
    if step.kind == "loop" and step.domain == ():
        return "scalars"
    return "nearest" if step.kind == "nearest" else "alone"
