"""Nodes that are not computed yet: which of them could be, and which a loop can take together."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection
from heapq import heapify, heappop, heappush

from qrsim.engine.llvm.graph import Access, Node, Shape
from qrsim.engine.llvm.refusal import UnsupportedError

OUTSIDE = ("input", "constant", "carry")
# Each of these is a step of its own.
ALONE = ("concatenate", "nearest", "scatter", "update", "running", "half_times", "half_lowered", "half_transformed")
# Those that may write where their first argument lies.
IN_PLACE = ("half_lowered", "half_transformed")
# Of these, the steps of regions are parts.
NESTED = ("cond", "while")
# What no loop computes.
NO_LOOP = (*OUTSIDE, "output", *ALONE, *NESTED)
# Lists what a node reads, what is read inside its regions included.
Reads = Callable[[Node], Collection[Access]]
_Rank = tuple[bool, bool, int]


class Waiting:
    """Nodes by their numbers, in an order in which they can be computed, which is that of their numbers.

    Args:
        nodes: all that is not computed yet; what else they read is.
        reads: what a node reads.
        sizes: how many nodes each domain has.
    """

    def __init__(self, nodes: Collection[Node], reads: Reads, sizes: Counter[Shape]):
        self.nodes = {node.number: node for node in nodes}
        self.readers: dict[int, list[Node]] = defaultdict(list)
        self._sizes = sizes
        # How many nodes that are not computed yet each one reads; those that read none, by when they are chosen.
        self._missing: dict[int, int] = {}
        self._ready: dict[_Rank, set[int]] = defaultdict(set)
        self._released: set[int] = set()
        for node in nodes:
            needed = {access.node.number for access in reads(node)} & self.nodes.keys()
            self._missing[node.number] = len(needed)
            for number in needed:
                self.readers[number].append(node)
            if not needed:
                self._ready[self._rank(node)].add(node.number)

    def _rank(self, node: Node) -> _Rank:
        """Return a waiting graph node's sort key: small loops first, writes to the carry of a loop last."""
        # Small domains first: what they make lets the large one run further in one loop. What changes a carry last, so
        # that it may do so in its place.
        return node.op in NESTED, changes_carry(node), self._sizes[node.domain] if node.domain else -1

    def first(self, wanted: set[int] | None = None) -> Node:
        """Return the graph node to compute next, among the numbers ``wanted`` if given."""
        for rank in sorted(self._ready):
            numbers = self._ready[rank] if wanted is None else self._ready[rank] & wanted
            if numbers:
                return self.nodes[min(numbers)]
        # Cannot happen with a jaxpr; it is said rather than looked for for ever.
        raise UnsupportedError("a graph with a cycle")

    def take(self, nodes: list[Node]) -> None:
        """Remove the nodes that a step computes from those that wait, and make them available to their readers."""
        for node in nodes:
            del self.nodes[node.number]
            self._ready[self._rank(node)].discard(node.number)
            if node.number not in self._released:
                self._release(node)

    def _release(self, node: Node) -> list[Node]:
        """Mark a node as computed, and return the nodes that no longer wait for any input."""
        self._released.add(node.number)
        found = []
        for reader in self.readers[node.number]:
            self._missing[reader.number] -= 1
            # An output comes with its branching.
            if not self._missing[reader.number] and reader.op != "output":
                self._ready[self._rank(reader)].add(reader.number)
                found.append(reader)
        return found

    def loop(self, first: Node, left_out: Collection[int]) -> tuple[list[Node], tuple[int, ...]]:
        """Return nodes for the loop of ``first``, in order, without those in ``left_out``, and the axes it reduces.

        Args:
            first: one that could be computed.
            left_out: the numbers of those that must not be among them.
        """
        domain = first.domain

        def fits(node: Node) -> bool:
            """Return whether a node can be computed in the loop of ``first``."""
            return node.domain == domain and node.op not in NO_LOOP and node.number not in left_out

        found: list[Node] = []
        inside: set[int] = set()
        reduced: tuple[int, ...] | None = None
        numbers = [number for number in self._ready[self._rank(first)] if fits(self.nodes[number])]
        heapify(numbers)
        while numbers:
            node = self.nodes[heappop(numbers)]
            if any(a.node.number in inside and not a.identical(domain) for a in node.args):
                continue
            # A pick reads elements that other turns of the loop make, so its array must be whole first.
            if node.op == "pick" and node.args[0].node.number in inside:
                continue
            # A nest has one set of reduced axes; another set is another nest.
            if node.op == "reduce":
                axes = tuple(sorted(node.attributes[1]))
                reduced = axes if reduced is None else reduced
                if axes != reduced:
                    continue
            else:
                inside.add(node.number)
                for reader in self._release(node):
                    if fits(reader):
                        heappush(numbers, reader.number)
            found.append(node)
        return found, reduced or ()


def changes_carry(node: Node) -> bool:
    """Return whether a node overwrites elements of the carry of a loop."""
    return node.op in ("scatter", "update") and node.args[0].node.op == "carry"
