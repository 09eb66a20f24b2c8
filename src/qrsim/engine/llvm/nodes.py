"""What the rules of primitives are made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from jax.core import ShapedArray

from qrsim.core.arrays import DType
from qrsim.engine.llvm.graph import Graph, Parameters, Shape, View, squeezed


class Like(NamedTuple):
    """Shape and type of a result."""

    shape: Shape
    dtype: DType


class Nodes:
    """Makes nodes of a graph from views.

    Args:
        graph: to which they are added.
    """

    def __init__(self, graph: Graph):
        self.graph = graph

    def apply(
        self, name: str, shape: Shape, dtype: npt.DTypeLike, *inputs: View, attributes: tuple[object, ...] = ()
    ) -> View:
        """Add an elementwise operation on arrays of one shape, or scalars, and return a view of its result."""
        accesses = tuple([view.access(shape) for view in inputs])
        return View.whole(self.graph.node(name, accesses, squeezed(shape), dtype, attributes), shape)

    def iota(self, op: str, inputs: list[View], out: ShapedArray | Like, parameters: Parameters) -> View:
        """Add graph nodes for JAX's iota: each element's index along an axis."""
        shape, dtype = tuple(out.shape), np.dtype(out.dtype)
        # An axis of one element is none of the loop, so it has no counter.
        if shape[parameters["dimension"]] == 1:
            return self.spread(self.graph.constant(np.zeros((), dtype)), shape)
        axis = len(squeezed(shape[: parameters["dimension"]]))
        if dtype.kind != "f":
            return View.whole(self.graph.node("iota", (), squeezed(shape), dtype, (axis,)), shape)
        # Counters are whole numbers; those of floating point are converted.
        whole = View.whole(self.graph.node("iota", (), squeezed(shape), np.int32, (axis,)), shape)
        return self.apply("convert_element_type", shape, dtype, whole)

    @staticmethod
    def spread(scalar: View, shape: Shape) -> View:
        """Return a view of a scalar repeated in this shape."""
        return View(scalar.node, (), shape)

    @staticmethod
    def without_unit_axes(view: View, shape: Shape) -> View:
        """Return a view of an array in a shape that differs only in axes of length 1."""
        before = [axis for axis, extent in enumerate(view.shape) if extent != 1]
        after = [axis for axis, extent in enumerate(shape) if extent != 1]
        return view.moved(dict(zip(before, after, strict=True)), shape)
