"""What a fleet is asked for that nobody commands, beside routes (see test_control.py)."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest

from qrsim.control import (
    SETPOINTS,
    AttitudeGuidance,
    AttitudeHeightGuidance,
    AttitudeHeightSetpoint,
    AttitudeSetpoint,
    Estimate,
    OffboardSetpoint,
    PathSetpoint,
    Route,
    VelocityGuidance,
    VelocityHeightGuidance,
    VelocityHeightSetpoint,
    VelocitySetpoint,
    WaypointSetpoint,
)
from qrsim.control.setpoints import TrackSetpoint
from qrsim.core.tree import cast
from qrsim.core.vectors import Vec3
from qrsim.scenarios import catalogue
from qrsim.scenarios.making import make_scenario

F32 = np.float32
# Two waypoints of two vehicles, the second padded.
HEIGHTS = np.array([[-10.0, -20.0], [-30.0, -20.0]], F32)
ROUTE = Route(
    Vec3(HEIGHTS * 0, HEIGHTS * 0, HEIGHTS), np.array([[0.5, -1.0], [0.7, -1.0]], F32), np.array([2, 1], np.int32)
)  # type: ignore[arg-type]
FAR = Vec3(*np.full((3, 2), 100.0, F32))


def asked(guidance: Any) -> Any:
    """What a guidance asks for, first and after a step, which must be one and the same."""
    guidance = cast(guidance, F32)
    state = guidance.init(ROUTE)
    after, setpoint = jax.jit(guidance.step)(state, ROUTE, FAR)
    np.testing.assert_array_equal(after.index, 0)
    np.testing.assert_array_equal(after.reached, 0)
    first = guidance.setpoint(state, ROUTE)
    assert type(setpoint) is type(first) is guidance.gives
    jax.tree.map(np.testing.assert_array_equal, setpoint, first)
    return setpoint


class TestDefaults:
    """Hover at the height of the first waypoint, at the vehicle's own heading."""

    @pytest.mark.parametrize(
        ("guidance", "expected"),
        [
            (VelocityGuidance(), {"velocity_ned.x": 0, "velocity_ned.y": 0, "velocity_ned.z": 0}),
            (VelocityHeightGuidance(), {"velocity_north": 0, "velocity_east": 0, "z": [-10, -20]}),
            (AttitudeHeightGuidance(), {"roll": 0, "pitch": 0, "z": [-10, -20]}),
            (AttitudeGuidance(), {"roll": 0, "pitch": 0, "throttle": 0.59}),
        ],
    )
    def test_values(self, guidance: Any, expected: dict[str, Any]):
        setpoint = asked(guidance)
        np.testing.assert_allclose(setpoint.yaw, [0.5, -1.0])
        for path, value in expected.items():
            found = setpoint
            for name in path.split("."):
                found = getattr(found, name)
            np.testing.assert_allclose(found, np.broadcast_to(value, 2), rtol=1e-6, err_msg=path)


class TestOwnNumbers:
    def test_one_for_all_or_one_for_each(self):
        level = asked(VelocityHeightGuidance(velocity_north=np.array([1.0, -1.0]), velocity_east=0.5))  # type: ignore[arg-type]
        np.testing.assert_allclose(level.velocity_north, [1.0, -1.0])
        np.testing.assert_allclose(level.velocity_east, [0.5, 0.5])
        climbing = asked(VelocityGuidance(velocity_down=-1.5))  # type: ignore[arg-type]
        np.testing.assert_allclose(climbing.velocity_ned.z, -1.5)
        tilted = asked(AttitudeGuidance(roll_rad=0.1, pitch_rad=np.array([0.2, 0.3]), throttle=0.7))  # type: ignore[arg-type]
        np.testing.assert_allclose(
            [tilted.roll, tilted.pitch, tilted.throttle], [[0.1] * 2, [0.2, 0.3], [0.7] * 2], rtol=1e-6
        )

    def test_a_vehicle_without_waypoints_keeps_the_height_of_its_start(self):
        world = make_scenario(
            [[0, 0, -10], {"position_ned": [9, 0, -12], "waypoints_ned": [[9, 9, -15]], "yaw_rad": 1.0}],
            controller="attitude_height",
        ).world()
        (fleet,) = world.fleets
        setpoint = fleet.guidance.setpoint(fleet.guidance.init(fleet.route), fleet.route)
        np.testing.assert_allclose(setpoint.z, [-10.0, -15.0])
        np.testing.assert_allclose(setpoint.yaw, [0.0, 1.0])


class TestTogether:
    def test_every_controller_has_the_guidance_of_its_name(self):
        """What a scenario without guidance gets fits its controller."""
        for name, controller in catalogue.CONTROLLERS.items():
            vehicle = {"none": "fixed_point", "fixed_wing": "fixed_wing", "rover": "rover"}.get(name, "pelican")
            given = name if name == "none" else {"type": name, "feed": "truth"}
            place = [[0, 0, 0 if name == "rover" else -30]]
            fleet = make_scenario(place, vehicle=vehicle, controller=given).spec.fleets["vehicles"]
            expected = name if name in catalogue.GUIDANCE else "route"
            assert fleet.guidance.type == expected
            assert catalogue.GUIDANCE[expected].gives in controller.setpoints  # type: ignore[attr-defined]

    def test_offboard_set_points_show_every_kind(self):
        """What is not asked for is NaN."""
        kinds = [
            WaypointSetpoint.of(np.ones((2, 3)), 0.5),
            VelocitySetpoint.of(np.ones((2, 3)), 0.5),
            VelocityHeightSetpoint.of(np.ones((2, 2)), -10.0, 0.5),
            AttitudeHeightSetpoint.of(np.ones(2), 0.2, -10.0, 0.5),
            AttitudeSetpoint.of(np.ones(2), 0.2, 0.5, 0.7),
            PathSetpoint.of(np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3)), 0.5),
            TrackSetpoint.line(np.ones((2, 3)), np.ones((2, 3))),
        ]
        given = [
            {"position_ned.x", "position_ned.y", "position_ned.z"},
            {"velocity_ned.x", "velocity_ned.y", "velocity_ned.z"},
            {"velocity_ned.x", "velocity_ned.y", "z"},
            {"roll", "pitch", "z"},
            {"roll", "pitch", "throttle"},
            {f"{name}_ned.{axis}" for name in ("position", "velocity") for axis in "xyz"},
        ]
        assert [type(kind) for kind in kinds] == list(SETPOINTS.values())
        # Lines and circles are no set-points of quadrotors.
        for kind, names in zip(kinds[:-1], given, strict=True):
            shown = OffboardSetpoint.of(cast(kind, F32))
            leaves, _ = jax.tree_util.tree_flatten_with_path(shown)
            finite = {jax.tree_util.keystr(path).lstrip(".") for path, leaf in leaves if np.all(np.isfinite(leaf))}
            assert finite == {*names, "yaw"}


class TestMaking:
    def test_from_arrays(self):
        estimate = Estimate.of(np.arange(6.0).reshape(2, 3), np.zeros((2, 3)), np.ones((2, 3)))
        np.testing.assert_array_equal(estimate.position_ned.y, [1.0, 4.0])
        np.testing.assert_array_equal(VelocityHeightSetpoint.of([[1, 2]], -3).velocity_east, [2.0])
        path = PathSetpoint.of([[1.0, 2.0, -3.0]] * 2, (4.0, 5.0, 6.0), yaw_rad=0.5)
        np.testing.assert_array_equal(path.velocity_ned.y, [5.0, 5.0])
        np.testing.assert_array_equal(path.acceleration_ned.z, [0.0, 0.0])
        np.testing.assert_array_equal(path.yaw, [0.5, 0.5])

    @pytest.mark.parametrize(
        ("make", "shape"),
        [
            (lambda: WaypointSetpoint.of(np.zeros((2, 2))), r"\(..., 3\), found shape \(2, 2\)"),
            (lambda: VelocityHeightSetpoint.of(np.zeros((2, 3)), -1.0), r"\(..., 2\), found shape \(2, 3\)"),
            (lambda: Estimate.of(0.0, np.zeros((1, 3)), np.zeros((1, 3))), r"\(..., 3\), found shape \(\)"),
        ],
    )
    def test_wrong_shapes(self, make: Any, shape: str):
        with pytest.raises(ValueError, match=shape):
            make()
