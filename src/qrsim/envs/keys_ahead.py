"""Keys of episodes to come, made many at a time: by NumPy, those of five take as long as those of a hundred."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.envs.functional import Functional
from qrsim.tasks.play import EpisodeKeys

# Largest number of episodes with keys: of each environment, and of all together.
MOST_EACH, MOST = 8, 8192


class KeysAhead:
    """Keys of the next episodes of each environment of a batch.

    Args:
        size: how many environments.
    """

    def __init__(self, size: int):
        self._each = min(MOST_EACH, MOST // size)
        # Leaves of the keys, and their structure.
        self._keys: tuple[list[NumpyArray], Any] | None = None
        # Of each environment, the seed of what is kept and the number of its first episode.
        self._seeds, self._first = np.zeros(size, np.int64), np.zeros(size, np.int64)

    def clear(self) -> None:
        """Discard the random keys that were computed ahead, because later episodes will be different ones."""
        self._keys = None

    def keys(self, functional: Functional, rows: NumpyArray, seeds: NumpyArray, numbers: NumpyArray) -> EpisodeKeys:
        """Return the random keys of the episodes to start in ``rows``, leaves (b, ...), computed ahead if possible.

        Args:
            functional: what is played.
            rows: (b,) which environments.
            seeds: (B,) of all environments.
            numbers: (B,) the episode of its seed that each plays, or begins now.
        """
        if self._each < 2:
            return functional.keys(seeds[rows], numbers[rows])
        place = numbers[rows] - self._first[rows]
        if self._keys is None or np.any((self._seeds[rows] != seeds[rows]) | (place < 0) | (place >= self._each)):
            self._seeds[:], self._first[:] = seeds, numbers + 1
            self._first[rows] = numbers[rows]
            ahead = self._first[:, None] + np.arange(self._each)
            self._keys = jax.tree.flatten(functional.keys(np.repeat(seeds, self._each), ahead.ravel()))
            place = np.zeros(len(rows), np.int64)
        chosen = np.asarray(rows) * self._each + place
        leaves, structure = self._keys
        found: EpisodeKeys = structure.unflatten([leaf[chosen] for leaf in leaves])
        return found
