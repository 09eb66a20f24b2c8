"""Steps a second of environments: keep_spot beside those of crazyflow and PyFlyt, and what a step of ours consists of.

Parts of a step are of the processor's time, by Python's own profile, which makes what is written in Python look slower
than it is: they say where the time goes, not how much of it there is.
"""

from __future__ import annotations

import cProfile
import os
import pstats
import time
from typing import Any

import gymnasium

from evidence._processes import printed
from qrsim.envs import gymnasium_id

DOC = "environment steps a second of keep_spot, over those of crazyflow and PyFlyt in the same run; where time is lost"
# Parts of a step, each by the function that does it: its file and name.
PARTS = {
    "ticks": ("engine/backend.py", "advance"),
    "keys_of_new_episodes": ("envs/functional.py", "keys"),
    "first_states_of_new_episodes": ("tasks/episodes.py", "start"),
}
# How many environments, and the steps that are looked at.
SPLIT, STEPS, FIRST = 1024, 1000, 100


def run(full: bool) -> dict[str, Any]:
    """Return both; the small form only sees that it works."""
    return {
        "load_average": os.getloadavg()[0],
        "compared": compared(printed("env_peers", *([] if full else ["--quick"]))),
        "split": split(SPLIT, STEPS, FIRST) if full else split(8, 2000, 5),
    }


def compared(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows as num_envs -> simulator -> numbers."""
    found: dict[str, Any] = {}
    for row in rows:
        name = row["simulator"].partition("=")[0].lower()
        if row["per_wall_second"] is not None:
            keys = ["per_wall_second", "per_cpu_second", *(["ours_to_theirs"] if row["ours_to_theirs"] else [])]
            found.setdefault(f"envs_{row['num_envs']}", {})[name] = {key: row[key] for key in keys}
    return found


def split(count: int, steps: int, first: int) -> dict[str, Any]:
    """Return the wall time of a step, without profile, and which part of it goes where, with one.

    Args:
        count: environments.
        steps: that are looked at, twice.
        first: steps before.
    """
    vector = gymnasium.make_vec(gymnasium_id("keep_spot"), num_envs=count)
    vector.reset(seed=1)
    vector.action_space.seed(1)
    actions = [vector.action_space.sample() for _ in range(8)]

    def fly(number: int) -> None:
        for step in range(number):
            vector.step(actions[step % 8])

    fly(first)
    begun = time.perf_counter()
    fly(steps)
    wall = time.perf_counter() - begun
    profile = cProfile.Profile()
    profile.runcall(fly, steps)
    return {"num_envs": count, "steps": steps, "step_us": 1e6 * wall / steps, **shares(profile)}


def shares(profile: cProfile.Profile) -> dict[str, float]:
    """Return which part of the whole each of PARTS takes with all that it calls, and the rest."""
    stats = pstats.Stats(profile)
    found = dict.fromkeys(PARTS, 0.0)
    for (file, _, function), (_, _, _, cumulative, _) in stats.stats.items():  # type: ignore[attr-defined]
        for name, (where, what) in PARTS.items():
            if function == what and file.replace(os.sep, "/").endswith(f"qrsim/{where}"):
                found[name] += cumulative / stats.total_tt  # type: ignore[attr-defined]
    return found | {"rest": 1.0 - sum(found.values())}
