"""Belief of persons over an area, from pictures alone: log odds of each cell, and where the camera was."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.errors import UsageError
from qrsim.models.scene.persons import INNER, Persons
from qrsim.models.sensors.camera import Camera
from qrsim.tasks.play import Play
from qrsim.tasks.search import Search

# Side of a cell [m]. Evidence for a person [nat] counts up to its bounds, so that it can be overturned.
CELL = 0.5
LEAST, MOST = -25.0, 16.0
# Chance that a person of a cell does not cover a window that one in the cell's middle would.
MISSED = 0.15
# Windows that a person covers: centre, corners and what lies between, in halves of its side.
OUTLINE = np.array([(0, 0), (1, 1), (1, -1), (-1, -1), (-1, 1), (2 / 3, 0), (-2 / 3, 0), (0, 2 / 3), (0, -2 / 3)])


class View(NamedTuple):
    """How a picture was taken.

    Attributes:
        windows: (3, 3) homogeneous map from north and east [m] to column and row of windows.
        place: (3,) position NED of the camera [m].
    """

    windows: NumpyArray
    place: NumpyArray


def view(corners: NumpyArray, grid: NumpyArray, camera: Camera) -> View:
    """Compute where a camera was from its picture's corners (4, 2) on the ground; ``grid``: rows and columns.

    Four points of a plane and the numbers of the camera give its pose (Zhang, IEEE Trans. PAMI 22, 2000, section 3.1).

    Args:
        corners: (4, 2) north and east [m]: upper left, upper right, lower right, lower left.
        grid: (2,) rows and columns.
        camera: what took it.
    """
    rows, columns = (int(number) for number in grid)
    ground = np.asarray(corners, np.float64)
    middle = ground.mean(axis=0)
    shown = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)], float)
    parts = []
    for (north, east), (u, v) in zip(ground - middle, shown, strict=True):
        parts.append([north, east, 1, 0, 0, 0, -u * north, -u * east, u])
        parts.append([0, 0, 0, north, east, 1, -v * north, -v * east, v])
    system = np.array(parts)
    flat = np.append(np.linalg.solve(system[:, :8], system[:, 8]), 1.0).reshape(3, 3)
    windows = flat @ np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1.0]])
    focal = float(camera.focal_length)
    scales = []
    for length, count, principal in (
        (camera.width, columns, float(camera.principal_x)),
        (camera.height, rows, float(camera.principal_y)),
    ):
        side = np.floor(length / count)
        first = np.floor(0.5 * (length - side * np.floor(length / side)))
        scales.append((side / focal, (first - principal) / focal))
    (a, b), (c, d) = scales
    pose = np.array([[a, 0, b], [0, c, d], [0, 0, 1.0]]) @ flat
    pose = pose * np.sign(pose[2, 2]) / np.sqrt(np.linalg.norm(pose[:, 0]) * np.linalg.norm(pose[:, 1]))
    turn = np.stack([pose[:, 0], pose[:, 1], np.cross(pose[:, 0], pose[:, 1])], axis=1)
    return View(windows, -turn.T @ pose[:, 2] + np.array([*middle, 0.0]))


class Belief:
    """Log odds that a person lies with its middle in a cell, for the whole team.

    Args:
        play: a search with lying persons, in a box.

    Raises:
        UsageError: there are no lying persons.
    """

    def __init__(self, play: Play):
        area: Any = play.world.area
        persons = play.world.contents.persons
        assert isinstance(play.task, Search)
        if not isinstance(persons, Persons):
            raise UsageError("policy baseline: it searches for lying persons; world.persons has none (type: lying)")
        self.camera = play.task.lens(play.world)
        self.low = np.array([float(area.x_min), float(area.y_min)])
        self.extent = np.array([float(area.x_max), float(area.y_max)]) - self.low
        self._size = float(persons.size)
        shape = np.ceil(self.extent / CELL).astype(int)
        inner = INNER * self.extent
        expected = 0.5 * (persons.fewest + persons.most) * CELL**2 / float(np.prod(inner))
        self.prior = float(np.log(expected))
        self.evidence = np.zeros(shape)
        away = 0.5 * (1.0 - INNER) * self.extent
        middles = [(np.arange(count) + 0.5) * CELL for count in shape]
        inside = [(m > away[k]) & (m < self.extent[k] - away[k]) for k, m in enumerate(middles)]
        self.possible = inside[0][:, None] & inside[1][None, :]

    def look(self, ratio: NumpyArray, shown: View, corners: NumpyArray, grid: NumpyArray) -> NumpyArray:
        """Update the map of persons with a picture's log ratios (Bayes' rule); return seen cells' centres (M, 2) [m].

        Returns:
            the middles (M, 2) of the cells in the picture [m].
        """
        rows, columns = (int(number) for number in grid)
        region = self.cells(corners.min(axis=0), corners.max(axis=0))
        index = np.stack(np.meshgrid(*(np.arange(part.start, part.stop) for part in region), indexing="ij"), axis=-1)
        place = self.low + (index + 0.5) * CELL
        points = place[..., None, :] + 0.5 * self._size * OUTLINE
        seen = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ shown.windows.T
        spot = np.floor(seen[..., :2] / seen[..., 2:]).astype(int)
        column, row = spot[..., 0], spot[..., 1]
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        number = np.sort(np.where(inside, row * columns + column, -1), axis=-1)
        fresh = (number >= 0) & np.concatenate(
            [np.ones((*number.shape[:-1], 1), bool), number[..., 1:] != number[..., :-1]], axis=-1
        )
        # A person is anywhere in its cell: a window that is empty then must not speak against it without bounds.
        flat = np.log(MISSED + (1.0 - MISSED) * np.exp(np.asarray(ratio, np.float64)[:rows, :columns].ravel()))
        said = np.where(fresh, flat[np.maximum(number, 0)], 0.0).sum(axis=-1)
        here = inside[..., 0]
        evidence = self.evidence[region]
        evidence[here] = np.clip(evidence[here] + said[here], LEAST, MOST)
        return np.asarray(place[here])

    def odds(self, region: tuple[slice, slice]) -> NumpyArray:
        """Return the log odds of a person in each map cell of a region (slices of rows and columns)."""
        return np.where(self.possible[region], self.prior + self.evidence[region], LEAST)

    def forget(self, point: NumpyArray, distance: float) -> None:
        """Rule out a person in the map within ``distance`` [m] of a point (2,), such as one that has been found."""
        self.evidence[self.cells(point - distance, point + distance)] = LEAST

    def best(self, point: NumpyArray, distance: float) -> tuple[NumpyArray, float]:
        """Return the centre (2,) [m] and log odds of the likeliest map cell within ``distance`` [m] of a point (2,)."""
        region = self.cells(point - distance, point + distance)
        odds = self.odds(region)
        at = np.unravel_index(int(np.argmax(odds)), odds.shape)
        first = np.array([region[0].start, region[1].start])
        return self.low + (first + np.array(at) + 0.5) * CELL, float(odds[at])

    def suspected(self, above: float, apart: float) -> NumpyArray:
        """Return centres (K, 2) [m] of map cells with log odds over ``above``, at least ``apart`` [m] apart."""
        odds = self.odds((slice(None), slice(None)))
        cells = np.argwhere(odds > above)
        order = np.argsort(-odds[cells[:, 0], cells[:, 1]], kind="stable")
        kept: list[NumpyArray] = []
        for point in self.low + (cells[order] + 0.5) * CELL:
            if all(np.linalg.norm(point - other) >= apart for other in kept):
                kept.append(point)
        return np.array(kept).reshape(-1, 2)

    def cells(self, low: NumpyArray, high: NumpyArray) -> tuple[slice, slice]:
        """Return the slices of map cells in a rectangle between two corners (2,) [m], at least one cell."""
        size = np.array(self.evidence.shape)
        first = np.clip(((low - self.low) / CELL).astype(int), 0, size - 1)
        last = np.clip(((high - self.low) / CELL).astype(int) + 1, first + 1, size)
        return slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))
