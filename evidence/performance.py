"""Speed: what the benchmarks of throughput, latency and serving print, and the memory of a million ticks."""

from __future__ import annotations

import os
from typing import Any

import jax
import numpy as np

import qrsim
from evidence._processes import peak_bytes, printed

DOC = "vehicle-steps per second by stage, latency of one step, memory, compilation, against XLA on the same machine"
SEED = 0
VEHICLES = ("1", "10", "100", "1000", "4096", "65536")
NAMES_OF_LIGHT = {
    "python -c 'import jax'": "import_jax",
    "qrsim run hover, no figure": "run",
    "qrsim run hover": "with_figure",
    "qrsim run mixed_team, no figure": "recorded",
    "compile outdoor_patrol": "compile_default",
    "compile mixed_team": "compile_mixed",
}
# Collisions cost less than the machine drifts within a minute: with and without them by turns.
TURNS = 7
TICKS = 1_000_000


def by_stage(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows of throughput as worlds and vehicles in each -> stage -> numbers."""
    found: dict[str, Any] = {}
    for row in rows:
        where = f"{row['worlds']}x{row['vehicles'] // row['worlds']}"
        numbers = ("per_wall_second", "per_cpu_second", "compile_seconds", "flying")
        found.setdefault(where, {})[row["stage"]] = {key: row[key] for key in numbers}
    return found


def collisions(turns: int) -> float:
    """Return which part of a CPU second collisions take at 1000 vehicles: the median of several pairs of runs."""
    shares = []
    for _ in range(turns):
        rows = printed("throughput", "--no-many-worlds", "--vehicles", "1000", "--stages", "gnss", "everything")
        stages = by_stage(rows)["1x1000"]
        shares.append(1.0 - stages["everything"]["per_cpu_second"] / stages["gnss"]["per_cpu_second"])
    return float(np.median(shares))


def bound() -> dict[str, Any]:
    """Return what this package reaches of a step written by hand in C++."""
    rows = {(row["program"], row["threads"]): row for row in printed("bound")}
    both = max(threads for _, threads in rows)
    ours, by_hand = rows["qrsim", both], rows["bound.cc", both]
    return {
        "per_cpu_second": by_hand["per_cpu_second"],
        "per_wall_second": by_hand["per_wall_second"],
        "of_bound_cpu": ours["of_bound_cpu"],
        "of_bound_wall": ours["of_bound_wall"],
    }


def peers() -> dict[str, Any]:
    """Return steps of ours for one of each other simulator that is installed, by wall time in the same run."""
    found = {}
    for row in printed("peers"):
        if row["ours_to_theirs_steps"] is not None:
            name = "_".join([row["simulator"].partition("=")[0], row["computed"].split(",")[0].replace(" ", "_")])
            found[f"{name}_{row['processes']}"] = {
                key: row[key] for key in ("per_wall_second", "ours_to_theirs_steps", "ours_to_theirs_seconds")
            }
    return found


def light() -> dict[str, Any]:
    """Return the CPU seconds of a plain run and of compiling, over those of importing JAX."""
    keys = ("cpu_s", "over_import_jax", "real_time_factor")
    rows = printed("light")
    return {NAMES_OF_LIGHT[row["what"]]: {key: row[key] for key in keys if row[key] is not None} for row in rows}


def memory(ticks: int) -> dict[str, Any]:
    """Return the largest resident set before and after many ticks of the default scenario, and bytes per vehicle."""
    simulation = qrsim.load("patrol_published")
    simulation.reset()
    simulation.step(ticks=1000)
    before = peak_bytes()
    simulation.step(ticks=ticks)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(simulation.state))
    return {
        "ticks": ticks,
        "before_bytes": before,
        "after_bytes": peak_bytes(),
        "state_bytes_per_vehicle": round(size / simulation.size, 1),
    }


def run(full: bool) -> dict[str, Any]:
    """Return all of it; the small form only sees that it works."""
    if not full:
        return {"throughput": by_stage(printed("throughput", "--quick")), "memory": memory(10_000)}
    rows = printed("throughput", "--vehicles", *VEHICLES)
    xla = printed("throughput", "--vehicles", "1000", "--stages", "everything", QRSIM_COMPILER="xla")
    latency = {"plain": 0, "command": 1, "looked_at": 2}
    taken = printed("latency")
    keys = ("median_us", "p95_us", "p99_us")
    results = {
        "throughput": by_stage(rows),
        "xla": by_stage(xla),
        "latency": {name: {key: taken[i][key] for key in keys} for name, i in latency.items()},
        "memory": memory(TICKS),
        "light": light(),
        "load_average": os.getloadavg()[0],
    }
    everything = results["throughput"]["512x8"]["everything"]  # type: ignore[index]
    results["times_xla"] = everything["per_wall_second"] / results["xla"]["512x8"]["everything"]["per_wall_second"]  # type: ignore[index]
    results["collisions_share"], results["collisions_turns"] = collisions(TURNS), TURNS
    results["bound"] = bound()
    results["peers"] = peers()
    return results
