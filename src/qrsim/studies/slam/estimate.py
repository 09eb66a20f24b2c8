"""``qrsim.slam``: the smoothed trajectory and the landmarks of a recorded flight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from qrsim.engine.settings import use_compilation_cache
from qrsim.errors import UsageError, did_you_mean, warn_user
from qrsim.runs import Run, open_run
from qrsim.studies.slam.covariance import covariance
from qrsim.studies.slam.flight import Flight, Floats
from qrsim.studies.slam.graph import GRAPHS, PRIORS, STATES, Graph, make_graph
from qrsim.studies.slam.memory import available_bytes, check_memory, state_size
from qrsim.studies.slam.mirror import Mirrors, mirrors
from qrsim.studies.slam.ranging import (
    FEWEST_RANGES,
    RANGE_LIMIT,
    RANGE_STD,
    Ranging,
    given_ranges,
    landmarks_given,
    measure_ranges,
)
from qrsim.studies.slam.solve import DAMPINGS, Point, Problem, Solution, solve

MOST_ITERATIONS = 100
# Correlation time of the simulator's gauss_markov_2 errors, to 1/e [s]: (G8),
# docs/explanation/models/gnss.md.
BIAS_TIME_CONSTANT = 44.3


@dataclass(frozen=True)
class Slam:
    """The smoothed estimate of a flight.

    Attributes:
        graph, states, prior: what was asked for.
        flight, ranging: all that went in, for an estimator of your own.
        time: (T + 1,) since the first state [s].
        position_ned: (T + 1, 3) [m].
        state: (T + 1, D) position, Euler angles, velocity and rates in body axes and thrust; for poses position and
            heading.
        bias: (T + 1, 2) estimated GNSS error, north and east [m]; None where it is not modelled.
        landmarks_ned: (L, 3) [m]; NaN where a landmark has too few ranges.
        landmarks_std: (L,) [m], the largest standard deviation in any direction.
        position_covariance: (T + 1, 3, 3) marginal covariance of the positions, north, east and down [m^2].
        landmarks_covariance: (L, 3, 3) marginal covariance of the landmarks [m^2]; NaN as in landmarks_ned.
        determined: (L,) whether the ranges say where each landmark is.
        mirrors: where each landmark's reflection fits the ranges as well, and how well.
        iterations, converged, costs: how the solution was found.
        kept: number of iterations -> the point after them.
    """

    graph: str
    states: str
    prior: str
    flight: Flight
    ranging: Ranging
    time: Floats
    position_ned: Floats
    state: Floats
    bias: Floats | None
    landmarks_ned: Floats
    landmarks_std: Floats
    position_covariance: Floats
    landmarks_covariance: Floats
    determined: npt.NDArray[np.bool_]
    mirrors: Mirrors
    iterations: int
    converged: bool
    costs: tuple[float, ...]
    kept: dict[int, Point]

    @property
    def problems(self) -> list[str]:
        """Warnings about the result, one sentence each: undetermined landmarks, no convergence."""
        found = []
        for i in np.flatnonzero(~self.determined):
            found.append(why_not_determined(int(i), int(self.ranging.per_landmark[i]), self.landmarks_std[i]))
        if not self.converged:
            found.append(f"not converged after {self.iterations} iterations")
        return found

    @property
    def trajectory_rmse_m(self) -> float:
        """Root mean square error of the estimated positions [m]."""
        return self.score(position_ned=self.position_ned)["trajectory_rmse_m"]

    @property
    def landmark_rmse_m(self) -> float:
        """Root mean square error of the landmarks that are determined [m]; NaN if the truth is unknown."""
        return self.score(landmarks_ned=self.landmarks_ned).get("landmark_rmse_m", float("nan"))

    def score(
        self, position_ned: npt.ArrayLike | None = None, landmarks_ned: npt.ArrayLike | None = None
    ) -> dict[str, float]:
        """Return the errors [m], by name, of another estimate of the same flight's positions or landmarks.

        Args:
            position_ned: (T + 1, 3) [m].
            landmarks_ned: (L, 3) [m]; those that are not determined do not count.

        Raises:
            UsageError: an array of another shape.
        """
        found: dict[str, float] = {}
        if position_ned is not None:
            truth = self.flight.truth[:, :3]
            found["trajectory_rmse_m"] = rms_distance(_shaped_as(truth, position_ned), truth)
        if landmarks_ned is not None and self.ranging.true_ned is not None:
            truth, rows = self.ranging.true_ned, self.determined
            found["landmark_rmse_m"] = rms_distance(_shaped_as(truth, landmarks_ned)[rows], truth[rows])
        return found


def _shaped_as(truth: Floats, values: npt.ArrayLike) -> Floats:
    """Convert values to an array; raises UsageError unless it has the shape of the truth."""
    array = np.asarray(values, np.float64)
    if array.shape != truth.shape:
        raise UsageError(f"score: expected an array of shape {truth.shape}, found {array.shape}")
    return array


def why_not_determined(landmark: int, ranges: int, std: float) -> str:
    """Return as text why the landmark with this index, ``ranges`` ranges and deviation is not determined.

    Args:
        landmark: its number, from 0.
        ranges: number of ranges to it.
        std: largest standard deviation of its place [m].
    """
    why = f"{ranges} range{'s' if ranges != 1 else ''}, at least {FEWEST_RANGES} needed"
    if ranges >= FEWEST_RANGES:
        why = f"its {ranges} ranges leave it uncertain by {std:.0f} m"
    return f"landmark {landmark} is not determined: {why}"


def rms_distance(places: Floats, others: Floats) -> float:
    """Return the root mean square distance between two sets of positions (N, 3) [m]; NaN if they are empty."""
    if not len(places):
        return float("nan")
    return float(np.sqrt(np.mean(np.sum(np.square(places - others), axis=-1))))


def from_run(
    run: Run | Path | str,
    *,
    graph: Literal["paper", "gnss"] = "gnss",
    states: Literal["full", "poses"] = "full",
    prior: Literal["start", "estimate"] | None = None,
    vehicle: str | None = None,
    landmarks_ned: npt.ArrayLike | None = None,
    landmarks_guess_ned: npt.ArrayLike | None = None,
    ranges: npt.ArrayLike | None = None,
    range_std: float = RANGE_STD,
    range_limit: float = RANGE_LIMIT,
    seed: int | None = None,
    state_period: float = 0.1,
    fix_std: float | None = None,
    bias_time_constant: float | None = None,
    process_noise: float | None = None,
    iterations: int = MOST_ITERATIONS,
    damping: Literal["metres", "diagonal"] = "metres",
    keep: tuple[int, ...] = (),
) -> Slam:
    """Smooth the trajectory of a recorded flight and estimate landmarks from ranges; see docs/explanation/slam.md.

    Args:
        run: a run folder, or what ``qrsim.open_run`` returned.
        graph: "gnss" has a factor for each GNSS fix; in "paper" GNSS is only where the iterations begin.
        states: "full" are the 13 of the vehicle's model, "poses" are position and heading only.
        prior: the first state is known to be near the true "start" (the default of "paper"), or only as well as the
            "estimate" of the sensors (the default of "gnss").
        vehicle: which one; None where the run has only one.
        landmarks_ned: (L, 3) true places [m]; None: ten drawn at random on the ground around the flight, unless
            ``ranges`` are given.
        landmarks_guess_ned: (L, 3) where to begin; None: drawn at random in the same place.
        ranges: your own, rows (R, 3) of time [s], number of the landmark from 0, range [m]; None: simulated.
        range_std: white noise of a range [m].
        range_limit: simulated ranges reach so far [m].
        seed: of simulated landmarks, guesses and ranges; None: the run's.
        state_period: time between two states, a multiple of the simulator's step [s].
        fix_std: standard deviation of a fix per axis [m]; None: measured against the truth of the run.
        bias_time_constant: in "gnss", model the fixes' error as Ornstein-Uhlenbeck states of this time constant [s].
        process_noise: in place of the vehicle's own, for what the model does not know, such as gusts [m/s^2, rad/s^2].
        iterations: at most so many linear solutions.
        damping: how Levenberg and Marquardt's steps are held back: in the places of vehicle and landmarks ("metres"),
            or in every unknown in proportion to its curvature ("diagonal"), as general solvers do; the optimum is the
            same.
        keep: numbers of iterations after which the point is kept, for ``Slam.kept``.

    Raises:
        UsageError: an unknown option, ranges that are not finite or do not fit, or no landmark in range.
        RunError: the run lacks something that is needed, or the problem does not fit into memory.
    """
    from qrsim.studies.slam.recorded import flight_of_run

    check_numbers(
        range_std=range_std,
        range_limit=range_limit,
        fix_std=fix_std,
        bias_time_constant=bias_time_constant,
        process_noise=process_noise,
        state_period=state_period,
    )
    if seed is not None and seed < 0:
        raise UsageError(f"seed: {seed} is negative")
    opened = run if isinstance(run, Run) else open_run(run)
    flight = flight_of_run(opened, vehicle, state_period, process_noise)
    number = opened.info.seed if seed is None else seed
    ranging = _ranging(flight, landmarks_ned, landmarks_guess_ned, ranges, range_std, range_limit, number)
    found = estimate(
        flight,
        ranging,
        graph=graph,
        states=states,
        prior=prior,
        fix_std=fix_std,
        bias_time_constant=bias_time_constant,
        iterations=iterations,
        damping=damping,
        keep=keep,
    )
    for problem in found.problems:
        warn_user(problem)
    return found


def estimate(
    flight: Flight,
    ranging: Ranging,
    *,
    graph: str = "gnss",
    states: str = "full",
    prior: str | None = None,
    fix_std: float | None = None,
    bias_time_constant: float | None = None,
    iterations: int = MOST_ITERATIONS,
    damping: str = "metres",
    keep: tuple[int, ...] = (),
) -> Slam:
    """Estimate trajectory and landmarks of a flight from its ranges; arguments and errors as ``from_run``."""
    prior = prior or ("start" if graph == "paper" else "estimate")
    check_options(graph, states, prior, damping, iterations)
    if bias_time_constant is not None and graph != "gnss":
        raise UsageError("bias_time_constant: without GNSS fixes there is no error of them; take graph gnss")
    std = flight.fix_std if fix_std is None else fix_std
    if not std > 0.0:
        raise UsageError(
            f"{flight.name}: its fixes are exact, and a graph weighs them by their errors; record it with a sensor of "
            "type gnss, or give fix_std"
        )
    size = state_size(states, bias_time_constant is not None)
    check_memory(len(flight.truth), size, ranging.ranges.shape[1], available_bytes())
    per_landmark = ranging.per_landmark
    active = (per_landmark >= FEWEST_RANGES).astype(np.float64)
    if not active.any():
        raise UsageError(f"landmarks: none has {FEWEST_RANGES} ranges; ranges to each: {per_landmark.tolist()}")
    problem, x = make_graph(
        flight,
        ranging,
        active,
        graph=graph,
        states=states,
        prior=prior,
        fix_std=std,
        bias_time_constant=bias_time_constant,
    )
    use_compilation_cache()
    solution, reflected = solve_reflected(
        problem, x, ranging, lambda point: point.x[:, :3], iterations=iterations, damping=damping, keep=keep
    )
    return _slam_result(graph, states, prior, flight, ranging, active > 0, solution, reflected, problem)


def solve_reflected(
    problem: Problem,
    x: Floats,
    ranging: Ranging,
    places: Callable[[Point], Floats],
    *,
    iterations: int,
    damping: str,
    keep: tuple[int, ...] = (),
) -> tuple[Solution, Mirrors]:
    """Solve a problem, and again from reflected landmarks if these fit better; return solution and reflections.

    Args:
        problem: the graph, of one vehicle or of several.
        x: (T + 1, D) where to begin.
        ranging: of all positions that ``places`` returns.
        places: returns the positions (..., 3) of a point from which landmarks were ranged.
        iterations, damping, keep: see ``qrsim.slam.from_run``.
    """

    def reflect(point: Point) -> Mirrors:
        """Return the reflections of a solution's landmarks."""
        return mirrors(Point(places(point), point.landmarks, point.cost), ranging)

    solution = solve(problem, x, ranging.guess_ned, iterations, keep, damping)
    reflected = reflect(solution.point)
    if solution.converged and reflected.better.any():
        guess = np.where(reflected.better[:, None], reflected.places_ned, solution.point.landmarks)
        again = solve(problem, solution.point.x, guess, iterations, damping=damping)
        if again.converged and again.point.cost <= solution.point.cost + 0.5 * reflected.tolerance:
            solution = _with_history(solution, again)
            reflected = reflect(solution.point)
    return solution, reflected


def check_options(graph: str, states: str, prior: str, damping: str, iterations: object) -> None:
    """Raise UsageError for unknown options of an estimation."""
    options = {
        "graph": (graph, GRAPHS),
        "states": (states, STATES),
        "prior": (prior, PRIORS),
        "damping": (damping, DAMPINGS),
    }
    for name, (value, known) in options.items():
        if value not in known:
            raise UsageError(f"{name}: '{value}' is not known{did_you_mean(str(value), known)}")
    if isinstance(iterations, bool) or not isinstance(iterations, int | np.integer) or iterations < 1:
        raise UsageError(f"iterations: {iterations!r} is not a positive whole number")


def _with_history(first: Solution, again: Solution) -> Solution:
    """Return the second of two solutions with the first one's iterations and costs in front of its own."""
    return Solution(
        again.point, first.iterations + again.iterations, again.converged, [*first.costs, *again.costs], first.kept
    )


def _slam_result(
    graph: str,
    states: str,
    prior: str,
    flight: Flight,
    ranging: Ranging,
    enough: npt.NDArray[np.bool_],
    solution: Solution,
    reflected: Mirrors,
    problem: Graph,
) -> Slam:
    """Return a flight's result from its solution: states, landmarks, covariances; ``enough`` (L,): has
    enough ranges."""
    point, base = solution.point, problem.vehicle_size
    believed = covariance(problem, point)
    spread, determined = spread_of(believed.landmarks, ranging, enough)
    return Slam(
        graph=graph, states=states, prior=prior, flight=flight, ranging=ranging, time=flight.time,
        position_ned=point.x[:, :3], state=point.x[:, :base],
        bias=point.x[:, base:] if point.x.shape[1] > base else None,
        landmarks_ned=np.where(enough[:, None], point.landmarks, np.nan),
        landmarks_std=np.where(enough, spread, np.inf), position_covariance=believed.positions,
        landmarks_covariance=np.where(enough[:, None, None], believed.landmarks, np.nan),
        determined=determined, mirrors=reflected,
        iterations=solution.iterations, converged=solution.converged, costs=tuple(solution.costs), kept=solution.kept,
    )  # fmt: skip


def spread_of(
    covariances: Floats, ranging: Ranging, enough: npt.NDArray[np.bool_]
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return each landmark's largest standard deviation (L,) [m], and whether it is determined (L,)."""
    spread = np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])
    # Uncertain by half its distance, a landmark is not even known by its direction.
    with np.errstate(invalid="ignore"):
        near = 0.5 * np.nanmedian(np.where(enough[None], ranging.ranges, 0.0), axis=0)
    return spread, enough & (spread < near)


def _ranging(
    flight: Flight,
    true_ned: object,
    guess_ned: object,
    ranges: npt.ArrayLike | None,
    std: float,
    limit: float,
    seed: int,
) -> Ranging:
    """Return a user's ranges after checks, or simulated ranges to given or drawn landmarks."""
    known, guess = landmarks_given(flight.truth[:, :2], true_ned, guess_ned, ranges is not None, seed)
    if ranges is not None:
        return given_ranges(ranges, flight.time, len(guess), std, guess, known)
    assert known is not None
    return measure_ranges(flight.truth[:, :3], known, guess, seed, std, limit)


def check_numbers(**numbers: float | None) -> None:
    """Raise UsageError for named numbers that are neither None nor positive."""
    for name, value in numbers.items():
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"{name}: {value!r} is not a positive number")
