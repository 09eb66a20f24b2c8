"""A task's baseline in many episodes side by side."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.tasks.baselines import Chasing, baseline
from qrsim.tasks.baselines.fleeing import Pursuing
from qrsim.tasks.baselines.holding import Holding
from qrsim.tasks.play import Play


class Many:
    """The baseline in B episodes; call ``begin`` before the first step.

    Args:
        play: the task and its world.
        size: B.
        timeless: the form without a clock, where the baseline has one.

    Raises:
        UsageError: the task has no baseline, or it cannot fly these vehicles.
    """

    def __init__(self, play: Play, size: int, timeless: bool = False):
        self._play, self._size = jax.tree.map(np.asarray, play), size
        one: Any = baseline(self._play)
        if timeless and isinstance(one, Chasing):
            one = Chasing(self._play, timeless=True)
        # One object flies all episodes at once, or there is one for each.
        self._one = one if isinstance(one, Chasing | Pursuing | Holding) else None
        self._each: list[Any] = [one] * size

    def begin(self, rows: NumpyArray | None = None) -> None:
        """Begin all episodes, or the next ones in some rows."""
        if self._one is not None:
            self._one.begin(self._size, rows)
            return
        for row in range(self._size) if rows is None else rows:
            self._each[row] = baseline(self._play, int(row))

    def act(self, seen: Any) -> Any:
        """Return the actions (B, n, A) for observations (B, n, ...); of several fleets by fleet."""
        if self._one is not None:
            return self._one.act(seen)
        given = [each.act(jax.tree.map(lambda leaf, i=i: leaf[i], seen)) for i, each in enumerate(self._each)]
        return jax.tree.map(lambda *parts: np.stack(parts), *given)
