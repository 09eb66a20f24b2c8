"""Unrolled loops: by how many turns, and the order of their operations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from qrsim.engine.llvm import kernels
from qrsim.engine.llvm.graph import Node
from qrsim.engine.llvm.schedule import Step


def turns_of(step: Step, axis: int | None) -> int:
    """Return how often to unroll the loop of a step along an axis: 1, 2 or 4 times.

    One turn of a body of some hundred operations that wait for each other fills what the processor looks ahead, and
    few of them run at once. A shorter body needs no help, and a longer one no more of it than its registers hold.
    """
    if axis is None:
        return 1
    # The results of a kernel share its operations.
    called = {(node.attributes[0], node.args) for node in step.nodes if node.op == "kernel"}
    size = sum(node.op != "kernel" for node in step.nodes) + sum(len(kernels.body(name).nodes) for name, _ in called)
    if not 60 <= size <= 200 or (size < 100 and not step.reduced):
        return 1
    return next((turns for turns in (4, 2) if step.domain[axis] % turns == 0), 1)


def parts_of(nodes: Sequence[Node]) -> list[list[Node]]:
    """Divide the graph nodes of a loop body into consecutive parts with few values needed after each.

    Up to the last kernel each node is a part, because operations of kernels wait for each other. After that parts end
    with a reduction after which fewer values are needed than after the ones next to it.
    """
    last = {access.node.number: i for i, node in enumerate(nodes) for access in node.args}
    begin = 1 + max((i for i, node in enumerate(nodes) if node.op == "kernel"), default=-1)
    kept: set[int] = set()
    # Of each reduction, where it is and how many values are needed after it.
    ends: list[tuple[int, int]] = []
    for i, node in enumerate(nodes):
        kept = {number for number in (*kept, node.number) if last.get(number, -1) > i}
        if node.op == "reduce" and i >= begin:
            ends.append((i + 1, len(kept)))
    outside = (0, len(nodes))
    around = zip([outside, *ends], ends, [*ends[1:], outside], strict=False)
    cuts = [end for (_, before), (end, own), (_, after) in around if own < min(before, after)]
    bounds = [*range(begin), *sorted({begin, *cuts, len(nodes)})]
    return [list(nodes[first:end]) for first, end in pairwise(bounds)]
