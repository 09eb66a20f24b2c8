"""Flights to learn from: the agents of many episodes side by side, each a row, with the learner's view and reward."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch
from qrsim.envs.objective import Objective
from qrsim.envs.one_side import OneSide
from qrsim.tasks.learned import LIMIT, View


class Decided(NamedTuple):
    """Results of a decision.

    Attributes:
        reward: (N,) of the learner.
        terminated: (N,) whether the episode has ended in a crash.
        ended: (N,) whether the episode has ended.
    """

    reward: Floats
    terminated: Floats
    ended: Floats


class Flights:
    """B episodes of n agents, N = B n rows; an episode that ends is followed by the next of its seed.

    Args:
        batch: the episodes; its task makes a step for each decision.
        view: of the learner.
        objective: of the learner.
        left_after: number of decisions after which the first half of the episodes are left, to start the next ones.

    Attributes:
        lasted: (B,) number of decisions until the end of each episode that ``fly`` has flown.
        last: (N, K) what a policy remembers: the last outputs of the network, within its limits, and integrals.
    """

    def __init__(self, batch: Batch | OneSide, view: View, objective: Objective, left_after: int | None = None):
        self.batch, self.view, self.objective = batch, view, objective
        self.agents = len(batch.agents)
        self.rows = batch.size * self.agents
        self.last = np.zeros((self.rows, view.remembered), np.float32)
        self.lasted = np.zeros(batch.size, int)
        # Decisions of each episode so far, and after how many it is left.
        self._age, self._most = np.zeros(batch.size, int), np.full(batch.size, np.iinfo(int).max)
        if left_after is not None:
            self._most[: batch.size // 2] = left_after

    def begin(self, seeds: Floats) -> None:
        """Start all B episodes with new seeds (B,)."""
        self.batch.reset(seeds)
        self.last[:], self._age[:] = 0.0, 0
        self.objective.begin(self.batch)

    @property
    def seen(self) -> Floats:
        """Present observations (N, O) of all agents."""
        found: Floats = self.batch.seen.reshape(self.rows, -1)
        return found

    def features(self, rows: Any = slice(None)) -> Floats:
        """Return the network's inputs (N, F), not yet scaled, for the next decisions of the agents ``rows``."""
        found: Floats = self.view.features(self.seen[rows], self.last[rows])
        return found

    def decide(self, outputs: Floats, action: Floats) -> Decided:
        """Advance all episodes by actions (N, A) of ``outputs`` (N, K); call ``follow`` for episodes that ended.

        Raises:
            RunError: a reward of the task is not finite.
        """
        self.last = self.view.remember(outputs, self.seen, self.last)
        reward, terminated, truncated = self.batch.step(action.reshape(self.batch.size, self.agents, -1))
        own = self.objective.reward(self.batch, reward, terminated, outputs.clip(-LIMIT, LIMIT))
        self._age += 1
        over = terminated | truncated | (self._age >= self._most)
        crashed, ended = (np.repeat(each, self.agents) for each in (terminated, over))
        return Decided(own, crashed, ended)

    def follow(self, ended: Floats) -> None:
        """Start the next episodes of those in which an agent's flag in ``ended`` (N,) is set."""
        if not ended.any():
            return
        self.last[ended] = 0.0
        rows = np.flatnonzero(ended.reshape(self.batch.size, self.agents).any(axis=1))
        self._age[rows] = 0
        self.batch.again(rows)
        self.objective.begin(self.batch, ended)

    def fly(self, act: Any, seeds: Floats, steps: int | None = None) -> tuple[Floats, Floats]:
        """Fly one episode per seed (B,); ``act`` maps inputs to outputs. Return (mean returns, flown to the end).

        Args:
            act: inputs (N, F) to outputs (N, K).
            seeds: (B,) of the episodes.
            steps: number of decisions after which they are left; None: they are whole.

        Returns:
            The mean return of the agents (B,), and whether each episode was flown to the end (B,).
        """
        self.begin(seeds)
        total, alive = np.zeros(self.batch.size), np.ones(self.batch.size, bool)
        self.lasted[:] = 0
        for _ in range(self.batch.functional.play.steps if steps is None else steps):
            outputs = act(self.features())
            self.last = self.view.remember(outputs, self.seen, self.last)
            action = self.view.action(outputs.clip(-LIMIT, LIMIT), self.seen).reshape(self.batch.size, self.agents, -1)
            reward, terminated, _ = self.batch.step(action)
            total += np.where(alive, reward.mean(axis=1, dtype=np.float64), 0.0)
            self.lasted += alive
            alive &= ~terminated
            if not alive.any():
                break
        return total, alive
