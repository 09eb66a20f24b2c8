"""The error-state Kalman filter: its algebra against matrices, its errors against what it states, gates, late fixes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from tests.by_numpy import by_numpy
from tests.control.kalman_rig import DT, Fix, Heading, Height, Inertial, errors, filtered, flown, matched

from qrsim.control.covariance import (
    Covariance,
    Measured,
    corrected,
    forgotten,
    independent,
    matrix,
    propagated,
    variance_of,
    variances,
)
from qrsim.control.kalman_state import SIZE, TURN, moves, of_angles
from qrsim.control.setpoints import Estimate
from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3, rotation


def vec(*axes: float) -> Vec3:
    return Vec3(*(jnp.array([axis]) for axis in axes))


@pytest.fixture
def covariance() -> np.ndarray:
    """Of one vehicle, (15, 15)."""
    half = np.random.default_rng(3).normal(size=(SIZE, SIZE))
    return half @ half.T + np.eye(SIZE)


def halves(matrix: np.ndarray, count: int = 1) -> Covariance:
    """Return the covariance of so many vehicles that all have this matrix."""
    upper = np.float32(matrix)[np.triu_indices(len(matrix))]
    return jnp.asarray(np.repeat(upper[:, None], count, axis=1))


def test_a_half_is_that_of_the_matrix(covariance: np.ndarray):
    given = halves(covariance, 2)
    assert given.shape == (120, 2)
    np.testing.assert_array_equal(matrix(given)[..., 1], np.float32(covariance))
    np.testing.assert_array_equal([variance[1] for variance in variances(given)], np.float32(np.diag(covariance)))


def test_independent_errors_have_a_diagonal_covariance():
    found = independent([jnp.full(2, 1.0 + k) for k in range(6)])
    np.testing.assert_array_equal(matrix(found)[..., 1], np.diag(np.arange(1.0, 7.0)))


@pytest.mark.long
def test_a_transition_is_that_of_matrices(covariance: np.ndarray):
    """F by its blocks (Sola 2017, section 7: rotations in the fixed frame)."""
    turned = rotation(Euler(*(jnp.array([angle]) for angle in (0.3, -0.2, 1.1))))
    axes = (turned.forward, turned.right, turned.down)
    to_ned = np.array([[float(part[0]) for part in (axis.x, axis.y, axis.z)] for axis in axes]).T
    # Of the specific force (1, -2, -9): cross @ x is force x x.
    cross = np.array([[0.0, 9.0, -2.0], [-9.0, 0.0, -1.0], [2.0, 1.0, 0.0]])
    whole = np.eye(SIZE)
    whole[0:3, 3:6] = 0.02 * np.eye(3)
    whole[3:6, 6:9] = -0.02 * cross
    whole[3:6, 12:15] = whole[6:9, 9:12] = -0.02 * to_ned
    noise = np.arange(15.0) * 1e-3
    found = propagated(
        halves(covariance), moves(vec(1.0, -2.0, -9.0), turned, 0.02), [jnp.array([value]) for value in noise]
    )
    expected = whole @ covariance @ whole.T + np.diag(noise)
    np.testing.assert_allclose(matrix(found)[..., 0], expected, rtol=2e-5, atol=2e-4)


@pytest.mark.long
def test_a_measurement_is_that_of_matrices(covariance: np.ndarray):
    """Kalman's equations with a sensitivity that is zero in most places; where it is not used nothing changes."""
    row = np.zeros(SIZE)
    row[[1, 4, 13]] = 1.0, -0.3, 0.5
    mean = np.linspace(-1.0, 1.0, SIZE)
    gain = covariance @ row / (row @ covariance @ row + 0.7)
    given = halves(covariance, 2)
    before = jnp.asarray(np.repeat(mean[:, None], 2, axis=1), jnp.float32)
    scalar = Measured(jnp.array([2.0, jnp.nan]), jnp.full(2, 0.7), {k: jnp.full(2, row[k]) for k in (1, 4, 13)})
    after, moved = corrected(given, before, [scalar], jnp.array([True, False]))
    np.testing.assert_allclose(moved[:, 0], mean + gain * (2.0 - row @ mean), rtol=1e-4, atol=1e-5)
    expected = covariance - np.outer(gain, row @ covariance)
    np.testing.assert_allclose(matrix(after)[..., 0], expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(moved[:, 1], jnp.asarray(mean, jnp.float32))
    np.testing.assert_array_equal(matrix(after)[..., 1], matrix(given)[..., 1])


def test_measurements_together_are_those_one_after_the_other(covariance: np.ndarray):
    """Three numbers of one reading at once, against the equations of Kalman for all of them."""
    rows = np.zeros((3, SIZE))
    rows[0, [1, 4]], rows[1, [1, 2, 7]], rows[2, 13] = (1.0, -0.3), (0.2, 1.0, 2.0), 1.0
    noise, innovations, mean = np.array([0.7, 0.2, 1.5]), np.array([2.0, -1.0, 0.5]), np.linspace(-1.0, 1.0, SIZE)
    scalars = [
        Measured(jnp.full(1, left), jnp.full(1, own), {k: jnp.full(1, row[k]) for k in np.flatnonzero(row).tolist()})
        for left, own, row in zip(innovations, noise, rows, strict=True)
    ]
    after, moved = corrected(halves(covariance), jnp.float32(mean)[:, None], scalars, jnp.array([True]))
    gain = covariance @ rows.T @ np.linalg.inv(rows @ covariance @ rows.T + np.diag(noise))
    np.testing.assert_allclose(moved[:, 0], mean + gain @ (innovations - rows @ mean), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(matrix(after)[..., 0], covariance - gain @ rows @ covariance, rtol=1e-4, atol=1e-4)
    assert float(variance_of(after, scalars[1].sensitivity)[0]) == pytest.approx(
        rows[1] @ (covariance - gain @ rows @ covariance) @ rows[1], rel=1e-4
    )


@pytest.mark.long
def test_what_is_forgotten_is_independent(covariance: np.ndarray):
    given = halves(covariance, 2)
    found = forgotten(given, {0: jnp.full(2, 4.0), 3: jnp.full(2, 9.0)}, jnp.array([True, False]))
    expected = covariance.copy()
    expected[[0, 3], :] = expected[:, [0, 3]] = 0.0
    expected[0, 0], expected[3, 3] = 4.0, 9.0
    np.testing.assert_allclose(matrix(found)[..., 0], expected, rtol=1e-6)
    np.testing.assert_array_equal(matrix(found)[..., 1], matrix(given)[..., 1])


def test_angles_turn_as_differences_say():
    """Roll, pitch and yaw of an attitude that is turned a little about each axis of NED."""
    angles = Euler(jnp.array([0.4]), jnp.array([-0.3]), jnp.array([2.0]))
    rows = of_angles(rotation(angles))
    small = 1e-3
    for axis in range(3):
        half = [0.5 * small if axis == k else 0.0 for k in range(3)]
        turned = (Quaternion(jnp.ones(1), *(jnp.array([part]) for part in half)) * Quaternion.of(angles)).euler()
        for row, name in zip(rows, ("roll", "pitch", "yaw"), strict=True):
            slope = (getattr(turned, name) - getattr(angles, name)) / small
            expected = row.get(TURN + axis, jnp.zeros(1))
            assert float(slope[0]) == pytest.approx(float(expected[0]), abs=2e-3), (name, axis)


@pytest.mark.long
@pytest.mark.parametrize(
    ("ticks", "count", "late"), [(160, 64, 10), pytest.param(600, 100, 15, marks=pytest.mark.nightly)]
)
def test_errors_are_as_large_as_stated(ticks: int, count: int, late: int):
    """Normalised squares of all 15 errors, with the noise that the filter is told of, on time and late.

    Each sum over the vehicles is chi-square distributed, here within its 99.9 % band. In three seconds the errors of
    place and speed fall to what 15 fixes of 1.5 m and 0.2 m/s allow.
    """
    kalman = replace(matched(), ages=(("gnss", late),) if late else ())
    truth = flown(ticks, count, np.random.default_rng(1))
    states, biases = filtered(kalman, truth, 2, late)
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], SIZE * count)
    for k in np.linspace(ticks // 5, ticks, 5).astype(int):
        found, stated = errors(states, truth, biases, k)
        nees = np.einsum("ni,nij,nj->", found, np.linalg.inv(stated), found)
        assert low < nees < high, (k, nees / count)
    assert found[:, :2].std() < 0.6
    assert found[:, 3:5].std() < 0.25


@pytest.mark.long
def test_rounding_leaves_a_covariance_one_for_minutes():
    """After 200 s in single precision: symmetric, and no error has a variance below zero in any direction."""
    truth = flown(10_000, 3, np.random.default_rng(5))
    states, _ = filtered(replace(matched(), ages=(("gnss", 10),)), truth, 6, 10)
    for k in (5000, 10_000):
        found = np.moveaxis(np.asarray(matrix(states.covariance)[k - 1], np.float64), -1, 0)
        scale = np.sqrt(np.einsum("nii->ni", found))
        scaled = found / scale[:, :, None] / scale[:, None]
        np.testing.assert_allclose(scaled, np.swapaxes(scaled, 1, 2), atol=1e-4)
        assert np.linalg.eigvalsh(scaled).min() > -1e-4


def readings(fix: tuple[float, ...], **other: Vec3) -> dict[str, Any]:
    level = Vec3(jnp.zeros(1), jnp.zeros(1), jnp.full(1, -9.81))
    zero = jnp.zeros(1)
    return {
        "imu": Inertial(vec(0.0, 0.0, 0.0), level),
        "gnss": Fix(vec(*fix), other.get("velocity", vec(0.0, 0.0, 0.0))),
        "barometer": Height(zero),
        "compass": Heading(Euler(zero, zero, zero)),
    }


def start() -> Estimate:
    zero = jnp.zeros(1)
    return Estimate(vec(0.0, 0.0, 0.0), vec(0.0, 0.0, 0.0), Euler(zero, zero, zero))


def test_the_gate_is_five_times_what_is_expected():
    """A first fix of 1.5 m std beside a place of 1.5 m std: 2.12 m are expected, and 10.6 m are the limit."""
    kalman = matched()
    state = kalman.init(readings((0.0, 0.0, 0.0)), start())[0]

    def step(given: dict[str, Any]) -> Any:
        return kalman.step(state, given, dict.fromkeys(given, jnp.array(True)), 1e-4)[1].position_ned.x

    believed = by_numpy(step, [(readings((north, 0.0, 0.0)),) for north in (10.4, 10.8)])
    np.testing.assert_allclose(believed, [[5.2], [0.0]], atol=0.01)


@pytest.mark.long
def test_a_jump_is_not_believed_until_it_lasts():
    """Of 100 m: beyond the gate for 7 s, then the filter begins there again. NaN is no reading; std grows meanwhile."""
    kalman = matched()
    always = {name: jnp.array(True) for name in ("imu", "gnss", "barometer", "compass")}
    state, _ = kalman.init(readings((0.0, 0.0, 0.0)), start())
    step = jax.jit(lambda state, given: kalman.step(state, given, always, DT))
    for _ in range(100):
        state, estimate = step(state, readings((0.0, 0.0, 0.0)))
    calm = float(kalman.std(state).position_ned.x[0])
    assert float(state.innovations.position_ned[0]) == 0.0
    nothing = readings((float("nan"),) * 3, velocity=vec(*(float("nan"),) * 3))
    for _ in range(50):
        state, estimate = step(state, nothing)
    assert float(kalman.std(state).position_ned.x[0]) > 1.2 * calm
    assert abs(float(estimate.position_ned.x[0])) < 1e-3
    far = readings((100.0, 0.0, 0.0))
    for _ in range(290):
        state, estimate = step(state, far)
    assert abs(float(estimate.position_ned.x[0])) < 1e-3, "6.8 s after the last fix"
    assert float(state.innovations.position_ned[0]) > 5.0
    for _ in range(20):
        state, estimate = step(state, far)
    assert float(estimate.position_ned.x[0]) == pytest.approx(100.0, abs=0.5)


@pytest.mark.long
def test_who_is_sure_of_a_wrong_tilt_finds_back():
    """Of 0.4 rad, which accelerates the estimate by 4 m/s^2; 7 s later the filter begins again, and finds the tilt."""
    kalman = matched()
    given = readings((0.0, 0.0, 0.0))
    always = {name: jnp.array(True) for name in given}
    wrong = Quaternion.of(Euler(jnp.full(1, 0.4), jnp.zeros(1), jnp.zeros(1)))
    begun, _ = kalman.init(given, start())
    step = jax.jit(lambda state: kalman.step(state, given, always, DT))
    for _ in range(500):
        begun, _ = step(begun)
    state, far, estimate = replace(begun, attitude=wrong), 0.0, start()
    for _ in range(500):
        state, estimate = step(state)
        far = max(far, abs(float(estimate.position_ned.y[0])))
    assert far > 20.0
    # With the tilt that it was sure of it still leans by 0.12 rad then, and flies at 0.5 m/s.
    assert abs(float(estimate.attitude.roll[0])) < 0.05
    assert abs(float(estimate.velocity_ned.y[0])) < 0.1


def test_what_a_late_fix_says_of_errors_now():
    """0.2 s late: where the vehicle was then is 0.2 s of its velocity behind, and that by what accelerates it.

    By hand, level and facing north, with a specific force of (1, -2, -9): d(dv) = -0.2 (dr x a - db_a).
    """
    kalman = replace(matched(), ages=(("gnss", 10),))
    given = readings((0.0, 0.0, 0.0))
    state = replace(kalman.init(given, start())[0], force_ned=vec(1.0, -2.0, -9.0))
    found = {what: scalars for what, scalars, _ in kalman._by_fix(state, given, lambda _: jnp.array([True]), DT)}
    factors = [
        {k: pytest.approx(float(factor[0])) for k, factor in scalar.sensitivity.items() if float(factor[0])}
        for scalar in (*found["position_ned"], *found["velocity_ned"])
    ]
    assert factors == [
        {0: 1.0, 3: -0.2},
        {1: 1.0, 4: -0.2},
        {3: 1.0, 7: 1.8, 8: -0.4, 12: 0.2},
        {4: 1.0, 6: -1.8, 8: -0.2, 13: 0.2},
        {5: 1.0, 6: 0.4, 7: 0.2, 14: 0.2},
    ]


def test_accuracies_that_a_fix_states_count():
    """``horizontal_accuracy`` is of both axes together: of 2 m each has a variance of 2 m2."""
    kalman = matched()
    plain = kalman.init(readings((0.0, 0.0, 0.0)), start())[0]
    assert float(variances(plain.covariance)[0][0]) == pytest.approx(2.25)
    fix = SimpleNamespace(
        position_ned=vec(0.0, 0.0, 0.0),
        velocity_ned=vec(0.0, 0.0, 0.0),
        horizontal_accuracy=jnp.array([2.0]),
        vertical_accuracy=jnp.array([3.0]),
        speed_accuracy=jnp.array([0.1]),
    )
    fix.__dataclass_fields__ = dict(vars(fix))
    given = {**readings((0.0, 0.0, 0.0)), "gnss": fix}
    stated = kalman.init(given, start())[0]
    assert float(variances(stated.covariance)[0][0]) == pytest.approx(2.0)
    # ``speed_accuracy`` is of all three axes together: a third of 0.01 each, where nothing is known of the satellites.
    assert float(variances(stated.covariance)[3][0]) == pytest.approx(0.01 / 3.0)
    assert float(variances(stated.covariance)[2][0]) == pytest.approx(0.09), "the barometer has the height"
    del given["barometer"]
    assert float(variances(kalman.init(given, start())[0].covariance)[2][0]) == pytest.approx(9.0)
