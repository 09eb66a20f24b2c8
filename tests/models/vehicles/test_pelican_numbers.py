"""Numbers of the identified quadrotor, its variants and what it holds, against the published equations by hand."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.core.tree import cast, record
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.vehicles.contracts import Handling
from qrsim.models.vehicles.envelope import _specific_force, envelope
from qrsim.models.vehicles.expression_quadrotor import ExpressionQuadrotor, value_at
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState, raw_to_command
from qrsim.models.vehicles.separate_quadrotor import SeparateQuadrotor

# Radians of a raw step of roll and pitch, -0.025 degrees, and of yaw, -254.760/2047 degrees a second (V3).
TILT, YAW = -4.363323129985824e-04, -2.1721547642e-03


pytestmark = pytest.mark.usefixtures("double_precision")


def vector(*values: float) -> Any:
    return Vec3(*(jnp.asarray([value]) for value in values))


def command(pitch: float, roll: float, throttle: float, yaw_rate: float, battery: float = 12.0) -> Command:
    return Command(*(jnp.asarray([value]) for value in (pitch, roll, throttle, yaw_rate, battery)))


def test_raw_units() -> None:
    """(V3): -0.025 degrees and -254.760/2047 degrees a second of a raw step, 4097 of full throttle."""
    one = np.ones(1)
    found = raw_to_command(40 * one, -80 * one, 2048.5 * one, 100 * one, 11 * one)  # type: ignore[arg-type]
    numbers = [float(np.asarray(part)[0]) for part in jax.tree.leaves(found)]
    assert numbers == pytest.approx([40 * TILT, -80 * TILT, 0.5, 100 * YAW, 11.0], rel=1e-6)


def test_slope_in_a_turn() -> None:
    """(V4) to (V10) at F = 15 N, v = (2, -1, 0.5), w = (0.1, -0.2, 0.3), roll 0.1 and pitch -0.2, no wind, T = 0.02.

    Full throttle asks for 43.97 N, of which 12 V allow 32.85: the thrust grows by 46.8004 N/s, as fast as it can.
    """
    vehicle: Any = cast(Quadrotor(), np.float64)
    zero = vector(0.0, 0.0, 0.0)
    attitude = Euler(jnp.asarray([0.1]), jnp.asarray([-0.2]), jnp.asarray([0.0]))
    state = QuadrotorState(zero, attitude, vector(2.0, -1.0, 0.5), vector(0.1, -0.2, 0.3), jnp.asarray([15.0]))
    slope, force = vehicle.derivative(
        state, command(-0.3, 0.25, 1.0, 0.6), lambda trig: zero, ProcessNoise(zero, zero), 0.02
    )
    lift = (15.0 + 0.02 * 46.8004) / 1.68
    felt = [-0.497391 * 2.0, 0.497391, -1.35341 * 0.5 - lift]
    np.testing.assert_allclose([axis[0] for axis in force.axes], felt, rtol=1e-9)
    np.testing.assert_allclose(slope.thrust, 46.8004, rtol=1e-12)
    roll = 179.797 * (-3.25060e-04 * 0.25 / TILT - 0.1) - 24.3536 * 0.1
    pitch = 179.797 * (-3.25060e-04 * -0.3 / TILT + 0.2) + 24.3536 * 0.2
    yaw = -4.81783e-03 * 0.6 / YAW - 5.08944 * 0.3
    np.testing.assert_allclose([axis[0] for axis in slope.rates_body.axes], [roll, pitch, yaw], rtol=1e-6)
    # D (0, 0, g) - w x v, w x v = (0.2, 0.55, 0.3).
    weight = [9.81 * math.sin(0.2), 9.81 * math.sin(0.1) * math.cos(0.2), 9.81 * math.cos(0.1) * math.cos(0.2)]
    expected = [f + g - c for f, g, c in zip(felt, weight, (0.2, 0.55, 0.3), strict=True)]
    np.testing.assert_allclose([axis[0] for axis in slope.velocity_body.axes], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("thrust", "throttle", "rate"),
    [
        # Half throttle, 2048.5 raw, is 12.254455 N: from half a newton below it is there in one step of 0.02 s.
        (11.754455, 0.5, 25.0),
        (12.754455, 0.5, -25.0),
        # Below 300 raw the rotors follow slowly: 200 raw is 0.908753 N.
        (10.908753, 200.0 / 4097.0, -30.7321),
    ],
)
def test_how_the_thrust_follows(thrust: float, throttle: float, rate: float) -> None:
    vehicle: Any = cast(Quadrotor(), np.float64)
    found = vehicle.thrust_rate(*(jnp.asarray([value]) for value in (thrust, throttle, 12.0)), 0.02)
    np.testing.assert_allclose(found, rate, rtol=1e-5)


def test_what_it_tells_its_controllers() -> None:
    """Hover by the published throttle and voltage; gains of the settled laws; rotors of 10 inches, 0.42 m apart."""
    vehicle = Quadrotor()
    idle = vehicle.idle_command(jnp.zeros(1))
    assert [float(part[0]) for part in jax.tree.leaves(idle)] == [0.0, 0.0, 0.59, 0.0, 12.0]
    known = vehicle.handling()
    assert known is not None
    assert float(known.tilt_gain) == pytest.approx(0.7449826, rel=1e-5)
    assert float(known.yaw_rate_gain) == pytest.approx(0.4358035, rel=1e-6)
    assert float(known.thrust_max) == pytest.approx(32.84978, rel=1e-6)
    curve = [float(part) for part in known.throttle_curve]
    assert curve == pytest.approx([0.663881, 3.0508270, 40.260643], rel=1e-5)
    share = vehicle.upright_share(command(0.3, -0.4, 0.5, 0.0))
    np.testing.assert_allclose(share, math.cos(0.7449826 * 0.3) * math.cos(0.7449826 * 0.4), rtol=1e-5)
    wake = vehicle.wake()
    assert float(wake.size) == pytest.approx(0.42)
    # Four discs of 5 inches radius: 4 pi 0.127^2.
    assert float(wake.disc_area) == pytest.approx(0.2026830, rel=1e-5)


def test_pitch_constants_of_its_own() -> None:
    """(V7) with kq0, kq1, kq2 in pitch alone; a commanded pitch settles at kq0 over the raw step."""
    vehicle: Any = SeparateQuadrotor(kq0=-4.0e-04, kq1=100.0, kq2=-10.0)  # type: ignore[arg-type]
    assert float(vehicle.handling().pitch_gain) == pytest.approx(0.9167325, rel=1e-6)
    zero = vector(0.0, 0.0, 0.0)
    attitude = Euler(jnp.asarray([0.1]), jnp.asarray([-0.2]), jnp.asarray([0.0]))
    state = QuadrotorState(zero, attitude, zero, vector(0.1, -0.2, 0.3), jnp.asarray([15.0]))
    found = vehicle.angular_acceleration(state, command(-0.3, 0.25, 1.0, 0.6))
    np.testing.assert_allclose(found.y, 100.0 * (0.9167325 * -0.3 + 0.2) + 10.0 * 0.2, rtol=1e-6)
    np.testing.assert_allclose(found.x, 179.797 * (0.7449826 * 0.25 - 0.1) - 24.3536 * 0.1, rtol=1e-5)


class TestLaws:
    def test_how_long_a_law_may_be(self) -> None:
        law = "throttle" + "+0" * 996
        assert ExpressionQuadrotor(thrust_law=law).thrust_law == law
        with pytest.raises(UsageError, match=r"thrust_law: 2001 characters; allowed: at most 2000"):
            ExpressionQuadrotor(thrust_law="9" + "+0" * 1000)

    def test_powers(self) -> None:
        assert value_at("3*throttle**4 - throttle**0", {"throttle": 2.0}) == 47.0
        assert value_at("throttle**9", {"throttle": 2.0}) == 512.0
        with pytest.raises(UsageError, match=r"'throttle \*\* 10' is not allowed"):
            ExpressionQuadrotor(thrust_law="throttle**10")

    def test_the_quadratic_next_to_a_cubic(self) -> None:
        """The least squares of u^3 at 41 even points: with t = 2 u - 1 the nearest line to t^3 is 0.6295 t.

        The mean of j^4 over that of j^2, j to 20, is 251.8, 0.6295 = 251.8/20^2; u^3 = (1 + 3t + 3t^2 + t^3)/8.
        """
        told = ExpressionQuadrotor(thrust_law="10*throttle + throttle**3").handling()
        assert told is not None
        assert [float(c) for c in told.throttle_curve] == pytest.approx([0.0463125, 9.407375, 1.5], rel=1e-9)
        # At full throttle the law itself says 11 N, less than the battery.
        assert float(told.thrust_max) == pytest.approx(11.0)

    @pytest.mark.parametrize(("bend", "rises"), [(4.5, True), (5.5, False)])
    def test_a_law_must_rise_up_to_full_throttle(self, bend: float, rises: bool) -> None:
        """10 u - b u^2 has the slope 10 - 2 b at full throttle."""
        law = ExpressionQuadrotor(thrust_law=f"10*throttle - {bend}*throttle**2")
        assert (law.handling() is not None) is rises

    def test_the_slope_at_rest_is_that_of_a_chord_of_two_ten_thousandths(self) -> None:
        """1e8 x^3 is 1e-4 at 1e-4: a slope of 1, beside a stiffness of 2."""
        told = ExpressionQuadrotor(tilt_law="1e8*command**3 - 2*angle - rate").handling()
        assert told is not None
        assert float(told.tilt_gain) == pytest.approx(0.5, rel=1e-9)

    def test_a_slope_beyond_double_precision_is_none(self) -> None:
        """1.95e308, where the largest number is 1.797e308; a tenth of it is one."""
        assert ExpressionQuadrotor(tilt_law="command*1.95e4*1e304 - 10*angle").handling() is None
        assert ExpressionQuadrotor(tilt_law="command*1.95e3*1e304 - 10*angle").handling() is not None


@record
class Unsolved(Quadrotor):
    """The identified quadrotor, if nobody had solved its equations."""

    def leaning(self, tilt: Any) -> Any:
        return None


def test_airspeed_is_found_in_steps_of_a_hundred_metres_halved_25_times() -> None:
    """g tan(0.4)/0.497391 = 8.33871... m/s: the last multiple of 100/2^25 m/s, 2.98 um/s, below it."""
    exact = 9.81 * math.tan(0.4) / 0.497391
    grid = 100.0 / 2**25
    found = envelope(Unsolved(), 0.4)
    assert found is not None
    assert found.airspeed[0] == pytest.approx(math.floor(exact / grid) * grid, abs=1e-9)


@pytest.mark.parametrize(("drag", "airspeed"), [(0.045, 92.169), (0.0377, math.inf)])
def test_nothing_is_faster_than_a_hundred_metres_a_second(drag: float, airspeed: float) -> None:
    """9.81 tan(0.4) = 4.14760 over the drag: 92.169 m/s, and 110.02 m/s, which is none."""
    found = envelope(Unsolved(kuv=-drag), 0.4, 1000.0)  # type: ignore[arg-type]
    assert found is not None
    assert found.airspeed[0] == pytest.approx(airspeed, abs=2e-3)


@record
class Asked(Quadrotor):
    """Something of 1 N whose force is 4 N up at a thrust of 4 N, with the square of it; it keeps what it is asked."""

    asked: ClassVar[list[Any]] = []
    reads: ClassVar[tuple[str, ...]] = ("ground",)

    def leaning(self, tilt: Any) -> Any:
        return None

    def handling(self) -> Handling:
        one: Any = np.float64(1.0)
        return Handling(one, one, 100.0 * one, (one, one, one), one, one, one)

    def draw_noise(self, draw: Any, dt: float) -> Any:
        self.asked.append(("noise", dt))

    def specific_force(self, state: Any, command: Any, air: Any, noise: Any, dt: float, around: Any = None) -> Vec3:
        if not isinstance(state.thrust, jax.core.Tracer):
            down, normal = around.ground(state.position_ned)
            place = [float(part[0]) for part in (state.position_ned.z, down, *normal.axes)]
            self.asked.append(("step", dt, *place))
        zero = 0.0 * state.thrust
        return Vec3(zero + 0.1, zero, -0.25 * state.thrust * state.thrust)


def test_the_thrust_that_carries_the_weight_is_found_by_four_secants() -> None:
    """x^2/4 = 1 from 1 and 1.5, x' = (a b + 4)/(a + b): 2.2, 1.972973, 1.998705, 2.0000088."""
    found = envelope(Asked(), 0.0)
    assert found is not None
    assert found.thrust[0] == pytest.approx(2.0000088147, abs=2e-10)


def test_a_vehicle_is_asked_at_the_height_of_the_site_far_above_level_ground() -> None:
    """The ground is 1000 m below; a step is so short that the thrust stays what it is, and the noise is that of 1 s."""
    Asked.asked.clear()
    one = jnp.ones(1)
    north, down = _specific_force(Asked(), 5.0 * one, 0.0 * one, 4.0 * one)
    assert Asked.asked == [("noise", 1.0), ("step", 1e-6, 0.0, 1000.0, 0.0, 0.0, -1.0)]
    assert [float(north[0]), float(down[0])] == pytest.approx([0.1, -4.0])
