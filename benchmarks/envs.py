"""How many environment steps a second: keep_spot and search_and_rescue/2B through gymnasium.make_vec, beside CartPole.

A step of keep_spot is one tick of 0.02 s, one of search_and_rescue/2B is 50 ticks, a picture of the camera and who was
found. All are measured in one process, one after the other: Python's own work, the copies of what is seen and the
episodes that end and begin again are part of it. CartPole is Gymnasium's own vector environment, in NumPy.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import _common

SIZES = (1, 64, 1024, 16384)
ENVIRONMENTS = {
    "keep_spot": "qrsim/keep_spot-v0",
    "search_and_rescue/2B": "qrsim/search_and_rescue_2B-v0",
    "CartPole": "CartPole-v1",
}
HEADINGS = {
    "environment": "environment",
    "num_envs": "num_envs",
    "per_wall_second": "steps per wall s",
    "per_cpu_second": "per CPU s",
    "simulated_per_wall_second": "simulated s per wall s",
    "first_step_seconds": "first step [s]",
}


def actions_of(name: str, size: int) -> Any:
    """Return actions (size, ...) that keep an episode going: a hover; for CartPole both pushes in turn."""
    import numpy as np

    if name == "CartPole":
        return np.arange(size) % 2
    if name == "keep_spot":
        return np.tile(np.float32(_common.HOVER), (size, 1))
    return np.zeros((size, 3), np.float32)


def measure(name: str, size: int, seconds: float, repeats: int) -> dict[str, Any]:
    """Return the row of one environment.

    Args:
        name: one of ENVIRONMENTS.
        size: how many in the batch.
        seconds: wall time that one measurement should take.
        repeats: measurements, of which the median counts.
    """
    import gymnasium
    import numpy as np

    actions = actions_of(name, size)
    begun = time.perf_counter()
    vector = gymnasium.make_vec(ENVIRONMENTS[name], num_envs=size, vectorization_mode="vector_entry_point")
    vector.reset(seed=1)
    vector.step(actions)
    first = time.perf_counter() - begun
    begun = time.perf_counter()
    vector.step(actions)
    once = time.perf_counter() - begun
    steps = max(1, round(seconds / once))
    walls, cpus = [], []
    # What takes long is measured once: its noise is small beside it.
    for _ in range(repeats if once < seconds else 1):
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(steps):
            vector.step(actions)
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    vector.close()
    rate = size * steps / float(np.median(walls))
    return {
        "environment": name,
        "num_envs": size,
        "per_wall_second": round(rate),
        "per_cpu_second": round(size * steps / float(np.median(cpus))),
        "simulated_per_wall_second": round(rate * step_seconds(vector), 1),
        "first_step_seconds": round(first, 4),
        "steps": steps,
    }


def step_seconds(vector: Any) -> float:
    """Return how much simulated time a step is [s]."""
    inner = vector.unwrapped
    return float(inner.batch.functional.play.task.period) if hasattr(inner, "batch") else float(inner.tau)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="*", metavar="N", help="num_envs (default: 1 64 1024 16384)")
    parser.add_argument("--environments", nargs="*", choices=ENVIRONMENTS, help="which (default: all)")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(arguments)
    _common.without_cache()
    on = _common.machine()
    from qrsim import envs

    envs.register()
    names = chosen.environments or (("keep_spot", "CartPole") if chosen.quick else ENVIRONMENTS)
    sizes = chosen.sizes or ((2,) if chosen.quick else SIZES)
    seconds, repeats = (0.01, 1) if chosen.quick else (1.0, 3)
    rows = [measure(name, size, seconds, repeats) for name in names for size in sizes]
    _common.publish(
        "envs",
        "Environments: steps through gymnasium.make_vec; first step: from make_vec to its end, compiling included",
        on,
        rows,
        HEADINGS,
        chosen.json,
    )


if __name__ == "__main__":
    main()
