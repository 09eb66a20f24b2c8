"""Makes the table of what obstacles do to signals of satellites: horizon and first reflection, in float64 NumPy.

Walls are upright. A ray from a cell at an azimuth meets edges; the highest over its distance makes the horizon, and the
nearest one mirrors a satellite whose azimuth follows from the wall's direction (image method).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import record_of
from qrsim.models.gnss.skyline import ANGLE, Skyline
from qrsim.models.scene.prisms import edges_of

Float64 = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
# Heights [m] at which a table is made, up to the highest roof; over the last one each is so much higher.
LEVELS, GROWTH = (0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0), 1.45
# Cells along each side of a block, whose edges are listed together.
BLOCK = 16
# A wall nearer than this [m] is the one that the receiver stands on.
_TOUCHING = 1e-3
# Of a bin's width: more than rounding moves a ray.
_EDGE = 1e-6
_NONE = np.iinfo(np.uint32).max


@dataclass(frozen=True)
class Walls:
    """Upright walls of solids.

    Attributes:
        first, last: (E, 2) ends of each wall, north and east [m].
        top: (E,) height of its upper edge over z = 0 [m].
        bottom: lowest height of any of them [m].
        solid: (E,) number of the solid that it belongs to, in order.
    """

    first: Float64
    last: Float64
    top: Float64
    bottom: float
    solid: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Frame:
    """Grid of a table: first corner [m], pitch of cells [m], rows, columns, levels of height [m] and azimuths."""

    corner: tuple[float, float]
    pitch: float
    rows: int
    columns: int
    levels: tuple[float, ...]
    azimuths: int

    @property
    def size(self) -> int:
        """Size of the table of horizons [bytes]."""
        return 4 * self.rows * self.columns * len(self.levels) * self.azimuths


def walls_of(solids: Sequence[tuple[Sequence[npt.ArrayLike], float, float]]) -> Walls:
    """Return the walls of solids, each given by rings of corners (V, 2), and top and bottom over z = 0 [m]."""
    ends = [edges_of(rings) for rings, _, _ in solids]
    count = [len(first) for first, _ in ends]
    return Walls(
        np.concatenate([first for first, _ in ends]),
        np.concatenate([last for _, last in ends]),
        np.repeat([top for _, top, _ in solids], count),
        min(bottom for _, _, bottom in solids),
        np.repeat(np.arange(len(solids)), count),
    )


def frame_of(
    walls: Walls, bounds: tuple[float, float, float, float] | None, lowest: float, pitch: float, azimuths: int
) -> Frame | None:
    """Return the grid of all positions at which walls can hide satellites from receivers; None if they cannot.

    Args:
        walls: of the obstacles.
        bounds: south, north, west, east [m] of the area in which receivers can be; None: unbounded.
        lowest: elevation [rad] below which no receiver uses satellites.
        pitch: side of a cell [m].
        azimuths: number of directions.
    """
    tallest = float(walls.top.max())
    reach = (tallest - walls.bottom) / math.tan(lowest)
    corners = np.concatenate([walls.first, walls.last])
    low, high = corners.min(axis=0) - reach, corners.max(axis=0) + reach
    if bounds is not None:
        low = np.maximum(low, [bounds[0], bounds[2]])
        high = np.minimum(high, [bounds[1], bounds[3]])
    if (low >= high).any():
        return None
    rows, columns = (max(1, math.ceil(float(side) / pitch)) for side in high - low)
    north, east = (float(value) + 0.5 * pitch for value in low)
    return Frame((north, east), pitch, rows, columns, _levels(walls.bottom, tallest), azimuths)


def _levels(bottom: float, tallest: float) -> tuple[float, ...]:
    """Return heights over z = 0 [m] of the table's levels, rising from ``bottom`` to the highest roof, ``tallest``."""
    above, whole = list(LEVELS), tallest - bottom
    while above[-1] * GROWTH < whole:
        above.append(above[-1] * GROWTH)
    return (*(bottom + level for level in above if level < whole - 0.5), tallest)


def make_table(walls: Walls, frame: Frame, lowest: float) -> Skyline:
    """Return the table of horizons, reflection detours and ceilings that walls cause; ``lowest`` as in ``frame_of``."""
    shape = (frame.rows * frame.columns, len(frame.levels), frame.azimuths)
    tables = [np.zeros(shape, np.uint8) for _ in range(3)]
    slope = math.tan(lowest)
    north: Float64 = frame.corner[0] + frame.pitch * np.arange(frame.rows, dtype=np.float64)
    east: Float64 = frame.corner[1] + frame.pitch * np.arange(frame.columns, dtype=np.float64)
    for i in range(0, frame.rows, BLOCK):
        for j in range(0, frame.columns, BLOCK):
            x, y = (part.ravel() for part in np.meshgrid(north[i : i + BLOCK], east[j : j + BLOCK], indexing="ij"))
            near = _near(walls, x, y, slope)
            if not near.any():
                continue
            own = np.arange(i, min(i + BLOCK, frame.rows))[:, None] * frame.columns
            cells = (own + np.arange(j, min(j + BLOCK, frame.columns))[None, :]).ravel()
            found = _block(walls.first[near], walls.last[near], walls.top[near], x, y, frame, slope)
            for table, part in zip(tables, found, strict=True):
                table[cells] = part
    _outside(tables, walls, frame, north, east)
    horizon, detour, ceiling = (table.astype(np.uint32) for table in tables)
    words = horizon | np.roll(horizon, -1, axis=-1) << 8 | detour << 16 | ceiling << 24
    return skyline_of(words.ravel().view(np.int32), frame)


def skyline_of(words: npt.NDArray[np.int32], frame: Frame) -> Skyline:
    """Return packed table words on the grid ``frame`` as the component that receivers query."""
    levels = np.array(frame.levels)
    return record_of(Skyline, words, levels, frame.corner, frame.pitch, frame.rows, frame.columns, frame.azimuths)


def _near(walls: Walls, x: Float64, y: Float64, slope: float) -> npt.NDArray[np.bool_]:
    """Return (E,) bool: the wall is high and near enough to hide a satellite from some grid cell."""
    middle = np.array([0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())])
    around = math.hypot(x.max() - middle[0], y.max() - middle[1])
    edge, start = walls.last - walls.first, middle - walls.first
    square = np.maximum(np.sum(edge * edge, axis=1), 1e-12)
    part = np.clip(np.sum(start * edge, axis=1) / square, 0.0, 1.0)
    away = np.hypot(*(start - part[:, None] * edge).T)
    return np.asarray((walls.top - walls.bottom) > slope * (away - around))


def _block(
    first: Float64, last: Float64, top: Float64, x: Float64, y: Float64, frame: Frame, slope: float
) -> tuple[Bytes, Bytes, Bytes]:
    """Return horizon, reflection detour and ceiling as bytes (C, L, A): C cells, L levels and A azimuths."""
    count, step = frame.azimuths, 2.0 * math.pi / frame.azimuths
    away_x, away_y = first[:, :1] - x, first[:, 1:] - y
    begin = np.arctan2(away_y, away_x)
    turn = np.arctan2(last[:, 1:] - y, last[:, :1] - x) - begin
    turn -= 2.0 * math.pi * np.round(turn / (2.0 * math.pi))
    begin = np.where(turn < 0.0, begin + turn, begin)
    lowest = np.ceil(begin / step).astype(np.int64)
    number = np.maximum(np.floor((begin + np.abs(turn)) / step).astype(np.int64) - lowest + 1, 0).ravel()
    pair = np.repeat(np.arange(number.size), number)
    turned = lowest.ravel()[pair] + np.arange(pair.size) - np.repeat(np.cumsum(number) - number, number)
    wall, cell, azimuth = pair // len(x), pair % len(x), turned % count
    edge = last - first
    ray = np.stack([np.cos(step * azimuth), np.sin(step * azimuth)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (away_x.ravel()[pair] * edge[wall, 1] - away_y.ravel()[pair] * edge[wall, 0]) / (
            ray[:, 0] * edge[wall, 1] - ray[:, 1] * edge[wall, 0]
        )
    base = frame.levels[0]
    kept = np.isfinite(distance) & (distance > _TOUCHING) & (top[wall] - base > slope * distance)
    distance, wall, cell, azimuth = distance[kept], wall[kept], cell[kept], azimuth[kept]
    place = cell * count + azimuth
    order = np.lexsort((distance, place))
    distance, wall, cell, azimuth, place = (part[order] for part in (distance, wall, cell, azimuth, place))
    shape = (len(frame.levels), len(x) * count)
    horizon, mirrored = np.zeros(shape), np.full(shape, _NONE, np.uint32)
    if len(place):
        starts = np.flatnonzero(np.append(True, place[1:] != place[:-1]))
        along = np.arctan2(edge[wall, 1], edge[wall, 0]) - step * azimuth
        detour = 2.0 * distance * np.sin(along) ** 2
        # The mirrored direction of a ray at azimuth a, by a wall along b, is 2 b - a.
        # Of walls along an axis it is the edge of a bin, on one side of which all rays have to end, or bins stay empty.
        back = cell * count + np.floor((2.0 * along + step * azimuth) / step + _EDGE).astype(np.int64) % count
        index = np.arange(len(place))
        for level, height in enumerate(frame.levels):
            over = top[wall] - height
            horizon[level, place[starts]] = np.maximum.reduceat(np.maximum(over, 0.0) / distance, starts)
            nearest = np.minimum.reduceat(np.where(over > 0.0, index, len(index)), starts)
            nearest = nearest[nearest < len(index)]
            nearest = nearest[detour[nearest] < 255.5]
            ceiling = _quantized(over[nearest] / distance[nearest])
            far = np.clip(np.round(detour[nearest]), 1, 255).astype(np.uint32)
            # The shortest counts; of equal ones the lower, so that the result does not depend on their order.
            np.minimum.at(mirrored[level], back[nearest], far * 256 + (255 - ceiling))
    there = mirrored != _NONE
    tables = (
        _quantized(horizon),
        np.where(there, mirrored >> 8, 0).astype(np.uint8),
        np.where(there, 255 - (mirrored & 255), 0).astype(np.uint8),
    )
    level_count, azimuths = len(frame.levels), count
    ordered = [table.reshape(level_count, len(x), azimuths).transpose(1, 0, 2) for table in tables]
    return ordered[0], ordered[1], ordered[2]


def _quantized(tangent: Float64) -> NumpyArray:
    """Return elevations, given by their tangents, as bytes in units of ANGLE."""
    return np.round(np.arctan(tangent) * (1.0 / ANGLE)).astype(np.uint8)


def _outside(tables: list[Bytes], walls: Walls, frame: Frame, north: Float64, east: Float64) -> None:
    """Copy the nearest outside cell's values into the cells inside a solid, in place."""
    from scipy.ndimage import distance_transform_edt

    roof = np.full((frame.rows, frame.columns), -np.inf)
    for number in range(int(walls.solid[-1]) + 1):
        own = walls.solid == number
        first, last = walls.first[own], walls.last[own]
        (south, west), (far, right) = first.min(axis=0), first.max(axis=0)
        i = slice(*np.searchsorted(north, [south, far]))
        j = slice(*np.searchsorted(east, [west, right]))
        inside = _inside(first, last, north[i], east[j])
        roof[i, j] = np.where(inside, np.maximum(roof[i, j], walls.top[own][0]), roof[i, j])
    for level, height in enumerate(frame.levels):
        hidden = roof > height
        if not hidden.any() or hidden.all():
            continue
        rows, columns = distance_transform_edt(hidden, return_distances=False, return_indices=True)
        source = (rows * frame.columns + columns)[hidden]
        for table in tables:
            table[np.flatnonzero(hidden), level] = table[source, level]


def _inside(first: Float64, last: Float64, north: Float64, east: Float64) -> npt.NDArray[np.bool_]:
    """Return (R, C) bool: the place is inside the polygon with edges from ``first`` to ``last`` (E, 2) [m]."""
    found = np.zeros((len(north), len(east)), bool)
    for (a, b), (c, d) in zip(first, last, strict=True):
        straddles = (a > north) != (c > north)
        if straddles.any():
            cut = np.where(straddles, b + (north - a) / np.where(straddles, c - a, 1.0) * (d - b), np.inf)
            found ^= straddles[:, None] & (cut[:, None] > east[None, :])
    return found
