"""Many episodes of a task at once: compiled, each restarted where it ends."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qrsim.engine.settings import use_compilation_cache
from qrsim.envs.functional import Functional
from qrsim.errors import UsageError
from qrsim.tasks.episodes import Episodes, score
from qrsim.world.episode import refuse_unplaced

FloatArray = np.ndarray[Any, Any]
# An action may be outside [-1, 1] by no more than rounding.
ROUNDING = 1e-5
LARGEST_SEED = 2**63


class Batch:
    """B episodes.

    Args:
        scenario, overrides, precision: see ``Functional.of``.
        size: B.

    Attributes:
        functional: what is played.
        episodes: what computes them.
        seen: what the agents see now, arrays (B, n, ...).
        truth: what is really the case, by name, (B, n, ...).
    """

    def __init__(
        self,
        scenario: str | Path | dict[str, Any],
        size: int,
        overrides: Iterable[str] = (),
        precision: str = "float32",
    ):
        if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
            raise UsageError(f"num_envs: {size!r} is not a positive whole number")
        use_compilation_cache()
        self.functional = Functional.of(scenario, overrides, precision)
        self.size = int(size)
        self.dtype = np.dtype(precision)
        with self._precision():
            self.episodes = Episodes(self.functional.play, self.size, self.dtype)
        self.seeds = np.zeros(self.size, np.int64)
        self.numbers = np.zeros(self.size, np.int64)
        self.seen: Any = None
        self.truth: dict[str, FloatArray] = {}

    def _precision(self) -> Any:
        return jax.enable_x64(self.dtype == np.float64)

    def reset(self, seeds: FloatArray, rows: FloatArray | None = None) -> None:
        """Reset the episodes ``rows`` (None: all) with new seeds, one each.

        Raises:
            UsageError: a seed is no integer from 0 to 2**63 - 1.
            RunError: a fleet found no place.
        """
        for seed in seeds:
            if isinstance(seed, bool) or not 0 <= int(seed) < LARGEST_SEED:
                raise UsageError(f"seed: {seed!r} is not an integer from 0 to 2**63 - 1")
        which = np.arange(self.size) if rows is None else np.asarray(rows)
        self.seeds[which], self.numbers[which] = np.asarray(seeds, np.int64), 0
        self._start(which)

    def again(self, rows: FloatArray) -> None:
        """Start the next episode of each of ``rows``, in its seed's series."""
        self.numbers[rows] += 1
        self._start(rows)

    def _start(self, rows: FloatArray) -> None:
        with self._precision():
            keys = self.functional.keys(self.seeds[rows], self.numbers[rows])
            begun = self.episodes.start(rows, keys)
        refuse_unplaced(self.functional.play.world, begun.placed)
        if self.seen is None:
            self.seen, self.truth = (_empty(part, self.size) for part in (begun.seen, begun.truth))
        for whole, part in ((self.seen, begun.seen), (self.truth, begun.truth)):
            jax.tree.map(lambda old, new: _set(old, rows, new), whole, part)

    def step(self, action: Any, words: Any = None, who: str = "action") -> tuple[FloatArray, FloatArray, FloatArray]:
        """Advance all episodes by actions (B, n, A), and return reward (B, n), terminated (B,) and truncated (B,).

        Args:
            action: of each agent.
            words: (B, n, D) what they say over the radio, NaN for who says nothing; None: nobody does.
            who: what messages call the actions.

        Raises:
            UsageError: nothing has started, or actions of another shape, not finite or outside [-1, 1].
        """
        if not self.episodes.started:
            raise UsageError("the environment has not started: call reset() first")
        checked = self.checked(action, who)
        if self.functional.play.message:
            said = np.full((*checked.shape[:2], self.functional.play.message), np.nan) if words is None else words
            checked = np.concatenate([checked, np.asarray(said, self.dtype)], axis=2)
        with self._precision():
            step, self.truth = self.episodes.step(checked)
        self.seen = step.observation
        return step.reward, step.terminated, step.truncated  # type: ignore[return-value]

    def checked(self, action: Any, who: str) -> FloatArray:
        """Check actions and return them as (B, n, A)."""
        axes, agents = self.functional.play.axes, self.functional.agents
        shape = (self.size, len(agents), len(axes))
        try:
            array = np.asarray(action, self.dtype)
        except (TypeError, ValueError, OverflowError):
            raise UsageError(f"{who}: expected numbers of shape {shape[2:]}, found {action!r}") from None
        if array.shape != shape:
            # Whoever has one environment, or one agent, does not see these axes.
            raise UsageError(
                f"{who}: expected shape {shape} (environments, agents; {', '.join(axis.name for axis in axes)}), found "
                f"{array.shape}"
            )
        wrong = ~(np.abs(array) <= 1.0 + ROUNDING)
        if wrong.any():
            row, agent, axis = np.argwhere(wrong)[0]
            raise UsageError(
                f"{who}: {axes[axis].name} of '{agents[agent]}' in environment {row} is {array[row, agent, axis]:g}; "
                "allowed: -1 to 1"
            )
        return array

    def score(self, row: int, answer: Any) -> FloatArray:
        """Score the answers (n, ...) of the agents of an episode; (n,).

        Raises:
            UsageError: another shape, or something that is not finite.
        """
        shape = (len(self.functional.agents), *self.functional.play.task.answer_shape(self.functional.play.world))
        array = np.asarray(answer, self.dtype)
        if array.shape != shape:
            raise UsageError(f"samples: expected shape {shape[1:]} of each agent, found {array.shape[1:]}")
        if not np.isfinite(array).all():
            raise UsageError(f"samples: number {np.argwhere(~np.isfinite(array))[0][1]} is not finite")
        with self._precision():
            return score(self.functional.play, self.episodes.episode(row), array)


def _empty(tree: Any, size: int) -> Any:
    return jax.tree.map(lambda leaf: np.zeros((size, *leaf.shape[1:]), leaf.dtype), tree)


def _set(old: FloatArray, rows: FloatArray, new: Any) -> None:
    old[rows] = new
