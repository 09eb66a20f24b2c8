"""The bodies of kernels as functions of the module, one for each width of vectors."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from qrsim.core.primitives import KERNELS
from qrsim.engine.layout import struct
from qrsim.engine.llvm.emit import Emitter
from qrsim.engine.llvm.graph import Graph, Node, View
from qrsim.engine.llvm.kernel_types import result_type, symbol, types
from qrsim.engine.llvm.schedule import Step
from qrsim.engine.llvm.simplify import live_nodes
from qrsim.engine.llvm.tracing import Tracer, trace


# A body depends on nothing but the package, and every program has some of them.
@lru_cache(maxsize=64)
def kernel_text(name: str, lanes: int) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the lines of the function of a kernel, and what it declares."""
    kernel, graph = KERNELS[name], Graph()
    inputs = [_argument(graph, i, dtype) for i, dtype in enumerate(kernel.takes)]
    closed = trace(kernel.body, *(struct((), np.dtype(dtype)) for dtype in kernel.takes))
    views = [View.whole(node, ()) for node in inputs]
    results = [view.access() for view in Tracer(graph, False).run(closed.jaxpr, closed.consts, views)]
    live = live_nodes(graph.region, results)
    nodes = [node for node in graph.region.nodes if node.number in live and node.op not in ("input", "constant")]
    # As worlds side by side, each element of a vector by itself.
    writer = Emitter({}, lanes, True, _no_memory, _no_memory)
    for i, node in enumerate(inputs):
        writer.scalars[node.number] = f"%a{i}", lanes
    writer.steps([Step("loop", (), nodes)], set())
    of, found = result_type(name, lanes), "poison"
    for i, (access, element) in enumerate(zip(results, types(kernel.gives, lanes), strict=True)):
        value = writer.widened(writer.value(access), access.node.dtype, lanes)
        found = writer.emit(f"insertvalue {of} {found}, {element} {value}, {i}")
    arguments = ", ".join(f"{each} %a{i}" for i, each in enumerate(types(kernel.takes, lanes)))
    head = f"define internal {of} {symbol(name, lanes)}({arguments}) #0 {{"
    return (head, "entry:", *writer.lines, f"  ret {of} {found}", "}"), frozenset(writer.declarations)


def _argument(graph: Graph, place: int, dtype: str) -> Node:
    return graph.node("input", (), (), np.dtype(dtype), ("argument", place), invariant=False, uniform=False)


def _no_memory(*given: Any) -> Any:
    raise AssertionError("a kernel computes single elements")
