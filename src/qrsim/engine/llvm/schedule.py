"""Which nodes share a loop, in which order the loops run, and where arrays are kept between them."""

from __future__ import annotations

from bisect import bisect
from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.rows import along, together
from qrsim.engine.llvm.waiting import ALONE, NESTED, NO_LOOP, OUTSIDE, Waiting, changes_carry

# Who reads a node: step, reading node or None, and how.
Reading = tuple[int, Node | None, Access]


@dataclass(eq=False)
class Step:
    """One loop nest, several in one loop over their last axis, one joining of arrays, or one branching.

    Attributes:
        kind: ``loop``, ``rows``, or one of ALONE or NESTED.
        domain: extents of the loops.
        nodes: computed in it, in order.
        kept, reduced: axes of the domain, outer loops first.
        branches: the steps of each region.
        parts: of rows, the loop nests, each of which is gone through for every element of the last axis.
        group: number of the steps that run strip by strip together (see ``strips``); 0: of none.
    """

    kind: str
    domain: Shape
    nodes: list[Node]
    kept: tuple[int, ...] = ()
    reduced: tuple[int, ...] = ()
    branches: list[list[Step]] = field(default_factory=list)
    parts: list[Step] = field(default_factory=list)
    group: int = 0

    @cached_property
    def accesses(self) -> list[tuple[Node | None, Access]]:
        """All reads of the step as (reading node, access); of conditionals and loops (None, access), once per node."""
        if self.kind not in NESTED:
            return [(node, access) for node in self.nodes for access in node.args]
        inner = [access for steps in self.branches for each in steps for _, access in each.accesses]
        every = (*self.nodes[0].args, *inner, *branch_results(self))
        return [(None, access) for access in {access.node.number: access for access in every}.values()]

    def reads_before(self, reader: Node, access: Access, writer: Node) -> bool:
        """Return whether this step reads each element for ``reader`` before it overwrites it for ``writer``."""
        if not self.parts:
            return access.identical(writer.shape)
        part = {node.number: i for i, each in enumerate(self.parts) for node in each.nodes}
        first, second = part[reader.number], part[writer.number]
        if first == second:
            return access.identical(writer.shape)
        return first < second and along(access, reader)


class Scheduler:
    """Puts the live nodes of a region into steps."""

    def __init__(self, live: set[int]):
        self.live = live
        # What the regions of nodes read.
        self._outside: dict[int, list[Access]] = {}

    def steps(self, nodes: list[Node]) -> list[Step]:
        """Order graph nodes into steps (loops, copies, branches); all other inputs must have been computed before."""
        nodes = [node for node in nodes if node.number in self.live and node.op not in OUTSIDE]
        # That of most nodes comes last.
        sizes = Counter(node.domain for node in nodes)
        waiting = Waiting(nodes, self.reads, sizes)
        found: list[Step] = []

        def take(step: Step) -> None:
            """Append a step to the schedule and mark its nodes as computed."""
            waiting.take(step.nodes)
            found.append(step)

        while rows := together(waiting.nodes, lambda node: node.op not in NO_LOOP, self.reads):
            own = {node.number for node in rows}
            before = self._needed(rows, waiting)
            while not before.isdisjoint(waiting.nodes):
                take(self._next(waiting, before, own))
            take(self._rows(rows, sizes))
        while waiting.nodes:
            take(self._next(waiting))
        return found

    def _needed(self, nodes: list[Node], waiting: Waiting) -> set[int]:
        """Return the numbers of the other ``waiting`` graph nodes that these nodes depend on."""
        own = {node.number for node in nodes}
        found: set[int] = set()
        stack = list(nodes)
        while stack:
            for access in self.reads(stack.pop()):
                number = access.node.number
                if number in waiting.nodes and number not in own and number not in found:
                    found.add(number)
                    stack.append(access.node)
        return found

    def _rows(self, nodes: list[Node], sizes: Counter[Shape]) -> Step:
        """Return one step that loops over the nodes' last axis; ``sizes``: count of waiting nodes by loop shape."""
        step = Step("rows", (nodes[0].domain[-1],), nodes)
        waiting = Waiting(nodes, self.reads, sizes)
        while waiting.nodes:
            part = self._next(waiting)
            waiting.take(part.nodes)
            step.parts.append(part)
        return step

    def _next(self, waiting: Waiting, wanted: set[int] | None = None, left_out: Collection[int] = ()) -> Step:
        """Return the next step: the first waiting node (of ``wanted``), with others that fit into its loop."""
        first = waiting.first(wanted)
        if first.op in NESTED:
            return self._branching(first, waiting)
        if first.op in ALONE:
            return Step(first.op, first.shape, [first])
        nodes, reduced = waiting.loop(first, left_out)
        kept = tuple(axis for axis in range(len(first.domain)) if axis not in reduced)
        return Step("loop", first.domain, nodes, kept, reduced)

    def reads(self, node: Node) -> Collection[Access]:
        """Return a node's reads, and the reads of its nested regions from outside them, each node once."""
        if not node.regions:
            return node.args
        if node.number not in self._outside:
            # Its regions are computed within it, so what they read must be there before.
            accesses = {access.node.number: access for access in node.args}
            for region in node.regions:
                live = [inner for inner in region.nodes if inner.number in self.live]
                accesses |= {access.node.number: access for inner in live for access in self.reads(inner)}
                accesses |= {a.node.number: a for a in region.results if a.node.number in self.live}
            own = {inner.number for region in node.regions for inner in region.nodes}
            self._outside[node.number] = [access for number, access in accesses.items() if number not in own]
        return self._outside[node.number]

    def _branching(self, cond: Node, waiting: Waiting) -> Step:
        """Return the step of a conditional node, with the steps of each branch."""
        outputs = [node for node in waiting.readers[cond.number] if node.op == "output"]
        step = Step(cond.op, (), [cond, *outputs])
        step.branches = [self.steps(region.nodes) for region in cond.regions]
        return step


def in_place(steps: list[Step]) -> dict[int, Node]:
    """Return node number -> loop output, for scatters that may overwrite the carry of their loop in place.

    It hands on what it was handed with some numbers changed, and nobody reads after it what was there before.
    """
    found: dict[int, Node] = {}
    for step in steps:
        for branch in step.branches:
            found |= in_place(branch)
        if step.kind == "while":
            node, body = step.nodes[0], step.branches[1]
            read = readers(body)
            for carry, output, result in zip(*node.attributes, node.regions[1].results, strict=True):
                scatter = result.node
                reads = [(i, reader) for i, reader, _ in read[carry.number]]
                reads += [(len(body), None) for access in node.regions[1].results if access.node is carry]
                own = [i for i, reader in reads if reader is scatter]
                if (
                    changes_carry(scatter)
                    and scatter.args[0].node is carry
                    and scatter.args[0].identical(scatter.shape)
                    and result.identical(scatter.shape)
                    and len(own) == 1
                    and max(i for i, _ in reads) == own[0]
                ):
                    found[scatter.number] = output
    return found


def branch_results(step: Step) -> list[Access]:
    """Return the results of the branches of a conditional step, or of a while loop's regions."""
    if step.kind == "while":
        return [access for region in step.nodes[0].regions for access in region.results]
    places = [output.attributes[0] for output in step.nodes if output.op == "output"]
    return [region.results[place] for region in step.nodes[0].regions for place in places]


def all_nodes(steps: Sequence[Step]) -> list[Node]:
    """Return all graph nodes that these steps compute, branches included."""
    found = []
    for step in steps:
        found.extend(step.nodes)
        for branch in step.branches:
            found.extend(all_nodes(branch))
    return found


def materialised(steps: list[Step], results: list[Access]) -> tuple[set[int], set[int]]:
    """Return the numbers of nodes stored as whole arrays, and of those stored one row element at a time.

    Whole are those that are read outside the loop that computes them.
    """
    # The results are moved to the state after the last loop.
    needed, short = {access.node.number for access in results}, set()

    def visit(steps: list[Step]) -> None:
        """Collect the numbers of the nodes that steps, and the steps of their branches, read from memory."""
        for step in steps:
            if step.kind in NESTED:
                needed.update(access.node.number for access in branch_results(step))
                needed.update(access.node.number for access in step.nodes[0].args)
                needed.update(node.number for node in step.nodes if step.kind == "while" and node.op == "output")
            else:
                own = {node.number for node in step.nodes} if step.kind in ("loop", "rows") else set()
                read = [access.node.number for _, access in step.accesses]
                needed.update(number for number in read if number not in own)
                needed.update(node.args[0].node.number for node in step.nodes if node.op == "pick")
            if step.kind == "loop":
                needed.update(node.number for node in step.nodes if node.op == "reduce")
            short.update(_between(step.parts))
            for branch in step.branches:
                visit(branch)

    visit(steps)
    return needed, short - needed


def _between(parts: list[Step]) -> set[int]:
    """Return the numbers of the array nodes that one of ``parts`` of a step computes and another one reads."""
    made = {node.number for part in parts for node in part.nodes}
    found = set()
    for part in parts:
        own = {node.number for node in part.nodes}
        reads = (access.node for _, access in part.accesses)
        found |= {node.number for node in reads if len(node.shape) > 1 and node.number in made - own}
    return found


class Arena:
    """Gives out byte offsets, using those of arrays that are no longer read again."""

    ALIGN = 64

    def __init__(self) -> None:
        self.free: list[tuple[int, int]] = []
        self.size = 0

    def take(self, size: int) -> int:
        """Reserve ``size`` bytes and return their offset."""
        # A vector may begin at any place that is given out.
        size = -(-size // self.ALIGN) * self.ALIGN
        for i, (begin, length) in enumerate(self.free):
            if length >= size:
                if length == size:
                    self.free.pop(i)
                else:
                    self.free[i] = (begin + size, length - size)
                return begin
        begin, self.size = self.size, self.size + size
        return begin

    def give(self, begin: int, size: int) -> None:
        """Release ``size`` bytes at the offset ``begin`` that ``take`` reserved."""
        size = -(-size // self.ALIGN) * self.ALIGN
        first = after = bisect(self.free, (begin, size))
        # Neighbours become one, so that a large array finds room where small ones were.
        if first and sum(self.free[first - 1]) == begin:
            first -= 1
            begin, size = self.free[first][0], self.free[first][1] + size
        if after < len(self.free) and self.free[after][0] == begin + size:
            size += self.free[after][1]
            after += 1
        self.free[first:after] = [(begin, size)]


def readers(steps: list[Step]) -> dict[int, list[Reading]]:
    """Return node number -> list of the steps and nodes that read this node."""
    found: dict[int, list[Reading]] = defaultdict(list)
    for i, step in enumerate(steps):
        for reader, access in step.accesses:
            found[access.node.number].append((i, reader, access))
    return found
