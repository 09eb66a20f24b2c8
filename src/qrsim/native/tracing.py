"""From a JAX program to a graph: one rule for each kind of operation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend import core as jex

from qrsim.native.graph import Access, Graph, Region, Shape, UnsupportedError, View, squeezed

# Operations of one element from one element of each argument, by JAX's names.
ELEMENTWISE = frozenset({
    "add", "sub", "mul", "div", "rem", "neg", "sign", "abs", "max", "min", "and", "or", "xor", "not", "eq", "ne", "lt",
    "le", "gt", "ge", "select_n", "shift_left", "shift_right_logical", "shift_right_arithmetic", "sqrt", "rsqrt",
    "floor", "ceil", "round", "is_finite", "square", "integer_pow", "clamp", "exp", "exp2", "expm1", "log", "log1p",
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "pow", "convert_element_type",
    "bitcast_convert_type",
})  # fmt: skip
# What is only there for differentiation, staging or for other compilers.
TRANSPARENT = frozenset({"copy", "copy_p", "stop_gradient", "optimization_barrier"})
CALLS = {
    "jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr", "remat": "jaxpr",
    "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr",
}  # fmt: skip
REDUCTIONS = {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_min": "min", "reduce_max": "max", "reduce_and": "and",
    "reduce_or": "or",
}  # fmt: skip
SCATTERS = {"scatter": "set", "scatter-add": "add", "scatter-min": "min", "scatter-max": "max"}
_ATTRIBUTES = {"integer_pow": "y", "round": "rounding_method"}


# From this many points on it is quicker to look into cells of space than at all pairs.
MANY_POINTS = 128


class Tracer:
    """Turns jaxprs into nodes of a graph.

    Args:
        graph: to which nodes are added.
        alone: the program is of one world, and has vectors.
    """

    def __init__(self, graph: Graph, alone: bool):
        self.graph, self.alone = graph, alone

    def run(self, jaxpr: Any, constants: Sequence[Any], arguments: Sequence[View]) -> list[View]:
        """Return the results of a jaxpr for arguments."""
        environment: dict[Any, View] = dict(zip(jaxpr.invars, arguments, strict=True))
        for variable, value in zip(jaxpr.constvars, constants, strict=True):
            environment[variable] = value if isinstance(value, View) else self.graph.constant(value)

        def read(atom: Any) -> View:
            if isinstance(atom, jex.Literal):
                of: Any = atom.aval
                return self.graph.constant(np.asarray(atom.val, of.dtype))
            return environment[atom]

        for equation in jaxpr.eqns:
            results = self._equation(equation, [read(atom) for atom in equation.invars])
            environment.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _equation(self, equation: Any, inputs: list[View]) -> list[View]:
        name, parameters = equation.primitive.name, equation.params
        out = equation.outvars[0].aval if equation.outvars else None
        if name in ELEMENTWISE:
            return [self._elementwise(name, inputs, out, parameters)]
        if name in TRANSPARENT:
            return inputs
        if name in CALLS and parameters.get("name") == "nearest_squared" and self._many(inputs[0]):
            return [self._nearest(inputs, out)]
        if name in CALLS:
            closed = parameters[CALLS[name]]
            inner = closed.jaxpr if hasattr(closed, "jaxpr") else closed
            return self.run(inner, getattr(closed, "consts", ()), inputs)
        if name in REDUCTIONS:
            return [self._reduction(name, inputs[0], out, parameters["axes"])]
        if name in SCATTERS:
            return [self._scatter(SCATTERS[name], inputs, out, parameters)]
        rule = getattr(self, f"_{name}", None)
        if rule is None:
            raise UnsupportedError(f"'{name}'")
        found = rule(inputs, out, parameters)
        return found if isinstance(found, list) else [found]

    def _elementwise(self, name: str, inputs: list[View], out: Any, parameters: Any) -> View:
        shape: Shape = tuple(out.shape)
        if out.dtype == jax.dtypes.float0:
            raise UnsupportedError("float0")
        attributes: tuple[Any, ...] = (parameters[_ATTRIBUTES[name]],) if _ATTRIBUTES.get(name) else ()
        if name == "convert_element_type" and inputs[0].node.dtype == out.dtype:
            return inputs[0]
        if name == "div" and inputs[1].node.invariant and np.dtype(out.dtype).kind == "f":
            name, inputs = "mul", [inputs[0], self._inverse(inputs[1])]
        accesses = tuple(view.access(shape) for view in inputs)
        return View.whole(self.graph.node(name, accesses, squeezed(shape), out.dtype, attributes), shape)

    def _inverse(self, divisor: View) -> View:
        """Return one over what is the same at every tick, because to divide takes ten times as long as to multiply."""
        node = divisor.node
        own = Access(node, tuple((axis, 0) for axis in range(len(node.shape))))
        one = self.graph.constant(np.ones((), node.dtype)).access(())
        inverse = self.graph.node("div", (one, own), node.shape, node.dtype)
        return View(inverse, divisor.index, divisor.shape)

    def _reduction(self, name: str, operand: View, out: Any, axes: Sequence[int]) -> View:
        kept = [axis for axis in range(len(operand.shape)) if axis not in axes]
        reduced = [axis for axis in axes if operand.shape[axis] != 1]
        moved = operand.moved({axis: i for i, axis in enumerate(kept)}, tuple(out.shape))
        if not reduced:
            return moved
        loop = [axis for axis, extent in enumerate(operand.shape) if extent != 1]
        attributes = (REDUCTIONS[name], tuple(loop.index(axis) for axis in reduced))
        node = self.graph.node(
            "reduce", (operand.access(),), squeezed(out.shape), out.dtype, attributes, domain=squeezed(operand.shape)
        )
        return View.whole(node, tuple(out.shape))

    def _many(self, points: View) -> bool:
        return self.alone and len(points.shape) == 1 and points.shape[0] >= MANY_POINTS

    def _nearest(self, inputs: list[View], out: Any) -> View:
        shape = tuple(out.shape)
        accesses = (*(view.access(shape) for view in inputs[:3]), inputs[3].access(()))
        return View.whole(self.graph.node("nearest", accesses, squeezed(shape), out.dtype), shape)

    def _apply(self, name: str, shape: Shape, dtype: Any, *inputs: View) -> View:
        """Return an elementwise operation on arrays of one shape."""
        accesses = tuple(view.access(shape) for view in inputs)
        return View.whole(self.graph.node(name, accesses, squeezed(shape), dtype), shape)

    def _argmin(self, inputs: list[View], out: Any, parameters: Any) -> View:
        return self._place_of("reduce_min", inputs[0], out, parameters["axes"])

    def _argmax(self, inputs: list[View], out: Any, parameters: Any) -> View:
        return self._place_of("reduce_max", inputs[0], out, parameters["axes"])

    def _place_of(self, extreme: str, operand: View, out: Any, axes: Sequence[int]) -> View:
        """Return the first place of the least or largest element, or of the first NaN."""
        (axis,), shape = axes, operand.shape
        if shape[axis] == 1:
            return self._spread(self.graph.constant(np.zeros((), out.dtype)), tuple(out.shape))
        kept = [i for i in range(len(shape)) if i != axis]
        best = self._reduction(extreme, operand, _Like(out.shape, operand.node.dtype), axes)
        best = best.moved(dict(enumerate(kept)), shape)
        equal = self._apply("eq", shape, np.bool_, operand, best)
        missing = self._apply("ne", shape, np.bool_, operand, operand)
        found = self._apply("or", shape, np.bool_, equal, missing)
        places = self._iota([], _Like(shape, out.dtype), {"dimension": axis})
        beyond = self._spread(self.graph.constant(np.full((), shape[axis], out.dtype)), shape)
        chosen = self._apply("select_n", shape, out.dtype, found, beyond, places)
        return self._reduction("reduce_min", chosen, out, axes)

    def _dynamic_slice(self, inputs: list[View], out: Any, parameters: Any) -> View:
        operand, shape = inputs[0], tuple(out.shape)
        starts = {axis: inputs[1 + axis] for axis, extent in enumerate(operand.shape) if extent != shape[axis]}
        limits = {axis: operand.shape[axis] - shape[axis] for axis in starts}
        return self._pick(operand, starts, limits, {axis: axis for axis in range(len(shape))}, out)

    def _pick(
        self,
        operand: View,
        starts: dict[int, View],
        limits: dict[int, int],
        follows: dict[int, int],
        out: Any,
        fill: Any = None,
    ) -> View:
        """Return elements of an array that lie where the program computes.

        Args:
            operand: the array.
            starts: axis of the array -> where it begins, () or of the result's shape.
            limits: axis -> the largest start; others are brought into range.
            follows: axis of the array -> axis of the result that it follows from there.
            out: shape and type of the result.
            fill: the result where a start is out of range, in place of the nearest in range.
        """
        shape = tuple(out.shape)
        order = {axis: i for i, axis in enumerate(starts)}
        # For each axis of the array in memory: which start moves it, and the largest that it may be.
        moved = tuple((order[a], limits[a]) if a in order else None for a, _ in operand.index)
        still = operand.moved({axis: follows.get(axis) for axis in range(len(operand.shape))}, shape)
        accesses = (still.access(), *(start.access(shape) for start in starts.values()))
        attributes = (moved, None if fill is None else np.asarray(fill, out.dtype).tobytes())
        return View.whole(self.graph.node("pick", accesses, squeezed(shape), out.dtype, attributes), shape)

    def _gather(self, inputs: list[View], out: Any, parameters: Any) -> View:
        """Single elements, each from where an array of whole numbers says."""
        operand, places = inputs
        numbers, shape, axes = parameters["dimension_numbers"], tuple(out.shape), range(len(inputs[0].shape))
        if numbers.offset_dims or {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims} != set(axes):
            raise UnsupportedError("a gather of parts")
        follows = dict(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
        starts = self._along(places, numbers.start_index_map, shape)
        limits = {axis: operand.shape[axis] - 1 for axis in starts}
        fill = _filling(parameters["fill_value"], out.dtype) if "FILL" in parameters["mode"].name else None
        return self._pick(operand, starts, limits, {int(a): int(b) for a, b in follows.items()}, out, fill)

    def _scatter(self, how: str, inputs: list[View], out: Any, parameters: Any) -> View:
        """Single elements, each to where an array of whole numbers says."""
        operand, places, updates = inputs
        numbers, shape = parameters["dimension_numbers"], updates.shape
        inserted = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        if numbers.update_window_dims or inserted != set(range(len(operand.shape))):
            raise UnsupportedError("a scatter of parts")
        if "FILL" not in parameters["mode"].name and "PROMISE" not in parameters["mode"].name:
            raise UnsupportedError("a scatter that brings into range")
        starts = self._along(places, numbers.scatter_dims_to_operand_dims, shape)
        order = {axis: i for i, axis in enumerate(starts)}
        kept = [axis for axis, extent in enumerate(operand.shape) if extent != 1]
        moved = tuple((order[a], operand.shape[a] - 1) if a in order else None for a in kept)
        single = tuple((order[a], 0) for a in order if a not in kept)
        follows = dict(zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True))
        index = View(updates.node, tuple((follows.get(a), 0) for a in kept), shape).access().index
        accesses = (operand.access(), updates.access(), *(start.access() for start in starts.values()))
        node = self.graph.node(
            "scatter", accesses, squeezed(out.shape), out.dtype, (how, moved, single, index), domain=squeezed(shape)
        )
        return View.whole(node, tuple(out.shape))

    @staticmethod
    def _along(places: View, axes: Sequence[int], shape: Shape) -> dict[int, View]:
        """Return how far along each of some axes, from an array that has them in its last one."""
        found = {}
        for which, axis in enumerate(axes):
            one = places.shifted([0] * len(shape) + [which], (*shape, 1))
            found[int(axis)] = one.moved({i: i for i in range(len(shape))}, shape)
        return found

    def _reshape(self, inputs: list[View], out: Any, parameters: Any) -> View:
        (operand, *_), shape = inputs, tuple(out.shape)
        if squeezed(operand.shape) == squeezed(shape):
            return self._without_unit_axes(operand, shape)
        number = self._linear(shape)
        starts, stride = {}, 1
        for axis in reversed(range(len(operand.shape))):
            extent = operand.shape[axis]
            if extent != 1:
                over = self._apply("div", shape, np.int32, number, self._number(stride, shape))
                starts[axis] = self._apply("rem", shape, np.int32, over, self._number(extent, shape))
            stride *= extent
        return self._pick(operand, starts, {axis: operand.shape[axis] - 1 for axis in starts}, {}, out)

    def _linear(self, shape: Shape) -> View:
        """Return the place (int32) of each element of an array in the order of its rows."""
        found, stride = self._number(0, shape), 1
        for axis in reversed(range(len(shape))):
            if shape[axis] != 1:
                along = self._iota([], _Like(shape, np.int32), {"dimension": axis})
                far = self._apply("mul", shape, np.int32, along, self._number(stride, shape))
                found = self._apply("add", shape, np.int32, found, far)
            stride *= shape[axis]
        return found

    def _number(self, value: int, shape: Shape) -> View:
        return self._spread(self.graph.constant(np.int32(value)), shape)

    def _broadcast_in_dim(self, inputs: list[View], out: Any, parameters: Any) -> View:
        operand, to = inputs[0], parameters["broadcast_dimensions"]
        grows = {axis: to[axis] for axis, extent in enumerate(operand.shape) if extent != 1}
        return operand.moved({axis: grows.get(axis) for axis in range(len(operand.shape))}, tuple(out.shape))

    def _squeeze(self, inputs: list[View], out: Any, parameters: Any) -> View:
        return self._without_unit_axes(inputs[0], tuple(out.shape))

    @staticmethod
    def _without_unit_axes(view: View, shape: Shape) -> View:
        before = [axis for axis, extent in enumerate(view.shape) if extent != 1]
        after = [axis for axis, extent in enumerate(shape) if extent != 1]
        return view.moved(dict(zip(before, after, strict=True)), shape)

    def _transpose(self, inputs: list[View], out: Any, parameters: Any) -> View:
        moves: dict[int, int | None] = {axis: i for i, axis in enumerate(parameters["permutation"])}
        return inputs[0].moved(moves, tuple(out.shape))

    def _slice(self, inputs: list[View], out: Any, parameters: Any) -> View:
        if any(stride != 1 for stride in parameters["strides"] or ()):
            raise UnsupportedError("a slice in strides")
        return inputs[0].shifted(parameters["start_indices"], tuple(out.shape))

    def _split(self, inputs: list[View], out: Any, parameters: Any) -> list[View]:
        axis, begin, parts = parameters["axis"], 0, []
        for size in parameters["sizes"]:
            shape = tuple(size if i == axis else extent for i, extent in enumerate(inputs[0].shape))
            parts.append(inputs[0].shifted([begin if i == axis else 0 for i in range(len(shape))], shape))
            begin += size
        return parts

    def _iota(self, inputs: list[View], out: Any, parameters: Any) -> View:
        shape = tuple(out.shape)
        if shape[parameters["dimension"]] == 1:
            return self._spread(self.graph.constant(np.zeros((), out.dtype)), shape)
        axis = len(squeezed(shape[: parameters["dimension"]]))
        return View.whole(self.graph.node("iota", (), squeezed(shape), out.dtype, (axis,)), shape)

    @staticmethod
    def _spread(scalar: View, shape: Shape) -> View:
        return View(scalar.node, (), shape)

    def _stack(self, inputs: list[View], out: Any, parameters: Any) -> View:
        axis = parameters["axis"] % len(out.shape)
        grown = []
        for view in inputs:
            shape = (*view.shape[:axis], 1, *view.shape[axis:])
            grown.append(view.moved({i: i if i < axis else i + 1 for i in range(len(view.shape))}, shape))
        return self._join(grown, tuple(out.shape), out.dtype, axis)

    def _concatenate(self, inputs: list[View], out: Any, parameters: Any) -> View:
        return self._join(inputs, tuple(out.shape), out.dtype, parameters["dimension"])

    def _join(self, parts: list[View], shape: Shape, dtype: Any, axis: int) -> View:
        parts = [part for part in parts if 0 not in part.shape]
        if len(parts) == 1:
            return parts[0]
        begins = np.cumsum([0, *(part.shape[axis] for part in parts)])
        where = len(squeezed(shape[:axis]))
        attributes = (where, tuple(int(b) for b in begins), tuple(squeezed(part.shape) for part in parts))
        accesses = tuple(part.access() for part in parts)
        return View.whole(self.graph.node("concatenate", accesses, squeezed(shape), dtype, attributes), shape)

    def _cond(self, inputs: list[View], out: Any, parameters: Any) -> list[View]:
        which, operands = inputs[0], inputs[1:]
        branches = parameters["branches"]
        if len(branches) != 2 or squeezed(which.shape):
            raise UnsupportedError("a switch of several branches")
        regions, results = [], []
        for branch in branches:
            region, views = self._region(branch, operands)
            regions.append(region)
            results.append(views)
        cond = self.graph.node("cond", (which.access(),), (), np.bool_, regions=tuple(regions), invariant=False)
        return [self._branch_result(cond, i, views) for i, views in enumerate(zip(*results, strict=True))]

    def _while(self, inputs: list[View], out: Any, parameters: Any) -> list[View]:
        conditions, bodies = parameters["cond_nconsts"], parameters["body_nconsts"]
        first = inputs[conditions + bodies :]
        if any(0 in view.shape for view in first):
            raise UnsupportedError("a loop over nothing")
        carries = [self._unknown("carry", (), view) for view in first]
        views = [View.whole(node, view.shape) for node, view in zip(carries, first, strict=True)]
        regions = [
            self._region(parameters["cond_jaxpr"], [*inputs[:conditions], *views])[0],
            self._region(parameters["body_jaxpr"], [*inputs[conditions : conditions + bodies], *views])[0],
        ]
        accesses = tuple(view.access() for view in first)
        node = self.graph.node("while", accesses, (), np.bool_, regions=tuple(regions), invariant=False, uniform=False)
        outputs = [self._unknown("output", (Access(node, ()),), view, i) for i, view in enumerate(first)]
        node.attributes = (tuple(carries), tuple(outputs))
        return [View.whole(output, view.shape) for output, view in zip(outputs, first, strict=True)]

    def _unknown(self, op: str, args: tuple[Access, ...], like: View, *attributes: Any) -> Any:
        dtype = like.node.dtype
        return self.graph.node(op, args, squeezed(like.shape), dtype, attributes, invariant=False, uniform=False)

    def _region(self, closed: Any, inputs: list[View]) -> tuple[Region, list[View]]:
        """Return the nodes of an inner program, and its results."""
        region = self.graph.region = Region(parent=self.graph.region)
        views = self.run(closed.jaxpr, closed.consts, inputs)
        region.results = [view.access() for view in views]
        assert region.parent is not None
        self.graph.region = region.parent
        return region, views

    def _cumsum(self, inputs: list[View], out: Any, parameters: Any) -> View:
        shape = tuple(out.shape)
        if shape[parameters["axis"]] == 1:
            return inputs[0]
        attributes = (len(squeezed(shape[: parameters["axis"]])), parameters["reverse"])
        return View.whole(
            self.graph.node("cumsum", (inputs[0].access(),), squeezed(shape), out.dtype, attributes), shape
        )

    def _branch_result(self, cond: Any, place: int, views: tuple[View, ...]) -> View:
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


def _filling(value: Any, dtype: Any) -> Any:
    """Return what JAX puts where an index is out of range."""
    if value is not None:
        return value
    kind = np.dtype(dtype).kind
    if kind == "f":
        return np.nan
    if kind == "b":
        return True
    return np.iinfo(dtype).min if kind == "i" else np.iinfo(dtype).max


class _Like(NamedTuple):
    """Shape and type of a result."""

    shape: Shape
    dtype: Any


def trace(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return the closed jaxpr of a function for arguments, or their shapes."""
    return jax.make_jaxpr(function)(*arguments)
