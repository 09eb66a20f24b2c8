"""Controllers of velocities, heights and attitudes: commands by hand, each on the vehicle, and all in one."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control import (
    AttitudeController,
    AttitudeHeightController,
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    ClimbLoop,
    Estimate,
    HeightLoop,
    OffboardController,
    VelocityController,
    VelocityHeightController,
    VelocityHeightSetpoint,
    VelocityLoop,
    VelocitySetpoint,
    WaypointController,
    WaypointSetpoint,
)
from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3, rotation
from qrsim.models.vehicles.process_noise import ProcessNoise
from qrsim.models.vehicles.quadrotor import Quadrotor

Array = np.ndarray[Any, Any]
DT = 0.02
QUICK = {"xla_cpu_use_fusion_emitters": False}
HOVER = 0.59004353928  # the throttle that carries the weight: docs/explanation/models/vehicle.md
SETTLES = 0.74498  # of a tilt command


@partial(jax.jit, compiler_options=QUICK)
def _steps(controller: Any, estimates: Estimate, setpoints: Any, memory: Any) -> Any:
    def tick(memory: Any, now: Any) -> Any:
        memory, command = controller.step(memory, *now, DT)
        return memory, (memory, command)

    return jax.lax.scan(tick, memory, (estimates, setpoints))[1]


def estimates(rows: list[dict[str, Any]]) -> Estimate:
    """One vehicle at rest and level at (0, 0, -10), each step with what differs: at, moves, turned (3,)."""
    columns = [
        np.array([row.get(name, default) for row in rows], np.float64)[:, None]
        for name, default in (("at", [0, 0, -10]), ("moves", [0, 0, 0]), ("turned", [0, 0, 0]))
    ]
    return Estimate.of(*columns)


def commands(controller: Any, rows: list[dict[str, Any]], setpoints: list[Any], memory: Any = None) -> Any:
    """Commands (T,) by name, and the memories, of a vehicle that believes each row in turn."""
    with jax.enable_x64(True):
        controller = cast(controller, np.float64)
        seen = estimates(rows)
        wanted = jax.tree.map(lambda *leaves: np.stack(leaves), *setpoints)
        start = controller.init(jax.tree.map(lambda leaf: leaf[0], seen)) if memory is None else memory
        memories, command = _steps(controller, seen, wanted, start)
        found = {name: np.asarray(getattr(command, name))[:, 0] for name in vars(command)}
        return found, jax.tree.map(np.asarray, memories)


def velocity(*rows: Any, yaw: float = 0.0) -> list[VelocitySetpoint]:
    return [VelocitySetpoint.of(np.array([row], np.float64), yaw) for row in rows]


def close(found: Any, *expected: float) -> None:
    np.testing.assert_allclose(found, expected, atol=1e-9)


class TestVelocity:
    def test_commands_by_hand(self):
        """e = 0.8, 0.7, 0.7: 0.25 e + 0.003 sum(e) + 0.05 de/dt, the sum of the steps before; ahead is nose down."""
        rows = [{"moves": [speed, 0, 0]} for speed in (0.2, 0.3, 0.3)]
        found, _ = commands(VelocityController(), rows, velocity(*[[1.0, 0, 0]] * 3))
        close(found["pitch"], -0.2, -(0.175 + 0.0024 - 0.25), -(0.175 + 0.0045))
        close(found["roll"], 0.0, 0.0, 0.0)
        close(found["throttle"], 0.59, 0.59, 0.59)
        close(found["battery"], 12.0, 12.0, 12.0)

    def test_to_the_right_is_right_side_down(self):
        rows = [{"moves": [0, speed, 0]} for speed in (0.2, 0.3, 0.3)]
        found, _ = commands(VelocityController(), rows, velocity(*[[0, 1.0, 0]] * 3))
        close(found["roll"], 0.2, 0.175 + 0.0024 - 0.25, 0.175 + 0.0045)
        close(found["pitch"], 0.0, 0.0, 0.0)

    def test_vertical(self):
        """e = w_des - w, down positive: 0.59 - 0.2 e - 0.002 sum(e), summed after use; no derivative."""
        rows = [{"moves": [0, 0, w]} for w in (0.0, -0.4, -0.4)]
        found, _ = commands(VelocityController(), rows, velocity(*[[0, 0, -1.0]] * 3))
        close(found["throttle"], 0.59 + 0.2, 0.59 + 0.12 + 0.002, 0.59 + 0.12 + 0.0032)

    def test_no_derivative_where_the_set_point_changes(self):
        """The error jumps from 0.8 to 1.1: a derivative would ask for 0.75 rad more. It is back on the next step."""
        rows = [{"moves": [0.2, 0, 0]}] * 2 + [{"moves": [0.21, 0, 0]}]
        found, _ = commands(VelocityController(), rows, velocity([1.0, 0, 0], [1.3, 0, 0], [1.3, 0, 0]))
        close(found["pitch"], -0.2, -(0.275 + 0.0024), -(0.2725 + 0.0024 + 0.0033 - 0.025))

    def test_a_turning_body_is_no_new_set_point(self):
        """The error in body axes changes because the body turns, and its derivative counts."""
        found, _ = commands(VelocityController(), [{}, {"turned": [0, 0, 0.01]}], velocity(*[[0.5, 0, 0]] * 2))
        sideways = -0.5 * math.sin(0.01)
        close(found["roll"], 0.0, 0.25 * sideways + 0.05 * sideways / DT)

    def test_the_set_point_is_turned_by_all_angles(self):
        """Heading east, north is to the left; nose up by 0.3, it is also downwards in the body's eyes."""
        east, _ = commands(
            VelocityController(), [{"turned": [0, 0, math.pi / 2]}], velocity([1.0, 0, 0], yaw=math.pi / 2)
        )
        close([east["pitch"][0], east["roll"][0], east["yaw_rate"][0]], 0.0, -0.25, 0.0)
        up, _ = commands(VelocityController(), [{"turned": [0, 0.3, 0]}], velocity([1.0, 0, 0]))
        close(up["pitch"], -0.25 * math.cos(0.3))
        close(up["throttle"], 0.59 - 0.2 * math.sin(0.3))

    def test_clips(self):
        """The wanted velocity at 3 m/s on each body axis, the tilt at 0.34 rad, the throttle at 0 and 1."""
        cases = [
            ([10.0, 0, 0], [2.5, 0, 0], (-0.125, 0.0, 0.59)),
            ([0, -10.0, 0], [0, -2.5, 0], (0.0, -0.125, 0.59)),
            ([0, 0, 10.0], [0, 0, 2.5], (0.0, 0.0, 0.49)),
            ([2.0, 2.0, 0], [0, 0, 0], (-0.34, 0.34, 0.59)),
            ([0, 0, -3.0], [0, 0, 0], (0.0, 0.0, 1.0)),
            ([0, 0, 3.0], [0, 0, 0], (0.0, 0.0, 0.0)),
        ]
        for wanted, moves, expected in cases:
            found, _ = commands(VelocityController(), [{"moves": moves}], velocity(wanted))
            close([found[name][0] for name in ("pitch", "roll", "throttle")], *expected)

    @pytest.mark.parametrize(("windup", "grows"), [("held", False), ("published", True)])
    def test_windup(self, windup: Any, grows: bool):
        """What drives a clipped tilt or throttle further is summed as published, or not at all; what comes back is."""
        controller = VelocityController(velocity=VelocityLoop(windup=windup), climb=ClimbLoop(windup=windup))
        _, memory = commands(controller, [{}] * 4, velocity(*[[2.0, -2.0, -2.5]] * 4))
        steps = 0.02 * np.arange(1, 5)
        close(memory.horizontal.integral_x[:, 0], *(2.0 * steps * grows))
        close(memory.horizontal.integral_y[:, 0], *(-2.0 * steps * grows))
        close(memory.climb[:, 0], *(-2.5 * steps * grows))
        # With 0.15 * 4 of the sum the tilt is clipped at an error of the other sign, which is summed by both.
        last = jax.tree.map(lambda leaf: leaf[-1], memory)
        wound = jax.tree_util.tree_map(np.array, last)
        wound.horizontal.integral_x[:] = 4.0
        found, after = commands(controller, [{"moves": [2.2, 0, 0]}], velocity([2.0, 0, -2.5]), wound)
        close(found["pitch"], -0.34)
        close(after.horizontal.integral_x[:, 0], 4.0 - 0.2 * DT)

    def test_own_gains(self):
        controller = VelocityController(
            velocity=VelocityLoop(kp=0.1, ki=0.0, kd=0.0, speed_limit=1.0),
            climb=ClimbLoop(hover_throttle=0.5, kp=0.4),
            tilt_limit=0.05,
            yaw_gain=2.0,
            yaw_rate_limit=0.5,
            battery=11.0,
        )  # type: ignore[arg-type]
        found, _ = commands(controller, [{}], velocity([9.0, 0.3, -0.5], yaw=3.0))
        close(
            [found[name][0] for name in ("pitch", "roll", "throttle", "yaw_rate", "battery")],
            -0.05,
            0.03,
            0.7,
            0.5,
            11.0,
        )
        assert controller.hover_throttle == 0.5


def velocity_height(north: float, east: float, z: float, yaw: float = 0.0) -> VelocityHeightSetpoint:
    return VelocityHeightSetpoint.of(np.array([[north, east]], np.float64), z, yaw)


class TestVelocityHeight:
    def test_commands_by_hand(self):
        """Horizontally as with velocities, vertically the height loop, which is 2 m too low, then 1.9 m."""
        rows = [{"moves": [0.2, 0, 0]}, {"moves": [0.3, 0, 0], "at": [0, 0, -10.1]}]
        found, _ = commands(VelocityHeightController(), rows, [velocity_height(1.0, -0.4, -12.0)] * 2)
        close(found["pitch"], -0.2, -(0.175 + 0.0024 - 0.25))
        close(found["roll"], -0.1, -0.1 - 0.0012)
        close(found["throttle"], 0.59 + 0.06 + 0.0008 * 0.04, 0.59 + 0.057 + 0.0008 * 0.078 - 0.04 * 5.0)

    def test_a_climb_is_no_horizontal_error(self):
        """Also where the body is tilted, so that part of the climb is along its axes."""
        row = {"moves": [0, 0, -1.0], "turned": [0.2, 0.3, 0]}
        found, _ = commands(VelocityHeightController(), [row], [velocity_height(0.0, 0.0, -10.0)])
        close([found["pitch"][0], found["roll"][0], found["throttle"][0]], 0.0, 0.0, 0.59)

    def test_another_height_is_no_new_velocity(self):
        """The derivative of the height loop is dropped, that of the velocity is not."""
        rows = [{"moves": [0.2, 0, 0]}, {"moves": [0.3, 0, 0]}]
        found, _ = commands(
            VelocityHeightController(), rows, [velocity_height(1.0, 0.0, -10.0), velocity_height(1.0, 0.0, -11.0)]
        )
        close(found["pitch"], -0.2, -(0.175 + 0.0024 - 0.25))
        close(found["throttle"], 0.59, 0.59 + 0.03 + 0.0008 * 0.02)


class TestAttitudes:
    def test_attitude_height_by_hand(self):
        wanted = [
            AttitudeHeightSetpoint.of(np.array([roll]), pitch, -12.0, yaw)
            for roll, pitch, yaw in ((0.1, -0.2, 0.5), (-0.9, 0.9, math.pi))
        ]
        found, _ = commands(AttitudeHeightController(), [{}, {"turned": [0, 0, -math.pi + 0.1]}], wanted)
        close(found["roll"], 0.1, -0.34)
        close(found["pitch"], -0.2, 0.34)
        # Across the wrap of the heading the error is 0.1 rad the short way.
        close(found["yaw_rate"], 3.0, -0.6)
        close(found["throttle"], 0.59 + 0.06 + 0.0008 * 0.04, 0.59 + 0.06 + 0.0008 * 0.08)

    def test_attitude_by_hand(self):
        wanted = [
            AttitudeSetpoint.of(np.array([roll]), pitch, 0.0, throttle)
            for roll, pitch, throttle in ((0.1, -0.2, 0.7), (0.9, -0.9, 1.3), (0.0, 0.0, -0.2))
        ]
        found, _ = commands(AttitudeController(), [{}] * 3, wanted)
        close(found["roll"], 0.1, 0.34, 0.0)
        close(found["pitch"], -0.2, -0.34, 0.0)
        close(found["throttle"], 0.7, 1.0, 0.0)
        wide, _ = commands(AttitudeController(tilt_limit=0.9), [{}] * 3, wanted)  # type: ignore[arg-type]
        close(wide["roll"], 0.1, 0.9, 0.0)


def attitude_height(i: int) -> AttitudeHeightSetpoint:
    return AttitudeHeightSetpoint.of(np.array([0.1]), 0.2, -9.0, 0.3)


SINGLES: dict[str, tuple[Any, Any]] = {
    "waypoint": (WaypointController(), lambda i: WaypointSetpoint.of(np.array([[2.0, -1.0, -12.0]]), 0.3)),
    "velocity": (VelocityController(), lambda i: VelocitySetpoint.of(np.array([[1.0, 0.4, -0.3 - (i > 3)]]), 0.3)),
    "velocity_height": (VelocityHeightController(), lambda i: velocity_height(1.0 + (i > 3), -0.4, -12.0, 0.3)),
    "attitude_height": (
        AttitudeHeightController(),
        lambda i: AttitudeHeightSetpoint.of(np.array([0.1]), 0.2, -9.0, 0.3),
    ),
    "attitude": (AttitudeController(), lambda i: AttitudeSetpoint.of(np.array([0.1]), 0.2, 0.3, 0.7)),
}
WANDERING = [
    {
        "at": [0.1 * i, -0.05 * i, -10 - 0.02 * i],
        "moves": [0.1 * i, 0.3, -0.1 * i],
        "turned": [0.02 * i, -0.03, 0.1 * i],
    }
    for i in range(7)
]


def own_gains(controller: Any) -> Any:
    """The same gains, none of them the default, in a controller of one kind and in the one of all kinds."""
    gains = {
        "position_gain": 0.8,
        "speed_limit": 4.0,
        "velocity_gain": 0.1,
        "tilt_limit": 0.3,
        "yaw_gain": 5.0,
        "yaw_rate_limit": 1.0,
        "battery": 11.5,
        "velocity": VelocityLoop(kp=0.2, windup="published"),
        "climb": ClimbLoop(kp=0.3, hover_throttle=0.55),
        "height": HeightLoop(kp=0.02, hover_throttle=0.55),
        "hover_throttle": 0.55,
    }  # type: ignore[arg-type]
    return type(controller)(**{name: gains[name] for name in vars(controller) if name in gains})


class TestOffboard:
    @pytest.mark.parametrize("name", SINGLES)
    def test_is_each_of_the_others(self, name: str):
        single, wanted = SINGLES[name]
        setpoints = [wanted(i) for i in range(7)]
        for controllers in ((single, OffboardController()), (own_gains(single), own_gains(OffboardController()))):
            alone, together = (commands(controller, WANDERING, setpoints)[0] for controller in controllers)
            for field in alone:
                np.testing.assert_allclose(together[field], alone[field], atol=1e-12, err_msg=field)

    @pytest.mark.parametrize("name", ["waypoint", "velocity", "velocity_height", "attitude_height"])
    def test_loops_that_were_not_used_start_anew(self, name: str):
        """After anything is asked for that does not use them."""
        controller, (_, wanted) = OffboardController(), SINGLES[name]
        _, used = commands(controller, WANDERING, [wanted(i) for i in range(7)])
        other = SINGLES["attitude"][1]
        _, after = commands(controller, WANDERING[:1], [other(0)], jax.tree.map(lambda leaf: leaf[-1], used))
        again, _ = commands(
            controller, WANDERING, [wanted(i) for i in range(7)], jax.tree.map(lambda leaf: leaf[-1], after)
        )
        first, _ = commands(controller, WANDERING, [wanted(i) for i in range(7)])
        for field in first:
            np.testing.assert_array_equal(again[field], first[field])

    def test_a_loop_that_both_use_goes_on(self):
        """From velocities to velocities at a height the sum that holds against the wind is kept."""
        _, used = commands(OffboardController(), [{}] * 5, velocity(*[[0.5, 0, 0]] * 5))
        last = jax.tree.map(lambda leaf: leaf[-1], used)
        found, _ = commands(OffboardController(), [{}], [velocity_height(0.5, 0.0, 10.0)], last)
        close(found["pitch"], -(0.125 + 0.003 * 5 * 0.5))


def fly(controller: Any, setpoint: Any, seconds: float) -> dict[str, Array]:
    """Fly one vehicle per set-point (n,) from hover in calm air, fed with the truth; float32, (T, n, ...) each."""
    controller, setpoint = (cast(item, np.float32) for item in (controller, setpoint))
    like = jax.tree.leaves(setpoint)[0]
    compiled = jax.jit(partial(_fly, steps=round(seconds / DT)), compiler_options=QUICK)
    state, velocity_ned, command = jax.tree.map(np.asarray, compiled(controller, setpoint, np.zeros_like(like)))
    stack = partial(np.stack, axis=-1)
    return {
        "position": stack(jax.tree.leaves(state.position_ned)),
        "attitude": stack(jax.tree.leaves(state.attitude)),
        "velocity": stack(jax.tree.leaves(velocity_ned)),
        "tilt": np.maximum(np.abs(command.pitch), np.abs(command.roll)),
    }


def _fly(controller: Any, setpoint: Any, zero: Any, steps: int) -> Any:
    vehicle, still = cast(Quadrotor(), np.float32), Vec3(zero, zero, zero)
    start = Vec3(zero, zero, zero - jnp.float32(50.0))
    state = vehicle.initial_state(start, Euler(zero, zero, zero), still, still)

    def believed(state: Any) -> Estimate:
        return Estimate(state.position_ned, rotation(state.attitude).to_ned(state.velocity_body), state.attitude)

    def tick(carry: Any, _: None) -> Any:
        state, memory = carry
        memory, command = controller.step(memory, believed(state), setpoint, DT)
        state, _ = vehicle.step(state, command, lambda trig: still, ProcessNoise(still, still), DT)
        return (state, memory), (state, believed(state).velocity_ned, command)

    return jax.lax.scan(tick, (state, controller.init(believed(state))), None, steps)[1]


class TestClosedLoop:
    """The identified vehicle in calm air, fed with the truth, from hover."""

    def test_velocity(self):
        """No steady error: within 5 cm/s from 12 s on, 1 cm/s after 30 s; beyond 3 m/s the wanted speed is clipped."""
        wanted = np.array([[0, 0, 0], [2, 0, 0], [0, -2, 0], [0, 0, -1], [0, 0, 1], [1.5, 1.5, -0.5]], float)
        yaw = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        found = fly(VelocityController(), VelocitySetpoint.of(wanted, yaw), 30.0)
        error = np.abs(found["velocity"] - wanted)
        assert np.max(error[600:]) < 0.05
        assert np.max(error[-1]) < 0.01
        assert np.max(found["tilt"]) <= np.float32(0.34)
        np.testing.assert_allclose(found["attitude"][-1, :, 2], yaw, atol=1e-3)

    def test_velocity_height(self):
        wanted = np.array([[2.0, 0.0], [0.0, 0.0], [-1.0, 1.0]])
        wanted_z = np.array([-50.0, -53.0, -47.0])
        found = fly(VelocityHeightController(), VelocityHeightSetpoint.of(wanted, wanted_z, 0.0), 30.0)
        assert np.max(np.abs(found["velocity"][-1, :, :2] - wanted)) < 0.01
        # What is left of the height's error dies out with its integral, in 34 s (see test_control.py).
        error = np.abs(found["position"][:, :, 2] - wanted_z)
        assert np.max(error[500:]) < 0.3
        assert np.max(error[-1]) < 0.2

    def test_attitude_height(self):
        """The platform tilts by 0.745 of the command, and drag then balances gravity's part along the body."""
        roll, pitch = np.array([0.1, 0.0, 0.34, 0.9]), np.array([0.0, -0.2, 0.0, 0.0])
        found = fly(AttitudeHeightController(), AttitudeHeightSetpoint.of(roll, pitch, -50.0, 0.0), 20.0)
        tilts = found["attitude"][-1]
        np.testing.assert_allclose(tilts[:, 0], SETTLES * np.clip(roll, -0.34, 0.34), atol=2e-3)
        np.testing.assert_allclose(tilts[:, 1], SETTLES * pitch, atol=2e-3)
        # Horizontally, at a constant height: drag of the body's axes against the tilted thrust.
        speed = found["velocity"][-1, 1, 0]
        assert speed == pytest.approx(9.81 * math.tan(SETTLES * 0.2) / 0.497391, rel=0.1)
        # A tilt of 0.15 rad takes away 1.1 % of the lift and adds drag from above, until the integral knows.
        error = np.abs(found["position"][:, :2, 2] + 50.0)
        assert np.max(error) < 0.5
        assert np.all(error[-1] < np.max(error, axis=0))

    def test_attitude(self):
        """At the throttle that carries the weight it hovers; 1 % more climbs, up to where drag balances it."""
        throttle = np.array([HOVER, 1.01 * HOVER])
        zero = np.zeros(2)
        found = fly(AttitudeController(), AttitudeSetpoint.of(zero, zero, np.array([0.0, -1.0]), throttle), 10.0)
        assert np.max(np.abs(found["velocity"][:, 0])) < 1e-3
        raw = HOVER * 4097.0
        more = 0.01 * raw * (7.44649e-4 + 2 * 2.39855e-6 * raw) / 1.68
        assert found["velocity"][-1, 1, 2] == pytest.approx(-more / 1.35341, rel=0.02)
        assert found["attitude"][-1, 1, 2] == pytest.approx(-1.0, abs=1e-3)
