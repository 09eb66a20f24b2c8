"""What a graph is spared before it becomes loops: dead nodes, and products that are added to something."""

from __future__ import annotations

import numpy as np

from qrsim.native.graph import Access, Graph, Index, Node, Region

# A product that is kept from being contracted is written as its minimum with this (see fastmath.rounded).
ROUNDED_BELOW = 1e30


def composed(outer: Index, inner: Index) -> Index:
    """Return the index of reading through a node that is read at ``outer`` what that node reads at ``inner``."""
    found: list[tuple[int | None, int]] = []
    for axis, offset in inner:
        if axis is None:
            found.append((None, offset))
        else:
            followed, begin = outer[axis]
            found.append((followed, offset + begin))
    return tuple(found)


def contract(graph: Graph) -> None:
    """Make one rounding of a product and the sum it goes into, always and by one rule.

    A compiler may do so where it sees both together, so that the last bit depends on the program around. Here it
    depends on the two operations only, and results are the same to the bit however worlds are cut into programs.
    """
    _contract_region(graph.region, graph)


def _contract_region(region: Region, graph: Graph) -> None:
    before, region.nodes = region.nodes, []
    for node in before:
        for inner in node.regions:
            _contract_region(inner, graph)
        if node.op == "min" and any(_is_rounding_mark(a.node) for a in node.args):
            node.op = "rounded"
            node.args = tuple(a for a in node.args if not _is_rounding_mark(a.node))
        elif node.op in ("add", "sub") and node.dtype.kind == "f":
            _contract_node(node)
        region.nodes.append(node)


def _is_rounding_mark(node: Node) -> bool:
    return (
        node.op == "constant"
        and node.shape == ()
        and node.dtype == np.float32
        and np.frombuffer(node.attributes[0], np.float32)[0] == np.float32(ROUNDED_BELOW)
    )


def _contract_node(node: Node) -> None:
    first, second = node.args
    if second.node.op == "mul":
        node.op, rest, product = ("fma" if node.op == "add" else "fnma"), first, second
    elif first.node.op == "mul":
        node.op, rest, product = ("fma" if node.op == "add" else "fms"), second, first
    else:
        return
    a, b = (Access(arg.node, composed(product.index, arg.index)) for arg in product.node.args)
    node.args = (a, b, rest)


def live_nodes(region: Region, results: list[Access]) -> set[int]:
    """Return the numbers of the nodes that the results depend on, those in branches included."""
    live: set[int] = set()
    stack = [access.node for access in results]
    while stack:
        node = stack.pop()
        if node.number in live:
            continue
        live.add(node.number)
        stack.extend(access.node for access in node.args)
        if node.op == "output" and node.args[0].node.op == "cond":
            cond, place = node.args[0].node, node.attributes[0]
            stack.extend(branch.results[place].node for branch in cond.regions)
        if node.op == "while":
            # All that is handed from turn to turn, whether or not anybody wants it at the end.
            live.update(output.number for output in node.attributes[1])
            stack.extend(access.node for region in node.regions for access in region.results)
    return live
