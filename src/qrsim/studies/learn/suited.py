"""Trainings with the settings that suit their task: what ``qrsim train`` does unless it is told otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from qrsim.envs.functional import Functional
from qrsim.studies.learn.ppo import Settings
from qrsim.studies.learn.starting import BASELINE
from qrsim.studies.learn.training import Plan
from qrsim.tasks.landing import Land
from qrsim.tasks.pursuit import Pursuit

# Decisions of 1 s, whose consequences are fewer; noise that cats a few metres from each other survive.
PURSUIT = Settings(discount=0.97, epochs=4, minibatches=8, spread=0.3, averaged=0.9)
# From a policy that flies well: a network with room for what the baseline computes, and small changes of it.
STARTED: dict[str, Any] = {"spread": 0.03, "rate": 1e-4, "falling": True}
STARTED_WIDTH = 48
# Episodes in which policies are tried: so many that a crash in a hundred is seen.
STARTED_TRIES = 200
# Noise with which a vehicle near the ground seldom tips over.
LANDING = Settings(spread=0.4)
# Episodes side by side: fewer of a team, so that the policy is improved more often for the same decisions.
ENVS, PURSUIT_ENVS = 512, 128


def plan_of(task: Any, overrides: tuple[str, ...] = (), envs: int | None = None, **changes: Any) -> Plan:
    """Return the plan of a training of a task: scenario, sizes and settings.

    Args:
        task, overrides: as of ``Plan``.
        envs: episodes side by side; None: as many as suit the task.
        changes: other fields of the plan.

    Raises:
        UsageError, ScenarioError: there is no such task.
    """
    kind = Functional.of(task, overrides).play.task
    pursues = isinstance(kind, Pursuit)
    settings = PURSUIT if pursues else LANDING if isinstance(kind, Land) else Settings()
    if envs is None:
        envs = PURSUIT_ENVS if pursues else ENVS
    suited: dict[str, Any] = {"settings": settings}
    if isinstance(kind, Pursuit) and not kind.senses:
        suited["start"] = BASELINE
    if (suited | changes).get("start") is not None:
        width = STARTED_WIDTH if pursues else settings.width
        suited |= {"settings": replace(settings, width=width, **STARTED), "tries": STARTED_TRIES}
    return Plan(task, overrides, envs=envs, **(suited | changes))
