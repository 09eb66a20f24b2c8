"""The wind of a table over height: exact at its levels, linear between, logarithmic below; the same in the tick."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast
from qrsim.errors import UsageError
from qrsim.models.atmosphere.wind_profile import ProfileRows, WindProfile

EAST, SOUTH = math.radians(90.0), math.radians(180.0)


def rows(heights: Any, speeds: Any, bearings: Any, times: Any = (), **more: Any) -> ProfileRows:
    columns: Any = (np.array(each, np.float64) for each in (heights, speeds, bearings, times))
    return ProfileRows(*columns, **more)


_air = jax.jit(lambda wind, heights, seconds, fraction: wind.velocity_ned(heights, seconds, fraction))


def evaluate(wind: WindProfile, heights: Any, time: float) -> np.ndarray[Any, Any]:
    """Velocities to north and east (2, n), in single precision."""
    whole = math.floor(time)
    air = _air(cast(wind, np.float32), np.array(heights, np.float32), np.int32(whole), np.float32(time - whole))
    assert not np.asarray(air.z).any()
    return np.stack([np.asarray(air.x), np.asarray(air.y)])


def test_a_steady_profile() -> None:
    """From the east 4 m/s at 10 m, from the south 8 m/s at 100 m; ln(1/0.1)/ln(10/0.1) is a half."""
    wind = rows([100.0, 10.0], [8.0, 4.0], [SOUTH, EAST], roughness=0.1).at(60.0)
    found = evaluate(wind, [10.0, 100.0, 55.0, 300.0, 1.0, 0.1, 0.0, -5.0], 7.5)
    north = [0.0, 8.0, 4.0, 8.0, 0.0, 0.0, 0.0, 0.0]
    east = [-4.0, 0.0, -2.0, 0.0, -2.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(found, [north, east], atol=1e-5)


def test_in_time_and_with_levels_that_move() -> None:
    """One level of 2 m/s at 20 m becomes two, of 6 m/s at 20 m and 10 m/s at 60 m; steady beyond the ends."""
    wind = rows([20.0, 20.0, 60.0], [2.0, 6.0, 10.0], [SOUTH] * 3, [0.0, 100.0, 100.0], roughness=0.2).at(100.0)
    for time, at_20, at_40, at_2 in ((0.0, 2.0, 2.0, 1.0), (25.0, 3.0, 3.5, 1.5), (100.0, 6.0, 8.0, 3.0)):
        found = evaluate(wind, [20.0, 40.0, 2.0], time)
        np.testing.assert_allclose(found, [[at_20, at_40, at_2], [0.0] * 3], atol=1e-5)
    np.testing.assert_allclose(evaluate(wind, [40.0], 500.0)[0], 8.0, atol=1e-5)
    # The mean of a run of 100 s.
    mean = cast(wind, np.float32).mean_velocity_ned(jnp.array([20.0, 40.0], jnp.float32))
    np.testing.assert_allclose(mean.x, [4.0, 5.0], atol=1e-5)


def test_its_mean_is_that_of_the_run_alone() -> None:
    """Of rows of an hour a run of 60 s has the first minute: 2 m/s to 2 + 6/60 m/s."""
    wind = rows([10.0, 10.0], [2.0, 8.0], [SOUTH] * 2, [0.0, 3600.0]).at(60.0)
    np.testing.assert_allclose(cast(wind, np.float32).mean_velocity_ned(jnp.array([10.0])).x, 2.05, atol=1e-5)


def test_its_direction_turns_through_north() -> None:
    """Half way from 350 to 10 degrees it is 0, by the velocities: 10 cos(10 deg) is 9.848."""
    wind = rows([10.0, 30.0], [10.0, 10.0], [math.radians(350.0), math.radians(10.0)]).at(1.0)
    np.testing.assert_allclose(evaluate(wind, [20.0], 0.0)[:, 0], [-9.848078, 0.0], atol=1e-5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (([10.0, 20.0], [1.0], [0.0, 0.0]), "speeds: 1 numbers; heights has 2"),
        (([10.0, 10.0], [1.0, 2.0], [0.0, 0.0]), "heights: 10 m is there twice at one time"),
        (([0.05], [1.0], [0.0]), "heights: 0.05 m; allowed: from 0.09144, twice the roughness"),
        (([10.0] * 2, [1.0] * 2, [0.0] * 2, [0.0, 5.0]), "times: from 0 to 5 s, which does not cover the run, 0 to 60"),
        ((range(1, 66), [1.0] * 65, [0.0] * 65), "heights: 65 levels at one time; allowed: 64"),
        (([], [], []), "heights: 0 rows; allowed: 1 to 10000"),
    ],
)
def test_wrong_rows(given: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        rows(*given).at(60.0)


def test_an_area_far_above_its_levels() -> None:
    wind = rows([10.0, 100.0], [1.0, 2.0], [0.0, 0.0]).at(1.0)
    assert wind.beyond(None, 200.0) == wind.beyond(None, None) == []
    assert wind.beyond(None, 201.0) == ["the highest level is 100 m above the ground; world.area reaches 201 m"]
