"""Ranges and landmarks: what is refused, what is not determined, and reflections."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.studies.slam.problems import exact_flight, exact_ranges

from qrsim.errors import RunError, UsageError
from qrsim.studies.slam import estimate as estimates
from qrsim.studies.slam.estimate import estimate
from qrsim.studies.slam.flight import Flight
from qrsim.studies.slam.memory import bytes_needed, check_memory
from qrsim.studies.slam.ranging import Ranging, given_ranges, measure_ranges


@pytest.fixture(scope="module")
def flight() -> Flight:
    return exact_flight(0.5, fixes=True)


def test_ranges_are_white_noise_on_true_distances_within_the_limit(flight: Flight) -> None:
    """Standard deviation within 4 of its own standard errors."""
    truth = flight.truth[:, :3]
    places = exact_ranges(flight).true_ned
    assert places is not None
    found = measure_ranges(truth, places, places, 3, 5.0, 25.0)
    distance = np.linalg.norm(truth[:, None] - places[None], axis=-1)
    assert np.array_equal(np.isfinite(found.ranges), distance <= 25.0)
    errors = (found.ranges - distance)[distance <= 25.0]
    assert errors.std() == pytest.approx(5.0, abs=4.0 * 5.0 / math.sqrt(2 * len(errors)))
    assert np.array_equal(found.ranges, measure_ranges(truth, places, places, 3, 5.0, 25.0).ranges, equal_nan=True)


def test_no_landmark_in_range_is_an_error(flight: Flight) -> None:
    far = np.array([[500.0, 0.0, 0.0]])
    with pytest.raises(UsageError, match=r"no landmark comes within 25 m of the flight; the nearest 4\d\d"):
        measure_ranges(flight.truth[:, :3], far, far, 0, 5.0, 25.0)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ([0.1, 0.0, math.nan], r"row 1 is \[0.1, 0.0, nan\]: leave out missing measurements"),
        ([math.inf, 0.0, 3.0], "row 1 is"),
        ([0.1, 0.0, -2.0], "row 1: a range of -2 m is negative"),
        ([0.1, 2.0, 3.0], "row 1: landmark 2; expected a number from 0 to 1"),
        ([0.1, 0.5, 3.0], "row 1: landmark 0.5"),
        ([0.13, 0.0, 3.0], "row 1: no state at 0.13 s; states are every 0.1 s from 0 to"),
        ([9999.0, 0.0, 3.0], "row 1: no state at 9999 s"),
    ],
)
def test_a_wrong_range_is_named(flight: Flight, row: list[float], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        given_ranges([[0.0, 1.0, 20.0], row], flight.time, 2, 5.0, np.zeros((2, 3)), None)


def test_a_table_of_another_shape_is_refused(flight: Flight) -> None:
    for table in ([], [1.0, 2.0], [[1.0, 2.0]]):
        with pytest.raises(UsageError, match=r"expected rows \(R, 3\) of time, landmark and range"):
            given_ranges(table, flight.time, 2, 5.0, np.zeros((2, 3)), None)


def test_several_ranges_of_one_state_count_as_many(flight: Flight) -> None:
    rows = [[0.2, 1, 18.0], [0.2, 1, 22.0], [0.3, 0, 5.0]]
    found = given_ranges(rows, flight.time, 2, 5.0, np.zeros((2, 3)), None)
    assert found.ranges[2, 1] == pytest.approx(20.0)
    assert found.counts[2].tolist() == [0.0, 2.0]
    assert found.per_landmark.tolist() == [1, 2]


def without_most_ranges(ranging: Ranging, landmark: int, kept: int) -> Ranging:
    """The same ranges, but few to one landmark."""
    ranges = ranging.ranges.copy()
    seen = np.flatnonzero(np.isfinite(ranges[:, landmark]))
    ranges[seen[kept:], landmark] = np.nan
    counts = np.isfinite(ranges).astype(np.float64)
    return Ranging(ranges, counts, ranging.std, ranging.guess_ned, ranging.true_ned)


@pytest.mark.long
def test_a_landmark_with_too_few_ranges_is_named_and_left_out(flight: Flight) -> None:
    ranging = without_most_ranges(exact_ranges(flight), 4, 2)
    found = estimate(flight, ranging)
    assert found.converged
    assert found.determined.tolist() == [i != 4 for i in range(len(found.determined))]
    assert np.isnan(found.landmarks_ned[4]).all()
    assert np.isfinite(np.delete(found.landmarks_ned, 4, axis=0)).all()
    assert found.problems == ["landmark 4 is not determined: 2 ranges, at least 3 needed"]
    assert found.landmark_rmse_m < 1.0


@pytest.mark.long
def test_ranges_from_almost_one_place_determine_no_landmark(flight: Flight) -> None:
    found = estimate(flight, without_most_ranges(exact_ranges(flight), 4, 6))
    assert not found.determined[4]
    assert "landmark 4 is not determined: its 6 ranges leave it uncertain by" in found.problems[0]


def test_where_no_landmark_has_enough_ranges_nothing_is_solved(flight: Flight) -> None:
    ranging = exact_ranges(flight, limit=30.0)
    for landmark in range(len(ranging.guess_ned)):
        ranging = without_most_ranges(ranging, landmark, 1)
    with pytest.raises(UsageError, match="none has 3 ranges; ranges to each: "):
        estimate(flight, ranging)


@pytest.mark.long
@pytest.mark.parametrize(("std", "ambiguous"), [(5.0, False), (12.0, True)])
def test_landmarks_looked_for_above_the_flight_are_found_below(flight: Flight, std: float, ambiguous: bool) -> None:
    """The flight rises by 2.5 m: ranges good enough tell a landmark from its reflection, others are told not to."""
    exact = exact_ranges(flight)
    above = exact.guess_ned * [1.0, 1.0, 0.0] - [0.0, 0.0, 45.0]
    found = estimate(flight, Ranging(exact.ranges, exact.counts, std, above, exact.true_ned))
    assert found.converged
    assert found.determined.all()
    assert found.mirrors.ambiguous.tolist() == [ambiguous] * len(above)
    assert np.all(found.mirrors.places_ned[:, 2] < -25.0)
    assert found.landmark_rmse_m < 1.0


def test_a_problem_that_does_not_fit_is_refused_before_it_starts(flight: Flight, monkeypatch: Any) -> None:
    with pytest.raises(RunError, match=r"1000000 states of 13 numbers .* need 38\.\d GiB, and 8\.0 GiB are free"):
        check_memory(10**6, 13, 10, 8 * 2**30)
    monkeypatch.setattr(estimates, "available_bytes", lambda: 2**20)
    with pytest.raises(RunError, match="take a longer state_period, states poses, or fewer landmarks"):
        estimate(flight, exact_ranges(flight))


def test_stated_memory_is_linear_in_the_states() -> None:
    one, two, three = (bytes_needed(states, 13, 10) for states in (1000, 2000, 3000))
    assert three - two == two - one > 0


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"graph": "papr"}, "graph: 'papr' is not known; did you mean 'paper'"),
        ({"states": "pose"}, "did you mean 'poses'"),
        ({"prior": "begin"}, "prior: 'begin' is not known"),
        ({"damping": "meters"}, "did you mean 'metres'"),
        ({"iterations": 0}, "iterations: 0 is not a positive whole number"),
        ({"graph": "paper", "bias_time_constant": 10.0}, "take graph gnss"),
    ],
)
def test_wrong_options(flight: Flight, options: dict[str, Any], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        estimate(flight, exact_ranges(flight), **options)
