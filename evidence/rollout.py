"""How much memory many worlds take: a rollout in a process of its own, whose largest resident set is asked for.

Only the summaries of the flights are kept; each world is the built-in keep_spot, one vehicle with everything on.
"""

from __future__ import annotations

from typing import Any

from evidence._processes import program

DOC = "memory and time of a rollout of 10 000 worlds"
SEED = 20140916
FULL, SMALL = (10_000, 60.0), (500, 1.0)
LIMIT_BYTES = 2 * 2**30

PROGRAM = """
import json, sys, time
import qrsim
from evidence._processes import peak_bytes

worlds, seconds, seed, cores = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
qrsim.configure(cpu_devices=cores)
world = qrsim.load_scenario("keep_spot").world()
begun = time.perf_counter()
flown = qrsim.rollout(world, ticks=round(seconds / world.time_step), worlds=worlds, seed=seed)
print(json.dumps({
    "worlds": worlds,
    "seconds": seconds,
    "cores": cores,
    "wall_s": round(time.perf_counter() - begun, 1),
    "peak_bytes": peak_bytes(),
    "stopped": int((flown["reason"] != 0).sum()),
    "distance_m": float(flown["distance_m"].mean()),
}))
"""


def flown(worlds: int, seconds: float, cores: int) -> dict[str, Any]:
    """Return memory, time and outcome of a rollout in a new process."""
    return program(PROGRAM, worlds, seconds, SEED, cores)


def run(full: bool) -> dict[str, Any]:
    """Return what a rollout of many worlds takes, and what half as many take."""
    worlds, seconds = FULL if full else SMALL
    cores = 2 if full else 1
    return {
        "limit_bytes": LIMIT_BYTES,
        "all": flown(worlds, seconds, cores),
        "half": flown(worlds // 2, seconds, cores),
    }
