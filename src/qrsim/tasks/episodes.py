"""Many episodes of a task, computed by this package's own machine code, or by XLA where that cannot be had."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.noise import Key
from qrsim.engine.cache import identity
from qrsim.engine.layout import Packer, struct
from qrsim.engine.llvm import (
    Input,
    Lanes,
    Program,
    Start,
    Together,
    UnsupportedError,
    build,
    build_start,
    layout_of,
    trace_of,
)
from qrsim.engine.programs import once
from qrsim.engine.settings import FEW_VEHICLES, quick_jit, quick_to_compile, threads, uses_llvm
from qrsim.simulation.one_world import mode_of_many
from qrsim.tasks.play import Episode, Play, Progress, Step

Array = np.ndarray[Any, Any]


class Begun(NamedTuple):
    """What is known of episodes at their start, arrays (b, ...)."""

    placed: Any
    seen: Any
    truth: dict[str, Array]


def episodes(play: Play, size: int, dtype: np.dtype[Any]) -> NativeEpisodes | XlaEpisodes:
    """Return what computes ``size`` episodes on this machine."""
    if uses_llvm():
        try:
            return NativeEpisodes(play, size, dtype)
        except UnsupportedError:
            pass
    return XlaEpisodes(play, size)


@lru_cache
def _scored() -> Any:
    def score(play: Play, episode: Episode, answer: Any) -> Any:
        return play.task.score(episode.memory, play.world, episode.state, answer)

    return quick_jit(score)


def score(play: Play, episode: Episode, answer: Array) -> Array:
    """Return the score (n,) of what the agents of an episode hand in, (n, ...)."""
    return np.asarray(_scored()(play, episode, answer))


class NativeEpisodes:
    """B episodes, a few side by side in the lanes of vectors.

    Args:
        play: what is played, its numbers on the host.
        size: B.
        dtype: of all numbers.

    Raises:
        UnsupportedError: XLA has to compute it.
    """

    def __init__(self, play: Play, size: int, dtype: np.dtype[Any]):
        self._play = jax.tree.map(np.asarray, play)
        self._size = size
        self._mode = mode_of_many(size, sum(fleet.size for fleet in play.world.fleets), dtype)
        self._fixed = Packer(self._play)
        self._shared = self._fixed.pack(self._play)
        self._actions = Packer(struct((len(play.agents), len(play.task.axes)), dtype))
        layout, self._first = self._start_program()
        self._state = Lanes(layout, size, self._mode)
        own = Lanes(self._actions, size, self._mode)
        self._together = Together(self._tick_program(), self._shared, own, self._state, threads())
        self.started = False

    def __getstate__(self) -> dict[str, Any]:
        # Programs are in memory of this process, and are loaded or made again in another.
        state = self._state.get(lambda progress: progress) if self.started else None
        return {"play": self._play, "size": self._size, "dtype": self._fixed.dtype, "state": state}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        with jax.enable_x64(kept["dtype"] == np.float64):
            self.__init__(kept["play"], kept["size"], kept["dtype"])  # type: ignore[misc]
        if kept["state"] is not None:
            self._state.put(np.arange(self._size), kept["state"])
            self.started = True

    def start(self, rows: Array, keys: Any) -> Begun:
        """Start the episodes ``rows`` (b,) by their keys, each leaf (b, ...)."""
        own = Lanes(self._first.inputs[1].layout, len(rows), self._mode)
        own.fill(keys)
        state = Lanes(self._state.layout, len(rows), self._mode)
        Together(self._first, self._shared, own, state, threads()).advance(0, 1)
        progress: Progress = state.get(lambda progress: progress)
        self._state.put(rows, progress)
        self.started = True
        seen, truth = progress.last.observation, progress.truth
        return Begun(progress.episode.state.placed, seen, truth)

    def step(self, action: Array) -> tuple[Step, dict[str, Array]]:
        """Advance all episodes by actions (B, n, A), and return what that brings and what is really the case."""
        self._together.own.fill(action)
        self._together.advance(0, self._play.ticks)
        found: tuple[Step, dict[str, Array]] = self._state.get(lambda progress: (progress.last, progress.truth))
        return found

    def episode(self, row: int) -> Episode:
        """Return one of the episodes."""
        found: Episode = jax.tree.map(lambda leaf: leaf[row], self._state.get(lambda progress: progress.episode))
        return found

    def _once(self, what: str, layouts: tuple[Packer, ...], make: Any, load: Any) -> Any:
        task, mode = type(self._play.task), self._mode
        # Of a user's task another process could not tell whether it is still the same.
        text = (what, *map(identity, layouts), mode) if task.__module__.startswith("qrsim.") else None
        return once((what, task, layouts, mode), text, make, load)

    def _tick_program(self) -> Program:
        layouts = (self._fixed, self._actions, self._state.layout)
        inputs = tuple(Input(layout, own=i > 0) for i, layout in enumerate(layouts))
        found: Program = self._once(
            "step of an episode",
            layouts,
            lambda: build(_tick, inputs, self._mode),
            lambda binary: Program(binary, inputs, self._mode),
        )
        return found

    def _start_program(self) -> tuple[Packer, Program]:
        keys = layout_of(self._play.keys(Key.roots(np.zeros(1, np.int64), np.zeros(1, np.int64))))
        inputs = (Input(self._fixed, own=False), Input(keys, own=True))

        def load(start: Start) -> tuple[Packer, Program]:
            layout = start.layout
            return layout, Program(start.binary, (*inputs, Input(layout, own=True)), self._mode)

        found: tuple[Packer, Program] = self._once(
            "start of an episode",
            (self._fixed, keys),
            lambda: build_start(trace_of(_progress, inputs), inputs, self._mode),
            load,
        )
        return found


def _progress(play: Play, keys: Any) -> Progress:
    return play.progress(keys)


def _tick(play: Play, action: Any, progress: Progress, number: Any) -> Progress:
    return play.tick(action, progress, number)


def _parts(count: int, part: int) -> Iterator[tuple[Array, Array]]:
    """Give the numbers of parts of equal size, the real ones and, behind the end, the last one again."""
    for first in range(0, count, part):
        filled = np.minimum(np.arange(first, first + part), count - 1)
        yield filled[: count - first], filled


def _rows(tree: Any, rows: Array) -> Any:
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def _first(tree: Any, count: int) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], tree)


def _begin(play: Play, keys: Any) -> Any:
    episode, seen = jax.vmap(play.reset)(keys)
    return episode, seen, jax.vmap(play.truth)(episode)


def _advance(play: Play, episode: Episode, action: Any) -> Any:
    after, step = jax.vmap(play.step)(episode, action)
    return after, step, jax.vmap(play.truth)(after)


def _put(whole: Any, part: Any, rows: Any) -> Any:
    """Return a tree with some of its rows replaced; those beyond its length are dropped."""
    return jax.tree.map(lambda all_rows, new: all_rows.at[rows].set(new, mode="drop"), whole, part)


class _Programs(NamedTuple):
    """The compiled parts, which all batches share; those of another structure or size are compiled when called."""

    begin: Any
    advance: Any
    put: Any


@lru_cache
def _programs(few: bool) -> _Programs:
    """Return the programs for a few vehicles, or for many."""
    options = quick_to_compile() if few else None
    return _Programs(
        jax.jit(_begin, compiler_options=options),
        jax.jit(_advance, compiler_options=options, donate_argnums=1),
        jax.jit(_put, donate_argnums=0),
    )


class XlaEpisodes:
    """B episodes, computed by XLA; the methods are those of ``NativeEpisodes``.

    Args:
        play: what is played.
        size: B.
    """

    def __init__(self, play: Play, size: int):
        self._play, self._size = jax.device_put(play), size
        self._programs = _programs(size * len(play.agents) <= FEW_VEHICLES)
        # So many are started in one call: a large part of the batch would be wasted on few, a small one take long.
        self._part = max(1, size // 16)
        self._episodes: Any = None

    def __getstate__(self) -> dict[str, Any]:
        play, state = jax.device_get((self._play, self._episodes))
        return {"play": play, "size": self._size, "state": state}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        with jax.enable_x64(any(leaf.dtype == np.float64 for leaf in jax.tree.leaves(kept["play"]))):
            self.__init__(kept["play"], kept["size"])  # type: ignore[misc]
            if kept["state"] is not None:
                self._episodes = jax.device_put(kept["state"])

    @property
    def started(self) -> bool:
        """Whether any episode has."""
        return self._episodes is not None

    def start(self, rows: Array, keys: Any) -> Begun:
        """Start the episodes ``rows`` (b,) by their keys, each leaf (b, ...)."""
        parts = []
        for some, filled in _parts(len(rows), self._part):
            episode, seen, truth = self._programs.begin(self._play, _rows(keys, filled))
            if self._episodes is None:
                self._episodes = jax.tree.map(
                    lambda leaf: jnp.zeros((self._size, *leaf.shape[1:]), leaf.dtype), episode
                )
            target = np.concatenate([rows[some], np.full(self._part - len(some), self._size)])
            parts.append(_first(Begun(episode.state.placed, seen, truth), len(some)))
            self._episodes = self._programs.put(self._episodes, episode, target)
        found: Begun = jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
        return found

    def step(self, action: Array) -> tuple[Step, dict[str, Array]]:
        """Advance all episodes by actions (B, n, A), and return what that brings and what is really the case."""
        self._episodes, step, truth = self._programs.advance(self._play, self._episodes, action)
        found: tuple[Step, dict[str, Array]] = jax.tree.map(np.array, (step, truth))
        return found

    def episode(self, row: int) -> Episode:
        """Return one of the episodes."""
        found: Episode = jax.tree.map(lambda leaf: leaf[row], self._episodes)
        return found
