"""The K nearest others of each point within reach, by cells of space: work grows with the number of points.

Unlike ``nearest_squared``, which serves collisions, it returns the numbers of the neighbours. It uses operations that
both compilers accept (no sort). Space is divided into vertical columns as wide as the reach, so that all points in
reach of a point are in its own column or in the eight around it. Points are listed by column, and three columns side by
side are one stretch of the list, so each point searches three stretches. A stretch has room for a fixed number of
points; a point that finds more is marked as overfull.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array, lax

from qrsim.core.tree import quantity, record

# Columns for each point: fewer collisions of far columns in the table for more memory.
_COLUMNS_FOR_A_POINT = 2
# Largest number of points that a column holds; further ones are not found, only counted.
_DEEPEST = 64
# Wider than the reach by more than rounding, 50 km from the origin too.
_WIDTH_IN_REACHES = 1.01
_NOBODY = -1


@record
class Neighbours:
    """The nearest others of n points, nearest first; at equal distance the lower number is first."""

    index: Array = quantity(doc="(K, n) int32 number of the other point; -1: nobody")
    squared: Array = quantity(unit="m^2", doc="(K, n) squared distance; infinite: nobody")
    overfull: Array = quantity(doc="(n,) bool: more points around it than there is room for, so it may miss some")


def neighbours(x: Array, y: Array, z: Array, reach: Array | float, count: int, room: int | None = None) -> Neighbours:
    """Return the up to ``count`` nearest other points within ``reach`` [m] of each of n points.

    Args:
        x, y, z: coordinates (n,) [m]; a point that is not finite has no neighbours and is no neighbour.
        reach: () [m] largest distance of a neighbour.
        count: K, the largest number of neighbours.
        room: largest number of points in three columns side by side; default: twice ``count``, at least 32. With no
            more points than in three such stretches, all pairs are compared, and no point is ever overfull.
    """
    room = _capacity(count) if room is None else room
    reach = jnp.asarray(reach, x.dtype)
    if always_room(x.shape[0], count, room):
        return _nearest_of(*_all_others(x, y, z), reach, count, jnp.zeros(x.shape, bool))
    candidates, overfull = _in_cells(x, y, z, reach, room)
    return _nearest_of(*_squared_distances(x, y, z, candidates), reach, count, overfull)


def always_room(points: int, count: int, room: int | None = None) -> bool:
    """Return whether a search by ``neighbours`` among this number of points can never overflow its tables."""
    return points - 1 <= 3 * (_capacity(count) if room is None else room)


def _capacity(count: int) -> int:
    """Return the default of ``room``, the largest number of points in three adjacent columns of grid cells."""
    return max(2 * count, 32)


def by_all_pairs(x: Array, y: Array, z: Array, reach: Array | float, count: int) -> Neighbours:
    """Return the same as ``neighbours``, computed from all pairs of points, as a reference for tests."""
    return _nearest_of(*_all_others(x, y, z), jnp.asarray(reach, x.dtype), count, jnp.zeros(x.shape, bool))


def _all_others(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Return, for each of n points, indices (n, n) and squared distances (n, n) of all points; inf to itself."""
    n = x.shape[0]
    number = jnp.broadcast_to(jnp.arange(n, dtype=jnp.int32)[:, None], (n, n))
    squared = sum((axis[None, :] - axis[:, None]) ** 2 for axis in (x, y, z))
    return number, jnp.where(number == jnp.arange(n, dtype=jnp.int32)[None, :], jnp.inf, squared)


def _squared_distances(x: Array, y: Array, z: Array, candidates: Array) -> tuple[Array, Array]:
    """Return indices and squared distances (M, n) of M candidates per point; infinite for itself and for none."""
    there = jnp.maximum(candidates, 0)
    squared = sum((axis[None, :] - axis.at[there].get(mode="promise_in_bounds")) ** 2 for axis in (x, y, z))
    itself = candidates == jnp.arange(x.shape[0], dtype=jnp.int32)[None, :]
    return candidates, jnp.where(itself | (candidates < 0), jnp.inf, squared)


def _nearest_of(number: Array, squared: Array, reach: Array, count: int, overfull: Array) -> Neighbours:
    """Return the ``count`` nearest of M candidates (M, n) within ``reach`` [m], from indices and squared distances."""
    # Written so that a NaN, which compares false, is out of reach.
    squared = jnp.where(squared <= reach * reach, squared, jnp.inf)
    most = jnp.int32(squared.shape[1])
    found, distances = [], []
    for _ in range(count):
        nearest = jnp.min(squared, axis=0)
        chosen = jnp.min(jnp.where(squared == nearest[None], number, most), axis=0)
        found.append(jnp.where(nearest < jnp.inf, chosen, _NOBODY))
        distances.append(nearest)
        # No point is chosen twice.
        squared = jnp.where(number == chosen[None], jnp.inf, squared)
    return Neighbours(jnp.stack(found), jnp.stack(distances), overfull)


def _in_cells(x: Array, y: Array, z: Array, reach: Array, room: int) -> tuple[Array, Array]:
    """Return indices (3 room, n) int32 of points in the nine columns around each, and overflow flags (n,) bool.

    Empty places have -1. A point is overfull if some of the points around it found no room.
    """
    n = x.shape[0]
    side = max(4, int((_COLUMNS_FOR_A_POINT * n) ** 0.5) + 1)
    known = jnp.isfinite(x + y + z)
    scale = 1.0 / jnp.maximum(_WIDTH_IN_REACHES * reach, 1e-3)
    # The table repeats in space; the caller excludes far points in the same column by their distance.
    cell = [
        jnp.mod(jnp.floor(jnp.where(known, axis, 0.0) * scale), side).astype(jnp.int32).clip(0, side - 1)
        for axis in (x, y)
    ]
    columns = side * side
    column = jnp.where(known, cell[0] * side + cell[1], columns)
    rank = _ranks(column, columns)
    inside = known & (rank >= 0)
    # All points of each column, also those beyond the deepest place.
    members = jnp.zeros(columns, jnp.int32).at[jnp.where(known, column, columns)].add(1, mode="drop")
    # From 0 on: where the points of each column begin.
    begin = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(jnp.minimum(members, _DEEPEST), dtype=jnp.int32)])
    slot_in_order = begin.at[jnp.minimum(column, columns - 1)].get(mode="promise_in_bounds") + rank
    order = (
        jnp.zeros(n, jnp.int32).at[jnp.where(inside, slot_in_order, n)].set(jnp.arange(n, dtype=jnp.int32), mode="drop")
    )
    parts, overfull = [], known & (rank < 0)
    slot = jnp.arange(room, dtype=jnp.int32)[:, None]
    for row in (-1, 0, 1):
        first_of_row = jnp.mod(cell[0] + row, side) * side
        lengths = [
            members.at[first_of_row + jnp.mod(cell[1] + beside, side)].get(mode="promise_in_bounds")
            for beside in (-1, 0, 1)
        ]
        shown = [jnp.minimum(part, _DEEPEST) for part in lengths]
        length = shown[0] + shown[1] + shown[2]
        out_of_sight = lengths[0] + lengths[1] + lengths[2] - length
        start = begin.at[first_of_row + jnp.mod(cell[1] - 1, side)].get(mode="promise_in_bounds")
        whole, end = (begin.at[first_of_row + k].get(mode="promise_in_bounds") for k in (0, side))
        # Around the end of the row, the stretch goes on at its beginning.
        at = start[None] + slot
        at = jnp.where(at >= end[None], at - (end - whole)[None], at)
        who = order.at[jnp.clip(at, 0, n - 1)].get(mode="promise_in_bounds")
        parts.append(jnp.where((slot < length[None]) & known[None], who, _NOBODY))
        overfull = overfull | (known & ((length > room) | (out_of_sight > 0)))
    return jnp.concatenate(parts), overfull


def _ranks(column: Array, columns: int) -> Array:
    """Return each point's rank (n,) in its column, by index; -1 without a column or beyond the deepest place."""
    n = column.shape[0]
    number = jnp.arange(n, dtype=jnp.int32)
    somewhere = column < columns
    clipped_column = jnp.minimum(column, columns - 1)

    def waits(carry: tuple[Array, Array]) -> Array:
        """Return whether any point has no rank yet: the loop's condition."""
        turn, rank = carry
        return (turn < _DEEPEST) & jnp.any(somewhere & (rank < 0))

    def one_more(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the loop's state with the next rank given to the point of lowest index in each column."""
        turn, rank = carry
        left = somewhere & (rank < 0)
        lowest = jnp.full(columns, n, jnp.int32).at[clipped_column].min(jnp.where(left, number, n), mode="drop")
        mine = left & (lowest.at[clipped_column].get(mode="promise_in_bounds") == number)
        return turn + 1, jnp.where(mine, turn, rank)

    return lax.while_loop(waits, one_more, (jnp.int32(0), jnp.full(n, -1, jnp.int32)))[1]
