"""Baseline policies, one for each family of tasks.

A baseline is made for an episode and has ``act(seen)``, from what all agents see to their actions (n, A) in [-1, 1],
and where something is handed in ``answer()``, (n, ...). It works on NumPy arrays and knows only what it has seen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.arrays import NumpyArray
from qrsim.core.noise import Draw, Key
from qrsim.errors import UsageError
from qrsim.interface.messages import Say
from qrsim.tasks.baselines.chasing import Chasing
from qrsim.tasks.baselines.consensus import Consensus
from qrsim.tasks.baselines.fleeing import Fleeing, Pursuing
from qrsim.tasks.baselines.holding import FLOWN, Holding
from qrsim.tasks.baselines.mapping import Mapping
from qrsim.tasks.baselines.searching import Searching
from qrsim.tasks.baselines.spotting import Spotting
from qrsim.tasks.baselines.touring import Touring
from qrsim.tasks.contracts import Answering
from qrsim.tasks.formation import KeepFormation
from qrsim.tasks.landing import Land
from qrsim.tasks.play import TASK, Play
from qrsim.tasks.plume_mapping import PlumeMapping
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.search import Search
from qrsim.tasks.simple import KeepSpot, KeepVelocity, ReachWaypoint, is_direct
from qrsim.tasks.speaking import ACT, SAY
from qrsim.tasks.teams import apart, by_fleet, together
from qrsim.world.state import State

__all__ = [
    "Baseline",
    "BaselinePolicy",
    "Chasing",
    "Consensus",
    "Fleeing",
    "Holding",
    "Mapping",
    "Searching",
    "Spotting",
    "Touring",
    "baseline",
    "oracle",
]
SIMPLE: dict[type, Any] = dict.fromkeys((KeepSpot, ReachWaypoint, Land, KeepVelocity), Holding)
ORACLES: dict[type, Any] = {Search: Touring}
KINDS: dict[type, Any] = {
    KeepFormation: Consensus,
    Pursuit: Chasing,
    Search: Searching,
    PlumeMapping: Mapping,
    **SIMPLE,
}


class Baseline(Protocol):
    """Policy of the agents of an episode."""

    def act(self, seen: object) -> Any:
        """Return the actions (n, A) in [-1, 1] for the agents' observations; fleet -> actions for several fleets."""
        ...


def baseline(play: Play, seed: int = 0) -> Baseline:
    """Return a task's built-in reference policy for one episode; ``seed``: of the policy's own random numbers.

    Raises:
        UsageError: the task has none.
    """
    kind: Any = KINDS.get(type(play.task), play.task.baseline)
    if kind is None:
        raise UsageError("policy baseline: this task has none; a task of your own names a class as its 'baseline'")
    if kind is Holding and not is_direct(play.task) and tuple(axis.name for axis in play.axes) != FLOWN:
        found = ", ".join(axis.name for axis in play.axes)
        raise UsageError(f"policy baseline: it gives {', '.join(FLOWN)}; these vehicles take {found}")
    if isinstance(play.task, Pursuit) and play.task.senses:
        raise UsageError("policy baseline: it reads the offsets that the observation lacks with task.senses")
    if isinstance(play.task, Pursuit) and play.task.mouse == "agent":
        kind = Pursuing
    if kind is Searching and cast(Search, play.task).observes == "likeliest":
        kind = Spotting
    made: Baseline = kind(play, seed)
    return made


def oracle(play: Play, seed: int = 0) -> Baseline:
    """Return a task's policy that acts on the true state; call ``know(state)`` before every ``act``.

    Raises:
        UsageError: the task has none.
    """
    kind = ORACLES.get(type(play.task))
    if kind is None:
        raise UsageError("policy oracle: this task has none; a search has")
    made: Baseline = kind(play, seed)
    return made


class BaselinePolicy:
    """A task's policy as one of ``Simulation`` and ``qrsim run``, called once per step of the task.

    Args:
        play: the task and its world.
        seed: of what it does at random.
        make: makes the policy of (play, seed); None: the task's baseline.

    Raises:
        UsageError: the task has no baseline.
    """

    def __init__(self, play: Play, seed: int = 0, make: Callable[[Play, int], Baseline] | None = None):
        self.play, self.seed = play, seed
        self._baseline = (make or baseline)(play, seed)
        self._memory: object = None
        self._observe = jax.jit(self._observed)

    def __call__(self, reading: Any) -> dict[str, object]:
        """Return set-points for the agents' fleet."""
        state, tick = reading.state, round(reading.time / self.play.world.time_step)
        if self._memory is None:
            self._memory = jax.jit(self._initial_memory)(state)
        seen = jax.tree.map(np.asarray, self._observe(self._memory, state, np.int32(tick)))
        done = self._baseline.act(seen)
        sides = self.play.sides
        if len(sides) > 1:
            by_fleet(done, [side.fleet for side in sides], "policy baseline: actions")
        each = {side.fleet: done if len(sides) == 1 else done[side.fleet] for side in sides}
        parts = {
            name: (part[ACT], part.get(SAY)) if isinstance(part, dict) else (part, None) for name, part in each.items()
        }
        acts = {name: np.asarray(act, self._like.dtype) for name, (act, _) in parts.items()}
        wanted = apart(sides, jnp.asarray(self.play.scaled(together(sides, acts, "policy baseline: actions"))))
        actions = self.play.task.commands(self._memory, self.play.world, wanted)
        names = [fleet.name for fleet in self.play.world.fleets]
        given = {name: jax.tree.map(np.asarray, action) for name, action in zip(names, actions, strict=True)}
        for name, (_, words) in parts.items():
            if words is not None:
                given[name] = Say(words, given[name])
        return given

    def answer(self) -> NumpyArray | None:
        """Return the agents' answers (n, ...), such as a plume's map, at the end of an episode; None without any."""
        policy = self._baseline
        return np.asarray(policy.answer(), self._like.dtype) if isinstance(policy, Answering) else None

    @property
    def _like(self) -> NumpyArray:
        """Return a zero of the world's floating-point type."""
        return np.zeros((), np.asarray(self.play.world.fleets[0].start.position_ned.x).dtype)

    def _initial_memory(self, state: State) -> object:
        """Return the task's memory (its own state) at the start of an episode."""
        ids = jnp.arange(self.play.task.ids, dtype=jnp.uint32)
        stream = Key.root(self.seed).stream(TASK, ids)
        return self.play.task.init(self.play.world, state, Draw(stream, jnp.int32(0), jnp.asarray(self._like)))

    def _observed(self, memory: object, state: State, tick: Array) -> object:
        """Return what the agents observe of a world's state at a tick."""
        return self.play.observed(memory, state, tick)
