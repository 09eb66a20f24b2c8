"""Numbers of the fixed wing at an instant, against (W1) to (W10) of docs/explanation/models/fixed_wing.md by hand."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.by_numpy import uncompiled
from tests.models.by_hand import many

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3
from qrsim.errors import UsageError
from qrsim.models.vehicles.fixed_wing import AttitudeCommand, FixedWing, SurfaceCommand, trim
from qrsim.models.vehicles.fixed_wing.aerodynamics import AirData, air_data, forces, lift_and_drag, propeller
from qrsim.models.vehicles.fixed_wing.parameters import Longitudinal, Propeller
from qrsim.models.vehicles.fixed_wing.rigid_body import slope_of, substep
from qrsim.models.vehicles.fixed_wing.stabiliser import moved, wanted_surfaces
from qrsim.models.vehicles.fixed_wing.state import Motion, Stabiliser, Surfaces
from qrsim.models.vehicles.fixed_wing.trim import cruise, stall_speed, throttle_for

MAVSIM = FixedWing(preset="mavsim")
pytestmark = pytest.mark.usefixtures("double_precision")


def vector(*values: float) -> Any:
    return Vec3(*(many(value) for value in values))


def aerosonde(**changes: Any) -> Any:
    return cast(FixedWing(**({"preset": "mavsim"} | changes)), np.float64)


def shaft(airspeed: float, throttle: float) -> float:
    """Return the thrust [N] of (W5): the speed n at which the torques of air and motor are the same."""
    rho, d, k = 1.2682, 0.508, 60.0 / (2.0 * math.pi * 145.0)
    square = 0.00523 * rho * d**5
    linear = 0.00497 * rho * d**4 * airspeed + 2.0 * math.pi * k * k / 0.042
    rest = -0.01664 * rho * d**3 * airspeed**2 - k * (44.4 * throttle / 0.042 - 1.5)
    n = (-linear + math.sqrt(linear * linear - 4.0 * square * rest)) / (2.0 * square)
    j = airspeed / (n * d)
    return rho * n * n * d**4 * (0.09357 - 0.06044 * j - 0.1079 * j * j)


def test_the_thrust_by_hand_is_the_published_one() -> None:
    assert shaft(25.0, 0.5) == pytest.approx(-12.43072534597213, rel=1e-12)


def test_air_data_of_hardly_any_wind() -> None:
    """(W1) with V at least 0.1 m/s: of (0.05, 0.02, 0.03) the angles are those of 0.1 m/s ahead."""
    found = uncompiled(air_data)(Vec3(many(0.05, 3.0), many(0.02, 4.0), many(0.03, -1.0)))
    np.testing.assert_allclose(found.airspeed, [0.1, math.sqrt(26.0)], rtol=1e-12)
    np.testing.assert_allclose(found.alpha, [math.atan(0.3), -math.atan(1.0 / 3.0)], rtol=1e-6)
    np.testing.assert_allclose(found.beta, [math.atan(0.2), math.asin(4.0 / math.sqrt(26.0))], rtol=1e-6)


class TestStall:
    """(W2): the line 0.23 + 5.61 a, the plate 2 sin|a| sin a cos a, and between them the share sigma of the plate."""

    def test_lift_about_the_stall(self) -> None:
        """At 0.47 rad, ahead and behind, half of each; two hundredths of a radian on, e/(1 + e) of the plate."""
        of: Any = cast(Longitudinal(), np.float64)
        alpha = np.array([0.47, -0.47, 0.49, -0.49, 0.45, -0.45])
        share = np.array([0.5, 0.5, math.e / (1 + math.e), math.e / (1 + math.e), 1 / (1 + math.e), 1 / (1 + math.e)])
        line, plate = 0.23 + 5.61 * alpha, 2.0 * np.abs(np.sin(alpha)) * np.sin(alpha) * np.cos(alpha)
        lift, drag = uncompiled(lift_and_drag)(of, jnp.asarray(15.0), jnp.asarray(alpha))
        np.testing.assert_allclose(lift, (1.0 - share) * line + share * plate, rtol=1e-9)
        np.testing.assert_allclose(drag, 0.0437 + line**2 / (math.pi * 0.9 * 15.0), rtol=1e-12)

    def test_what_is_left_of_the_plate_far_below(self) -> None:
        """Both shares end at exp(-40); a line of 0.5 + 2 a has no lift at -0.25 rad, which leaves the plate's."""
        of: Any = cast(
            Longitudinal(lift_0=0.5, lift_alpha=2.0, stall_angle=0.5, stall_sharpness=1000.0),  # type: ignore[arg-type]
            np.float64,
        )
        lift, _ = uncompiled(lift_and_drag)(of, jnp.asarray(15.0), many(-0.25))
        plate = -2.0 * math.sin(0.25) ** 2 * math.cos(0.25)
        np.testing.assert_allclose(lift, 2.0 * math.exp(-40.0) * plate, rtol=1e-9)

    def test_the_slope_far_beyond_in_single_precision(self) -> None:
        """That of the plate, 2 (2 sin cos^2 - sin^3), finite though exp(47)^2 is beyond single precision."""
        with jax.enable_x64(False):
            of: Any = cast(Longitudinal(), np.float32)
            alpha = jnp.asarray([1.41, -1.41], jnp.float32)
            ratio = jnp.asarray(15.0, jnp.float32)
            slope = jax.jit(jax.vmap(jax.grad(lambda a: lift_and_drag(of, ratio, a)[0])))(alpha)
        sine, cosine = math.sin(1.41), math.cos(1.41)
        np.testing.assert_allclose(slope, 2.0 * (2.0 * sine * cosine**2 - sine**3), rtol=1e-5)


def test_turning_is_damped() -> None:
    """(W3), (W4): at 25 m/s p, q, r of 1, 2, 3 rad/s count times b/(2V) or c/(2V), and Q S b or c."""
    model = aerosonde()
    air = AirData(many(25.0), many(0.0), many(0.0))
    zero = many(0.0)
    (_, rest, _), (force, moment, _) = (
        uncompiled(forces)(model, air, rates, Surfaces(zero, zero, zero), zero)
        for rates in (vector(0.0, 0.0, 0.0), vector(1.0, 2.0, 3.0))
    )
    pressed = 0.5 * 1.2682 * 625.0 * 0.55
    wide, long = 2.8956 / 50.0, 0.18994 / 50.0
    roll = pressed * 2.8956 * wide * (-0.51 + 3.0 * 0.25)
    yaw = pressed * 2.8956 * wide * (0.069 - 3.0 * 0.095)
    pitch = pressed * 0.18994 * long * 2.0 * -38.21
    found = [float((axis - before)[0]) for axis, before in zip(moment.axes, rest.axes, strict=True)]
    assert found == pytest.approx([roll, pitch, yaw], rel=1e-9)
    np.testing.assert_allclose(force.z, -pressed * (0.23 + 7.95 * long * 2.0), rtol=1e-9)


def flying(*velocity: float) -> Motion:
    zero = vector(0.0, 0.0, 0.0)
    return Motion(zero, Quaternion.of(Euler(many(0.0), many(0.0), many(0.0))), vector(*velocity), zero)


def test_accelerations_of_the_published_forces() -> None:
    """(W7) of the force (-12.109717, 0.207073, 63.443738 - 11 g) and moment (0.50637, 8.756434, -0.21775) of mavsim."""
    surfaces = Surfaces(many(-0.2), many(0.0), many(0.005))
    still = vector(0.0, 0.0, 0.0)
    slope, specific = uncompiled(slope_of)(aerosonde(), flying(25.0, 0.0, 0.0), surfaces, many(0.5), still, still)
    felt = np.array([-12.109717, 0.207073, 63.443738 - 107.91]) / 11.0
    np.testing.assert_allclose([axis[0] for axis in specific.axes], felt, atol=1e-6)
    np.testing.assert_allclose([axis[0] for axis in slope.velocity.axes], felt + np.array([0.0, 0.0, 9.81]), atol=1e-6)
    # The inverse of ((0.8244, -0.1204), (-0.1204, 1.759)), whose determinant is 1.43562344.
    roll = (1.759 * 0.50637 - 0.1204 * 0.21775) / 1.43562344
    yaw = (0.1204 * 0.50637 - 0.8244 * 0.21775) / 1.43562344
    np.testing.assert_allclose([axis[0] for axis in slope.rates.axes], [roll, 8.756434 / 1.135, yaw], atol=1e-5)


@pytest.mark.long
def test_a_fall_without_air() -> None:
    """The classical rule is exact on g t^2/2: in 0.1 s 0.04905 m beside the way of 0.2 m, and nothing is felt."""
    still = vector(0.0, 0.0, 0.0)
    surfaces = Surfaces(many(0.0), many(0.0), many(0.0))
    model = aerosonde(density=1e-12)
    after, force = uncompiled(substep)(model, flying(3.0, 0.0, 2.0), surfaces, many(0.0), still, still, 0.1)
    np.testing.assert_allclose([axis[0] for axis in after.displacement.axes], [0.3, 0.0, 0.24905], atol=1e-9)
    np.testing.assert_allclose([axis[0] for axis in after.velocity.axes], [3.0, 0.0, 2.981], atol=1e-9)
    np.testing.assert_allclose([axis[0] for axis in force.axes], 0.0, atol=1e-9)


class TestVehicle:
    def test_what_it_declares(self) -> None:
        assert dict(FixedWing.default_limits) == {"pitch": 1.5707963267948966, "velocity": 80.0, "rate": 30.0}

    def test_a_start_has_the_elevator_of_level_flight(self) -> None:
        """That of (W9) at no less than half the cruise airspeed, 12.5 m/s, within 0.44 rad; its thrust at 5 m/s.

        3 kg: CL 0.54013 - 0.23, hence -0.1489 rad; 11 kg would want -0.908 rad, a moment of 1 without lift 0.7 rad.
        """
        zero = vector(0.0, 0.0, 0.0)

        def start(**changes: Any) -> Any:
            return aerosonde(**changes).initial_state(zero, Euler(*zero.axes), vector(5.0, 0.0, 0.0), zero)

        pressed = 0.5 * 1.2682 * 12.5**2 * 0.55
        _, elevator = np.linalg.solve([[5.61, 0.13], [-2.74, -0.99]], [29.43 / pressed - 0.23, -0.0135])
        np.testing.assert_allclose(start(mass=3.0).surfaces.elevator, elevator, rtol=1e-9)
        np.testing.assert_allclose(start().surfaces.elevator, -0.44, rtol=1e-12)
        up = Longitudinal(moment_0=1.0, lift_0=1.9)  # type: ignore[arg-type]
        np.testing.assert_allclose(start(longitudinal=up).surfaces.elevator, 0.44, rtol=1e-12)
        # A drag that no throttle makes up for.
        drags = start(longitudinal=Longitudinal(drag_parasitic=20.0))  # type: ignore[arg-type]
        np.testing.assert_allclose(drags.thrust, shaft(5.0, 1.0), rtol=1e-9)

    def test_the_idle_throttle_is_no_more_than_full(self) -> None:
        idle = aerosonde(longitudinal=Longitudinal(drag_parasitic=20.0)).idle_command(jnp.zeros(1))  # type: ignore[arg-type]
        assert float(idle.throttle[0]) == 1.0

    def test_the_mean_force_of_a_step_is_that_of_an_instant(self) -> None:
        """The published force by 11 kg, over a step so short that nothing moves, in three substeps."""
        model = aerosonde(surface_lag=0.0, surface_rate_max=0.0, longest_substep=1e-7)
        zero = vector(0.0, 0.0, 0.0)
        start = model.initial_state(zero, Euler(*zero.axes), vector(25.0, 0.0, 0.0), zero)
        command = SurfaceCommand(many(-0.2), many(0.0), many(0.005), many(0.5))
        _, force = uncompiled(model.step)(start, command, lambda trig: zero, None, 3e-7)
        felt = np.array([-12.109717, 0.207073, -44.466283]) / 11.0
        np.testing.assert_allclose([axis[0] for axis in force.axes], felt, atol=2e-5)

    @pytest.mark.parametrize(("dt", "substeps"), [(0.01, 1), (0.01 * (1 + 1.1e-9), 2), (1e-12, 1)])
    def test_how_many_substeps_a_step_has(self, dt: float, substeps: int) -> None:
        """10 ms or less are one, of which a billionth may be missing: in one the roll error is looked at once.

        It is 0.05 rad at the start, and 0.05 less what a roll of 1 rad/s makes of it in the middle of a step of two.
        """
        model = aerosonde()
        zero = vector(0.0, 0.0, 0.0)
        start = model.initial_state(zero, Euler(*zero.axes), vector(25.0, 0.0, 1.0), vector(1.0, 0.0, 0.0))
        command = AttitudeCommand(many(0.05), many(0.0), many(1.3))
        after, _ = uncompiled(model.step)(start, command, lambda trig: zero, None, dt)
        once = 0.1 * 0.05 * dt
        if substeps == 1:
            np.testing.assert_allclose(after.stabiliser.roll_integral, once, rtol=1e-9)
        else:
            np.testing.assert_allclose(once - after.stabiliser.roll_integral, 0.1 * dt**2 / 4.0, rtol=0.2)
        # More than full throttle is full throttle.
        np.testing.assert_allclose(after.thrust, shaft(float(after.airspeed[0]), 1.0), rtol=1e-9)


class TestStabiliser:
    def test_gains_below_eight_metres_a_second(self) -> None:
        """(W8) at 4 m/s as at 8: k = (25/8)^2; roll and pitch errors of 0.02 and -0.01, a yaw rate of 0.5 rad/s."""
        zero = many(0.0)
        memory, found = uncompiled(wanted_surfaces)(
            aerosonde(),
            Stabiliser(zero, zero, zero),
            AttitudeCommand(many(0.12), many(0.19), zero),
            Euler(many(0.1), many(0.2), zero),
            vector(0.01, 0.02, 0.5),
            many(4.0),
            many(-0.1),
            0.01,
        )
        k = 625.0 / 64.0
        slow = 0.01 * 0.5
        aileron = k * (1.2 * 0.02 - 0.12 * 0.01) + 0.1 * 0.01 * 0.02
        elevator = -0.1 - k * (1.5 * -0.01 - 0.25 * 0.02) - 0.5 * 0.01 * -0.01
        expected = [elevator, aileron, 0.2 * (0.5 - slow)]
        np.testing.assert_allclose([part[0] for part in jax.tree.leaves(found)], expected, rtol=1e-9)
        np.testing.assert_allclose([part[0] for part in jax.tree.leaves(memory)], [2e-5, 5e-5, slow], rtol=1e-9)

    def test_a_lag_and_a_rate(self) -> None:
        """Of 0.1 rad 1 - exp(-0.2) in 10 ms with 0.05 s; of 0.4 rad 0.035 rad, at 3.5 rad/s."""
        now, goal = Surfaces(many(0.0), many(0.0), many(0.1)), Surfaces(many(0.1), many(0.4), many(-0.3))
        found = uncompiled(moved)(aerosonde(), now, goal, 0.01)
        expected = [0.1 * (1.0 - math.exp(-0.2)), 0.035, 0.065]
        np.testing.assert_allclose([part[0] for part in jax.tree.leaves(found)], expected, rtol=1e-9)

    def test_without_a_lag_it_is_there(self) -> None:
        """To the last bit, where now + (goal - now) is not; and ten radians in a step at most."""
        model = aerosonde(surface_lag=0.0, surface_rate_max=0.0)
        assert 0.44 + (0.001 - 0.44) != 0.001
        now, goal = Surfaces(many(0.44), many(0.0), many(0.0)), Surfaces(many(0.001), many(15.0), many(-15.0))
        found = uncompiled(moved)(model, now, goal, 0.01)
        assert [float(part[0]) for part in jax.tree.leaves(found)] == [0.001, 10.0, -10.0]


class TestLevelFlight:
    def test_formulas(self) -> None:
        """(W9) solved by hand at 25 m/s: 107.91 N by alpha and elevator, without a moment; 1 % of the trim."""
        pressed = 0.5 * 1.2682 * 625.0 * 0.55
        alpha, elevator = np.linalg.solve([[5.61, 0.13], [-2.74, -0.99]], [107.91 / pressed - 0.23, -0.0135])
        found = [float(value) for value in uncompiled(cruise)(aerosonde(), jnp.asarray(25.0))]
        assert found[:2] == pytest.approx([alpha, elevator], rel=1e-9)
        assert found == pytest.approx([0.050107, -0.125044, 0.676776], rel=0.01)

    @pytest.mark.parametrize(("airspeed", "throttle"), [(25.0, 0.5), (0.0, 0.3), (15.0, 0.9)])
    def test_the_throttle_of_a_thrust(self, airspeed: float, throttle: float) -> None:
        thrust = shaft(airspeed, throttle)
        found = uncompiled(throttle_for)(aerosonde(), jnp.asarray(airspeed), jnp.asarray(thrust))
        assert float(found) == pytest.approx(throttle, rel=1e-9)
        assert float(uncompiled(propeller)(aerosonde(), many(airspeed), many(throttle))[0][0]) == pytest.approx(
            thrust, rel=1e-9
        )

    def test_stall_speed(self) -> None:
        """sqrt(2 m g/(rho S CL)) at the highest CL of (W2) among the angles 0, 0.002, ... 0.8 rad."""
        alpha = np.arange(401) * 0.002
        a, d = np.exp(50.0 * (alpha - 0.47)), np.exp(-50.0 * (alpha + 0.47))
        share = (a + d + a * d) / ((1.0 + a) * (1.0 + d))
        lift = (1.0 - share) * (0.23 + 5.61 * alpha) + share * 2.0 * np.sin(alpha) ** 2 * np.cos(alpha)
        expected = math.sqrt(2.0 * 107.91 / (1.2682 * 0.55 * np.max(lift)))
        assert stall_speed(aerosonde()) == pytest.approx(expected, rel=1e-9)
        assert expected == pytest.approx(11.4, abs=0.3)


class TestTrim:
    """(W10), by Newton's rule; a glide in which a motor of so high a resistance needs hardly a current."""

    GLIDE = -0.0522

    @pytest.mark.long
    def test_it_has_no_acceleration(self) -> None:
        """Less than 1e-10 of anything; the last but one step of this climb leaves 1.1e-10."""
        at = trim(MAVSIM, 25.0, 0.0445)
        still = vector(0.0, 0.0, 0.0)
        ahead, down = 25.0 * math.cos(at.alpha), 25.0 * math.sin(at.alpha)
        attitude = Quaternion.of(Euler(many(at.phi), many(at.theta), many(0.0)))
        motion = Motion(still, attitude, vector(ahead, 0.0, down), still)
        surfaces = Surfaces(many(at.elevator), many(at.aileron), many(at.rudder))
        slope, _ = uncompiled(slope_of)(aerosonde(), motion, surfaces, many(at.throttle), still, still)
        rest = [*slope.velocity.axes, *slope.rates.axes, slope.displacement.z + 25.0 * math.sin(0.0445)]
        assert max(abs(float(part[0])) for part in rest) < 1e-10

    @pytest.mark.long
    def test_sixty_steps_of_a_tenth(self) -> None:
        """The formulas begin at a throttle of about 6.4 with 57 ohm, and of about 7.2 with 65, which is too far."""
        near, far = (replace(MAVSIM, propeller=Propeller(resistance=ohm)) for ohm in (57.0, 65.0))  # type: ignore[arg-type]
        assert trim(near, 25.0, self.GLIDE).alpha == pytest.approx(0.0502, abs=1e-4)
        with pytest.raises(UsageError, match="no steady flight"):
            trim(far, 25.0, self.GLIDE)

    @pytest.mark.long
    def test_more_than_full_throttle_is_none(self) -> None:
        """36 m/s takes 0.965 of it; 38 m/s would take 1.02."""
        with pytest.raises(UsageError, match="no steady flight at 38 m/s"):
            trim(MAVSIM, 38.0)
