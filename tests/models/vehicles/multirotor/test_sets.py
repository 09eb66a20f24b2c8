"""Numbers of the parameter sets as their sources have them, and what the mixer keeps of yaw."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.quaternions import Quaternion
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor.mixer import Mixer
from qrsim.models.vehicles.multirotor.sets import SETS
from qrsim.models.vehicles.multirotor.stabiliser import Stabiliser, rates_wanted

NAMES = (
    "mass", "inertia_x", "inertia_y", "inertia_z", "thrust_coefficient", "torque_ratio", "speed_max", "spin_up",
    "spin_down", "rotor_drag", "inflow_loss", "translational_lift", "drag_x", "drag_y", "drag_z",
)  # fmt: skip
PUBLISHED = {
    # PX4-gazebo-models, x500: 2.0 kg and four rotors of 0.016076923 kg; the drag of its body is assumed.
    "x500": (
        2.0643, 0.021666667, 0.021666667, 0.04, 8.54858e-6, 0.016, 1000.0, 0.0125, 0.025, 8.06428e-5, 0.0, 0.0,
        0.02, 0.02, 0.03,
    ),
    # rotorpy 3.0.0, hummingbird_params: k_m 1.36e-7 over k_eta 5.57e-6; time constants of RotorS.
    "hummingbird": (
        0.5, 3.65e-3, 3.68e-3, 7.03e-3, 5.57e-6, 0.0244165, 1500.0, 0.0125, 0.025, 1.19e-4, 2.32e-4, 3.39e-3,
        0.005, 0.005, 0.01,
    ),
    # RotorS, pelican.xacro.
    "pelican": (1.0, 0.01, 0.01, 0.02, 9.9865e-6, 0.016, 838.0, 0.0125, 0.025, 8.06428e-5, *[0.0] * 5),
    # drone-models 0.1.0, cf2x_L250; drag after Foerster 2015.
    "crazyflie": (
        0.0319, 1.68e-5, 1.68e-5, 2.98e-5, 1.983e-8, 0.00735, 2460.0, 0.05, 0.1, 1.03e-6, 7.55e-7, *[0.0] * 4,
    ),
    # A design without a source, of a figure of merit of 0.65.
    "hexa4": (4.0, 0.12, 0.12, 0.21, 3.0e-5, 0.016, 700.0, 0.03, 0.05, 2.5e-4, 4.0e-4, 0.0, 0.05, 0.05, 0.08),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(SETS))
def test_a_set_has_the_numbers_of_its_source(name: str) -> None:
    found = SETS[name]()
    expected = dict(zip(NAMES, PUBLISHED[name], strict=True))
    assert {key: getattr(found, key) for key in NAMES} == pytest.approx(expected, rel=1e-5)


def test_at_the_limit_of_the_rotors_fifteen_hundredths_of_a_yaw_torque_are_kept() -> None:
    """As PX4's multirotor mixer does: four rotors at their 1 N, and a yaw that asks for 0.4 N more and less of each.

    0.15 of it are 0.06 N; all are then lowered by that, so that none is above what it can give.
    """
    rows = [(0.25, 0.0, 0.0, sign) for sign in (1.0, -1.0, 1.0, -1.0)]
    # Of a second vehicle at half its thrust there is room for all of it.
    thrust, yaw, none = np.array([4.0, 2.0]), np.array([0.4, 0.4]), np.zeros(2)
    share = jax.jit(lambda *given: Mixer(rows, rows, jnp.ones(2), 1.0).share(given[0], Vec3(*given[1:]), keeps))
    keeps = Stabiliser().yaw_share
    found = np.stack(share(thrust, none, none, yaw))
    np.testing.assert_allclose(found.T, [[1.0, 0.88, 1.0, 0.88], [0.9, 0.1, 0.9, 0.1]], rtol=1e-6)


def test_a_quarter_turn_is_asked_for_at_two_hundred_degrees_a_second() -> None:
    """2 x 2.8/0.4 sin(0.4 x 45 degrees) are 4.3 rad/s, of which 3.5 are allowed; of an eighth turn 2.2 rad/s."""
    halves = np.radians([45.0, 22.5])
    none, one = np.zeros(2), np.ones(2)
    wanted = jax.jit(
        lambda w, z: rates_wanted(
            Stabiliser(),
            Quaternion(one, none, none, none),
            Quaternion(w, none, none, z),
            none,  # type: ignore[arg-type]
        )
    )(np.cos(halves), np.sin(halves))
    np.testing.assert_allclose(wanted.z, [3.5, 14.0 * np.sin(np.radians(9.0))], rtol=1e-5)
    np.testing.assert_allclose(wanted.x, 0.0, atol=1e-6)
