"""Range-only SLAM's solver beside GTSAM's: CPU time on the same problem in the same run, and how far apart they end.

Needs GTSAM in an environment of its own: ``python benchmarks/slam_solver.py --install``.
"""

from __future__ import annotations

import os
from typing import Any

from evidence._processes import printed

DOC = "CPU time of range-only SLAM over that of GTSAM on the same problem; the solutions' distance and cost"
NUMBERS = ("states", "ours_cpu_s", "theirs_cpu_s", "ours_to_theirs", "ours_iterations", "theirs_iterations", "apart_m")


def run(full: bool) -> dict[str, Any]:
    """Return the rows by problem; the small form only sees that it works."""
    rows = printed("slam_solver", *([] if full else ["--quick"]))
    return {"load_average": os.getloadavg()[0], **by_problem(rows)}


def by_problem(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows as linear or poses -> seconds of the flight -> numbers that are there."""
    found: dict[str, Any] = {"linear": {}, "poses": {}}
    for row in rows:
        name, _, seconds = row["problem"].removesuffix(" s").partition(", ")
        told = {key: row[key] for key in (*NUMBERS, "cost_apart") if row[key] is not None}
        found[name][f"flight_{seconds}_s"] = told
    return found
