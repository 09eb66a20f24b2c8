"""From a JAX program to a graph: one method for each kind of operation, chosen by the table in ``rules``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import chain
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend import core as jex
from jax.extend import source_info_util

from qrsim.core.arrays import DType
from qrsim.core.nearest import by_all_pairs
from qrsim.core.operators import make_jaxpr
from qrsim.core.primitives import KERNELS
from qrsim.engine.llvm.graph import Access, Graph, Node, Parameters, Region, Shape, View, squeezed
from qrsim.engine.llvm.indexing import Indexing
from qrsim.engine.llvm.nodes import Like
from qrsim.engine.llvm.refusal import UnsupportedError
from qrsim.engine.llvm.rules import rule_of
from qrsim.engine.llvm.text import scalar_type

_ATTRIBUTES = {"integer_pow": "y", "round": "rounding_method"}
# Of all others, all arguments are of one type.
_MIXED = ("select_n", "convert_element_type", "bitcast_convert_type")
# From this many points on it is quicker to look into cells of space than at all pairs.
MANY_POINTS = 128
# A loop over at most so many turns is written out: its values stay in registers.
UNROLLED = 4


class Tracer(Indexing):
    """Turns jaxprs into nodes of a graph.

    Args:
        graph: to which nodes are added.
        alone: whether the program is of one world, and its arrays are vectors.
    """

    def __init__(self, graph: Graph, alone: bool):
        super().__init__(graph)
        self.alone = alone
        self._variables_used_once: dict[jex.Jaxpr, set[jex.Var]] = {}  # jaxprs compare by identity

    def run(self, jaxpr: jex.Jaxpr, constants: Sequence[object], arguments: Sequence[View]) -> list[View]:
        """Translate a jaxpr to graph nodes; return views of its results, given its arguments and constants."""
        environment: dict[object, View] = dict(zip(jaxpr.invars, arguments, strict=True))
        for variable, value in zip(jaxpr.constvars, constants, strict=True):
            environment[variable] = value if isinstance(value, View) else self.graph.constant(value)

        def read(atom: object) -> View:
            """Return the view of a variable or a literal of the jaxpr."""
            if isinstance(atom, jex.Literal):
                of: Any = atom.aval
                return self.graph.constant(np.asarray(atom.val, of.dtype))
            return environment[atom]

        # For each function by itself: whether a product is rounded must not depend on who calls the function.
        products = _Products(self._used_once(jaxpr))
        for equation in jaxpr.eqns:
            inputs = [read(atom) for atom in equation.invars]
            try:
                results = self._equation(equation, inputs, products)
            # The innermost line of the program is the most specific.
            except UnsupportedError as error:
                raise error.at(source_info_util.summarize(equation.source_info)) from None
            environment.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _used_once(self, jaxpr: jex.Jaxpr) -> set[jex.Var]:
        """Return the variables of a jaxpr that exactly one equation or result uses, once.

        A product among them may be fused with its sum (see ``_contracted``). Sets are kept for later calls.
        """
        if jaxpr not in self._variables_used_once:
            uses = chain(jaxpr.outvars, *(equation.invars for equation in jaxpr.eqns))
            counts = Counter(atom for atom in uses if not isinstance(atom, jex.Literal))
            self._variables_used_once[jaxpr] = {variable for variable, count in counts.items() if count == 1}
        return self._variables_used_once[jaxpr]

    def _equation(self, equation: Any, inputs: list[View], products: _Products) -> list[View]:
        """Translate one equation of a jaxpr to graph nodes, and return views of its results."""
        rule = rule_of(equation)
        for variable in (*equation.invars, *equation.outvars):
            # Known here, where the line of the program is known too.
            scalar_type(variable.aval.dtype)
        out = equation.outvars[0].aval if equation.outvars else None
        arithmetic = rule.method == "elementwise" and rule.op in ("add", "sub", "mul")
        if arithmetic and out is not None and out.dtype.kind == "f":
            return [self._contracted(rule.op, equation, inputs, out, products)]
        found = getattr(self, rule.method)(rule.op, inputs, out, equation.params)
        return found if isinstance(found, list) else [found]

    def _contracted(
        self, op: str, equation: jex.JaxprEqn, inputs: list[View], out: ShapedArray, products: _Products
    ) -> View:
        """Add graph nodes for a sum, difference or product; fuse a product with the only sum that uses it.

        Compilers fuse a product and a sum if they see both together, so the last bit depends on the surrounding
        program. Here it depends only on the function that contains both. A product that is used elsewhere too is
        rounded, so that it is the same number everywhere. Two products are both rounded: a * b - a * b is zero.
        """
        shape = tuple(out.shape)
        plain = self.apply(op, shape, out.dtype, *inputs)
        if op == "mul":
            products.made[equation.outvars[0]] = inputs
            return plain
        first, second = (products.of(atom) for atom in equation.invars)
        # Neither is a product, or both are.
        if (first is None) == (second is None):
            return plain
        which = 0 if second is None else 1
        if not products.only_here(equation.invars[which]) or inputs[which].shape != shape:
            return plain
        factors, rest = first or second, inputs[1 - which]
        assert factors is not None
        name = "fma" if op == "add" else ("fms", "fnma")[which]
        return self.apply(name, shape, out.dtype, *factors, rest)

    def elementwise(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for an elementwise primitive of JAX."""
        shape: Shape = tuple(out.shape)
        before = inputs[0].node.dtype
        if op == "convert_element_type" and before == out.dtype:
            return inputs[0]
        if op == "bitcast_convert_type" and (
            "b" in (before.kind, out.dtype.kind) or before.itemsize != out.dtype.itemsize
        ):
            raise UnsupportedError(f"the bits of {before} as {out.dtype}")
        if op not in _MIXED and len({view.node.dtype for view in inputs}) > 1:
            raise UnsupportedError(f"'{op}' of {' and '.join(str(view.node.dtype) for view in inputs)}")
        if op == "select_n" and (len(inputs) != 3 or before.kind != "b"):
            raise UnsupportedError("a selection among several")
        attributes = (int(parameters[_ATTRIBUTES[op]]),) if op in _ATTRIBUTES else ()
        return self.apply(op, shape, out.dtype, *inputs, attributes=attributes)

    def kernel(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Add graph nodes for an elementwise function that is compiled as a kernel, and return its results."""
        return [
            self.apply("kernel", tuple(out.shape), np.dtype(dtype), *inputs, attributes=(op, i))
            for i, dtype in enumerate(KERNELS[op].gives)
        ]

    def transparent(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Translate a primitive that has no effect: return the arguments unchanged."""
        return inputs

    def call(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Translate a call of an inner function, and return its results."""
        closed = parameters[op]
        inner = closed.jaxpr if hasattr(closed, "jaxpr") else closed
        return self.run(inner, getattr(closed, "consts", ()), inputs)

    def reduction(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for a reduction, such as a sum, along some axes."""
        return self._reduced(op, inputs[0], out, parameters["axes"])

    def _reduced(self, op: str, operand: View, out: ShapedArray | Like, axes: Sequence[int]) -> View:
        """Return a reduction of an array along ``axes``; axes of length 1 need no reduction."""
        kept = [axis for axis in range(len(operand.shape)) if axis not in axes]
        reduced = [axis for axis in axes if operand.shape[axis] != 1]
        moved = operand.moved({axis: i for i, axis in enumerate(kept)}, tuple(out.shape))
        if not reduced:
            return moved
        loop = [axis for axis, extent in enumerate(operand.shape) if extent != 1]
        # Axes of the loop, which has no unit axes.
        attributes = (op, tuple(loop.index(axis) for axis in reduced))
        node = self.graph.node(
            "reduce", (operand.access(),), squeezed(out.shape), out.dtype, attributes, domain=squeezed(operand.shape)
        )
        return View.whole(node, tuple(out.shape))

    def running(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add a graph node for a cumulative reduction along an axis, such as cumsum."""
        shape = tuple(out.shape)
        if shape[parameters["axis"]] == 1 or 0 in shape:
            return inputs[0]
        attributes = (len(squeezed(shape[: parameters["axis"]])), parameters["reverse"], op)
        node = self.graph.node("running", (inputs[0].access(),), squeezed(shape), out.dtype, attributes)
        return View.whole(node, shape)

    def nearest(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add a graph node for the search of each point's nearest neighbour, and return its squared distance (n,)."""
        shape = tuple(out.shape)
        # Cells pay from some size on, and their tables are of one world.
        if not (self.alone and len(shape) == 1 and shape[0] >= MANY_POINTS and not inputs[3].shape):
            pairs = make_jaxpr(by_all_pairs)(*(jax.ShapeDtypeStruct(view.shape, view.node.dtype) for view in inputs))
            return self.run(pairs.jaxpr, pairs.consts, inputs)[0]
        accesses = (*(view.access(shape) for view in inputs[:3]), inputs[3].access(()))
        return View.whole(self.graph.node("nearest", accesses, squeezed(shape), out.dtype), shape)

    def place_of(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's argmin or argmax: the index of the first minimum, maximum or NaN."""
        operand, axes = inputs[0], parameters["axes"]
        (axis,), shape = axes, operand.shape
        if shape[axis] == 1:
            return self.spread(self.graph.constant(np.zeros((), out.dtype)), tuple(out.shape))
        kept = [i for i in range(len(shape)) if i != axis]
        best = self._reduced(op, operand, Like(out.shape, operand.node.dtype), axes)
        # Spread back over the axis, to be compared with every element.
        best = best.moved(dict(enumerate(kept)), shape)
        found = self.apply("eq", shape, np.bool_, operand, best)
        if operand.node.dtype.kind == "f":
            # What differs from itself is NaN, which counts as the extreme.
            missing = self.apply("ne", shape, np.bool_, operand, operand)
            found = self.apply("or", shape, np.bool_, found, missing)
        places = self.iota("", [], Like(shape, out.dtype), {"dimension": axis})
        beyond = self.spread(self.graph.constant(np.full((), shape[axis], out.dtype)), shape)
        # The least place among those that hold the extreme is the first one.
        chosen = self.apply("select_n", shape, out.dtype, found, beyond, places)
        return self._reduced("min", chosen, out, axes)

    def broadcast_in_dim(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Return a view for JAX's broadcast_in_dim: the array with further axes, along which it repeats."""
        if len(inputs) != 1:
            raise UnsupportedError("a shape that the program computes")
        operand, to = inputs[0], parameters["broadcast_dimensions"]
        grows = {axis: to[axis] for axis, extent in enumerate(operand.shape) if extent != 1}
        return operand.moved({axis: grows.get(axis) for axis in range(len(operand.shape))}, tuple(out.shape))

    def squeeze(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Return a view for JAX's squeeze: the array without some axes of length 1."""
        return self.without_unit_axes(inputs[0], tuple(out.shape))

    def transpose(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Return a view for JAX's transpose: the array with permuted axes."""
        moves: dict[int, int | None] = {axis: i for i, axis in enumerate(parameters["permutation"])}
        return inputs[0].moved(moves, tuple(out.shape))

    def slice(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Return a view for JAX's slice: a part of an array at constant begin and end, without strides."""
        if any(stride != 1 for stride in parameters["strides"] or ()):
            raise UnsupportedError("a slice in strides")
        return inputs[0].shifted(parameters["start_indices"], tuple(out.shape))

    def split(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Return views for JAX's split: consecutive parts of an array along an axis."""
        axis, begin, parts = parameters["axis"], 0, []
        for size in map(int, parameters["sizes"]):
            shape = tuple(size if i == axis else extent for i, extent in enumerate(inputs[0].shape))
            parts.append(inputs[0].shifted([begin if i == axis else 0 for i in range(len(shape))], shape))
            begin += size
        return parts

    def unstack(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Return views for JAX's unstack: the slices of an array along an axis, without this axis."""
        (view,), axis = inputs, parameters["axis"] % len(inputs[0].shape)
        parts = []
        for begin in range(view.shape[axis]):
            shape = tuple(1 if i == axis else extent for i, extent in enumerate(view.shape))
            part = view.shifted([begin if i == axis else 0 for i in range(len(shape))], shape)
            parts.append(self.without_unit_axes(part, (*shape[:axis], *shape[axis + 1 :])))
        return parts

    def tile(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's tile: an array repeated along each axis."""
        view = inputs[0]
        for axis, count in enumerate(parameters["reps"]):
            shape = tuple(extent * (count if i == axis else 1) for i, extent in enumerate(view.shape))
            view = self._join([view] * count, shape, out.dtype, axis)
        return view

    def stack(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's stack: arrays joined along a new axis."""
        axis = parameters["axis"] % len(out.shape)
        grown = []
        for view in inputs:
            shape = (*view.shape[:axis], 1, *view.shape[axis:])
            grown.append(view.moved({i: i if i < axis else i + 1 for i in range(len(view.shape))}, shape))
        return self._join(grown, tuple(out.shape), out.dtype, axis)

    def concatenate(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's concatenate: arrays joined along an axis."""
        return self._join(inputs, tuple(out.shape), out.dtype, parameters["dimension"])

    def _join(self, parts: list[View], shape: Shape, dtype: DType, axis: int) -> View:
        """Return arrays joined along an axis, without empty ones, which would give loops over nothing."""
        if 0 in shape:
            return self.spread(self.graph.constant(np.zeros((), dtype)), shape)
        parts = [part for part in parts if 0 not in part.shape]
        if len(parts) == 1:
            return parts[0]
        begins = np.cumsum([0, *(part.shape[axis] for part in parts)])
        where = len(squeezed(shape[:axis]))
        attributes = (where, tuple(int(b) for b in begins), tuple(squeezed(part.shape) for part in parts))
        accesses = tuple(part.access() for part in parts)
        return View.whole(self.graph.node("concatenate", accesses, squeezed(shape), dtype, attributes), shape)

    def cond(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Add graph nodes for JAX's cond: the results of the one of two branches that is chosen at run time."""
        which, operands = inputs[0], inputs[1:]
        branches = parameters["branches"]
        if len(branches) != 2 or which.shape:
            raise UnsupportedError("a switch of several branches")
        regions, results = [], []
        for branch in branches:
            region, views = self._region(branch, operands)
            regions.append(region)
            results.append(views)
        # Never invariant, because its regions may read the state though its condition does not.
        cond = self.graph.node("cond", (which.access(),), (), np.bool_, regions=tuple(regions), invariant=False)
        return [self._branch_result(cond, i, views) for i, views in enumerate(zip(*results, strict=True))]

    def _branch_result(self, cond: Node, place: int, views: tuple[View, ...]) -> View:
        """Return result number ``place`` of a conditional; ``views`` has this result in each branch."""
        first = views[0]
        node = self.graph.node(
            "output",
            (Access(cond, ()),),
            squeezed(first.shape),
            first.node.dtype,
            (place,),
            invariant=False,
            uniform=cond.uniform and all(view.node.uniform for view in views),
        )
        return View.whole(node, first.shape)

    def while_(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Add graph nodes for JAX's while: the final carry of a while loop."""
        conditions, bodies = parameters["cond_nconsts"], parameters["body_nconsts"]
        first = inputs[conditions + bodies :]
        if any(0 in view.shape for view in first):
            raise UnsupportedError("a loop over nothing")
        if squeezed(parameters["cond_jaxpr"].out_avals[0].shape):
            raise UnsupportedError("a loop with a condition for each element")
        # What changes from turn to turn is known to be neither the same at every tick nor in every world.
        carries = [self._unknown("carry", (), view) for view in first]
        views = [View.whole(node, view.shape) for node, view in zip(carries, first, strict=True)]
        # The condition sees the carries too, and is computed before every turn.
        regions = [
            self._region(parameters["cond_jaxpr"], [*inputs[:conditions], *views])[0],
            self._region(parameters["body_jaxpr"], [*inputs[conditions : conditions + bodies], *views])[0],
        ]
        accesses = tuple(view.access() for view in first)
        node = self.graph.node("while", accesses, (), np.bool_, regions=tuple(regions), invariant=False, uniform=False)
        outputs = [self._unknown("output", (Access(node, ()),), view, i) for i, view in enumerate(first)]
        node.attributes = (tuple(carries), tuple(outputs))
        return [View.whole(output, view.shape) for output, view in zip(outputs, first, strict=True)]

    def scan(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> list[View]:
        """Add graph nodes for JAX's scan without scanned arrays: the final carry of a loop of fixed length."""
        constants, length = parameters["num_consts"], parameters["length"]
        carries = len(inputs) - constants
        if parameters["num_carry"] != carries or len(parameters["jaxpr"].out_avals) != carries:
            raise UnsupportedError("a scan through arrays")
        if length <= UNROLLED:
            carry = inputs[constants:]
            for _ in range(length):
                carry = self.call("jaxpr", [*inputs[:constants], *carry], out, parameters)
            return carry
        turn = jex.jaxpr_as_fun(parameters["jaxpr"])

        def loop(*given: Array) -> tuple[Array, ...]:
            """Return the final carry of the scan, written as a while loop with a counter."""

            def body(state: tuple[Array, ...]) -> tuple[Array, ...]:
                """Return counter and carry after one turn of the scan."""
                return (state[0] + 1, *turn(*given[:constants], *state[1:]))

            first = (jnp.int32(0), *given[constants:])
            return jax.lax.while_loop(lambda state: state[0] < length, body, first)[1:]

        counted = make_jaxpr(loop)(*(jax.ShapeDtypeStruct(view.shape, view.node.dtype) for view in inputs))
        return self.run(counted.jaxpr, counted.consts, inputs)

    def _unknown(self, op: str, args: tuple[Access, ...], like: View, *attributes: object) -> Node:
        """Return a new node of the shape and dtype of ``like`` that may differ by tick and by world."""
        dtype = like.node.dtype
        return self.graph.node(op, args, squeezed(like.shape), dtype, attributes, invariant=False, uniform=False)

    def _region(self, closed: jex.ClosedJaxpr, inputs: list[View]) -> tuple[Region, list[View]]:
        """Translate the jaxpr ``closed`` of a branch or loop body to a separate region; return it and its results."""
        region = self.graph.region = Region(parent=self.graph.region)
        views = self.run(closed.jaxpr, closed.consts, inputs)
        region.results = [view.access() for view in views]
        assert region.parent is not None
        self.graph.region = region.parent
        return region, views


class _Products:
    """The products of one function, by their variables, and which of them are used once."""

    def __init__(self, used_once: set[jex.Var]):
        self.made: dict[object, list[View]] = {}
        self._used_once = used_once

    def of(self, atom: object) -> list[View] | None:
        """Return views of the two factors of a variable that is a product; None if it is not."""
        return None if isinstance(atom, jex.Literal) else self.made.get(atom)

    def only_here(self, atom: object) -> bool:
        """Return whether a variable is used exactly once in its jaxpr."""
        return atom in self._used_once
