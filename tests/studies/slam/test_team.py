"""Flights of several vehicles: what they share and what they do not, and how sure of itself a matched estimate is."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.studies.slam import example, team
from qrsim.studies.slam.flight import Flight

SECONDS, PERIOD, VEHICLES, SEEDS = 20.0, 0.2, 3, range(11, 13)


@pytest.fixture(scope="module")
def shared() -> list[list[Flight]]:
    return team.shared_flights(SEEDS, VEHICLES, SECONDS, PERIOD)


@pytest.fixture(scope="module")
def own() -> list[list[Flight]]:
    return team.own_flights(SEEDS, VEHICLES, SECONDS, PERIOD)


@pytest.mark.long
def test_under_one_sky_errors_are_one_and_under_each_its_own_they_are_not(
    shared: list[list[Flight]], own: list[list[Flight]]
) -> None:
    """What a receiver adds to the sky's errors are 2 mm of range noise, some mm of position."""
    for flights in shared:
        for flight in flights[1:]:
            assert np.max(np.abs(flight.fix_error - flights[0].fix_error)) < 0.05
            assert flight.fix_std > 0.1
    for flights in own:
        for flight in flights[1:]:
            assert np.sqrt(np.mean(np.square(flight.fix_error - flights[0].fix_error))) > 0.3


@pytest.mark.long
def test_the_first_vehicle_is_that_of_a_flight_alone(shared: list[list[Flight]], own: list[list[Flight]]) -> None:
    alone = example.coloured_flights(SEEDS, SECONDS, PERIOD)
    for i, flight in enumerate(alone):
        assert np.array_equal(own[i][0].truth, flight.truth)
        assert np.array_equal(shared[i][0].truth, flight.truth)
        one, other = example.ranging_of(flight, SEEDS[i]), team.rangings_of(shared[i], SEEDS[i])[0]
        assert np.array_equal(one.ranges, other.ranges, equal_nan=True)


@pytest.mark.long
def test_vehicles_fly_routes_of_their_own_on_levels_of_their_own(shared: list[list[Flight]]) -> None:
    for flights in shared:
        assert [-float(flight.truth[0, 2]) for flight in flights] == [20.0, 19.0, 21.0]
        assert np.linalg.norm(flights[1].truth[0, :2] - flights[0].truth[0, :2]) > 1.0
    rangings = team.rangings_of(shared[0], SEEDS[0])
    assert np.array_equal(rangings[0].true_ned, rangings[1].true_ned)  # type: ignore[arg-type]
    errors = [
        ranging.ranges - np.linalg.norm(flight.truth[:, None, :3] - ranging.true_ned[None], axis=-1)  # type: ignore[index]
        for flight, ranging in zip(shared[0], rangings, strict=True)
    ]
    both = np.isfinite(errors[0]) & np.isfinite(errors[1])
    assert abs(np.corrcoef(errors[0][both], errors[1][both])[0, 1]) < 4.0 / np.sqrt(both.sum())


@pytest.mark.long
def test_white_errors_are_as_large_as_coloured_ones(own: list[list[Flight]]) -> None:
    """Within 4 standard errors of 100 fixes and two axes."""
    white = team.white_flights(SEEDS, own, SECONDS, PERIOD)
    for flights, models in zip(white, own, strict=True):
        for flight, model in zip(flights, models, strict=True):
            assert flight.fix_std == pytest.approx(model.fix_std, rel=4.0 / np.sqrt(2.0 * 200.0))
            assert abs(np.mean(flight.fix_error[1:] * flight.fix_error[:-1])) < 0.4 * flight.fix_std**2


@pytest.mark.parametrize("vehicles", [0, -1, 10])
def test_a_number_of_vehicles_that_there_is_no_room_for(vehicles: int) -> None:
    for fly in (team.shared_flights, team.own_flights):
        with pytest.raises(UsageError, match=f"vehicles: {vehicles}; expected a number from 1 to 9"):
            fly([1], vehicles)
