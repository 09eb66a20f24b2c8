"""One vehicle's task as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import jax
import numpy as np

from qrsim.envs.batch import Batch
from qrsim.envs.spaces import SAMPLES, VELOCITY, action_space, observation_space, split_say
from qrsim.errors import UsageError


def only_one(batch: Batch) -> None:
    """Refuse a task of several vehicles.

    Raises:
        UsageError: that.
    """
    agents = batch.functional.agents
    if len(agents) != 1:
        raise UsageError(
            f"{batch.functional.name}: {len(agents)} vehicles are commanded, {', '.join(agents)}; it is an "
            "environment of PettingZoo, qrsim.envs.parallel_env"
        )


def refuse_drawing(render_mode: str | None) -> None:
    """Refuse every render mode but None.

    Raises:
        UsageError: another one is asked for.
    """
    if render_mode is not None:
        raise UsageError(f"render_mode: {render_mode!r}; allowed: None")


def shaped(batch: Batch, flight: Any, who: str, *lead: int) -> np.ndarray[Any, Any]:
    """Check the flight part of actions, and return it as an array (*lead, A).

    Raises:
        UsageError: it has another shape.
    """
    axes = batch.functional.play.axes
    expected = (*lead, len(axes))
    if np.shape(flight) != expected:
        names = ", ".join(axis.name for axis in axes)
        raise UsageError(f"{who}: expected shape {expected} ({names}), found {np.shape(flight)}")
    return np.asarray(flight)


def split_answer(batch: Batch, action: Any, who: str) -> tuple[Any, Any]:
    """Split an action into its flight part and the answer, None for a task without answers.

    Raises:
        UsageError: a part is missing.
    """
    if not batch.functional.play.task.hands_in:
        return action, None
    for part in (VELOCITY, SAMPLES):
        if not isinstance(action, dict) or part not in action:
            raise UsageError(f"{who}: {part} are missing; a step of this task takes a dict of {VELOCITY} and {SAMPLES}")
    return action[VELOCITY], action[SAMPLES]


class SingleTask(gymnasium.Env[Any, Any]):
    """A task with one vehicle.

    An action is numbers in [-1, 1], which the task scales to its units; an observation what the vehicle's sensors say;
    what is really the case is in ``info`` only. An episode is terminated when a vehicle has stopped, and truncated
    after its last step. A seed starts a series of episodes; without one the next episode of the series begins.

    Args:
        scenario: as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        precision: float32 or float64.
        render_mode: None; nothing is drawn.

    Attributes:
        observation_axes: name, unit and range of each number of an observation; of a dict, of those that have names.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | Path | dict[str, Any],
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
    ):
        refuse_drawing(render_mode)
        self.render_mode = None
        self.batch = Batch(scenario, 1, overrides, precision)
        only_one(self.batch)
        self.action_space = action_space(self.batch)
        self.batch.reset(np.zeros(1, np.int64))
        self.observation_axes = self.batch.functional.observation_axes
        self.observation_space = observation_space(self.batch.functional.play, self.batch.seen)
        self._running = False
        self._seeded = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; return the observation and the info with the ground truth."""
        super().reset(seed=seed)
        if seed is None and self._seeded:
            self.batch.again(np.zeros(1, np.int64))
        else:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self.batch.reset(np.array([first]))
        self._running = self._seeded = True
        return self._seen(), self._truth()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advance by a step.

        Raises:
            UsageError: the episode has ended, or an action of another shape, not finite, out of range or incomplete.
        """
        if not self._running:
            raise UsageError("the episode has ended, or has not begun: call reset()")
        action, words = split_say(self.batch, action, "action")
        flight, answer = split_answer(self.batch, action, "action")
        flown = shaped(self.batch, flight, "action")[None, None]
        reward, terminated, truncated = self.batch.step(flown, words[None, None])
        total = float(reward[0, 0])
        if answer is not None and truncated[0]:
            total += float(self.batch.score(0, np.asarray(answer)[None])[0])
        self._running = not (terminated[0] or truncated[0])
        return self._seen(), total, bool(terminated[0]), bool(truncated[0]), self._truth()

    def _seen(self) -> Any:
        return jax.tree.map(lambda leaf: leaf[0, 0].copy(), self.batch.seen)

    def _truth(self) -> dict[str, Any]:
        return {name: leaf[0, 0].copy() for name, leaf in self.batch.truth.items()}
