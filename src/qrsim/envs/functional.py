"""Tasks as pure functions of JAX: can be compiled, mapped over seeds and differentiated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.errors import UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import Episode, Play, Step


@dataclass(frozen=True)
class Functional:
    """A task of n agents, each of whose actions is A numbers in [-1, 1].

    Attributes:
        play: the task and its world.
        name: of the scenario.
    """

    play: Play
    name: str

    @staticmethod
    def of(
        scenario: str | Path | dict[str, Any], overrides: Iterable[str] = (), precision: str = "float32"
    ) -> Functional:
        """Return the environment of a scenario.

        Args:
            scenario: as ``qrsim.load`` takes it.
            overrides: assignments such as "world.wind.speed_20ft=7".
            precision: of its numbers, float32 or float64.

        Raises:
            UsageError, ScenarioError: there is no such scenario, it is wrong, or it has no task.
        """
        loaded = load_scenario(scenario, overrides)
        if not loaded.steps:
            raise UsageError(f"scenario {loaded.name}: it has no task, and nothing to be rewarded for")
        # Of every number one array, so that all scenarios of a structure share a program.
        task, world = cast(loaded.task(precision), np.dtype(precision)), loaded.world(precision)
        return Functional(Play(task, world, loaded.steps), loaded.name)

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the agents."""
        return self.play.agents

    def keys(self, seeds: Any, numbers: Any = 0) -> Any:
        """Return the keys of episodes, one for each seed (B,), made on the host.

        Args:
            seeds: 0 <= seed < 2**63.
            numbers: which episode of its seed each is, 0 <= number < 2**32.
        """
        seeds = np.atleast_1d(np.asarray(seeds, np.int64))
        return self.play.keys(Key.roots(seeds, np.broadcast_to(np.asarray(numbers, np.int64), seeds.shape)))

    def reset(self, seed: Any) -> tuple[Episode, Any]:
        """Start an episode; return it and the observations, (n, O) or a dict of arrays (n, ...).

        Args:
            seed: () or, for one of 64 bits, its low and high words (2,) uint32; or one of ``keys``.
        """
        if hasattr(seed, "dtype") or isinstance(seed, int):
            words = jnp.asarray(seed, jnp.uint32)
            key = Key.root(words if words.ndim else jnp.stack([words, jnp.uint32(0)]))
            return self.play.reset(self.play.keys(key))
        return self.play.reset(seed)

    def step(self, episode: Episode, action: Array) -> tuple[Episode, Step]:
        """Advance an episode by the actions (n, A); results after its end have no meaning."""
        return self.play.step(episode, action)

    def score(self, episode: Episode, answer: Array) -> Array:
        """Score the agents' answers, (n, L) or (n, L, K), (n,); see the task.

        Raises:
            UsageError: nothing can be handed in.
        """
        if not self.play.task.hands_in:
            raise UsageError(f"{self.name}: nothing is handed in in this task")
        score: Array = self.play.task.score(episode.memory, self.play.world, episode.state, answer)
        return score

    def truth(self, episode: Episode) -> dict[str, Array]:
        """Return the ground truth of the agents (n,), which they do not observe."""
        return self.play.truth(episode)
