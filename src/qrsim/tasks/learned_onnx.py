"""Learned policies as ONNX models, for any runtime of ONNX: ``qrsim export POLICY.npz --format onnx``.

The model maps observations and the last outputs of the network to actions and the next outputs. It needs no memory, so
that many vehicles are flown by one call.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from qrsim.extras import load
from qrsim.tasks.learned import LIMIT, MOST_SUM, PolicyFile, View

# Versions of the operators and of the file that runtimes of 2022 and later read.
OPERATORS, FILE = 17, 8
OBSERVATION, LAST, ACTION, NEXT = "observation", "last", "action", "next_last"


class _Graph:
    """Nodes and constants of a model; every method returns the name of its result."""

    def __init__(self, helper: Any, numpy_helper: Any):
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self._node, self._array = helper.make_node, numpy_helper.from_array

    def constant(self, value: Any, dtype: Any = np.float32) -> str:
        """Add a constant array to the ONNX graph and return its name."""
        name = f"constant_{len(self.constants)}"
        self.constants.append(self._array(np.asarray(value, dtype), name))
        return name

    def apply(self, operator: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        """Add an operator to the ONNX graph and return the name of its result."""
        result = name or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(self._node(operator, list(inputs), [result], **attributes))
        return result

    def columns(self, source: str, which: Any) -> str:
        """Add a selection of columns of the array ``source`` to the graph; return its name, array (N, len(which))."""
        return self.apply("Gather", source, self.constant(which, np.int64), axis=1)

    def limited(self, source: str, limit: float, name: str = "") -> str:
        """Add a clip of the array ``source`` to [-limit, limit] to the graph and return its name."""
        return self.apply("Clip", source, self.constant(-limit), self.constant(limit), name=name)


def onnx_model(file: PolicyFile) -> bytes:
    """Return a learned policy as the bytes of an ONNX model.

    Its inputs are ``observation`` (N, O) and ``last`` (N, K), zeros at the start of an episode; its outputs are
    ``action`` (N, A) in [-1, 1] and ``next_last`` (N, K), all float32.

    Raises:
        MissingExtraError: onnx is not installed.
    """
    onnx = load("onnx", "an ONNX model", "onnx")
    helper, view = onnx.helper, file.view
    graph = _Graph(helper, onnx.numpy_helper)
    value = _features(graph, view)
    value = graph.apply("Sub", value, graph.constant(file.scaling.mean))
    value = graph.limited(graph.apply("Div", value, graph.constant(file.scaling.deviation)), LIMIT)
    for number, (weights, offset) in enumerate(file.layers):
        value = graph.apply("Gemm", value, graph.constant(weights), graph.constant(offset))
        if number < len(file.layers) - 1:
            value = graph.apply("Tanh", value)
    outputs = graph.limited(value, LIMIT, "" if view.summed else NEXT)
    if view.summed:
        graph.apply("Concat", outputs, _sums(graph, view), name=NEXT, axis=1)
    reach = np.zeros((len(view.flown), len(view.acts)), np.float32)
    reach[np.arange(len(view.flown)), view.flown] = np.asarray(view.reach, np.float32)[list(view.flown)]
    moved = graph.apply("Gemm", outputs, graph.constant(reach), graph.constant(view.centre))
    graph.limited(moved, 1.0, ACTION)

    def numbers(name: str, size: int) -> Any:
        """Return ONNX's description of a float array (N, size), one row per vehicle."""
        return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["vehicles", size])

    given = [numbers(OBSERVATION, len(view.observed)), numbers(LAST, view.remembered)]
    found = [numbers(ACTION, len(view.acts)), numbers(NEXT, view.remembered)]
    made = helper.make_graph(graph.nodes, "qrsim_policy", given, found, graph.constants)
    model = helper.make_model(
        made, opset_imports=[helper.make_opsetid("", OPERATORS)], ir_version=FILE, producer_name="qrsim"
    )
    facts = {"task": view.task, "version": view.version, "seconds": view.seconds}
    facts |= {"observation": json.dumps(view.observed), "action": json.dumps(view.acts)}
    helper.set_model_props(model, {name: str(fact) for name, fact in facts.items()})
    onnx.checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString()
    return content


def _features(graph: _Graph, view: View) -> str:
    """Add the network's inputs to the graph: chosen observations and integrals, rotated, and last outputs."""
    count, pairs = len(view.observed) + len(view.summed), () if view.yaw is None else view.pairs
    source = {number: number for number in range(count)}
    known = OBSERVATION
    if view.summed:
        known = graph.apply("Concat", OBSERVATION, _remembered_sums(graph, view), axis=1)
    parts = [known]
    if pairs:
        cos, sin = (graph.apply(each, graph.columns(OBSERVATION, [view.yaw])) for each in ("Cos", "Sin"))
        north, east = (graph.columns(known, [pair[side] for pair in pairs]) for side in (0, 1))
        ahead = graph.apply("Add", graph.apply("Mul", cos, north), graph.apply("Mul", sin, east))
        right = graph.apply("Sub", graph.apply("Mul", cos, east), graph.apply("Mul", sin, north))
        parts += [ahead, right]
        for number, pair in enumerate(pairs):
            source |= {pair[0]: count + number, pair[1]: count + len(pairs) + number}
    whole = graph.apply("Concat", *parts, LAST, axis=1)
    first = count + 2 * len(pairs)
    return graph.columns(whole, [*(source[kept] for kept in view.kept), *range(first, first + len(view.flown))])


def _remembered_sums(graph: _Graph, view: View) -> str:
    """Add the selection of the integrals from the remembered values to the graph, and return its name."""
    return graph.columns(LAST, list(range(len(view.flown), view.remembered)))


def _sums(graph: _Graph, view: View) -> str:
    """Add the integrals of observations after a decision to the graph, and return their name."""
    change = graph.apply("Mul", graph.columns(OBSERVATION, list(view.summed)), graph.constant(view.seconds))
    return graph.limited(graph.apply("Add", _remembered_sums(graph, view), change), MOST_SUM)
