"""Errors over many seeds, under white and under coloured GNSS noise, with paired tests and intervals.

In an arm every seed has one solution; arms of one seed share its waypoints, landmarks, guesses and the noise of the
ranges. All tests are two-sided; intervals hold with CONFIDENCE.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from qrsim.core.tree import record_of
from qrsim.errors import UsageError, did_you_mean
from qrsim.files import Content
from qrsim.studies.slam import example
from qrsim.studies.slam.estimate import BIAS_TIME_CONSTANT, Slam, estimate, rms_distance
from qrsim.studies.slam.flight import Flight, Floats, ticks_between
from qrsim.studies.slam.intervals import CONFIDENCE, SLOPE_WINDOWS, allan_slope, interval, paired, recovered
from qrsim.studies.slam.memory import available_bytes, check_memory, state_size
from qrsim.studies.slam.ranging import LANDMARKS, Ranging

NOISES = ("white", "coloured")
TEN = 10
# Correlation times of the sweep [s]; white comes before them.
TIME_CONSTANTS = (1.0, 3.0, 10.0, 30.0, 100.0)
# What is kept of a flight for each of its ticks, and what recording it takes.
BYTES_PER_TICK = 400
# What the arms of each graph are, in the order of figures and tables.
ARMS = {
    "paper": {
        "guess": "where the iterations begin",
        "ten": "10 iterations, diagonal damping",
        "ten_metres": "10 iterations, damping in metres",
        "converged": "converged",
    },
    "gnss": {"plain": "converged", "bias": "converged, error as a state"},
}


@dataclass
class Arm:
    """Solutions of S seeds.

    Attributes:
        position_ned: of each seed (T + 1, 3) [m].
        landmarks_ned: of each seed (L, 3) [m].
        determined: of each seed (L,), as the converged solution says.
        ambiguous: of each seed (L,), whether the reflection fits as well.
        iterations: of each seed.
        converged: of each seed.
    """

    position_ned: list[Floats] = field(default_factory=list)
    landmarks_ned: list[Floats] = field(default_factory=list)
    determined: list[npt.NDArray[np.bool_]] = field(default_factory=list)
    ambiguous: list[npt.NDArray[np.bool_]] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    converged: list[bool] = field(default_factory=list)

    def add(self, position: Floats, landmarks: Floats, solved: Slam) -> None:
        """Append the solution of one more seed to the results of this estimator."""
        self.position_ned.append(position)
        self.landmarks_ned.append(landmarks)
        self.determined.append(solved.determined)
        self.ambiguous.append(solved.mirrors.ambiguous)
        self.iterations.append(solved.iterations)
        self.converged.append(solved.converged)


@dataclass
class Study:
    """Flights and solutions of a study; flights and arms have one entry for each seed.

    Attributes:
        graph: paper or gnss.
        seeds: S of them.
        flights: by noise.
        landmarks_ned: true landmarks of each seed.
        arms: by noise and name of the arm.
    """

    graph: str
    seeds: tuple[int, ...]
    flights: dict[str, list[Flight]]
    landmarks_ned: list[Floats]
    arms: dict[tuple[str, str], Arm]

    def trajectory_errors(self, noise: str, arm: str) -> Floats:
        """Return each seed's root mean square trajectory error (S,) [m], by GNSS noise and estimator (arm)."""
        pairs = zip(self.arms[noise, arm].position_ned, self.flights[noise], strict=True)
        return np.array([rms_distance(position, flight.truth[:, :3]) for position, flight in pairs])

    def landmark_errors(self, noise: str, arm: str) -> Floats:
        """Return each seed's root mean square landmark error (S,) [m], by GNSS noise and estimator (arm).

        Over those that are determined in every arm of the seed; NaN where there are none.
        """
        errors = []
        for i, truth in enumerate(self.landmarks_ned):
            everywhere = np.all([other.determined[i] for other in self.arms.values()], axis=0)
            errors.append(rms_distance(self.arms[noise, arm].landmarks_ned[i][everywhere], truth[everywhere]))
        return np.array(errors)

    def position_errors(self, noise: str, arm: str, period: float) -> list[Floats]:
        """Return each seed's position errors (N, 2) [m], one every ``period`` [s], by GNSS noise and estimator."""
        found = []
        for position, flight in zip(self.arms[noise, arm].position_ned, self.flights[noise], strict=True):
            every = round(period / (flight.ticks * flight.time_step))
            found.append((position - flight.truth[:, :3])[::every, :2])
        return found


def check_size(
    seeds: int, noises: int, duration: float, states: str, state_period: float = example.STATE_PERIOD
) -> None:
    """Raise RunError, before anything is flown, if a study of this size does not fit into memory.

    Raises:
        UsageError: a duration that is no whole number of ticks.
        RunError: it does not fit.
    """
    ticks = ticks_between(duration, example.base_world().time_step, "duration")
    flown = BYTES_PER_TICK * ticks * seeds * noises
    # With the GNSS error as a state, the largest problem of a study.
    count, size = round(duration / state_period) + 1, state_size(states, bias=True)
    smaller = "take a shorter --duration, --states poses, or fewer --seeds"
    check_memory(count, size, LANDMARKS, available_bytes(), flown, smaller)


def fly(
    seeds: Sequence[int],
    noises: Sequence[str] = NOISES,
    duration: float = example.DURATION,
    state_period: float = example.STATE_PERIOD,
    gnss: str | None = None,
) -> dict[str, list[Flight]]:
    """Fly all seeds with each GNSS noise, "white" or "coloured", of equal size; return noise -> flights.

    Coloured flights are those of the published receiver, or of one of type gnss with the preset ``gnss``.

    Raises:
        UsageError: an unknown noise.
    """
    for noise in noises:
        if noise not in NOISES:
            raise UsageError(f"noise: '{noise}' is not known{did_you_mean(noise, NOISES)}")
    base = example.base_world(gnss=gnss)
    coloured = example.coloured_flights(seeds, duration, state_period, base)
    every = {"coloured": coloured}
    if "white" in noises:
        every["white"] = example.correlated_flights(
            seeds, coloured, duration=duration, state_period=state_period, base=base
        )
    return {noise: every[noise] for noise in noises}


def study(
    graph: str,
    seeds: Sequence[int],
    flights: dict[str, list[Flight]],
    *,
    states: str = "full",
    prior: str | None = None,
    bias_time_constant: float = BIAS_TIME_CONSTANT,
    progress: Callable[[], None] = lambda: None,
) -> Study:
    """Estimate all flights with every estimator (arm) of a graph; return the study's results.

    Args:
        graph: paper or gnss.
        seeds: of the flights.
        flights: by noise; in "gnss" the remedy is applied to all but white ones.
        states, prior: as in ``qrsim.slam``.
        bias_time_constant: of the remedy [s].
        progress: called after each flight.
    """
    landmarks = []
    arms: dict[tuple[str, str], Arm] = {}
    for i, seed in enumerate(seeds):
        for noise, flown in flights.items():
            ranging = example.ranging_of(flown[i], seed)
            bias = bias_time_constant if noise != "white" else None
            for arm, (position, places, solved) in _solve_arms(
                flown[i], ranging, bias, graph=graph, states=states, prior=prior
            ).items():
                arms.setdefault((noise, arm), Arm()).add(position, places, solved)
            progress()
        landmarks.append(ranging.true_ned)
    return record_of(Study, graph, tuple(seeds), flights, landmarks, arms)


def _solve_arms(
    flight: Flight, ranging: Ranging, bias: float | None, **options: Any
) -> dict[str, tuple[Floats, Floats, Slam]]:
    """Return estimator (arm) -> (vehicle's positions, landmarks, solution); ``bias``: error's time constant [s]."""
    whole = estimate(flight, ranging, keep=(TEN,), **options)
    converged = (whole.position_ned, whole.landmarks_ned, whole)
    if options["graph"] == "paper":
        stopped = estimate(flight, ranging, iterations=TEN, damping="diagonal", **options)
        ten = whole.kept[TEN]
        return {
            "guess": (flight.estimate[:, :3], ranging.guess_ned, whole),
            "ten": (stopped.position_ned, stopped.landmarks_ned, whole),
            "ten_metres": (ten.x[:, :3], ten.landmarks, whole),
            "converged": converged,
        }
    if bias is None:
        return {"plain": converged}
    remedied = estimate(flight, ranging, bias_time_constant=bias, **options)
    return {"plain": converged, "bias": (remedied.position_ned, remedied.landmarks_ned, remedied)}


def numbers(flown: Study) -> Content:
    """Return all results of a study as a dict for JSON."""
    result: Content = {"seeds": len(flown.seeds), "confidence": CONFIDENCE, "errors": {}, "paired": {}}
    measures = {"trajectory_m": flown.trajectory_errors, "landmarks_m": flown.landmark_errors}
    for noise, arm in flown.arms:
        result["errors"].setdefault(noise, {})[arm] = {
            **{name: interval(measure(noise, arm)) for name, measure in measures.items()},
            "iterations": float(np.mean(flown.arms[noise, arm].iterations)),
            "not_converged": sum(not done for done in flown.arms[noise, arm].converged),
        }
    total = sum(len(places) for places in flown.landmarks_ned)
    everywhere = [np.all([arm.determined[i] for arm in flown.arms.values()], axis=0) for i in range(len(flown.seeds))]
    result["landmarks"] = {"all": total, "determined": int(np.sum([np.sum(each) for each in everywhere]))}
    if len(flown.seeds) > 1:
        for arm in ARMS[flown.graph]:
            pair = [(noise, arm) for noise in NOISES]
            if all(key in flown.arms for key in pair):
                result["paired"][arm] = {name: paired(*(m(*key) for key in pair)) for name, m in measures.items()}
        if {("white", "plain"), ("coloured", "bias")} <= set(flown.arms):
            result["remedy"] = _compare_bias(measures)
    result["fixes"] = {noise: _fix_statistics(flights) for noise, flights in flown.flights.items()}
    return result


def _compare_bias(measures: Mapping[str, Callable[[str, str], Floats]]) -> Content:
    """Compare estimates with and without the GNSS error as a state; also return the share of the loss recovered."""
    found: Content = {}
    for name, measure in measures.items():
        white, coloured, remedied = measure("white", "plain"), measure("coloured", "plain"), measure("coloured", "bias")
        found[name] = {"gain": paired(remedied, coloured)}
        if name == "trajectory_m":
            found[name]["recovered"] = recovered(white, coloured, remedied)
    return found


def _fix_statistics(flown: list[Flight]) -> Content:
    """Return the size [m] of the flights' GNSS errors, and the slope of their Allan deviation."""
    errors = [flight.fix_error for flight in flown]
    found: Content = {"rms_m": float(np.sqrt(np.mean([np.mean(np.square(error)) for error in errors])))}
    period = flown[0].fix_period
    if min(map(len, errors)) >= 2 * round(SLOPE_WINDOWS[1] / period):
        found["allan"] = allan_slope(errors, period)
    return found


@dataclass(frozen=True)
class Sweep:
    """Errors against the correlation time of GNSS errors of equal variance, graph gnss.

    Attributes:
        time_constants: (C,) [s], the first one that of white noise.
        plain, bias: trajectory errors (C, S) [m] without and with the error as a state; NaN for white.
    """

    time_constants: tuple[float, ...]
    plain: Floats
    bias: Floats

    def numbers(self) -> Content:
        """Return the errors by correlation time, with intervals and tests against white noise, as a dict for JSON."""
        found: Content = {}
        for i, tau in enumerate(self.time_constants):
            name = "white" if tau == example.WHITE else f"tau_{tau:g}_s"
            found[name] = {"plain": interval(self.plain[i])}
            if tau != example.WHITE:
                found[name]["bias"] = interval(self.bias[i])
                found[name]["against_white"] = paired(self.plain[0], self.plain[i])
                found[name]["gain"] = paired(self.bias[i], self.plain[i])
        return found


def sweep(
    seeds: Sequence[int],
    flights: dict[str, list[Flight]],
    time_constants: Sequence[float] = TIME_CONSTANTS,
    states: str = "full",
    progress: Callable[[], None] = lambda: None,
    gnss: str | None = None,
) -> Sweep:
    """Fly and estimate with GNSS errors of each correlation time [s], equal in size to the coloured flight's."""
    coloured, base = flights["coloured"], example.base_world(gnss=gnss)
    duration = coloured[0].time[-1]
    period = coloured[0].ticks * coloured[0].time_step
    plain, bias = [], []
    for tau in (example.WHITE, *time_constants):
        kind = "white" if tau == example.WHITE else "correlated"
        flown = example.correlated_flights(seeds, coloured, tau, round(float(duration), 9), period, base)
        found = study("gnss", seeds, {kind: flown}, states=states, bias_time_constant=tau, progress=progress)
        plain.append(found.trajectory_errors(kind, "plain"))
        remedied = (kind, "bias") in found.arms
        bias.append(found.trajectory_errors(kind, "bias") if remedied else np.full(len(seeds), np.nan))
    return Sweep((example.WHITE, *time_constants), np.array(plain), np.array(bias))
