"""Many episodes of a task side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import DType, NumpyArray
from qrsim.core.noise import Key
from qrsim.core.tree import replace
from qrsim.engine.backend import Extent, Function, Worlds
from qrsim.engine.settings import quick_jit
from qrsim.tasks.play import Episode, Play, Progress, Step


class Begun(NamedTuple):
    """Episodes at their start, arrays (b, ...)."""

    placed: Any
    seen: object
    truth: dict[str, NumpyArray]


@lru_cache
def _score_function() -> Callable[..., jax.Array]:
    """Return the jitted function that scores the agents' answers at the end of an episode."""

    def score(play: Play, episode: Episode, answer: jax.Array) -> jax.Array:
        """Return the score (n,) of the agents' answers; 0 for vehicles that have stopped."""
        found = play.task.score(episode.memory, play.world, episode.state, answer)
        return found if episode.gone is None else jnp.where(episode.gone, 0.0, found)

    return quick_jit(score)


def score(play: Play, episode: Episode, answer: NumpyArray) -> NumpyArray:
    """Return the score (n,) of the agents' answers (n, ...) at the end of an episode; 0 for agents that have left."""
    return np.asarray(_score_function()(play, episode, answer))


def _start_progress(play: Play, own: tuple[Any, Any]) -> Progress:
    """Return the state of an episode at its start; ``own``: (constants, random keys) of the episode."""
    return play.progress(own[1])


def _tick_progress(play: Play, own: tuple[Any, Any], progress: Progress, number: Any) -> Progress:
    """Return the state of an episode after tick ``number`` of a step; ``own``: (constants, action)."""
    return play.tick(own[1], progress, number)


def _look(play: Play, progress: Progress, to: dict[str, jax.Array], tick: Any) -> dict[str, jax.Array]:
    """Return the large parts of an observation, such as pictures; ``to``: zeros of their names and shapes."""
    return play.look(progress, to)


def _merged(seen: Any, late: dict[str, NumpyArray]) -> dict[str, Any]:
    """Join an observation with its parts that were computed on demand, sorted by name as JAX does."""
    return dict(sorted({**seen, **late}.items()))


def _begun_of(progress: Progress) -> Begun:
    """Return an episode's start: whether all vehicles could be placed, the observations and the true values."""
    return Begun(progress.episode.state.placed, progress.last.observation, progress.truth)


def _results_of(progress: Progress) -> tuple[Step, dict[str, NumpyArray]]:
    """Return the results of an episode's last step, and the true values after it."""
    return progress.last, progress.truth


class Episodes:
    """B episodes of a task.

    They can be pickled and deep-copied at any time, and a copy has the same future.

    Args:
        play: what is played.
        size: B.
        dtype: of all numbers.
    """

    def __init__(self, play: Play, size: int, dtype: DType):
        self._play = jax.tree.map(np.asarray, play)
        self._size, self._dtype = size, dtype
        keys = play.keys(Key.roots(np.zeros(1, np.int64), np.zeros(1, np.int64)))
        # Large parts of observations have a program of their own; XLA computes all at once.
        late = bool(play.task.later(play.world))
        self._worlds = self._made(replace(self._play, late=late), keys)
        if late and not self._worlds.looks:
            self._worlds = self._made(self._play, keys)

    def _made(self, play: Play, keys: Any) -> Worlds:
        """Compile the programs of B episodes of a task; ``keys``: those of one episode, for their structure."""
        extent = Extent(sum(fleet.size for fleet in play.world.fleets), self._dtype, self._size)
        task = type(play.task)
        # Of a user's task another process could not tell whether it is still the same.
        text = () if task.__module__.startswith("qrsim.") else None
        start = Function("start of an episode", _start_progress, (task,), text)
        step = Function("step of an episode", _tick_progress, (task,), text)
        look, looked = None, {}
        if play.late:
            look = Function("look of an episode", _look, (task,), text)
            shapes = play.task.later(play.world)
            looked = {name: jax.ShapeDtypeStruct(shape, self._dtype) for name, shape in shapes.items()}
        worlds = Worlds(start, step, play, extent, look=look, looked=looked)
        worlds.prepare(keys, np.zeros((1, len(play.agents), play.width + play.message), self._dtype))
        return worlds

    def __getstate__(self) -> dict[str, object]:
        # Programs are in memory of this process, and are loaded or made again in another.
        state = self._all(lambda progress: progress) if self.started else None
        return {"play": self._play, "size": self._size, "dtype": self._dtype, "state": state}

    def __setstate__(self, kept: Mapping[str, object]) -> None:
        with jax.enable_x64(kept["dtype"] == np.float64):
            self.__init__(kept["play"], kept["size"], kept["dtype"])  # type: ignore[misc]
            if kept["state"] is not None:
                self._worlds.restore(kept["state"])

    def _all(self, select: Any) -> Any:
        """Return a copy of the part of all episodes' states that ``select`` picks, leaves (B, ...)."""
        found = self._worlds.get(select)
        # What LLVM's states return is a copy already.
        return found if self.compiler == "llvm" else jax.tree.map(np.array, found)

    @property
    def compiler(self) -> str:
        """Name of the compiler of the episodes' programs, "llvm" or "xla"."""
        return self._worlds.compiler

    @property
    def started(self) -> bool:
        """Whether any episode has started."""
        return self._worlds.started

    def draw_from(self, play: Play) -> None:
        """Make episodes that start from now on use another ``Play`` that differs only in its random ranges."""
        self._play = jax.tree.map(np.asarray, play)
        self._worlds.share_at_starts(replace(self._play, late=self._worlds.looks))

    def start(self, rows: NumpyArray, keys: object) -> Begun:
        """Start the episodes ``rows`` (b,) from their random keys, leaves (b, ...); return their first observations."""
        found: Begun = self._worlds.begin_some(rows, keys, _begun_of)
        if self._worlds.looks:
            found = found._replace(seen=_merged(found.seen, self.look(rows)))
        return found

    @property
    def late(self) -> tuple[str, ...]:
        """Names of the large parts of an observation, such as pictures, that ``look`` computes; () for none."""
        return tuple(self._play.task.later(self._play.world)) if self._worlds.looks else ()

    def look(self, rows: NumpyArray | None = None) -> dict[str, NumpyArray]:
        """Compute the parts of observations named in ``late`` (b, n, ...), of all episodes or those in ``rows``.

        Agents that have stopped see what they saw last. The caller owns the arrays.
        """
        found: dict[str, NumpyArray] = self._worlds.look(rows)
        return found

    def step(self, action: NumpyArray) -> tuple[Step, dict[str, NumpyArray]]:
        """Advance all episodes by one step; ``action`` (B, n, A), with radio (B, n, A + D). Return step, truth."""
        self._worlds.advance(0, self._play.ticks, action)
        found: tuple[Step, dict[str, NumpyArray]] = self._all(_results_of)
        if not self._worlds.looks:
            return found
        (step, truth), late = found, self.look()
        stopped = truth["reason"] != 0
        for part in late.values() if stopped.any() else ():
            part[stopped] = 0
        return replace(step, observation=_merged(step.observation, late)), truth

    def episode(self, row: int) -> Episode:
        """Return the state of the episode in this row of the batch."""
        found: Episode = jax.tree.map(lambda leaf: leaf[row], self._worlds.get(lambda progress: progress.episode))
        return found
