"""What policies score in a task: the same episodes flown by each, with intervals and paired differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch, numbers, one_line
from qrsim.envs.dataset import Recording
from qrsim.errors import QrsimError, RunError, UsageError, did_you_mean
from qrsim.tasks.agents import still
from qrsim.tasks.baselines import baseline, oracle
from qrsim.tasks.contracts import Answering
from qrsim.tasks.play import Play
from qrsim.tasks.speaking import ACT, SAY
from qrsim.tasks.teams import apart, axes_of_agents, by_fleet

BASELINE, HOVER, RANDOM, ORACLE = "baseline", "hover", "random", "oracle"
BUILT_IN = (BASELINE, HOVER, RANDOM, ORACLE)
CONFIDENCE, RESAMPLES, RESAMPLE_SEED = 0.95, 2000, 20261123


@runtime_checkable
class Policy(Protocol):
    """Policy of all agents of one episode; see ``Answering`` too."""

    def act(self, seen: object) -> Floats:
        """Return the actions (n, A) in [-1, 1] for the agents' observations, (n, O) or a dict of (n, ...).

        With a radio it may return a dict of ``act``, which is that, and ``say`` (n, D), NaN for who says nothing. Where
        agents are of several fleets, it sees and returns a dict by fleet of all that.
        """
        ...


@runtime_checkable
class Informed(Protocol):
    """Policy that is told the truth: an oracle, which bounds what others can reach."""

    def know(self, state: object) -> None:
        """Take the true ``State`` of the world; called before each ``act``."""
        ...


class Hover:
    """Asks for nothing: of a command the neutral value of each number, of a velocity zero; hands in zeros."""

    def __init__(self, play: Play, seed: int = 0):
        rows = [list(still(axes)) for axes in axes_of_agents(play.sides)]
        self._still = apart(play.sides, np.array([row + [0.0] * (play.width - len(row)) for row in rows]))

    def act(self, seen: object) -> Any:
        """Return the same neutral actions (n, A) at every call, such as hovering."""
        return self._still


class Uniform:
    """Draws every number of every action uniformly; hands in zeros."""

    def __init__(self, play: Play, seed: int = 0):
        self._sides, self._shape = play.sides, (len(play.agents), play.width)
        self._random = np.random.default_rng(seed)

    def act(self, seen: object) -> Any:
        """Return random actions (n, A), uniform in [-1, 1]."""
        return apart(self._sides, self._random.uniform(-1.0, 1.0, self._shape))


class _Function:
    """A function of what is seen, as a policy."""

    def __init__(self, function: Callable[[Any], Any]):
        self._function = function

    def act(self, seen: object) -> Any:
        """Return the actions that the user's function returns for the observations."""
        return self._function(seen)


def maker(policy: str | object, play: Play) -> Callable[[Play, int], Policy]:
    """Return a function (play, seed) -> policy for an episode, from a built-in policy's name, a class or a function.

    Args:
        policy: one of ``BUILT_IN``; a class that is called with both and has ``act(seen)``; or a function of ``seen``.
        play: the task, for which there has to be a baseline or an oracle if that is asked for.

    Raises:
        UsageError: the task has no baseline or no oracle, a policy cannot be called, or a class has no ``act``.
    """
    if policy == BASELINE:
        baseline(play)
        return baseline
    if policy == ORACLE:
        oracle(play)
        return oracle
    if policy in (HOVER, RANDOM):
        return Hover if policy == HOVER else Uniform
    if isinstance(policy, type):
        if not issubclass(policy, Policy):
            raise UsageError(f"--policy: the class {policy.__name__} has no act(seen)")
        return policy
    if not callable(policy):
        raise UsageError(f"--policy: {policy!r} is neither a function of what is seen nor a class with act(seen)")
    return lambda *_: _Function(policy)


@dataclass(frozen=True)
class Interval:
    """A mean over episodes, and its percentile bootstrap interval at ``CONFIDENCE``; NaN of fewer than two."""

    mean: float
    low: float
    high: float

    @staticmethod
    def of(values: Floats) -> Interval:
        """Return the mean of values (S,) with its confidence interval."""
        mean = float(np.mean(values))
        if len(values) < 2:
            return Interval(mean, float("nan"), float("nan"))
        chosen = np.random.default_rng(RESAMPLE_SEED).integers(0, len(values), (RESAMPLES, len(values)))
        low, high = np.quantile(values[chosen].mean(axis=1), [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
        return Interval(mean, float(low), float(high))


@dataclass(frozen=True)
class Scored:
    """What a policy did.

    Attributes:
        name: of the policy.
        returns: (S,) of the episodes, mean over the agents, of several fleets over those of the first.
        others: of several fleets those of the others, by fleet.
        alive: (S,) whether nobody stopped.
        persons_found: (S,) by the end of each episode; None in a world without persons.
        picture: the first episode from above at its end, (480, 640, 3) uint8; None if none was asked for.
    """

    name: str
    returns: Floats
    alive: Floats
    picture: Floats | None = None
    persons_found: Floats | None = None
    others: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def interval(self) -> Interval:
        """Mean return over all episodes, with its confidence interval."""
        return Interval.of(self.returns)

    @property
    def persons_found_interval(self) -> Interval | None:
        """Mean number of persons found per episode, with its confidence interval; None if there are no persons."""
        return None if self.persons_found is None else Interval.of(self.persons_found)

    def less(self, other: Scored) -> Interval:
        """Return the mean of this policy's returns minus another's in the same episodes, with confidence interval."""
        return Interval.of(self.returns - other.returns)


def play_policy(
    batch: Batch,
    name: str,
    make: Callable[[Play, int], Policy],
    seeds: Floats,
    drawn: bool = False,
    told: Callable[[int], None] = lambda step: None,
    recording: Recording | None = None,
) -> Scored:
    """Fly one episode per seed with the policy that ``make`` builds; return its score. ``told`` is called per step.

    Args:
        batch: as many episodes as there are seeds.
        name: of the policy.
        make: see ``maker``.
        seeds: (S,).
        drawn: whether the first episode is drawn.
        told: is called with the number of each step done.
        recording: keeps the episodes, of the same batch.

    Raises:
        UsageError: an action, message or answer of another shape, not finite or out of range.
        RunError: anything that a user's policy raises, or a reward that is not finite.
    """
    play = jax.tree.map(np.asarray, batch.functional.play)
    batch.reset(seeds)
    with _blamed(name, "making it of (play, seed)", play):
        policies = [make(play, int(seed)) for seed in seeds]
    drawing = _started_drawing(batch) if drawn else None
    if recording is not None:
        recording.begin()
    nothing = np.zeros((len(play.agents), play.width))
    total, flies = np.zeros((batch.size, len(play.agents))), np.ones(batch.size, bool)
    finds = None if batch.episodes.episode(0).state.contents.persons is None else np.zeros(batch.size)
    for step in range(play.steps):
        seen = [jax.tree.map(lambda leaf, i=i: leaf[i], batch.seen) for i in range(batch.size)]
        with _blamed(name, f"step {step + 1}", play):
            for row, each in enumerate(policies):
                if isinstance(each, Informed) and flies[row]:
                    each.know(batch.episodes.episode(row).state)
            given = [policies[i].act(seen[i]) if flies[i] else None for i in range(batch.size)]
        silent = np.full((len(nothing), play.message), np.nan)
        parts = [
            (nothing, silent) if done is None and not flies[i] else _together(batch, done, name)
            for i, done in enumerate(given)
        ]
        actions, words = np.stack([act for act, _ in parts]), np.stack([said for _, said in parts])
        reward, terminated, truncated = batch.step(actions, words, f"policy {name}")
        total += np.where(flies[:, None], reward.astype(np.float64), 0.0)
        if recording is not None:
            recording.add(np.flatnonzero(flies), actions, reward, (terminated, truncated))
        if drawing is not None and flies[0]:
            drawing.moved()
            if terminated[0] or truncated[0]:
                picture = drawing.frame()
        if finds is not None:
            for over in np.flatnonzero(flies & (terminated | truncated)):
                finds[over] = _finds(batch, int(over))
        flies &= ~terminated
        told(step + 1)
        if not flies.any():
            break
    for i in np.flatnonzero(flies) if play.task.hands_in else ():
        policy = policies[i]
        with _blamed(name, "answer", play):
            answer = policy.answer() if isinstance(policy, Answering) else _no_answers(batch)
        handed_in = batch.score(int(i), answer)
        total[i] += handed_in
        if recording is not None:
            recording.score(int(i), float(handed_in.mean()))
    first, *others = ((side.fleet, total[:, side.rows].mean(axis=1)) for side in batch.sides)
    return Scored(name, first[1], flies, picture if drawing is not None else None, finds, dict(others))


def _finds(batch: Batch, row: int) -> int:
    """Return the number of persons found so far in the episode ``row``."""
    persons = batch.episodes.episode(row).state.contents.persons
    return int(np.sum(np.asarray(persons.found_tick)[np.asarray(persons.there)] >= 0))


@contextmanager
def _blamed(name: str, where: str, play: Play) -> Iterator[None]:
    """Return a context in which exceptions of a user's policy become a RunError that names it and ``where``.

    Raises:
        RunError: what it raised, which stays the cause.
    """
    try:
        yield
    except QrsimError:
        raise
    except Exception as error:
        if name in BUILT_IN and (name != BASELINE or play.task.baseline is None):
            raise
        raise RunError(f"policy {name}: {where}: {type(error).__name__}: {' '.join(str(error).split())}") from error


def _together(batch: Batch, given: Any, name: str) -> tuple[Floats, Floats]:
    """Return a policy's checked actions (n, A), and its radio messages (n, D), NaN for none."""
    if len(batch.sides) > 1:
        by_fleet(given, [side.fleet for side in batch.sides], f"policy {name}: actions")
    acts, said = [], []
    for side in batch.sides:
        mine = given if len(batch.sides) == 1 else given[side.fleet]
        who = name if len(batch.sides) == 1 else f"{name}: fleet '{side.fleet}'"
        act, words = _parted(batch, mine, len(side.names), who)
        rows = checked(act, np.zeros((len(side.names), len(side.axes))), who)
        acts.append(np.pad(rows, ((0, 0), (0, batch.width - len(side.axes)))))
        said.append(words)
    return np.concatenate(acts), np.concatenate(said)


def _parted(batch: Batch, given: object, agents: int, name: str) -> tuple[object, Floats]:
    """Split what a policy returned into actions and radio messages (n, D), NaN for agents that send none.

    Raises:
        UsageError: a dict without ``act``, with something else than ``act`` and ``say``, or no D numbers to say.
    """
    shape = (agents, batch.functional.play.message)
    if not (shape[1] and isinstance(given, dict)):
        return given, np.full(shape, np.nan)
    for part in given:
        if part not in (ACT, SAY):
            raise UsageError(f"policy {name}: there is no part '{part}'{did_you_mean(str(part), (ACT, SAY))}")
    if ACT not in given:
        raise UsageError(f"policy {name}: expected a dict of {ACT} and {SAY}; {ACT} is missing")
    said = given.get(SAY)
    words = np.full(shape, np.nan) if said is None else numbers(said, f"policy {name}: {SAY}", shape)
    if words.shape != shape:
        expected = f"expected shape {shape} (agents, world.radio.size)"
        raise UsageError(f"policy {name}: {SAY}: {expected}, found {words.shape}")
    try:
        return given[ACT], words.astype(np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"policy {name}: {SAY}: expected numbers of shape {shape}, found {one_line(said)}") from None


def checked(action: object, like: Floats, name: str) -> Floats:
    """Return a policy's actions as an array in the shape of ``like``; raise UsageError that names it otherwise.

    Raises:
        UsageError: they have another shape, or are no numbers.
    """
    try:
        array = np.asarray(numbers(action, name, like.shape), np.float64)
    except (TypeError, ValueError, OverflowError):
        expected = f"expected actions of shape {like.shape} (agents, axes)"
        raise UsageError(f"policy {name}: {expected}, found {one_line(action)}") from None
    if array.shape != like.shape:
        raise UsageError(f"policy {name}: expected actions of shape {like.shape} (agents, axes), found {array.shape}")
    return array


def score_task(
    batch: Batch,
    makers: Mapping[str, Callable[[Play, int], Policy]],
    first_seed: int = 0,
    drawn: bool = False,
    told: Callable[[str, int], None] = lambda name, step: None,
    recording: Recording | None = None,
) -> list[Scored]:
    """Fly all policies (name -> maker) in the same episodes, with seeds from ``first_seed`` on; return scores.

    Args:
        batch: as many episodes as wanted.
        makers: policies by name, see ``maker``; of the first the first episode is drawn.
        first_seed: of the first episode.
        drawn: whether it is drawn.
        told: is called with the name of the policy and the number of the step done.
        recording: keeps all episodes of the first policy.
    """
    seeds = first_seed + np.arange(batch.size)
    found: list[Scored] = []
    for name, make in makers.items():
        first = not found
        found.append(
            play_policy(
                batch,
                name,
                make,
                seeds,
                drawn and first,
                lambda step, name=name: told(name, step),  # type: ignore[misc]
                recording if first else None,
            )
        )
    return found


def _no_answers(batch: Batch) -> Floats:
    """Return zeros in the shape of all agents' answers, for a policy that gives none."""
    return np.zeros((len(batch.functional.agents), *batch.answer_shape))


def _started_drawing(batch: Batch) -> Any:
    """Return a drawing of the batch's first episode from above, at its start."""
    from qrsim.envs.drawing import Drawing

    drawing = Drawing(batch)
    drawing.begin()
    return drawing
