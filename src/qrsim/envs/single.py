"""One vehicle's task as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import jax
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.envs.arguments import checked_arguments
from qrsim.envs.batch import Batch, checked_seed, numbers
from qrsim.envs.drawing import RENDER_MODES, Drawing, checked_mode
from qrsim.envs.spaces import action_space, answer_space, observation_space, split_say
from qrsim.errors import UsageError
from qrsim.files import Content


def only_one(batch: Batch) -> None:
    """Raise UsageError if the batch's task has several agents.

    Raises:
        UsageError: that.
    """
    agents = batch.functional.agents
    if len(agents) != 1:
        raise UsageError(
            f"{batch.functional.name}: {len(agents)} vehicles are commanded, {', '.join(agents)}; it is an "
            "environment of PettingZoo, qrsim.envs.parallel_env"
        )


def shaped(batch: Batch, flight: object, who: str, *lead: int, agent: int = 0) -> NumpyArray:
    """Return an agent's actions ``flight`` (*lead, A), padded to the batch's width; raise UsageError if invalid.

    Raises:
        UsageError: it has another shape, or is no numbers.
    """
    axes = batch.axes[agent]
    expected = (*lead, len(axes))
    array = numbers(flight, who, expected)
    if array.shape != expected:
        names = ", ".join(axis.name for axis in axes)
        raise UsageError(f"{who}: expected shape {expected} ({names}), found {array.shape}")
    return np.pad(array, [(0, 0)] * len(lead) + [(0, batch.width - len(axes))]) if len(axes) < batch.width else array


class SingleTask(gymnasium.Env[Any, Any]):
    """A task with one vehicle.

    An action is numbers in [-1, 1], which the task scales to its units; an observation what the vehicle's sensors say;
    what is really the case is in ``info`` only. An episode is terminated when a vehicle has stopped, and truncated
    after its last step. The last observation of a vehicle that has stopped is the one of the step before, its last in
    flight. A seed starts a series of episodes; without one the next episode of the series begins.

    Args:
        scenario: as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        precision: float32 or float64.
        render_mode: "rgb_array": ``render`` returns a picture from above; None: nothing is drawn.

    Attributes:
        observation_axes: name, unit and range of each number of an observation; of a dict, of those that have names.
        answer_space: of what is handed in by ``hand_in``; None for a task without.
    """

    metadata: dict[str, object] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    @checked_arguments
    def __init__(
        self,
        scenario: str | Path | Content,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
    ):
        self.render_mode = checked_mode(render_mode)
        self.batch = Batch(scenario, 1, overrides, precision)
        only_one(self.batch)
        self.metadata = {**self.metadata, "render_fps": self.batch.steps_per_second}
        self._drawing = None if render_mode is None else Drawing(self.batch)
        self.action_space, self.answer_space = action_space(self.batch), answer_space(self.batch)
        self.batch.reset(np.zeros(1, np.int64))
        self.observation_axes = self.batch.functional.observation_axes
        self.observation_space = observation_space(self.batch.functional.play, self.batch.seen)
        self._running = False
        self._seeded = False

    def reset(self, *, seed: int | None = None, options: dict[str, object] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode, without a seed the next of the series; return the observation, and true values as info.

        Args:
            seed: of a new series; None: the next episode of this one.
            options: ``difficulty`` is that of ``set_difficulty``.

        Raises:
            UsageError: a seed is no integer from 0 to 2**63 - 1, or a difficulty is none.
        """
        seed = None if seed is None else checked_seed(seed)
        super().reset(seed=seed)
        self.batch.take_options(options)
        if seed is None and self._seeded:
            self.batch.again(np.zeros(1, np.int64))
        else:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self.batch.reset([first])
        self._running = self._seeded = True
        if self._drawing is not None:
            self._drawing.begin()
        return self._observation(), self._truth_values()

    def step(self, action: object) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by one step; return observation, reward, terminated, truncated, and true values as info.

        Raises:
            UsageError: the episode has ended, or an action of another shape, not finite, out of range or incomplete.
        """
        if not self._running:
            raise UsageError("the episode has ended, or has not begun: call reset()")
        action, words = split_say(self.batch, action, "action")
        flown = shaped(self.batch, action, "action")[None, None]
        reward, terminated, truncated = self.batch.step(flown, words[None, None])
        total = float(reward[0, 0])
        if truncated[0]:
            total += float(self.batch.scores(np.zeros(1, int))[0, 0])
        if self._drawing is not None:
            self._drawing.moved()
        self._running = not (terminated[0] or truncated[0])
        return self._observation(), total, bool(terminated[0]), bool(truncated[0]), self._truth_values()

    def render(self) -> NumpyArray | None:
        """Return a picture of the episode from above, (480, 640, 3) uint8; None without a render mode.

        Raises:
            UsageError: nothing has begun.
        """
        return None if self._drawing is None else self._drawing.frame()

    def hand_in(self, samples: object) -> None:
        """Store the agent's answer (``answer_space``); the last one of an episode is scored at its end.

        Whoever hands in nothing is scored as if it were zeros.

        Raises:
            UsageError: nothing is handed in in this task, no episode runs, another shape, or something not finite.
        """
        if not self._running:
            raise UsageError("the episode has ended, or has not begun: hand in before its last step")
        self.batch.hand_in([[samples]], np.zeros(1, int), np.zeros(1, int))

    def set_difficulty(self, difficulty: float) -> None:
        """Set the difficulty of later episodes, from 0 (the scenario's values) to 1 (its full random ranges).

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        self.batch.set_difficulty(difficulty)

    def _observation(self) -> object:
        """Return a copy of the agent's present observation."""
        return jax.tree.map(lambda leaf: leaf[0, 0].copy(), self.batch.seen)

    def _truth_values(self) -> dict[str, object]:
        """Return the agent's present true values by name."""
        return {name: leaf[0, 0].copy() for name, leaf in self.batch.truth.items()}
