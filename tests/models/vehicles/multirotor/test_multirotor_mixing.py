"""The mixer of thrust and torques with all rotors, without yaw that fits, and with rotors that are lost; by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.geometry import Rotor, ring
from qrsim.models.vehicles.multirotor.mixer import Mixer, mixer_of

# Forward and aside by 0.2 m, from the front right one clockwise.
QUAD = (
    Rotor((0.2, 0.2, 0.0), -1),
    Rotor((-0.2, 0.2, 0.0), 1),
    Rotor((-0.2, -0.2, 0.0), -1),
    Rotor((0.2, -0.2, 0.0), 1),
)
FIFTH = Rotor((0.0, 0.0, 0.0), 1)
SIGNS = ((-1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0))


pytestmark = pytest.mark.usefixtures("double_precision")


def vec(*axes: float) -> Any:
    return Vec3(*(np.array([axis]) for axis in axes))  # type: ignore[arg-type]


def first(rows: Any) -> Any:
    """Return what each rotor gives of the thrust, of one vehicle after the other."""
    return np.stack([np.broadcast_to(np.asarray(row[0]), (2,)) for row in rows], -1)


def mixer(most: float) -> Mixer:
    rows = [(0.25, 0.5 * roll, 0.5 * pitch, yaw) for roll, pitch, yaw in SIGNS]
    return Mixer(rows, rows, np.array([most]), 1.0)  # type: ignore[arg-type]


def test_what_fits_is_shared_out_as_asked_for() -> None:
    """4 N in four, 0.2 and 0.1 N of roll and pitch, 0.1 N of yaw: none is near 0 or 3 N."""
    found = np.ravel(mixer(3.0).share(np.array([4.0]), vec(0.4, 0.2, 0.1), np.array([0.15])))  # type: ignore[arg-type]
    expected = [1.0 + 0.2 * roll + 0.1 * pitch + 0.1 * yaw for roll, pitch, yaw in SIGNS]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 1.1e-12])
def test_rotors_without_thrust_give_no_yaw(yaw: float) -> None:
    """Those that should slow down have nothing to give, even of a pico-newton."""
    found = np.ravel(mixer(3.0).share(np.zeros(1), vec(0.0, 0.0, yaw), np.zeros(1)))  # type: ignore[arg-type]
    assert found.tolist() == [0.0] * 4


def test_torque_of_rotors_is_the_sum_of_their_effects() -> None:
    effects = [(1.0, 0.1, -0.2, 0.3), (1.0, 0.0, 0.4, 0.05)]
    thrusts: Any = [np.array([2.0]), np.array([3.0])]
    found = Mixer(effects, effects, np.ones(1), 1.0).torque(thrusts)  # type: ignore[arg-type]
    np.testing.assert_allclose(np.ravel(found.stack()), [0.2, 0.8, 0.75], rtol=1e-12)


def test_with_all_rotors_it_holds_its_heading() -> None:
    found = mixer_of(QUAD, 0.016, 5.0, [])  # type: ignore[arg-type]
    assert found.holds_yaw == 1.0
    np.testing.assert_allclose(first(found.rows), [[0.25] * 4] * 2, rtol=1e-12)


def test_three_rotors_of_four_carry_it_without_a_heading() -> None:
    """Those beside the lost one carry half each, the one across nothing; of a second vehicle nothing is known."""
    known: Any = np.array([True, False])
    found = mixer_of(QUAD, 0.016, 5.0, [(0, known)])  # type: ignore[arg-type]
    np.testing.assert_allclose(first(found.rows), [[0.0, 0.5, 0.0, 0.5], [0.25] * 4], atol=1e-12)
    np.testing.assert_array_equal(found.holds_yaw, [0.0, 1.0])


def test_two_rotors_cannot_be_shared_out() -> None:
    """What stands is what the last one lost has left: the second, so that half is on the first and the third."""
    known: Any = np.array([True, True])
    found = mixer_of(QUAD, 0.016, 5.0, [(0, known), (1, known)])  # type: ignore[arg-type]
    np.testing.assert_allclose(first(found.rows), [[0.5, 0.0, 0.5, 0.0]] * 2, atol=1e-12)


def test_seven_rotors_of_eight_hold_the_heading() -> None:
    known: Any = np.array([True, False])
    found = mixer_of(ring(8, 0.5, math.pi / 8.0), 0.016, 5.0, [(0, known)])  # type: ignore[arg-type]
    np.testing.assert_array_equal(found.holds_yaw, [1.0, 1.0])


def test_four_in_one_point_that_tilt_by_a_third_more_than_they_lift_cannot_hold_yaw() -> None:
    """At a torque of 0.02 m the weakest direction has 0.02 x 1.3/sqrt(2) = 0.018 of the best one; 0.02 are needed."""
    length = math.hypot(1.3, 1.0)
    side, lift = 1.3 / length, -1.0 / length
    axes = [(1, (side, 0.0, lift)), (1, (-side, 0.0, lift)), (-1, (0.0, side, lift)), (-1, (0.0, -side, lift))]
    rotors = [*(Rotor((0.0, 0.0, 0.0), *each) for each in axes), FIFTH]
    known: Any = np.array([True])
    np.testing.assert_array_equal(mixer_of(rotors, 0.02, 5.0, [(4, known)]).holds_yaw, [0.0])  # type: ignore[arg-type]


def test_rotors_that_are_canted_along_with_their_reaction_hold_yaw() -> None:
    """On 0.2 m, canted by atan(0.1): the push turns it by 0.2 x 0.0995 = 0.02 x 0.995 N m, as much as the reaction.

    They add up; were the reaction of the other sign, they would cancel.
    """
    length = math.hypot(0.1, 1.0)
    side, lift = 0.1 / length, -1.0 / length
    rotors = [
        Rotor((0.2, 0.0, 0.0), 1, (0.0, -side, lift)),
        Rotor((0.0, 0.2, 0.0), -1, (-side, 0.0, lift)),
        Rotor((-0.2, 0.0, 0.0), 1, (0.0, side, lift)),
        Rotor((0.0, -0.2, 0.0), -1, (side, 0.0, lift)),
        FIFTH,
    ]
    known: Any = np.array([True])
    np.testing.assert_array_equal(mixer_of(rotors, 0.02, 5.0, [(4, known)]).holds_yaw, [1.0])  # type: ignore[arg-type]
