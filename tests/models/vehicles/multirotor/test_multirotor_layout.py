"""Arrangements of rotors and the balance of a leaning vehicle, in closed form.

A rotor at r with the axis a and the direction d gives, for each newton, -a_z of lift and the torque r x a + d k a;
k is torque over thrust.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from qrsim.models.vehicles.multirotor.balance import leaning
from qrsim.models.vehicles.multirotor.derived import derived
from qrsim.models.vehicles.multirotor.geometry import Rotor, allocation, combined, holds_yaw, rank_of, ring
from qrsim.models.vehicles.multirotor.vehicle import Multirotor

# Hubs in one point, axes tilted by atan(0.6/0.8) forward, back, right and left.
BUNCH = tuple(
    Rotor((0.0, 0.0, 0.0), direction, axis)
    for direction, axis in [
        (1, (0.6, 0.0, -0.8)),
        (1, (-0.6, 0.0, -0.8)),
        (-1, (0.0, 0.6, -0.8)),
        (-1, (0.0, -0.6, -0.8)),
    ]
)
# On arms of 1 m, each tilted along the circle so that its push takes most of its reaction torque away.
CANTED = tuple(
    Rotor(position, direction, axis)
    for position, direction, axis in [
        ((1.0, 0.0, 0.0), 1, (0.0, 0.6, -0.8)),
        ((0.0, 1.0, 0.0), -1, (0.6, 0.0, -0.8)),
        ((-1.0, 0.0, 0.0), 1, (0.0, -0.6, -0.8)),
        ((0.0, -1.0, 0.0), -1, (-0.6, 0.0, -0.8)),
    ]
)


def test_a_ring_begins_clockwise_and_turns_in_turns() -> None:
    found = ring(6, 2.0, 0.5)
    assert [rotor.direction for rotor in found] == [1, -1, 1, -1, 1, -1]
    angles = [0.5 + math.radians(60.0 * i) for i in range(6)]
    expected = [(2.0 * math.cos(angle), 2.0 * math.sin(angle), 0.0) for angle in angles]
    np.testing.assert_allclose([rotor.position for rotor in found], expected, atol=1e-12)
    assert found[0].axis == (0.0, 0.0, -1.0)


@pytest.mark.parametrize("factor", [1.0, -1.0, 1.2, -1.2, 0.5])
def test_a_known_factor_times_an_array(factor: float) -> None:
    array: Any = np.array([2.0, -3.0])
    np.testing.assert_allclose(combined((factor, array), (0.0, array)), [2.0 * factor, -3.0 * factor], rtol=1e-15)


def test_four_rotors_share_thrust_and_torques() -> None:
    """At 0.2 m forward and aside: 1/4 of the thrust; 1/(4 x 0.2) of a torque; 1/(4 x 0.016) of that about down."""
    places = [((0.2, 0.2), -1), ((-0.2, 0.2), 1), ((-0.2, -0.2), -1), ((0.2, -0.2), 1)]
    rotors = [Rotor((x, y, -0.05), direction) for (x, y), direction in places]
    ratio: Any = np.array([0.016])
    for yaw in (True, False):
        rows = allocation(rotors, ratio, yaw=yaw)
        # What does not depend on the ratio is known before it is.
        assert all(isinstance(row[0], float) for row in rows)
        expected = [
            (0.25, -1.25 * math.copysign(1.0, y), 1.25 * math.copysign(1.0, x), -15.625 * direction if yaw else 0.0)
            for (x, y), direction in places
        ]
        np.testing.assert_allclose([[float(np.ravel(each)[0]) for each in row] for row in rows], expected, atol=1e-12)


def test_rotors_in_one_point_that_push_up_ahead_and_aside() -> None:
    """Two lift and turn opposite ways, one pushes ahead, one to the right; torque 0.5 of thrust: exact in binary."""
    axes = [(1, (0.0, 0.0, -1.0)), (-1, (0.0, 0.0, -1.0)), (1, (1.0, 0.0, 0.0)), (1, (0.0, 1.0, 0.0))]
    rows = allocation([Rotor((0.0, 0.0, 0.0), *each) for each in axes], 0.5)  # type: ignore[arg-type]
    assert rows == [[0.5, 0.0, 0.0, -1.0], [0.5, 0.0, 0.0, 1.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]]


def test_hubs_in_one_point_have_no_lever() -> None:
    """Their rows are orthogonal, of the lengths 1.6, k 0.6 sqrt(2) (twice) and 1.6: 0.5 x 0.6 sqrt(2)/1.6."""
    assert rank_of(BUNCH, 0.5) == pytest.approx(0.2651650429449553, rel=1e-9)


def test_rank_of_canted_rotors() -> None:
    """Lift 0.8 of each; tilting torque 0.8 + 0.6 k = 1.1 of two; turning torque (0.6 - 0.8 k)/k = 0.4 of each.

    Lengths 1.6, 1.1 sqrt(2) = 1.556 (twice) and 0.8.
    """
    assert rank_of(CANTED, 0.5) == pytest.approx(0.5, rel=1e-9)
    assert rank_of(CANTED[:3], 0.5) == 0.0
    # Products of numbers that are too large command nothing.
    assert rank_of([*CANTED[:3], Rotor((1e300, 1e300, 0.0), 1, (1e300, 1e300, -1.0))], 0.5) == 0.0


def test_yaw_needs_a_fiftieth_of_the_best_direction() -> None:
    """As above 0.6 k/(0.8 sqrt(2)) is the least over the largest: 0.022 and 0.018."""
    for rank, holds in ((0.022, True), (0.018, False)):
        ratio = rank * 0.8 * math.sqrt(2.0) / 0.6
        assert rank_of(BUNCH, ratio) == pytest.approx(rank, rel=1e-9)
        assert holds_yaw(BUNCH, ratio, ()) is holds
    assert holds_yaw(BUNCH, 0.5, (0,)) is False
    assert holds_yaw(BUNCH, 0.5, (0, 1, 2, 3)) is False


@pytest.mark.parametrize(("behind", "holds"), [(0.055, True), (0.03, False)])
def test_each_rotor_needs_a_twentieth_of_the_most_loaded(behind: float, holds: bool) -> None:
    """Of two on a beam, 1 m ahead and ``behind`` m behind, the front one carries ``behind`` times what the other does.

    Two more aside, which turn the other way, carry half of the weight in equal parts, between these.
    """
    places = [((1.0, 0.0, 0.0), 1), ((-behind, 0.0, 0.0), 1), ((0.0, 1.0, 0.0), -1), ((0.0, -1.0, 0.0), -1)]
    assert holds_yaw([Rotor(*place) for place in places], 0.02, ()) is holds


def leaner(rotor_drag: float, **others: Any) -> Any:
    """Return a vehicle of 10 N with nothing but drag of four rotors of 1e-5 N s^2."""
    values: Any = {
        "mass": 1.0,
        "gravity": 10.0,
        "thrust_coefficient": 1e-5,
        "drag_x": 0.0,
        "drag_z": 0.0,
        "rotor_drag": rotor_drag,
        **others,
    }
    return Multirotor(**values)


def test_airspeed_of_balance_without_losses() -> None:
    """At atan(3/4): W = sqrt(8 N/(4 k_T)), V = 7.5 N/(4 k_d W) = 41.93 m/s; 110 m/s is beyond what is looked for.

    The interval of 100 m/s has been halved forty times: a multiple of 100/2^40 m/s, the last below the balance.
    """
    tilt = np.array([math.atan(0.75)])
    exact = 7.5 / (4e-4 * math.sqrt(2e5))
    airspeed, thrust = leaning(leaner(1e-4), tilt)  # type: ignore[misc]
    assert 0.0 <= exact - airspeed[0] < 1.001 * 100.0 / 2.0**40
    assert (airspeed[0] * 2.0**40 / 100.0).is_integer()
    np.testing.assert_allclose(thrust, [8.0], rtol=1e-12)
    airspeed, _ = leaning(leaner(3.8e-5), tilt)  # type: ignore[misc]
    assert airspeed.tolist() == [math.inf]
    tilted: Any = (Rotor((1.0, 0.0, 0.0), 1, (0.6, 0.0, -0.8)), *leaner(1e-4).rotors[1:])
    assert leaning(leaner(1e-4, rotors=tilted), tilt) is None


def test_inflow_takes_thrust_away() -> None:
    """At the balance V both equations hold: k_T W^2 - k_z W V sin = 2 N, and 4 k_d W V cos = 6 N.

    So W V = 6/(4e-4 x 0.8) = 18750, and k_T W^2 = 2 + 1e-4 x 18750 x 0.6 = 3.125 N: W = 559.017, V = 33.5410 m/s.
    """
    airspeed, thrust = leaning(leaner(1e-4, inflow_loss=1e-4), np.array([math.atan(0.75)]))  # type: ignore[misc]
    np.testing.assert_allclose(airspeed, [18750.0 / math.sqrt(312500.0)], rtol=1e-9)
    np.testing.assert_allclose(thrust, [12.5], rtol=1e-9)


def test_hover_and_reserves_of_a_curved_throttle() -> None:
    """40 N of largest thrust for 10 N: 0.5 u^2 + 0.5 u = 1/4 at u = (sqrt(3) - 1)/2; 1/8 s of the angles."""
    told = derived(leaner(1e-4, throttle_curve=0.5))
    assert told["hover_throttle"] == pytest.approx(0.3660254037844386, rel=1e-12)
    assert told["thrust_to_weight"] == pytest.approx(4.0, rel=1e-12)
    assert told["hover_speed_rad_s"] == pytest.approx(500.0, rel=1e-12)
    assert told["roll_time_constant_s"] == 0.125
