"""Rules for what is read from, or put, where the program computes: single elements, parts, and other shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax.core import ShapedArray

from qrsim.core.arrays import DType
from qrsim.engine.llvm.graph import Parameters, Shape, View, squeezed
from qrsim.engine.llvm.nodes import Like, Nodes
from qrsim.engine.llvm.refusal import UnsupportedError


class Indexing(Nodes):
    """The part of a Tracer that deals with places.

    An axis of one element is no axis of a node. Where a program says how far along it something lies, that may still
    be out of range, so ranges are checked for every axis of the program's own, and before nodes are read.
    """

    # Whether the program is of one world.
    alone: bool

    def dynamic_slice(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's dynamic_slice: a slice with a run-time start, clipped into range."""
        operand, shape = inputs[0], tuple(out.shape)
        # Where the whole extent is taken, JAX brings any start to zero.
        starts = {axis: inputs[1 + axis] for axis, extent in enumerate(operand.shape) if extent != shape[axis]}
        limits = {axis: operand.shape[axis] - shape[axis] for axis in starts}
        return self._pick(operand, starts, limits, {axis: axis for axis in range(len(shape))}, out)

    def dynamic_update_slice(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's dynamic_update_slice: a slice replaced at a run-time start, clipped into range."""
        operand, update, *starts = inputs
        shape, part = operand.shape, update.shape
        if 0 in part:
            return operand
        if part == shape:
            return update
        # Worlds side by side would each put their part elsewhere.
        if not self.alone:
            raise UnsupportedError("a part of an array at a computed place, in worlds side by side")
        kept = [axis for axis, extent in enumerate(shape) if extent != 1]
        # Where the whole extent is replaced, JAX brings any start to zero.
        moving = [axis for axis in kept if part[axis] != shape[axis]]
        moved = tuple((moving.index(a), shape[a] - part[a]) if a in moving else None for a in kept)
        loop = [axis for axis, extent in enumerate(part) if extent != 1]
        follows = tuple(kept.index(axis) for axis in loop)
        accesses = (operand.access(), update.access(), *(starts[axis].access(()) for axis in moving))
        node = self.graph.node("update", accesses, squeezed(shape), out.dtype, (moved, follows), domain=squeezed(part))
        return View.whole(node, shape)

    def _pick(
        self, operand: View, starts: dict[int, View], limits: dict[int, int], follows: dict[int, int], out: ShapedArray
    ) -> View:
        """Return a view of the elements at starts that are computed at run time, one start for each indexed axis.

        Args:
            operand: the array.
            starts: axis of the array -> where it begins, () or of the result's shape.
            limits: axis -> the largest start; others are brought into range.
            follows: axis of the array -> axis of the result that it follows from there.
            out: shape and type of the result.
        """
        shape = tuple(out.shape)
        order = {axis: i for i, axis in enumerate(starts)}
        # For each axis of the array in memory: which start moves it, and the largest that it may be.
        moved = tuple((order[a], limits[a]) if a in order else None for a, _ in operand.index)
        still = operand.moved({axis: follows.get(axis) for axis in range(len(operand.shape))}, shape)
        # Every axis that is moved had one element: there is one place to read, wherever it was asked for.
        if not any(moved):
            return still
        accesses = (still.access(), *(start.access(shape) for start in starts.values()))
        return View.whole(self.graph.node("pick", accesses, squeezed(shape), out.dtype, (moved,)), shape)

    def gather(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's gather: single elements of an array at the indices in an integer array."""
        operand, places = inputs
        numbers, shape, mode = parameters["dimension_numbers"], tuple(out.shape), parameters["mode"].name
        single = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims} == set(range(len(operand.shape)))
        # Parts would need a loop inside a loop for each place; XLA has that.
        if numbers.offset_dims or not single or any(size != 1 for size in parameters["slice_sizes"]):
            raise UnsupportedError("a gather of parts")
        if mode not in ("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS"):
            raise UnsupportedError(f"a gather with mode {mode}")
        # There is no place to bring an index to.
        if 0 in operand.shape:
            raise UnsupportedError("a gather from nothing")
        follows = dict(zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True))
        starts = self._along(places, numbers.start_index_map, shape)
        limits = {axis: operand.shape[axis] - 1 for axis in starts}
        found = self._pick(operand, starts, limits, {int(a): int(b) for a, b in follows.items()}, out)
        # The start was brought into range, which is what clipping is; what is promised to be in range is so anyway.
        if mode != "FILL_OR_DROP":
            return found
        fill = np.asarray(_filling(parameters["fill_value"], out.dtype), out.dtype)
        # On the indices as they were given, before they were brought into range.
        inside = self._inside(starts, limits, shape)
        return self.apply("select_n", shape, out.dtype, inside, self.spread(self.graph.constant(fill), shape), found)

    def _inside(self, starts: dict[int, View], limits: dict[int, int], shape: Shape) -> View:
        """Return a view of bools: whether the starts of all axes are between 0 and their limits."""
        inside = self.spread(self.graph.constant(np.bool_(True)), shape)
        for axis, start in starts.items():
            dtype = start.node.dtype
            # An unsigned number is never below zero, and the test would compare it with a number it cannot be.
            tests = [("le", limits[axis])] if dtype.kind == "u" else [("ge", 0), ("le", limits[axis])]
            for op, limit in tests:
                bound = self.spread(self.graph.constant(np.asarray(limit, dtype)), shape)
                within = self.apply(op, shape, np.bool_, start, bound)
                inside = self.apply("and", shape, np.bool_, inside, within)
        return inside

    def scatter(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's scatter: single elements replaced at the indices in an integer array."""
        operand, places, updates = inputs
        numbers, shape, mode = parameters["dimension_numbers"], updates.shape, parameters["mode"].name
        inserted = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
        if numbers.update_window_dims or inserted != set(range(len(operand.shape))):
            raise UnsupportedError("a scatter of parts")
        if mode not in ("CLIP", "FILL_OR_DROP", "PROMISE_IN_BOUNDS"):
            raise UnsupportedError(f"a scatter with mode {mode}")
        # How JAX writes a function that is applied to elements.
        if op == "set" and parameters.get("update_jaxpr") is not None:
            raise UnsupportedError("a scatter that applies a function")
        # Nothing can be put into nothing.
        if 0 in operand.shape:
            return operand
        starts = self._along(places, numbers.scatter_dims_to_operand_dims, shape)
        if mode == "CLIP":
            starts = {axis: self._clipped(start, operand.shape[axis] - 1, shape) for axis, start in starts.items()}
        order = {axis: i for i, axis in enumerate(starts)}
        kept = [axis for axis, extent in enumerate(operand.shape) if extent != 1]
        moved = tuple((order[a], operand.shape[a] - 1) if a in order else None for a in kept)
        # Axes of one element are none of the node, but an index along one can still be out of range.
        single = tuple((order[a], 0) for a in order if a not in kept)
        follows = dict(zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True))
        index = View(updates.node, tuple((follows.get(a), 0) for a in kept), shape).access().index
        accesses = (operand.access(), updates.access(), *(start.access() for start in starts.values()))
        node = self.graph.node(
            "scatter", accesses, squeezed(out.shape), out.dtype, (op, moved, single, index), domain=squeezed(shape)
        )
        return View.whole(node, tuple(out.shape))

    def _clipped(self, start: View, largest: int, shape: Shape) -> View:
        """Return the run-time start of a slice clipped to [0, largest], in this shape."""
        dtype = start.node.dtype
        low, high = (self.spread(self.graph.constant(np.asarray(v, dtype)), shape) for v in (0, largest))
        return self.apply("clamp", shape, dtype, low, start, high)

    @staticmethod
    def _along(places: View, axes: Sequence[int], shape: Shape) -> dict[int, View]:
        """Return axis -> view of the start along it, from the last axis of an array of indices."""
        found = {}
        for which, axis in enumerate(axes):
            one = _joined_part(places.shifted([0] * len(shape) + [which], (*shape, 1)))
            found[int(axis)] = one.moved({i: i for i in range(len(shape))}, shape)
        return found

    def half(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add a graph node for an operation on symmetric matrices (see ``qrsim.core.symmetric``)."""
        if out.dtype.kind != "f" or inputs[0].shape[0] < 2:
            raise UnsupportedError(f"'{op}' of {out.dtype}[{inputs[0].shape[0]}]")
        attributes = (inputs[0].shape[0], *(parameters[name] for name in sorted(parameters)))
        accesses = tuple(view.access() for view in inputs)
        return View.whole(
            self.graph.node(op, accesses, squeezed(tuple(out.shape)), out.dtype, attributes), tuple(out.shape)
        )

    def reshape(self, op: str, inputs: list[View], out: ShapedArray, parameters: Parameters) -> View:
        """Add graph nodes for JAX's reshape: the array in another shape, in row-major order."""
        (operand, *dynamic), shape = inputs, tuple(out.shape)
        if dynamic:
            raise UnsupportedError("a shape that the program computes")
        if squeezed(operand.shape) == squeezed(shape):
            return self.without_unit_axes(operand, shape)
        if 0 in shape:
            return self.spread(self.graph.constant(np.zeros((), out.dtype)), shape)
        # In general an element comes from anywhere, so its place is computed: by the row-major number of both shapes.
        number = self._linear(shape)
        starts, stride = {}, 1
        for axis in reversed(range(len(operand.shape))):
            extent = operand.shape[axis]
            if extent != 1:
                over = self.apply("div", shape, np.int32, number, self._number(stride, shape))
                starts[axis] = self.apply("rem", shape, np.int32, over, self._number(extent, shape))
            stride *= extent
        return self._pick(operand, starts, {axis: operand.shape[axis] - 1 for axis in starts}, {}, out)

    def _linear(self, shape: Shape) -> View:
        """Return an array of this shape with each element's row-major index (int32)."""
        found, stride = self._number(0, shape), 1
        for axis in reversed(range(len(shape))):
            if shape[axis] != 1:
                along = self.iota("", [], Like(shape, np.dtype(np.int32)), {"dimension": axis})
                far = self.apply("mul", shape, np.int32, along, self._number(stride, shape))
                found = self.apply("add", shape, np.int32, found, far)
            stride *= shape[axis]
        return found

    def _number(self, value: int, shape: Shape) -> View:
        """Return an integer as a constant view of this shape."""
        return self.spread(self.graph.constant(np.int32(value)), shape)


def _joined_part(view: View) -> View:
    """Return a view of the single joined array that a view into concatenated arrays shows.

    JAX joins the numbers along each axis to one array of indices; to take that apart costs more than to read it.
    """
    node = view.node
    if node.op != "concatenate":
        return view
    where, begins, shapes = node.attributes
    axis, offset = view.index[where]
    if axis is not None or offset not in begins[:-1]:
        return view
    number = begins.index(offset)
    # A part of one element has no such axis.
    if len(shapes[number]) == len(node.shape):
        return view
    part = node.args[number]
    along = [index for i, index in enumerate(view.index) if i != where]
    index = tuple((None, o) if a is None else (along[a][0], along[a][1] + o) for a, o in part.index)
    return View(part.node, index, view.shape)


def _filling(value: object, dtype: DType) -> object:
    """Return the value that JAX gives for out-of-range indices: ``value``, or the dtype's default if it is None."""
    if value is not None:
        return value
    kind = np.dtype(dtype).kind
    if kind == "f":
        return np.nan
    if kind == "b":
        return True
    return np.iinfo(dtype).min if kind == "i" else np.iinfo(dtype).max
