"""Many episodes of a task at once: compiled, each restarted where it ends."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import jax
import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.engine.settings import use_compilation_cache
from qrsim.envs.functional import Functional
from qrsim.envs.keys_ahead import KeysAhead
from qrsim.errors import RunError, UsageError, did_you_mean, shortened
from qrsim.files import Content
from qrsim.tasks.agents import Axis
from qrsim.tasks.episodes import Episodes, score
from qrsim.tasks.teams import Side, axes_of_agents, part_of
from qrsim.world.episode import refuse_unplaced

# What a reset may be told; the mask is of batches alone.
OPTIONS = ("difficulty", "reset_mask")
# PettingZoo's own test of environments gives an option of this name.
IGNORED = "options"
# An action may be outside [-1, 1] by no more than rounding.
ROUNDING = 1e-5
LARGEST_SEED = 2**63
# Numbers of a vehicle in the state of an episode.
STATE = 13


def checked_seed(seed: Any) -> int:
    """Return a seed as int; raise UsageError unless it is an integer from 0 to 2**63 - 1.

    Raises:
        UsageError: it is no integer from 0 to 2**63 - 1.
    """
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not (whole and 0 <= int(seed) < LARGEST_SEED):
        raise UsageError(f"seed: {int(seed) if whole else one_line(seed)} is not an integer from 0 to 2**63 - 1")
    return int(seed)


def numbers(given: object, what: str, shape: tuple[int, ...]) -> Floats:
    """Convert numbers to an array of any shape; raise UsageError, which names ``what`` and ``shape``, for others.

    Raises:
        UsageError: it has rows of different lengths, or something else in it, such as text or complex numbers.
    """
    try:
        array = np.asarray(given)
    except (TypeError, ValueError):
        array = np.zeros((), str)
    if array.dtype.kind not in "biufO" or isinstance(given, dict) or given is None:
        raise UsageError(f"{what}: expected numbers of shape {shape}, found {one_line(given)}")
    return array


def one_line(value: object) -> str:
    """Return the repr of a value as one short line of text for an error message."""
    return shortened(" ".join(repr(value).split()), 80)


class Batch:
    """B episodes.

    Args:
        scenario, overrides, precision: see ``Functional.of``.
        size: B.

    Attributes:
        functional: what is played.
        agents: names of the n agents.
        sides: the agents by fleet.
        axes: the numbers of an action of each agent (n,).
        width: how many numbers an action has in an array of all agents (A), the largest number of axes.
        episodes: what computes them.
        seen: what the agents see now, arrays (B, n, ...); of several fleets by fleet. Agents that have stopped see what
            they saw last.
        truth: what is really the case, by name, (B, n, ...).
        gone: after a step (B, n) which agents have stopped, where these leave (``task.leave``); else None.
    """

    def __init__(
        self,
        scenario: str | Path | Content,
        size: int,
        overrides: Iterable[str] = (),
        precision: str = "float32",
    ):
        if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
            raise UsageError(f"num_envs: {size!r} is not a positive whole number")
        use_compilation_cache()
        self.functional = self._full = Functional.of(scenario, overrides, precision)
        # Kept, because to find them takes a quarter of a step of many episodes.
        self.agents = self.functional.agents
        self.sides: tuple[Side, ...] = self.functional.play.sides
        self.axes: tuple[tuple[Axis, ...], ...] = axes_of_agents(self.sides)
        self.width, self.size = self.functional.play.width, int(size)
        self.dtype = np.dtype(precision)
        with self._precision_context():
            self.episodes = Episodes(self.functional.play, self.size, self.dtype)
        self.seeds = np.zeros(self.size, np.int64)
        self.numbers = np.zeros(self.size, np.int64)
        self._ahead = KeysAhead(self.size)
        # Steps done of each episode, and whether it has ended: what comes after has no meaning.
        self._steps, self._ended = np.zeros(self.size, np.int64), np.zeros(self.size, bool)
        self._answers: Floats | None = None
        self.seen: Any = None
        # Whether parts of ``seen`` belong to the user, who may change them.
        self._given_away = False
        self.gone: Floats | None = None
        self.truth: dict[str, Floats] = {}

    def _precision_context(self) -> AbstractContextManager[object]:
        """Return a context in which JAX uses the precision (32 or 64 bits) of the batch."""
        wide = self.dtype == np.float64
        # To enter JAX's context takes as long as to look at all actions.
        same: bool = jax.config.jax_enable_x64 == wide  # type: ignore[attr-defined]
        return nullcontext() if same else jax.enable_x64(wide)

    def reset(self, seeds: Iterable[object], rows: Floats | None = None) -> None:
        """Reset the episodes ``rows`` (None: all) with new seeds, one each.

        Raises:
            UsageError: a seed is no integer from 0 to 2**63 - 1.
            RunError: a fleet found no place.
        """
        given = [checked_seed(seed) for seed in seeds]
        which = np.arange(self.size) if rows is None else np.asarray(rows)
        self.seeds[which], self.numbers[which] = np.array(given, np.int64), 0
        self._start_episodes(which)

    def again(self, rows: Floats) -> None:
        """Start the next episode of the seed's series in each of the environments ``rows``."""
        self.numbers[rows] += 1
        self._start_episodes(rows)

    def set_difficulty(self, difficulty: float) -> None:
        """Set the difficulty, 0 to 1, of episodes that start from now on; see ``Functional.at_difficulty``.

        Raises:
            UsageError: as of that.
        """
        with self._precision_context():
            self.functional = self._full.at_difficulty(difficulty)
            self.episodes.draw_from(self.functional.play)
        self._ahead.clear()

    def take_options(self, options: dict[str, Any] | None) -> None:
        """Set the difficulty if the options of a reset name one; raise UsageError for unknown options.

        Raises:
            UsageError: another option, or no difficulty.
        """
        for name in options or {}:
            if name not in (*OPTIONS, IGNORED):
                raise UsageError(f"reset: options has no '{name}'{did_you_mean(str(name), OPTIONS)}")
        if options and "difficulty" in options:
            self.set_difficulty(options["difficulty"])

    def _start_episodes(self, rows: Floats) -> None:
        """Start the episodes ``rows``, each given by a seed and a number in the seed's series."""
        if self._answers is not None:
            self._answers[rows] = 0.0
        self._steps[rows], self._ended[rows] = 0, False
        with self._precision_context():
            keys = self._ahead.keys(self.functional, rows, self.seeds, self.numbers)
            begun = self.episodes.start(rows, keys)
        refuse_unplaced(self.functional.play.world, begun.placed)
        if self.seen is None:
            self.seen, self.truth = (_zeros_like(part, self.size) for part in (begun.seen, begun.truth))
        if self._given_away:
            self.seen, self._given_away = self.seen | self.episodes.look(), False
        kept, new = (jax.tree.leaves(each) for each in ((self.seen, self.truth), (begun.seen, begun.truth)))
        for old, part in zip(kept, new, strict=True):
            old[rows] = part

    def give_away(self) -> object:
        """Return all agents' observations (B, n, ...) as arrays that the caller may change.

        Parts that are computed late are handed over, the others copied.
        """
        self._given_away = bool(self.episodes.late)
        if not self._given_away:
            return jax.tree.map(np.copy, self.seen)
        late = self.episodes.late
        return {name: part if name in late else part.copy() for name, part in self.seen.items()}

    def step(self, action: object, words: object = None, who: str = "action") -> tuple[Floats, Floats, Floats]:
        """Advance all episodes by actions (B, n, A); return reward (B, n), terminated (B,) and truncated (B,).

        Args:
            action: of each agent.
            words: (B, n, D) what they say over the radio, NaN for who says nothing; None: nobody does.
            who: what messages call the actions.

        Raises:
            UsageError: nothing has started, or actions of another shape, not finite or outside [-1, 1].
            RunError: the task's reward is NaN or infinite.
        """
        if not self.episodes.started:
            raise UsageError("the environment has not started: call reset() first")
        checked = self.checked(action, who)
        if self.functional.play.message:
            said = np.full((*checked.shape[:2], self.functional.play.message), np.nan) if words is None else words
            checked = np.concatenate([checked, np.asarray(said, self.dtype)], axis=2)
        with self._precision_context():
            step, self.truth = self.episodes.step(checked)
        before, self.seen, self.gone = self.seen, step.observation, step.gone
        self._given_away = False
        self._keep_last_seen(before)
        self._steps += 1
        reward, terminated, truncated = (np.asarray(each) for each in (step.reward, step.terminated, step.truncated))
        if not np.isfinite(reward).all():
            self._refuse_reward(reward)
        self._ended |= terminated | truncated
        return reward, terminated, truncated

    def _keep_last_seen(self, before: Any) -> None:
        """Replace the observations of stopped agents by their last ones in flight, from ``before``."""
        stopped = self.truth["reason"] != 0
        if not stopped.any():
            return
        late = self.episodes.late
        if late:
            rows = np.flatnonzero(stopped.any(axis=1))
            for name, part in self.episodes.look(rows).items():
                self.seen[name][rows] = part
        for side in self.sides:
            which = np.nonzero(stopped[:, side.rows])
            last, now = (seen if len(self.sides) == 1 else seen[side.fleet] for seen in (before, self.seen))
            if late:
                last, now = ({name: part for name, part in seen.items() if name not in late} for seen in (last, now))
            jax.tree.map(lambda new, old, which=which: _set_rows(new, which, old[which]), now, last)

    def _refuse_reward(self, reward: Floats) -> None:
        """Raise RunError for rewards (B, n) that are not finite in an episode that has not ended."""
        for row, agent in np.argwhere(~np.isfinite(reward) & ~self._ended[:, None]):
            raise RunError(f"{self._place(row, agent)}: the reward is {reward[row, agent]:g}")

    def _place(self, row: int, agent: int) -> str:
        """Return in words which agent, episode and step a wrong reward of a task belongs to."""
        task = type(self.functional.play.task).__name__
        series = f"episode {self.numbers[row]} of seed {self.seeds[row]}"
        agents = self.agents
        return f"{self.functional.name}: task {task}: step {self._steps[row]}, {series}, '{agents[agent]}'"

    def checked(self, action: object, who: str) -> Floats:
        """Return actions as an array (B, n, A) in [-1, 1]; raise UsageError that names ``who`` if they are invalid."""
        agents = self.agents
        shape = (self.size, len(agents), self.width)
        try:
            array = np.asarray(numbers(action, who, shape), self.dtype)
        except (TypeError, ValueError, OverflowError):
            raise UsageError(f"{who}: expected numbers of shape {shape[2:]}, found {one_line(action)}") from None
        if array.shape != shape:
            # Whoever has one environment, or one agent, does not see these axes.
            names = (
                ", ".join(axis.name for axis in self.axes[0]) if len(self.sides) == 1 else "the largest of any agent"
            )
            raise UsageError(f"{who}: expected shape {shape} (environments, agents; {names}), found {array.shape}")
        most = self.dtype.type(1.0 + ROUNDING)
        # Extremes are NaN if a number is.
        if not (array.max(initial=0.0) <= most and array.min(initial=0.0) >= -most):
            row, agent, axis = np.argwhere(~(np.abs(array) <= most))[0]
            what = f"{self._named(agent, axis)} of '{agents[agent]}' in environment {row}"
            raise UsageError(f"{who}: {what} is {array[row, agent, axis]:g}; allowed: -1 to 1")
        return array

    def _named(self, agent: int, axis: int) -> str:
        """Return the name of a number in an agent's action, such as "pitch"."""
        mine = self.axes[agent]
        return mine[axis].name if axis < len(mine) else f"number {axis}, which is none"

    def of_agent(self, seen: object, number: int) -> object:
        """Return agent ``number``'s part, leaves (B, ...), of observations (B, n, ...) of all, by fleet if several."""
        return part_of(self.sides, seen, number)

    @property
    def vehicles(self) -> int:
        """Number of vehicles in one world, of all fleets together."""
        return sum(fleet.size for fleet in self.functional.play.world.fleets)

    def state(self, row: int) -> Floats:
        """Return the true state of episode ``row``, (STATE V + 1,), for the V vehicles of all fleets in their order.

        Of each vehicle: position NED [m], roll, pitch and yaw [rad], velocity in body axes [m/s], body rates [rad/s],
        and 1 if it has stopped; at the end the part of the episode that is over, 0 to 1.
        """
        episode, play = self.episodes.episode(row), self.functional.play
        found = []
        for model, fleet in zip(play.world.fleets, episode.state.fleets, strict=True):
            pose = model.vehicle.pose(fleet.vehicle)
            parts = [pose.position_ned, pose.attitude, pose.velocity_body, pose.rates_body, fleet.violation.code != 0]
            found.append(np.stack([np.asarray(leaf, self.dtype) for leaf in jax.tree.leaves(parts)], axis=1).ravel())
        return np.concatenate([*found, np.array([episode.step / play.steps], self.dtype)])

    @property
    def steps_per_second(self) -> float:
        """Number of steps (actions) per second of simulated time."""
        return 1.0 / self.functional.play.task.period

    @property
    def answer_shape(self) -> tuple[int, ...]:
        """Shape of each agent's answer; () for a task without answers."""
        return tuple(self.functional.play.task.answer_shape(self.functional.play.world))

    def hand_in(self, answers: object, rows: Floats, agents: Floats) -> None:
        """Store answers (b, a, ...) of ``agents`` in episodes ``rows``, such as plume maps; the last ones count.

        Args:
            answers: one of each.
            rows: (b,) numbers of the episodes.
            agents: (a,) numbers of the agents.

        Raises:
            UsageError: nothing can be handed in, nothing has started, another shape, or something that is not finite.
        """
        if not self.functional.play.task.hands_in:
            raise UsageError(f"{self.functional.name}: nothing is handed in in this task")
        if not self.episodes.started:
            raise UsageError("the environment has not started: call reset() first")
        checked = self._answer(answers, (len(rows), len(agents)))
        if self._answers is None:
            self._answers = np.zeros((self.size, len(self.agents), *self.answer_shape), self.dtype)
        self._answers[np.ix_(rows, agents)] = checked

    def scores(self, rows: Floats) -> Floats:
        """Return the scores (b, n) of the stored answers of episodes; missing answers count as zeros."""
        agents = len(self.agents)
        if not self.functional.play.task.hands_in:
            return np.zeros((len(rows), agents))
        nothing = np.zeros((agents, *self.answer_shape), self.dtype)
        found = [self.score(int(row), nothing if self._answers is None else self._answers[row]) for row in rows]
        return np.asarray(found, float).reshape(len(rows), agents)

    def score(self, row: int, answer: object) -> Floats:
        """Return the scores (n,) of the answers (n, ...) that an episode's agents give at its end.

        Raises:
            UsageError: another shape, or something that is not finite.
            RunError: the score is NaN or infinite.
        """
        array = self._answer(answer, (len(self.agents),))
        with self._precision_context():
            found = score(self.functional.play, self.episodes.episode(row), array)
        if not np.isfinite(found).all():
            agent = int(np.flatnonzero(~np.isfinite(found))[0])
            raise RunError(f"{self._place(row, agent)}: the score of what was handed in is {found[agent]:g}")
        return found

    def _answer(self, answer: object, lead: tuple[int, ...]) -> Floats:
        """Return answers as an array (*lead, *answer_shape); raise UsageError for a wrong shape or value."""
        try:
            array = np.asarray(answer, self.dtype)
        except (TypeError, ValueError, OverflowError):
            raise UsageError(f"samples: expected numbers of shape {self.answer_shape} of each agent") from None
        if array.shape != (*lead, *self.answer_shape):
            raise UsageError(
                f"samples: expected shape {self.answer_shape} of each agent, found {array.shape[len(lead) :]}"
            )
        if not np.isfinite(array).all():
            raise UsageError(f"samples: number {np.argwhere(~np.isfinite(array))[0][len(lead)]} is not finite")
        return array


def _zeros_like(tree: object, size: int) -> Any:
    """Return a tree of zeros in the shape and dtype of ``tree``, with leaves for ``size`` episodes."""
    return jax.tree.map(lambda leaf: np.zeros((size, *leaf.shape[1:]), leaf.dtype), tree)


def _set_rows(old: Floats, rows: NumpyArray, new: object) -> None:
    """Write new values into these rows of an array, in place."""
    old[rows] = new
