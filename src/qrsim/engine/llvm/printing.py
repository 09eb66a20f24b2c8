"""The forms of a program, for people: its graph, its steps, and LLVM's text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from jax.extend.core import ClosedJaxpr

from qrsim.engine.llvm.graph import Access, Node, Region
from qrsim.engine.llvm.program import Draft, Input, Mode
from qrsim.engine.llvm.refusal import refusing
from qrsim.engine.llvm.schedule import Step

FORMS = ("graph", "steps", "llvm")


def printed(closed: ClosedJaxpr, inputs: Sequence[Input], mode: Mode, form: str) -> str:
    """Return a traced program (``closed``: its jaxpr) as text in one of the FORMS: "graph", "steps" or "llvm".

    Args:
        closed, inputs, mode: see ``program.build``.
        form: one of FORMS.

    Raises:
        UnsupportedError: the code generator does not take the program.
    """
    with refusing():
        draft = Draft(closed, inputs, mode)
        if form == "llvm":
            return draft.text(kernels_inside=True)
        lines = _region_lines(draft.graph.region, "") if form == "graph" else _schedule_lines(draft)
        return "\n".join(lines)


def _region_lines(region: Region, indent: str) -> Iterator[str]:
    """Yield the text lines of a graph region and of the regions nested in it, preceded by ``indent``."""
    for node in region.nodes:
        yield f"{indent}{_node(node)}"
        for i, inner in enumerate(node.regions):
            yield f"{indent}  region {i}:"
            yield from _region_lines(inner, f"{indent}    ")
            yield f"{indent}    -> {', '.join(map(_access, inner.results))}"


def _node(node: Node) -> str:
    """Return a graph node as text: number, type, operation and arguments, with a mark if it is computed once."""
    shape = ",".join(map(str, node.shape))
    arguments = [_access(access) for access in node.args]
    if node.op == "constant":
        arguments = [str(np.frombuffer(node.attributes[0], node.dtype).tolist())]
    elif not node.regions:
        arguments += [str(value) for value in node.attributes]
    note = " ; invariant" if node.invariant and node.op not in ("input", "constant") else ""
    return f"%{node.number}: {node.dtype.name}[{shape}] = {node.op}({', '.join(arguments)}){note}"


def _access(access: Access) -> str:
    """Return an argument's access as text: the node, and for each of its axes the loop's axis plus an offset."""
    places = [("" if axis is None else f"i{axis}") + (f"+{offset}" if offset else "") for axis, offset in access.index]
    return f"%{access.node.number}" + (f"[{','.join(place or '0' for place in places)}]" if places else "")


def _schedule_lines(draft: Draft) -> Iterator[str]:
    """Yield the text lines of the schedule (order of loops) of a program (``draft``)."""
    for name, steps in (("before the first tick", draft.prologue), ("every tick", draft.body)):
        yield f"{name}:"
        for i, step in enumerate(steps):
            yield from _step_lines(step, f"  {i}. ", "  ")
    yield f"working memory: {draft.arena.size} B"


def _step_lines(step: Step, label: str, indent: str) -> Iterator[str]:
    """Yield the text lines of a schedule's step and of its parts, preceded by ``indent``."""
    operations = ", ".join(f"{count} {op}" for op, count in Counter(node.op for node in step.nodes).most_common())
    shape = " x ".join(map(str, step.domain)) or "scalars"
    reduced = f", reduced along {step.reduced}" if step.reduced else ""
    yield f"{label}{step.kind} over {shape}{reduced}: {operations}"
    for i, part in enumerate(step.parts):
        yield from _step_lines(part, f"{indent}    part {i}: ", f"{indent}    ")
    for i, branch in enumerate(step.branches):
        yield f"{indent}    branch {i}:"
        for j, inner in enumerate(branch):
            yield from _step_lines(inner, f"{indent}      {j}. ", f"{indent}      ")
