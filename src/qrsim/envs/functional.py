"""Tasks as pure functions of JAX: can be compiled, mapped over seeds and differentiated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.noise import Key
from qrsim.core.tree import cast
from qrsim.envs.arguments import checked_arguments
from qrsim.errors import UsageError
from qrsim.files import Content
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.arguments import check_precision
from qrsim.tasks import Episode, Play, Step
from qrsim.tasks.agents import Axis
from qrsim.tasks.play import EpisodeKeys
from qrsim.tasks.speaking import ACT, SAY
from qrsim.tasks.teams import by_fleet, together
from qrsim.world.state import Range, World


@dataclass(frozen=True)
class Functional:
    """A task of n agents, each of whose actions is A numbers in [-1, 1].

    Where agents are of several fleets, actions and observations are dicts by fleet of what is said here of one.

    Attributes:
        play: the task and its world.
        name: of the scenario.
    """

    play: Play
    name: str

    @staticmethod
    @checked_arguments
    def of(scenario: str | Path | Content, overrides: Iterable[str] = (), precision: str = "float32") -> Functional:
        """Build the environment of a scenario as pure JAX functions.

        Args:
            scenario: as ``qrsim.load`` takes it.
            overrides: assignments such as "world.wind.speed_20ft=7".
            precision: of its numbers, float32 or float64.

        Raises:
            UsageError, ScenarioError: there is no such scenario, it is wrong, or it has no task.
        """
        check_precision(precision)
        loaded = load_scenario(scenario, overrides)
        if not loaded.steps:
            raise UsageError(f"scenario {loaded.name}: it has no task, and nothing to be rewarded for")
        # Of every number one array, so that all scenarios of a structure share a program.
        task, world = cast(loaded.task(precision), np.dtype(precision)), loaded.world(precision)
        return Functional(Play(task, world, loaded.steps), loaded.name)

    @property
    def agents(self) -> tuple[str, ...]:
        """Names of the vehicles that are agents."""
        return self.play.agents

    @property
    def observation_axes(self) -> tuple[Axis, ...] | dict[str, Any]:
        """Description of each value of an observation: name, unit and range; of a dict, by part, those described."""
        return self.play.task.sees(self.play.world)

    def keys(self, seeds: object, numbers: object = 0) -> EpisodeKeys:
        """Return the random keys of episodes, one per seed (B,) and number in its series, as NumPy arrays.

        Args:
            seeds: 0 <= seed < 2**63.
            numbers: which episode of its seed each is, 0 <= number < 2**32.

        Raises:
            UsageError: a seed is none.
        """
        given = np.atleast_1d(np.asarray(seeds))
        if given.dtype.kind not in "iu" or (given.size and (given.min() < 0 or given.max() >= 2**63)):
            raise UsageError(f"seed: {' '.join(repr(seeds).split())} is no array of integers from 0 to 2**63 - 1")
        seeds = given.astype(np.int64)
        return self.play.keys(Key.roots(seeds, np.broadcast_to(np.asarray(numbers, np.int64), seeds.shape)))

    def at_difficulty(self, difficulty: float) -> Functional:
        """Return this environment with random ranges narrowed towards the scenario's values (0: to these alone).

        Args:
            difficulty: 0: every number of ``ranges`` is what the scenario itself says; 1: it is drawn from low to high;
                between them both ends lie between, in proportion.

        Raises:
            UsageError: it is no number from 0 to 1, or the scenario has no ranges.
        """
        part = checked_difficulty(difficulty)
        world = self.play.world
        if not world.ranges:
            raise UsageError(f"{self.name}: it has no ranges, and so no difficulty")
        grown = tuple(_scaled_range(item, _number_at(world, item.paths[0]), part) for item in world.ranges)
        return replace(self, play=replace(self.play, world=replace(world, ranges=grown)))

    def reset(self, seed: object) -> tuple[Episode, Any]:
        """Start an episode; return its state and the observations, (n, O) or a dict of arrays (n, ...).

        Args:
            seed: () or, for one of 64 bits, its low and high words (2,) uint32; or one of ``keys``.

        Raises:
            UsageError: a seed is none.
        """
        if not isinstance(seed, EpisodeKeys):
            whole = jnp.issubdtype(seed.dtype, jnp.integer) if hasattr(seed, "dtype") else type(seed) is int
            if not whole or (isinstance(seed, int) and not 0 <= seed < 2**32):
                raise UsageError(f"seed: {seed!r} is neither an integer from 0 to 2**32 - 1 nor one of keys()")
            words = jnp.asarray(seed, jnp.uint32)
            key = Key.root(words if words.ndim else jnp.stack([words, jnp.uint32(0)]))
            return self.play.reset(self.play.keys(key))
        return self.play.reset(seed)

    def step(self, episode: Episode, action: Array) -> tuple[Episode, Step]:
        """Advance an episode by one action of each agent; return its new state and the step's results.

        Results after the episode's end have no meaning.
        The sensors of an agent that has stopped report nothing, so what it observes then is not what it saw last; the
        other forms of an environment repeat that.

        Args:
            episode: before.
            action: (n, A), of several fleets by fleet (n_f, A_f); with a radio also a dict of ``act``, which is that,
                and ``say`` (n, D), a message of each.

        Raises:
            UsageError: other shapes, or something to say without a radio.
        """
        return self.play.step(episode, self._together(action))

    def _together(self, action: Array) -> Array:
        """Return actions as one array, (n, A) or with radio messages (n, A + D), from that or from a dict of both."""
        sides = self.play.sides
        if len(sides) > 1:
            return self._action_of_fleets(action)
        n, size = len(self.agents), self.play.message
        said = None
        if isinstance(action, dict):
            wrong = [part for part in action if part not in (ACT, SAY)]
            if wrong or ACT not in action:
                raise UsageError(f"action: expected a dict of {ACT} and {SAY}, found {', '.join(map(str, action))}")
            action, said = action[ACT], action.get(SAY)
        for what, array, width in (("action", action, len(self.play.axes)), ("action: say", said, size)):
            if array is not None and jnp.shape(array) != (n, width):
                more = "; there is no world.radio" if what != "action" and not size else ""
                raise UsageError(f"{what}: expected shape ({n}, {width}), found {jnp.shape(array)}{more}")
        return action if said is None else jnp.concatenate([action, jnp.asarray(said, action.dtype)], axis=1)

    def _action_of_fleets(self, action: Any) -> Array:
        """Return actions as one array (n, A), from a dict fleet -> actions."""
        sides, size = self.play.sides, self.play.message
        by_fleet(action, [side.fleet for side in sides], "action")
        acts, said, speak = {}, [], False
        for side in sides:
            given, what = action[side.fleet], f"action of fleet '{side.fleet}'"
            words = jnp.full((len(side.names), size), jnp.nan)
            if isinstance(given, dict):
                if ACT not in given or not set(given) <= {ACT, SAY}:
                    raise UsageError(f"{what}: expected a dict of {ACT} and {SAY}, found {', '.join(map(str, given))}")
                given, told = given[ACT], given.get(SAY)
                if told is not None and (not size or jnp.shape(told) != words.shape):
                    more = "" if size else "; there is no world.radio"
                    raise UsageError(f"{what}: {SAY}: expected shape {words.shape}, found {jnp.shape(told)}{more}")
                speak, words = speak or told is not None, words if told is None else told
            acts[side.fleet] = jnp.asarray(given)
            said.append(jnp.asarray(words))
        flown: Array = together(sides, acts)
        return jnp.concatenate([flown, jnp.concatenate(said).astype(flown.dtype)], axis=1) if speak else flown

    def score(self, episode: Episode, answer: Array) -> Array:
        """Return the scores (n,) of the agents' answers at the end of an episode, (n, L) or (n, L, K).

        Raises:
            UsageError: nothing can be handed in.
        """
        if not self.play.task.hands_in:
            raise UsageError(f"{self.name}: nothing is handed in in this task")
        score: Array = self.play.task.score(episode.memory, self.play.world, episode.state, answer)
        return score

    def truth(self, episode: Episode) -> dict[str, Array]:
        """Return the true values of the agents, name -> (n, ...), which they do not observe."""
        return self.play.truth(episode)


def checked_difficulty(given: Any) -> float:
    """Return a difficulty as float; raise UsageError unless it is a number from 0 to 1.

    Raises:
        UsageError: it is no number from 0 to 1.
    """
    number = isinstance(given, int | float | np.integer | np.floating) and not isinstance(given, bool)
    if not number or not 0.0 <= given <= 1.0:
        raise UsageError(f"difficulty: {given!r}; allowed: a number from 0 to 1")
    return float(given)


def _number_at(world: World, path: tuple[str | int, ...]) -> object:
    """Return the number at a path of attributes and indices in a world; of several vehicles, the first one's."""
    found: Any = world
    for part in path:
        found = found[part] if isinstance(part, int) else getattr(found, part)
    return np.ravel(np.asarray(found))[0]


def _scaled_range(item: Range, own: Any, part: float) -> Range:
    """Return a random range shrunk towards the scenario's value ``own``; ``part``: share that remains, 0 to 1."""

    def between(end: Array) -> Any:
        """Return the value between the scenario's own and one end of the range."""
        return np.asarray((1.0 - part) * own + part * np.asarray(end), np.asarray(end).dtype)

    return replace(item, low=between(item.low), high=between(item.high))
