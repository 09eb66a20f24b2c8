"""Height loop, waypoint controller and routes against commands worked by hand, and the loop closed on the vehicle."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control import (
    Estimate,
    HeightLoop,
    HeightState,
    Route,
    RouteFollower,
    RouteState,
    WaypointController,
    WaypointSetpoint,
)
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Command, Quadrotor, QuadrotorState

Array = np.ndarray[Any, Any]
F32, DT = np.float32, 0.02
LOOP, CONTROLLER = cast(HeightLoop(), F32), cast(WaypointController(), F32)
CONTROLLER64 = cast(WaypointController(), np.float64)


def floats(*values: float) -> Any:
    return np.asarray(values, F32)


@jax.jit
def _heights(loop: HeightLoop, z: jax.Array, wanted: jax.Array) -> tuple[HeightState, jax.Array]:
    """States and throttles of a loop that sees heights and set-points (steps, n)."""

    def tick(state: HeightState, now: Any) -> tuple[HeightState, Any]:
        state, throttle = loop.step(state, *now, DT)
        return state, (state, throttle)

    return jax.lax.scan(tick, loop.init(z[0]), (z, wanted))[1]


def heights(z: Any, wanted: Any, loop: HeightLoop = LOOP) -> tuple[HeightState, Array]:
    """As _heights, for one vehicle that sees z and wants z_wanted, padded so that most tests share a program."""
    z, wanted = np.broadcast_arrays(np.asarray(z, F32), np.asarray(wanted, F32))
    padded = [np.pad(x, (0, 64 - len(x)), "edge")[:, None] for x in (z, wanted)]
    states, throttle = _heights(loop, *padded)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(z), 0], states), np.asarray(throttle)[: len(z), 0]


class TestHeightLoop:
    def test_commands_by_hand(self):
        """e = z - z_wanted = 2, 1.9, 1.9: too low, so more throttle; I = sum of e T; no derivative at first."""
        states, throttle = heights([-8.0, -8.1, -8.1], [-10.0] * 3)
        expected = [
            0.59 + 0.03 * 2.0 + 0.0008 * 0.04,  # 0.650032
            0.59 + 0.03 * 1.9 + 0.0008 * 0.078 + 0.04 * -5.0,  # -0.1 m in 0.02 s is -5 m/s: 0.4470624
            0.59 + 0.03 * 1.9 + 0.0008 * 0.116,  # 0.6470928
        ]
        # The derivative is of single-precision heights of 8 m, rounded to 5e-7 m: 4e-2/2e-2 times that.
        np.testing.assert_allclose(throttle, expected, atol=2e-6)
        np.testing.assert_allclose(states.integral, [0.04, 0.078, 0.116], atol=1e-6)
        np.testing.assert_allclose(states.error, [2.0, 1.9, 1.9], atol=1e-6)

    def test_above_the_set_point_there_is_less_throttle(self):
        _, throttle = heights([-12.0], [-10.0])
        assert throttle[0] == pytest.approx(0.59 - 0.06 - 0.0008 * 0.04, abs=1e-6)

    def test_no_derivative_on_the_step_where_the_set_point_changes(self):
        # The vehicle stays; the set-point jumps up by 1 m in step 2 and stays there. With the derivative the jump
        # would be 0.04 * 1/0.02 = 2: full throttle.
        states, throttle = heights([-10.0] * 4, [-10.0, -10.0, -11.0, -11.0])
        np.testing.assert_allclose(throttle, 0.59 + 0.03 * states.error + 0.0008 * states.integral, atol=1e-6)
        np.testing.assert_allclose(states.error, [0.0, 0.0, 1.0, 1.0])

    def test_derivative_is_back_on_the_next_step(self):
        _, throttle = heights([-10.0, -10.0, -10.01], [-10.0, -11.0, -11.0])
        # e: 0, 1, 0.99.
        assert throttle[2] == pytest.approx(0.59 + 0.03 * 0.99 + 0.0008 * 0.0398 - 0.04 * 0.5, abs=5e-6)

    @pytest.mark.parametrize(("error", "bound"), [(20.0, 1.0), (-20.0, 0.0)])
    def test_clip_and_anti_windup(self, error: float, bound: float):
        """e = 20: unclipped 0.59 + 0.6 + 0.0008 I; I takes up 0.4 per step and loses twice what is clipped."""
        states, throttle = heights([error - 10.0] * 3, [-10.0] * 3)
        integral, expected = 0.0, []
        for _ in range(3):
            integral += error * DT
            unclipped = 0.59 + 0.03 * error + 0.0008 * integral
            integral -= 2.0 * (unclipped - bound)
            expected.append(integral)
        # By hand, the first for e = 20: 0.4 - 2 (1.19032 - 1) = 0.01936.
        if error > 0.0:
            assert expected[0] == pytest.approx(0.01936, abs=1e-6)
        np.testing.assert_array_equal(throttle, bound)
        np.testing.assert_allclose(states.integral, expected, atol=2e-6)

    def test_the_integral_stays_bounded_while_clipped(self):
        # Without anti-windup 400 m s. With it I' = I + 0.4 - 2 (0.59 + 0.6 + 0.0008 (I + 0.4) - 1), which has its
        # fixed point at I = 0.01936/0.0016 = 12.1 and approaches it by a factor of 0.9984 per step.
        z, wanted = np.full((1000, 1), 10.0, F32), np.full((1000, 1), -10.0, F32)
        states, throttle = _heights(LOOP, z, wanted)
        np.testing.assert_array_equal(throttle, 1.0)
        assert float(states.integral[-1, 0]) == pytest.approx(12.1 * (1.0 - 0.9984**1000), rel=1e-3)

    def test_without_clipping_nothing_is_taken_off(self):
        states, _ = heights([-9.0] * 50, [-10.0] * 50)
        np.testing.assert_allclose(states.integral, 0.02 * np.arange(1, 51), rtol=1e-5)

    def test_own_gains_and_time_step(self):
        loop = cast(HeightLoop(hover_throttle=0.5, kp=0.1, ki=0.5, kd=0.02, anti_windup=0.0), F32)  # type: ignore[arg-type]
        _, throttle = heights([-9.0, -9.1], [-10.0, -10.0], loop)
        np.testing.assert_allclose(throttle, [0.5 + 0.1 + 0.01, 0.5 + 0.09 + 0.019 - 0.1], atol=2e-6)
        slower = jax.jit(lambda loop, state: loop.step(state, floats(-9.0), floats(-10.0), 0.1))
        state, found = slower(loop, HeightState(floats(1.0), floats(1.2), floats(-10.0)))
        # I = 1 + 1 * 0.1, de/dt = -0.2/0.1: 0.5 + 0.1 + 0.55 - 0.04, clipped to 1.
        assert float(state.integral[0]) == pytest.approx(1.1)
        assert float(found[0]) == 1.0

    def test_vehicles_have_loops_of_their_own(self):
        z = np.array([[-8.0, -12.0, -10.0], [-8.1, -11.0, -10.0]], F32)
        wanted = np.array([[-10.0, -10.0, -10.0], [-10.0, -11.0, -10.0]], F32)
        _, together = _heights(LOOP, z, wanted)
        for i in range(3):
            np.testing.assert_allclose(together[:, i], heights(z[:, i], wanted[:, i])[1], atol=1e-6)


CASE = {"x": 0.0, "y": 0.0, "z": -10.0, "vn": 0.0, "ve": 0.0, "vd": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
WANTED = {"to_x": 0.0, "to_y": 0.0, "to_z": -10.0, "to_yaw": 0.0}


@jax.jit
def _command(controller: WaypointController, estimate: Estimate, setpoint: WaypointSetpoint) -> Command:
    return controller.step(controller.init(estimate), estimate, setpoint, DT)[1]


def commands(*cases: dict[str, float], controller: WaypointController = CONTROLLER) -> list[dict[str, float]]:
    """First command for each case, given as what differs from hovering at the waypoint."""
    # As many vehicles each time, so that this compiles once.
    filled = [CASE | WANTED | case for case in cases] + [CASE | WANTED] * (16 - len(cases))
    column = {name: floats(*(case[name] for case in filled)) for name in CASE | WANTED}
    estimate = Estimate(
        Vec3(column["x"], column["y"], column["z"]),
        Vec3(column["vn"], column["ve"], column["vd"]),
        Euler(column["roll"], column["pitch"], column["yaw"]),
    )
    setpoint = WaypointSetpoint(Vec3(column["to_x"], column["to_y"], column["to_z"]), column["to_yaw"])
    found = _command(controller, estimate, setpoint)
    names = ("pitch", "roll", "throttle", "yaw_rate", "battery")
    return [{name: float(getattr(found, name)[i]) for name in names} for i in range(len(cases))]


def near(**values: float) -> Any:
    """A command with the named fields, otherwise that of hovering at the waypoint."""
    return pytest.approx(
        {"pitch": 0.0, "roll": 0.0, "throttle": 0.59, "yaw_rate": 0.0, "battery": 12.0} | values, abs=2e-6
    )


class TestWaypointController:
    def test_hovers_at_the_waypoint(self):
        assert commands({})[0] == near()

    def test_commands_by_hand(self):
        found = commands(
            {"to_x": 2.0},  # 2 m ahead: u_des = 1.8, pitch = 0.09 (0 - 1.8): nose down
            {"to_x": -2.0},
            {"to_y": 2.0},  # to the right: v_des = 1.8, roll = 0.09 (1.8 - 0): right side down
            {"to_x": 2.0, "vn": 2.5},  # too fast: 0.09 (2.5 - 1.8), nose up
            {"to_y": 2.0, "ve": 2.5},
            {"to_z": -12.0},  # 2 m too low
            {"to_yaw": 0.5},
            {"yaw": 0.2, "to_yaw": -0.2},
        )
        assert found == [
            near(pitch=-0.162),
            near(pitch=0.162),
            near(roll=0.162),
            near(pitch=0.063),
            near(roll=-0.063),
            near(throttle=0.59 + 0.06 + 0.0008 * 0.04),
            near(yaw_rate=3.0),
            near(yaw_rate=-2.4),
        ]

    def test_each_clip(self):
        found = commands(
            {"to_x": 5.5},  # 4.95 m/s: just not clipped
            {"to_x": 100.0, "vn": 4.0},  # 5 m/s wanted: -0.09
            {"to_x": -100.0, "vn": -4.0},
            {"to_y": 100.0, "ve": 4.0},
            {"to_y": -100.0, "ve": -4.0},
            {"to_x": 100.0, "to_y": -100.0},  # each axis on its own: 0.09 * 5 = 0.45 is more than 0.34
            {"to_x": -100.0, "to_y": 100.0},
            {"to_yaw": 1.0},  # 6 is more than 4.4
            {"to_yaw": -1.0},
            {"to_z": -40.0},  # 0.59 + 0.9
            {"to_z": 20.0},  # 0.59 - 0.9
        )
        assert found == [
            near(pitch=-0.34),
            near(pitch=-0.09),
            near(pitch=0.09),
            near(roll=0.09),
            near(roll=-0.09),
            near(pitch=-0.34, roll=-0.34),
            near(pitch=0.34, roll=0.34),
            near(yaw_rate=4.4),
            near(yaw_rate=-4.4),
            near(throttle=1.0),
            near(throttle=0.0),
        ]
        # What the first one is before its tilt is clipped, with a limit that does not bind.
        wide = cast(WaypointController(tilt_limit=0.9), F32)  # type: ignore[arg-type]
        assert commands({"to_x": 5.5}, {"to_x": 5.6}, controller=wide) == [near(pitch=-0.4455), near(pitch=-0.45)]

    def test_own_limits_and_battery(self):
        changed = WaypointController(
            position_gain=0.5, speed_limit=1.0, velocity_gain=0.2, tilt_limit=0.1, yaw_gain=2.0, yaw_rate_limit=0.5,
            battery=11.0, height=HeightLoop(hover_throttle=0.5),
        )  # type: ignore[arg-type]  # fmt: skip
        found = commands(
            {"to_x": 0.4}, {"to_x": 9.0, "vn": 0.8}, {"to_y": 9.0}, {"to_yaw": 0.1}, {"to_yaw": 3.0},
            controller=cast(changed, F32),
        )  # fmt: skip
        own = {"throttle": 0.5, "battery": 11.0}
        assert found == [
            near(**own, pitch=-0.04),
            near(**own, pitch=-0.04),
            near(**own, roll=0.1),
            near(**own, yaw_rate=0.2),
            near(**own, yaw_rate=0.5),
        ]

    def test_yaw_goes_the_short_way(self):
        near_pi = math.pi - 0.05
        found = commands(
            {"yaw": near_pi, "to_yaw": -near_pi},  # 0.1 rad further clockwise
            {"yaw": -near_pi, "to_yaw": near_pi},
            {"yaw": 6.0 * math.pi + 0.1, "to_yaw": 0.0},  # turns are counted in the state, not in the error
            {"yaw": -9.0 * math.pi, "to_yaw": math.pi - 0.2},
            {"yaw": 0.1, "to_yaw": 2.0 * math.pi},
        )
        rates = [command["yaw_rate"] for command in found]
        # Angles of 28 rad are rounded to 1e-6 rad, which the gain makes 6e-6 rad/s.
        assert rates == pytest.approx([0.6, -0.6, -0.6, -1.2, -0.6], abs=2e-5)

    def test_errors_are_turned_into_the_heading_frame(self):
        """The same situation in the vehicle's eyes, at several headings."""
        ahead, right, u, v = 2.0, -1.0, 0.3, 0.7
        cases = []
        for yaw in (0.0, 0.5 * math.pi, -2.0, 3.0, 8.0):
            c, s = math.cos(yaw), math.sin(yaw)
            cases.append(
                {
                    "yaw": yaw, "to_yaw": yaw, "x": 7.0, "y": -3.0,
                    "to_x": 7.0 + c * ahead - s * right, "to_y": -3.0 + s * ahead + c * right,
                    "vn": c * u - s * v, "ve": s * u + c * v,
                }
            )  # fmt: skip
        expected = near(pitch=0.09 * (0.3 - 1.8), roll=0.09 * (-0.9 - 0.7))
        for found in commands(*cases):
            assert found == expected

    def test_tilt_and_climb_have_no_part_in_the_heading_frame(self):
        # Only the heading turns the horizontal velocity, as with GNSS: not roll, pitch or the rate of climb.
        found = commands({"roll": 0.3, "pitch": -0.2, "vd": -2.0, "vn": 1.0, "to_x": 2.0})
        assert found[0] == near(pitch=0.09 * (1.0 - 1.8))

    def test_keeps_the_height_loops_memory(self):
        @jax.jit
        def two(controller: WaypointController) -> tuple[HeightState, Command]:
            zero = jnp.zeros(1, jnp.float32)
            estimate = Estimate(Vec3(zero, zero, zero - 8.0), Vec3(zero, zero, zero), Euler(zero, zero, zero))
            setpoint = WaypointSetpoint(Vec3(zero, zero, zero - 10.0), zero)
            state, _ = controller.step(controller.init(estimate), estimate, setpoint, DT)
            lower = replace(estimate, position_ned=Vec3(zero, zero, zero - 7.9))
            return controller.step(state, lower, setpoint, DT)

        state, command = two(CONTROLLER)
        # e = 2.1, I = 0.04 + 0.042, de/dt = 5.
        assert float(state.integral[0]) == pytest.approx(0.082, abs=1e-6)
        assert float(command.throttle[0]) == pytest.approx(0.59 + 0.063 + 0.0008 * 0.082 + 0.2, abs=2e-6)


# Three vehicles with three, one and two waypoints, padded with what must never be used.
FAR = 1e6
ROUTE = Route(
    Vec3(
        np.array([[10.0, 5.0, -10.0], [20.0, FAR, -20.0], [30.0, FAR, FAR]], F32),  # type: ignore[arg-type]
        np.array([[0.0, 5.0, 0.0], [1.0, FAR, 2.0], [2.0, FAR, FAR]], F32),  # type: ignore[arg-type]
        np.array([[-10.0, -20.0, -30.0], [-11.0, FAR, -32.0], [-12.0, FAR, FAR]], F32),  # type: ignore[arg-type]
    ),
    np.array([[0.1, 0.5, 0.7], [0.2, FAR, 0.8], [0.3, FAR, FAR]], F32),  # type: ignore[arg-type]
    np.array([3, 1, 2], np.int32),  # type: ignore[arg-type]
)
AWAY = [500.0, 500.0, -500.0]


@jax.jit
def _follow(follower: RouteFollower, positions: Vec3) -> tuple[RouteState, WaypointSetpoint]:
    """States and set-points of vehicles at positions (steps, 3)."""

    def tick(state: RouteState, position: Vec3) -> tuple[RouteState, Any]:
        state, setpoint = follower.step(state, ROUTE, position)
        return state, (state, setpoint)

    return jax.lax.scan(tick, follower.init(ROUTE), positions)[1]


def follow(follower: RouteFollower, positions: Any) -> tuple[Array, Array, Array]:
    """Index and count of waypoints reached, (steps, 3) each, and set-point x, y, z, yaw, (steps, 3, 4)."""
    path = np.asarray(positions, F32)
    padded = np.concatenate([path, np.tile(F32(AWAY), (12 - len(path), 3, 1))])
    state, setpoint = _follow(cast(follower, F32), Vec3(*np.moveaxis(padded, -1, 0)))  # type: ignore[arg-type]
    where = np.stack([*(np.asarray(leaf) for leaf in jax.tree.leaves(setpoint.position_ned)), setpoint.yaw], axis=-1)
    return np.asarray(state.index)[: len(path)], np.asarray(state.reached)[: len(path)], where[: len(path)]


def visit(*stations: tuple[int | None, int | None, int | None]) -> list[list[list[float]]]:
    """Positions of the three vehicles at waypoints of these numbers, or away from all of them."""
    points = np.moveaxis(np.array(jax.tree.leaves(ROUTE.position_ned)), 0, -1)
    return [[AWAY if k is None else points[k, i].tolist() for i, k in enumerate(row)] for row in stations]


class TestRouteFollower:
    def test_starts_at_the_first_waypoint(self):
        index, reached, where = follow(RouteFollower(), visit((None, None, None)))
        np.testing.assert_array_equal(index, [[0, 0, 0]])
        np.testing.assert_array_equal(reached, [[0, 0, 0]])
        expected = [[[10.0, 0.0, -10.0, 0.1], [5.0, 5.0, -20.0, 0.5], [-10.0, 0.0, -30.0, 0.7]]]
        np.testing.assert_array_equal(where, np.array(expected, F32))

    def test_repeats_from_the_last_to_the_first(self):
        stations = [(0, None, 0), (None, None, None), (1, None, 1), (2, None, None), (None, None, 0), (0, None, 1)]
        index, reached, where = follow(RouteFollower(repeat=True), visit(*stations))
        np.testing.assert_array_equal(index[:, 0], [1, 1, 2, 0, 0, 1])
        np.testing.assert_array_equal(reached[:, 0], [1, 1, 2, 3, 3, 4])
        np.testing.assert_array_equal(index[:, 2], [1, 1, 0, 0, 1, 0])
        np.testing.assert_array_equal(reached[:, 2], [1, 1, 2, 2, 3, 4])
        # The set-point is that of the new waypoint at once, with its heading; never the padding.
        np.testing.assert_array_equal(
            where[0], np.array([[20, 1, -11, 0.2], [5, 5, -20, 0.5], [-20, 2, -32, 0.8]], F32)
        )
        np.testing.assert_array_equal(where[3, 0], np.array([10.0, 0.0, -10.0, 0.1], F32))
        assert np.max(np.abs(where)) < 100.0

    def test_holds_at_the_last(self):
        stations = [(0, None, 0), (1, None, 1), (2, None, None), (None, None, 0), (0, None, None)]
        index, reached, where = follow(RouteFollower(repeat=False), visit(*stations))
        np.testing.assert_array_equal(index[:, 0], [1, 2, 2, 2, 2])
        np.testing.assert_array_equal(reached[:, 0], [1, 2, 3, 3, 3])
        np.testing.assert_array_equal(index[:, 2], [1, 1, 1, 1, 1])
        np.testing.assert_array_equal(reached[:, 2], [1, 2, 2, 2, 2])
        np.testing.assert_array_equal(where[-1, 0], np.array([30.0, 2.0, -12.0, 0.3], F32))
        assert np.max(np.abs(where)) < 100.0

    @pytest.mark.parametrize("repeat", [True, False])
    def test_a_route_of_one_waypoint_stays_there(self, repeat: bool):
        index, _, where = follow(RouteFollower(repeat=repeat), visit(*[(None, 0, None)] * 3, (None, None, None)))
        np.testing.assert_array_equal(index[:, 1], 0)
        np.testing.assert_array_equal(where[:, 1], np.tile(np.array([5.0, 5.0, -20.0, 0.5], F32), (4, 1)))

    @pytest.mark.parametrize(
        ("repeat", "vehicle", "count"), [(False, 0, 3), (False, 1, 1), (False, 2, 2), (True, 1, 1)]
    )
    def test_a_waypoint_where_a_vehicle_holds_is_reached_once(self, repeat: bool, vehicle: int, count: int):
        stations = visit((0, 0, 0), (1, 0, 1), *[(2, 0, 1)] * 5)
        _, reached, _ = follow(RouteFollower(repeat=repeat), stations)
        assert reached[-1, vehicle] == count

    def test_acceptance_is_a_sphere_of_open_boundary(self):
        first = np.array([10.0, 0.0, -10.0])
        # 3 m by 2-2-1 and by each axis, and just nearer.
        for offset in ([2.0, 2.0, 1.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, -3.0]):
            at = [[first + scale * np.array(offset), AWAY, AWAY] for scale in (1.001, 1.0, 0.999)]
            index, _, _ = follow(RouteFollower(), at)
            np.testing.assert_array_equal(index[:, 0], [0, 0, 1])

    def test_own_radius(self):
        follower = RouteFollower(acceptance_radius=0.5)  # type: ignore[arg-type]
        index, _, _ = follow(follower, [[[10.6, 0.0, -10.0], AWAY, AWAY], [[10.4, 0.0, -10.0], AWAY, AWAY]])
        np.testing.assert_array_equal(index[:, 0], [0, 1])

    def test_one_waypoint_per_step(self):
        # At both of the third vehicle's waypoints at once, with a radius that takes in both.
        follower = RouteFollower(acceptance_radius=50.0)  # type: ignore[arg-type]
        index, reached, _ = follow(follower, visit(*[(None, None, 0)] * 3))
        np.testing.assert_array_equal(index[:, 2], [1, 0, 1])
        np.testing.assert_array_equal(reached[:, 2], [1, 2, 3])


def estimate_of(state: QuadrotorState) -> Estimate:
    """The truth."""
    velocity = rotation(state.attitude).to_ned(state.velocity_body)
    return Estimate(state.position_ned, velocity, state.attitude)


def fly(controller: WaypointController, setpoint: WaypointSetpoint, start: Vec3, steps: int) -> tuple[Any, ...]:
    """Fly identified vehicles (n,) in still air without noise; their states (steps, n) and commands."""
    vehicle, zero = cast(Quadrotor(), start.x.dtype), jnp.zeros_like(start.x)
    still = Vec3(zero, zero, zero)
    state = vehicle.initial_state(start, Euler(zero, zero, zero), still, still)

    def tick(carry: Any, _: None) -> Any:
        state, memory = carry
        memory, command = controller.step(memory, estimate_of(state), setpoint, DT)
        state, _ = vehicle.step(state, command, lambda trig: still, ProcessNoise(still, still), DT)
        return (state, memory), (state, command)

    return jax.lax.scan(tick, (state, controller.init(estimate_of(state))), None, steps)[1]


# Steps from hover 50 m above the ground, and the heading wanted after it.
STEPS = np.array([[0, 0, 0], [4, 0, 0], [0, -4, 0], [0, 0, -4], [3, 3, -2], [40, -30, -10]], float)
HEADINGS = np.array([0.0, 0.0, 0.0, 0.0, 2.5, -1.0])
HIGH = np.array([0.0, 0.0, -50.0])


@pytest.fixture(scope="module")
def responses() -> tuple[QuadrotorState, Command]:
    """States and commands of the 60 s after each of STEPS, (3000, 6) each."""
    start = Vec3(*np.tile(floats(*HIGH)[:, None], 6))  # type: ignore[arg-type]
    wanted = WaypointSetpoint(Vec3(*(HIGH + STEPS).T.astype(F32)), floats(*HEADINGS))  # type: ignore[arg-type]
    compiled = jax.jit(partial(fly, steps=3000), compiler_options={"xla_cpu_use_fusion_emitters": False})
    return jax.tree.map(np.asarray, compiled(CONTROLLER, wanted, start))


def misses(responses: tuple[QuadrotorState, Command]) -> tuple[Array, Array]:
    """Horizontal distance from the waypoint and height error (positive when too low) [m], (3000, 6) each."""
    position = responses[0].position_ned
    error = np.stack(jax.tree.leaves(position), axis=-1).astype(np.float64) - HIGH - STEPS
    return np.linalg.norm(error[..., :2], axis=-1), error[..., 2]


def at_second(time: float) -> int:
    return round(time / DT) - 1


class TestClosedLoop:
    """The identified vehicle in still air, fed with the truth."""

    def test_settles_horizontally(self, responses):
        """Within 5 cm from 10 s on after steps of up to 4.3 m, and from 25 s on after one of 50 m; then to 1 mm."""
        horizontal, _ = misses(responses)
        assert np.max(horizontal[at_second(10.0) :, :5]) < 0.05
        assert np.max(horizontal[at_second(25.0) :]) < 0.05
        assert np.max(horizontal[at_second(40.0) :]) < 1e-3

    def test_settles_vertically(self, responses):
        """Within 0.25 m from 8 s on after steps of up to 4 m, and then as slowly as the integral: 0.1 m after 60 s."""
        _, vertical = misses(responses)
        assert np.max(np.abs(vertical[at_second(8.0) :, :5])) < 0.25
        assert np.max(np.abs(vertical[-1, :5])) < 0.1
        # The hover throttle of 0.59 is not quite that of 1.68 kg: 4.4e-5/0.03, which the integral takes away.
        assert np.max(np.abs(vertical[:, 0])) < 2e-3
        assert abs(vertical[-1, 0]) < 0.5e-3

    def test_slowest_mode_is_that_of_the_height_integral(self, responses):
        """The smallest root of the loop linearised at hover: s^3 + (K kd/m - Kw) s^2 + K kp/m s + K ki/m."""
        v, raw = Quadrotor(), 0.59004354 * 4097.0
        gain = 4097.0 * (v.cth1 + 2.0 * v.cth2 * raw) / v.mass
        slowest = np.max(np.roots([1.0, gain * 0.04 - v.kw, gain * 0.03, gain * 0.0008]).real)
        assert -1.0 / slowest == pytest.approx(34.45, abs=0.01)
        _, vertical = misses(responses)
        found = np.log(vertical[-1, 3] / vertical[at_second(30.0), 3]) / 30.0
        assert found == pytest.approx(slowest, rel=0.03)

    def test_does_not_overshoot_much(self, responses):
        """By less than 5 % of a horizontal step and 6 % of a climb."""
        position = responses[0].position_ned
        assert 4.0 < np.max(position.x[:, 1]) < 4.2
        assert 4.0 < np.max(-position.y[:, 2]) < 4.2
        assert 4.0 < np.max(HIGH[2] - position.z[:, 3]) < 4.24

    def test_settles_on_its_heading(self, responses):
        """Within 0.01 rad from 4 s on, and then to 1e-4 rad."""
        error = np.abs(responses[0].attitude.yaw - HEADINGS)
        assert np.max(error[at_second(4.0) :]) < 0.01
        assert np.max(error[at_second(10.0) :]) < 1e-4

    def test_axes_do_not_disturb_each_other(self, responses):
        """Ahead is what right is, and a climb moves nothing sideways."""
        position = responses[0].position_ned
        np.testing.assert_allclose(position.x[:, 1], -position.y[:, 2], atol=1e-5)
        np.testing.assert_array_equal(position.y[:, 1], 0.0)
        np.testing.assert_array_equal(position.x[:, 3], 0.0)
        # A step ahead tilts the thrust, which costs some height.
        _, vertical = misses(responses)
        assert 0.0 < np.max(vertical[:, 1]) < 0.15

    def test_commands_and_speeds_stay_within_their_limits(self, responses):
        state, command = responses
        assert np.max(np.abs([command.pitch, command.roll])) <= F32(0.34)
        assert np.max(np.abs(command.yaw_rate)) <= F32(4.4)
        assert np.min(command.throttle) >= 0.0
        assert np.max(command.throttle) <= 1.0
        np.testing.assert_array_equal(command.battery, 12.0)
        # On the way over 50 m the tilt is what limits the speed, not the clip at 5 m/s.
        assert 2.0 < np.max(np.abs([state.velocity_body.x, state.velocity_body.y])) < 5.0


class TestGradients:
    @pytest.mark.long
    def test_with_respect_to_gains_set_point_and_start(self):
        """Finite, also where the vehicle is at its waypoint, where commands are clipped, and at the yaw's wrap."""
        start = Vec3(floats(0.0, 0.0, 0.0), floats(0.0, 0.0, 0.0), floats(-10.0, -10.0, -10.0))
        wanted = WaypointSetpoint(
            Vec3(floats(0.0, 60.0, 1.0), floats(0.0, -60.0, 2.0), floats(-10.0, -60.0, -11.0)),
            floats(0.0, math.pi, 0.3),
        )

        def cost(controller: WaypointController, wanted: WaypointSetpoint, start: Vec3) -> jax.Array:
            state, _ = fly(controller, wanted, start, 50)
            miss = jax.tree.map(lambda x: x[-1], state.position_ned) - wanted.position_ned
            return jnp.sum(miss.dot(miss)) + jnp.sum(state.attitude.yaw[-1])

        controller = jax.tree.map(jnp.asarray, CONTROLLER)
        options = {"xla_cpu_use_fusion_emitters": False}
        gradient = jax.jit(jax.grad(cost, argnums=(0, 1, 2)), compiler_options=options)(controller, wanted, start)
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(gradient)]
        assert len(leaves) == 12 + 4 + 3
        assert all(np.all(np.isfinite(leaf)) for leaf in leaves)
        # Each matters: the second vehicle climbs at full throttle, which the battery limits.
        by_name = gradient[0]
        for name in (
            "battery",
            "position_gain",
            "speed_limit",
            "velocity_gain",
            "tilt_limit",
            "yaw_gain",
            "yaw_rate_limit",
        ):
            assert float(getattr(by_name, name)) != 0.0, name
        for name in ("hover_throttle", "kp", "ki", "kd"):
            assert float(getattr(by_name.height, name)) != 0.0, name

    def test_of_a_command_equals_differences(self):
        """In double precision, with every part of the controller in its linear range."""
        with jax.enable_x64(True):
            point = np.array([0.3, -0.2, -10.1, 0.1, -0.2, 0.05, 0.4, 0.6, -0.5, -10.4, 0.3])

            @jax.jit
            def command(x: jax.Array) -> jax.Array:
                x = x[:, None]
                zero = jnp.zeros_like(x[0])
                estimate = Estimate(Vec3(*x[:3]), Vec3(*x[3:6]), Euler(zero, zero, x[6]))
                memory = HeightState(zero + 0.3, zero + 0.2, x[9])
                found = CONTROLLER64.step(memory, estimate, WaypointSetpoint(Vec3(*x[7:10]), x[10]), DT)[1]
                return jnp.concatenate([found.pitch, found.roll, found.throttle, found.yaw_rate])

            jacobian = np.asarray(jax.jit(jax.jacfwd(command))(point))
            for i in range(len(point)):
                h = 1e-6 * np.eye(len(point))[i]
                difference = (np.asarray(command(point + h)) - np.asarray(command(point - h))) / 2e-6
                if i != 9:  # the height wanted: a difference there is a set-point change
                    np.testing.assert_allclose(jacobian[:, i], difference, rtol=1e-6, atol=1e-8)

    def test_through_a_route(self):
        """Finite where a vehicle is exactly at a waypoint: its distance there has no slope, and none is asked for."""

        def total(xy: jax.Array) -> jax.Array:
            follower = cast(RouteFollower(), F32)
            positions = Vec3(xy, jnp.asarray(ROUTE.position_ned.y)[0], jnp.asarray(ROUTE.position_ned.z)[0])
            return jnp.sum(follower.step(follower.init(ROUTE), ROUTE, positions)[1].position_ned.stack())

        assert np.all(np.isfinite(jax.jit(jax.grad(total))(jnp.asarray(ROUTE.position_ned.x)[0])))
