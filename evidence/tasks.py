"""What the baselines of the tasks score, against flying at random.

A random policy draws every number of every action uniformly; where something is handed in, it hands in zeros, or for
puffs samples of an exponential distribution of mean 0.01 at every location, because equal samples have no distribution.
Both fly the same episodes. The mean over the seeds has a Student t interval.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from scipy import stats

from qrsim.apps.envs.batch import Batch
from qrsim.tasks import Play
from qrsim.tasks.baselines import baseline

DOC = "mean scores of the baseline of each family of tasks and of a random policy, over 100 seeds"
# The baselines were made while seeds from 0 on were looked at.
SEED = 1000
CONFIDENCE = 0.95
# Scenarios, seeds, and the duration [s] in place of theirs (0: theirs).
FULL = (("cats_and_mouse/1A", "cats_and_mouse/1C", "plume_mapping/3A", "search_and_rescue/2D"), 100, 0.0)
SMALL = (("search_and_rescue/2A",), 3, 10.0)

Values = np.ndarray[Any, Any]


class Random:
    """Flies at random."""

    def __init__(self, play: Play, seed: int):
        self._shape = (len(play.agents), len(play.task.axes))
        self._random = np.random.default_rng(seed)
        self._play = play

    def act(self, seen: Any) -> Values:
        """Return the actions (n, A)."""
        return self._random.uniform(-1.0, 1.0, self._shape)

    def answer(self) -> Values:
        """Return what each agent hands in."""
        shape = (self._shape[0], *self._play.task.answer_shape(self._play.world))
        return np.zeros(shape) if len(shape) == 2 else self._random.exponential(0.01, shape)


def scores(batch: Batch, policy: Any) -> tuple[Values, Values]:
    """Return the return of each episode (B,), the mean of its agents, and whether nobody stopped in it."""
    play = jax.tree.map(np.asarray, batch.functional.play)
    batch.reset(SEED + np.arange(batch.size))
    policies = [policy(play, seed) for seed in range(batch.size)]
    nothing = np.zeros((len(play.agents), len(play.task.axes)))
    total, flies = np.zeros(batch.size), np.ones(batch.size, bool)
    for step in range(play.steps):
        seen = [jax.tree.map(lambda leaf, i=i: leaf[i], batch.seen) for i in range(batch.size)]
        actions = [policies[i].act(seen[i]) if flies[i] else nothing for i in range(batch.size)]
        reward, terminated, _ = batch.step(np.stack(actions))
        total += np.where(flies, reward.mean(axis=1), 0.0)
        flies &= ~terminated
        if step == play.steps - 1 and hasattr(play.task, "answer_shape"):
            for i in np.flatnonzero(flies):
                total[i] += batch.score(int(i), policies[i].answer()).mean()
    return total, flies


def summary(total: Values, flies: Values) -> dict[str, float]:
    """Return mean, interval, median, and the part of the episodes in which nobody stopped."""
    half = stats.t.ppf(0.5 + CONFIDENCE / 2.0, len(total) - 1) * total.std(ddof=1) / math.sqrt(len(total))
    return {
        "mean": total.mean(),
        "low": total.mean() - half,
        "high": total.mean() + half,
        "median": float(np.median(total)),
        "flown_to_the_end": flies.mean(),
    }


def run(full: bool) -> dict[str, Any]:
    """Return what baseline and random policy score in each scenario."""
    names, seeds, duration = FULL if full else SMALL
    found: dict[str, Any] = {"seeds": seeds, "confidence": CONFIDENCE}
    for name in names:
        batch = Batch(name, seeds, [f"duration={duration}"] if duration else ())
        found[name.replace("/", "_")] = {
            "baseline": summary(*scores(batch, baseline)),
            "random": summary(*scores(batch, Random)),
        }
    return found
