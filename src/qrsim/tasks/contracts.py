"""Protocol of tasks, as episodes use them.

A task names the contract as its base class. Methods marked abstract are required; the others, and the class variables,
have the defaults that stand here. All of them are pure functions of JAX.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax.numpy as jnp
from jax import Array

from qrsim.core.arrays import Floats
from qrsim.core.noise import Draw
from qrsim.models.radio.contracts import Inbox
from qrsim.tasks.agents import Axis
from qrsim.world.state import Action, State, World


@runtime_checkable
class Answering(Protocol):
    """Policy that hands something in at the end of its episode."""

    def answer(self) -> Floats:
        """Return the agents' answers (n, ...), such as a plume's map, at the end of an episode."""
        ...


@runtime_checkable
class Task(Protocol):
    """Goal and reward of an episode; the agents are the n vehicles of one fleet, or of several (``fleets``).

    Of several fleets all that is said here to be (n, ...) is a dict by fleet of (n_f, ...): actions, rewards,
    observations; of ``acts`` and ``sees`` too. Memory, answers and scores are not.

    Attributes:
        fleet: name of that fleet, of several the first, whose return is the task's score; "": there is no task.
        period: time between two actions [s], a multiple of the time step.
        penalty: reward of the step in which a vehicle stops.
        leave: whether an agent that stops leaves, and the others fly on until all have stopped; else its episode ends.
        axes: the numbers of an action, with unit and range, where they do not depend on the world (see ``acts``).
        asks_for: kind of set-points that its fleet's controller must take; None: its actions are commands.
        receives: whether radio messages are numbers of the observation, by ``observe_received``. The agents then
            send beacons alone; else messages are parts of actions and observations.
        hands_in: whether an agent hands in an answer at the end, which has a ``score``.
        baseline: class of a policy for comparison, as ``qrsim score`` takes it; None: the task has none of its own.
    """

    fleet: str
    period: float
    penalty: Array
    leave: bool = False
    axes: ClassVar[tuple[Axis, ...]] = ()
    asks_for: ClassVar[type | None] = None
    receives: ClassVar[bool] = False
    hands_in: ClassVar[bool] = False
    baseline: ClassVar[type | None] = None

    @property
    def ids(self) -> int:
        """Number of random streams that ``init`` draws from."""
        return 0

    @property
    def fleets(self) -> tuple[str, ...]:
        """Names of the fleets whose vehicles are agents, ``fleet`` first."""
        return (self.fleet,)

    def asks(self, fleet: str) -> type | None:
        """Return the type of set-points with which agents steer a fleet's controller; None: agents give commands."""
        return self.asks_for

    def acts(self, world: World) -> tuple[Axis, ...] | dict[str, tuple[Axis, ...]]:
        """Describe the numbers of an action by name, unit and range (by fleet if several); agents use [-1, 1]."""
        return self.axes

    @abstractmethod
    def init(self, world: World, state: State, draw: Draw) -> Any:
        """Return the task's memory (its own state) at the start of an episode; ``draw`` gives random numbers."""

    @abstractmethod
    def commands(self, memory: Any, world: World, action: Any) -> tuple[Action, ...]:
        """Convert actions (n, A), in physical units, to one command or set-point per fleet."""

    def each_tick(self, memory: Any, world: World, state: State) -> object:
        """Return the task's memory (its own state) after a tick of the world."""
        return memory

    @abstractmethod
    def judge(self, memory: Any, world: World, state: State, step: Array, steps: Array) -> tuple[object, object]:
        """Return the memory after step ``step`` () of ``steps`` (), from 1, and the reward (n,) while all vehicles fly.

        Both are numbers of the program, so that an episode of another length has the same one.
        """

    def crashed(self, memory: Any, world: World, state: State, steps: Array) -> Array:
        """Return the reward, () for the team or (n,), of the step in which a vehicle stops, such as after a crash."""
        return jnp.asarray(self.penalty)

    def truth(self, memory: Any, world: World, state: State) -> dict[str, Array]:
        """Return true values by name, (n, ...), that the agents' infos have in addition to the true poses."""
        return {}

    @abstractmethod
    def observe(self, memory: Any, world: World, state: State) -> Any:
        """Return the agents' observations, (n, O) or a dict of arrays (n, ...), from sensors and never the truth."""

    def observe_received(self, memory: Any, world: World, state: State, inbox: Inbox) -> Any:
        """Return the agents' observations, for a task with ``receives``, from the radio messages of all vehicles."""
        raise NotImplementedError

    @abstractmethod
    def sees(self, world: World) -> Any:
        """Describe the O values of an observation by name, unit and range; for a dict, its described parts."""

    def later(self, world: World) -> dict[str, tuple[int, ...]]:
        """Return name -> shape (n, ...) of large parts of an observation, such as pictures, that ``look`` computes.

        The observation is then a dict of one fleet, and ``observe_early`` returns the others.
        """
        return {}

    def observe_early(self, memory: Any, world: World, state: State) -> dict[str, Array]:
        """Return the agents' observations without the large parts that ``later`` names."""
        raise NotImplementedError

    def shot(self, world: World, state: State) -> Any:
        """Return what ``look`` needs of each agent's state, leaves (n, ...), such as its last camera reading."""
        raise NotImplementedError

    def look(self, world: World, state: State, shot: Any, to: dict[str, Array]) -> dict[str, Array]:
        """Compute the parts of an observation that ``later`` names; ``to``: zeros of their names and shapes.

        Args:
            world: where.
            state: at any time of the episode since the shot.
            shot: what ``shot`` returned, of each agent since it stopped that of the step before.
            to: zeros in their shapes, which a loop may fill.
        """
        raise NotImplementedError

    def answer_shape(self, world: World) -> tuple[int, ...]:
        """Return the shape of an agent's answer at the end of an episode; () for a task without answers."""
        return ()

    def score(self, memory: Any, world: World, state: State, answer: Array) -> Array:
        """Return the score (n,) of the agents' answers (n, *answer_shape) at the end of an episode."""
        return jnp.zeros(answer.shape[0], answer.dtype)
