"""Where rotors and feet of the parameter sets are, and what test_sets.py has not of their sources' numbers.

A square arm of d has its hubs at d/sqrt(2) forward and aside; the sides of a regular hexagon of 0.35 m are
0.35 cos(30 degrees) = 0.3031089 m from the middle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from qrsim.models.vehicles.multirotor.parameters import Airframe
from qrsim.models.vehicles.multirotor.sets import SETS

Corners = tuple[tuple[float, float, float], ...]

# Radius [m], moment of inertia of a rotor [kg m^2], voltage [V], avionics [W], gains of the angles and rates [1/s], and
# the top [m].
NAMES = ("rotor_radius", "rotor_inertia", "nominal_voltage", "avionics_power", "attitude_gain", "rate_gain", "top")
REST = {
    "x500": (0.128, 0.0, 14.8, 5.0, 8.0, 24.0, -0.1),
    # rotorpy's hummingbird_params has rotor_radius 0.10; three cells.
    "hummingbird": (0.10, 0.0, 11.1, 5.0, 8.0, 24.0, -0.06),
    # RotorS, pelican.xacro: radius_rotor 0.128.
    "pelican": (0.128, 0.0, 11.1, 5.0, 8.0, 24.0, -0.12),
    "crazyflie": (0.0231, 0.0, 3.7, 0.5, 6.0, 18.0, -0.02),
    "hexa4": (0.1905, 1.5e-4, 22.2, 5.0, 8.0, 24.0, -0.15),
}


def square(side: float, down: float) -> Corners:
    """Return the corners of a square clockwise from the front right one."""
    return ((side, side, down), (-side, side, down), (-side, -side, down), (side, -side, down))


# Hubs, directions of rotors, feet.
PLACES: dict[str, tuple[Corners, tuple[int, ...], Corners]] = {
    # PX4-gazebo-models, x500: rotors at 0.174 m, 0.06 m above.
    "x500": (square(0.174, -0.06), (-1, 1, -1, 1), square(0.15, 0.2)),
    "hummingbird": (square(0.12020815, 0.0), (-1, 1, -1, 1), square(0.084145707, 0.12)),
    "pelican": (
        ((0.21, 0.0, -0.05), (0.0, 0.21, -0.05), (-0.21, 0.0, -0.05), (0.0, -0.21, -0.05)),
        (1, -1, 1, -1),
        square(0.1, 0.12),
    ),
    "crazyflie": (square(0.032526912, 0.0), (-1, 1, -1, 1), square(0.022768838, 0.015)),
    "hexa4": (
        (
            (0.30310889, 0.175, 0.0),
            (0.0, 0.35, 0.0),
            (-0.30310889, 0.175, 0.0),
            (-0.30310889, -0.175, 0.0),
            (0.0, -0.35, 0.0),
            (0.30310889, -0.175, 0.0),
        ),
        (1, -1, 1, -1, 1, -1),
        square(0.2, 0.25),
    ),
}


@pytest.mark.parametrize("name", sorted(PLACES))
def test_rotors_and_feet_are_where_the_source_has_them(name: str) -> None:
    hubs, directions, feet = PLACES[name]
    found = SETS[name]()
    np.testing.assert_allclose([rotor.position for rotor in found.rotors], hubs, rtol=1e-6, atol=1e-12)
    assert tuple(rotor.direction for rotor in found.rotors) == directions
    # All push straight up.
    assert {rotor.axis for rotor in found.rotors} == {(0.0, 0.0, -1.0)}
    np.testing.assert_allclose(found.feet, feet, rtol=1e-6)


@pytest.mark.parametrize("name", sorted(REST))
def test_a_set_has_the_radius_the_voltage_the_gains_and_the_top_of_its_source(name: str) -> None:
    found: Any = SETS[name]()
    own = {**vars(found), **vars(found.stabiliser)}
    assert found.top[:2] == (0.0, 0.0)
    told = {key: own[key] if key != "top" else found.top[2] for key in NAMES}
    assert told == pytest.approx(dict(zip(NAMES, REST[name], strict=True)), rel=1e-9)


def test_an_airframe_of_nothing_but_defaults_is_an_x500() -> None:
    found = Airframe()
    assert [rotor.position for rotor in found.rotors] == [*square(0.174, -0.06)]
    assert found.feet == square(0.15, 0.2)
    assert found.top == (0.0, 0.0, -0.1)
    assert found.others == (*square(0.174, -0.06), (0.0, 0.0, -0.1))
    # Four rotors push up; 4 x 8.54858e-6 N s^2 x (1000 rad/s)^2 = 34.19432 N.
    assert found.lift_share == 4.0
    assert found.thrust_max == pytest.approx(34.19432, rel=1e-9)
