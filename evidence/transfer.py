"""Training for the field: policies learned in calm air with exact sensors, against ones learned in wind with noise.

Both learn keep_spot with the defaults of ``qrsim train``, and with ``--integral``, several seeds of each. Each then
flies the same new episodes in both places. The field has a mean wind from any direction, gusts, and the sensors of the
published task.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from evidence.tasks import summary
from qrsim.studies.learn.training import Plan, Training
from qrsim.tasks.learned import PolicyFile, forward

DOC = "keep_spot learned in calm air with exact sensors, against learned in wind with noise, both flown in both"
SEEDS, TRIALS, STEPS = 3, 200, 600_000
WIND = 5.0
EXACT = ("gnss", "barometer", "attitude", "gyroscope", "accelerometer")
CALM: dict[str, Any] = {
    "name": "keep_spot",
    "extends": "keep_spot",
    "world": {"turbulence": {"type": "still"}},
    "fleets": {
        "pelicans": {
            "vehicle": {"type": "pelican", "process_noise": 0.0},
            "sensors": {name: {"type": f"ideal_{name}"} for name in EXACT},
        }
    },
}
FIELD: dict[str, Any] = {
    "name": "keep_spot",
    "extends": "keep_spot",
    "world": {"wind": {"type": "log_shear", "speed_20ft": WIND, "wind_from_deg": 0.0}},
    "ranges": [{"path": "world.wind.wind_from_deg", "low": 0.0, "high": 360.0}],
}
PLACES = {"calm": CALM, "field": FIELD}
# Whether the integral of the offset is an input.
VIEWS = {"plain": False, "integral": True}


def run(full: bool) -> dict[str, Any]:
    """Return how each policy does in each place; the small form trains one seed in calm air, briefly."""
    seeds, steps, trials = (SEEDS, STEPS, TRIALS) if full else (1, 100_000, 32)
    found: dict[str, Any] = {"seeds": seeds, "trials": trials, "steps": steps, "wind_mps": WIND}
    for view, integral in VIEWS.items() if full else (("plain", False),):
        plans = {place: Plan(scenario, steps=steps, integral=integral) for place, scenario in PLACES.items()}
        where = {place: Training(replace(plan, envs=1, tries=1)).flights_of(trials) for place, plan in plans.items()}
        for learned in PLACES if full else ("calm",):
            for seed in range(seeds):
                training = Training(replace(plans[learned], seed=seed))
                list(training.cycles())
                assert training.best is not None
                policy = training.best[0]
                flights = {place: flown(policy, each, trials) for place, each in where.items()}
                found[f"{learned}_{view}_seed_{seed}"] = flights
    return found


def flown(policy: PolicyFile, flights: Any, trials: int) -> dict[str, float]:
    """Return the returns of a policy in new episodes, and the part flown to the end."""
    total, alive = flights.fly(lambda seen: forward(policy.layers, policy.scaling.scaled(seen)), np.arange(trials))
    return summary(total, alive)
