"""Axes of ROS: attitudes that were turned by hand, with REP-103 in view."""

import math

import numpy as np
import pytest

from qrsim.links.ros2.frames import angles_ned_frd, enu_of, flu_of, quaternion_enu_flu

H = math.sqrt(0.5)


def test_north_is_y_and_up_is_z():
    assert enu_of(np.array([1.0, 2.0, -3.0])).tolist() == [2.0, 1.0, 3.0]
    assert enu_of(np.array([[0.0, 5.0, 0.0], [0.0, 0.0, 1.0]])).tolist() == [[5.0, 0.0, 0.0], [0.0, 0.0, -1.0]]


def test_right_is_minus_y_of_the_body():
    assert flu_of(np.array([1.0, 2.0, -9.81])).tolist() == [1.0, -2.0, 9.81]


@pytest.mark.parametrize(
    ("ned", "enu"),
    [
        # Level and facing north: turned from east to north, 90 degrees about up.
        ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, H, H)),
        # Level and facing east, 90 degrees clockwise from north: as the map.
        ((H, 0.0, 0.0, H), (0.0, 0.0, 0.0, 1.0)),
        # Level and facing 30 degrees: 60 from east.
        ((math.cos(math.pi / 12), 0.0, 0.0, math.sin(math.pi / 12)), (0.0, 0.0, 0.5, math.sqrt(0.75))),
        # Facing east with the right wing down by 60 degrees: about x of the body, which is forward in both.
        ((H * math.sqrt(0.75), H * 0.5, H * 0.5, H * math.sqrt(0.75)), (0.5, 0.0, 0.0, math.sqrt(0.75))),
        # Facing east with the nose up by 60 degrees: nose up is a turn about right, so about minus left.
        ((H * math.sqrt(0.75), -H * 0.5, H * 0.5, H * math.sqrt(0.75)), (0.0, -0.5, 0.0, math.sqrt(0.75))),
    ],
)
def test_attitudes_turned_by_hand(ned: tuple[float, ...], enu: tuple[float, ...]):
    found = quaternion_enu_flu(np.array(ned))
    assert abs(float(found @ np.array(enu))) == pytest.approx(1.0, abs=1e-12)
    assert float(np.linalg.norm(found)) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("enu", "angles"),
    [
        ((0.0, 0.0, H, H), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, math.pi / 2)),
        ((0.5, 0.0, 0.0, math.sqrt(0.75)), (math.pi / 3, 0.0, math.pi / 2)),
        ((0.0, -0.5, 0.0, math.sqrt(0.75)), (0.0, math.pi / 3, math.pi / 2)),
        # Twice as long means the same.
        ((0.0, -1.0, 0.0, math.sqrt(3.0)), (0.0, math.pi / 3, math.pi / 2)),
    ],
)
def test_angles_of_attitudes_turned_by_hand(enu: tuple[float, ...], angles: tuple[float, ...]):
    assert angles_ned_frd(np.array(enu)).tolist() == pytest.approx(angles, abs=1e-12)
