"""Ranges and rules of a multirotor of one's own at their edges.

By hand from the rules in docs/explanation/models/multirotor.md.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.models.vehicles.multirotor.own import GEOMETRIES, own_multirotor, own_parameters, rotors_of

QUAD: dict[str, Any] = {
    "mass": 1.2,
    "arm": 0.225,
    "rotors": 4,
    "hover_throttle": 0.5,
    "thrust_to_weight": 2.2,
    "attitude_bandwidth": 8.0,
}


@pytest.mark.parametrize(
    ("name", "least", "largest", "shown"),
    [
        ("mass", 0.01, 100.0, "0.01 to 100 kg"),
        ("arm", 0.02, 3.0, "0.02 to 3 m"),
        ("hover_throttle", 0.1, 0.95, "0.1 to 0.95"),
        ("thrust_to_weight", 1.2, 20.0, "1.2 to 20"),
        ("attitude_bandwidth", 1.0, 40.0, "1 to 40 rad/s"),
    ],
)
def test_a_number_just_out_of_its_range_is_refused_with_the_range(
    name: str, least: float, largest: float, shown: str
) -> None:
    for value in (0.99 * least, 1.01 * largest):
        with pytest.raises(UsageError, match=f"^{name}: .*; allowed: {re.escape(shown)}$"):
            own_multirotor(**{**QUAD, name: value})


def test_three_rotors_are_counted_and_two_are_none() -> None:
    with pytest.raises(UsageError, match="rotors: 3; allowed: 4, 6, 8"):
        own_multirotor(**{**QUAD, "rotors": 3})
    with pytest.raises(UsageError, match="rotors: 2; a multirotor needs 4, 6 or 8, or a geometry"):
        own_multirotor(**{**QUAD, "rotors": 2})


@pytest.mark.parametrize(("throttle", "curve"), [(0.2455, 0.0), (0.5045, 1.0), (0.4, 0.625)])
def test_hover_of_two_digits_is_taken_for_the_nearest_curve(throttle: float, curve: float) -> None:
    """With four times its weight it hovers at 1/4 to 1/2; at 0.4 of it (0.4 - 0.25)/(0.4 - 0.16) = 0.625."""
    found = own_parameters(**{**QUAD, "thrust_to_weight": 4.0, "hover_throttle": throttle})
    assert found["throttle_curve"] == pytest.approx(curve, abs=1e-12)


@pytest.mark.parametrize("throttle", [0.2445, 0.5055])
def test_hover_of_more_than_half_a_hundredth_beside_is_refused(throttle: float) -> None:
    with pytest.raises(UsageError, match=r"hovers at 0\.25 \(thrust .* to 0\.5 \(to its square\)"):
        own_parameters(**{**QUAD, "thrust_to_weight": 4.0, "hover_throttle": throttle})


def test_rotors_of_fifteen_milliseconds_allow_ten_radians_a_second_and_two_hundredths() -> None:
    """0.45/(3 x 0.015 s) = 10 rad/s."""
    given = {**QUAD, "known": {"spin_up": 0.015}}
    assert own_parameters(**{**given, "attitude_bandwidth": 10.15})["stabiliser"].rate_gain == pytest.approx(30.45)
    with pytest.raises(UsageError, match=r"time constant of 0\.015 s allow 10 rad/s at most"):
        own_parameters(**{**given, "attitude_bandwidth": 10.25})


def test_small_rotors_speed_up_in_twelve_milliseconds_at_the_least() -> None:
    """R = 0.6 x 0.12 m = 0.072 m, of which 0.12 s/m are 8.6 ms."""
    found = own_parameters(**{**QUAD, "arm": 0.12})
    assert found["rotor_radius"] == pytest.approx(0.072, rel=1e-9)
    assert (found["spin_up"], found["spin_down"]) == pytest.approx((0.012, 0.024), rel=1e-9)


@pytest.mark.parametrize(
    ("rotors", "radius", "first"),
    # 0.45 of the distance of neighbours: 0.4 m of six; 0.8 sin(22.5 degrees) = 0.3061467 m of eight.
    [(6, 0.18, (0.34641016, 0.2)), (8, 0.13776604, (0.36955181, 0.15307337))],
)
def test_propellers_of_neighbours_just_clear_each_other(rotors: int, radius: float, first: tuple[float, float]) -> None:
    found = own_parameters(**{**QUAD, "mass": 4.0, "arm": 0.4, "rotors": rotors, "attitude_bandwidth": 5.0})
    assert found["rotor_radius"] == pytest.approx(radius, rel=1e-7)
    assert len(found["rotors"]) == rotors
    np.testing.assert_allclose(found["rotors"][0].position, (*first, 0.0), rtol=1e-7)


def test_pairs_on_four_arms_of_half_a_metre() -> None:
    """R = 0.6 x 0.5 m; k_T = 0.0125 x 1.225 pi R^4 x 0.9; torque R sqrt(0.0125/2)/0.65/0.9; a fifth of an arm high."""
    given = {**QUAD, "mass": 8.0, "arm": 0.5, "rotors": 8, "attitude_bandwidth": 3.0, "geometry": "coaxial_x8"}
    found = own_parameters(**given)
    assert found["rotor_radius"] == pytest.approx(0.3, rel=1e-9)
    assert found["thrust_coefficient"] == pytest.approx(0.9 * 0.0125 * 1.225 * math.pi * 0.0081, rel=1e-9)
    assert found["torque_ratio"] == pytest.approx(0.3 * 0.0790569415 / 0.65 / 0.9, rel=1e-9)
    assert found["top"] == pytest.approx((0.0, 0.0, -0.25))
    assert [rotor.position[2] for rotor in found["rotors"]] == pytest.approx([0.0] * 4 + [0.1] * 4)
    assert [rotor.direction for rotor in found["rotors"]] == [-1, 1, -1, 1, 1, -1, 1, -1]


def test_it_stands_on_feet_below_the_middles_of_its_arms() -> None:
    """Half an arm forward and aside, and 0.3 of an arm and 2 cm below; its top is 0.3 of an arm above."""
    found = own_parameters(**{**QUAD, "arm": 0.4, "attitude_bandwidth": 5.0})
    np.testing.assert_allclose(
        found["feet"], [(0.2, 0.2, 0.14), (-0.2, 0.2, 0.14), (-0.2, -0.2, 0.14), (0.2, -0.2, 0.14)], rtol=1e-9
    )
    assert found["top"] == pytest.approx((0.0, 0.0, -0.12))


@pytest.mark.parametrize(
    ("geometry", "arms", "count", "first_deg"),
    [
        ("quad_x", 4, 4, 45.0),
        ("quad_plus", 4, 4, 0.0),
        ("hexa_x", 6, 6, 30.0),
        ("hexa_plus", 6, 6, 0.0),
        ("octo_x", 8, 8, 22.5),
        ("coaxial_x8", 4, 8, 45.0),
    ],
)
def test_arrangements_have_their_arms_and_the_angle_of_the_first(
    geometry: str, arms: int, count: int, first_deg: float
) -> None:
    kind = GEOMETRIES[geometry]
    assert (kind.arms, kind.count) == (arms, count)
    rotors = rotors_of(geometry, 1.0)
    angles = np.degrees([math.atan2(*rotor.position[1::-1]) for rotor in rotors])
    expected = first_deg + 360.0 / arms * (np.arange(count) % arms)
    np.testing.assert_allclose(angles % 360.0, expected % 360.0, atol=1e-9)
    assert [rotor.direction for rotor in rotors[:arms]] == [-1, 1] * (arms // 2)
