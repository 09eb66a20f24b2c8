"""What estimators compute, by hand.

From docs/explanation/models/estimators.md (F1 to F8), where the numbers are small enough for that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from qrsim.control.consistency import normalised, of_blocks, turned
from qrsim.control.covariance import independent, variances
from qrsim.control.ekf import ErrorStateKalmanFilter
from qrsim.control.kalman_readings import compass, heights
from qrsim.control.kalman_state import Inner, KalmanState, Places, lost, of_angles, small
from qrsim.control.kalman_unseen import leaned
from qrsim.control.mahony import Turning
from qrsim.control.setpoints import Estimate
from qrsim.core.quaternions import Quaternion
from qrsim.core.vectors import Euler, Rotation, Vec3

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


def quick(function: Callable[..., Any], *given: Any) -> Any:
    """Call a function compiled as quickly as possible, which takes less time than its operations one by one."""
    return jax.jit(function, compiler_options=QUICK)(*given)


def one(value: float) -> Any:
    """Of one vehicle."""
    return np.array([value], np.float32)


def vec(*axes: float) -> Vec3:
    return Vec3(*map(one, axes))


def numbers(vector: Vec3) -> list[float]:
    return [float(axis[0]) for axis in vector.axes]


NONE = vec(0.0, 0.0, 0.0)
LEVEL = Quaternion(one(1.0), one(0.0), one(0.0), one(0.0))


class TestConsistency:
    """Bar-Shalom, Li and Kirubarajan 2001, section 5.4: e' P^-1 e; divided by the number of errors."""

    def test_errors_that_are_one_and_the_same(self) -> None:
        """The second is known by the first, but for the 1e-6 of rounding: e = (0, 0.001) is one std of that, of two."""
        covariance = np.ones((2, 2, 1), np.float32)
        found = quick(normalised, covariance, np.array([[0.0], [1e-3]], np.float32))
        assert float(found[0]) == pytest.approx(0.5, rel=1e-4)

    def test_two_that_depend(self) -> None:
        """P = [[4, 2], [2, 2]], e = (2, 1): the inverse is [[0.5, -0.5], [-0.5, 1]], and e' P^-1 e is 1."""
        covariance = np.array([[4.0, 2.0], [2.0, 2.0]], np.float32)[..., None]
        found = quick(normalised, covariance, np.array([[2.0], [1.0]], np.float32))
        assert float(found[0]) == pytest.approx(0.5, rel=1e-5)

    @pytest.mark.parametrize("whole_turns", [0, 1])
    def test_the_rotation_between(self, whole_turns: int) -> None:
        """0.2 rad to the right is 2 sin(0.1) about down; a whole turn is none, whatever the quaternion's sign."""
        yaw = one(0.2 + 2.0 * math.pi * whole_turns)
        found = quick(turned, Euler(one(0.0), one(0.0), yaw), LEVEL)
        assert numbers(found) == pytest.approx([0.0, 0.0, 2.0 * math.sin(0.1)], abs=2e-6)

    def test_blocks(self) -> None:
        """Errors of 1, 2, 3 ... std: each block has the mean of its squares; three more errors are not looked at."""
        errors = [one(k) for k in range(1, 16)]
        found = quick(lambda p, e: of_blocks(p, e, True), np.eye(18, dtype=np.float32)[..., None], errors)
        blocks = found.every, found.position, found.velocity, found.attitude, found.bias
        # k^2 from 1 to n sum to n (n + 1) (2 n + 1)/6: 14, 91, 285 and 1240 up to 3, 6, 9 and 15.
        assert np.ravel(blocks) == pytest.approx([1240 / 15, 14 / 3, 77 / 3, 194 / 3, 955 / 6], rel=1e-5)

    def test_blocks_without_biases(self) -> None:
        errors = [one(k) for k in range(1, 10)]
        found = quick(lambda p, e: of_blocks(p, e, False), np.eye(18, dtype=np.float32)[..., None], errors)
        blocks = found.every, found.position, found.velocity, found.attitude
        assert np.ravel(blocks) == pytest.approx([285 / 9, 14 / 3, 77 / 3, 194 / 3], rel=1e-5)
        assert np.isnan(found.bias[0])


def state(inner: Inner) -> KalmanState:
    """At rest in the origin, level to the north; what is not read is left out."""
    absent: Any = ()
    return KalmanState(NONE, NONE, NONE, LEVEL, inner, NONE, NONE, (), NONE, one(0.0), absent)


class TestKalman:
    def test_how_many_errors_there_are(self) -> None:
        """15 of motion and biases; wind and height's bias stand in three, the field and its bias in six before them."""
        zero = one(0.0)
        field = {"earth_field_ned": NONE, "field_bias": NONE}
        wind = {"wind_north": zero, "wind_east": zero}
        assert Places.of(Inner(NONE, NONE)) == (None, None, None, None, 15)
        assert Places.of(Inner(NONE, NONE, **wind)) == (None, None, 15, None, 18)
        assert Places.of(Inner(NONE, NONE, height_bias=zero)) == (None, None, None, 17, 18)
        assert Places.of(Inner(NONE, NONE, **field, **wind)) == (15, 18, 21, None, 24)  # type: ignore[arg-type]

    def test_straight_up_angles_are_bounded(self) -> None:
        """A nose within 0.01 of straight up counts as 0.01 off, with the direction it has: 0.005 north is half of it.

        Roll: 0.5/0.01 by north, and yaw: 0.005/0.01^2.
        """
        nose = Rotation(vec(0.005, 0.0, -1.0), vec(0.0, 1.0, 0.0), vec(1.0, 0.0, 0.005))
        roll, pitch, yaw = quick(of_angles, nose)
        found = [float(value[0]) for value in (roll[6], roll[7], pitch[6], pitch[7], yaw[6], yaw[7], yaw[8])]
        assert found == pytest.approx([50.0, 0.0, 0.0, 0.5, 50.0, 0.0, 1.0], rel=1e-5)

    def test_a_small_rotation_is_that_of_its_series(self) -> None:
        """Half of 0.3 rad: cos = 1 - 0.09/2, and sin = 0.3 (1 - 0.09/6), in the share 0.6, 0, 0.8 of the axes."""
        found = quick(small, vec(0.18, 0.0, -0.24))
        parts = [float(axis[0]) for axis in (found.w, found.x, found.y, found.z)]
        assert parts == pytest.approx([0.955, 0.6 * 0.2955, 0.0, -0.8 * 0.2955], abs=1e-6)

    def test_a_lean_is_remembered(self) -> None:
        """(F1) Of the 20 s of the mean a tick of 1 s is a twentieth, and adds twice that share of the square.

        A turn to the right side, from (0, 0, 1) to (0, 1, 0), changes two axes by 1. The nineteen twentieths that are
        left each time add up to 2/20 (1 + 0.95^2 + 0.95^4 ...) = 0.1/(1 - 0.9025) of the square, which is 1.03 of it.
        """
        aside = Rotation(vec(1.0, 0.0, 0.0), vec(0.0, 0.0, 1.0), vec(0.0, -1.0, 0.0))
        lean, added = vec(0.0, 0.0, 1.0), []
        for _ in range(2):
            lean, square = quick(lambda lean: leaned(lean, aside, 1.0), lean)
            added.append(float(square[0]))
        assert added == pytest.approx([0.1 * 2.0, 0.1 * 2.0 * 0.9025], rel=1e-5)
        assert numbers(lean) == pytest.approx([0.0, 0.0975, 0.9025], rel=1e-5)

    def test_who_is_lost_knows_little(self) -> None:
        """A hundred stds of a fix, 10 m/s, and 0.2 rad of each angle (11 degrees); biases stay as they were."""

        def after(before: Any, of_fix: Any) -> Any:
            where: Any = np.array([True])
            return variances(lost(independent(before), of_fix, where))

        found = quick(after, [one(0.5)] * 15, [one(1.0), one(2.0), one(4.0)])
        expected = [1e4, 2e4, 4e4, 100.0, 100.0, 100.0, 0.04, 0.04, 0.04, *[0.5] * 6]
        np.testing.assert_allclose(np.ravel(found), expected, rtol=1e-5)

    def test_a_height_is_that_of_the_place(self) -> None:
        """2 m up where 0 is thought: 2 m less down, which is the third error."""
        (found,) = quick(heights, state(Inner(NONE, NONE)), one(2.0), one(0.09))
        assert {key: float(value[0]) for key, value in found.sensitivity.items()} == {2: 1.0}
        assert float(found.innovation[0]) == -2.0

    def test_a_field_without_a_level_part(self) -> None:
        """(F4) with H of at least 0.001 uT: 0.05 uT down are 50 of that, and a wrong tilt to the north is felt."""
        (found,) = quick(compass, state(Inner(NONE, NONE)), vec(0.0, 0.0, 0.05), one(0.0), one(0.01))
        slopes = {key: float(value[0]) for key, value in found.sensitivity.items()}
        assert slopes == pytest.approx({6: -50.0, 7: 0.0, 8: 1.0}, rel=1e-5)

    def test_a_tick_moves_it_by_half_of_its_acceleration(self) -> None:
        """(F1) At 3 m/s to the north with 2 m/s^2: 3 + 2/2 m in a second, and 5 m/s then."""

        def after(force: Vec3) -> Any:
            fields = {"rates_body": NONE, "specific_force": force}
            readings = {"imu": SimpleNamespace(**fields, __dataclass_fields__=fields)}
            kalman = ErrorStateKalmanFilter()
            start = Estimate(NONE, vec(3.0, 0.0, 0.0), Euler(*NONE.axes))
            return kalman.step(kalman.init(readings, start)[0], readings, {}, 1.0)[1]

        found = quick(after, vec(2.0, 0.0, -9.81))
        assert numbers(found.position_ned) == pytest.approx([4.0, 0.0, 0.0], abs=1e-5)
        assert numbers(found.velocity_ned) == pytest.approx([5.0, 0.0, 0.0], abs=1e-5)


class TestComplementary:
    """(F8), of a state that is level and at rest."""

    def test_two_fixes_at_once_are_a_millisecond_apart(self) -> None:
        """3 mm/s within that: 3 m/s^2."""

        def after(velocity: Vec3) -> Any:
            new: Any = np.array([True])
            return Turning.start(LEVEL, NONE).with_velocity(velocity, new).acceleration_ned

        assert numbers(quick(after, vec(0.003, 0.0, -0.001))) == pytest.approx([3.0, 0.0, -1.0], rel=1e-5)

    def test_next_to_no_force_says_little_of_the_tilt(self) -> None:
        """1e-5 m/s^2 to the north where 10 up is expected: the product of both counts as 0.001, so the error is 0.1."""

        def after(force: Vec3) -> Any:
            return Turning.start(LEVEL, NONE).tilt_error(force, one(10.0))

        assert numbers(quick(after, vec(1e-5, 0.0, 0.0))) == pytest.approx([0.0, 0.1, 0.0], rel=1e-5)

    def test_it_turns_by_the_mean_rate_and_the_correction(self) -> None:
        """0 and 0.4 rad/s about north for half a second are 0.1 rad, 0.06 rad more put it right: 2 atan(0.08)."""

        def after(rates: Vec3, correction: Vec3) -> Any:
            return Turning.start(LEVEL, NONE).turned(rates, correction, NONE, 0.5).attitude

        found = quick(after, vec(0.4, 0.0, 0.0), vec(0.06, 0.0, 0.0))
        half = math.atan(0.08)
        assert [float(found.w[0]), float(found.x[0])] == pytest.approx([math.cos(half), math.sin(half)], abs=1e-6)
        assert [float(found.y[0]), float(found.z[0])] == [0.0, 0.0]
