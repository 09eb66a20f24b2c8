"""Ratios of speed in one run on one machine: batches, one world, bounds in C++, recording, environments, servers."""

from __future__ import annotations

from typing import Any

from evidence._processes import printed

DOC = "ratios of speed in one run: batches, one world, bounds in C++, recording, environments, servers"
SEED = 0
PARTS = ("batches", "bounds", "large_worlds", "recording", "environments", "servers")


def batches() -> dict[str, Any]:
    """Return the speed of the default scenario, in many worlds and in one, and of rotors."""
    outdoor = {row["worlds"]: row for row in printed("outdoor") if row["stage"] == "whole"}
    (rotors,) = (row for row in printed("throughput", "--vehicles", "1", "--stages", "rotors") if row["worlds"] > 1)
    return {
        "outdoor_patrol": {"measured": 1e9 / outdoor[512]["ns"]},  # vehicle-steps per CPU second
        "one_world": {"measured": outdoor[1]["tick_us"]},
        "rotors": {"measured": rotors["per_cpu_second"]},
    }


def bounds() -> dict[str, Any]:
    """Return the speed over that of steps written by hand in C++, per CPU second."""
    rows = {(row["program"], row["threads"]): row for row in printed("bound")}
    both = max(threads for _, threads in rows)
    return {
        "published": {"ratio": rows["qrsim", both]["of_bound_cpu"]},
        "filter": {"ratio": rows["qrsim, filter alone", both]["of_bound_cpu"]},
    }


def large_worlds() -> dict[str, Any]:
    """Return the speed of one large world over that of 512 worlds of 8, by the wall on all threads."""
    rows = printed("one_world", "--vehicles", "4096", "65536")
    most = max(row["threads"] for row in rows)
    chosen = {row["vehicles"]: row for row in rows if row["worlds"] == 1 and row["threads"] == most}
    return {f"vehicles_{count}": {"ratio": row["over_many_worlds"]} for count, row in chosen.items()}


def recording() -> dict[str, Any]:
    """Return the wall time of recorded flights over that of their ticks alone."""
    return {row["what"]: {"ratio": row["over_ticks"], "ticks_s": row["ticks_s"]} for row in printed("recording")}


def environments() -> dict[str, Any]:
    """Return the steps a second of 1024 environments."""
    rows = printed("envs", "--sizes", "1024", "--environments", "keep_spot", "search_and_rescue/2B")
    return {row["environment"].partition("/")[0]: {"measured": row["per_wall_second"]} for row in rows}


def servers() -> dict[str, Any]:
    """Return the CPU seconds a simulated second of servers with 30 vehicles."""
    return {name: {"measured": printed(name, "--vehicles", "30")[0]["core"]} for name in ("mavlink", "ros2")}


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return the ratios of the parts; the small form only sees that one of the benchmarks works."""
    if not full:
        (row,) = printed("recording", "--quick")
        return {"recording": {row["what"]: {"ratio": row["over_ticks"]}}}
    every = (batches, bounds, large_worlds, recording, environments, servers)
    return {part.__name__: part() for part in every if part.__name__ in parts}
