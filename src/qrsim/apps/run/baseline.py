"""The policy that comes with a scenario's task."""

from __future__ import annotations

from typing import Any

from qrsim.errors import UsageError
from qrsim.scenarios.scenario import Scenario


def baseline_policy(scenario: Scenario, seed: int, precision: str) -> tuple[Any, int]:
    """Return the baseline of a scenario's task, and its period in ticks.

    Raises:
        UsageError: the scenario has no task, or its task has no baseline.
    """
    from qrsim.tasks import Play
    from qrsim.tasks.baselines import BaselinePolicy

    if not scenario.steps:
        raise UsageError(f"--policy baseline: scenario {scenario.name} has no task")
    play = Play(scenario.task(precision), scenario.world(precision), scenario.steps)
    return BaselinePolicy(play, seed), play.ticks
