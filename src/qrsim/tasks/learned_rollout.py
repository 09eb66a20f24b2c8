"""Learned policies for rollouts: compiled into the loop of thousands of worlds."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from qrsim.core.noise import Draw, Key
from qrsim.tasks.learned import PolicyFile, forward
from qrsim.tasks.play import TASK, Play

Memory = tuple[Any, Array, Array]


class RolloutPolicy:
    """A policy of ``qrsim.rollout`` that flies a task's agents by a policy file, called once per step of the task.

    Args:
        file: the policy, checked against the task (``PolicyFile.maker``).
        play: the task and its world.

    Attributes:
        ticks: ``policy_ticks`` of the rollout.
    """

    def __init__(self, file: PolicyFile, play: Play):
        self.ticks = play.ticks
        self._file, self._play = file, play
        self._hold = max(1, round(file.view.seconds / play.task.period))

    def init(self, reading: Any) -> Memory:
        """Return the policy's memory at the start: the task's memory, remembered values (n, K), step number ()."""
        play, state = self._play, reading.state
        like = jnp.zeros((), play.world.fleets[0].start.position_ned.x.dtype)
        ids = jnp.arange(play.task.ids, dtype=jnp.uint32)
        memory = play.task.init(play.world, state, Draw(Key.root(0).stream(TASK, ids), jnp.int32(0), like))
        last = jnp.zeros((len(play.agents), self._file.view.remembered), jnp.float32)
        return memory, last, jnp.int32(0)

    def step(self, reading: Any, memory: Memory) -> tuple[dict[str, Any], Memory]:
        """Return the commands of the agents' fleet by its name, and the policy's memory after them."""
        file, play = self._file, self._play
        own, last, number = memory
        seen = play.observed(own, reading.state, number * play.ticks)
        outputs = forward(file.layers, file.scaling.scaled(file.view.features(seen, last)))
        last = jnp.where(number % self._hold == 0, file.view.remember(outputs, seen, last), last)
        action = play.scaled(file.view.action(last[:, : len(file.view.flown)], seen).astype(seen.dtype))
        commands = play.task.commands(own, play.world, action)
        names = [fleet.name for fleet in play.world.fleets]
        given = {name: each for name, each in zip(names, commands, strict=True) if each is not None}
        return given, (own, last, number + np.int32(1))
