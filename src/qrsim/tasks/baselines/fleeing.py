"""Mice that run from the cats as their scripted guidance does, and both sides of a pursuit together."""

from __future__ import annotations

from typing import Any

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.tasks.baselines.chasing import Chasing
from qrsim.tasks.play import Play

# Speed of a mouse that runs [m/s], as of the guidance ``flee``.
SPEED = 3.0


class Fleeing:
    """Mice of a pursuit that runs from all cats: along the sum of d/|d|^2, d the offset from a cat to the mouse.

    That is what the guidance ``flee`` does, which looks at every tick; this one does at every step.
    """

    def __init__(self, play: Play, seed: int = 0):
        cats, mice = play.sides
        self._cats, self._limit = len(cats.names), float(mice.axes[0].high)

    def act(self, seen: Any) -> NumpyArray:
        """Return the mice's actions (..., m, 2) for their observations (..., m, O), of one episode or of many."""
        known = np.asarray(seen, np.float64)
        offsets = known[..., 4 : 4 + 2 * self._cats].reshape(*known.shape[:-1], self._cats, 2)
        square = np.sum(offsets**2, axis=-1, keepdims=True)
        away = -np.sum(np.where(square > 0.0, offsets / np.where(square > 0.0, square, 1.0), 0.0), axis=-2)
        length = np.linalg.norm(away, axis=-1, keepdims=True)
        run = np.where(length > 0.0, SPEED * away / np.where(length > 0.0, length, 1.0), 0.0)
        return np.clip(run / self._limit, -1.0, 1.0)

    def begin(self, size: int, rows: NumpyArray | None = None) -> None:
        """Do nothing: it remembers nothing."""


class Pursuing:
    """Baselines of both sides of a pursuit, by fleet."""

    def __init__(self, play: Play, seed: int = 0):
        cats, mice = play.sides
        self._each: dict[str, Chasing | Fleeing] = {cats.fleet: Chasing(play, seed), mice.fleet: Fleeing(play, seed)}

    def act(self, seen: Any) -> dict[str, NumpyArray]:
        """Return fleet -> actions (..., n_f, 2), for cats and mice."""
        return {fleet: policy.act(seen[fleet]) for fleet, policy in self._each.items()}

    def begin(self, size: int, rows: NumpyArray | None = None) -> None:
        """Begin ``size`` episodes side by side, or the next episodes in some of their rows."""
        for policy in self._each.values():
            policy.begin(size, rows)
