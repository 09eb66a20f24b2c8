"""Several controllers of one world in real time: late ticks, and how soon an order is flown."""

from __future__ import annotations

import os
from typing import Any

from evidence._processes import printed

DOC = "late ticks and the latency of orders where each vehicle of a world has a controller in a process of its own"
SEED = 0
NAMES = ("ten", "thirty")


def run(full: bool) -> dict[str, Any]:
    """Return what the benchmark prints, by the number of controllers; the small form has two of them for a second."""
    load = os.getloadavg()[0]
    rows = printed("pace", *(() if full else ("--quick",)))
    names = NAMES if full else ("two",)
    kept = ("controllers", "ticks", "overruns_percent", "latency_median_ms", "latency_p99_ms", "missed")
    found = {name: {key: row[key] for key in kept} for name, row in zip(names, rows, strict=True)}
    return {**found, "load_average": load}
