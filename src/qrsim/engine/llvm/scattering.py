"""Putting numbers into an array at places that the program computes, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from qrsim.core.arrays import DType
from qrsim.engine.llvm.graph import Node
from qrsim.engine.llvm.loops import Loops
from qrsim.engine.llvm.text import scalar_type, splat, stored_bytes, vector
from qrsim.engine.llvm.writing import Moves, Place


def write_scatter(writer: Loops, node: Node) -> None:
    """Emit a scatter: a copy of an array with updates written in order; indices out of range are dropped.

    If the copy takes the place of the array (see schedule.in_place), worlds that have left the loop keep their values.

    Args:
        writer: of the program.
        node: its arguments are the array, the updates, and their indices along some axes.
    """
    place = writer.places[node.number]
    # The array may be read elsewhere, so a copy is changed.
    if not _lies_there(writer, node):
        writer.copy(node.args[0], node.shape, place)
    shape = node.domain
    if 0 in shape:
        return
    writer.open_scope(shape)
    with writer.over(range(len(shape)), shape, None):
        lanes = writer.lanes if writer.side_by_side and place.own else 1
        values = [writer.widened(writer.value(access), access.node.dtype, lanes) for access in node.args[1:]]
        # One after the other: two of them may have the same index, and then the last one counts.
        for lane in range(lanes):
            parts = []
            for value, access in zip(values, node.args[1:], strict=True):
                of = vector(scalar_type(access.node.dtype), lanes)
                parts.append(writer.emit(f"extractelement {of} {value}, i32 {lane}") if lanes > 1 else value)
            _put(writer, node, lane if lanes > 1 else 0, parts)


def _put(writer: Loops, node: Node, lane: int, parts: list[str]) -> None:
    """Emit the store of one element of the world in ``lane``; ``parts``: names of its new value and its indices."""
    how, moved, single, index = node.attributes
    place, dtype = writer.places[node.number], node.dtype
    number, starts = parts[0], [(text, 1) for text in parts[1:]]
    dtypes = [access.node.dtype for access in node.args[2:]]
    inside = _in_range(writer, (*moved, *single), starts, dtypes, 1)
    # Memory is shared by all turns here, so a world that has left must not write any more.
    if writer.turning is not None and _lies_there(writer, node):
        going = writer.emit(f"extractelement {vector('i1', writer.lanes)} {writer.turning}, i32 {lane}")
        inside = writer.emit(f"and i1 {inside}, {going}")
    begun = writer.begun(replace(place, offset=place.offset + lane * stored_bytes(dtype)), moved, starts, dtypes)
    address = writer.address(begun, [(None if a is None else writer.scope.variables[a], o) for a, o in index])
    before, of = writer.load(dtype, address, 1), scalar_type(dtype)
    after = number if how == "set" else writer.operations.combine(how, dtype, 1, before, number)
    # Without a branch: what is out of range writes back what it read at the place in range.
    writer.store(dtype, address, writer.emit(f"select i1 {inside}, {of} {after}, {of} {before}"), 1)


def write_update(writer: Loops, node: Node) -> None:
    """Emit a copy of an array with a slice replaced at a run-time start.

    Args:
        writer: of the program, which is of one world.
        node: its arguments are the array, the part, and where that begins along some axes.
    """
    place, (moved, follows) = writer.places[node.number], node.attributes
    if not _lies_there(writer, node):
        writer.copy(node.args[0], node.shape, place)
    writer.open_scope(())
    starts = [writer.value(access) for access in node.args[2:]]
    begun = writer.begun(place, moved, starts, [access.node.dtype for access in node.args[2:]])
    strides = tuple(place.strides[axis] for axis in follows)
    # What lies behind the part is not replaced.
    writer.copy(node.args[1], node.domain, Place(begun.pointer, begun.offset, strides, place.own, tight=True))


def _lies_there(writer: Loops, node: Node) -> bool:
    """Return whether a node's result shares the memory of its first argument, so that no copy is needed."""
    return writer.places.get(node.args[0].node.number) == writer.places[node.number]


def _in_range(writer: Loops, moved: Moves, starts: list[tuple[str, int]], dtypes: Sequence[DType], lanes: int) -> str:
    """Emit whether all run-time ``starts`` are in range of the axes ``moved``, and return the name of the flag."""
    inside, mask = splat("true", "i1", lanes), vector("i1", lanes)
    for move in moved:
        if move is not None:
            dtype = dtypes[move[0]]
            start = writer.widened(starts[move[0]], dtype, lanes)
            # What is below zero is large where it is taken for unsigned.
            limit = splat(str(move[1]), scalar_type(dtype), lanes)
            within = writer.emit(f"icmp ule {vector(scalar_type(dtype), lanes)} {start}, {limit}")
            inside = writer.emit(f"and {mask} {inside}, {within}")
    return inside
