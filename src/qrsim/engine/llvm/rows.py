"""Which nodes go through the elements of a last axis together: reductions along other axes, and who reads them.

A sum over waves at each of n vehicles is an array (n,), and its terms are one (waves, n). Loop after loop, every array
between the two would be written whole and read again. In a loop over the vehicles, with the loops over waves inside,
what is between them is as small as one vehicle's part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from qrsim.engine.llvm.graph import Access, Node
from qrsim.engine.llvm.waiting import Reads


def reduces_rows(node: Node) -> bool:
    """Return whether a graph node reduces an array along other axes than the last one."""
    last = len(node.domain) - 1
    return node.op == "reduce" and last not in node.attributes[1] and 0 not in node.domain


def along(access: Access, reader: Node) -> bool:
    """Return whether the node ``reader`` reads an argument only at its own index of the last axis."""
    last = len(reader.domain) - 1
    followed = [axis for axis, _ in access.index]
    return (
        bool(followed)
        and access.node.shape[-1] == reader.domain[-1]
        and access.index[-1] == (last, 0)
        and followed.count(last) == 1
        # What the program picks from may be read anywhere.
        and not (reader.op == "pick" and access.node is reader.args[0].node)
    )


def together(waiting: dict[int, Node], loops: Callable[[Node], bool], reads: Reads) -> list[Node]:
    """Return nodes that one loop over a last axis can compute, in order; [] if no reduction has a reader there.

    Args:
        waiting: nodes that are not yet computed, in an order in which they can be.
        loops: whether a node is computed in a loop that others may share.
        reads: what a node reads.
    """
    for extent in dict.fromkeys(node.domain[-1] for node in waiting.values() if reduces_rows(node)):
        found = _Cluster(extent, loops, reads).of(waiting)
        reductions = {node.number for node in found if reduces_rows(node)}
        if any(access.node.number in reductions for node in found for access in node.args):
            return found
    return []


class _Cluster:
    """Chooses the nodes of one extent."""

    def __init__(self, extent: int, loops: Callable[[Node], bool], reads: Reads):
        self.extent, self.loops, self.reads = extent, loops, reads
        self.inside: dict[int, Node] = {}
        # Of those, the reductions and what depends on one.
        self.reduced: set[int] = set()

    def of(self, waiting: dict[int, Node]) -> list[Node]:
        """Choose waiting nodes for one loop over the last axis: reductions, their readers and their inputs."""
        after: set[int] = set()
        for node in waiting.values():
            fits = self.loops(node) and self._fits(node)
            late, whole = False, []
            for access in self.reads(node):
                number = access.node.number
                late = late or number in after
                # What another element, or another kind of step, reads must be whole before.
                if number in self.inside and not (fits and along(access, node)):
                    whole.append(access.node)
            if late or any(other.number in self.reduced for other in whole):
                after.add(node.number)
                continue
            if whole:
                self._leave(whole)
            if fits:
                self.inside[node.number] = node
                if reduces_rows(node) or any(a.node.number in self.reduced for a in node.args):
                    self.reduced.add(node.number)
        needed = self._with_what_they_need(self.inside[number] for number in self.reduced)
        return [node for number, node in self.inside.items() if number in needed]

    def _fits(self, node: Node) -> bool:
        """Return whether a node can be computed row by row: same last axis, no reduction along it."""
        domain = node.domain
        return (
            bool(domain)
            and domain[-1] == self.extent
            and 0 not in domain
            and (node.op != "reduce" or reduces_rows(node))
        )

    def _with_what_they_need(self, nodes: Iterable[Node]) -> set[int]:
        """Return the numbers of these nodes and of all nodes of the cluster that they depend on."""
        found: set[int] = set()
        stack = list(nodes)
        while stack:
            node = stack.pop()
            if node.number in self.inside and node.number not in found:
                found.add(node.number)
                stack.extend(access.node for access in node.args)
        return found

    def _leave(self, nodes: Iterable[Node]) -> None:
        """Remove these nodes and all nodes that they depend on from the cluster."""
        for number in self._with_what_they_need(nodes):
            del self.inside[number]
