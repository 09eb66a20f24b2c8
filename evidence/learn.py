"""What ``qrsim train`` learns with its defaults on the simple tasks: ten seeds of each, tried in the same new episodes.

Each policy then flies 200 episodes that nothing was learned from and that no policy was chosen by; so do hovering and
the baseline. A vehicle within ``NEAR`` of the waypoint at the end has reached it. Times are of one process with one
thread, programs loaded; the processor's time does not depend on what else the machine does.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from evidence.returns import fly
from evidence.tasks import summary
from qrsim.envs.batch import Batch
from qrsim.envs.objective import Reached
from qrsim.envs.scoring import HOVER, maker
from qrsim.studies.learn.training import Plan, Training
from qrsim.tasks.learned import forward

DOC = "policies of qrsim train on keep_spot and goto_waypoint, ten seeds each, against the baseline"
SEEDS, TRIALS, SMALL_TRIALS = 10, 200, 8
# Decisions that each seed learns from.
STEPS = {"keep_spot": 600_000, "goto_waypoint": 2_000_000}
NEAR = 3.0
# The comparison, and each seed of each task: every part takes a minute or two.
COMPARED = "compared"
PARTS = (COMPARED, *(f"{task}_{seed}" for task in STEPS for seed in range(SEEDS)))

Values = np.ndarray[Any, Any]


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return the results of each part; the small form trains briefly in short episodes."""
    if not full:
        plan = Plan("keep_spot", ("duration=2",), envs=64, steps=4096, tries=SMALL_TRIALS)
        return {"keep_spot_seed_0": trained(plan, SMALL_TRIALS)}
    found: dict[str, Any] = {"seeds": SEEDS, "trials": TRIALS, "near_m": NEAR} if COMPARED in parts else {}
    for task, steps in STEPS.items():
        if COMPARED in parts:
            found[task] = {"steps": steps, **compared(task)}
        for seed in range(SEEDS):
            if f"{task}_{seed}" in parts:
                found[f"{task}_seed_{seed}"] = trained(Plan(task, seed=seed, steps=steps), TRIALS)
    return found


def trained(plan: Plan, trials: int) -> dict[str, float]:
    """Return how the best policy of a training does in new episodes, and what the training took."""
    training = Training(plan)
    wall, processor = time.perf_counter(), time.process_time()
    cycles = list(training.cycles())
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    assert training.best is not None
    policy, _ = training.best
    flights = training.flights_of(trials)
    total, alive = flights.fly(lambda seen: forward(policy.layers, policy.scaling.scaled(seen)), np.arange(trials))
    return {
        "decisions": cycles[-1].steps,
        "wall_s": round(wall, 1),
        "processor_s": round(processor, 1),
        "near": float(np.mean(alive & (distances(flights.batch) <= NEAR))),
        **summary(total, alive),
    }


def compared(task: str) -> dict[str, Any]:
    """Return how hovering and the baseline do in the same episodes, and the part that ends near the goal."""
    found = {}
    for name in (HOVER, "baseline"):
        batch = Batch(task, TRIALS, ["task.period=0.1"])
        play = batch.functional.play
        policies = [maker(name, play)(play, seed) for seed in range(TRIALS)]

        def act(_: int, seen: Values, policies: list[Any] = policies) -> Values:
            """Return the actions of all."""
            return np.stack([policy.act(each) for policy, each in zip(policies, seen, strict=True)])

        total, alive = fly(batch, act)
        found[name] = {"near": float(np.mean(alive & (distances(batch) <= NEAR))), **summary(total, alive)}
    return found


def distances(batch: Batch) -> Values:
    """Return the true distances (B,) from the goal now [m]."""
    return Reached(batch, 1.0).errors(batch)
