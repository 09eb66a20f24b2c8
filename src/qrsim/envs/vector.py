"""One vehicle's task, many times, as a vector environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from qrsim.envs.batch import Batch, checked_seed
from qrsim.envs.drawing import RENDER_MODES, Drawing, checked_mode
from qrsim.envs.single import only_one, shaped
from qrsim.envs.spaces import action_space, answer_space, observation_space, split_say
from qrsim.errors import UsageError, did_you_mean

Array = np.ndarray[Any, Any]


class VectorTask(VectorEnv[Any, Any, Any]):
    """Many episodes of a task with one vehicle.

    Environment i of a seed s is that of ``SingleTask`` with the seed s + i.

    Args:
        scenario, overrides, precision, render_mode: as of ``SingleTask``.
        num_envs: how many.
        autoreset_mode: when an episode that has ended is followed by the next, one of Gymnasium's or its name.
            ``NEXT_STEP``: the next step begins it; that step's action is not looked at, and its reward is 0.
            ``SAME_STEP``: the step that ends the old one begins it; what was seen last of the old one, and what was
            really the case, is in ``infos["final_obs"]`` and ``infos["final_info"]``. ``DISABLED``: a reset by
            ``options["reset_mask"]`` begins it.

    Attributes:
        observation_axes, answer_space: as of ``SingleTask``, each of one environment.

    Raises:
        UsageError: there is no such mode.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | dict[str, Any],
        num_envs: int = 1,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ):
        self.render_mode = checked_mode(render_mode)
        self._mode = mode_of(autoreset_mode)
        self.batch = Batch(scenario, num_envs, overrides, precision)
        only_one(self.batch)
        rate = self.batch.steps_per_second
        self.metadata = {**self.metadata, "autoreset_mode": self._mode, "render_fps": rate}
        self._drawings = [] if render_mode is None else [Drawing(self.batch, row) for row in range(self.batch.size)]
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
        self._over = np.zeros(self.num_envs, bool)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes, or those of ``options["reset_mask"]`` (num_envs,) bool.

        Args:
            seed: one for environment 0, those of the others follow; or one for each. None: the next episodes of the
                series, at first of a random seed.
            options: see above; ``difficulty`` is that of ``set_difficulty``.

        Raises:
            UsageError: a seed or the mask is none, or some are to begin before all have.
        """
        rows = self._rows((options or {}).get("reset_mask"), "reset_mask")
        if len(rows) < self.num_envs and not self.batch.episodes.started:
            raise UsageError("reset_mask: nothing has begun yet; the first reset is of all environments")
        self.batch.take_options(options)
        if seed is None and self.batch.episodes.started:
            self.batch.again(rows)
        else:
            first = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else seed
            table = np.asarray(first, object)
            given = list(table) if table.ndim else [checked_seed(first) + i for i in range(self.num_envs)]
            if len(given) != self.num_envs or any(given[row] is None for row in rows):
                raise UsageError(f"seed: expected one for each of {self.num_envs} environments, found {len(given)}")
            self.batch.reset([given[row] for row in rows], rows)
        self._over[rows] = False
        self._begun(rows)
        return self._seen(), self._truth(np.ones(self.num_envs, bool))

    def _rows(self, given: Any, what: str) -> Array:
        """Return the numbers of the environments of a mask, of all for None.

        Raises:
            UsageError: it has another shape or type.
        """
        mask = np.ones(self.num_envs, bool) if given is None else np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise UsageError(
                f"{what}: expected shape ({self.num_envs},) of bool, found {mask.shape} of {mask.dtype.name}"
            )
        return np.flatnonzero(mask)

    def step(self, actions: Any) -> tuple[Any, Array, Array, Array, dict[str, Any]]:
        """Advance all episodes, and begin the next of those that have ended, as ``autoreset_mode`` says.

        Raises:
            UsageError: nothing has started, an episode has ended and nothing has begun its next (``DISABLED``), or
                actions of another shape, not finite, out of range or incomplete.
        """
        waiting = self._over
        if self._mode is AutoresetMode.DISABLED and waiting.any():
            raise UsageError(
                f"the episode of environment {np.flatnonzero(waiting)[0]} has ended: call reset() with a reset_mask"
            )
        actions, words = split_say(self.batch, actions, "actions", self.num_envs)
        flown = shaped(self.batch, actions, "actions", self.num_envs)
        if waiting.any():
            # These episodes are over, and what becomes of them is not seen.
            flown, words = (np.where(waiting[:, None], np.zeros((), each.dtype), each) for each in (flown, words))
        reward, terminated, truncated = self.batch.step(flown[:, None], words[:, None], "actions")
        rewards, ended = reward[:, 0].astype(np.float64), (terminated | truncated) & ~waiting
        last = np.flatnonzero(truncated & ~waiting)
        rewards[last] += self.batch.scores(last)[:, 0]
        for drawing in self._drawings:
            drawing.moved()
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP:
            if ended.any():
                infos = self._final(ended)
                self.batch.again(np.flatnonzero(ended))
                self._begun(np.flatnonzero(ended))
        elif waiting.any():
            self.batch.again(np.flatnonzero(waiting))
            self._begun(np.flatnonzero(waiting))
            rewards[waiting], terminated, truncated = 0.0, terminated & ~waiting, truncated & ~waiting
        self._over = ended if self._mode is not AutoresetMode.SAME_STEP else np.zeros_like(ended)
        infos |= self._truth(np.ones(self.num_envs, bool))
        return self._seen(), rewards, terminated, truncated, infos

    def hand_in(self, samples: Any, mask: Any = None) -> None:
        """Hand in the answers of all episodes, or of those of a mask; the last of an episode counts, at its end.

        Args:
            samples: (num_envs, ...), each of ``answer_space``.
            mask: (num_envs,) bool, whose count; None: all.

        Raises:
            UsageError: nothing is handed in in this task, nothing has started, another shape, or something not finite.
        """
        rows = self._rows(mask, "mask")
        array = np.asarray(samples)
        if array.shape[:1] != (self.num_envs,):
            raise UsageError(f"samples: expected those of {self.num_envs} environments, found shape {array.shape}")
        self.batch.hand_in(array[rows][:, None], rows, np.zeros(1, int))

    def render(self) -> tuple[Any, ...] | None:
        """Return a picture of each environment, as ``SingleTask`` does; None without a render mode."""
        return tuple(drawing.frame() for drawing in self._drawings) or None

    def set_difficulty(self, difficulty: float) -> None:
        """Draw the ranges of later episodes from smaller ones; see ``Functional.at_difficulty``.

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        self.batch.set_difficulty(difficulty)

    def _begun(self, rows: Array) -> None:
        for row in rows if self._drawings else ():
            self._drawings[row].begin()

    def _final(self, ended: Array) -> dict[str, Any]:
        """Return what was seen last of the episodes that have ended, and what was really the case."""
        return {
            "final_obs": jax.tree.map(lambda leaf: _where(ended, leaf), self._seen()),
            "final_info": {name: _where(ended, leaf) for name, leaf in self._truth(ended).items()},
            "_final_obs": ended.copy(),
            "_final_info": ended.copy(),
        }

    def _seen(self) -> Any:
        return jax.tree.map(lambda leaf: leaf[:, 0].copy(), self.batch.seen)

    def _truth(self, there: Array) -> dict[str, Any]:
        values = {name: leaf[:, 0].copy() for name, leaf in self.batch.truth.items()}
        return values | {f"_{name}": there.copy() for name in values}


def mode_of(given: AutoresetMode | str) -> AutoresetMode:
    """Return a mode of Gymnasium by itself, its name or its value.

    Raises:
        UsageError: there is none such.
    """
    named = {mode.name: mode for mode in AutoresetMode} | {mode.value: mode for mode in AutoresetMode}
    if isinstance(given, AutoresetMode):
        return given
    if str(given) not in named:
        modes = [mode.name for mode in AutoresetMode]
        raise UsageError(f"autoreset_mode: there is no '{given}'{did_you_mean(str(given).upper(), modes)}")
    return named[str(given)]


def _where(ended: Array, leaf: Array) -> Array:
    """Return a copy that is zero where an episode goes on."""
    shaped = ended.reshape(-1, *(1,) * (leaf.ndim - 1))
    return np.where(shaped, leaf, np.zeros((), leaf.dtype))
