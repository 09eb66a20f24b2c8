"""Trainings with the settings that suit their task: what ``qrsim train`` does unless it is told otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from qrsim.envs.functional import Functional
from qrsim.studies.learn.ppo import Settings
from qrsim.studies.learn.starting import BASELINE
from qrsim.studies.learn.training import Plan
from qrsim.tasks.formation import KeepFormation
from qrsim.tasks.landing import Land
from qrsim.tasks.pursuit import Pursuit
from qrsim.tasks.search import Search
from qrsim.tasks.simple import is_direct

# Decisions of 1 s, whose consequences are fewer; noise that cats a few metres from each other survive.
PURSUIT = Settings(discount=0.97, epochs=4, minibatches=8, spread=0.3, averaged=0.9)
# From a policy that flies well: small changes of it; in a pursuit a network with room for what the baseline computes.
STARTED: dict[str, Any] = {"spread": 0.03, "rate": 1e-4, "falling": True}
STARTED_PURSUIT: dict[str, Any] = {"width": 64, "rate": 3e-4}
# Decisions of a pursuit that is started with a policy; longer trainings were not measured with these settings.
STARTED_STEPS = 2_400_000
# Episodes in which policies are tried: so many that a crash in a hundred is seen.
STARTED_TRIES = 200
# Cats come near each other and the mouse in this time [s], from which half of the episodes are learned.
EARLY_S = 40.0
# Where episodes are learned in shorter ones: policies are tried in more of these, and in fewer whole ones.
STARTS, WHOLE_TRIES = 1000, 64
# Length of the episodes that pursuits are learned in [s]: most crashes come early. Policies are tried in whole ones.
SHORTER_S = 200.0
# Noise with which a vehicle near the ground seldom tips over.
LANDING = Settings(spread=0.4)
# Decisions of 0.2 s and more: fewer samples, and more passes over them.
SLOW, SLOW_ENVS = Settings(epochs=4, minibatches=8, spread=0.4), 64
# Rates and motors, decided every 0.02 s: a longer horizon, and a rate that falls, so that noise does not move the last
# policy from its spot. They are learned in episodes of this length [s], so that policies are tried more often.
DIRECT_SETTINGS = Settings(discount=0.99, epochs=2, averaged=0.9, falling=True)
# They start with the baseline: from nothing some seeds learn to stay upright, and not to stay at the spot.
DIRECT_S, DIRECT_ENVS, DIRECT_STEPS = 20.0, 256, 3_500_000
# Episodes side by side: fewer of a team, so that the policy is improved more often for the same decisions.
ENVS, PURSUIT_ENVS = 512, 128
SUITED: dict[type, tuple[Settings, int]] = {
    Pursuit: (PURSUIT, PURSUIT_ENVS),
    Land: (LANDING, ENVS),
    KeepFormation: (SLOW, SLOW_ENVS),
    Search: (SLOW, SLOW_ENVS),
}


def plan_of(task: Any, overrides: tuple[str, ...] = (), envs: int | None = None, **changes: Any) -> Plan:
    """Return the training plan suited to a task: scenario, number of environments and PPO settings.

    Args:
        task, overrides: as of ``Plan``.
        envs: episodes side by side; None: as many as suit the task.
        changes: other fields of the plan.

    Raises:
        UsageError, ScenarioError: there is no such task.
    """
    play = Functional.of(task, overrides).play
    kind: Any = play.task
    settings, suited = next((each for task, each in SUITED.items() if isinstance(kind, task)), (Settings(), ENVS))
    direct = is_direct(kind)
    if envs is None:
        envs = DIRECT_ENVS if direct else suited
    fields: dict[str, Any] = {"settings": settings}
    if isinstance(kind, Pursuit) and play.steps * kind.period > SHORTER_S:
        fields["shorter"] = (f"duration={SHORTER_S:g}",)
    if direct:
        fields |= {"settings": DIRECT_SETTINGS, "steps": DIRECT_STEPS, "start": BASELINE}
        if play.steps * kind.period > DIRECT_S:
            fields["shorter"] = (f"duration={DIRECT_S:g}",)
    if isinstance(kind, Pursuit) and not kind.senses:
        fields["start"] = BASELINE
    if (fields | changes).get("start") is not None:
        suits = STARTED | (STARTED_PURSUIT if isinstance(kind, Pursuit) else {})
        fields |= {"settings": replace(fields["settings"], **suits), "tries": STARTED_TRIES}
        if isinstance(kind, Pursuit):
            fields |= {"steps": STARTED_STEPS, "early": EARLY_S}
        if "shorter" in fields and not direct:
            fields |= {"starts": STARTS, "tries": WHOLE_TRIES}
    return Plan(task, overrides, envs=envs, **(fields | changes))
