"""Policies of a scenario's task: its baseline, or what ``qrsim train`` has learned."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qrsim.scenarios.scenario import Scenario

if TYPE_CHECKING:
    from qrsim.tasks.baselines import BaselinePolicy


def task_policy(scenario: Scenario, source: str, seed: int, precision: str) -> tuple[BaselinePolicy, int]:
    """Return the policy named ``source`` of a scenario's task (its baseline or a learned one), and the ticks between
    its calls.

    Args:
        scenario: with a task.
        source: "baseline", or the name of a policy file.
        seed: of what the policy does at random.
        precision: of the flight.

    Raises:
        UsageError: the scenario has no task, its task has no baseline, or the file is of another task or damaged.
    """
    from qrsim.envs import VERSION
    from qrsim.envs.learned import play_of
    from qrsim.tasks.baselines import BaselinePolicy
    from qrsim.tasks.learned import is_policy_file, read_policy

    play = play_of(scenario, f"--policy {source}", precision)
    make = read_policy(source).maker(play, scenario.name, VERSION) if is_policy_file(source) else None
    return BaselinePolicy(play, seed, make), play.ticks
