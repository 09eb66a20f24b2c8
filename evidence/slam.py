"""Range-only SLAM under white and under coloured GNSS noise: what docs/explanation/slam_results.md says of both graphs.

Every flight has its own seed; both noises of a seed share waypoints, landmarks, guesses and the noise of the ranges.
Differences are tested pair by pair with Wilcoxon's signed ranks (two-sided); means have Student t intervals, slopes and
the part that the remedy recovers percentile bootstrap intervals over seeds, all of 95 %.
"""

from __future__ import annotations

import pickle
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evidence._processes import program
from qrsim.studies.slam import example, intervals
from qrsim.studies.slam import study as studies
from qrsim.studies.slam.study import Study

DOC = "errors of range-only SLAM under white and coloured GNSS noise, with paired tests; time and memory"
SEED = 20140918
# Seeds, seconds of each flight, states per second; the small form solves for poses only.
FULL, SMALL = (50, 120.0, 5), (8, 30.0, 5)
# Seeds of the sweep over correlation times.
SWEPT = 25
# Flights whose time and memory are measured [s].
LONG = (120.0, 900.0, 3600.0)

PROGRAM = """
import json, pickle, sys, time
from pathlib import Path
from evidence._processes import peak_bytes
from qrsim.studies.slam.estimate import estimate
from qrsim.studies.slam.memory import bytes_needed

flight, ranging = pickle.loads(Path(sys.argv[1]).read_bytes())
before = peak_bytes()
# Compiles.
estimate(flight, ranging, iterations=1)
begun = time.perf_counter()
ten = estimate(flight, ranging, iterations=10, damping="diagonal")
wall = time.perf_counter() - begun
begun = time.perf_counter()
whole = estimate(flight, ranging)
print(json.dumps({
    "seconds": float(flight.time[-1]),
    "states": len(flight.truth),
    "iterations": ten.iterations,
    "ten_iterations_s": round(wall, 2),
    "whole_iterations": whole.iterations,
    "whole_s": round(time.perf_counter() - begun, 2),
    "not_converged": int(not whole.converged),
    "trajectory_m": whole.trajectory_rmse_m,
    "bytes": peak_bytes() - before,
    "stated_bytes": bytes_needed(len(flight.truth), 13, ranging.ranges.shape[1]),
}))
"""


def measured(seconds: float) -> dict[str, Any]:
    """Return time and memory of a problem in a process of its own: of 10 iterations once compiled, and of all."""
    flight = example.coloured_flights([SEED], seconds)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight"
        path.write_bytes(pickle.dumps((flight, example.ranging_of(flight, SEED))))
        return program(PROGRAM, path)


def resources() -> dict[str, Any]:
    """Return time and memory of short and long flights, and bytes for each state more."""
    found = {f"flight_{seconds:g}_s": measured(seconds) for seconds in LONG}
    middle, longest = (found[f"flight_{seconds:g}_s"] for seconds in LONG[1:])
    more = longest["states"] - middle["states"]
    return {
        **found,
        "bytes_per_state": (longest["bytes"] - middle["bytes"]) / more,
        "stated_bytes_per_state": (longest["stated_bytes"] - middle["stated_bytes"]) / more,
    }


def studied(seeds: int, seconds: float, rate: int, states: str = "full") -> tuple[dict[str, Study], Any]:
    """Return the studies by name, and the flights that they share."""
    chosen = range(SEED, SEED + seeds)
    flights = studies.fly(chosen, duration=seconds, state_period=1.0 / rate)
    found = {graph: studies.study(graph, chosen, flights, states=states) for graph in ("gnss", "paper")}
    return found, flights


def solution_slopes(found: Study) -> dict[str, Any]:
    """Return the slopes of the Allan deviation of the solutions' errors at the fix epochs."""
    period = next(iter(found.flights.values()))[0].fix_period
    slopes: dict[str, Any] = {}
    for noise, arm in found.arms:
        errors = found.position_errors(noise, arm, period)
        slopes.setdefault(noise, {})[arm] = intervals.allan_slope(errors, period)
    return slopes


def run(full: bool) -> dict[str, Any]:
    """Return the numbers of both graphs; in full also poses, the other prior, the sweep, time and memory."""
    seeds, seconds, rate = FULL if full else SMALL
    found, flights = studied(seeds, seconds, rate, "full" if full else "poses")
    results: dict[str, Any] = {name: studies.numbers(study) for name, study in found.items()}
    if not full:
        return results
    for name, study in found.items():
        results[name]["slopes"] = solution_slopes(study)
    chosen = range(SEED, SEED + seeds)
    results["gnss_poses"] = studies.numbers(studies.study("gnss", chosen, flights, states="poses"))
    other = studies.study("paper", chosen, flights, states="poses", prior="estimate")
    results["paper_prior_estimate"] = studies.numbers(other)
    fewer = {noise: flown[:SWEPT] for noise, flown in flights.items()}
    results["sweep"] = {"seeds": SWEPT, **studies.sweep(chosen[:SWEPT], fewer, states="poses").numbers()}
    results["ambiguous_percent"] = 100.0 * ambiguous(found["gnss"])
    results["resources"] = resources()
    return results


def ambiguous(found: Study) -> float:
    """Return the part of the determined landmarks whose reflection the ranges cannot exclude, coloured noise."""
    arm = found.arms["coloured", "plain"]
    told = np.concatenate([own[known] for own, known in zip(arm.ambiguous, arm.determined, strict=True)])
    return float(told.mean())
