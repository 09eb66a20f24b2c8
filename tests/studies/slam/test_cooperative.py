"""Several vehicles as one problem: against separate solutions, a dense matrix of its own, and the truth."""

from __future__ import annotations

import math
from dataclasses import replace as other_than
from typing import Any

import jax
import numpy as np
import pytest
from tests.studies.slam.problems import LANDMARKS, STATES, exact_flight, exact_ranges

from qrsim.core.tree import replace
from qrsim.errors import RunError, UsageError
from qrsim.studies.slam.between import Between, distances, measure_between, no_ranges, pairs_of
from qrsim.studies.slam.cooperative import estimate_together, graph_of
from qrsim.studies.slam.covariance import marginals
from qrsim.studies.slam.estimate import estimate
from qrsim.studies.slam.flight import Flight
from qrsim.studies.slam.graph import Graph, make_graph
from qrsim.studies.slam.joint import Common, JointGraph
from qrsim.studies.slam.ranging import Ranging, draw_landmarks

SHIFT = np.array([6.0, -9.0, 3.0])


def moved(flight: Flight, by: Any) -> Flight:
    """The same flight elsewhere."""
    at = np.concatenate([by, np.zeros(10)])
    return other_than(flight, truth=flight.truth + at, estimate=flight.estimate + at, fixes=flight.fixes + by[:2])


def two(noise: float = 0.5, limit: float = 30.0) -> tuple[list[Flight], list[Ranging]]:
    """Two flights with fixes over the same landmarks, the ranges to them exact."""
    first = exact_flight(noise, fixes=True)
    flights = [first, moved(first, SHIFT)]
    places = draw_landmarks(5, 1, LANDMARKS, first.truth[:, :2].mean(axis=0), 30.0)
    guess = exact_ranges(first, places).guess_ned
    return flights, [other_than(exact_ranges(flight, places, limit), guess_ned=guess) for flight in flights]


def exact_between(flights: list[Flight], std: float = 0.1) -> Between:
    """A range of each pair at each state, without noise."""
    pairs = pairs_of(len(flights))
    found = distances(np.stack([flight.truth[:, :3] for flight in flights]), pairs)
    return Between(pairs, found, np.ones_like(found), std)


def apart(rangings: list[Ranging]) -> list[Ranging]:
    """Each vehicle's own landmarks: the first one sees the first half, the second one the others."""
    half = LANDMARKS // 2
    found = []
    for ranging, mine in zip(rangings, (slice(0, half), slice(half, None)), strict=True):
        ranges = np.full_like(ranging.ranges, np.nan)
        ranges[:, mine] = ranging.ranges[:, mine]
        found.append(other_than(ranging, ranges=ranges, counts=np.isfinite(ranges).astype(np.float64)))
    return found


def alone(ranging: Ranging, mine: slice) -> Ranging:
    """Only some of the landmarks."""
    assert ranging.true_ned is not None
    return Ranging(
        ranging.ranges[:, mine], ranging.counts[:, mine], ranging.std, ranging.guess_ned[mine], ranging.true_ned[mine]
    )


@pytest.mark.long
def test_vehicles_that_share_nothing_are_as_if_each_were_alone() -> None:
    flights, rangings = two()
    rangings = apart(rangings)
    together = estimate_together(flights, rangings, no_ranges(2, STATES), states="poses")
    assert together.converged
    assert together.bias is None
    assert together.common_bias is None
    half = LANDMARKS // 2
    for i, mine in enumerate((slice(0, half), slice(half, None))):
        single = estimate(flights[i], alone(rangings[i], mine), graph="gnss", states="poses")
        np.testing.assert_allclose(together.position_ned[i], single.position_ned, atol=1e-5)
        np.testing.assert_allclose(together.landmarks_ned[mine], single.landmarks_ned, atol=1e-4)
        np.testing.assert_allclose(together.covariance_of(i), single.position_covariance, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(together.landmarks_covariance[mine], single.landmarks_covariance, rtol=1e-4)
    # Nothing in common: errors are independent, and variances of the difference add.
    np.testing.assert_allclose(together.position_covariance[:, 0, :, 1, :], 0.0, atol=1e-12)
    added = together.covariance_of(0) + together.covariance_of(1)
    np.testing.assert_allclose(together.relative_covariance(0, 1), added, atol=1e-12)


def test_each_part_of_the_error_has_its_time_constant() -> None:
    """Of 0.5 m, 3/4 of the variance is common with 100 s, and 1/4 of each vehicle with 5 s: states are 0.1 s apart."""
    flights, rangings = two()
    graph, x = graph_of(flights[0], rangings[0], np.ones(LANDMARKS), 0.5, 100.0, 0.75, 5.0, "poses", "estimate")
    assert x.shape == (STATES, 6)
    np.testing.assert_allclose(float(graph.bias_decay), math.exp(-0.1 / 5.0))
    np.testing.assert_allclose(np.asarray(graph.prior_weight)[4:], 1.0 / 0.25)
    own = 0.25**2 * (1.0 - math.exp(-2.0 * 0.1 / 5.0))
    np.testing.assert_allclose(np.asarray(graph.whiten)[7, 4:, 4:], np.eye(2) / math.sqrt(own), atol=1e-9)
    common = 0.75 * 0.5**2 * (1.0 - math.exp(-2.0 * 0.1 / 100.0))
    # Every second state has a fix.
    weights = np.tile([1.0 / math.sqrt(own + common), 0.0], STATES // 2)
    np.testing.assert_allclose(np.asarray(graph.fix_weight), weights)


@pytest.mark.long
def test_parts_with_one_time_constant_need_not_say_so() -> None:
    flights, rangings = two()
    how: dict[str, Any] = {"states": "poses", "bias_time_constant": 20.0, "common_share": 0.5}
    one = estimate_together(flights, rangings, exact_between(flights), **how)
    both = estimate_together(flights, rangings, exact_between(flights), own_time_constant=20.0, **how)
    np.testing.assert_allclose(one.position_ned, both.position_ned, atol=1e-9)
    other = estimate_together(flights, rangings, exact_between(flights), own_time_constant=2.0, **how)
    assert np.abs(one.position_ned - other.position_ned).max() > 1e-3


def short(share: float) -> tuple[JointGraph, Any, Any]:
    """Two vehicles with 4 states, every kind of factor, and a point at which none of them is zero."""
    flights, rangings = two(limit=1000.0)
    made, generator = [], np.random.default_rng(4)
    for flight, ranging in zip(flights, rangings, strict=True):
        first = other_than(
            flight,
            commands=flight.commands[:3],
            air_ned=flight.air_ned[:3],
            truth=flight.truth[:4],
            estimate=flight.estimate[:4],
            fixes=flight.fixes[:4],
        )
        seen = other_than(ranging, ranges=ranging.ranges[:4], counts=ranging.counts[:4])
        options: dict[str, Any] = {"graph": "gnss", "states": "poses", "prior": "estimate", "fix_std": 0.5}
        options["bias_time_constant"] = 20.0 if share < 1.0 else None
        made.append(make_graph(first, seen, np.ones(LANDMARKS), **options))
        flights[len(made) - 1] = first
    between = exact_between(flights, 0.1)
    between.ranges[2, 0] = np.nan
    between.counts[2, 0] = 0.0
    between.counts[1, 0] = 2.0
    joint = JointGraph(tuple(graph for graph, _ in made), between, Common(0.4, 0.9) if share > 0.0 else None)
    x = joint.joined([x for _, x in made]) + 0.3 * generator.standard_normal((4, joint.size))
    return joint, x, rangings[0].guess_ned + generator.standard_normal((LANDMARKS, 3))


def following(graph: Graph, k: int, state: Any) -> Any:
    """The pose and the error that follow a state: the step of the dead-reckoned states, turned by the heading."""
    nominal = np.asarray(graph.nominal[k : k + 2])
    step, turn = nominal[1] - nominal[0], state[3] - nominal[0, 5]
    cos, sin = np.cos(turn), np.sin(turn)
    moves = [cos * step[0] - sin * step[1], sin * step[0] + cos * step[1], step[2], step[5]]
    return np.concatenate([state[:4] + np.array(moves), float(graph.bias_decay) * state[4:]])


def cost_by_hand(joint: JointGraph, x: Any, landmarks: Any) -> float:
    """Half the sum of squares, of each factor by its formula and one after the other."""
    size = joint.graphs[0].size
    total = 0.0
    for n, graph in enumerate(joint.graphs):
        rest = size - 3
        own = [np.concatenate([row[3 * n : 3 * n + 3], row[6 + rest * n : 6 + rest * n + rest]]) for row in x]
        for k, state in enumerate(own):
            for i, place in enumerate(landmarks):
                weight = float(graph.range_weight[k, i])
                total += (weight * (np.linalg.norm(state[:3] - place) - float(graph.ranges[k, i]))) ** 2
            shared = x[k, -2:] if joint.common else np.zeros(2)
            bias = state[4:] if graph.bias else np.zeros(2)
            residual = float(graph.fix_weight[k]) * (state[:2] + bias + shared - np.asarray(graph.fixes[k]))
            total += residual @ residual
        total += np.sum((np.asarray(graph.prior_weight) * (own[0] - np.asarray(graph.prior_mean))) ** 2)
        for k in range(len(own) - 1):
            expected = following(graph, k, own[k])
            residual = np.asarray(graph.whiten[k]) @ (own[k + 1] - expected)
            total += residual @ residual
    for k in (0, 1, 3):
        # Two ranges of one state count as two.
        weight = np.sqrt(2.0 if k == 1 else 1.0) / 0.1
        total += (weight * (np.linalg.norm(x[k, :3] - x[k, 3:6]) - joint.between.ranges[k, 0])) ** 2
    if joint.common:
        error = x[:, -2:]
        total += np.sum((error[0] / 0.4) ** 2)
        total += np.sum((error[1:] - 0.9 * error[:-1]) ** 2) / (0.4**2 * (1.0 - 0.81))
    return 0.5 * float(total)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "share", [pytest.param(0.0, marks=pytest.mark.long), 0.5, pytest.param(1.0, marks=pytest.mark.long)]
)
def test_cost_and_gradient_are_those_of_the_factors_one_by_one(share: float) -> None:
    """The gradient against central differences of a cost that is written out here."""
    joint, x, landmarks = short(share)
    values = np.concatenate([x.ravel(), landmarks.ravel()])

    def by_hand(row: Any) -> float:
        return cost_by_hand(joint, row[: x.size].reshape(x.shape), row[x.size :].reshape(landmarks.shape))

    with jax.enable_x64(True):
        assert joint.cost(x, landmarks) == pytest.approx(by_hand(values), rel=1e-10)
        normal = joint.linearise(x, landmarks)
    assert normal.cost == pytest.approx(by_hand(values), rel=1e-10)
    found = np.concatenate([np.ravel(normal.gradient), np.ravel(normal.gradient_landmarks)])
    width = 1e-5
    for i in range(len(values)):
        step = width * np.eye(1, len(values), i)[0]
        expected = (by_hand(values + step) - by_hand(values - step)) / (2.0 * width)
        assert found[i] == pytest.approx(expected, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("share", [0.5, *(pytest.param(share, marks=pytest.mark.long) for share in (0.0, 1.0))])
def test_the_information_is_that_of_a_dense_matrix(share: float) -> None:
    """Where all residuals are zero J'J is the Hessian of the cost, by central differences of the gradient."""
    joint, x, landmarks = short(share)
    joint, x = satisfied(joint, x, landmarks)
    values = np.concatenate([x.ravel(), landmarks.ravel()])
    with jax.enable_x64(True):
        normal = joint.linearise(x, landmarks)
        assert normal.cost == pytest.approx(0.0, abs=1e-12)

        def gradient(row: Any) -> Any:
            here = joint.linearise(row[: x.size].reshape(x.shape), row[x.size :].reshape(landmarks.shape))
            return np.concatenate([np.ravel(here.gradient), np.ravel(here.gradient_landmarks)])

        width = 1e-5
        rows = [gradient(values + width * e) - gradient(values - width * e) for e in np.eye(len(values))]
    dense = np.array(rows) / (2.0 * width)
    scale = np.sqrt(np.diag(dense))
    full = assembled(normal, x, landmarks)
    assert np.max(np.abs(full - dense) / np.outer(scale, scale)) < 1e-5
    found, inverse = marginals(normal), np.linalg.inv(full)
    for k, covariance in enumerate(found.positions):
        at = slice(k * joint.size, k * joint.size + 6)
        np.testing.assert_allclose(covariance, inverse[at, at], rtol=1e-5, atol=1e-6)
    for i, covariance in enumerate(found.landmarks):
        at = slice(x.size + 3 * i, x.size + 3 * i + 3)
        np.testing.assert_allclose(covariance, inverse[at, at], rtol=1e-4, atol=1e-4)


def satisfied(joint: JointGraph, x: Any, landmarks: Any) -> tuple[JointGraph, Any]:
    """A problem of which the states of the model's own motion are an exact solution."""
    graphs, states = [], []
    for n, graph in enumerate(joint.graphs):
        own = [x[0, joint.columns(n)]]
        for k in range(3):
            own.append(following(graph, k, own[-1]))
        state = np.array(own)
        ranges = np.linalg.norm(state[:, None, :3] - landmarks[None], axis=-1)
        seen = np.asarray(graph.range_weight) > 0.0
        made = np.asarray(graph.fix_weight) > 0.0
        believed = state[:, :2] + (state[:, 4:] if graph.bias else 0.0)
        told = {
            "ranges": np.where(seen, ranges, 0.0),
            "fixes": np.where(made[:, None], believed, 0.0),
            "prior_mean": state[0],
        }
        graphs.append(replace(graph, **told))
        states.append(state)
    found = distances(np.stack([state[:, :3] for state in states]), joint.between.pairs)
    ranges = np.where(np.isfinite(joint.between.ranges), found, np.nan)
    whole = JointGraph(tuple(graphs), other_than(joint.between, ranges=ranges), joint.common)
    return whole, whole.joined(states)


def assembled(normal: Any, x: Any, landmarks: Any) -> Any:
    """The normal equations as one full matrix."""
    count, size = x.shape
    full = np.zeros((x.size + landmarks.size,) * 2)
    for k in range(count):
        here = slice(k * size, (k + 1) * size)
        full[here, here] = normal.diagonal[k]
        if k < count - 1:
            after = slice((k + 1) * size, (k + 2) * size)
            full[after, here] = normal.below[k]
            full[here, after] = normal.below[k].T
        full[k * size : k * size + normal.places, x.size :] = normal.border[k].reshape(normal.places, -1)
    full[x.size :, : x.size] = full[: x.size, x.size :].T
    for i, block in enumerate(normal.corner):
        at = slice(x.size + 3 * i, x.size + 3 * i + 3)
        full[at, at] = block
    return full


@pytest.mark.long
def test_ranges_between_vehicles_bring_one_without_fixes_to_its_place() -> None:
    """Its sensors begin 20 m off; the other one's fixes are good to centimetres, and both turn about each other."""
    flights, rangings = two(0.02)
    lost = other_than(flights[1], fixes=np.full((STATES, 2), np.nan))
    lost.estimate[:, :2] += [12.0, -16.0]
    unseen = [
        rangings[0],
        other_than(
            rangings[1], ranges=np.full_like(rangings[1].ranges, np.nan), counts=np.zeros_like(rangings[1].counts)
        ),
    ]
    # A third vehicle elsewhere, so that the ranges are from two sides.
    third = moved(flights[0], np.array([-9.0, -7.0, 2.0]))
    every, ranged = [flights[0], lost, third], [*unseen, rangings[0]]
    ranged[2] = other_than(exact_ranges(third, rangings[0].true_ned), guess_ned=rangings[0].guess_ned)
    without = estimate_together(every, ranged, no_ranges(3, STATES), states="poses")
    found = estimate_together(every, ranged, exact_between(every), states="poses")
    assert found.converged
    assert without.trajectory_rmse_m[1] == pytest.approx(20.0, abs=1.0)
    assert found.trajectory_rmse_m[1] < 0.5
    assert found.covariance_of(1)[150, 0, 0] < 0.5 < 1000.0 < without.covariance_of(1)[150, 0, 0]


def test_ranges_are_those_of_the_ranging_sensor() -> None:
    """0.1 m of white noise, 2 % lost near by and half of the rest at 60 m: 49 % are left there."""
    place = np.zeros((3, 4000, 3))
    place[1, :, 0], place[2, :, 1] = 10.0, 60.0
    found = measure_between(place, 3)
    assert found.pairs.tolist() == [[0, 1], [0, 2], [1, 2]]
    seen = np.isfinite(found.ranges)
    assert seen.mean(axis=0)[:2] == pytest.approx([0.98, 0.49], abs=0.03)
    assert np.nanstd(found.ranges[:, 0]) == pytest.approx(0.1, abs=0.005)
    assert np.nanmean(found.ranges[:, 1]) == pytest.approx(60.0, abs=0.01)
    assert np.array_equal(seen, found.counts > 0)
    fewer = measure_between(place[:2], 3)
    assert np.array_equal(fewer.ranges[:, 0], found.ranges[:, 0], equal_nan=True)


def test_what_does_not_fit_together_is_refused() -> None:
    flights, rangings = two()
    between = exact_between(flights)
    cases: list[tuple[Any, str]] = [
        (([], [], between), "flights: none"),
        ((flights, rangings[:1], between), "rangings: 1 of 2 flights"),
        ((flights, rangings, no_ranges(2, STATES - 1)), r"between: expected ranges of shape \(300, 1\)"),
        ((flights, rangings, exact_between([*flights, flights[0]])), "vehicles 0 to 1"),
        (([flights[0], other_than(flights[1], ticks=10)], rangings, between), "flight 1 has states every 0.2 s"),
        ((flights, [rangings[0], alone(rangings[1], slice(0, 3))], between), r"expected ranges of shape \(300, 10\)"),
        ((flights, rangings, other_than(between, std=0.0)), "standard deviation of 0.0 m"),
        ((flights, rangings, other_than(between, ranges=-between.ranges)), "state 0, pair 0: a range of -"),
        ((flights, rangings, other_than(between, pairs=np.array([[1, 1]]))), "vehicle 1 has no range to itself"),
    ]
    for given, reason in cases:
        with pytest.raises(UsageError, match=reason):
            estimate_together(*given)
    for options, reason in (
        ({"common_share": 0.5}, "no error as a state without bias_time_constant"),
        ({"common_share": 1.5, "bias_time_constant": 10.0}, "1.5 is not a number from 0 to 1"),
        ({"own_time_constant": 5.0}, "own_time_constant: there is no error as a state"),
        ({"own_time_constant": 0.0, "bias_time_constant": 10.0}, "own_time_constant: 0.0 is not a positive number"),
        ({"states": "pose"}, "did you mean 'poses'"),
    ):
        with pytest.raises(UsageError, match=reason):
            estimate_together(flights, rangings, between, **options)  # type: ignore[arg-type]
    blind = [other_than(flight, fixes=np.full((STATES, 2), np.nan)) for flight in flights]
    with pytest.raises(RunError, match="no GNSS fix"):
        estimate_together(blind, rangings, between)
