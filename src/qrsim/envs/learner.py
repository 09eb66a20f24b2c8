"""Tasks of one vehicle in the form that learners like: ``gymnasium.make("qrsim/keep_spot-learner-v0")``.

It is the view and the reward of ``qrsim train`` (docs/howto/train.md). The published task keeps its own form, and its
reward is in the info of each step.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.envs.arguments import checked_arguments
from qrsim.envs.drawing import RENDER_MODES
from qrsim.envs.functional import Functional
from qrsim.envs.objective import objective_of
from qrsim.envs.single import SingleTask
from qrsim.envs.viewing import view_of
from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.tasks.learned import LIMIT

# Change of an observation that is one unit of an input, by its unit; of others 1.
UNITS = {"m": 5.0, "m/s": 2.0, "rad": 0.3}


class LearnerTask(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A task with one vehicle, with scaled inputs, actions around the neutral one, and a reward for each decision.

    An observation (F,) has the offset to the goal, velocity and attitude relative to the heading, over 5 m, 2 m/s and
    0.3 rad, and the last action (K,). An action (K,) in [-1, 1] changes the neutral command. A decision is held for
    0.1 s, of rates and motors for 0.02 s. Time limits are truncations.

    Args:
        scenario, overrides, precision, render_mode: as of ``SingleTask``.
        discount: of the learner, for each decision; the potential in the reward needs it.

    Attributes:
        view: how the task is seen.

    Raises:
        UsageError: the task is not one that ``qrsim train`` takes, or it has several vehicles.
    """

    # A dict of the class, because Gymnasium before 1.4 reads it before there is an environment.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    @checked_arguments
    def __init__(
        self,
        scenario: str | Path | Content,
        overrides: Iterable[str] = (),
        precision: str = "float32",
        render_mode: str | None = None,
        discount: float = 0.99,
    ):
        if not (isinstance(discount, float | int) and 0.0 <= discount < 1.0):
            raise UsageError(f"discount: {discount!r}; allowed: 0 to less than 1")
        given = list(overrides)
        functional = Functional.of(scenario, given)
        self.view = view_of(functional)
        task = SingleTask(scenario, [*given, f"task.period={self.view.seconds!r}"], precision, render_mode)
        super().__init__(task)
        self.metadata = task.metadata
        self._batch = task.batch
        self._objective = objective_of(task.batch, discount)
        acts = len(self.view.flown)
        axes: Any = functional.observation_axes
        units = [UNITS.get(axis.unit, 1.0) for axis in axes]
        self._units = np.array([*(units[number] for number in self.view.kept), *[1.0] * acts], np.float32)
        self._last = np.zeros((1, acts), np.float32)
        self._seen = np.zeros((1, len(self.view.observed)), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (acts,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-LIMIT, LIMIT, (self.view.inputs,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[NumpyArray, dict[str, Any]]:
        """Start an episode; return the network's inputs (F,) and the info with the true values.

        Raises:
            UsageError: as of ``SingleTask.reset``.
        """
        seen, info = self.env.reset(seed=seed, options=options)
        self._last = np.zeros_like(self._last)
        self._objective.begin(self._batch)
        return self._inputs(seen), info

    def step(self, action: Any) -> tuple[NumpyArray, float, bool, bool, dict[str, Any]]:
        """Advance by one decision; return inputs (F,), learner's reward, ends, info with the task's ``task_reward``.

        Raises:
            UsageError: as of ``SingleTask.step``.
        """
        given = np.asarray(action)
        if given.shape != self._last.shape[1:] or given.dtype.kind not in "biuf" or not np.isfinite(given).all():
            raise UsageError(
                f"action: expected {self._last.shape[1]} finite numbers from -1 to 1, found {action!r:.80}"
            )
        outputs = given[None].astype(np.float32).clip(-1.0, 1.0)
        seen, reward, terminated, truncated, info = self.env.step(self.view.action(outputs, self._seen)[0])
        self._last = outputs
        own = self._objective.reward(self._batch, np.array([[reward]]), np.array([terminated]), outputs)
        return self._inputs(seen), float(own[0]), terminated, truncated, info | {"task_reward": reward}

    def _inputs(self, seen: object) -> NumpyArray:
        """Store an observation; return the network's inputs (F,) for it and the last action, scaled and clipped."""
        self._seen = np.asarray(seen)[None]
        return self.scaled(self.view.features(self._seen, self._last))[0]

    def scaled(self, features: NumpyArray) -> NumpyArray:
        """Return inputs (N, F) of the view, divided by typical values of their units and clipped."""
        found: NumpyArray = (features / self._units).clip(-LIMIT, LIMIT).astype(np.float32)
        return found
