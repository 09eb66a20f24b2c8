"""Search with a probability map of persons, descending on likely ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.play import Play

Array = np.ndarray[Any, Any]
CELL, SECTOR = 0.5, 10.0
# Log odds that a person lies with its middle in a cell: before anything was seen, when it is worth a visit, and when it
# is not any more. Evidence counts up to its bounds.
PRIOR, LIKELY, DOUBTFUL = -9.0, -2.0, -5.0
MOST, LEAST = 14.0, -15.0
# Higher up a person gives too little evidence in passing.
SEARCH_HEIGHT = 35.0
HOVER_HEIGHT, NEAR, PATIENCE_S = 3.0, 3.0, 8
GAIN, SPEED, CLIMB = 0.5, 3.0, 3.0
SEPARATION = 12.0


class Descending:
    """Vehicles that cover unseen ground, descend on likely persons, hover there, and go on."""

    def __init__(self, play: Play, seed: int = 0):
        area: Any = play.world.area
        self._low = np.array([float(area.x_min), float(area.y_min)])
        self._extent = np.array([float(area.x_max), float(area.y_max)]) - self._low
        self._evidence = np.zeros(np.ceil(self._extent / CELL).astype(int))
        self._unseen = np.ones(np.ceil(self._extent / SECTOR).astype(int), bool)
        # Sectors at the edge would lead vehicles out of the area, and persons are not there.
        self._middles = self._low + SECTOR * (np.moveaxis(np.indices(self._unseen.shape), 0, -1) + 0.5)
        margin = 0.1 * self._extent
        inside = (self._middles > self._low + margin) & (self._middles < self._low + self._extent - margin)
        self._unseen &= np.all(inside, axis=-1)
        count = len(play.agents)
        self._target = np.full((count, 2), np.nan)
        self._waited = np.zeros(count, int)
        self._height: Array | None = None
        self._limit = float(play.axes[0].high)

    def act(self, seen: dict[str, Array]) -> Array:
        """Return the actions (n, 3)."""
        place = np.asarray(seen["vehicle"][:, :3], np.float64)
        if self._height is None:
            self._height = np.minimum(-place[:, 2], SEARCH_HEIGHT)
        for i in range(len(place)):
            self._look(seen["ratio"][i], seen["corners"][i], seen["grid"][i])
        wanted = np.stack([self._steer(i, place) for i in range(len(place))])
        return np.clip((wanted + apart(place, SEPARATION)) / self._limit, -1.0, 1.0)

    def _look(self, ratio: Array, corners: Array, grid: Array) -> None:
        """Add a picture to the map."""
        rows, columns = int(grid[0]), int(grid[1])
        if not rows:
            return
        upper_left, upper_right, lower_right, lower_left = corners.astype(float)
        region = self._cells(corners.min(axis=0), corners.max(axis=0))
        indices = np.stack(np.meshgrid(*(np.arange(part.start, part.stop) for part in region), indexing="ij"), axis=-1)
        place = self._low + (indices + 0.5) * CELL
        # The picture of a tilted camera is a trapezium, nearly a parallelogram.
        axes = 0.5 * np.stack([upper_right - upper_left + lower_right - lower_left,
                               lower_left - upper_left + lower_right - upper_right], axis=1)  # fmt: skip
        across, down = np.moveaxis((place - corners.mean(axis=0)) @ np.linalg.inv(axes).T + 0.5, -1, 0)
        inside = (across >= 0.0) & (across < 1.0) & (down >= 0.0) & (down < 1.0)
        window = (down[inside] * rows).astype(int), (across[inside] * columns).astype(int)
        evidence = self._evidence[region]
        # A person whose middle is in the cell is in the window that shows it.
        evidence[inside] = np.clip(evidence[inside] + ratio[window], LEAST, MOST)
        sector = ((place[inside] - self._low) / SECTOR).astype(int)
        self._unseen[sector[:, 0], sector[:, 1]] = False

    def _steer(self, i: int, place: Array) -> Array:
        """Return the velocity [m/s] of a vehicle."""
        here = place[i]
        if np.isfinite(self._target[i, 0]):
            self._follow(i, here)
        if not np.isfinite(self._target[i, 0]):
            self._choose(i, here, place)
        assert self._height is not None
        if np.isfinite(self._target[i, 0]):
            offset = self._target[i] - here[:2]
            # Down to where a person is found, not before it is nearly below.
            slope = max(HOVER_HEIGHT, 1.5 * (np.linalg.norm(offset) - NEAR))
            height = min(float(self._height[i]), slope)
        else:
            offset, height = self._onwards(i, here), float(self._height[i])
        speed = GAIN * np.linalg.norm(offset)
        level = offset * (GAIN * min(1.0, SPEED / max(float(speed), 1e-9)))
        return np.array([*level, np.clip(-GAIN * (height + here[2]), -CLIMB, CLIMB)])

    def _follow(self, i: int, here: Array) -> None:
        """Keep to the likely person, or give up: when it is not likely any more, or was waited for in vain."""
        region = self._around(self._target[i], 1.5)
        odds = PRIOR + self._evidence[region]
        best = np.unravel_index(np.argmax(odds), odds.shape)
        if np.linalg.norm(self._target[i] - here[:2]) < NEAR and -here[2] < HOVER_HEIGHT + 1.5:
            self._waited[i] += 1
        if odds[best] < DOUBTFUL or self._waited[i] > PATIENCE_S:
            self._evidence[self._around(self._target[i], 2.0)] = LEAST
            self._target[i] = np.nan
        elif -here[2] > HOVER_HEIGHT + 3.0:
            first = np.array([region[0].start, region[1].start])
            self._target[i] = self._low + (first + np.array(best) + 0.5) * CELL

    def _around(self, point: Array, distance: float) -> tuple[slice, slice]:
        """Return the cells near a point."""
        return self._cells(point - distance, point + distance)

    def _cells(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Return the cells of a rectangle, at least one."""
        size = np.array(self._evidence.shape)
        first = np.clip(((low - self._low) / CELL).astype(int), 0, size - 1)
        last = np.clip(((high - self._low) / CELL).astype(int) + 1, first + 1, size)
        return slice(int(first[0]), int(last[0])), slice(int(first[1]), int(last[1]))

    def _choose(self, i: int, here: Array, place: Array) -> None:
        """Take the nearest likely person that nobody else goes to."""
        cells = np.argwhere(PRIOR + self._evidence > LIKELY)
        if not len(cells):
            return
        points = self._low + (cells + 0.5) * CELL
        distance = np.linalg.norm(points - here[:2], axis=1)
        for j in range(len(place)):
            if j != i and np.isfinite(self._target[j, 0]):
                distance = np.where(np.linalg.norm(points - self._target[j], axis=1) < SEPARATION, np.inf, distance)
        best = int(np.argmin(distance))
        if np.isfinite(distance[best]):
            self._target[i], self._waited[i] = points[best], 0

    def _onwards(self, i: int, here: Array) -> Array:
        """Return the way [m] to the nearest sector that nobody has seen, in the direction of flight if it can be."""
        if not self._unseen.any():
            return np.zeros(2)
        points = self._middles[self._unseen]
        offset = points - here[:2]
        distance = np.linalg.norm(offset, axis=1)
        way: Array = offset[int(np.argmin(distance))]
        return way * max(1.0, 8.0 / max(float(np.linalg.norm(way)), 1e-9))
