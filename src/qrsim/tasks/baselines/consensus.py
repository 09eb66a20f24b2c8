"""Baseline of a formation: the leader's velocity, and a consensus on the received positions."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.tasks.formation import OTHER
from qrsim.tasks.play import Play

# Velocity for each metre of the offset to the place [1/s], and the weight of the leader among those heard.
GAIN, LEADER = 0.5, 0.5


class Consensus:
    """Flies each agent at the velocity of the leader, corrected by a weighted mean of its offsets to its place.

    An agent without a message of the leader takes the mean velocity of the agents with one. It is the law of Ren
    (2007), as in ``control.teams.formation``, in all three axes.

    Args:
        play: a task ``keep_formation``.
        seed: nothing is drawn.
    """

    def __init__(self, play: Play, seed: int = 0):
        self._limit = float(play.axes[0].high)

    def act(self, seen: Floats) -> Floats:
        """Return actions (n, 3), scaled velocities NED that keep the formation, for observations (n, 9 + 8 n)."""
        others = np.asarray(seen, np.float64)[:, 9:].reshape(len(seen), -1, OTHER)
        to_place, velocity, heard = others[..., :3], others[..., 3:6], others[..., 7]
        mates = heard[:, 1:].sum(axis=1)
        # The weights sum to one whichever vehicles are heard.
        leader = heard[:, 0] * np.where(mates > 0.0, LEADER, 1.0)
        each = (1.0 - leader) / np.maximum(mates, 1.0)
        weight = np.concatenate([leader[:, None], heard[:, 1:] * each[:, None]], axis=1)
        # Velocities follow the leader alone where it is heard.
        shared = np.where(heard[:, :1] > 0.0, np.arange(heard.shape[1])[None] == 0, weight)
        wanted = ((shared[..., None] * velocity) + GAIN * weight[..., None] * to_place).sum(axis=1)
        found: Floats = np.clip(wanted / self._limit, -1.0, 1.0)
        return found
