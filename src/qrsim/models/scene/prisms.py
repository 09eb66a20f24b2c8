"""Upright prisms over polygons, such as buildings: one of a scenario, and all of a world.

See docs/explanation/models/scene.md.

A world holds them as upright pieces over trapezoids with two sides along east, convex whatever the polygon is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.host import library_of
from qrsim.core.tree import parameter, quantity, record, record_of, setting
from qrsim.core.vectors import Vec3

Float64 = npt.NDArray[np.float64]
# Up to FEW_PIECES, every vehicle is compared with all pieces; beyond, with those near its cell of this side [m], larger
# where that would be more than MOST_CELLS.
FEW_PIECES, CELL, MOST_CELLS = 16, 4.0, 250_000
# Beyond this distance [m] a world's prisms need not be noticed.
LEAST_REACH = 5.0
# A coordinate beyond all vehicles [m].
_FAR = 1e7


@record
class PrismObstacle:
    """An upright prism over a polygon, such as a building; it has none of its holes."""

    north: Array = quantity(unit="m", doc="(E,) where each edge begins, of the outline and then of each hole")
    east: Array = quantity(unit="m", doc="(E,) the same, east")
    north_to: Array = quantity(unit="m", doc="(E,) where each edge ends")
    east_to: Array = quantity(unit="m", doc="(E,) the same, east")
    z_min: Array = parameter(unit="m", doc="top, negative above ground")
    z_max: Array = parameter(default=0.0, unit="m", doc="bottom; 0 is the ground")

    @staticmethod
    def of(
        corners_ned: npt.ArrayLike, z_min: float, z_max: float = 0.0, holes_ned: Sequence[npt.ArrayLike] = ()
    ) -> PrismObstacle:
        """Return a vertical prism from corners (V, 2) [m], north and east, of its outline and of each hole."""
        first, last = edges_of([corners_ned, *holes_ned])
        parts = (first[:, 0], first[:, 1], last[:, 0], last[:, 1], z_min, z_max)
        return record_of(PrismObstacle, *parts)

    def rings(self) -> list[Float64]:
        """Return the corners (V, 2) [m] of the prism's outline, then those of each hole."""
        first = np.column_stack([self.north, self.east]).astype(np.float64)
        last = np.column_stack([self.north_to, self.east_to]).astype(np.float64)
        ends = np.flatnonzero((last[:-1] != first[1:]).any(axis=1)) + 1
        return np.split(first, ends)

    def distance(self, position_ned: Vec3) -> Array:
        """Return the distance (n,) [m] of positions from the prism, 0 inside it."""
        lib = library_of(position_ned.x)
        column = (-1,) + (1,) * position_ned.x.ndim
        north, east, north_to, east_to = (
            lib.reshape(lib.asarray(part), column) for part in (self.north, self.east, self.north_to, self.east_to)
        )
        x, y = position_ned.x[None], position_ned.y[None]
        along_north, along_east = north_to - north, east_to - east
        straddles = (north > x) != (north_to > x)
        cross = along_east * (x - north) - (y - east) * along_north
        inside = lib.sum(straddles & ((cross > 0.0) == (along_north > 0.0)), axis=0) % 2 == 1
        square = lib.min(_to_segment(lib, x - north, y - east, along_north, along_east), axis=0)
        beyond = lib.maximum(lib.maximum(self.z_min - position_ned.z, position_ned.z - self.z_max), 0.0)
        return length_of(lib, lib.where(inside, 0.0 * position_ned.x, square) + beyond * beyond)


def edges_of(rings: Sequence[npt.ArrayLike]) -> tuple[Float64, Float64]:
    """Return first and last points (E, 2) of the edges of closed rings of corners (V, 2)."""
    corners = [np.asarray(ring, np.float64).reshape(-1, 2) for ring in rings]
    return np.concatenate(corners), np.concatenate([np.roll(ring, -1, axis=0) for ring in corners])


def _to_segment(lib: ModuleType, x: Array, y: Array, along_x: Array, along_y: Array) -> Array:
    """Return the squared distance of points (x, y) from a segment that leads from (0, 0) to (along_x, along_y)."""
    square = along_x * along_x + along_y * along_y
    part = lib.clip((x * along_x + y * along_y) / lib.where(square > 0.0, square, 1.0), 0.0, 1.0)
    across_x, across_y = x - part * along_x, y - part * along_y
    return across_x * across_x + across_y * across_y


def length_of(lib: ModuleType, square: Array) -> Array:
    """Return the square root of squared lengths, with gradient 0 at 0; NaN stays NaN."""
    zero = square <= 0.0
    return lib.where(zero, 0.0, lib.sqrt(lib.where(zero, 1.0, square)))


@record
class Pieces:
    """Upright solids (...) over trapezoids between two norths."""

    south: Array = quantity(unit="m", doc="southern side")
    north: Array = quantity(unit="m", doc="northern side")
    west: tuple[Array, Array] = quantity(unit="m", doc="where the western side begins in the south, ends in the north")
    east: tuple[Array, Array] = quantity(unit="m", doc="the same of the eastern side")
    z_min: Array = quantity(unit="m", doc="top")
    z_max: Array = quantity(unit="m", doc="bottom")
    number: Array = quantity(doc="number of the obstacle in the scenario")

    def square(self, x: Array, y: Array, z: Array) -> Array:
        """Return squared distances [m^2] of points (x, y, z) [m] from trapezoidal solids, 0 inside; all broadcast."""
        (w0, w1), (e0, e1) = self.west, self.east
        tall = self.north - self.south
        part = jnp.clip((x - self.south) / tall, 0.0, 1.0)
        from_south = x - self.south
        level = (x >= self.south) & (x <= self.north)
        inside = level & (y >= w0 + part * (w1 - w0)) & (y <= e0 + part * (e1 - e0))
        sides = [
            _to_segment(jnp, from_south, y - w0, tall, w1 - w0),
            _to_segment(jnp, from_south, y - e0, tall, e1 - e0),
            _beyond(y, w0, e0) ** 2 + from_south * from_south,
            _beyond(y, w1, e1) ** 2 + (x - self.north) ** 2,
        ]
        flat = jnp.minimum(jnp.minimum(sides[0], sides[1]), jnp.minimum(sides[2], sides[3]))
        above = _beyond(z, self.z_min, self.z_max)
        return jnp.where(inside, 0.0, flat) + above * above

    def over(self, x: Array, y: Array, slack: float = 0.0) -> Array:
        """Return whether points are inside the vertical sides of trapezoidal solids, widened by ``slack`` [m]."""
        (w0, w1), (e0, e1) = self.west, self.east
        part = (x - self.south) / (self.north - self.south)
        level = (x >= self.south - slack) & (x <= self.north + slack)
        return level & (y >= w0 + part * (w1 - w0) - slack) & (y <= e0 + part * (e1 - e0) + slack)


def _beyond(value: Array, low: Array, high: Array) -> Array:
    """Return the distance of values from the interval [low, high], 0 inside it."""
    return jnp.maximum(jnp.maximum(low - value, value - high), 0.0)


@record
class Prisms:
    """All prisms of a world, in T pieces, and which of them are near each cell of a grid."""

    pieces: Pieces = quantity(doc="(T,) and, where there is a grid, one that is far away from everything")
    near: Array | None = quantity(
        default=None, doc="(C * most,) int32 numbers of pieces near each cell, or None: all are near"
    )
    corner: Any = quantity(default=None, doc="north and east of the middle of the first cell [m]")
    cell: Any = quantity(default=None, doc="side of a cell [m]")
    rows: int = setting(default=1, doc="cells to the north")
    columns: int = setting(default=1, doc="cells to the east")
    most: int = setting(default=0, doc="pieces that a cell names")
    reach: float = setting(default=math.inf, unit="m", doc="farther prisms need not be noticed")

    @property
    def count(self) -> int:
        """Number T of trapezoidal solids into which the prisms are cut."""
        return int(self.pieces.south.shape[0]) - (self.near is not None)

    def nearest(self, position_ned: Vec3) -> tuple[Array, Array]:
        """Return the distance (n,) [m] of positions from the nearest prism, and its number in the scenario.

        One that is farther than ``reach`` may be overlooked: then the distance is that of another one.
        """
        x, y, z = (axis[None, :] for axis in (position_ned.x, position_ned.y, position_ned.z))
        pieces = self.pieces_near(position_ned)
        square = pieces.square(x, y, z)
        place = jnp.arange(square.shape[0])[:, None]
        chosen = jnp.where(place == jnp.argmin(square, axis=0)[None, :], pieces.number, 0.0)
        return length_of(jnp, jnp.min(square, axis=0)), jnp.sum(chosen, axis=0)

    def pieces_near(self, position_ned: Vec3) -> Pieces:
        """Return the trapezoidal solids (K, n) near positions (n,), or all (K, 1) if there is no search grid."""
        import jax

        lib = library_of(position_ned.x, self.pieces.south)
        if self.near is None:
            return jax.tree.map(lambda leaf: leaf[:, None], self.pieces)
        row, column = (
            lib.clip(_finite(lib, (value - low) / self.cell) + 0.5, 0.0, float(count - 1)).astype(lib.int32)
            for value, low, count in (
                (position_ned.x, self.corner[0], self.rows),
                (position_ned.y, self.corner[1], self.columns),
            )
        )
        first = (row * self.columns + column) * self.most
        number = lib.asarray(self.near)[first[None, :] + lib.arange(self.most, dtype=lib.int32)[:, None]]
        return jax.tree.map(lambda leaf: lib.asarray(leaf)[number], self.pieces)


def _finite(lib: ModuleType, value: Array) -> Array:
    """Return values with NaN and infinities replaced by 0."""
    return lib.where(lib.isfinite(value), value, 0.0)


def trapezoids(rings: Sequence[npt.ArrayLike]) -> Float64:
    """Return a polygon with holes cut into trapezoids (T, 6) with parallel sides along east.

    Args:
        rings: corners (V, 2), north and east, of the outline and of each hole.

    Returns:
        (T, 6): south, north, west at both, east at both.
    """
    first, last = edges_of(rings)
    low, high = np.where((first[:, :1] <= last[:, :1])[None], [first, last], [last, first])
    slanted = high[:, 0] > low[:, 0]
    low, high = low[slanted], high[slanted]
    slope = (high[:, 1] - low[:, 1]) / (high[:, 0] - low[:, 0])
    cuts = np.unique(np.concatenate([low[:, 0], high[:, 0]]))
    found: list[list[float]] = []
    going: dict[tuple[int, int], list[float]] = {}
    for south, north in pairwise(cuts):
        across = np.flatnonzero((low[:, 0] <= south) & (high[:, 0] >= north))
        ends = [low[across, 1] + slope[across] * (level - low[across, 0]) for level in (south, north)]
        order = np.argsort(ends[0] + ends[1], kind="stable")
        pairs = {}
        for i, j in zip(order[::2], order[1::2], strict=False):
            key = (int(across[i]), int(across[j]))
            # Between the same two edges a piece goes on over any number of cuts.
            begun = going.get(key, [south, north, ends[0][i], 0.0, ends[0][j], 0.0])
            pairs[key] = [begun[0], north, begun[2], ends[1][i], begun[4], ends[1][j]]
        found += [piece for key, piece in going.items() if key not in pairs]
        going = pairs
    return np.array([*found, *going.values()], np.float64).reshape(-1, 6)


def prisms_of(
    solids: Sequence[PrismObstacle],
    numbers: Sequence[int],
    radius: float,
    *,
    reach: float | None = None,
    most_cells: int = MOST_CELLS,
) -> Prisms | None:
    """Return the prism obstacles of a world with their search grid, in float64; None without any prism.

    Args:
        solids: the prisms.
        numbers: of each in the scenario.
        radius: the largest distance [m] that vehicles keep from obstacles.
        reach: distance [m] beyond which a prism need not be noticed; None: from the radius.
        most_cells: of the grid.
    """
    if not solids:
        return None
    reach = max(LEAST_REACH, 2.0 * radius) if reach is None else reach
    cut = [trapezoids(solid.rings()) for solid in solids]
    each = np.repeat(np.arange(len(solids)), [len(part) for part in cut])
    flat = np.concatenate(cut)
    top, bottom = (np.array([float(getattr(solid, name)) for solid in solids])[each] for name in ("z_min", "z_max"))
    count = np.asarray(numbers, np.float64)[each]
    if len(flat) <= FEW_PIECES:
        return Prisms(_pieces(flat, top, bottom, count))
    south, west = flat[:, 0].min() - reach, flat[:, 2:4].min() - reach
    size = (flat[:, 1].max() + reach - south, flat[:, 4:6].max() + reach - west)
    cell = max(CELL, math.sqrt(size[0] * size[1] / most_cells))
    rows, columns = (max(1, math.ceil(side / cell)) for side in size)
    corner = (south + 0.5 * cell, west + 0.5 * cell)
    near = _near_cells(flat, reach + cell * math.sqrt(0.5), corner, cell, rows, columns)
    # One more, which fills the rows of cells that have fewer near them.
    nowhere = np.array([[_FAR, _FAR + 1.0, _FAR, _FAR, _FAR + 1.0, _FAR + 1.0]])
    pieces = _pieces(
        np.concatenate([flat, nowhere]), np.append(top, 0.0), np.append(bottom, 1.0), np.append(count, -1.0)
    )
    return record_of(
        Prisms,
        pieces,
        near.ravel(),
        corner,
        cell,
        rows=rows,
        columns=columns,
        most=near.shape[1],
        reach=float(reach),
    )


def _pieces(flat: Float64, top: Float64, bottom: Float64, number: Float64) -> Pieces:
    """Return trapezoids (T, 6), with top and bottom heights and prism numbers (T,), as a record."""
    column = [np.ascontiguousarray(part) for part in flat.T]
    ends = (top, bottom, number)
    return record_of(Pieces, column[0], column[1], (column[2], column[3]), (column[4], column[5]), *ends)


def _near_cells(
    flat: Float64, within: float, corner: tuple[float, float], cell: float, rows: int, columns: int
) -> npt.NDArray[np.int32]:
    """Return the indices (C, most) of trapezoids (T, 6) within a distance [m] of each grid cell's centre.

    Rows with fewer are filled with T.
    """
    named: list[npt.NDArray[np.int64]] = []
    owner: list[npt.NDArray[np.int64]] = []
    for number, (south, north, w0, w1, e0, e1) in enumerate(flat):
        box = ((south, north, corner[0], rows), (min(w0, w1), max(e0, e1), corner[1], columns))
        spans = [
            np.arange(
                max(0, math.floor((low - within - first) / cell)),
                min(count - 1, math.ceil((high + within - first) / cell)) + 1,
            )
            for low, high, first, count in box
        ]
        x, y = (first + cell * span for (_, _, first, _), span in zip(box, spans, strict=True))
        close = _flat_distance((south, north, w0, w1, e0, e1), x[:, None], y[None, :]) <= within
        i, j = np.nonzero(close)
        named.append(spans[0][i] * columns + spans[1][j])
        owner.append(np.full(len(i), number))
    cells, owners = np.concatenate(named), np.concatenate(owner)
    order = np.argsort(cells, kind="stable")
    cells, owners = cells[order], owners[order]
    count = np.bincount(cells, minlength=rows * columns)
    place = np.arange(len(cells)) - np.repeat(np.cumsum(count) - count, count)
    near = np.full((rows * columns, max(1, int(count.max()))), len(flat), np.int32)
    near[cells, place] = owners
    return near


def _flat_distance(piece: tuple[float, ...], x: Float64, y: Float64) -> Float64:
    """Return the horizontal distance of points from a trapezoid, 0 inside it."""
    south, north, w0, w1, e0, e1 = piece
    corners = [[(south, w0), (north, w1), (north, e1), (south, e0)]]
    first, last = edges_of(corners)
    square = np.full(np.broadcast_shapes(x.shape, y.shape), np.inf)
    for (a, b), (c, d) in zip(first, last, strict=True):
        square = np.minimum(square, _to_segment(np, x - a, y - b, c - a, d - b))
    part = np.clip((x - south) / (north - south), 0.0, 1.0)
    inside = (x >= south) & (x <= north) & (y >= w0 + part * (w1 - w0)) & (y <= e0 + part * (e1 - e0))
    return np.where(inside, 0.0, np.sqrt(square))
