"""One step of a rover's controller by hand.

Pure pursuit, backing and stopping of docs/explanation/models/rover.md, D7 to D9.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.control.rover import RoverController
from qrsim.control.setpoints import Estimate, TrackSetpoint, VelocitySetpoint, WaypointSetpoint

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


class Told:
    """A vehicle that repeats what it is told: speed [m/s] and curvature [1/m]."""

    def drive(self, speed: Any, curvature: Any) -> Any:
        return speed, curvature


def _step(estimate: Estimate, setpoint: Any) -> Any:
    controller = RoverController(nominal=Told(), speed_integral_gain=0.0)  # type: ignore[arg-type]
    return controller.step(controller.init(estimate), estimate, setpoint, 0.02)[1]


def told(setpoint: Any, at: Any = (0.0, 0.0), yaw: float = 0.0, forward: float = 0.0) -> list[float]:
    """What a rover is told that looks north but for ``yaw``, and drives ahead at a speed; without its integral."""
    with jax.enable_x64(True):
        fast = forward * np.array([[math.cos(yaw), math.sin(yaw), 0.0]])
        estimate = Estimate.of(np.array([[*at, 0.0]]), fast, np.array([[0.0, 0.0, yaw]]))
        return [float(number[0]) for number in jax.jit(_step, compiler_options=QUICK)(estimate, setpoint)]


def place(north: float, east: float) -> WaypointSetpoint:
    return WaypointSetpoint.of(np.array([[north, east, 0.0]]))


def line(end: float, begin: float = 0.0) -> TrackSetpoint:
    """A line along north."""
    return TrackSetpoint.line(np.array([[begin, 0.0, 0.0]]), np.array([[end, 0.0, 0.0]]))


def orbit(centre: Any, radius: float) -> TrackSetpoint:
    return TrackSetpoint.orbit(np.array([[*centre, 0.0]]), radius)


def test_it_backs_from_a_place_beside_it() -> None:
    """0.75 m beside it, nearer than 1.5 m times the sine of 1: at 0.5 m/s back, nose to there, 2/1.5 m sharp."""
    assert told(place(0.0, 0.75)) == pytest.approx([-0.5, -4.0 / 3.0])
    assert told(place(0.0, -0.75)) == pytest.approx([-0.5, 4.0 / 3.0])


@pytest.mark.parametrize(
    ("sine", "forward", "backs"),
    [
        (0.60, 0.0, False),  # Standing it turns to where the arc is no tighter than 1.5 m: 1 m > 0.9 m.
        (0.44, -0.5, False),  # Backing it goes on until it is 1.4 times as wide: 1 m > 2.1 m * 0.44.
        (0.50, -0.5, True),  # 1 m < 2.1 m * 0.5.
        (0.50, -0.16, True),  # 0.15 m/s back is backing.
        (0.50, -0.14, False),
    ],
)
def test_when_it_backs_from_a_place_a_metre_away(sine: float, forward: float, backs: bool) -> None:
    """Nearer than the lookahead the arc through the place is 2 sin(eta)/distance; sqrt(2 m * 1 m/s^2) at most."""
    speed, curvature = told(place(math.sqrt(1.0 - sine * sine), sine), forward=forward)
    expected = [-0.5, -4.0 / 3.0] if backs else [math.sqrt(2.0), 2.0 * sine]
    assert [speed, curvature] == pytest.approx(expected)


def test_who_looks_the_other_way_turns_as_for_a_point_beside_it() -> None:
    """Its line begins behind: 2/1.5 m to the nearer side, and sqrt(3 / that) = 1.5 m/s."""
    assert told(line(-100.0), at=(0.0, 3.0)) == pytest.approx([1.5, -4.0 / 3.0])
    assert told(line(-100.0), at=(0.0, -3.0)) == pytest.approx([1.5, 4.0 / 3.0])


def test_at_a_place_it_is_to_stop() -> None:
    """As a track, a place is a line that begins where it ends, with a stop: 1, as documented."""
    shown = RoverController().shown(place(2.0, 3.0))
    assert [float(value[0]) for value in (shown.radius, shown.speed, shown.stops)] == [0.0, 0.0, 1.0]


def test_it_creeps_from_fifteen_centimetres_a_second_on() -> None:
    """Below 0.15 m/s it stands (D9)."""
    for speed, wanted in ((0.16, 0.16), (0.14, 0.0)):
        assert told(VelocitySetpoint.of(np.array([[speed, 0.0, 0.0]]))) == pytest.approx([wanted, 0.0])


def test_a_line_below_a_millimetre_is_a_place() -> None:
    """3 m beside and 10 m behind a line of 1.1 mm it steers for the point 0.75 m along it; of 0.5 mm, for its end."""
    for length, ahead in ((0.0011, 0.75), (0.0005, 10.0005)):
        curvature = -2.0 * (3.0 / math.hypot(3.0, ahead)) / 1.5
        assert told(line(length), at=(-10.0, 3.0))[1] == pytest.approx(curvature, rel=1e-6)


def test_at_the_end_of_a_line_it_goes_straight_on() -> None:
    assert told(line(5.0), at=(5.0, 0.0)) == pytest.approx([2.0, 0.0])


def test_the_speed_before_a_place_has_a_slope() -> None:
    """sqrt(2 m/s^2 d) grows by sqrt(1/(2 d)) for each metre that the place is further: 1 /s at half a metre."""
    with jax.enable_x64(True):
        still, end = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
        estimate = Estimate.of(still, still, still)

        def speed(north: Any) -> Any:
            return _step(estimate, WaypointSetpoint.of(end * north))[0][0]

        value, slope = jax.jit(jax.value_and_grad(speed), compiler_options=QUICK)(0.5)
    assert (float(value), float(slope)) == pytest.approx((1.0, 1.0))


def test_in_the_middle_of_a_circle_it_steers_as_from_north_of_it() -> None:
    """Round 10 m, 1.5 m further along it: 2 asin(0.075) from north, and the sine of that is 0.15 sqrt(1 - 0.075^2)."""
    sine = 0.15 * math.sqrt(1.0 - 0.075**2)
    assert told(orbit((0.0, 0.0), 10.0)) == pytest.approx([2.0, 2.0 * sine / 1.5])


def test_small_circles() -> None:
    """The chord is at most 1.4 radii long, at asin(0.7) from the tangent: sin(eta) = 0.7, curvature 1.4/1.5 m."""
    curvature = 1.4 / 1.5
    assert told(orbit((0.0, 1.0), 1.0)) == pytest.approx([math.sqrt(3.0 / curvature), curvature])
    # A circle below a millimetre is one of a millimetre: from north of it, the chord is at pi/2 + asin(0.7).
    yaw = 0.5 * math.pi + math.asin(0.7) - 0.3
    assert told(orbit((0.0, 0.0), 5e-4), at=(1e-3, 0.0), yaw=yaw)[1] == pytest.approx(2.0 * math.sin(0.3) / 1.5)


def test_where_rounding_swallows_the_lookahead_it_goes_straight_on() -> None:
    """East of a circle's centre, looking north, the point 1e-20 m further is where it is already: no bearing, so north.

    8 m times the cosine of pi/2, which is 6.1e-17 as pi is rounded, is where it is to the north.
    """
    with jax.enable_x64(True):
        still, turns = np.zeros((1, 3)), orbit((0.0, 0.0), 8.0)
        estimate = Estimate.of(np.array([[8.0 * math.cos(0.5 * math.pi), 8.0, 0.0]]), still, still)

        def step(least: Any) -> Any:
            controller = RoverController(nominal=Told(), lookahead_min=least)
            return controller.step(controller.init(estimate), estimate, turns, 0.02)[1]

        speed, curvature = jax.jit(step, compiler_options=QUICK)(1e-20)
    assert (float(speed[0]), float(curvature[0])) == (2.0, 0.0)
