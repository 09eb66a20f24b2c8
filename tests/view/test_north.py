"""The arrow that points north covers no vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.view.frame import Cast
from qrsim.view.ground import arrow_of


def rows(count: int) -> Cast:
    """Vehicles in rows of twenty, 2 m apart, around the origin."""
    number = np.arange(count)
    places = np.stack([2.0 * (number // 20) - 9.0, 2.0 * (number % 20) - 19.0, np.full(count, -15.0)], axis=1)
    return Cast(tuple(f"v_{i}" for i in number), np.zeros(count, int), places)


def test_of_one_vehicle_it_lies_west_of_its_route_and_is_short():
    """A route of 40 m north and 30 m west: a fifth of that, and the head half of a span away."""
    route = np.array([[0.0, 0.0, -20.0], [40.0, 0.0, -20.0], [40.0, -30.0, -20.0]])
    cast = Cast(("v",), np.zeros(1, int), route[:1], routes=(route,))
    north, east, length = arrow_of(cast, 0.65, 25.0)
    assert (north, length) == (0.0, 8.0)
    assert -40.0 < east < -30.0 - 0.14 * length - 0.65 / 2


def test_of_one_vehicle_without_a_route_it_is_as_long_as_two():
    assert arrow_of(Cast(("v",), np.zeros(1, int), np.zeros((1, 3))), 0.65, 25.0)[2] == 1.3


def test_of_many_it_lies_west_of_them():
    """200 vehicles, from -9 to 9 m north and -19 to 19 m east."""
    north, east, length = arrow_of(rows(200), 0.65, 25.0)
    assert (north, length) == (-9.0, pytest.approx(7.6))
    # Its head is as wide as 0.28 of its length.
    assert east + 0.14 * length < -19.0 - 0.65 / 2
    assert east > -40.0


def test_it_is_never_longer_than_asked():
    assert arrow_of(rows(200), 0.65, 5.0)[2] == 5.0
