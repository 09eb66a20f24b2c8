"""One vehicle's task, many times, as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from qrsim.envs.batch import Batch
from qrsim.envs.single import only_one, refuse_drawing, shaped, split_answer
from qrsim.envs.spaces import action_space, observation_space, split_say
from qrsim.errors import UsageError

Array = np.ndarray[Any, Any]


class VectorTask(VectorEnv[Any, Any, Any]):
    """Many episodes of a task with one vehicle; an episode that ends is restarted in the same step.

    Environment i of a seed s is that of ``SingleTask`` with the seed s + i. What was seen last of an episode that has
    ended, and what was really the case, is in ``infos["final_obs"]`` and ``infos["final_info"]``.

    Args:
        scenario, overrides, precision, render_mode: as of ``SingleTask``.
        num_envs: how many.

    Attributes:
        observation_axes: as of ``SingleTask``.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | dict[str, Any],
        num_envs: int = 1,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
    ):
        refuse_drawing(render_mode)
        self.render_mode = None
        self.batch = Batch(scenario, num_envs, overrides, precision)
        only_one(self.batch)
        self.num_envs = self.batch.size
        self.single_action_space = action_space(self.batch)
        self.observation_axes = self.batch.functional.observation_axes
        shapes = jax.eval_shape(self.batch.functional.reset, np.zeros(2, np.uint32))[1]
        self.single_observation_space = observation_space(
            self.batch.functional.play,
            jax.tree.map(lambda leaf: np.broadcast_to(np.zeros((), leaf.dtype), (1, *leaf.shape)), shapes),
        )
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]`` (num_envs,) bool.

        Args:
            seed: one for environment 0, those of the others follow; or one for each. None: the next episodes of the
                series, at first of a random seed.
            options: see above.
        """
        rows = np.arange(self.num_envs)
        if options and "reset_mask" in options:
            rows = np.flatnonzero(options["reset_mask"])
        if seed is None and self.batch.episodes.started:
            self.batch.again(rows)
        else:
            first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            given = [first + i for i in range(self.num_envs)] if isinstance(first, int | np.integer) else list(first)
            if len(given) != self.num_envs or any(value is None for value in given):
                raise UsageError(f"seed: expected one for each of {self.num_envs} environments, found {len(given)}")
            self.batch.reset(np.array(given)[rows], rows)
        return self._seen(), self._truth(np.ones(self.num_envs, bool))

    def step(self, actions: Any) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """Advance all episodes, and restart those that have ended.

        Raises:
            UsageError: nothing has started, or actions of another shape, not finite, out of range or incomplete.
        """
        actions, words = split_say(self.batch, actions, "actions", self.num_envs)
        flight, answers = split_answer(self.batch, actions, "actions")
        flown = shaped(self.batch, flight, "actions", self.num_envs)
        reward, terminated, truncated = self.batch.step(flown[:, None], words[:, None], "actions")
        rewards = reward[:, 0].astype(np.float64)
        if answers is not None:
            for row in np.flatnonzero(truncated):
                rewards[row] += self.batch.score(int(row), np.asarray(answers)[row][None])[0]
        ended = terminated | truncated
        infos: dict[str, Any] = {}
        if ended.any():
            infos["final_obs"] = jax.tree.map(lambda leaf: _where(ended, leaf), self._seen())
            infos["final_info"] = {name: _where(ended, leaf) for name, leaf in self._truth(ended).items()}
            infos["_final_obs"], infos["_final_info"] = ended.copy(), ended.copy()
            self.batch.again(np.flatnonzero(ended))
        infos |= self._truth(np.ones(self.num_envs, bool))
        return self._seen(), rewards, terminated, truncated, infos

    def _seen(self) -> Any:
        return jax.tree.map(lambda leaf: leaf[:, 0].copy(), self.batch.seen)

    def _truth(self, there: Array) -> dict[str, Any]:
        values = {name: leaf[:, 0].copy() for name, leaf in self.batch.truth.items()}
        return values | {f"_{name}": there.copy() for name in values}


def _where(ended: Array, leaf: Array) -> Array:
    """Return a copy that is zero where an episode goes on."""
    shaped = ended.reshape(-1, *(1,) * (leaf.ndim - 1))
    return np.where(shaped, leaf, np.zeros((), leaf.dtype))
