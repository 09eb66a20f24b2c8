"""The loop of training: fly, improve, try, keep.

Training is cut into cycles of whole episodes. At the end of each the mean policy flies episodes that are not learned
from, the best policy so far is kept, and everything is written, so a later process goes on with the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qrsim.core.arrays import Floats, NumpyArray
from qrsim.engine.settings import use_compilation_cache
from qrsim.envs.batch import Batch
from qrsim.envs.functional import Functional
from qrsim.envs.objective import objective_of
from qrsim.envs.one_side import OneSide, Others
from qrsim.envs.viewing import batch_of, view_of
from qrsim.errors import RunError, UsageError
from qrsim.studies.learn.flights import Flights
from qrsim.studies.learn.imitating import imitate
from qrsim.studies.learn.moments import Moments
from qrsim.studies.learn.ppo import DECIDING, Algorithm, Learner, Pair, Samples, Settings
from qrsim.studies.learn.starting import BASELINE, read_start
from qrsim.tasks.learned import PolicyFile, forward, read_policy

# Decisions of each row in an iteration, and of all rows at least.
HORIZON, FEWEST = 32, 2048
# Interval, in decisions, of the inputs whose moments are taken; those between hardly differ.
THINNED = 4
# Seeds of the episodes that are learned from, of those that policies are tried in, whole or in the start, and how many
# whole ones these are.
LEARNED, TRIED, STARTED, TRIES = 10**9, 5 * 10**8, 6 * 10**8, 64
# Episodes of one seed of a training; more than anybody has memory for.
APART = 10**6
# Cycles in which the value of a policy that was started with is learned, before the policy itself changes.
VALUED = 1


@dataclass(frozen=True)
class Plan:
    """What is trained.

    Attributes:
        task: scenario, as ``qrsim.load`` takes it.
        overrides: assignments such as "world.wind.speed_20ft=7".
        shorter: further assignments in the episodes that are learned from; policies are tried without them.
        seed: of the training.
        envs: episodes side by side.
        steps: decisions of all agents, after which it ends.
        seconds: wall time after which it ends [s]; None: any.
        tries: episodes in which policies are tried.
        early: time [s] after which half of the episodes that are learned from are left, so that more starts are seen;
            None: none is.
        starts: further episodes in which policies are tried, of the length of those that are learned from.
        integral: as of ``view_of``.
        settings: numbers of the algorithm.
        start: ``BASELINE``: the policy first imitates the task's baseline; the name of a policy file: it is that policy
            at first; None: it begins from nothing.
        fleet: name of the one that learns, in a task with agents of several.
        others: name of a policy file that flies the agents of another fleet; None: the task's baseline does.
    """

    task: Any
    overrides: tuple[str, ...] = ()
    shorter: tuple[str, ...] = ()
    seed: int = 0
    envs: int = 512
    steps: int = 3_000_000
    seconds: float | None = None
    tries: int = TRIES
    early: float | None = None
    starts: int = 0
    integral: bool = False
    settings: Settings = field(default_factory=Settings)
    start: str | None = None
    fleet: str | None = None
    others: str | None = None


@dataclass(frozen=True)
class Tried:
    """A row of the curve.

    Attributes:
        cycle: number of the cycle, from 1.
        steps: decisions of all agents so far.
        seconds: wall time of the cycles so far [s].
        mean_return: of the task, in the episodes that policies are tried in; see ``in_parts`` for those with starts.
        flown_to_the_end: part of these.
        reward: mean of the learner's reward of a decision in the cycle.
        divergence: mean divergence of an iteration's policy from the one before.
    """

    cycle: int
    steps: int
    seconds: float
    mean_return: float
    flown_to_the_end: float
    reward: float
    divergence: float

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key of policies: share of episodes flown to the end, then mean return."""
        return self.flown_to_the_end, self.mean_return


class Training:
    """A training; iterate over ``cycles``.

    Args:
        plan: what is trained.
        begins: whether it begins; else a checkpoint is restored, and nothing is read that the plan starts with.

    Attributes:
        best: the policy that did best so far, and its row; None before the first cycle.

    Raises:
        UsageError, ScenarioError: there is no such task, or it cannot be learned.
        MissingExtraError: optax is not installed.
    """

    def __init__(self, plan: Plan, begins: bool = True):
        self.plan = plan
        functional = Functional.of(plan.task, plan.overrides)
        self.view = view_of(functional, plan.integral, plan.fleet)
        self._read = read_start(plan.start, functional.play, self.view, plan.settings.width) if begins else None
        if plan.others is not None and self.view.fleet is None:
            raise UsageError(f"--others {plan.others}: all agents of {self.view.task} learn")
        self._opponent = None if plan.others is None else read_policy(plan.others)
        self.algorithm = Algorithm(self.view, plan.settings)
        use_compilation_cache()
        early = None if plan.early is None else round(plan.early / self.view.seconds)
        self.flights = self.flights_of(plan.envs, plan.shorter, early)
        self.trials = self.flights_of(plan.tries)
        self.starts = self.flights_of(plan.starts) if plan.starts else None
        self.horizon = max(HORIZON, -(-FEWEST // self.flights.rows))
        self.learner: Learner = self.algorithm.begin(plan.seed)
        # Layers of the running mean of the policies.
        self.averaged: Any = None
        self.moments = Moments(self.view.inputs)
        self.scaling = self.moments.scaling()
        self.cycle, self.steps = 0, 0
        self.best: tuple[PolicyFile, Tried] | None = None
        self.curve: list[Tried] = []

    def flights_of(self, episodes: int, more: tuple[str, ...] = (), left_after: int | None = None) -> Flights:
        """Return B = ``episodes`` parallel episodes as the learner sees them.

        Args:
            episodes: B.
            more: further overrides.
            left_after: as of ``Flights``.
        """
        batch = batch_of(self.plan.task, episodes, [*self.plan.overrides, *more], self.view)
        side = self.side_of(batch)
        return Flights(side, self.view, objective_of(side, self.plan.settings.discount), left_after)

    def side_of(self, batch: Batch) -> Any:
        """Return a batch as the learner's fleet sees it.

        Raises:
            UsageError: the policy of the others does not fit, or there are none.
        """
        if self.view.fleet is None:
            return batch
        others = None if self._opponent is None else Others(self._opponent, batch, self.view.fleet)
        return OneSide(batch, self.view.fleet, others)

    @property
    def iterations(self) -> int:
        """Number of iterations in a training cycle, enough for an episode to end."""
        return -(-self.flights.batch.functional.play.steps // self.horizon)

    def cycles(self, told: Callable[[int], None] = lambda steps: None) -> Iterator[Tried]:
        """Train, and yield a row of the training curve after each cycle; ``told`` is called with the decisions so far.

        Args:
            told: is called with the decisions so far.

        Raises:
            RunError: a reward is not finite.
        """
        begun, before = time.monotonic(), self.curve[-1].seconds if self.curve else 0.0
        limit = np.inf if self.plan.seconds is None else self.plan.seconds
        while self.steps < self.plan.steps and time.monotonic() - begun < limit:
            rng = np.random.default_rng([self.plan.seed, self.cycle])
            first = LEARNED + APART * (self.plan.seed % 10**6) + self.cycle * self.plan.envs
            if self.plan.start is not None and not self.cycle:
                self._start(rng, first + APART // 2)
            self.flights.begin(first + np.arange(self.plan.envs))
            rewards, divergences, ahead = [], [], self._drawn(rng)
            for number in range(1, self.iterations + 1):
                reward, divergence = self._iterate(*ahead)
                rewards.append(float(reward.mean()))
                if number < self.iterations:
                    ahead = self._drawn(rng)
                # Waits until JAX has read the samples, which the next iteration overwrites.
                divergences.append(self._finite(float(divergence)))
                self._average()
                self.steps += reward.size
                told(self.steps)
                if self.steps >= self.plan.steps or time.monotonic() - begun > limit:
                    break
            self.cycle += 1
            policy = self._policy()
            mean_return, flown_to_the_end = self._outcome(policy)
            elapsed = time.monotonic() - begun
            row = Tried(
                self.cycle,
                self.steps,
                round(before + elapsed, 2),
                mean_return,
                flown_to_the_end,
                float(np.mean(rewards)),
                float(np.mean(divergences)),
            )
            self.curve.append(row)
            if self.best is None or row.rank > self.best[1].rank:
                self.best = policy, row
            yield row

    def _outcome(self, policy: PolicyFile) -> tuple[float, float]:
        """Try a policy; return the mean return, and the part of the episodes that is flown to the end."""

        def act(features: Floats) -> Floats:
            """Return the policy's outputs (N, K) for inputs (N, F)."""
            found: Floats = forward(policy.layers, policy.scaling.scaled(features))
            return found

        whole = self.trials.fly(act, TRIED + np.arange(self.plan.tries))
        if self.starts is None:
            return float(whole[0].mean()), float(whole[1].mean())
        length = self.flights.batch.functional.play.steps
        starts = self.starts.fly(act, STARTED + np.arange(self.plan.starts), length)
        return in_parts(whole, self.trials.lasted > length, starts)

    def _improved(self, samples: Samples, orders: NumpyArray) -> tuple[Learner, Any]:
        """Return the learner after an iteration, and its divergence; the value of a start is learned first."""
        if self.plan.start is not None and self.cycle < VALUED:
            return self.algorithm.improve_value(self.learner, self._pair, samples, orders)
        falling = () if not self.plan.settings.falling else (np.float32(max(0.0, 1.0 - self.steps / self.plan.steps)),)
        found: tuple[Learner, Any] = self.algorithm.improve(self.learner, self._pair, samples, orders, *falling)
        return found

    def _start(self, rng: np.random.Generator, seed: int) -> None:
        """Make the policy that of the plan's start; the scaling of its inputs then stays as it is."""
        if self.plan.start == BASELINE:
            imitated = imitate(self.flights, self.learner.weights["policy"], self.moments, seed, rng)
            self.steps, layers = self.steps + imitated.decisions, imitated.layers
        else:
            assert self._read is not None
            self.moments = Moments.of(self._read.scaling)
            layers = [tuple(map(jnp.asarray, layer)) for layer in self._read.layers]
        self.learner = self.learner._replace(weights=self.learner.weights | {"policy": layers})

    def _average(self) -> None:
        """Add the present weights to the running mean of policies, if the settings want one."""
        share = np.float32(1.0 - self.plan.settings.averaged)
        if share == 1.0:
            return
        last = jax.tree.map(np.asarray, self.learner.weights["policy"])
        before = last if self.averaged is None else self.averaged
        self.averaged = jax.tree.map(lambda old, new: old + share * (new - old), before, last)

    def _finite(self, divergence: float) -> float:
        """Return the divergence of an iteration unchanged; raise RunError if it is not finite.

        Raises:
            RunError: it is not finite, and so are the weights.
        """
        if not np.isfinite(divergence):
            raise RunError(f"{self.view.task}: training diverged in cycle {self.cycle + 1}: weights are not finite")
        return divergence

    def keep_untried(self) -> bool:
        """Keep the present policy if the training was interrupted before any was tried; return whether it was kept."""
        if self.best is not None or not self.steps:
            return False
        unknown = float("nan")
        self.best = self._policy(), Tried(0, self.steps, 0.0, unknown, 0.0, unknown, unknown)
        return True

    def _drawn(self, rng: np.random.Generator) -> tuple[Floats, NumpyArray]:
        """Draw the normals (T, N, K) of an iteration's decisions, and the orders of its samples."""
        rows = self.flights.rows
        noise = rng.standard_normal((self.horizon, rows, len(self.view.flown)), np.float32)
        return noise, self.algorithm.orders(rng, self.horizon * rows)

    def _iterate(self, noise: Floats, orders: NumpyArray) -> tuple[Floats, Any]:
        """Fly an iteration, and have JAX improve the policy in another thread.

        Args:
            noise: (T, N, K) normals of the decisions.
            orders: of the samples.

        Returns:
            The rewards (T, N), valid until the next iteration, and the divergence (), perhaps still being computed.
        """
        first = not self.moments.count
        samples = self._fly(noise)
        inputs = samples.inputs[:-1:THINNED].reshape(-1, self.view.inputs)
        if first:
            # Nothing was known yet; the new policy returns zeros by any scaling.
            self.moments.add(inputs)
            self.scaling = self.moments.scaling()
        self.learner, divergence = self._improved(samples, orders)
        if self.plan.start is None and not first:
            self.moments.add(inputs)
        return samples.reward, divergence

    def _fly(self, noise: Floats) -> Samples:
        """Fly an iteration with normals (T, N, K); return its samples, valid until the next; sets ``scaling``."""
        flights, found, weights = self.flights, self._samples, self.learner.weights
        self.scaling = self.moments.scaling()
        # Each array passed to a compiled function costs a few microseconds, so only what a decision needs is passed.
        pair, deciding = jax.tree.map(jnp.asarray, self._pair), {name: weights[name] for name in DECIDING}
        # The log density of a Gaussian: a normal says how many deviations an output is from the mean.
        found.log_density[:] = -0.5 * np.square(noise).sum(axis=-1) - np.asarray(weights["log_spread"]).sum()
        cut, last = np.zeros(found.ended.shape, bool), []
        for number, normals in enumerate(noise):
            decision = self.algorithm.decide(deciding, pair, flights.seen, flights.last, normals)
            *kept, action = map(np.asarray, decision)
            for room, part in zip(found, kept, strict=False):
                room[number] = part
            reward, terminated, ended = flights.decide(found.outputs[number], action)
            cut[number] = ended & ~terminated
            if cut[number].any():
                last.append(flights.features(cut[number]))
            found.reward[number], found.ended[number] = reward, ended
            flights.follow(ended)
        found.inputs[-1] = flights.features()
        found.beyond[:] = 0.0
        if last:
            found.beyond[cut] = self._values(pair, np.concatenate(last))
        return found

    def _values(self, pair: Pair, features: Floats) -> Floats:
        """Return the value network's outputs (M,) for inputs (M, F), by the program for all rows of the flights."""
        count, rows = len(features), self.flights.rows
        room = np.zeros((-(-count // rows) * rows, self.view.inputs), np.float32)
        room[:count] = features
        parts = [self.algorithm.value(self.learner.weights, pair, part) for part in np.split(room, len(room) // rows)]
        return np.concatenate([np.asarray(part) for part in parts])[:count]

    @cached_property
    def _samples(self) -> Samples:
        """Memory of an iteration's samples, which the next iteration overwrites."""
        shape = (self.horizon, self.flights.rows)
        inputs = np.empty((shape[0] + 1, shape[1], self.view.inputs), np.float32)
        outputs = np.empty((*shape, len(self.view.flown)), np.float32)
        density, reward, beyond = (np.empty(shape, np.float32) for _ in range(3))
        return Samples(inputs, outputs, density, reward, np.empty(shape, bool), beyond)

    @property
    def _pair(self) -> Pair:
        """Mean and standard deviation of the network's inputs (F,), for compiled functions."""
        return self.scaling.mean, self.scaling.deviation

    def _policy(self) -> PolicyFile:
        """Return the present policy, or the running mean of policies, as a ``PolicyFile``."""
        found = self.learner.weights["policy"] if self.averaged is None else self.averaged
        layers = tuple((np.array(weights), np.array(offset)) for weights, offset in found)
        facts = {"seed": self.plan.seed, "steps": self.steps, "overrides": list(self.plan.overrides)}
        return PolicyFile(self.view, self.scaling, layers, facts)


def in_parts(whole: tuple[Floats, Floats], later: Floats, starts: tuple[Floats, Floats]) -> tuple[float, float]:
    """Return mean return and part flown to the end, from whole episodes and from the starts of many more.

    Crashes in the start are counted in the starts, and all that comes after it in those whole episodes that get there.

    Args:
        whole: mean returns (B,) of whole episodes, and whether each is flown to the end (B,).
        later: (B,) whether these last longer than a start.
        starts: returns (S,) of starts, and whether each is flown to its end (S,).
    """
    if not later.any():
        return float(whole[0].mean()), float(whole[1].mean())
    returns, well = (each[later].mean() for each in whole)
    return float(np.where(starts[1], returns, starts[0]).mean()), float(starts[1].mean() * well)
