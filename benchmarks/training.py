"""How fast ``qrsim train`` decides and improves, relative to the bare environments: keep_spot with 1024 episodes.

The bare environments are those of ``gymnasium.make_vec`` with the same time between two actions, in a hover or with
random actions; fewer than 1 % of their steps only begin an episode, and are counted too. A training is measured over
whole cycles, without the episodes in which policies are tried after each. The three take turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

import _common

TASK, ENVS = "keep_spot", 1024
# Number of turns, seconds that the bare environments step in a turn, cycles of the training before the first turn, and
# cycles in a turn.
FULL, QUICK = (15, 1.5, 4, 2), (1, 0.1, 1, 1)
HEADINGS = {
    "what": "what",
    "num_envs": "num_envs",
    "per_wall_second": "decisions per wall s",
    "per_cpu_second": "per CPU s",
    "loop_over_it": "rate of the training / this rate",
}


def rates(act: Callable[[], int]) -> tuple[float, float]:
    """Return the decisions per second of wall time and of CPU time of ``act``, which returns how many it made."""
    wall, cpu = time.perf_counter(), time.process_time()
    count = act()
    return count / (time.perf_counter() - wall), count / (time.process_time() - cpu)


def bare(vector: Any, actions: Any, seconds: float) -> Callable[[], int]:
    """Return a function that steps the bare environments for some seconds, and returns the number of decisions."""

    def act() -> int:
        end, steps = time.perf_counter() + seconds, 0
        while time.perf_counter() < end:
            vector.step(actions[steps % len(actions)])
            steps += 1
        return steps * vector.num_envs

    return act


def loop(training: Any, cycles: Iterator[Any], count: int) -> Callable[[], int]:
    """Return a function that trains for ``count`` cycles, and returns the number of decisions."""

    def act() -> int:
        before = training.steps
        for _ in range(count):
            next(cycles)
        return int(training.steps - before)

    return act


def rows(envs: int, turns: int, seconds: float, before: int, count: int) -> list[dict[str, Any]]:
    """Return a row for the bare environments in a hover, with random actions, and for the training: medians of turns.

    Args:
        envs: episodes side by side.
        turns: number of turns.
        seconds: time that the bare environments step in a turn [s].
        before: cycles of the training before the first turn.
        count: cycles of the training in a turn.
    """
    from qrsim.envs.vector import VectorTask
    from qrsim.studies.learn.suited import plan_of
    from qrsim.studies.learn.training import Training

    training = Training(plan_of(TASK, envs=envs, steps=10**12))
    # What is measured is the loop, not the trials of its policies.
    training._outcome = lambda policy: (0.0, 0.0)  # type: ignore[method-assign]
    vector = VectorTask(TASK, envs, [f"task.period={training.view.seconds}"])
    vector.reset(seed=0)
    hover = np.tile(np.float32(_common.HOVER), (1, envs, 1))
    drawn = np.random.default_rng(0).uniform(-1.0, 1.0, (8, envs, len(_common.HOVER))).astype(np.float32)
    cycles = training.cycles()
    loop(training, cycles, before)()
    acts = {
        "bare, hover": bare(vector, hover, seconds),
        "bare, random actions": bare(vector, drawn, seconds),
        "training": loop(training, cycles, count),
    }
    each = [{what: rates(act) for what, act in acts.items()} for _ in range(turns)]
    found = {what: np.array([turn[what] for turn in each]) for what in acts}
    vector.close()
    return [
        {
            "what": what,
            "num_envs": envs,
            "per_wall_second": round(float(np.median(own[:, 0]))),
            "per_cpu_second": round(float(np.median(own[:, 1]))),
            "loop_over_it": round(float(np.median(found["training"][:, 0] / own[:, 0])), 3),
        }
        for what, own in found.items()
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    results = rows(8, *QUICK) if chosen.quick else rows(ENVS, *FULL)
    title = f"Training {TASK}, decisions of 0.1 s"
    _common.publish("training", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
