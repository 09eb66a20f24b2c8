"""What policies cost in a rollout, by the benchmark of that name."""

from __future__ import annotations

import os
from typing import Any

from evidence._processes import printed

DOC = "vehicle-steps per second of rollouts with compiled policies, with ones in NumPy, and with one for each team"
SEED = 0
NAMES = ("none", "compiled", "compiled_teams", "numpy", "numpy_teams", "numpy_class")


def run(full: bool) -> dict[str, Any]:
    """Return vehicle-steps per second and microseconds a call by policy and number of worlds."""
    rows = printed("policies", *([] if full else ["--quick"]))
    counts = list(dict.fromkeys(row["worlds"] for row in rows))
    found: dict[str, Any] = {name: {} for name in NAMES}
    for at, count in enumerate(counts):
        for number, name in enumerate(NAMES):
            row = rows[at * len(NAMES) + number]
            keys = ("per_wall_second", "microseconds_a_call")
            found[name][f"w{count}"] = {key: row[key] for key in keys}
    return {**found, "load_average": os.getloadavg()[0]}
