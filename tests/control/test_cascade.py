"""The cascade: commands by hand for a vehicle of round numbers, one column for each case."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, ClassVar

import jax
import numpy as np
import pytest

import qrsim
from qrsim.control import (
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    CascadeController,
    Estimate,
    PathSetpoint,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.core.tree import cast, parameter, record, replace
from qrsim.errors import ScenarioError, UsageError
from qrsim.models.vehicles.contracts import Handling, Vehicle
from qrsim.models.vehicles.expression_quadrotor import ExpressionQuadrotor
from qrsim.models.vehicles.quadrotor import Quadrotor

DT = 0.02
QUICK = {"xla_cpu_use_fusion_emitters": False}


@record
class Round:
    """2 kg at 10 m/s^2, at most 40 N at full throttle, in proportion; nothing but what a cascade asks of a vehicle."""

    thrust: Any = parameter(default=40.0, unit="N", doc="largest")
    command_type: ClassVar[type[Any]] = dict

    def handling(self) -> Handling:
        curve: Any = (0.0, self.thrust, 0.0)
        answers: Any = {"tilt_gain": 0.75, "yaw_rate_gain": 0.25, "tilt_max": 0.9}
        return Handling(2.0, 10.0, self.thrust, curve, **answers)  # type: ignore[arg-type]

    def tilt_command(self, pitch: Any, roll: Any, throttle: Any, yaw_rate: Any) -> Any:
        return {"pitch": pitch, "roll": roll, "throttle": throttle, "yaw_rate": yaw_rate}

    def on_ground(self, state: Any) -> Any:
        """Have feet."""


@record
class Footless(Round):
    """The same without feet, as the identified quadrotors."""

    on_ground = Vehicle.on_ground


@partial(jax.jit, compiler_options=QUICK)
def _steps(controller: Any, estimates: Estimate, setpoint: Any) -> Any:
    start = controller.init(jax.tree.map(lambda leaf: leaf[0], estimates))
    return jax.lax.scan(lambda memory, now: controller.step(memory, now, setpoint, DT), start, estimates)


def commands(setpoint: Any, *, kind: Any = Round, thrust: Any = 40.0, steps: int = 1, **of: Any) -> tuple[Any, Any]:
    """The last state and all commands (T, n) at rest and level at the origin but for ``of``: at, moves, turned."""
    with jax.enable_x64(True):
        setpoint = jax.tree.map(
            lambda leaf: np.asarray(leaf) if leaf.dtype == bool else np.asarray(leaf, float), setpoint
        )
        n = setpoint.yaw.shape[0]
        rows = [
            np.broadcast_to(np.asarray(of.get(name, 0.0), float), (steps, n, 3)) for name in ("at", "moves", "turned")
        ]
        controller = cast(CascadeController().fitted(kind(thrust)), np.float64)  # type: ignore[arg-type]
        return jax.tree.map(np.asarray, _steps(controller, Estimate.of(*rows), setpoint))


def close(found: Any, expected: Any) -> None:
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


# 10 m/s^2 times the tangent of the tilt limit, 0.611 rad.
LEAN = 7.004083914099546


class TestWaypoint:
    def test_one_step_by_hand(self) -> None:
        """Position to velocity, velocity to acceleration, that and gravity to tilt and throttle (2 f / 40)."""
        cases = [
            # wanted offset, velocity, yaw | specific thrust: ahead, right, up
            # 1.2 /s x 1 m, 2.2 /s.
            ((1, 0, 0), (0, 0, 0), 0.0, (2.64, 0.0, 10.0)),
            ((0, 1, 0), (0, 0, 0), 0.0, (0.0, 2.64, 10.0)),
            # Facing east, north is to the left.
            ((1, 0, 0), (0, 0, 0), math.pi / 2, (0.0, -2.64, 10.0)),
            ((1, 0, 0), (0.5, 0, 0), 0.0, (1.54, 0.0, 10.0)),
            # 1 /s x 1 m, 4 /s.
            ((0, 0, -1), (0, 0, 0), 0.0, (0.0, 0.0, 14.0)),
            # At most 8 m/s in the direction 3 : 4, and 35 degrees.
            ((3, 4, 0), (0, 0, 0), 0.0, (7.92 * LEAN / 13.2, 10.56 * LEAN / 13.2, 10.0)),
            ((60, 80, 0), (6.0, 8.0, 0), 0.0, (2.2 * -1.2, 2.2 * -1.6, 10.0)),
            # Up at 3 m/s at most, down at 1.5.
            ((0, 0, -50), (0, 0, -2.5), 0.0, (0.0, 0.0, 12.0)),
            ((0, 0, 50), (0, 0, 1.0), 0.0, (0.0, 0.0, 8.0)),
            # Never less than 0.3 of the weight, never more than 0.98 of the thrust, 20 m/s^2.
            ((0, 0, 50), (0, 0, -1.0), 0.0, (0.0, 0.0, 3.0)),
            ((0, 0, -50), (0, 0, 0), 0.0, (0.0, 0.0, 19.6)),
            # Height first: the rest of 20 m/s^2 is left to lean.
            ((50, 0, -50), (0, 0, 0), 0.0, (math.sqrt(400.0 - 19.6**2), 0.0, 19.6)),
        ]
        offset, moves, yaw, thrust = (np.array([case[i] for case in cases], float) for i in range(4))
        turned = np.stack([0 * yaw, 0 * yaw, yaw], axis=1)
        _, found = commands(WaypointSetpoint.of(offset, yaw), moves=moves, turned=turned)
        size = np.linalg.norm(thrust, axis=1)
        close(found["pitch"][0], -np.arctan2(thrust[:, 0], thrust[:, 2]) / 0.75)
        close(found["roll"][0], np.arcsin(thrust[:, 1] / size) / 0.75)
        close(found["throttle"][0], size / 20.0)
        close(found["yaw_rate"][0], 0.0 * yaw)

    def test_heading(self) -> None:
        """2 /s, the short way round, at most 1 rad/s; the platform gives 0.25 of what it is told."""
        cases = [(0.0, 0.3, 2.4), (0.0, -0.4, -3.2), (0.0, 2.0, 4.0), (3.0, -3.0, 2.0 * (2 * math.pi - 6.0) / 0.25)]
        now, wanted, rate = np.array(cases).T
        turned = np.stack([0 * now, 0 * now, now], axis=1)
        _, found = commands(WaypointSetpoint.of(np.zeros((4, 3)), wanted), turned=turned)
        close(found["yaw_rate"][0], rate)

    def test_a_command_stays_in_its_range(self) -> None:
        """At a tilt limit of 0.75 rad the platform would have to be told 1 rad; it takes 0.9."""
        with jax.enable_x64(True):
            controller = cast(CascadeController(tilt_limit=0.75).fitted(Round()), np.float64)  # type: ignore[arg-type]
            at = Estimate.of(*(np.zeros((1, 1, 3)),) * 3)
            _, found = _steps(controller, at, WaypointSetpoint.of(np.array([[50.0, 0.0, 0.0]])))
        close(found["pitch"][0], [-0.9])

    def test_the_integrals(self) -> None:
        """They grow by their gain, stop where the thrust is at its limit, and end at 14 and 6 m/s^2."""
        # 0.5 m/s and 0.2 m/s short for 32 s; half as fast for 1 s; 8 m/s, beyond any lean; 3 m/s, beyond the thrust.
        offset = [[0.5 / 1.2, 0, 0], [0, 0, 0.2], [50, 0, 0], [0, 0, -50]]
        thrust = np.array([200.0, 40.0, 40.0, 40.0])
        state, found = commands(WaypointSetpoint.of(np.array(offset)), thrust=thrust, steps=1600)
        # 10 tan(0.611) = 7.004 is all that the lean gives: it stops at 7.004 - 2.2 x 0.5.
        close(state.integral.x[[2]], [0.0])
        close(state.integral.z, [0.0, 6.0, 0.0, 0.0])
        assert state.integral.x[0] == pytest.approx(LEAN - 1.1, abs=0.01)
        # What it was after 50 steps: 0.9 /s^2 x 0.5 m/s x 1 s, and 2 /s^2 x 0.2 m/s x 1 s.
        close(np.tan(-0.75 * found["pitch"][50, 0]), [(1.1 + 0.45) / 10.0])
        close(found["throttle"][50, 1], (10.0 - 0.8 - 0.4) / 20.0)

    def test_the_horizontal_integral_ends_at_its_limit(self) -> None:
        with jax.enable_x64(True):
            controller = CascadeController(tilt_limit=1.4).fitted(Round(200.0))  # type: ignore[arg-type]
            at = Estimate.of(*(np.zeros((1600, 1, 3)),) * 3)
            state, _ = _steps(cast(controller, np.float64), at, WaypointSetpoint.of(np.array([[0.3, 0.4, 0.0]])))
        close(np.hypot(state.integral.x, state.integral.y), [14.0])

    def test_the_acceleration_of_now_damps(self) -> None:
        """From rest to 1 m/s in a step: 50 m/s^2, of which 0.02 / (0.02 + 0.05) pass, times 0.2; not upwards."""
        moves = np.zeros((2, 1, 3))
        moves[1] = [1.0, 0.0, -0.2]
        _, found = commands(WaypointSetpoint.of(np.zeros((1, 3))), moves=moves, steps=2)
        close(np.tan(-0.75 * found["pitch"][:, 0]) * [10.0, 9.2], [0.0, -2.2 - 0.2 * 50.0 * 2.0 / 7.0])
        close(found["throttle"][0], [0.5])


class TestKinds:
    def test_a_path_feeds_forward(self) -> None:
        """2.2 /s x 3 m/s + 1 m/s^2 ahead; 4 /s x 0.5 m/s + 2 m/s^2 upwards."""
        path = PathSetpoint.of(np.zeros((1, 3)), [3.0, 0.0, -0.5], [1.0, 0.0, -2.0])
        _, found = commands(path)
        thrust = [7.6, 0.0, 14.0]
        close(np.tan(-0.75 * found["pitch"][0]), [7.6 / 14.0])
        close(found["throttle"][0], [np.linalg.norm(thrust) / 20.0])

    def test_idle_motors_forget(self) -> None:
        """On the ground with idle motors nothing is learned of the wind."""
        path = PathSetpoint(*vars(PathSetpoint.of(np.ones((2, 3)), yaw_rad=0.2)).values())
        path = PathSetpoint(
            path.position_ned, path.velocity_ned, path.acceleration_ned, path.yaw, np.array([True, False])
        )  # type: ignore[arg-type]
        state, found = commands(path, steps=3)
        for name in ("pitch", "roll", "throttle", "yaw_rate"):
            assert found[name][2, 0] == 0.0
            assert found[name][2, 1] != 0.0
        close(state.integral.x, [0.0, 3 * 0.02 * 0.9 * 1.2])

    @pytest.mark.parametrize(("kind", "leans"), [(Round, 0.0), (Footless, 1.0)])
    def test_who_touches_the_ground_with_a_foot_does_not_lean(self, kind: Any, leans: float) -> None:
        """Of 7.6 m/s^2 ahead and 14 upwards, as above, only the latter; what is learned of the wind stays."""
        path = PathSetpoint.of(np.zeros((2, 3)), [3.0, 0.0, -0.5], [1.0, 0.0, -2.0])
        path = replace(path, idle=np.zeros(2, bool), level=np.array([True, False]))
        state, found = commands(path, kind=kind)
        close(np.tan(-0.75 * found["pitch"][0]), [leans * 7.6 / 14.0, 7.6 / 14.0])
        close(found["throttle"][0], [math.hypot(leans * 7.6, 14.0) / 20.0, math.hypot(7.6, 14.0) / 20.0])
        assert state.integral.x[0] == state.integral.x[1] > 0.0

    def test_a_velocity_has_no_place(self) -> None:
        _, found = commands(VelocitySetpoint.of(np.array([[2.0, 0.0, -1.0], [0.0, 0.0, 9.0]])), at=[50.0, 9.0, -4.0])
        close(np.tan(-0.75 * found["pitch"][0]), [4.4 / 14.0, 0.0])
        close(found["throttle"][0], [math.hypot(4.4, 14.0) / 20.0, 4.0 / 20.0])

    def test_a_velocity_at_a_height(self) -> None:
        setpoint = VelocityHeightSetpoint.of(np.array([[0.0, 2.0]]), -11.0)
        _, found = commands(setpoint, at=[50.0, 9.0, -10.0])
        close(np.tan(0.75 * found["roll"][0]) * 14.0, [4.4])
        close(found["throttle"][0], [math.hypot(4.4, 14.0) / 20.0])

    def test_a_tilt_at_a_height(self) -> None:
        """Commands are handed on; the throttle makes up for the lean."""
        setpoint = AttitudeHeightSetpoint.of(np.array([0.1, 2.0]), np.array([-0.2, -2.0]), -1.0, 0.0)
        _, found = commands(setpoint, turned=[0.3, 0.4, 0.0])
        close(found["roll"][0], [0.1, 0.9])
        close(found["pitch"][0], [-0.2, -0.9])
        close(found["throttle"][0], [14.0 / (math.cos(0.3) * math.cos(0.4)) / 20.0] * 2)
        # Whoever lies on the side, cos 0.07, gets no more than ten times as much.
        _, found = commands(setpoint, thrust=400.0, turned=[1.5, 0.0, 0.0])
        close(found["throttle"][0], [2.0 * 140.0 / 400.0] * 2)

    def test_a_tilt_and_a_thrust(self) -> None:
        setpoint = AttitudeSetpoint.of(np.array([0.1, 2.0]), np.array([-0.2, -2.0]), 0.0, np.array([0.4, 1.5]))
        _, found = commands(setpoint)
        close(found["roll"][0], [0.1, 0.9])
        close(found["pitch"][0], [-0.2, -0.9])
        close(found["throttle"][0], [0.4, 1.0])


def test_the_pelican_is_told_more_than_it_shall_lean() -> None:
    """0.745 of a tilt command is flown; 1.68 kg by the published thrust polynomial."""
    with jax.enable_x64(True):
        controller = cast(CascadeController().fitted(Quadrotor()), np.float64)
        at = Estimate.of(*(np.zeros((1, 1, 3)),) * 3)
        _, found = _steps(controller, at, WaypointSetpoint.of(np.array([[1.0, 0.0, 0.0]])))
    close(found.pitch[0], [-0.352874071344703])
    close(found.throttle[0], [0.6015351572107278])
    close(found.battery[0], [12.0])


def test_a_cascade_without_a_vehicle_says_so() -> None:
    at = Estimate.of(*(np.zeros((1, 3)),) * 3)
    controller = CascadeController()
    with pytest.raises(UsageError, match=r"knows no vehicle; fit it first: controller\.fitted\(vehicle\)"):
        controller.step(controller.init(at), at, WaypointSetpoint.of(np.zeros((1, 3))), DT)


def test_a_vehicle_that_does_not_answer_is_refused() -> None:
    with pytest.raises(UsageError, match="ExpressionQuadrotor says of none how it answers"):
        CascadeController().fitted(ExpressionQuadrotor(yaw_law="-5*rate"))
    with pytest.raises(ScenarioError, match=r"fleets\.vehicles\.controller: a cascade commands tilt and throttle"):
        qrsim.make_world([[0, 0, -10]], vehicle={"type": "expression", "yaw_law": "-5*rate"}, controller="cascade")


@pytest.mark.parametrize(
    ("feed", "words"),
    [
        (
            "filter",
            "fed with a filter of measurements, but no sensor gives specific_force; add one of type "
            "accelerometer, or set fleets.vehicles.controller.feed to measurements or truth",
        ),
        ("measurements", ""),
    ],
)
def test_the_filter_needs_an_accelerometer(feed: str, words: str) -> None:
    sensors = {name: {"type": f"ideal_{name}"} for name in ("gnss", "barometer", "attitude")}
    parts: dict[str, Any] = {"controller": {"type": "cascade", "feed": feed}, "sensors": sensors}
    if not words:
        assert qrsim.make_world([[0, 0, -10]], **parts).fleets[0].controller.estimator() is None
        return
    with pytest.raises(ScenarioError) as caught:
        qrsim.make_world([[0, 0, -10]], **parts)
    assert words in str(caught.value)


def test_a_controller_taken_from_a_world_can_be_handed_in_again() -> None:
    """The vehicle that it was fitted to is no part of a scenario."""
    world = qrsim.make_world([[0, 0, -10]], controller=CascadeController(speed_limit=4.0))
    fitted = world.fleets[0].controller
    assert isinstance(fitted, CascadeController)
    assert isinstance(fitted.nominal, Quadrotor)
    again = qrsim.make_world([[0, 0, -10]], controller=fitted, vehicle={"type": "pelican", "mass": 1.5})
    other = again.fleets[0].controller
    assert isinstance(other, CascadeController)
    assert isinstance(other.nominal, Quadrotor)
    assert float(other.nominal.mass) == pytest.approx(1.5)
    assert float(other.speed_limit) == 4.0


def test_an_episode_may_fly_another_mass_than_the_controller_knows() -> None:
    """A range is of the vehicle alone: that is what a random mass is for."""
    ranges = [{"path": "fleets.vehicles.vehicle.mass", "low": 1.9, "high": 1.9}]
    simulation = qrsim.Simulation(qrsim.make_world([[0, 0, -10]], controller="cascade", ranges=ranges), seed=1)
    simulation.reset()
    simulation.step(ticks=1000)
    fleet = simulation.world.with_drawn(simulation.state.drawn).fleets[0]
    assert isinstance(fleet.controller, CascadeController)
    assert isinstance(fleet.vehicle, Quadrotor)
    assert isinstance(fleet.controller.nominal, Quadrotor)
    assert float(fleet.vehicle.mass) == pytest.approx(1.9)
    assert float(fleet.controller.nominal.mass) == pytest.approx(1.68)
    # Its integral has taken the 0.22 kg: 1.28 m/s^2.
    assert simulation.truth.position_ned[0] == pytest.approx([0.0, 0.0, -10.0], abs=0.1)
    assert float(simulation.state.fleets[0].controller.integral.z[0]) == pytest.approx(  # type: ignore[attr-defined]
        -9.81 * 0.22 / 1.68, rel=0.05
    )
