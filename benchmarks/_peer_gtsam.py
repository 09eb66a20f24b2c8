"""Solves a problem of slam_solver.py with GTSAM; run by the Python of an environment that has it. Arguments: IN OUT.

IN is an .npz file of that benchmark. Of 'linear', the whitened Jacobians of one iteration are JacobianFactors, solved
by multifrontal elimination; of 'poses', GTSAM's own factors of a Pose3 chain are minimised by its Levenberg-Marquardt.
OUT gets the solution; times go to the standard output as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

REPEATS = 5


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what it returns and the shortest time [s] of the processor over a few times."""
    best = float("inf")
    for _ in range(REPEATS):
        began = time.process_time()
        found = work()
        best = min(best, time.process_time() - began)
    return found, best


def seen(given: Any) -> list[int]:
    """Return the numbers of the landmarks that have ranges."""
    return [int(i) for i in np.flatnonzero((given["range_weight"] > 0.0).any(axis=0))]


def linear_graph(given: Any) -> gtsam.GaussianFactorGraph:
    """Return the linear problem of one iteration: motions, prior, ranges and fixes, whitened."""
    found = gtsam.GaussianFactorGraph()
    steps, size = given["motion"].shape[:2]
    unit = {n: gtsam.noiseModel.Unit.Create(n) for n in {1, 2, 3, size}}
    for k in range(steps):
        before, after, right = given["motion"][k], given["whiten"][k], -given["motion_residual"][k]
        found.add(gtsam.JacobianFactor(X(k), before, X(k + 1), after, right, unit[size]))
    found.add(gtsam.JacobianFactor(X(0), np.diag(given["prior_weight"]), -given["prior_residual"], unit[size]))
    for k, i in np.argwhere(given["range_weight"] > 0.0):
        row = np.zeros((1, size))
        row[0, :3] = given["range_position"][k, i]
        by_landmark, right = given["range_landmark"][k, i][None], -given["range_residual"][k, i][None]
        found.add(gtsam.JacobianFactor(X(k), row, L(i), by_landmark, right, unit[1]))
    for k in np.flatnonzero(given["fix_weight"] > 0.0):
        found.add(gtsam.JacobianFactor(X(k), given["fix"][k], -given["fix_residual"][k], unit[2]))
    return found


def linear(given: Any) -> dict[str, Any]:
    """Solve the linear problem, with the order of elimination found beforehand, the better one of two."""
    graph = linear_graph(given)
    states, landmarks = len(given["motion"]) + 1, seen(given)
    natural = gtsam.Ordering()
    for key in [*(X(k) for k in range(states)), *(L(i) for i in landmarks)]:
        natural.push_back(key)
    orders = {"COLAMD": gtsam.Ordering.ColamdGaussianFactorGraph(graph), "natural": natural}
    times = {}
    for name, order in orders.items():
        found, times[name] = timed(lambda order=order: graph.optimize(order))
    best = min(times, key=times.__getitem__)
    x = np.array([found.at(X(k)) for k in range(states)])
    return {"cpu_s": times[best], "chosen": best, "iterations": 1, "x": x}


def poses_graph(given: Any) -> gtsam.NonlinearFactorGraph:
    """Return the problem of poses; roll and pitch, which the other side does not have, are held at zero."""
    found = gtsam.NonlinearFactorGraph()
    held = 1e-6
    sigma = given["motion_std"]  # (T, 4) north, east, down, heading
    moves = given["moves"]  # (T, 4) forward, right, down [m] and turn [rad], in the frame of the pose before
    for k, (forward, right, down, turn) in enumerate(moves):
        model = gtsam.noiseModel.Diagonal.Sigmas(np.array([held, held, sigma[k, 3], *sigma[k, :3]]))
        move = gtsam.Pose3(gtsam.Rot3.Yaw(turn), np.array([forward, right, down]))
        found.add(gtsam.BetweenFactorPose3(X(k), X(k + 1), move, model))
    deviations = 1.0 / given["prior_weight"]
    mean = given["prior_mean"]
    model = gtsam.noiseModel.Diagonal.Sigmas(np.array([held, held, deviations[3], *deviations[:3]]))
    found.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(gtsam.Rot3.Yaw(mean[3]), mean[:3]), model))
    for k, i in np.argwhere(given["range_weight"] > 0.0):
        model = gtsam.noiseModel.Isotropic.Sigma(1, 1.0 / given["range_weight"][k, i])
        found.add(gtsam.RangeFactor3D(X(k), L(i), given["ranges"][k, i], model))
    for k in np.flatnonzero(given["fix_weight"] > 0.0):
        std = 1.0 / given["fix_weight"][k]
        model = gtsam.noiseModel.Diagonal.Sigmas(np.array([std, std, 1e4]))  # no height in a fix
        found.add(gtsam.GPSFactor(X(k), np.array([*given["fixes"][k], given["x"][k, 2]]), model))
    return found


def poses(given: Any) -> dict[str, Any]:
    """Minimise the cost of poses from where the other side begins."""
    graph, start = poses_graph(given), gtsam.Values()
    for k, (north, east, down, heading) in enumerate(given["x"]):
        start.insert(X(k), gtsam.Pose3(gtsam.Rot3.Yaw(heading), np.array([north, east, down])))
    for i in seen(given):
        start.insert(L(i), given["landmarks"][i])
    best: dict[str, Any] = {}
    for name, settings in minimisers().items():

        def work(settings: Any = settings) -> tuple[Any, int]:
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, settings)
            return optimizer.optimize(), optimizer.iterations()

        (found, iterations), seconds = timed(work)
        told = {"cpu_s": seconds, "iterations": iterations, "chosen": name, "cost": graph.error(found)}
        if (
            not best
            or told["cost"] < best["cost"] - 1e-3
            or (told["cost"] < best["cost"] + 1e-3 and seconds < best["cpu_s"])
        ):
            states = [found.atPose3(X(k)) for k in range(len(given["x"]))]
            places = given["landmarks"].copy()
            for i in seen(given):
                places[i] = found.atPoint3(L(i))
            x = np.array([[*pose.translation(), pose.rotation().yaw()] for pose in states])
            best = told | {"x": x, "landmarks": places}
    return best


def minimisers() -> dict[str, Any]:
    """Return settings of Levenberg-Marquardt by name: each of its two dampings, with each of its two defaults."""
    found = {}
    for name, make in (
        ("legacy", gtsam.LevenbergMarquardtParams.LegacyDefaults),
        ("ceres", gtsam.LevenbergMarquardtParams.CeresDefaults),
    ):
        for damping in ("identity", "diagonal"):
            settings = make()
            settings.setDiagonalDamping(damping == "diagonal")
            settings.setMaxIterations(100)
            settings.setRelativeErrorTol(1e-9)
            settings.setAbsoluteErrorTol(1e-9)
            found[f"{name}, {damping}"] = settings
    return found


def main() -> None:
    """Solve and print."""
    with np.load(sys.argv[1]) as file:
        given = dict(file)
    found = linear(given) if "motion_residual" in given else poses(given)
    np.savez(sys.argv[2], **{name: found.pop(name) for name in ("x", "landmarks") if name in found})
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
