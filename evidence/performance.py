"""Speed: what the benchmarks of throughput, latency and serving print, and the memory of a million ticks."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax

import qrsim
from evidence.rollout import peak_bytes

DOC = "vehicle-steps per second by stage, latency of one step, memory, compilation, against XLA on the same machine"
SEED = 0
BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
VEHICLES = ("1", "1000")
TICKS = 1_000_000


def printed(name: str, *words: str, **environment: str) -> list[dict[str, Any]]:
    """Return the rows that a benchmark prints."""
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), "--json", *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, **environment})
    rows: list[dict[str, Any]] = json.loads(done.stdout)["results"]
    return rows


def by_stage(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows of throughput as worlds and vehicles in each -> stage -> numbers."""
    found: dict[str, Any] = {}
    for row in rows:
        where = f"{row['worlds']}x{row['vehicles'] // row['worlds']}"
        numbers = ("per_wall_second", "per_cpu_second", "compile_seconds", "flying")
        found.setdefault(where, {})[row["stage"]] = {key: row[key] for key in numbers}
    return found


def memory(ticks: int) -> dict[str, Any]:
    """Return the largest resident set before and after many ticks of the default scenario, and bytes per vehicle."""
    simulation = qrsim.load("outdoor_patrol")
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
        "load_average": os.getloadavg()[0],
    }
    everything = results["throughput"]["512x8"]["everything"]  # type: ignore[index]
    results["times_xla"] = everything["per_wall_second"] / results["xla"]["512x8"]["everything"]["per_wall_second"]  # type: ignore[index]
    one = results["throughput"]["1x1000"]  # type: ignore[index]
    results["collisions_share"] = 1.0 - one["everything"]["per_cpu_second"] / one["gnss"]["per_cpu_second"]
    return results
