"""Many episodes of a task at once: compiled, each restarted where it ends."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.apps.envs.functional import Functional
from qrsim.configuration import FEW_VEHICLES, QUICK_TO_COMPILE, use_compilation_cache
from qrsim.errors import UsageError
from qrsim.tasks import Episode, Play
from qrsim.world import refuse_unplaced

FloatArray = np.ndarray[Any, Any]
# An action may be outside [-1, 1] by no more than rounding.
ROUNDING = 1e-5
LARGEST_SEED = 2**63


def _begin(play: Play, keys: Any) -> Any:
    episode, seen = jax.vmap(play.reset)(keys)
    return episode, seen, jax.vmap(play.truth)(episode)


def _advance(play: Play, episode: Episode, action: Any) -> Any:
    after, step = jax.vmap(play.step)(episode, action)
    return after, step, jax.vmap(play.truth)(after)


def _put(whole: Any, part: Any, rows: Any) -> Any:
    """Return a tree with some of its rows replaced; those beyond its length are dropped."""
    return jax.tree.map(lambda all_rows, new: all_rows.at[rows].set(new, mode="drop"), whole, part)


def _score(play: Play, episode: Episode, answer: Any) -> Any:
    return play.task.score(episode.memory, play.world, episode.state, answer)


class _Programs(NamedTuple):
    """The compiled parts, which all batches share; those of another structure or size are compiled when called."""

    begin: Any
    advance: Any
    put: Any
    score: Any


@lru_cache
def _programs(few: bool) -> _Programs:
    """Return the programs for a few vehicles, or for many."""
    options = QUICK_TO_COMPILE if few else None
    return _Programs(
        jax.jit(_begin, compiler_options=options),
        jax.jit(_advance, compiler_options=options, donate_argnums=1),
        jax.jit(_put, donate_argnums=0),
        jax.jit(_score, compiler_options=QUICK_TO_COMPILE),
    )


class Batch:
    """B episodes.

    Args:
        scenario, overrides, precision: see ``Functional.of``.
        size: B.

    Attributes:
        functional: what is played.
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
        few = self.size * len(self.functional.agents) <= FEW_VEHICLES
        self._programs = _programs(few)
        # So many are restarted in one call: a large part of the batch would be wasted on few, a small one take long.
        self.part = max(1, self.size // 16)
        with self._precision():
            self._play = jax.device_put(self.functional.play)
        self.seeds = np.zeros(self.size, np.int64)
        self.numbers = np.zeros(self.size, np.int64)
        self.episode: Episode | None = None
        self.seen: Any = None
        self.truth: dict[str, FloatArray] = {}

    def _precision(self) -> Any:
        return jax.enable_x64(self.dtype == np.float64)

    def reset(self, seeds: FloatArray, rows: FloatArray | None = None) -> None:
        """Start the episodes ``rows`` (all where None) of new seeds, one for each of them.

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
        """Start the next episode of the seeds of ``rows``."""
        self.numbers[rows] += 1
        self._start(rows)

    def _start(self, rows: FloatArray) -> None:
        play = self.functional.play
        with self._precision():
            for first in range(0, len(rows), self.part):
                some = rows[first : first + self.part]
                filled = np.concatenate([some, np.repeat(some[-1:], self.part - len(some))])
                keys = self.functional.keys(self.seeds[filled], self.numbers[filled])
                episode, seen, truth = self._programs.begin(self._play, keys)
                refuse_unplaced(play.world, jax.tree.map(np.asarray, episode.state.placed))
                if self.episode is None:
                    self.episode = _empty(episode, self.size, jnp)
                    self.seen, self.truth = (_empty(part, self.size, np) for part in (seen, truth))
                target = np.concatenate([some, np.full(self.part - len(some), self.size)])
                self.episode = self._programs.put(self.episode, episode, target)
                for whole, part in ((self.seen, seen), (self.truth, truth)):
                    jax.tree.map(lambda old, new, some=some: _set(old, some, new), whole, part)

    def step(self, action: Any, who: str = "action") -> tuple[FloatArray, FloatArray, FloatArray]:
        """Advance all episodes by actions (B, n, A), and return reward (B, n), terminated (B,) and truncated (B,).

        Raises:
            UsageError: nothing has started, or actions of another shape, not finite or outside [-1, 1].
        """
        if self.episode is None:
            raise UsageError("the environment has not started: call reset() first")
        checked = self.checked(action, who)
        with self._precision():
            self.episode, step, truth = self._programs.advance(self._play, self.episode, checked)
            self.seen, self.truth = jax.tree.map(np.array, (step.observation, truth))
            reward, terminated, truncated = jax.tree.map(np.array, (step.reward, step.terminated, step.truncated))
        return reward, terminated, truncated

    def checked(self, action: Any, who: str) -> FloatArray:
        """Return actions (B, n, A) that are fit to be flown."""
        axes, agents = self.functional.play.task.axes, self.functional.agents
        shape = (self.size, len(agents), len(axes))
        try:
            array = np.asarray(action, self.dtype)
        except (TypeError, ValueError):
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
        """Return the score (n,) of what the agents of an episode hand in, (n, ...).

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
            episode = jax.tree.map(lambda leaf: leaf[row], self.episode)
            return np.asarray(self._programs.score(self._play, episode, array))


def _empty(tree: Any, size: int, library: Any) -> Any:
    return jax.tree.map(lambda leaf: library.zeros((size, *leaf.shape[1:]), leaf.dtype), tree)


def _set(old: FloatArray, rows: FloatArray, new: Any) -> None:
    old[rows] = np.asarray(new)[: len(rows)]
