"""Cooperative range-only SLAM: several vehicles that share landmarks and range to each other, solved as one problem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from qrsim.core.arrays import NumpyArray
from qrsim.core.tree import replace
from qrsim.engine.settings import use_compilation_cache
from qrsim.errors import UsageError
from qrsim.studies.slam.between import Between, checked_between
from qrsim.studies.slam.covariance import covariance
from qrsim.studies.slam.estimate import (
    MOST_ITERATIONS,
    check_numbers,
    check_options,
    rms_distance,
    solve_reflected,
    spread_of,
    why_not_determined,
)
from qrsim.studies.slam.flight import Flight, Floats
from qrsim.studies.slam.graph import Graph, make_graph
from qrsim.studies.slam.joint import Common, JointGraph
from qrsim.studies.slam.memory import available_bytes, check_memory, state_size
from qrsim.studies.slam.mirror import Mirrors
from qrsim.studies.slam.ranging import FEWEST_RANGES, Ranging
from qrsim.studies.slam.solve import Point


@dataclass(frozen=True)
class CooperativeSlam:
    """The smoothed estimate of N vehicles and of the landmarks that they share.

    Attributes:
        flights, rangings, between: all that went in.
        time: (T + 1,) since the first state [s].
        position_ned: (N, T + 1, 3) [m].
        bias: (N, T + 1, 2) estimated GNSS error of each vehicle beside the common one, north and east [m]; None where
            it is not modelled.
        common_bias: (T + 1, 2) estimated GNSS error of all vehicles [m]; None where it is not modelled.
        landmarks_ned: (L, 3) [m]; NaN where a landmark has too few ranges.
        landmarks_std: (L,) [m], the largest standard deviation in any direction.
        position_covariance: (T + 1, N, 3, N, 3) marginal covariance of all positions at a time, in NED [m^2].
        landmarks_covariance: (L, 3, 3) marginal covariance of the landmarks [m^2]; NaN as in landmarks_ned.
        determined: (L,) whether the ranges of all vehicles say where each landmark is.
        mirrors: where each landmark's reflection fits the ranges as well, and how well.
        iterations, converged, costs: how the solution was found.
    """

    flights: tuple[Flight, ...]
    rangings: tuple[Ranging, ...]
    between: Between
    time: Floats
    position_ned: Floats
    bias: Floats | None
    common_bias: Floats | None
    landmarks_ned: Floats
    landmarks_std: Floats
    position_covariance: Floats
    landmarks_covariance: Floats
    determined: npt.NDArray[np.bool_]
    mirrors: Mirrors
    iterations: int
    converged: bool
    costs: tuple[float, ...]

    @property
    def truth_ned(self) -> Floats:
        """True positions (N, T + 1, 3) NED [m] of the vehicles."""
        return np.stack([flight.truth[:, :3] for flight in self.flights])

    @property
    def trajectory_rmse_m(self) -> Floats:
        """Root mean square error (N,) of each vehicle's estimated positions [m]."""
        pairs = zip(self.position_ned, self.truth_ned, strict=True)
        return np.array([rms_distance(places, truth) for places, truth in pairs])

    @property
    def relative_rmse_m(self) -> float:
        """Root mean square error of the vehicles' positions relative to each other, over all pairs [m]."""
        error = self.position_ned - self.truth_ned
        one, other = np.triu_indices(len(error), 1)
        apart = (error[one] - error[other]).reshape(-1, 3)
        return rms_distance(apart, np.zeros_like(apart))

    @property
    def landmark_rmse_m(self) -> float:
        """Root mean square error of the landmarks that are determined [m]; NaN if the truth is unknown."""
        truth = self.rangings[0].true_ned
        if truth is None:
            return float("nan")
        return rms_distance(self.landmarks_ned[self.determined], truth[self.determined])

    def covariance_of(self, vehicle: int) -> Floats:
        """Return the marginal covariance (T + 1, 3, 3) of one vehicle's positions in NED [m^2]."""
        return self.position_covariance[:, vehicle, :, vehicle, :]

    def relative_covariance(self, vehicle: int, other: int) -> Floats:
        """Return the covariance (T + 1, 3, 3) of one vehicle's position minus another's, NED [m^2]."""
        every = self.position_covariance
        across = every[:, vehicle, :, other, :]
        alone = every[:, vehicle, :, vehicle, :] + every[:, other, :, other, :]
        return alone - across - across.transpose(0, 2, 1)

    @property
    def problems(self) -> list[str]:
        """Warnings about the result, one sentence each: undetermined landmarks, no convergence."""
        counts = np.sum([ranging.per_landmark for ranging in self.rangings], axis=0)
        found = [
            why_not_determined(int(i), int(counts[i]), self.landmarks_std[i]) for i in np.flatnonzero(~self.determined)
        ]
        if not self.converged:
            found.append(f"not converged after {self.iterations} iterations")
        return found


def estimate_together(
    flights: Sequence[Flight],
    rangings: Sequence[Ranging],
    between: Between,
    *,
    states: str = "full",
    prior: str = "estimate",
    fix_std: float | None = None,
    bias_time_constant: float | None = None,
    common_share: float = 0.0,
    own_time_constant: float | None = None,
    iterations: int = MOST_ITERATIONS,
    damping: str = "metres",
) -> CooperativeSlam:
    """Estimate trajectories of several vehicles and the landmarks that they share as one least-squares problem.

    Args:
        flights: of N vehicles, with states at the same times. A flight whose fixes are all NaN has none.
        rangings: of each flight to the same landmarks, with the same first guesses of them.
        between: ranges between the vehicles.
        states, prior, bias_time_constant, iterations, damping: see ``qrsim.slam.from_run``; the graph is "gnss".
        fix_std: standard deviation of a fix per axis [m]; None: measured against the truth, of each vehicle.
        common_share: part of the variance of the fixes' error, 0 to 1, that is the same for all vehicles: of the
            errors as states one is then common to all. 0: each has its own only.
        own_time_constant: of the part that is each vehicle's own [s]; None: ``bias_time_constant``.

    Raises:
        UsageError: an unknown option, flights that do not fit together, or no landmark in range.
        RunError: no vehicle has a fix, or the problem does not fit into memory.
    """
    check_options("gnss", states, prior, damping, iterations)
    _check_error_model(common_share, bias_time_constant, own_time_constant)
    _check_flights(flights, rangings)
    vehicles, count = len(flights), len(flights[0].truth)
    checked_between(between, vehicles, count)
    own_bias = bias_time_constant is not None and common_share < 1.0
    size = vehicles * state_size(states, own_bias) + 2 * (common_share > 0.0)
    smaller = "take a longer state_period, states poses, fewer vehicles or fewer landmarks"
    check_memory(count, size, rangings[0].ranges.shape[1], available_bytes(), smaller=smaller)
    ranging = joined_ranging(rangings)
    active = (ranging.per_landmark >= FEWEST_RANGES).astype(np.float64)
    if not active.any():
        raise UsageError(f"landmarks: none has {FEWEST_RANGES} ranges; ranges to each: {ranging.per_landmark.tolist()}")
    stds = _deviations(flights, fix_std)
    made = [
        graph_of(flight, own, active, std, bias_time_constant, common_share, own_time_constant, states, prior)
        for flight, own, std in zip(flights, rangings, stds, strict=True)
    ]
    common = None
    if bias_time_constant is not None and common_share > 0.0:
        decay = math.exp(-flights[0].ticks * flights[0].time_step / bias_time_constant)
        common = Common(math.sqrt(common_share) * float(np.sqrt(np.mean(np.square(stds)))), decay)
    joint = JointGraph(tuple(graph for graph, _ in made), between, common)
    return _solve(
        joint, joint.joined([x for _, x in made]), flights, rangings, ranging, active > 0, iterations, damping
    )


def joined_ranging(rangings: Sequence[Ranging]) -> Ranging:
    """Join the ranges of N vehicles to the same landmarks into one set (N (T + 1), L), vehicle after vehicle."""
    first = rangings[0]
    ranges, counts = (np.concatenate([getattr(each, name) for each in rangings]) for name in ("ranges", "counts"))
    # In units of the first one's deviation, so that each range weighs as much as in its own.
    weights = np.concatenate([np.full(each.ranges.shape[0], (first.std / each.std) ** 2) for each in rangings])
    return Ranging(ranges, counts * weights[:, None], first.std, first.guess_ned, first.true_ned)


def graph_of(
    flight: Flight,
    ranging: Ranging,
    active: Floats,
    fix_std: float,
    bias_time_constant: float | None,
    share: float,
    own_time_constant: float | None,
    states: str,
    prior: str,
) -> tuple[Graph, Floats]:
    """Return the factor graph of one vehicle, with its own GNSS error as a state, and its initial states."""
    make = partial(make_graph, flight, ranging, active, graph="gnss", states=states, prior=prior)
    if bias_time_constant is None:
        return make(fix_std=fix_std, bias_time_constant=None)
    own = own_time_constant or bias_time_constant
    # What is left of a fix beside both parts: what they move by within an interval.
    twice = -2.0 * flight.ticks * flight.time_step
    moved = -share * math.expm1(twice / bias_time_constant) - (1.0 - share) * math.expm1(twice / own)
    white = fix_std * math.sqrt(moved)
    if share >= 1.0:
        return make(fix_std=white, bias_time_constant=None)
    graph, x = make(fix_std=fix_std * math.sqrt(1.0 - share), bias_time_constant=own)
    with jax.enable_x64(True):
        return replace(graph, fix_weight=jnp.where(graph.fix_weight > 0.0, 1.0 / white, 0.0)), x


def _solve(
    joint: JointGraph,
    x: Floats,
    flights: Sequence[Flight],
    rangings: Sequence[Ranging],
    ranging: Ranging,
    enough: NumpyArray,
    iterations: int,
    damping: str,
) -> CooperativeSlam:
    """Solve the joint problem from initial states ``x``; return the result with covariances and
    landmark reflections."""

    def places(point: Point) -> Floats:
        """Return the positions (N (T + 1), 3) of all vehicles in a solution."""
        return joint.positions(point.x).reshape(-1, 3)

    use_compilation_cache()
    solution, reflected = solve_reflected(joint, x, ranging, places, iterations=iterations, damping=damping)
    point, vehicles = solution.point, len(flights)
    believed = covariance(joint, point)
    spread, determined = spread_of(believed.landmarks, ranging, enough)
    states, common = joint.split(point.x)
    graph = joint.graphs[0]
    return CooperativeSlam(
        flights=tuple(flights),
        rangings=tuple(rangings),
        between=joint.between,
        time=flights[0].time,
        position_ned=joint.positions(point.x),
        bias=np.stack([values[:, graph.vehicle_size :] for values in states]) if graph.bias else None,
        common_bias=common,
        landmarks_ned=np.where(enough[:, None], point.landmarks, np.nan),
        landmarks_std=np.where(enough, spread, np.inf),
        position_covariance=believed.positions.reshape(len(point.x), vehicles, 3, vehicles, 3),
        landmarks_covariance=np.where(enough[:, None, None], believed.landmarks, np.nan),
        determined=determined,
        mirrors=reflected,
        iterations=solution.iterations,
        converged=solution.converged,
        costs=tuple(solution.costs),
    )


def _deviations(flights: Sequence[Flight], fix_std: float | None) -> list[float]:
    """Return each vehicle's standard deviation of fixes [m]: ``fix_std``, or by its errors, or by other vehicles'."""
    if fix_std is not None:
        return [fix_std] * len(flights)
    known = [flight.fix_std for flight in flights if len(flight.fix_error)]
    if not known:
        return [flights[0].fix_std]
    others = float(np.sqrt(np.mean(np.square(known))))
    return [flight.fix_std if len(flight.fix_error) else others for flight in flights]


def _check_error_model(share: float, bias_time_constant: float | None, own_time_constant: float | None) -> None:
    """Raise UsageError for an invalid common share or time constant of the GNSS errors."""
    if not 0.0 <= share <= 1.0:
        raise UsageError(f"common_share: {share!r} is not a number from 0 to 1")
    if share > 0.0 and bias_time_constant is None:
        raise UsageError("common_share: there is no error as a state without bias_time_constant")
    if own_time_constant is None:
        return
    if bias_time_constant is None:
        raise UsageError("own_time_constant: there is no error as a state without bias_time_constant")
    check_numbers(own_time_constant=own_time_constant)


def _check_flights(flights: Sequence[Flight], rangings: Sequence[Ranging]) -> None:
    """Raise UsageError unless all flights have the same times, and all rangings the same landmarks."""
    if not flights:
        raise UsageError("flights: none; cooperative SLAM is of at least one vehicle")
    if len(rangings) != len(flights):
        raise UsageError(f"rangings: {len(rangings)} of {len(flights)} flights")
    first = flights[0]
    for i, flight in enumerate(flights):
        period, expected = flight.ticks * flight.time_step, first.ticks * first.time_step
        if not math.isclose(period, expected):
            raise UsageError(f"flight {i} has states every {period:g} s, the first one every {expected:g} s")
        if len(flight.truth) != len(first.truth):
            raise UsageError(f"flight {i} has {len(flight.truth)} states, the first one {len(first.truth)}")
        shape, wanted = rangings[i].ranges.shape, (len(first.truth), len(rangings[0].guess_ned))
        if shape != wanted:
            raise UsageError(f"rangings: expected ranges of shape {wanted}, found {shape} of flight {i}")
