"""Which nodes share a loop, in which order the loops run, and where arrays are kept between them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Any

from qrsim.engine.llvm.graph import Access, Node, Region, Shape
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.rows import along, together

OUTSIDE = ("input", "constant", "carry")
# Each of these is a step of its own.
ALONE = ("concatenate", "nearest", "scatter", "running")
# Of these, the steps of regions are parts.
NESTED = ("cond", "while")
# What no loop computes.
NO_LOOP = (*OUTSIDE, "output", *ALONE, *NESTED)
# Who reads a node: step, reading node or None, and how.
Reading = tuple[int, Any, Access]


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
    """

    kind: str
    domain: Shape
    nodes: list[Node]
    kept: tuple[int, ...] = ()
    reduced: tuple[int, ...] = ()
    branches: list[list[Step]] = field(default_factory=list)
    parts: list[Step] = field(default_factory=list)

    def reads_before(self, reader: Node, access: Access, writer: Node) -> bool:
        """Return whether of each element that ``writer`` computes ``reader``, of this step too, has read before."""
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

    def steps(self, nodes: list[Node], done: set[int]) -> list[Step]:
        """Return the steps of nodes, where those numbered ``done`` are computed before."""
        nodes = [node for node in nodes if node.number in self.live and node.op not in OUTSIDE]
        done = set(done)
        waiting = {node.number: node for node in nodes}
        # How many nodes each domain has: that of most comes last.
        sizes = Counter(node.domain for node in nodes)
        found: list[Step] = []

        def take(step: Step) -> None:
            for node in step.nodes:
                done.add(node.number)
                waiting.pop(node.number)
            found.append(step)

        while rows := together(waiting, lambda node: node.op not in NO_LOOP, self._reads):
            own = {node.number: node for node in rows}
            before = self._needed(rows, waiting)
            while any(number in waiting for number in before):
                others = {number: node for number, node in waiting.items() if number not in own}
                take(self._next(others, done, sizes, before))
            take(self._rows(own, done, sizes))
        while waiting:
            take(self._next(waiting, done, sizes, waiting.keys()))
        return found

    def _needed(self, nodes: list[Node], waiting: dict[int, Node]) -> set[int]:
        """Return the numbers of what must be computed before nodes."""
        own = {node.number for node in nodes}
        found: set[int] = set()
        stack = list(nodes)
        while stack:
            for access in self._reads(stack.pop()):
                number = access.node.number
                if number in waiting and number not in own and number not in found:
                    found.add(number)
                    stack.append(access.node)
        return found

    def _rows(self, nodes: dict[int, Node], done: set[int], sizes: Counter[Shape]) -> Step:
        extent = next(iter(nodes.values())).domain[-1]
        step = Step("rows", (extent,), list(nodes.values()))
        waiting, done = dict(nodes), set(done)
        while waiting:
            part = self._next(waiting, done, sizes, waiting.keys())
            for node in part.nodes:
                done.add(node.number)
                waiting.pop(node.number)
            step.parts.append(part)
        return step

    def _next(self, waiting: dict[int, Node], done: set[int], sizes: Counter[Shape], wanted: Collection[int]) -> Step:
        ready = [
            node for number, node in waiting.items()
            if number in wanted and node.op != "output" and self._ready(node, done)
        ]  # fmt: skip
        if not ready:
            # Cannot happen with a jaxpr; it is said rather than looped over for ever.
            raise UnsupportedError("a graph with a cycle")
        # Small domains first: what they make lets the large one run further in one loop. What changes a carry last, so
        # that it may do so in its place.
        first = min(
            ready,
            key=lambda node: (node.op in NESTED, _changes_carry(node), sizes[node.domain] if node.domain else -1),
        )
        if first.op in NESTED:
            return self._branching(first, waiting, done)
        if first.op in ALONE:
            return Step(first.op, first.shape, [first])
        return self._loop(first, waiting, done)

    def _loop(self, first: Node, waiting: dict[int, Node], done: set[int]) -> Step:
        domain, nodes = first.domain, []
        inside: set[int] = set()
        reduced: tuple[int, ...] | None = None
        for node in waiting.values():
            if node.domain != domain or node.op in NO_LOOP:
                continue
            if not all(self._available(access, domain, inside, done) for access in node.args):
                continue
            # A pick reads elements that other turns of the loop make, so its array must be whole first.
            if node.op == "pick" and node.args[0].node.number in inside:
                continue
            # A nest has one set of reduced axes; another set is another nest.
            if node.op == "reduce":
                axes = tuple(sorted(node.attributes[1]))
                if reduced is None:
                    reduced = axes
                if axes != reduced:
                    continue
            else:
                inside.add(node.number)
            nodes.append(node)
        reduced = reduced or ()
        kept = tuple(axis for axis in range(len(domain)) if axis not in reduced)
        return Step("loop", domain, nodes, kept, reduced)

    @staticmethod
    def _available(access: Access, domain: Shape, inside: set[int], done: set[int]) -> bool:
        node = access.node
        if node.op in OUTSIDE or node.number in done:
            return True
        return node.number in inside and access.identical(domain)

    def _ready(self, node: Node, done: set[int]) -> bool:
        return all(access.node.op in OUTSIDE or access.node.number in done for access in self._reads(node))

    def _reads(self, node: Node) -> Iterable[Access]:
        return self._outer(node) if node.op in NESTED else node.args

    def _outer(self, cond: Node) -> list[Access]:
        """List the nodes that a step with parts reads from outside."""
        own: set[int] = set()
        # Its regions are computed within it, so what they read must be there before.
        accesses = list(cond.args)

        def visit(region: Region) -> None:
            for node in region.nodes:
                own.add(node.number)
                if node.number in self.live:
                    accesses.extend(node.args)
                    for inner in node.regions:
                        visit(inner)
            accesses.extend(result for result in region.results if result.node.number in self.live)

        for region in cond.regions:
            visit(region)
        return [access for access in accesses if access.node.number not in own]

    def _branching(self, cond: Node, waiting: dict[int, Node], done: set[int]) -> Step:
        outputs = [node for node in waiting.values() if node.op == "output" and node.args[0].node is cond]
        step = Step(cond.op, (), [cond, *outputs])
        step.branches = [self.steps(region.nodes, done) for region in cond.regions]
        return step


def _changes_carry(node: Node) -> bool:
    return node.op == "scatter" and node.args[0].node.op == "carry"


def in_place(steps: list[Step]) -> dict[int, Node]:
    """Return, by its number, each scatter of a loop's body that may write where its carry lies: that carry's output.

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
                    _changes_carry(scatter)
                    and scatter.args[0].node is carry
                    and scatter.args[0].identical(scatter.shape)
                    and result.identical(scatter.shape)
                    and len(own) == 1
                    and max(i for i, _ in reads) == own[0]
                ):
                    found[scatter.number] = output
    return found


def inner_accesses(step: Step) -> list[tuple[Node | None, Access]]:
    """Return (reader, access) of all that a step reads, branches included; the reader is None for their results."""
    found: list[tuple[Node | None, Access]] = []
    for node in step.nodes:
        if node.op in NESTED:
            found.extend((None, access) for access in node.args)
            for inner in (inner for steps in step.branches for inner in steps):
                found.extend((None, access) for _, access in inner_accesses(inner))
            found.extend((None, access) for access in branch_results(step))
        elif node.op != "output":
            found.extend((node, access) for access in node.args)
    return found


def branch_results(step: Step) -> list[Access]:
    """List the wanted nodes that the regions of a step hand out."""
    if step.kind == "while":
        return [access for region in step.nodes[0].regions for access in region.results]
    places = [output.attributes[0] for output in step.nodes if output.op == "output"]
    return [region.results[place] for region in step.nodes[0].regions for place in places]


def all_nodes(steps: list[Step]) -> list[Node]:
    """Return the nodes of steps, branches included."""
    found = []
    for step in steps:
        found.extend(step.nodes)
        for branch in step.branches:
            found.extend(all_nodes(branch))
    return found


def materialised(steps: list[Step], results: list[Access]) -> tuple[set[int], set[int]]:
    """Return the numbers of the nodes that need memory: all of an array, and of one element of its last axis.

    Whole are those that are read outside the loop that computes them.
    """
    # The results are moved to the state after the last loop.
    needed, short = {access.node.number for access in results}, set()

    def visit(steps: list[Step]) -> None:
        for step in steps:
            if step.kind in NESTED:
                needed.update(access.node.number for access in branch_results(step))
                needed.update(access.node.number for access in step.nodes[0].args)
                needed.update(node.number for node in step.nodes if step.kind == "while" and node.op == "output")
            else:
                own = {node.number for node in step.nodes} if step.kind in ("loop", "rows") else set()
                read = [access.node.number for _, access in inner_accesses(step)]
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
    """Return the numbers of the nodes that one part makes and another reads, but for those of one number an element."""
    made = {node.number for part in parts for node in part.nodes}
    found = set()
    for part in parts:
        own = {node.number for node in part.nodes}
        reads = (access.node for _, access in inner_accesses(part))
        found |= {node.number for node in reads if len(node.shape) > 1 and node.number in made - own}
    return found


class Arena:
    """Gives out byte offsets, using those of arrays that are no longer read again."""

    ALIGN = 64

    def __init__(self) -> None:
        self.free: list[tuple[int, int]] = []
        self.size = 0

    def take(self, size: int) -> int:
        """Return the offset of ``size`` bytes."""
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
        """Take back what ``take`` gave."""
        size = -(-size // self.ALIGN) * self.ALIGN
        # Neighbours become one, so that a large array finds room where small ones were.
        merged: list[tuple[int, int]] = []
        for part in sorted([*self.free, (begin, size)]):
            if merged and merged[-1][0] + merged[-1][1] == part[0]:
                merged[-1] = (merged[-1][0], merged[-1][1] + part[1])
            else:
                merged.append(part)
        self.free = merged


def readers(steps: list[Step]) -> dict[int, list[Reading]]:
    """Return for each node number who reads it."""
    found: dict[int, list[Reading]] = defaultdict(list)
    for i, step in enumerate(steps):
        for reader, access in inner_accesses(step):
            found[access.node.number].append((i, reader, access))
    return found
