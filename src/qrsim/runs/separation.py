"""The smallest distance between two vehicles of a run, from its log."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.runs.reader import Run
from qrsim.runs.summary import vectors

# Ticks that are compared together.
TICKS = 4096


@dataclass(frozen=True)
class Separation:
    """The smallest distance [m] between two vehicles, its time [s], and both names."""

    distance_m: float
    time_s: float
    vehicles: tuple[str, str]

    @property
    def text(self) -> str:
        """The smallest separation as a sentence, for tables."""
        one, other = self.vehicles
        return f"separation: {self.distance_m:.2f} m at least, of {one} and {other} at {self.time_s:.2f} s"

    def to_json(self) -> dict[str, object]:
        """Return the smallest separation as a dict for JSON."""
        return {"distance_m": self.distance_m, "time_s": self.time_s, "vehicles": list(self.vehicles)}


def smallest_separation(run: Run) -> Separation | None:
    """Return the smallest distance of any two vehicles, at least one of which moves; None without such pairs.

    It is of the logged ticks, and of pairs of which one moves in the run and has not stopped; as in a rollout, the
    other may have.
    """
    if len(run.vehicles) < 2:
        return None
    truth = run["truth"]
    position = vectors(truth, "position_ned")
    active = truth["valid"].astype(bool) & (position != position[:1]).any(axis=(0, 2))
    found, best = None, math.inf
    for begin in range(0, len(position), TICKS):
        span = slice(begin, begin + TICKS)
        for distance, row, pair in _nearer(position[span], active[span], best):
            best = distance
            found = Separation(distance, float(truth.time[begin + row]), (run.vehicles[pair[0]], run.vehicles[pair[1]]))
    return found


def _nearer(position: Floats, active: NumpyArray, best: float) -> Iterator[tuple[float, int, tuple[int, int]]]:
    """Yield (distance [m], tick, pair) of ever smaller distances below ``best`` [m] in positions (T, n, 3).

    Vehicles are sorted along the axis on which they spread farthest; those that are farther apart than the nearest
    pair along that axis alone are not compared.
    """
    spread = np.fmax.reduce(position, axis=(0, 1)) - np.fmin.reduce(position, axis=(0, 1))
    axis = int(np.argmax(np.where(np.isfinite(spread), spread, -1.0)))
    order = np.argsort(position[..., axis], axis=1)
    position, active = np.take_along_axis(position, order[..., None], axis=1), np.take_along_axis(active, order, axis=1)
    for shift in range(1, position.shape[1]):
        apart = position[:, shift:] - position[:, :-shift]
        counts = (active[:, shift:] | active[:, :-shift]) & (apart[..., axis] < best)
        if not counts.any():
            return
        distance = np.linalg.norm(apart, axis=-1)
        distance = np.where(counts & (distance < best), distance, math.inf)
        row, first = np.unravel_index(np.argmin(distance), distance.shape)
        if distance[row, first] < best:
            best = float(distance[row, first])
            one, other = sorted((int(order[row, first]), int(order[row, first + shift])))
            yield best, int(row), (one, other)
