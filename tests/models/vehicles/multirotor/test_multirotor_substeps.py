"""One step of a multirotor in closed form: rotors, contact that is looked for, limits of the motors, loops.

A rotor closes on its target by the classical Runge-Kutta rule, which leaves 1 + z + z^2/2 + z^3/6 + z^4/24 of the
difference at z = -dt/tau; at z = -0.8 and -0.4 that is 0.45173333 and 0.6704.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Around
from qrsim.models.vehicles.multirotor.commands import AttitudeCommand, MotorCommand, Powered
from qrsim.models.vehicles.multirotor.contact import Contact
from qrsim.models.vehicles.multirotor.flight import fly
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.models.vehicles.multirotor.rigid_body import Surroundings, slope_of
from qrsim.models.vehicles.multirotor.state import Brush, Ground, Motion, MultirotorState
from qrsim.models.vehicles.multirotor.vehicle import Multirotor
from qrsim.models.vehicles.process_noise import ProcessNoise

COUNT, DT, MASS = 7, 0.02, 2.0643
UP, DOWN = 0.4517333333333333, 0.6704
# Two rotors on one axis at 500 rad/s, each with the thrust of two of an X500's.
TWIN = (Rotor((0.0, 0.0, -0.06), -1), Rotor((0.0, 0.0, -0.06), 1))
THRUST = 2.0 * 17.09716e-6 * 500.0**2
# The X500's own, from the front right one clockwise.
FOUR = (
    Rotor((0.174, 0.174, -0.06), -1),
    Rotor((-0.174, 0.174, -0.06), 1),
    Rotor((-0.174, -0.174, -0.06), -1),
    Rotor((0.174, -0.174, -0.06), 1),
)


@pytest.fixture(autouse=True)
def _by_hand() -> Iterator[None]:
    """Loops as Python runs them, so that no program is compiled."""
    with jax.enable_x64(True), jax.disable_jit():
        yield


def each(*values: float) -> Any:
    return np.broadcast_to(np.array(values), (COUNT,))


def vec(x: Any, y: Any, z: Any) -> Vec3:
    return Vec3(*(np.broadcast_to(np.asarray(axis, float), (COUNT,)) for axis in (x, y, z)))  # type: ignore[arg-type]


def plain(**others: Any) -> Any:
    """Return an X500 of two rotors, without drag and friction, whose step of 0.02 s is one substep."""
    values: Any = {
        "drag_x": 0.0,
        "drag_y": 0.0,
        "drag_z": 0.0,
        "rotor_drag": 0.0,
        "longest_substep": DT,
        "rotors": TWIN,
        "thrust_coefficient": 17.09716e-6,
        "spin_up": 0.025,
        "spin_down": 0.05,
        "thin_air": "ignored",
        "contact": Contact(friction=0.0),
        **others,  # type: ignore[arg-type]
    }
    return Multirotor(**values)


def start(height: Any, north: Any = 0.0, speed: Any = 500.0, yaw: float = 0.0, rotors: int = 2) -> MultirotorState:
    zero = each(0.0)
    turned = Quaternion(zero + math.cos(0.5 * yaw), zero, zero, zero + math.sin(0.5 * yaw))
    bent = (Brush(zero + 0.5, zero),) * (5 + rotors)
    speeds = (np.broadcast_to(np.asarray(speed, float), (COUNT,)),) * rotors
    return MultirotorState(
        vec(0.0, 0.0, -np.asarray(height)),
        turned,
        vec(north, 0.0, 0.0),
        vec(0.0, 0.0, 0.0),
        speeds,  # type: ignore[arg-type]
        zero + yaw,
        vec(0.0, 0.0, 0.0),
        bent,
        zero,
        zero,
        zero,
    )


def flown(state: MultirotorState, command: Any, dt: float = DT, around: Any = None, **others: Any) -> Any:
    still = vec(0.0, 0.0, 0.0)
    return fly(plain(**others), state, command, lambda _: still, ProcessNoise(still, still), dt, around)


def motors(fraction: Any) -> Any:
    return MotorCommand.of(np.broadcast_to(np.asarray(fraction, float)[..., None], (COUNT, 2)))  # type: ignore[arg-type]


@pytest.mark.long
def test_a_body_that_spins_about_three_axes() -> None:
    """(V22) J = (0.02, 0.03, 0.04) at (1, 2, 3) rad/s: w x J w = (0.06, -0.06, 0.02) N m, so w' = (-3, 2, -0.5).

    One metre a second ahead gives -w x v = (0, -3, 2) m/s^2 and the weight; 1.5 m/s^2 of noise are a specific force.
    """
    model = plain(inertia_x=0.02, inertia_y=0.03, inertia_z=0.04)
    one, still = each(1.0), vec(0.0, 0.0, 0.0)
    level = Quaternion(one, 0.0 * one, 0.0 * one, 0.0 * one)
    motion = Motion(still, level, vec(1.0, 0.0, 0.0), vec(1.0, 2.0, 3.0), (0.0 * one,) * 2, ())
    ground = Ground(50.0 * one, vec(0.0, 0.0, -1.0), vec(1.0, 0.0, 0.0), vec(0.0, 1.0, 0.0))
    around = Surroundings(still, still, ground, vec(1.5, 0.0, 0.0), still, one, one)
    slope, _, touched = slope_of(model, motion, (0.0 * one,) * 2, around)
    assert touched is None
    np.testing.assert_allclose(slope.rates.stack()[0], [-3.0, 2.0, -0.5], rtol=1e-9)
    np.testing.assert_allclose(slope.velocity.stack()[0], [1.5, -3.0, 11.81], rtol=1e-9)
    # Of 500 rad/s one goes up to 600 and one down to 400.
    motion = replace(motion, rotor_speed=(500.0 * one,) * 2)
    slope, specific, _ = slope_of(model, motion, (600.0 * one, 400.0 * one), around)
    np.testing.assert_allclose([rate[0] for rate in slope.rotor_speed], [4000.0, -2000.0], rtol=1e-9)
    np.testing.assert_allclose(specific.z, -THRUST / MASS, rtol=1e-5)


@pytest.mark.parametrize("powered", [False, True])
def test_rotors_close_on_the_largest_speed(powered: bool) -> None:
    """Told 1.1 of 1000 rad/s, at 16.5 V of nominal 14.8 V, they are told 1000; half of it where half is left of one.

    Up from 600 rad/s in 25 ms, down in 50 ms.
    """
    command, around = motors(1.1), None
    if powered:
        still, one = vec(0.0, 0.0, 0.0), each(1.0)
        command = Powered(command, 16.5 * one)
        lost = ((0, 0.5 * one, one < 0.0),)
        around = Around(lambda _: (0.0 * one, vec(0.0, 0.0, -1.0)), still, lost)
    after, _ = flown(start(50.0, speed=600.0), command, around=around)
    first = 500.0 + 100.0 * DOWN if powered else 1000.0 - 400.0 * UP
    np.testing.assert_allclose(after.rotor_speed[0], first, rtol=1e-9)
    np.testing.assert_allclose(after.rotor_speed[1], 1000.0 - 400.0 * UP, rtol=1e-9)


def test_a_step_that_is_longer_by_more_than_a_billionth_is_flown_in_two_parts() -> None:
    after, force = flown(start(50.0, speed=600.0), motors(1.0), DT * (1.0 + 1.1e-9))
    np.testing.assert_allclose(after.rotor_speed[0], 1000.0 - 400.0 * DOWN**2, rtol=1e-7)
    assert (force.z < -THRUST / MASS).all()


def test_a_step_of_a_picosecond_is_one_part() -> None:
    _, force = flown(start(50.0), motors(0.5), 1e-12)
    np.testing.assert_allclose(force.z, -THRUST / MASS, rtol=1e-5)


def test_a_heading_that_is_held_and_turned() -> None:
    """At half the throttle, facing 1 rad, which is held, and turned at 0.1 rad/s: after a step the aim is 0.002 rad on.

    So 14 sin(0.4 x 0.001) + 0.1 rad/s are asked for, the torque is 0.04 x 8 of it, shared by four of 0.016 m, and the
    integral grows by 0.02 x 0.1 x 8^2 of it.
    """
    zero = each(0.0)
    command = AttitudeCommand(zero, zero, zero + 0.5, zero + 0.1)
    after, _ = flown(start(50.0, yaw=1.0, rotors=4), command, rotors=FOUR, thrust_coefficient=8.54858e-6)
    rate = 14.0 * math.sin(0.0004) + 0.1
    np.testing.assert_allclose(after.rate_integral.z, 0.128 * rate, rtol=1e-5)
    np.testing.assert_allclose(after.yaw_setpoint, 1.002, rtol=1e-9)
    share = 0.32 * rate / (4.0 * 0.016)
    faster, slower = (math.sqrt((0.25 * THRUST + sign * share) / 8.54858e-6) for sign in (1.0, -1.0))
    np.testing.assert_allclose(after.rotor_speed[0], faster + (500.0 - faster) * UP, rtol=1e-6)
    np.testing.assert_allclose(after.rotor_speed[1], slower + (500.0 - slower) * DOWN, rtol=1e-6)


@pytest.mark.long
def test_one_step_near_the_ground_and_far_from_it() -> None:
    """Of a farthest point at 0.2915 m contact is looked for below 0.3915 m, and at 5 m/s below 0.5915 m.

    Bristles in the air straighten in 0.05 s there (z = -0.4), and have none above. Two slide over the ground on their
    feet, at 0.115 and 0.09 m/s; the last flies far above.
    """
    height = np.array([0.4, 0.35, 0.61, 0.5, 0.197, 0.197, 50.0])
    north = np.array([0.0, 0.0, 5.0, 5.0, 0.115, 0.09, 0.0])
    fraction = np.array([0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.5])
    after, force = flown(start(height, north, 1000.0 * fraction), motors(fraction))
    np.testing.assert_allclose(after.brush[0].north[:4], [0.0, 0.5 * DOWN, 0.0, 0.5 * DOWN], rtol=1e-9)
    np.testing.assert_allclose(after.standing, [0.0, 0.0, 0.0, 0.0, 0.0, DT, 0.0])
    np.testing.assert_allclose(after.velocity_body.x[4:6], [0.115, 0.09], rtol=1e-9)
    # Thrust alone, and on the ground the weight.
    np.testing.assert_allclose(force.z[4:], [-9.81, -9.81, -THRUST / MASS], rtol=1e-5)
    assert after.velocity_body.z[6] == pytest.approx(DT * (9.81 - THRUST / MASS), rel=1e-5)
    assert after.position_ned.z[6] == pytest.approx(-50.0 + 0.5 * DT**2 * (9.81 - THRUST / MASS), abs=1e-9)
