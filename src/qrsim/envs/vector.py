"""One vehicle's task, many times, as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.envs.arguments import checked_arguments
from qrsim.envs.batch import Batch
from qrsim.envs.drawing import RENDER_MODES
from qrsim.envs.series import Series
from qrsim.envs.single import only_one, shaped
from qrsim.envs.spaces import action_space, answer_space, observation_space, split_say
from qrsim.errors import UsageError
from qrsim.files import Content


class VectorTask(VectorEnv[Any, Any, Any]):
    """Many episodes of a task with one vehicle.

    Environment i of a seed s is that of ``SingleTask`` with the seed s + i.

    Args:
        scenario: as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        precision: "float32" or "float64".
        render_mode: as of ``SingleTask``.
        num_envs: how many.
        autoreset_mode: when an episode that has ended is followed by the next, one of Gymnasium's or its name.
            ``NEXT_STEP``: the next step begins it; that step's action is not looked at, and its reward is 0.
            ``SAME_STEP``: the step that ends the old one begins it; what was seen last of the old one, and what was
            really the case, is in ``infos["final_obs"]`` and ``infos["final_info"]``. ``DISABLED``: a reset by
            ``options["reset_mask"]`` begins it.

    Attributes:
        observation_axes: as of ``SingleTask``, each of one environment.
        answer_space: as of ``SingleTask``, each of one environment.

    Raises:
        UsageError: there is no such mode.
    """

    metadata: dict[str, object] = {"render_modes": list(RENDER_MODES), "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    @checked_arguments
    def __init__(
        self,
        scenario: str | Path | Content,
        num_envs: int = 1,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ):
        self.render_mode = render_mode
        self.batch = Batch(scenario, num_envs, overrides, precision)
        only_one(self.batch)
        self._series = Series(self.batch, autoreset_mode, render_mode)
        rate = self.batch.steps_per_second
        self.metadata = {**self.metadata, "autoreset_mode": self._series.mode, "render_fps": rate}
        self.num_envs = self.batch.size
        self.single_action_space, self.answer_space = action_space(self.batch), answer_space(self.batch)
        self.observation_axes = self.batch.functional.observation_axes
        shapes = jax.eval_shape(self.batch.functional.reset, np.zeros(2, np.uint32))[1]
        self.single_observation_space = observation_space(
            self.batch.functional.play,
            jax.tree.map(lambda leaf: np.broadcast_to(np.zeros((), leaf.dtype), (1, *leaf.shape)), shapes),
        )
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, object] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]`` (num_envs,) bool; return observations and infos.

        Args:
            seed: one for environment 0, those of the others follow; or one for each. None: the next episodes of the
                series, at first of a random seed.
            options: see above; ``difficulty`` is that of ``set_difficulty``.

        Raises:
            UsageError: a seed or the mask is none, or some are to begin before all have.
        """
        self._series.reset(seed, options)
        return self._observations(), self._truth_info(self.batch.truth, np.ones(self.num_envs, bool))

    def step(self, actions: object) -> tuple[Any, NumpyArray, NumpyArray, NumpyArray, dict[str, Any]]:
        """Advance all environments by one step; ended episodes restart as ``autoreset_mode`` says.

        Raises:
            UsageError: nothing has started, an episode has ended and nothing has begun its next (``DISABLED``), or
                actions of another shape, not finite, out of range or incomplete.
        """
        self._series.check_going()
        actions, words = split_say(self.batch, actions, "actions", self.num_envs)
        flown = shaped(self.batch, actions, "actions", self.num_envs)
        moved = self._series.step(flown[:, None], words[:, None])
        infos: dict[str, object] = {}
        if moved.last is not None:
            seen, truth = moved.last
            infos = {
                "final_obs": jax.tree.map(lambda leaf: leaf[:, 0], seen),
                "final_info": self._truth_info(truth, moved.ended),
                "_final_obs": moved.ended.copy(),
                "_final_info": moved.ended.copy(),
            }
        infos |= self._truth_info(self.batch.truth, np.ones(self.num_envs, bool))
        return self._observations(), moved.rewards[:, 0], moved.terminated, moved.truncated, infos

    def hand_in(self, samples: object, mask: object = None) -> None:
        """Store answers, such as plume maps, of all environments or those in ``mask``; the last ones are scored.

        Args:
            samples: (num_envs, ...), each of ``answer_space``.
            mask: (num_envs,) bool, whose count; None: all.

        Raises:
            UsageError: nothing is handed in in this task, nothing has started, another shape, or something not finite.
        """
        rows = self._series.rows(mask, "mask")
        array = np.asarray(samples)
        if array.shape[:1] != (self.num_envs,):
            raise UsageError(f"samples: expected those of {self.num_envs} environments, found shape {array.shape}")
        self.batch.hand_in(array[rows][:, None], rows, np.zeros(1, int))

    def render(self) -> tuple[Floats, ...] | None:
        """Return a picture of each environment from above; None without a render mode."""
        return self._series.frames()

    def set_difficulty(self, difficulty: float) -> None:
        """Set the difficulty of later episodes, from 0 (the scenario's values) to 1 (its full random ranges).

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        self.batch.set_difficulty(difficulty)

    def _observations(self) -> object:
        """Return the observations (num_envs, ...) as arrays that the caller may change."""
        return jax.tree.map(lambda leaf: leaf[:, 0], self.batch.give_away())

    def _truth_info(self, truth: dict[str, NumpyArray], there: NumpyArray) -> dict[str, NumpyArray]:
        """Return true values as Gymnasium's vector infos: name -> array, "_name" -> which rows have it (``there``)."""
        values = {name: leaf[:, 0].copy() for name, leaf in truth.items()}
        return values | {f"_{name}": there.copy() for name in values}
