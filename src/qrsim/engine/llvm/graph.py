"""A tick as a graph of elementwise operations on small arrays, which is what a loop can be made of.

Axes of one element are left out: an array of shape (12, 1) is one of shape (12,) here. What only looks at an array in
another way (a slice, a new axis, a transposition) is no operation but an index, so it costs nothing.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import DType
from qrsim.engine.llvm.text import scalar_type

Shape = tuple[int, ...]
# Of an equation of JAX, by name.
Parameters = Mapping[str, Any]
# For each axis of a node: the axis of the loop it follows, or None where it stands still, and an offset.
Index = tuple[tuple[int | None, int], ...]
_NEVER_EQUAL = ("cond", "while", "carry", "output", "input")


# Equal by identity: two nodes of equal fields may be two branchings.
@dataclass(eq=False, slots=True)
class Node:
    """One array.

    Attributes:
        op: what makes it; ``input``, ``constant``, ``iota``, ``reduce``, ``concatenate``, ``pick``, ``scatter``,
            ``running``, ``cond``, ``while``, ``carry`` (what a while hands from turn to turn), ``output`` (of a cond or
            while), or an elementwise operation by JAX's name of it.
        args: what it reads.
        shape: without axes of one element.
        dtype: NumPy's.
        attributes: what else the operation is told.
        domain: shape of the loop that computes it; its own unless it reduces.
        regions: of a cond, one for each branch; of a while, its condition and its body.
        invariant: the same at every tick.
        uniform: the same in every world.
    """

    op: str
    args: tuple[Access, ...]
    shape: Shape
    dtype: DType
    attributes: tuple[Any, ...] = ()
    domain: Shape = ()
    regions: tuple[Region, ...] = ()
    invariant: bool = False
    uniform: bool = False
    number: int = 0


class Access(NamedTuple):
    """A node read at an index of the reading loop."""

    node: Node
    index: Index  # type: ignore[assignment]  # a method of tuples

    # Asked of every access, because only such a value can stay in a register between two nodes of a loop.
    def identical(self, domain: Shape) -> bool:
        """Return whether a loop over ``domain`` reads the array element by element, at its own index."""
        return self.node.shape == domain and self.index == own_index(len(domain))


class View(NamedTuple):
    """An array of the traced program: a node, seen through an index of the program's own axes, unit axes included."""

    node: Node
    index: Index  # type: ignore[assignment]  # a method of tuples
    shape: Shape

    @staticmethod
    def whole(node: Node, shape: Shape) -> View:
        """Return a view of a graph node's whole array, in a shape that may have more axes of length 1."""
        return View(node, _whole_index(shape), shape)

    def access(self, shape: Shape | None = None) -> Access:
        """Return how a loop over ``shape`` (default: the view's), without axes of length 1, reads this view."""
        return Access(self.node, _loop_index(self.index, self.shape if shape is None else shape))

    def moved(self, axes: dict[int, int | None], shape: Shape) -> View:
        """Return the view with its axis a as axis ``axes[a]`` of ``shape`` (None: dropped)."""
        index = tuple((axes.get(axis) if axis is not None else None, offset) for axis, offset in self.index)
        return View(self.node, index, shape)

    def shifted(self, starts: Sequence[int], shape: Shape) -> View:
        """Return the view of the part of this view that begins at index ``starts`` and has this ``shape``."""
        index: list[tuple[int | None, int]] = []
        for axis, offset in self.index:
            begin = 0 if axis is None else starts[axis]
            # With one element left there is nothing to follow, and the loop has no such axis.
            still = axis is None or shape[axis] == 1
            index.append((None if still else axis, offset + begin))
        return View(self.node, tuple(index), shape)


# A program has thousands of views, of a few shapes: their indices are computed once.
@lru_cache(maxsize=4096)
def squeezed(shape: Shape) -> Shape:
    """Return a shape without its axes of length 1."""
    return tuple(extent for extent in shape if extent != 1)


@lru_cache(maxsize=64)
def own_index(axes: int) -> Index:
    """Return the identity index of a loop over this number of axes: each axis at offset 0."""
    return tuple((axis, 0) for axis in range(axes))


@lru_cache(maxsize=4096)
def _whole_index(shape: Shape) -> Index:
    """Return the index by which a loop reads a whole array: each axis longer than 1 from 0."""
    return tuple((axis, 0) for axis, extent in enumerate(shape) if extent != 1)


@lru_cache(maxsize=16384)
def _loop_index(index: Index, shape: Shape) -> Index:
    """Convert an index over all axes to one over the axes longer than 1, as loops use it."""
    # Loops run over squeezed shapes, so an axis of the program has another number there.
    axes = {axis: i for i, (axis, _) in enumerate(_whole_index(shape))}
    return tuple((axes.get(axis) if axis is not None else None, offset) for axis, offset in index)


@dataclass(eq=False)
class Region:
    """A list of nodes in an order in which they can be computed, and which accesses it hands out."""

    parent: Region | None = None
    nodes: list[Node] = field(default_factory=list)
    results: list[Access] = field(default_factory=list)
    known: dict[Hashable, Node] = field(default_factory=dict)

    def find(self, key: object) -> Node | None:
        """Return the node with this key that this region or an outer one has computed; None if there is none."""
        # What lies outside is computed before the region, so it may be used inside; the reverse does not hold.
        region: Region | None = self
        while region is not None:
            found = region.known.get(key)
            if found is not None:
                return found
            region = region.parent
        return None


class Graph:
    """Nodes under construction; equal ones are made once."""

    def __init__(self) -> None:
        self.region = Region()
        self.count = 0

    def node(
        self,
        op: str,
        args: tuple[Access, ...],
        shape: Shape,
        dtype: npt.DTypeLike,
        attributes: tuple[object, ...] = (),
        *,
        domain: Shape | None = None,
        regions: tuple[Region, ...] = (),
        invariant: bool | None = None,
        uniform: bool | None = None,
    ) -> Node:
        """Add or find a node: an array and its operation. ``invariant``: same each tick, ``uniform``: in all worlds."""
        dtype = np.dtype(dtype)
        # Only a reduction and a scatter loop over something else than they make.
        domain = shape if domain is None else domain
        key = op, args, shape, dtype, attributes, domain
        # Two branchings of equal arguments have regions of their own, and two inputs are never the same.
        if op not in _NEVER_EQUAL:
            found = self.region.find(key)
            if found is not None:
                return found
        same, alike = True, True
        for access in args:
            same, alike = same and access.node.invariant, alike and access.node.uniform
        invariant, uniform = same if invariant is None else invariant, alike if uniform is None else uniform
        self.count += 1
        node = Node(op, args, shape, dtype, attributes, domain, regions, invariant, uniform, self.count)
        self.region.nodes.append(node)
        self.region.known[key] = node
        return node

    def constant(self, value: object) -> View:
        """Add a constant array to the graph and return a view of it."""
        array = np.asarray(value)
        # An array of numbers that the code generator does not have is refused here.
        scalar_type(array.dtype)
        shape = squeezed(array.shape)
        # As bytes, which can be compared and hashed, with NaN equal to itself.
        attributes = (array.reshape(shape).tobytes(),)
        return View.whole(self.node("constant", (), shape, array.dtype, attributes), array.shape)
