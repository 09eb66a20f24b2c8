"""What a flight scores in its task, whoever flies it: the task's own rewards over the states of all ticks."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from qrsim.core.arrays import Floats
from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.engine.settings import quick_jit
from qrsim.errors import UsageError
from qrsim.tasks.episodes import score
from qrsim.tasks.places import Places, places_of
from qrsim.tasks.play import Episode, Judged, Play
from qrsim.world.state import State

# Ticks that are judged at once.
CHUNK = 50
FLOWN, CRASHED, UNFINISHED, SPOILT = "flown_to_the_end", "crashed", "unfinished", "not_finite"


class Ticks(Protocol):
    """States of consecutive ticks, as ``Simulation.record`` returns them: ``ticks`` (T,), leaves (T, ...)."""

    ticks: Floats

    @property
    def state(self) -> Any:
        """States of the world after these ticks, leaves (T, ...)."""


@dataclass(frozen=True)
class TaskScore:
    """What a flight scored.

    Attributes:
        returns: return of each agent, by its name; of an unfinished flight so far; None where it is not finite.
        outcome: "flown_to_the_end"; "crashed": a vehicle stopped, which ended the episode (where agents leave, the last
            one); "unfinished"; "not_finite": a reward was NaN or infinite.
        steps: steps judged.
        of: steps of an episode.
        handed_in: whether the policy handed something in; where it did not, zeros were scored. None without answers.
        fleets: names of the agents by fleet, where those of several are agents; else nothing.
    """

    returns: dict[str, float | None]
    outcome: str
    steps: int
    of: int
    handed_in: bool | None = None
    fleets: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def mean(self) -> float | None:
        """Mean return of the agents (of several fleets, of the first one's); None if it is not finite."""
        return self._mean_return(next(iter(self.fleets.values()), tuple(self.returns)))

    def _mean_return(self, agents: tuple[str, ...]) -> float | None:
        """Return the mean return of these agents, None if it is unknown for one of them."""
        known = [self.returns[agent] for agent in agents]
        finite = [value for value in known if value is not None]
        return float(np.mean(finite)) if finite and len(finite) == len(known) else None

    def to_json(self) -> dict[str, object]:
        """Return the score's fields for JSON; with several fleets, also each one's mean return."""
        several = (
            {"fleets": {name: self._mean_return(agents) for name, agents in self.fleets.items()}} if self.fleets else {}
        )
        return {
            "return": self.mean,
            **several,
            "agents": dict(self.returns),
            "outcome": self.outcome,
            "steps": self.steps,
            "of_steps": self.of,
            "handed_in": self.handed_in,
        }


class Referee:
    """Judges a flight tick by tick.

    The world of a seed is that of the first episode which environments and ``qrsim score`` start with this seed.

    Args:
        play: the task in its world.
        seed, number: of the episode.
        beginning: its state at the start, of one tick.
    """

    def __init__(self, play: Play, seed: int, number: int, beginning: Ticks):
        self._dtype = np.asarray(play.world.fleets[0].start.position_ned.x).dtype
        self._play = jax.tree.map(np.asarray, cast(play, self._dtype))
        self._names, self._steps = play.agents, play.steps
        self._rewards: list[Floats] = []
        self._waiting: list[tuple[Floats, State]] = []
        self._over = ""
        self._last = jax.tree.map(lambda leaf: np.array(leaf[0]), beginning.state)
        with self._precision_context():
            # The task's memory, and who has left.
            self._carried = _begin_function()(self._play, Key.root(seed, number), self._last)
            self._places = places_of(self._play.task, self._play.world, self._carried[0], self._last.contents)
            # Compiled now, so that it does not count as flying.
            still = jax.tree.map(lambda leaf: np.repeat(leaf[None], CHUNK, axis=0), self._last)
            _watch_function()(self._play, self._carried, still, np.int32(1), np.int32(0))

    def _precision_context(self) -> AbstractContextManager[object]:
        """Return a context in which JAX uses the precision (32 or 64 bits) of the world."""
        return jax.enable_x64(self._dtype == np.float64)

    @property
    def places(self) -> Places:
        """Goals and other places of the task, for display."""
        return self._places

    @property
    def asks(self) -> bool:
        """Whether the task requires an answer from its agents at the end."""
        return self._play.task.hands_in

    def watch(self, history: Ticks) -> None:
        """Take the states after the next ticks, to judge in chunks; the first call begins with the first tick."""
        if len(history.ticks) == CHUNK:
            # As a flight without a policy of its own comes: nothing is copied.
            self._judge_all()
            if not self._over:
                self._judge(np.asarray(history.ticks), history.state, CHUNK)
        elif not self._over:
            self._waiting.append((np.asarray(history.ticks), jax.tree.map(np.array, history.state)))
            if sum(len(ticks) for ticks, _ in self._waiting) >= CHUNK:
                self._judge_all()

    def _judge_all(self) -> None:
        """Judge all states that wait, in chunks of the same size."""
        if not self._waiting or self._over:
            return
        ticks = np.concatenate([ticks for ticks, _ in self._waiting])
        states = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(states for _, states in self._waiting))
        self._waiting = []
        for first in range(0, len(ticks), CHUNK):
            # Of one length always, so that there is one program.
            count = min(CHUNK, len(ticks) - first)
            rows = first + np.minimum(np.arange(CHUNK), count - 1)
            self._judge(ticks[rows], jax.tree.map(lambda leaf, rows=rows: leaf[rows], states), count)
            if self._over:
                return

    def _judge(self, ticks: Floats, states: object, count: int) -> None:
        """Compute the rewards of the first ``count`` of CHUNK states, and add those at the ends of steps."""
        with self._precision_context():
            self._carried, rewards, flies = jax.tree.map(
                np.asarray, _watch_function()(self._play, self._carried, states, np.int32(ticks[0]), np.int32(count))
            )
        for place in np.flatnonzero(ticks[:count] % self._play.ticks == 0):
            self._add_reward(rewards[place], bool(flies[place]))
            if self._over:
                self._last = jax.tree.map(lambda leaf, place=place: np.array(leaf[place]), states)
                return

    def _add_reward(self, reward: Floats, flies: bool) -> None:
        """Add the rewards (n,) of a step, and note whether the episode is over; ``flies``: whether it goes on."""
        self._rewards.append(reward.astype(np.float64))
        if not np.isfinite(reward).all():
            self._over = SPOILT
        elif not flies:
            self._over = CRASHED
        elif len(self._rewards) == self._steps:
            self._over = FLOWN

    def finish(self, answer: object = None) -> TaskScore:
        """Return the score of the flight, up to its last whole step.

        Args:
            answer: what the agents hand in, (n, ...), in a task that asks for it; None: zeros.

        Raises:
            UsageError: an answer of another shape.
        """
        self._judge_all()
        total = np.sum(self._rewards, axis=0) if self._rewards else np.zeros(len(self._names))
        asked, outcome = self.asks, self._over or UNFINISHED
        if asked and outcome == FLOWN:
            shape = (len(self._names), *self._play.task.answer_shape(self._play.world))
            given = np.zeros(shape, self._dtype) if answer is None else np.asarray(answer, self._dtype)
            if given.shape != shape:
                raise UsageError(f"answer: expected shape {shape} (agents, ...), found {given.shape}")
            with self._precision_context():
                step: Any = np.int32(self._steps)
                episode = Episode(self._last, self._carried[0], step, self._carried[1])
                total = total + score(self._play, episode, given)
            outcome = outcome if np.isfinite(total).all() else SPOILT
        returns = {
            name: float(value) if np.isfinite(value) else None for name, value in zip(self._names, total, strict=True)
        }
        handed_in = answer is not None if asked else None
        sides = self._play.sides
        fleets = {side.fleet: side.names for side in sides} if len(sides) > 1 else {}
        return TaskScore(returns, outcome, len(self._rewards), self._steps, handed_in, fleets)


@lru_cache
def _begin_function() -> Callable[..., tuple[object, Array | None]]:
    """Return the jitted function that starts the judging of an episode."""

    def begin(play: Play, key: Key, state: State) -> tuple[object, Array | None]:
        """Return the task's memory at the start of an episode, and flags of agents that have left."""
        return play.begun(play.keys(key), state), play.nobody_gone()

    return quick_jit(begin)


@lru_cache
def _watch_function() -> Callable[..., tuple[tuple[object, Array | None], Array, Array]]:
    """Return the jitted function that judges a chunk of states."""
    return quick_jit(_watch)


def _watch(play: Play, carried: object, states: object, first: Array, count: Array) -> tuple[Any, Array, Array]:
    """Judge ``count`` ticks from ``first``; return (memory, agents gone) after them, rewards (T, n), goes on (T,).

    What is returned of ticks that end no step has no meaning.
    """

    def tick(before: Any, item: tuple[Any, Array]) -> tuple[Any, tuple[Array, Array]]:
        """Judge one tick (``item``: state, row); return (memory, agents gone) after it, reward, whether it goes on."""
        state, place = item
        number = first + place
        memory = play.task.each_tick(before[0], play.world, state)
        episode = Episode(state, memory, number // play.ticks - 1, before[1])

        def judged() -> Judged:
            """Return the reward of a tick that ends a step."""
            return play.rewarded(episode)

        def going() -> Judged:
            """Return a reward of zeros for a tick that does not end a step."""
            empty = jax.eval_shape(judged).reward
            return Judged(memory, jnp.zeros(empty.shape, empty.dtype), jnp.ones((), bool), before[1])

        found = lax.cond(number % play.ticks == 0, judged, going)
        after = (found.memory, found.gone)
        after = jax.tree.map(lambda new, old: jnp.where(place < count, new, old), after, before)
        return after, (found.reward, found.goes_on)

    places = jnp.arange(CHUNK, dtype=jnp.int32)
    carried, (rewards, flies) = lax.scan(tick, carried, (states, places))
    return carried, rewards, flies
