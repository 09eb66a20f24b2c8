"""The learner's reward: that of the task in a form that gradients like, or the task's own, scaled.

Tasks with a goal or wanted velocity: each second costs log(1 + e^2) + ``PULL`` e, for an error e in metres or m/s. The
logarithm rewards precision near the goal, and the second term has a slope far from it. A crash costs ``CRASH``: the
discounted cost of staying 120 m away forever, so that no crash is better than a flight. A potential of minus the error
is added as gamma Phi(s') - Phi(s), which leaves the best policy as it is (Ng, Harada and Russell 1999). Errors are the
true ones: a reward may use what a policy does not observe. All of it is multiplied by ``SCALE``.
Velocities: the same of the error, and ``DRIFT`` of its integral.
Landings: of the distance from the pad, and ``OFF_GROUND`` more while the vehicle moves.
Searches by numbers: of the distance to the nearest missing person, and ``MISSING`` for each other one.
Formations: of the distance from the place in it.
Pursuits: of the distance beyond that of a catch; less room than ``ROOM`` to the mouse or a cat costs too, and a mouse
far from the middle of the area lowers the potential. Half of it is each cat's own and half the mean of all cats. A
decision of 1 s counts as one, so a crash costs more, and the unit is smaller. A mouse that is an agent gains what the
distances to all cats cost these, in the mean, and pays for the same places and for the same lack of room.
Other tasks: the task's reward over the running standard deviation of its discounted sum.
"""

from __future__ import annotations

from typing import Any, Protocol, cast

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch
from qrsim.envs.one_side import OneSide
from qrsim.tasks.formation import KeepFormation
from qrsim.tasks.landing import Land
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.search import Search
from qrsim.tasks.simple import KeepSpot, KeepVelocity

# 5 s, the horizon of a discount of 0.98 for each 0.1 s, of log(1 + 120^2) + 12.
CRASH = 110.0
# Cost of each metre or m/s of error each second.
PULL = 0.1
# Longest time of a decision that counts [s].
LONGEST = 0.1
# Potential for each metre or m/s of error, and cost of the squared output of a network each second.
POTENTIAL, EFFORT = 0.5, 0.05
# Error of velocity for each metre of drift [1/s].
DRIFT = 0.5
# Error of a vehicle in the air where it is to land [m], and the cost of a crash: that of staying 40 m away forever.
# More would teach to keep away from the ground.
OFF_GROUND, CRASH_IN_LANDING = 2.0, 60.0
# Error of a search for each missing person that is not the nearest one [m], and for one within reach.
MISSING, UNFOUND = 20.0, 2.0
# Unit of the learner's reward, which makes values a few units large.
SCALE = 0.1
# Pursuits: cost of a crash and of each metre, longest time of a decision [s], unit.
CRASH_IN_PURSUIT, PULL_IN_PURSUIT, LONGEST_IN_PURSUIT, SCALE_IN_PURSUIT = 600.0, 0.12, 1.0, 0.03
# Distance [m] within which vehicles are too near to each other, and the cost of its lack squared each second.
ROOM, CROWDED = 4.5, 3.0
# The mouse's distance from the middle, in parts of half a side, beyond which the potential falls, and its fall a metre.
INNER, OUTWARD = 0.43, 0.3
# Limit of a scaled reward.
LARGEST = 10.0


class Objective(Protocol):
    """Reward of the learner."""

    def begin(self, batch: Batch | OneSide, ended: Floats | None = None) -> None:
        """Note the state at the start of episodes, of the agents ``ended`` (N,) bool or, for None, of all."""

    def reward(self, batch: Batch | OneSide, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the learner's rewards, N = B n, from the task's ``reward`` (B, n) of n agents in B episodes."""

    def state(self) -> dict[str, Floats]:
        """Return the reward's running statistics as arrays, for a checkpoint."""

    def restore(self, state: dict[str, object]) -> None:
        """Restore what ``state`` returned, from a checkpoint."""


def objective_of(batch: Batch | OneSide, discount: float) -> Objective:
    """Return the reward on which a policy of this task is trained; ``discount``: per decision."""
    task = batch.functional.play.task
    if isinstance(task, Land):
        return Landed(batch, discount)
    if isinstance(task, KeepVelocity):
        return Steady(batch, discount)
    if isinstance(task, KeepSpot):
        return Reached(batch, discount)
    if isinstance(task, KeepFormation):
        return InFormation(batch, discount)
    if isinstance(task, Search):
        return Searched(batch, discount)
    if isinstance(task, Pursuit) and task.mouse == "agent" and batch.agents == batch.functional.play.sides[-1].names:
        return Escaped(batch, discount)
    if isinstance(task, Pursuit) and not task.senses:
        return Caught(batch, discount)
    return Scaled(batch, discount)


class Reached:
    """Reward for a small true error of position.

    Attributes:
        crash, pull, longest, scale: the numbers of the module that hold for the task.
    """

    crash, pull, longest, scale = CRASH, PULL, LONGEST, SCALE

    def __init__(self, batch: Batch | OneSide, discount: float):
        self._discount = discount
        # Of longer decisions too, as values are sums over decisions.
        self._seconds = min(batch.functional.play.task.period, self.longest)
        self._potential = np.zeros(0)

    def begin(self, batch: Batch | OneSide, ended: Floats | None = None) -> None:
        """Note the agents' potentials at the start of episodes, for the shaping of rewards."""
        self._potential = self.potential(batch, self.errors(batch))

    def reward(self, batch: Batch | OneSide, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the learner's rewards (N,) for a step: fall of potential, less costs of error, effort and crash."""
        before, error = self._potential, self.errors(batch)
        now = self._potential = self.potential(batch, error)
        crashed = np.repeat(terminated, reward.shape[1])
        effort = EFFORT * _summed(np.square(outputs))
        potential = before - self._discount * np.where(crashed, 0.0, now)
        cost = self._seconds * (self.cost(error) + effort + self.crowding(batch))
        found: Floats = (self.scale * (potential - cost - self.crash * crashed)).astype(np.float32)
        return self.shared(found, reward.shape[1])

    def cost(self, error: Floats) -> Floats:
        """Return the cost (N,) of errors (N,) per second."""
        found: Floats = np.log1p(error * error) + self.pull * error
        return found

    def potential(self, batch: Batch | OneSide, error: Floats) -> Floats:
        """Return minus the potential (N,) for errors (N,); a step is rewarded for lowering it."""
        found: Floats = POTENTIAL * error
        return found

    def crowding(self, batch: Batch | OneSide) -> Floats | float:
        """Return the cost per second of being too near to other agents, (N,) or 0; 0 here."""
        return 0.0

    def shared(self, reward: Floats, agents: int) -> Floats:
        """Share rewards (N,) within teams of ``agents``; here each agent keeps its own."""
        return reward

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the true distance (N,) [m] of each agent from its goal."""
        goal = batch.seen[..., 9:12] + batch.seen[..., 0:3]
        return _length(goal - batch.truth["position_ned"])

    def state(self) -> dict[str, Floats]:
        """Return {}, because this reward learns nothing."""
        return {}

    def restore(self, state: dict[str, object]) -> None:
        """Do nothing, because this reward learns nothing."""


class Steady(Reached):
    """Reward for a small true error of velocity, and a small drift: an error that lasts leads out of the area."""

    def __init__(self, batch: Batch | OneSide, discount: float):
        super().__init__(batch, discount)
        self._drift = np.zeros((batch.size * len(batch.agents), 3))

    def begin(self, batch: Batch | OneSide, ended: Floats | None = None) -> None:
        """Note the agents' velocity errors, and set the drift of new episodes to zero."""
        self._drift[slice(None) if ended is None else ended] = 0.0
        super().begin(batch, ended)

    def reward(self, batch: Batch | OneSide, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Integrate the velocity error over this step into the drift, and return the learner's rewards (N,)."""
        self._drift += batch.functional.play.task.period * _lacking(batch)
        return super().reward(batch, reward, terminated, outputs)

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the agents' true velocity errors (N,) [m/s], plus ``DRIFT`` times the integral of each."""
        found: Floats = _length(_lacking(batch)) + DRIFT * _length(self._drift)
        return found


class Landed(Reached):
    """Reward for a small true distance from a pad, and for standing."""

    crash = CRASH_IN_LANDING

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the true distances (N,) [m] from the pad, increased by ``OFF_GROUND`` for a vehicle that moves."""
        moves = _length(batch.truth["velocity_body"]) > 0.0
        found: Floats = Reached.errors(self, batch) + OFF_GROUND * moves
        return found


class InFormation(Reached):
    """Reward for a small true distance from a place in a formation."""

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the agents' true distances (N,) [m] from their places in the formation."""
        return _length(batch.truth["to_place_ned"])


class Searched(Reached):
    """Reward for a small true distance to the nearest missing person, and for finding one."""

    crash = CRASH_IN_LANDING

    def __init__(self, batch: Batch | OneSide, discount: float):
        super().__init__(batch, discount)
        self._reach = float(cast(Any, batch.functional.play.world.contents.persons).found_distance)

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return distances (N,) [m] to where the nearest missing person is found, plus ``MISSING`` per other one."""
        missing = batch.truth["missing"].ravel()
        away = np.maximum(_length(batch.truth["to_person_ned"]) - self._reach, 0.0) + UNFOUND
        found: Floats = np.where(missing > 0.0, away + MISSING * (missing - 1.0), 0.0)
        return found


class Caught(Reached):
    """Reward for cats near the mouse, by the offsets that they observe."""

    crash, pull, longest, scale = CRASH_IN_PURSUIT, PULL_IN_PURSUIT, LONGEST_IN_PURSUIT, SCALE_IN_PURSUIT

    def __init__(self, batch: Batch | OneSide, discount: float):
        super().__init__(batch, discount)
        play = batch.functional.play
        task, area = cast(Any, play.task), cast(Any, play.world.area)
        sizes = {fleet.name: fleet.size for fleet in play.world.fleets}
        self._opponents = sizes[self.opponents(task)]
        self._catch = float(task.reach) * float(play.world.collision_distance)
        # Of areas of other shapes no middle is known.
        self._middle, self._inner = np.zeros(2), np.inf
        if area.is_box:
            low, high = np.array([[area.x_min, area.y_min], [area.x_max, area.y_max]], float)
            self._middle, self._inner = 0.5 * (low + high), INNER * 0.5 * float((high - low).min())

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the observed distance (N,) [m] of each cat to the nearest mouse beyond that of a catch, at least 0."""
        found: Floats = np.maximum(self._distances(batch)[:, : self._opponents].min(axis=1) - self._catch, 0.0)
        return found

    def potential(self, batch: Batch | OneSide, error: Floats) -> Floats:
        """Return minus the potential (N,) for errors (N,), larger with the mouse far from the area's middle."""
        found: Floats = super().potential(batch, error) + self._outside(batch.seen[..., 0:2] + batch.seen[..., 4:6])
        return found

    @staticmethod
    def opponents(task: Pursuit) -> str:
        """Return the name of the fleet to catch."""
        return task.prey

    def _outside(self, mouse: Floats) -> Floats:
        """Return the fall of the potential (N,) for places (..., 2) of mice [m]."""
        away = np.sqrt(np.square(mouse - self._middle).sum(axis=-1)).ravel()
        found: Floats = OUTWARD * np.maximum(away - self._inner, 0.0)
        return found

    def crowding(self, batch: Batch | OneSide) -> Floats:
        """Return the cost per second (N,) of cats nearer than ``ROOM`` to a mouse or another cat."""
        lacking = np.maximum(ROOM - self._distances(batch).min(axis=1), 0.0)
        found: Floats = CROWDED * lacking * lacking
        return found

    def _distances(self, batch: Batch | OneSide) -> Floats:
        """Return the observed distances (N, m + n - 1) [m] to the mice and the other cats."""
        offsets = batch.seen[..., 4:].reshape(-1, (batch.seen.shape[-1] - 4) // 2, 2)
        found: Floats = np.sqrt(np.square(offsets).sum(axis=-1))
        return found

    def shared(self, reward: Floats, agents: int) -> Floats:
        """Average rewards (N,) with each team of ``agents``: half a cat's own, half the team's mean."""
        teams = reward.reshape(-1, agents)
        found: Floats = (0.5 * teams + 0.5 * teams.mean(axis=1, keepdims=True)).ravel()
        return found


class Escaped(Caught):
    """Reward for mice far from all cats, by the offsets that they observe."""

    @staticmethod
    def opponents(task: Pursuit) -> str:
        """Return the name of the fleet to escape from."""
        return task.fleet

    def errors(self, batch: Batch | OneSide) -> Floats:
        """Return the observed distances (N, m) [m] to the cats less that of a catch, at least 0."""
        found: Floats = np.maximum(self._distances(batch)[:, : self._opponents] - self._catch, 0.0)
        return found

    def cost(self, error: Floats) -> Floats:
        """Return minus the mean cost (N,) of the cats with errors (N, m) per second."""
        found: Floats = -super().cost(error).mean(axis=1)
        return found

    def potential(self, batch: Batch | OneSide, error: Floats) -> Floats:
        """Return minus the potentials (N,) of the mice's own places."""
        return self._outside(batch.seen[..., 0:2])


def _lacking(batch: Batch | OneSide) -> Floats:
    """Return the wanted velocity minus the true one of each agent, (N, 3) NED [m/s]."""
    wanted = batch.seen[..., 9:12] + batch.seen[..., 3:6]
    found: Floats = (wanted - _velocity_ned(batch.truth)).reshape(-1, 3)
    return found


def _length(vectors: Floats) -> Floats:
    """Return the lengths (N,) of vectors (..., 3)."""
    found: Floats = np.sqrt(_summed(np.square(vectors.reshape(-1, 3))))
    return found


def _summed(parts: Floats) -> Floats:
    """Return the sums (N,) of rows of a few numbers (N, K), which is faster than NumPy's sum over a short axis."""
    found = parts[:, 0]
    for column in parts.T[1:]:
        found = found + column
    return found


def _velocity_ned(truth: dict[str, Floats]) -> Floats:
    """Return the true velocities (B, n, 3) NED [m/s] from attitude and body velocity."""
    roll, pitch, yaw = np.moveaxis(truth["attitude"], -1, 0)
    x, y, z = np.moveaxis(truth["velocity_body"], -1, 0)
    right, below = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    ahead, down = np.cos(pitch) * x + np.sin(pitch) * below, np.cos(pitch) * below - np.sin(pitch) * x
    return np.stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * right, np.sin(yaw) * ahead + np.cos(yaw) * right, down], axis=-1
    )


class Scaled:
    """The task's own reward over the running standard deviation of its discounted sum."""

    def __init__(self, batch: Batch | OneSide, discount: float):
        self._discount = discount
        self._sum = np.zeros(0)
        # Number of sums, their mean, and the sum of their squared differences from it.
        self._count, self._mean, self._squares = 1e-4, 0.0, 1e-4

    def begin(self, batch: Batch | OneSide, ended: Floats | None = None) -> None:
        """Allocate the discounted sums of rewards at the first call; later calls do nothing."""
        size = batch.size * len(batch.agents)
        if len(self._sum) != size:
            self._sum = np.zeros(size)

    def reward(self, batch: Batch | OneSide, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the task's rewards (N,), divided by the running standard deviation of discounted returns."""
        given = reward.astype(np.float64).ravel()
        self._sum = self._discount * self._sum + given
        count = len(given)
        away = self._sum.mean() - self._mean
        whole = self._count + count
        self._squares += self._sum.var() * count + away * away * self._count * count / whole
        self._mean, self._count = self._mean + away * count / whole, whole
        self._sum[np.repeat(terminated, reward.shape[1])] = 0.0
        scale = np.sqrt(self._squares / self._count) + 1e-8
        found: Floats = (given / scale).clip(-LARGEST, LARGEST).astype(np.float32)
        return found

    def state(self) -> dict[str, Floats]:
        """Return count, mean and sum of squared deviations of the discounted returns, for a checkpoint."""
        return {"reward_moments": np.array([self._count, self._mean, self._squares])}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore count, mean and sum of squared deviations of the discounted returns from a checkpoint."""
        self._count, self._mean, self._squares = map(float, state["reward_moments"])
