"""Trees as few flat buffers, at the jit boundary only.

Handing JAX a tree of a hundred small arrays costs more per call than one simulation step; two buffers cost
next to nothing. Inside a tick the tree stays a tree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import DType, NumpyArray
from qrsim.core.structure import kinds

Buffers = tuple[Any, Any]
# Vectors are read whole where they begin at a multiple of this many bytes.
ALIGNMENT = 64
# A loop of machine code may read this many elements behind the last one.
SPARE = 64


class Packer:
    """Converts trees of one structure to (float buffer, int32 buffer) and back.

    Args:
        template: a tree of arrays or of jax.ShapeDtypeStruct. Floating-point leaves share one dtype.
    """

    def __init__(self, template: object):
        leaves, self.structure = jax.tree.flatten(template)
        self.shapes = [tuple(leaf.shape) for leaf in leaves]
        self.dtypes = [np.dtype(leaf.dtype) for leaf in leaves]
        self.is_float = [np.issubdtype(dtype, np.floating) for dtype in self.dtypes]
        floats = {dtype for dtype, is_float in zip(self.dtypes, self.is_float, strict=True) if is_float}
        # Two buffers would not do.
        if len(floats) > 1:
            raise TypeError(f"the tree mixes floating-point types {sorted(map(str, floats))}")
        self.dtype = floats.pop() if floats else np.dtype(np.float32)
        self.slices: list[slice] = []
        ends = [0, 0]
        for shape, is_float in zip(self.shapes, self.is_float, strict=True):
            # Integers of all kinds and bools share the second buffer, as int32.
            buffer, size = (0 if is_float else 1), math.prod(shape)
            self.slices.append(slice(ends[buffer], ends[buffer] + size))
            ends[buffer] += size
        self.sizes = (ends[0], ends[1])

    @cached_property
    def _identity(self) -> tuple[object, ...]:
        """Hashable identity of the layout: structure, record types, shapes and dtypes."""
        # By its text and types, because to JAX two structures are equal whose records differ in nothing but their type,
        # and two types may have one name.
        return (repr(self.structure), tuple(kinds(self.structure)), tuple(self.shapes), tuple(self.dtypes))

    def __reduce__(self) -> tuple[object, ...]:
        # JAX cannot pickle a structure in which there are records.
        return Packer, (self.template(),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Packer) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def pack(self, tree: object) -> Buffers:
        """Copy the leaves of a tree to two flat buffers, floats and integers; NumPy leaves give NumPy buffers."""
        leaves = jax.tree.leaves(tree)
        # On the host where all leaves are: JAX would send each of them to the device and back.
        numpy = np if all(isinstance(leaf, np.ndarray | np.generic) for leaf in leaves) else jnp
        floats, integers = [numpy.zeros(0, self.dtype)], [numpy.zeros(0, np.int32)]
        for leaf, is_float in zip(leaves, self.is_float, strict=True):
            if is_float:
                floats.append(numpy.reshape(leaf, (-1,)))
            elif leaf.dtype == np.uint32:
                # Bit by bit, because a key does not fit into an int32 as a number.
                integers.append(numpy.reshape(numpy.asarray(leaf).view(np.int32), (-1,)))
            else:
                integers.append(numpy.reshape(leaf, (-1,)).astype(np.int32))
        return numpy.concatenate(floats), numpy.concatenate(integers)

    def unpack(self, buffers: Buffers) -> Any:
        """Return the tree of leaves that are packed along the last axis of two buffers; NumPy buffers give views."""
        return jax.tree.unflatten(self.structure, [self.leaf(buffers, i) for i in range(len(self.slices))])

    def leaf(self, buffers: Buffers, number: int) -> Any:
        """Return leaf ``number`` of a tree of leaves that are packed along the last axis of two buffers."""
        flat = buffers[0 if self.is_float[number] else 1][..., self.slices[number]]
        leaf = flat.reshape((*flat.shape[:-1], *self.shapes[number]))
        if self.dtypes[number] == np.uint32:
            return leaf.view(np.uint32)
        if not self.is_float[number] and self.dtypes[number] != np.int32:
            return leaf.astype(self.dtypes[number])
        return leaf

    def template(self) -> Any:
        """Return the tree with a ShapeDtypeStruct in place of each leaf."""
        return jax.tree.unflatten(self.structure, list(map(struct, self.shapes, self.dtypes)))

    @cached_property
    def numbers(self) -> Any:
        """Tree of the same structure with each leaf's index in place of the leaf."""
        return jax.tree.unflatten(self.structure, range(len(self.slices)))


def struct(shape: tuple[int, ...], dtype: DType) -> jax.ShapeDtypeStruct:
    """Return a ShapeDtypeStruct for a shape and dtype."""
    return jax.ShapeDtypeStruct(shape, dtype)


def layout_of_each(tree: object) -> Packer:
    """Return the layout of one world's tree, from the tree of many worlds with leaves (B, ...)."""
    return Packer(jax.tree.map(lambda leaf: struct(np.shape(leaf)[1:], np.asarray(leaf).dtype), tree))


def aligned(size: int, dtype: DType) -> NumpyArray:
    """Return zeros (size,) in memory aligned for vectors, with room for one vector after the end."""
    raw = np.zeros(size * dtype.itemsize + ALIGNMENT + SPARE * 8, np.uint8)
    begin = -raw.ctypes.data % ALIGNMENT
    return raw[begin : begin + size * dtype.itemsize].view(dtype)


def aligned_copy(buffers: Buffers) -> Buffers:
    """Return an aligned copy of two flat buffers that a program may overwrite."""
    floats, integers = (aligned(part.size, np.dtype(part.dtype)) for part in buffers)
    floats[...], integers[...] = buffers
    return floats, integers


@dataclass(frozen=True, eq=False)
class Shared:
    """What all worlds of a program have in common.

    Attributes:
        tree: as it was given.
        layout: of the tree.
        buffers: its numbers on the host.
    """

    tree: Any
    layout: Packer
    buffers: Buffers

    @classmethod
    def of(cls, tree: object) -> Shared:
        """Pack a tree of arrays that all worlds share."""
        host = jax.tree.map(np.asarray, tree)
        layout = Packer(host)
        return cls(tree, layout, layout.pack(host))

    # Sent to the device once, not at every call.
    @cached_property
    def device_tree(self) -> Any:
        """Tree of the shared values as JAX arrays."""
        return jax.device_put(self.tree)

    @cached_property
    def device_buffers(self) -> Buffers:
        """The two flat buffers of the shared values as JAX arrays."""
        found: Buffers = jax.device_put(self.buffers)
        return found
