"""The learner's reward: that of the task in a form that gradients like, or the task's own, scaled.

Tasks with a goal or wanted velocity: each second costs log(1 + e^2) + ``PULL`` e, for an error e in metres or m/s. The
logarithm rewards precision near the goal, and the second term has a slope far from it. A crash costs ``CRASH``: the
discounted cost of staying 120 m away forever, so that no crash is better than a flight. A potential of minus the error
is added as gamma Phi(s') - Phi(s), which leaves the best policy as it is (Ng, Harada and Russell 1999). Errors are the
true ones: a reward may use what a policy does not observe. All of it is multiplied by ``SCALE``.
Pursuits: the same of the distance beyond that of a catch, half of it each cat's own and half the mean of all cats.
Other tasks: the task's reward over the running standard deviation of its discounted sum.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from qrsim.core.arrays import Floats
from qrsim.envs.batch import Batch
from qrsim.tasks.learned import observed_names
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.simple import KeepSpot, KeepVelocity

# 5 s, the horizon of a discount of 0.98 for each 0.1 s, of log(1 + 120^2) + 12.
CRASH = 110.0
# Cost of each metre or m/s of error each second.
PULL = 0.1
# Longest time of a decision that counts [s].
LONGEST = 0.1
# Potential for each metre or m/s of error, and cost of the squared output of a network each second.
POTENTIAL, EFFORT = 0.5, 0.05
# Unit of the learner's reward, which makes values a few units large.
SCALE = 0.1
# Limit of a scaled reward.
LARGEST = 10.0


class Objective(Protocol):
    """Reward of the learner."""

    def begin(self, batch: Batch) -> None:
        """Store the batch's values at the start of episodes."""

    def reward(self, batch: Batch, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the learner's rewards (N,) for a step with the task's rewards (B, n) and ends (B,)."""

    def state(self) -> dict[str, Floats]:
        """Return the reward statistics as arrays, for a checkpoint."""

    def restore(self, state: dict[str, object]) -> None:
        """Set the state that ``state`` returned."""


def objective_of(batch: Batch, discount: float) -> Objective:
    """Return the learner's reward for a task."""
    task = batch.functional.play.task
    if isinstance(task, KeepSpot | KeepVelocity):
        return Reached(batch, discount)
    if isinstance(task, Pursuit) and not task.senses:
        return Caught(batch, discount)
    return Scaled(batch, discount)


class Reached:
    """Reward for a small true error of position or velocity."""

    def __init__(self, batch: Batch, discount: float):
        self._discount = discount
        # Of longer decisions too, as values are sums over decisions.
        self._seconds = min(batch.functional.play.task.period, LONGEST)
        self._by_velocity = isinstance(batch.functional.play.task, KeepVelocity)
        self._error = np.zeros(0)

    def begin(self, batch: Batch) -> None:
        """Store the agents' errors at the start of episodes."""
        self._error = self.errors(batch)

    def reward(self, batch: Batch, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the rewards (N,)."""
        before, now = self._error, self.errors(batch)
        self._error = now
        crashed = np.repeat(terminated, reward.shape[1])
        effort = EFFORT * np.square(outputs).sum(axis=1)
        potential = POTENTIAL * (before - self._discount * np.where(crashed, 0.0, now))
        cost = self._seconds * (np.log1p(now * now) + PULL * now + effort)
        found: Floats = (SCALE * (potential - cost - CRASH * crashed)).astype(np.float32)
        return self.shared(found, reward.shape[1])

    def shared(self, reward: Floats, agents: int) -> Floats:
        """Return the rewards (N,) unchanged: each agent's own."""
        return reward

    def errors(self, batch: Batch) -> Floats:
        """Return the agents' true errors (N,) of position or velocity [m or m/s]."""
        seen, truth = batch.seen, batch.truth
        if self._by_velocity:
            wanted = seen[..., 9:12] + seen[..., 3:6]
            return _length(wanted - _velocity_ned(truth))
        goal = seen[..., 9:12] + seen[..., 0:3]
        return _length(goal - truth["position_ned"])

    def state(self) -> dict[str, Floats]:
        """Return {}: nothing is learned."""
        return {}

    def restore(self, state: dict[str, object]) -> None:
        """Do nothing: there is no state."""


class Caught(Reached):
    """Reward for cats near the mouse, by the offsets that they observe."""

    def errors(self, batch: Batch) -> Floats:
        """Return the observed distances (N,) [m] to the nearest mouse less that of a catch, at least 0."""
        play = batch.functional.play
        mice = sum(name.startswith("mouse_") for name in observed_names(play)) // 2
        offsets = batch.seen[..., 4 : 4 + 2 * mice].reshape(-1, mice, 2)
        task: Any = play.task
        catch = float(task.reach) * float(play.world.collision_distance)
        found: Floats = np.maximum(np.sqrt(np.square(offsets).sum(axis=-1)).min(axis=1) - catch, 0.0)
        return found

    def shared(self, reward: Floats, agents: int) -> Floats:
        """Return the rewards (N,) half as given and half averaged over each team of ``agents``."""
        teams = reward.reshape(-1, agents)
        found: Floats = (0.5 * teams + 0.5 * teams.mean(axis=1, keepdims=True)).ravel()
        return found


def _length(vectors: Floats) -> Floats:
    """Return the lengths (B n,) of vectors (B, n, 3)."""
    found: Floats = np.sqrt(np.square(vectors).sum(axis=-1)).ravel()
    return found


def _velocity_ned(truth: dict[str, Floats]) -> Floats:
    """Rotate the true body velocities to NED, (B, n, 3)."""
    roll, pitch, yaw = np.moveaxis(truth["attitude"], -1, 0)
    x, y, z = np.moveaxis(truth["velocity_body"], -1, 0)
    right, below = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    ahead, down = np.cos(pitch) * x + np.sin(pitch) * below, np.cos(pitch) * below - np.sin(pitch) * x
    return np.stack(
        [np.cos(yaw) * ahead - np.sin(yaw) * right, np.sin(yaw) * ahead + np.cos(yaw) * right, down], axis=-1
    )


class Scaled:
    """The task's own reward over the running standard deviation of its discounted sum."""

    def __init__(self, batch: Batch, discount: float):
        self._discount = discount
        self._sum = np.zeros(0)
        # Number of sums, their mean, and the sum of their squared differences from it.
        self._count, self._mean, self._squares = 1e-4, 0.0, 1e-4

    def begin(self, batch: Batch) -> None:
        """Allocate the running returns, on the first call."""
        size = batch.size * len(batch.functional.agents)
        if len(self._sum) != size:
            self._sum = np.zeros(size)

    def reward(self, batch: Batch, reward: Floats, terminated: Floats, outputs: Floats) -> Floats:
        """Return the task's rewards (N,), scaled by the standard deviation of discounted returns."""
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
        """Return the moments of the returns."""
        return {"reward_moments": np.array([self._count, self._mean, self._squares])}

    def restore(self, state: dict[str, Any]) -> None:
        """Set the moments of the returns."""
        self._count, self._mean, self._squares = map(float, state["reward_moments"])
