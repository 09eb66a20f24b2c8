"""Kernels in LLVM's text: as functions of the module, or written out where they are used."""

from __future__ import annotations

from functools import cache

import numpy as np

from qrsim.core.operators import make_jaxpr
from qrsim.core.primitives import KERNELS
from qrsim.engine.layout import struct
from qrsim.engine.llvm.graph import Access, Graph, View
from qrsim.engine.llvm.operations import Emit, Operations
from qrsim.engine.llvm.simplify import live_nodes
from qrsim.engine.llvm.text import literal, scalar_type, splat, vector
from qrsim.engine.llvm.tracing import Tracer


class Body:
    """The operations of a kernel.

    Args:
        name: of the kernel.
    """

    def __init__(self, name: str):
        kernel, graph = KERNELS[name], Graph()
        dtypes = [np.dtype(dtype) for dtype in kernel.takes]
        inputs = [
            graph.node("input", (), (), dtype, (i,), invariant=False, uniform=False) for i, dtype in enumerate(dtypes)
        ]
        closed = make_jaxpr(kernel.body)(*(struct((), dtype) for dtype in dtypes))
        found = Tracer(graph, False).run(closed.jaxpr, closed.consts, [View.whole(node, ()) for node in inputs])
        self.results = [view.access() for view in found]
        live = live_nodes(graph.region, self.results)
        self.inputs = [node.number for node in inputs]
        self.nodes = [
            node for node in graph.region.nodes if node.number in live and node.op not in ("input", "constant")
        ]

    def write(self, operations: Operations, turns: list[list[str]], lanes: int) -> list[list[str]]:
        """Emit the kernel's operations for several sets of arguments, interleaved; return the results of each set.

        Every operation needs the one before it. Those of two sets do not wait for each other.
        """
        known = [dict(zip(self.inputs, arguments, strict=True)) for arguments in turns]
        for node in self.nodes:
            for values in known:
                arguments = [_value(access, values, lanes) for access in node.args]
                values[node.number] = operations.compute(node, arguments, lanes)
        return [[_value(access, values, lanes) for access in self.results] for values in known]


def _value(access: Access, values: dict[int, str], lanes: int) -> str:
    """Return the name of an argument's value in a kernel; a constant is repeated in ``lanes`` lanes."""
    node = access.node
    if node.op != "constant":
        return values[node.number]
    number = np.frombuffer(node.attributes[0], node.dtype)[0]
    return splat(literal(number, node.dtype), scalar_type(node.dtype), lanes)


# A body depends on nothing but the package, and every program has some of them.
body = cache(Body)


def types(names: tuple[str, ...], lanes: int) -> list[str]:
    """Return the LLVM types of vectors of ``lanes`` elements, from names of NumPy dtypes."""
    return [vector(scalar_type(np.dtype(name)), lanes) for name in names]


def call(emit: Emit, name: str, arguments: list[str], lanes: int) -> list[str]:
    """Emit a call of a kernel's LLVM function, and return the names of its results."""
    of = _result_type(name, lanes)
    given = ", ".join(
        f"{kind} {value}" for kind, value in zip(types(KERNELS[name].takes, lanes), arguments, strict=True)
    )
    found = emit(f"call {of} {_symbol(name, lanes)}({given})")
    return [emit(f"extractvalue {of} {found}, {i}") for i in range(len(KERNELS[name].gives))]


@cache
def function(name: str, lanes: int) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the lines of the LLVM function of kernel ``name``, and the declarations it needs."""
    kernel, lines, declarations = KERNELS[name], list[str](), set[str]()

    def emit(instruction: str) -> str:
        """Append an LLVM instruction to the function and return the name of its result."""
        lines.append(f"  %v{len(lines)} = {instruction}")
        return f"%v{len(lines) - 1}"

    arguments = [f"%a{i}" for i in range(len(kernel.takes))]
    (results,) = body(name).write(Operations(emit, declarations), [arguments], lanes)
    of, found = _result_type(name, lanes), "poison"
    for i, (value, kind) in enumerate(zip(results, types(kernel.gives, lanes), strict=True)):
        found = emit(f"insertvalue {of} {found}, {kind} {value}, {i}")
    given = ", ".join(f"{kind} {each}" for kind, each in zip(types(kernel.takes, lanes), arguments, strict=True))
    head = f"define internal {of} {_symbol(name, lanes)}({given}) #0 {{"
    return (head, "entry:", *lines, f"  ret {of} {found}", "}"), frozenset(declarations)


def _symbol(name: str, lanes: int) -> str:
    """Return the symbol of a kernel's LLVM function for vectors of ``lanes`` elements."""
    return f"@kernel.{name}.{lanes}"


def _result_type(name: str, lanes: int) -> str:
    """Return the LLVM type of a kernel's results: a struct of vectors."""
    return "{ " + ", ".join(types(KERNELS[name].gives, lanes)) + " }"
