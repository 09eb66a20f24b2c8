"""How the Kalman filter starts, and the errors that it considers.

By hand from docs/explanation/models/estimators.md (F6, F7).
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control.contracts import Preflight
from qrsim.control.covariance import variances
from qrsim.control.ekf import ErrorStateKalmanFilter, _shares
from qrsim.control.kalman_state import KalmanState
from qrsim.control.kalman_unseen import Unseen, along, unseen, with_unseen
from qrsim.control.setpoints import Estimate
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3

pytestmark = pytest.mark.long

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
G = 9.81


def one(value: float) -> Any:
    """Of one vehicle."""
    return np.array([value], np.float32)


def vec(*axes: float) -> Vec3:
    return Vec3(*map(one, axes))


def reading(**fields: Any) -> Any:
    return SimpleNamespace(**fields, __dataclass_fields__=dict(fields))


NONE = vec(0.0, 0.0, 0.0)


def begun(
    kalman: ErrorStateKalmanFilter,
    force: Vec3,
    field: Vec3 | None = None,
    at_rest: bool | None = True,
    normal: float = 0.0,
) -> KalmanState:
    """The first state of a vehicle that is truly level to the north, by what its sensors read."""
    readings = {
        "imu": reading(rates_body=vec(0.35, 0.0, 0.0), specific_force=force),
        "gnss": reading(position_ned=NONE, velocity_ned=NONE),
    }
    if field is not None:
        readings["compass"] = reading(field_body=field)
    rest = None if at_rest is None else np.array([at_rest])
    preflight = Preflight((one(normal),) * 9, rest, vec(0.35, -0.2, 0.1))  # type: ignore[arg-type]
    start = Estimate(NONE, NONE, Euler(one(0.0), one(0.0), one(0.0)))
    return jax.jit(lambda: kalman.begin(readings, start, preflight)[0], compiler_options=QUICK)()


def angles(state: KalmanState) -> list[float]:
    found = state.attitude.euler()
    return [float(angle[0]) for angle in (found.roll, found.pitch, found.yaw)]


SLOPE = math.radians(20.0)


@pytest.mark.parametrize(
    ("force", "roll", "pitch"),
    [
        pytest.param((0.0, 0.0, -G), 0.0, 0.0, id="level"),
        pytest.param((G * math.sin(SLOPE), 0.0, -G * math.cos(SLOPE)), 0.0, SLOPE, id="nose up on a slope"),
        pytest.param((0.0, -G * math.sin(SLOPE), -G * math.cos(SLOPE)), SLOPE, 0.0, id="right side down"),
        pytest.param((0.0, 0.1, G), -math.pi, 0.0, id="upside down"),
    ],
)
def test_an_accelerometer_at_rest_levels(force: tuple[float, float, float], roll: float, pitch: float):
    """Specific force at rest is -g along the vertical, whatever the attitude; the yaw is not known by it."""
    found = angles(begun(ErrorStateKalmanFilter(), vec(*force)))
    assert abs(math.remainder(found[0] - roll, 2.0 * math.pi)) < 0.02
    assert found[1] == pytest.approx(pitch, abs=1e-3)


def test_levelling_knows_no_tilt_better_than_its_accelerometer():
    """A bias of 0.5 m/s^2 is a tilt of 0.5/9.81 = 0.051 rad; vertically the bias is seen."""
    kalman = replace(ErrorStateKalmanFilter(), accelerometer_bias_std=np.float32(0.5))
    found = np.sqrt(np.ravel(variances(begun(kalman, vec(0.0, 0.0, -G)).covariance)))
    assert found[6:8] == pytest.approx([0.051] * 2, rel=0.05)
    # White noise of a reading, 0.02 / sqrt(0.02 s).
    assert found[12:15] == pytest.approx([0.5, 0.5, 0.14], rel=0.05)


def test_a_compass_heads_and_the_declination_counts():
    """A field of 20 uT seen ahead, where it points 0.1 rad east of north: the vehicle faces 0.1 rad east."""
    earth = vec(20.0 * math.cos(0.1), 20.0 * math.sin(0.1), 44.0)
    kalman = replace(ErrorStateKalmanFilter(), earth_field_ned=earth)
    assert angles(begun(kalman, vec(0.0, 0.0, -G), vec(20.0, 0.0, 44.0)))[2] == pytest.approx(0.1, abs=2e-3)


def test_near_a_magnetic_pole_a_compass_does_not_head():
    """2 uT with a bias of 2 uT show nothing: the yaw stays, with the std of a start in flight."""
    kalman = replace(ErrorStateKalmanFilter(), earth_field_ned=vec(2.0, 0.0, 56.0))
    state = begun(kalman, vec(0.0, 0.0, -G), vec(0.0, 2.0, 56.0))
    assert abs(angles(state)[2]) < 0.05
    assert float(variances(state.covariance)[8][0]) <= 0.03**2 * 1.01


@pytest.mark.parametrize("at_rest", [None, False])
def test_a_start_in_flight_errs_by_what_it_states(at_rest: bool | None):
    """Normals of 2: twice 0.015 rad of roll and pitch, 0.03 rad of yaw; the first force is not looked at."""
    found = angles(begun(ErrorStateKalmanFilter(), vec(3.0, 0.0, -9.0), at_rest=at_rest, normal=2.0))
    assert found == pytest.approx([0.03, 0.03, 0.06], abs=2e-3)


def test_a_calibration_removes_the_bias():
    """What a gyroscope errs by at rest but for 0.001 rad/s, in flight too; without a calibration it is not known."""
    kalman = ErrorStateKalmanFilter()
    state = begun(kalman, vec(0.0, 0.0, -G), at_rest=None, normal=-1.0)
    assert [float(axis[0]) for axis in state.inner.gyroscope_bias.axes] == pytest.approx([0.349, -0.201, 0.099])
    assert float(variances(state.covariance)[9][0]) == pytest.approx(1e-6)
    bare = begun(replace(kalman, calibration_time=0.0), vec(0.0, 0.0, -G), at_rest=None)
    assert [float(axis[0]) for axis in bare.inner.gyroscope_bias.axes] == [0.0, 0.0, 0.0]
    assert float(variances(bare.covariance)[9][0]) == pytest.approx(1e-4)


def test_a_start_on_the_truth_draws_nothing():
    kalman = replace(ErrorStateKalmanFilter(), start="truth", calibration_time=0.0)
    assert kalman.first_normals == 0
    assert angles(begun(kalman, vec(3.0, 0.0, -9.0), normal=5.0)) == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_more_fixes_do_not_average_a_slow_error_away():
    """A position that is known to 0.1 m against fixes that err by 1.5 m is known to 1.503 m; white, to 0.1 m."""
    for errors, std in (("coloured", math.hypot(1.5, 0.1)), ("white", 0.1)):
        kalman = replace(ErrorStateKalmanFilter(), gnss_errors=errors)
        state = begun(kalman, vec(0.0, 0.0, -G))
        # The first number is the variance of the first axis.
        sure = jnp.asarray(state.covariance).at[0].multiply((0.1 / 1.5) ** 2)
        stated = jax.jit(kalman.std, compiler_options=QUICK)(replace(state, covariance=sure))
        assert float(stated.position_ned.x[0]) == pytest.approx(std, rel=1e-3)


def test_an_accelerometer_that_leans_leans_the_estimate():
    """Errors of 0.04 per axis beside tilts known to 0.03 rad: 0.05 rad, and no more of the yaw."""
    kalman = replace(
        ErrorStateKalmanFilter(),
        tilt_std=np.float32(0.03),
        heading_std=np.float32(0.03),
        accelerometer_scale=np.float32(0.04),
    )
    stated = jax.jit(kalman.std, compiler_options=QUICK)(begun(kalman, vec(0.0, 0.0, -G), at_rest=None))
    angles = [float(angle[0]) for angle in (stated.attitude.roll, stated.attitude.pitch, stated.attitude.yaw)]
    assert angles == pytest.approx([0.05, 0.05, 0.03], rel=1e-3)


def test_unseen_errors_are_added_with_what_they_share():
    """An error of variance 4 that two errors have, one twice: 4 [[1, 2], [2, 4]]; of their difference, 4."""
    error = Unseen(one(4.0), {0: one(1.0), 1: one(2.0)})
    found = with_unseen(np.eye(3, dtype=np.float32)[..., None], [error])  # type: ignore[arg-type]
    np.testing.assert_allclose(found[..., 0], [[5.0, 8.0, 0.0], [8.0, 17.0, 0.0], [0.0, 0.0, 1.0]], rtol=1e-6)
    assert float(along([error], {0: one(-1.0), 1: one(1.0)})[0]) == pytest.approx(4.0)


def test_a_speed_accuracy_is_of_all_axes():
    """Dilutions of 0.8 level and 1.2 down are 0.32 of 2.08 for each level axis, and 1.44 down."""
    level, down = _shares({"gnss": reading(hdop=one(0.8), vdop=one(1.2))})
    assert [float(level[0]), float(down[0])] == pytest.approx([0.32 / 2.08, 1.44 / 2.08])
    assert _shares({"gnss": reading(position_ned=NONE)}) == pytest.approx((1 / 3, 1 / 3))


def test_a_lean_changes_the_biases():
    """(F6) Leant from (0, 0, 1) to (0.6, 0, 0.8), the downward direction differs by 0.36 + 0.04 in square, times g^2.

    Of the accelerometer 1 % of that, and of its level axes 1 % of g too; of the gyroscope 0.0002 rad/s for 1 m/s^2.
    """
    leant = replace(begun(ErrorStateKalmanFilter(), vec(0.0, 0.0, -G)), lean=vec(0.6, 0.0, 0.8))
    found = unseen(leant, np.float32(0.01), np.float32(2e-4), np.float32(G))  # type: ignore[arg-type]
    stds = [float(along(found, {k: 1.0})[0]) ** 0.5 for k in (9, 11, 12, 14)]
    of_lean = 0.4**0.5 * G
    assert stds == pytest.approx([2e-4 * of_lean, 2e-4 * of_lean, 0.01 * 1.4**0.5 * G, 0.01 * of_lean], rel=1e-4)
