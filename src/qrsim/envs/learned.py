"""Learned policies of scenarios, for flights outside of environments."""

from __future__ import annotations

from pathlib import Path

from qrsim.envs import VERSION
from qrsim.errors import UsageError
from qrsim.scenarios.scenario import Scenario
from qrsim.tasks import Play
from qrsim.tasks.learned import PolicyFile, read_policy
from qrsim.tasks.learned_rollout import RolloutPolicy


def play_of(scenario: Scenario, what: str, precision: str = "float32") -> Play:
    """Return the task of a scenario in its world; raise UsageError if it has none (``what`` needs it).

    Args:
        scenario: with a task.
        what: needs it, for the message.
        precision: of the flight.

    Raises:
        UsageError: the scenario has no task.
    """
    if not scenario.steps:
        raise UsageError(f"{what}: scenario {scenario.name} has no task")
    return Play(scenario.task(precision), scenario.world(precision), scenario.steps)


def rollout_policy(source: str | Path, scenario: Scenario, precision: str = "float32") -> RolloutPolicy:
    """Return a learned policy from its file, for ``qrsim.rollout``; its attribute ``ticks`` is its period.

    Raises:
        UsageError: the scenario has no task, or the file is of another task or damaged.
    """
    play = play_of(scenario, f"--policy {source}", precision)
    file: PolicyFile = read_policy(source)
    file.maker(play, scenario.name, VERSION)
    return RolloutPolicy(file, play)
