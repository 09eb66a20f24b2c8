"""Rotors over the ground, contact points and the loops of the stabiliser, one equation at a time, by hand.

The equations have the numbers of docs/explanation/models/multirotor.md.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from qrsim.core.quaternions import Quaternion
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.multirotor.aerodynamics import _in_plane, forces, near_ground
from qrsim.models.vehicles.multirotor.commands import MotorCommand
from qrsim.models.vehicles.multirotor.contact import Contact, plane_below, stiffness, touch
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser, rates_wanted, rotor_thrusts
from qrsim.models.vehicles.multirotor.state import Brush, Motion
from qrsim.models.vehicles.multirotor.vehicle import Multirotor

DOWN = np.array([0.0, 0.0, 1.0])


pytestmark = pytest.mark.usefixtures("double_precision")


def vec(*axes: Any, count: int = 4) -> Vec3:
    return Vec3(*(np.broadcast_to(np.asarray(axis, float), (count,)) for axis in axes))  # type: ignore[arg-type]


def moving(velocity: Vec3, rotors: int = 0, speed: float = 0.0, brush: Any = ()) -> Motion:
    """Return a level motion that faces north."""
    one: Any = np.ones_like(velocity.x)
    zero = 0.0 * one
    level = Quaternion(one, zero, zero, zero)
    return Motion(Vec3(zero, zero, zero), level, velocity, Vec3(zero, zero, zero), (speed * one,) * rotors, brush)


def test_thrust_over_the_ground() -> None:
    """(V19) with h at half a radius at least: 1/(1 - 1/4), and 1/(1 - 1/16) at a radius; none without thrust.

    A rotor of 1e-10 N has the induced velocity of one of 1e-9 N: 1/(1 - (1/4)/(1 + 1)) for as much sideways.
    """
    given: Any = (
        np.array([3.0, 3.0, 0.0, 1e-10]),
        np.array([0.0, 0.0, 0.0, 1e-9]),
        np.array([0.05, 0.5, 0.25, 0.25]),
        0.5,
        1.0,
    )
    np.testing.assert_allclose(near_ground(*given), [4.0, 3.2, 0.0, 8e-10 / 7.0], rtol=1e-9)


def test_a_rotor_of_ten_newtons_flies_past_the_ground() -> None:
    """R = 0.4 m at 0.2 m: v_i^2 = 10 N/(2 x 1.25 pi 0.16) m^2/s^2; T = 10/(1 - (1/4)/(1 + 9/v_i^2))."""
    values: Any = {
        "rotors": (Rotor((0.0, 0.0, 0.0), 1),),
        "rotor_radius": 0.4,
        "thrust_coefficient": 1e-5,
        "air_density": 1.25,
        "rotor_drag": 0.0,
        "drag_x": 0.0,
        "drag_y": 0.0,
        "drag_z": 0.0,
    }
    motion, still = moving(vec(3.0, 0.0, 0.0), 1, 1000.0), vec(0.0, 0.0, 0.0)
    ground = plane_below(np.full(4, 0.2), vec(0.0, 0.0, -1.0))  # type: ignore[arg-type]
    turned = motion.quaternion.rotation()
    force, _ = forces(Airframe(**values), motion, (np.zeros(4),), turned, still, still, ground)  # type: ignore[arg-type]
    thrust = 10.0 / (1.0 - 0.25 / (1.0 + 9.0 * 0.4 * math.pi / 10.0))
    np.testing.assert_allclose(force.z, -thrust, rtol=1e-9)
    np.testing.assert_allclose(np.stack(force.axes[:2]), 0.0, atol=1e-12)


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_flow_along_an_axis_of_the_body_is_known_to_have_no_part_in_the_plane(push: float) -> None:
    found = _in_plane(vec(3.0, 2.0, 5.0), np.full(4, push * 5.0), Rotor((0.0, 0.0, 0.0), 1, (0.0, 0.0, push)))  # type: ignore[arg-type]
    assert [part if isinstance(part, float) else part.tolist() for part in found] == [[3.0] * 4, [2.0] * 4, 0.0]


def test_spring_and_damper_of_a_foot() -> None:
    """(V23) 20 N on four feet that sink in by 4 mm: 1250 N/m; 2 x 0.7 sqrt(4 x 1250 N/m x 2 kg)/4 = 35 N s/m."""
    contact: Any = {"sink": 0.004, "damping": 0.7}
    found = stiffness(Contact(**contact), 20.0, 2.0, 4)  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [1250.0, 35.0], rtol=1e-9)


def test_a_foot_that_slides() -> None:
    """(V24) 1 cm deep and sinking at 0.2 m/s: N = 1000 x 0.01 + 10 x 0.2 = 12 N.

    The second slides at more than its bristles hold, the third is off the ground, the fourth so fast that 5 mm of
    bristle are passed in less than 4 ms.
    """
    slides = np.array([0.1, 1.0, 0.1, 2.0])
    ones: Any = np.ones(4)
    motion = moving(vec(slides, 0.0, 0.2), brush=(Brush(0.3 * ones, -0.2 * ones),))
    ground = plane_below(np.array([0.19, 0.19, 0.3, 0.19]), vec(0.0, 0.0, -1.0))  # type: ignore[arg-type]
    turned = motion.quaternion.rotation()
    found = touch(Contact(), 1000.0, 10.0, [(0.0, 0.0, 0.2)], [], motion, turned, ground, 0.004)  # type: ignore[arg-type]
    bent = np.stack([0.3 + slides / 0.17, -0.2 * ones])
    push = -0.6 * 12.0 * bent / np.maximum(np.hypot(*bent), 1.0) * [1.0, 1.0, 0.0, 1.0]
    np.testing.assert_allclose(np.stack(found.force.axes[:2]), push, rtol=1e-9)
    np.testing.assert_allclose(found.force.z, [-12.0, -12.0, 0.0, -12.0], rtol=1e-9)
    np.testing.assert_allclose(found.brush[0].north, [0.07 / 0.005, 0.7 / 0.005, -6.0, 1.4 / 0.008], rtol=1e-9)
    np.testing.assert_allclose(found.brush[0].east, [0.02 / 0.005, 0.2 / 0.005, 4.0, 0.4 / 0.008], rtol=1e-9)


def test_rates_that_turn_into_another_attitude() -> None:
    """(V28) Half a roll of 0.1 rad asks for 2 x 8 sin(0.1), half a turn of 0.1 for 2 x 2.8/0.4 sin(0.4 x 0.1).

    The quaternion of the other sign asks for the same. Of almost half a turn the sine is what is left of the tilt over
    a millionth.
    """
    c, s = math.cos(0.1), math.sin(0.1)
    zero: Any = np.zeros(4)
    rows: Any = [[c, s, 0.0, 0.0], [c, 0.0, 0.0, s], [-c, 0.0, 0.0, -s], [1e-7, 1.0, 0.0, 0.0]]
    columns: list[Any] = list(np.array(rows).T)
    wanted = Quaternion(*columns)
    level = Quaternion(zero + 1.0, zero, zero, zero)
    found = rates_wanted(Stabiliser(), level, wanted, zero)
    np.testing.assert_allclose(found.x, [16.0 * s, 0.0, 0.0, 1.6], rtol=1e-5, atol=1e-9)
    turn = 14.0 * math.sin(0.04)
    np.testing.assert_allclose(found.z, [0.0, turn, turn, 0.0], rtol=1e-5, atol=1e-9)


class Short:
    """A mixer whose rotors give less than what is asked for."""

    holds_yaw = 1.0

    def __init__(self, missing: Vec3):
        self.missing = missing

    def share(self, thrust: Any, torque: Vec3, yaw_share: Any) -> list[Any]:
        self.given = torque - self.missing
        return []

    def torque(self, thrusts: Any) -> Vec3:
        return self.given


@pytest.mark.parametrize(("dtype", "slack"), [(np.float64, 1e-6), (np.float32, 1e-4)])
def test_an_integral_is_held_where_rotors_give_less_than_asked_for(dtype: Any, slack: float) -> None:
    """(V29) 1 N m that lacks 1.1 and 0.9 times the slack; almost none, that lacks 1.1e-9 and 0.9e-9 N m.

    It grows by 0.02 s x 0.5 of the error where it is not held, as where rotors give more than asked for.
    """
    gains: Any = {"rate_gain": 1.0, "yaw_rate_gain": 1.0, "integral": 0.5, "yaw_integral": 0.5, "integral_limit": 10.0}
    lacks = np.array([1.1, 0.9, -1.1, -0.9], dtype)
    zero = np.zeros(4, dtype)
    error: Any = Vec3(zero + dtype(1.0), zero + dtype(1e-8), zero)  # type: ignore[arg-type]
    still: Any = Vec3(zero, zero, zero)  # type: ignore[arg-type]
    short: Any = Short(Vec3(lacks * dtype(slack), lacks * dtype(1e-9), zero))  # type: ignore[arg-type]
    one: Any = Vec3(*(dtype(1.0),) * 3)
    _, found = rotor_thrusts(Stabiliser(**gains), one, short, still, error, still, zero, 0.02)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.x, [0.0, 0.01, 0.01, 0.01], rtol=1e-5)
    np.testing.assert_allclose(found.y, [0.0, 1e-10, 1e-10, 1e-10], rtol=1e-5)


def test_thrust_of_a_curved_throttle_and_back() -> None:
    """(V31) 40 N at most and a = 0.5: 40 x 0.5 x (0.25 + 0.5) = 15 N at a half; 10 N at (sqrt(3) - 1)/2."""
    values: Any = {"thrust_coefficient": 1e-5, "throttle_curve": 0.5, "mass": 2.0, "gravity": 9.0}
    vehicle = Multirotor(**values)
    assert float(vehicle.thrust_of(0.5)) == pytest.approx(15.0, rel=1e-9)  # type: ignore[arg-type]
    throttles = vehicle.throttle_of(np.array([10.0, 15.0, 40.0, 0.0]))  # type: ignore[arg-type]
    np.testing.assert_allclose(throttles, [0.3660254037844386, 0.5, 1.0, 0.0], rtol=1e-9)
    # A controller is told 40 N (0.7 u + 0.3 u^2) of another one.
    handling = Multirotor(**{**values, "throttle_curve": 0.3}).handling()
    np.testing.assert_allclose(handling.throttle_curve, [0.0, 28.0, 12.0], rtol=1e-9)
    np.testing.assert_allclose(handling.tilt_max, 0.9)


def test_a_wake_is_as_wide_as_the_rotors_are_apart() -> None:
    """The hubs of an X500 are 0.174 m forward and aside: 2 x 0.174 sqrt(2) m; four discs of 0.128 m."""
    wake = Multirotor().wake()
    np.testing.assert_allclose(wake.size, 0.492146, rtol=1e-5)
    np.testing.assert_allclose(wake.disc_area, 4.0 * math.pi * 0.128**2, rtol=1e-9)


def test_limits_of_what_it_is_made_of() -> None:
    found = dict(Multirotor.default_limits)
    assert found == {"pitch": pytest.approx(1.5707963267948966), "velocity": 40.0, "rate": 30.0}
    assert len(MotorCommand.of_count(16).__dataclass_fields__) == 16
    with pytest.raises(KeyError):
        MotorCommand.of_count(17)


def test_who_has_landed_and_who_starts_on_the_ground() -> None:
    """On the ground since half a second; a start is on the ground with feet within 10 mm of it."""
    down = np.array([7.791, 7.7885, 7.809, 7.8115])
    zero = np.zeros(4)
    vehicle, still = Multirotor(), vec(0.0, 0.0, 0.0)
    start: Any = vehicle.initial_state(Vec3(zero, zero, down), Euler(zero, zero, zero), still, still)  # type: ignore[arg-type]
    found = vehicle.stood(start, lambda _: (zero + 8.0, vec(0.0, 0.0, -1.0)))  # type: ignore[arg-type,return-value]
    np.testing.assert_allclose(found.standing, [0.5, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(found.position_ned.z, [7.803, 7.7885, 7.803, 7.8115], atol=1e-9)
    waited = type(start)(**{**vars(start), "standing": np.array([0.55, 0.45, 0.51, 0.0])})
    assert np.asarray(vehicle.on_ground(waited)).tolist() == [True, False, True, False]
