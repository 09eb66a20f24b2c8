"""CPU time of range-only SLAM beside GTSAM on the same problem, each on one core, in the same run.

Of 'linear', both get the whitened Jacobians of one iteration with all states and solve for the step. Of 'poses', both
minimise the same cost from the same start with factors of their own: GTSAM's poses have six numbers, of which roll and
pitch are held, and ours four. GTSAM lives in an environment of its own; ``--install`` makes it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import _common
import peers

SEED = 20140918
STATE_PERIOD = 0.2
REPEATS = 5
HEADINGS = {
    "problem": "problem",
    "states": "states",
    "ours_cpu_s": "ours [CPU s]",
    "theirs_cpu_s": "GTSAM's",
    "ours_to_theirs": "ours/theirs",
    "ours_iterations": "iter., ours",
    "theirs_iterations": "theirs",
    "apart_m": "apart [m]",
    "cost_apart": "cost, ours-theirs",
    "note": "theirs by",
}


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what it returns, and the shortest time [s] of the processor; compiled before."""
    work()
    best = float("inf")
    for _ in range(REPEATS):
        began = time.process_time()
        found = work()
        best = min(best, time.process_time() - began)
    return found, best


def problem(seconds: float, states: str) -> tuple[Any, Any, Any]:
    """Return the graph, the states and the landmarks at which the iterations begin, of one flight of the example."""
    from qrsim.studies.slam import example, graph, study

    (flight,) = study.fly(range(SEED, SEED + 1), duration=seconds, state_period=STATE_PERIOD)["coloured"]
    ranging = example.ranging_of(flight, SEED)
    active = (ranging.per_landmark >= 3).astype(np.float64)
    made, x = graph.make_graph(
        flight,
        ranging,
        active,
        graph="gnss",
        states=states,
        prior="estimate",
        fix_std=flight.fix_std,
        bias_time_constant=None,
    )
    return made, x, ranging.guess_ned


def linear(seconds: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return our row of one iteration's linear problem, and what the other side is given."""
    import jax
    import jax.numpy as jnp

    from qrsim.studies.slam import graph as graphs
    from qrsim.studies.slam import solve

    made, x, guess = problem(seconds, "full")
    reached = solve.solve(made, x, guess, 100).point
    with jax.enable_x64(True):
        slopes = jax.block_until_ready(graphs._jacobians(made, jnp.asarray(x), jnp.asarray(reached.landmarks)))
        normal = graphs._normal_equations(made, slopes)
        none = solve.Damping.of(normal, "metres", 0.0)

        def work() -> Any:
            return solve.step(graphs._normal_equations(made, slopes), none)

        (dx, da), seconds = timed(work)
    motion, prior, ranges, fixes = (np.asarray(part) for part in slopes.residuals)
    given = {
        "motion": slopes.motion,
        "whiten": made.whiten,
        "motion_residual": motion,
        "prior_residual": prior,
        "prior_weight": made.prior_weight,
        "range_weight": made.range_weight,
        "range_residual": ranges,
        "range_position": slopes.range_position,
        "range_landmark": slopes.range_landmark,
        "fix": slopes.fix,
        "fix_residual": fixes,
        "fix_weight": made.fix_weight,
    }
    own = {"cpu_s": seconds, "iterations": 1, "x": dx, "landmarks": da}
    return own, {name: np.asarray(value) for name, value in given.items()}


def poses(seconds: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return our row of the whole minimisation with poses, and what the other side is given."""
    from qrsim.studies.slam import solve

    made, x, guess = problem(seconds, "poses")
    found, cpu = timed(lambda: solve.solve(made, x, guess, 100))
    nominal = np.asarray(made.nominal)
    step, yaw = np.diff(nominal, axis=0), nominal[:-1, 5]
    cos, sin = np.cos(yaw), np.sin(yaw)
    moves = [cos * step[:, 0] + sin * step[:, 1], -sin * step[:, 0] + cos * step[:, 1], step[:, 2], step[:, 5]]
    # Of the factors' own covariance, which is diagonal and the same along and across.
    inverse = np.linalg.inv(np.asarray(made.whiten))
    given = {
        "moves": np.stack(moves, axis=1),
        "motion_std": np.sqrt(np.einsum("tij,tij->ti", inverse, inverse)),
        "prior_mean": made.prior_mean,
        "prior_weight": made.prior_weight,
        "ranges": made.ranges,
        "range_weight": made.range_weight,
        "fixes": made.fixes,
        "fix_weight": made.fix_weight,
        "x": x,
        "landmarks": guess,
    }
    own = {"cpu_s": cpu, "iterations": found.iterations, "x": found.point.x, "landmarks": found.point.landmarks}
    own["cost"] = found.point.cost
    return own, {name: np.asarray(value) for name, value in given.items()}


def theirs(given: dict[str, Any]) -> dict[str, Any]:
    """Return what GTSAM finds, in a process of its own on this core.

    Raises:
        RuntimeError: it failed; the last line of its errors is the message.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("given.npz", "found.npz")]
        np.savez(files[0], **given)
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QRSIM", "JAX"))}
        script = peers.FOLDER / "_peer_gtsam.py"
        words = [str(peers.python_of(peers.environment("gtsam"))), str(script), *map(str, files)]
        done = subprocess.run(words, capture_output=True, text=True, env=clean, check=False)
        if done.returncode:
            raise RuntimeError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
        with np.load(files[1]) as found:
            return {**json.loads(done.stdout.splitlines()[-1]), **dict(found)}


def row(name: str, seconds: float, there: bool) -> dict[str, Any]:
    """Return one row of the table."""
    own, given = (linear if name == "linear" else poses)(seconds)
    blank: dict[str, Any] = dict.fromkeys(HEADINGS)
    blank |= {"problem": f"{name}, {seconds:g} s", "states": len(own["x"])}
    blank |= {"ours_cpu_s": own["cpu_s"], "ours_iterations": own["iterations"], "note": ""}
    if not there:
        return blank | {"note": "not installed: python benchmarks/slam_solver.py --install"}
    try:
        found = theirs(given)
    except RuntimeError as error:
        return blank | {"note": f"did not run: {error}"}
    return blank | {
        "theirs_cpu_s": found["cpu_s"],
        "ours_to_theirs": own["cpu_s"] / found["cpu_s"],
        "theirs_iterations": found["iterations"],
        "apart_m": float(np.abs(own["x"][:, :3] - found["x"][:, :3]).max()),
        "cost_apart": own["cost"] - found["cost"] if "cost" in own else None,
        "note": found["chosen"],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--install", action="store_true", help="make GTSAM's environment if missing, then measure")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(arguments)
    peer = peers.Peer("gtsam", "", "", 1, 1, module="gtsam")
    if chosen.install and not peers.installed(peer):
        peers.install("gtsam")
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {0})
    on, there = _common.machine(), peers.installed(peer)
    flights = (4.0,) if chosen.quick else (120.0, 900.0)
    results = [row(name, seconds, there) for name in ("linear", "poses") for seconds in flights]
    title = "Range-only SLAM: CPU time, ours over GTSAM's, the same problem on one core"
    _common.publish("slam_solver", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    sys.exit(main())
