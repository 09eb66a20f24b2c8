"""Lines from waypoint to waypoint by hand: which one is flown or driven, how far it is, and where it ends."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.control.guidance import Route, RouteState
from qrsim.control.tracks import FixedWingGuidance, RoverGuidance, advanced, left_of, line_of
from qrsim.core.vectors import Vec3

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def quick(function: Any, *given: Any) -> Any:
    """Call a function compiled as quickly as possible, which takes less time than its operations one by one."""
    return jax.jit(function, compiler_options=QUICK)(*given)


def row(*numbers: float, dtype: type = np.float32) -> Any:
    return np.array(numbers, dtype)


def state(index: tuple[int, ...], reached: tuple[int, ...]) -> RouteState:
    return RouteState(row(*index, dtype=np.int32), row(*reached, dtype=np.int32))


def level(north: Any, east: Any) -> Vec3:
    north, east = np.asarray(north, np.float32), np.asarray(east, np.float32)
    return Vec3(north, east, np.zeros_like(north))


def route(counts: tuple[int, ...]) -> Route:
    north: Any = np.repeat(row(100.0, 200.0, 300.0)[:, None], len(counts), axis=1)
    return Route(level(north, 0.0 * north), 0.0 * north, row(*counts, dtype=np.int32))


def test_a_line_begins_at_the_waypoint_before_it() -> None:
    """Of the first one at itself, and at the last one from the second round on."""
    begin, end = quick(line_of, state((0, 0, 1, 2), (0, 3, 1, 2)), route((3, 3, 3, 3)))
    np.testing.assert_array_equal(begin.x, [100.0, 300.0, 100.0, 200.0])
    np.testing.assert_array_equal(end.x, [100.0, 100.0, 200.0, 300.0])


def test_how_far_it_is_to_the_end_of_a_line() -> None:
    """From 2 m west and 3 m south of it along north; a line of half a millimetre counts by half of that."""
    begin, end = level([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]), level([10.0, 5e-4, 0.0], [0.0, 0.0, 0.0])
    distance, along = quick(left_of, begin, end, level([7.0, -3.0, -3.0], [-2.0, -2.0, -2.0]))
    np.testing.assert_allclose(distance, 13.0**0.5, rtol=1e-3)
    np.testing.assert_allclose(along, [3.0, 1.5, 0.0], rtol=1e-3)


@pytest.mark.parametrize(("repeat", "following"), [(False, [0, 1, 1, 2, 2]), (True, [0, 1, 0, 2, 0])])
def test_the_next_waypoint_follows_one_that_is_reached(repeat: bool, following: list[int]) -> None:
    """Each stands at its waypoint: the only one of one, both of two, the second and the third of three."""
    index, counts = (0, 0, 1, 1, 2), (1, 2, 2, 3, 3)
    place = level([100.0 * (i + 1) for i in index], [0.0] * 5)
    moved = quick(
        partial(advanced, passed=False, repeat=repeat), state(index, index), route(counts), place, row(*[1.0] * 5)
    )
    np.testing.assert_array_equal(moved.index, following)
    np.testing.assert_array_equal(moved.reached, np.array(index) + 1)


# At these waypoints: the only one of one, the first and second of two, the second of three.
AT, OF = (0, 0, 1, 1), (1, 2, 2, 3)


@pytest.mark.parametrize(("repeat", "stops"), [(False, [1.0, 0.0, 1.0, 0.0]), (True, [1.0, 0.0, 0.0, 0.0])])
def test_a_rover_stops_at_the_last_waypoint(repeat: bool, stops: list[float]) -> None:
    """And who goes round and round only at the only one."""
    asked = quick(RoverGuidance(repeat=repeat).setpoint, state(AT, AT), route(OF))
    np.testing.assert_array_equal(asked.stops, stops)


@pytest.mark.parametrize(("repeat", "circles"), [(False, [1.0, 0.0, 1.0, 0.0]), (True, [1.0, 0.0, 0.0, 0.0])])
def test_a_fixed_wing_circles_the_last_waypoint(repeat: bool, circles: list[float]) -> None:
    """And who goes round and round only the only one."""
    guidance = FixedWingGuidance(radius=row(-80.0), repeat=repeat)
    asked = quick(guidance.setpoint, state(AT, AT), route(OF))
    np.testing.assert_array_equal(asked.radius, [-80.0 * circle for circle in circles])
