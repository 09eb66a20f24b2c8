"""Ratios of speed in one run on one machine: batches, one world, bounds in C++, recording, environments, servers."""

from __future__ import annotations

from typing import Any

from evidence._processes import printed

DOC = "ratios of speed in one run: batches, one world, bounds in C++, recording, environments, servers"
SEED = 0
# At commit f2c2fb2, on two cores of an AMD EPYC with AVX-512: ratios mean little on machines of another kind.
BEFORE = {
    "outdoor_patrol": 2.1e6,  # vehicle-steps per CPU second
    "one_world": 4.1,  # us of CPU time a tick
    "rotors": 3.7e6,  # vehicle-steps per CPU second
    "search_and_rescue": 32e3,  # steps per second
    "keep_spot": 1.1e6,  # steps per second
}


def batches() -> dict[str, Any]:
    """Return the speed of the default scenario and of rotors, and of each over that before."""
    outdoor = {row["worlds"]: row for row in printed("outdoor") if row["stage"] == "whole"}
    (rotors,) = printed("throughput", "--vehicles", "--stages", "rotors")
    many, one = 1e9 / outdoor[512]["ns"], outdoor[1]["tick_us"]
    return {
        "outdoor_patrol": _compared("outdoor_patrol", many),
        "one_world": {"measured": one, "ratio": one / BEFORE["one_world"]},
        "rotors": _compared("rotors", rotors["per_cpu_second"]),
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
    """Return the steps a second of 1024 environments, and over those before."""
    rows = printed("envs", "--sizes", "1024", "--environments", "keep_spot", "search_and_rescue/2B")
    rates = {row["environment"].partition("/")[0]: row["per_wall_second"] for row in rows}
    return {name: _compared(name, rate) for name, rate in rates.items()}


def servers() -> dict[str, Any]:
    """Return the CPU seconds a simulated second of servers with 30 vehicles."""
    return {name: {"measured": printed(name, "--vehicles", "30")[0]["core"]} for name in ("mavlink", "ros2")}


def run(full: bool) -> dict[str, Any]:
    """Return all ratios; the small form only sees that one of the benchmarks works."""
    if not full:
        (row,) = printed("recording", "--quick")
        return {"recording": {row["what"]: {"ratio": row["over_ticks"]}}}
    return {
        "batches": batches(),
        "bounds": bounds(),
        "large_worlds": large_worlds(),
        "recording": recording(),
        "environments": environments(),
        "servers": servers(),
    }


def _compared(name: str, measured: float) -> dict[str, float]:
    """Return a speed, and its ratio to that before."""
    return {"measured": measured, "ratio": measured / BEFORE[name]}
