"""What a graph is spared before it becomes loops: dead nodes."""

from __future__ import annotations

from qrsim.engine.llvm.graph import Access, Region


def live_nodes(region: Region, results: list[Access]) -> set[int]:
    """Return the numbers of the nodes of ``region`` that the results depend on, nodes inside branches included."""
    live: set[int] = set()
    # By hand and not by recursion: a tick has chains of thousands of nodes.
    stack = [access.node for access in results]
    while stack:
        node = stack.pop()
        if node.number in live:
            continue
        live.add(node.number)
        stack.extend(access.node for access in node.args)
        # Of a branching only what is wanted is computed; the rest of both branches is dead.
        if node.op == "output" and node.args[0].node.op == "cond":
            cond, place = node.args[0].node, node.attributes[0]
            stack.extend(branch.results[place].node for branch in cond.regions)
        if node.op == "while":
            # All that is handed from turn to turn, whether or not anybody wants it at the end.
            live.update(output.number for output in node.attributes[1])
            stack.extend(access.node for region in node.regions for access in region.results)
    return live
