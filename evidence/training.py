"""What can be learned: keep_spot by examples/keep_spot_ppo.py, and two tasks by PPO of Stable-Baselines3 as it comes.

Of the example learners of several seeds fly the same episodes to learn from. All are then tried, by the mean of their
policy, in the same episodes that are new to them, as the hover command that they begin with and the waypoint controller
are. Stable-Baselines3 learns with every setting at its default on the registered environments, several seeds of each,
up to a number of steps, or until it flies all the episodes that it is tried in to the end; it is then scored in others,
beside hovering and the baseline. It is installed in an environment of its own: see _learners.py. Means have Student t
intervals over the episodes.
"""

from __future__ import annotations

import dataclasses
import time
from functools import partial
from typing import Any

import jax
import numpy as np
from examples import keep_spot_ppo as ppo

from evidence import IMAGES
from evidence._learners import STUDIES, learned
from evidence.tasks import CONFIDENCE, summary
from qrsim.core.tree import record, replace
from qrsim.envs import Functional
from qrsim.runs.picture import new_figure, save_picture
from qrsim.tasks import KeepSpot

DOC = "return of policies learned by PPO on keep_spot, against hovering and the waypoint controller"
PARTS = ("example", *STUDIES)
# Learners, iterations, episodes of each iteration, episodes to try them in.
FULL, SMALL = (3, ppo.ITERATIONS, ppo.EPISODES, 1000), (1, 2, 16, 16)
IMAGE = IMAGES / "training.png"


@record
class Watched(KeepSpot):
    """The same task with nobody at the controls: the scenario's own controller flies, and is scored alike."""

    def commands(self, memory: Any, world: Any, action: Any) -> tuple[None, ...]:
        """Return no command for any fleet."""
        return (None,) * len(world.fleets)


def watched(env: Functional) -> Functional:
    """Return the environment whose vehicles fly themselves."""
    task = Watched(**{field.name: getattr(env.play.task, field.name) for field in dataclasses.fields(KeepSpot)})
    return dataclasses.replace(env, play=replace(env.play, task=task))


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return what each part finds; the small form is of the example only."""
    found = example(full) if "example" in parts else {}
    if full:
        found |= {name: learned(name) for name in STUDIES if name in parts}
    return found


def example(full: bool) -> dict[str, Any]:
    """Return the learning curves, and what everybody scores in new episodes; in full also what the controller does."""
    learners, iterations, episodes, trials = FULL if full else SMALL
    env = Functional.of("keep_spot", ppo.OVERRIDES)
    pilot = jax.jit(partial(ppo.fly, env))
    found: dict[str, Any] = {
        "learners": learners,
        "iterations": iterations,
        "episodes": episodes,
        "trials": trials,
        "confidence": CONFIDENCE,
        "hover": scored(pilot, ppo.hover(), trials),
    }
    for seed in range(learners):
        begun, curve, weights = time.perf_counter(), {}, ppo.hover()
        for learner, returned in ppo.train(pilot, seed, iterations, episodes):
            curve[f"iteration_{len(curve) + 1}"] = round(float(returned.mean()), 1)
            weights = learner.weights
        took = round(time.perf_counter() - begun, 1)
        found[f"learner_{seed}"] = {"curve": curve, "seconds": took, **scored(pilot, weights, trials)}
    if full:
        found["controller"] = scored(jax.jit(partial(ppo.fly, watched(env))), ppo.hover(), trials)
        save_picture(lambda: draw(found), IMAGE)
    return found


def scored(pilot: Any, weights: Any, trials: int) -> dict[str, float]:
    """Return mean, interval and median of the returns, and the part of the episodes flown to the end."""
    returned, lost = ppo.tried(pilot, weights, trials)
    return summary(np.asarray(returned, np.float64), ~np.asarray(lost))


def draw(results: dict[str, Any]) -> Any:
    """Draw the learning curves, and what hovering and the controller score."""
    figure = new_figure(7.5, 4.6)
    axes = figure.subplots()
    for seed in range(results["learners"]):
        curve = list(results[f"learner_{seed}"]["curve"].values())
        axes.plot(np.arange(1, len(curve) + 1), curve, lw=1.4, label=f"PPO, learner {seed}")
    for name, label, style in (("hover", "hover command", ":"), ("controller", "waypoint controller", "--")):
        axes.axhline(results[name]["mean"], color="black", ls=style, label=f"{label}: {results[name]['mean']:.0f}")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(top=-1.0)
    axes.set_xlabel(f"iteration, {results['episodes']} episodes of 10 s each")
    axes.set_ylabel("mean return of an episode")
    axes.set_title("keep_spot in a wind of 3 m/s from anywhere, commands at 10 Hz", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=9)
    return figure
