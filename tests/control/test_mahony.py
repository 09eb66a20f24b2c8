"""The complementary filter where nobody reports an attitude: it turns by the gyroscope; forces and fields correct."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import qrsim
from qrsim.control import ComplementaryFilter, Estimate
from qrsim.control.mahony import Turning
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.errors import ScenarioError

DT = 0.02
SENSORS = (
    "fleets.pelicans.sensors={gnss: {type: gnss_receiver}, barometer: {type: barometer}, "
    "imu: {type: imu, preset: icm42688p}}"
)
MAHONY = "fleets.pelicans.estimator=complementary"


def vec(*axes: float) -> Vec3:
    return Vec3(*(jnp.array([axis]) for axis in axes))


def euler(*angles: float) -> Euler:
    return Euler(*(jnp.array([angle]) for angle in angles))


def turning(*angles: float) -> Turning:
    return Turning.start(Quaternion.of(euler(*angles)), vec(0.0, 0.0, 0.0))


def test_a_force_says_how_far_the_tilt_is_off():
    """Level, and believed to be rolled by 0.1 rad: it has to turn back about north by the sine of that."""
    error = turning(0.1, 0.0, 0.0).tilt_error(vec(0.0, 0.0, -9.81), jnp.array(9.81))
    assert [float(axis[0]) for axis in error.axes] == pytest.approx([-math.sin(0.1), 0.0, 0.0], abs=1e-5)


def test_an_acceleration_is_no_tilt():
    """2 m/s2 to the north by fixes 0.2 s apart: the force is then 2 m/s2 to the north, too, and nothing is wrong."""
    moving = replace(turning(0.0, 0.0, 0.0), since_fix=jnp.array([0.2]))
    moving = moving.with_velocity(vec(0.4, 0.0, 0.0), jnp.array([True]))
    assert [float(axis[0]) for axis in moving.acceleration_ned.axes] == pytest.approx([2.0, 0.0, 0.0])
    error = moving.tilt_error(vec(2.0, 0.0, -9.81), jnp.array(9.81))
    assert [float(axis[0]) for axis in error.axes] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    # The same force at rest is a nose that is lower than it is thought to be: about east, by its angle.
    still = turning(0.0, 0.0, 0.0).tilt_error(vec(2.0, 0.0, -9.81), jnp.array(9.81))
    assert float(still.y[0]) == pytest.approx(math.sin(math.atan2(2.0, 9.81)), abs=1e-5)


def test_headings():
    """A field of the north read 0.2 rad to the left is a yaw of 0.2; a course counts from 3 m/s on."""
    there = rotation(euler(0.0, 0.0, 0.2)).to_body(vec(20.0, 1.0, 44.0))
    assert float(turning(0.0, 0.0, 0.0).compass_error(there, jnp.arctan2(1.0, 20.0))[0]) == pytest.approx(0.2, abs=1e-5)
    error = turning(0.0, 0.0, 3.0).course_error(vec(-4.0, -1.0, 0.0), jnp.array(3.0))
    assert float(error[0]) == pytest.approx(math.atan2(-1.0, -4.0) - 3.0 + 2.0 * math.pi, abs=1e-5)
    assert np.isnan(turning(0.0, 0.0, 3.0).course_error(vec(-2.0, -1.0, 0.0), jnp.array(3.0))[0])


def reading(**fields: Any) -> Any:
    return SimpleNamespace(**fields, __dataclass_fields__=dict(fields))


@pytest.mark.long
def test_it_finds_tilt_heading_and_bias():
    """At rest, begun 0.1 rad off in roll and yaw, with a gyroscope that is wrong by 0.01 rad/s: gone after 100 s.

    Without the fix's velocities at rest there is no acceleration; poles of s^2 + 0.3 s + 0.02 are at -0.1 and -0.2 /s.
    """
    kalman = ComplementaryFilter().fitted({}, vec(20.0, 1.0, 44.0))
    given = {
        "imu": reading(rates_body=vec(0.01, -0.01, 0.01), specific_force=vec(0.0, 0.0, -9.81)),
        "gnss": reading(position_ned=vec(0.0, 0.0, 0.0), velocity_ned=vec(0.0, 0.0, 0.0)),
        "magnetometer": reading(field_body=vec(20.0, 1.0, 44.0)),
    }
    state, _ = kalman.init(given, Estimate(vec(0.0, 0.0, 0.0), vec(0.0, 0.0, 0.0), euler(0.1, 0.0, 0.1)))

    def tick(state: Any, k: Any) -> Any:
        fresh = {"imu": jnp.array(True), "gnss": k % 10 == 0, "magnetometer": k % 5 == 0}
        state, estimate = kalman.step(state, given, fresh, DT)
        return state, estimate.attitude

    state, angles = jax.jit(lambda state: jax.lax.scan(tick, state, jnp.arange(5000)))(state)
    for name in ("roll", "pitch", "yaw"):
        assert abs(float(getattr(angles, name)[-1, 0])) < 2e-3, name
    found = [float(axis[0]) for axis in state.turning.gyroscope_bias.axes]
    assert found == pytest.approx([0.01, -0.01, 0.01], abs=5e-4)
    # From 0.1 rad, turned by -0.3 * 0.1 + 0.01 rad/s, only the faster pole is moved: e^-2 is left after 10 s.
    assert float(angles.roll[499, 0]) == pytest.approx(0.1 * math.exp(-2.0), abs=1e-3)


def test_an_attitude_or_a_gyroscope():
    bare = (
        "fleets.pelicans.sensors={gnss: {type: gnss_receiver}, barometer: {type: barometer}, a: {type: accelerometer}}"
    )
    with pytest.raises(
        ScenarioError, match="no sensor gives attitude; add one of type attitude_estimator or gyroscope"
    ):
        qrsim.load_scenario("patrol_plain", [bare, MAHONY])
    assert qrsim.load_scenario("patrol_plain", [SENSORS, MAHONY]).world().fleets[0].own_estimator is not None


@pytest.mark.long
def test_the_default_patrol_is_flown_on_it():
    """60 s on an inertial chip, without a reported attitude: 0.5 deg/s of turn-on bias are 0.03 rad until learned."""
    scenario = qrsim.load_scenario("patrol_plain", [SENSORS, MAHONY, "duration=60"], quiet=True)

    def tilt(state: Any) -> Any:
        fleet = state.fleets[0]
        own, true = fleet.belief.estimate.attitude, fleet.vehicle.attitude
        return jnp.stack([own.roll - true.roll, own.pitch - true.pitch])

    found = qrsim.rollout(scenario, seeds=range(3), record=tilt)
    assert np.asarray(found.metrics["flown_s"]) == pytest.approx(60.0)
    assert np.sqrt(np.mean(np.square(found.recorded))) < 0.08
