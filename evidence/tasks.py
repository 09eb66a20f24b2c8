"""What the baselines of the tasks score, against hovering and against flying at random; in a search, beside an oracle.

A random policy draws every number of every action uniformly. Most of its vehicles leave the area, which says little of
the others; an idle one asks for no velocity at all. Where something is handed in, both hand in zeros, or for puffs
samples of an exponential distribution of mean 0.01 at every location, because equal samples have no distribution. All
fly the same episodes. The mean over the seeds has a Student t interval.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import jax
import numpy as np
import scipy

from qrsim.envs.batch import Batch
from qrsim.envs.scoring import Informed
from qrsim.tasks import Play, Search
from qrsim.tasks.baselines import baseline, oracle

DOC = "mean scores of the baseline of each task, of hovering and of a random policy, over 100 seeds"
# The baselines were made while seeds from 0 on were looked at.
SEED = 1000
CONFIDENCE = 0.95
# Those that take longest first, so that two cores end together.
FULL = (
    *(f"plume_mapping/3{letter}" for letter in "GFEDCBA"),
    *(f"search_and_rescue/2{letter}" for letter in "DCBA"),
    *(f"cats_and_mouse/1{letter}" for letter in "CBA"),
)
PARTS = FULL
SEEDS = 100
SMALL, SMALL_SEEDS, SMALL_S = ("search_and_rescue/2A",), 3, 10.0

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


class Idle(Random):
    """Stays where it is."""

    def act(self, seen: Any) -> Values:
        """Return the actions (n, A): no velocity."""
        return np.zeros(self._shape)


POLICIES = {"baseline": baseline, "idle": Idle, "random": Random}
# Of a search, whose oracle knows where persons lie.
SEARCHED = {**POLICIES, "oracle": oracle}


def scores(batch: Batch, policy: Any) -> tuple[Values, Values]:
    """Return the return of each episode (B,), the mean of its agents, and whether nobody stopped in it."""
    play = jax.tree.map(np.asarray, batch.functional.play)
    batch.reset(SEED + np.arange(batch.size))
    policies = [policy(play, seed) for seed in range(batch.size)]
    nothing = np.zeros((len(play.agents), len(play.task.axes)))
    total, flies = np.zeros(batch.size), np.ones(batch.size, bool)
    for step in range(play.steps):
        if not flies.any():
            break
        seen = [jax.tree.map(lambda leaf, i=i: leaf[i], batch.seen) for i in range(batch.size)]
        for i in np.flatnonzero(flies):
            if isinstance(policies[i], Informed):
                policies[i].know(batch.episodes.episode(int(i)).state)
        actions = [policies[i].act(seen[i]) if flies[i] else nothing for i in range(batch.size)]
        reward, terminated, _ = batch.step(np.stack(actions))
        total += np.where(flies, reward.mean(axis=1), 0.0)
        flies &= ~terminated
        if step == play.steps - 1 and play.task.hands_in:
            for i in np.flatnonzero(flies):
                total[i] += batch.score(int(i), policies[i].answer()).mean()
    return total, flies


def summary(total: Values, flies: Values) -> dict[str, float]:
    """Return mean, interval, median, and the part of the episodes in which nobody stopped."""
    half = scipy.stats.t.ppf(0.5 + CONFIDENCE / 2.0, len(total) - 1) * total.std(ddof=1) / math.sqrt(len(total))
    return {
        "mean": total.mean(),
        "low": total.mean() - half,
        "high": total.mean() + half,
        "median": float(np.median(total)),
        "flown_to_the_end": flies.mean(),
    }


def score(name: str, seeds: int, duration_s: float) -> dict[str, Any]:
    """Return what each policy scores in a scenario; a duration of 0 leaves it its own."""
    batch = Batch(name, seeds, [f"duration={duration_s}"] if duration_s else ())
    if not isinstance(batch.functional.play.task, Search):
        return {kind: summary(*scores(batch, policy)) for kind, policy in POLICIES.items()}
    found = {}
    for kind, policy in SEARCHED.items():
        total, flies = scores(batch, policy)
        found[kind] = {**summary(total, flies), "persons_found": persons(total, flies, batch.functional.play.steps)}
    return found


def persons(total: Values, flies: Values, steps: int) -> float:
    """Return how many persons a flight finds that goes on to the end, the mean; 0 if none does.

    Each is worth 1 in place of the -1 / steps of a step without any.
    """
    each = np.floor(total[flies] + 1.0 + 0.5 / steps)
    return float(each.mean()) if len(each) else 0.0


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return what the policies score in each scenario, or in some of them."""
    found: dict[str, Any] = {"seeds": SEEDS if full else SMALL_SEEDS, "confidence": CONFIDENCE}
    if not full:
        return found | {key(name): score(name, SMALL_SEEDS, SMALL_S) for name in SMALL}
    # Threads of a forked process would wait for ever for those that were not forked with it.
    with ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn")) as pool:
        waiting = {name: pool.submit(score, name, SEEDS, 0.0) for name in FULL if name in parts}
        return found | {key(name): waiting[name].result() for name in sorted(waiting)}


def key(name: str) -> str:
    """Return what a scenario is called in the results."""
    return name.replace("/", "_")
