"""Numbers of the rovers at an instant.

Against the equations (D1) to (D6) of docs/explanation/models/rover.md by hand.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.models.by_hand import many

from qrsim.core.tree import cast
from qrsim.core.vectors import Euler, Vec3
from qrsim.models.vehicles.rover.ackermann import Rover, RoverState
from qrsim.models.vehicles.rover.commands import SteeringCommand, WheelCommand
from qrsim.models.vehicles.rover.differential import DifferentialRover, DifferentialRoverState
from qrsim.models.vehicles.rover.planar import ground_of

# So short a step that what changes in it, over it, is the slope.
DT = 1e-7
# Half the weight of 4 kg on each axle [N], times the friction of 0.7; the stiffness C over it.
MOST, STIFFNESS = 0.7 * 0.5 * 4.0 * 9.81, 10.0 / 0.7


pytestmark = pytest.mark.usefixtures("double_precision")


def still(count: int) -> Vec3:
    zero = jnp.zeros(count)
    return Vec3(zero, zero, zero)


def tyres(v: float, vy: float, r: float, delta: float) -> tuple[float, float]:
    """Return v_y' and r' of (D2) and (D3) at a speed that the slip angles are of already."""
    front = MOST * math.tanh(STIFFNESS * (delta - math.atan((vy + 0.165 * r) / v)))
    rear = MOST * math.tanh(STIFFNESS * -math.atan((vy - 0.165 * r) / v))
    return (front * math.cos(delta) + rear) / 4.0, (0.165 * front * math.cos(delta) - 0.165 * rear) / 0.06


def bicycle(v: float, vy: float, r: float, delta: float) -> tuple[float, float]:
    """Return v_y' and r' of (D4): both settle in 0.05 s at those of the kinematic bicycle."""
    turn = v * math.tan(delta) / 0.33
    return (0.165 * turn - vy) / 0.05, (turn - r) / 0.05


def test_cornering_of_a_steered_rover() -> None:
    """Below 0.5 m/s the bicycle, from 1.5 m/s on the tyres, half of each at 1 m/s; the same backwards.

    The slip angles are those of at least 1 m/s: at 0.8 m/s, three tenths of the way, of 1 m/s.
    """
    vy, r, delta = 0.02, 0.3, 0.1
    speeds = (0.4, 0.5, 0.8, 1.0, 1.5, 3.0, -0.4, -2.0)
    shares = (0.0, 0.0, 0.3, 0.5, 1.0, 1.0, 0.0, 1.0)
    n = len(speeds)
    same = many(*[1.0] * n)
    model: Any = cast(Rover(), np.float64)
    flat = still(n)
    state = RoverState(flat, Euler(*flat.axes), many(*speeds), vy * same, r * same, delta * same)
    command = SteeringCommand(delta * same, many(*speeds))
    after, force = jax.jit(lambda state: model.step(state, command, lambda trig: flat, None, DT))(state)
    side, swing = [], []
    for v, share in zip(speeds, shares, strict=True):
        fast = tyres(math.copysign(max(abs(v), 1.0), v), vy, r, delta)
        slow = bicycle(v, vy, r, delta)
        side.append(share * (fast[0] - v * r) + (1.0 - share) * slow[0])
        swing.append(share * fast[1] + (1.0 - share) * slow[1])
    np.testing.assert_allclose((after.slip_speed - vy) / DT, side, rtol=1e-4)
    np.testing.assert_allclose((after.yaw_rate - r) / DT, swing, rtol=1e-4)
    np.testing.assert_allclose(force.x, -r * vy, atol=1e-5)
    np.testing.assert_allclose(force.y, np.array(side) + np.array(speeds) * r, rtol=1e-4)
    # On ground that is level at 0 m it neither leans nor sinks.
    assert np.asarray(after.attitude.roll).tolist() == np.asarray(after.attitude.pitch).tolist() == [0.0] * n
    np.testing.assert_allclose(force.z, -9.81, rtol=1e-12)


def test_what_a_steered_rover_declares() -> None:
    """The preset r1 as in the docs: 10 kg, 0.35 m between the axles and 3 m/s; inertia 0.169 kg m^2."""
    found: Any = Rover(preset="r1")
    assert [found.mass, found.front_arm, found.rear_arm, found.yaw_inertia, found.speed_max] == [
        10.0,
        0.175,
        0.175,
        0.169,
        3.0,
    ]
    limits = {"pitch": 1.5707963267948966, "velocity": 30.0, "rate": 20.0}
    assert dict(Rover.default_limits) == dict(DifferentialRover.default_limits) == limits


@pytest.mark.long
def test_two_sides() -> None:
    """(D5): 2 and 1 m/s are 1.5 m/s and 0.7/0.4 = 1.75 rad/s; 5 m/s to the side are more than 0.7 g at 3 m/s."""
    model: Any = cast(DifferentialRover(), np.float64)
    flat = still(3)
    state = DifferentialRoverState(flat, Euler(*flat.axes), many(2.0, 3.0, -2.0), many(1.0, 1.0, -2.5))
    pose = model.pose(state)
    np.testing.assert_allclose(pose.velocity_body.x, [1.5, 2.0, -2.25], rtol=1e-12)
    np.testing.assert_allclose(pose.rates_body.z, [1.75, 6.867 / 2.0, 0.875], rtol=1e-12)
    # Left gains 2.5 m/s^2, right loses 4 m/s^2, which is all it can: -0.75 m/s^2 ahead; v r to the side.
    command = WheelCommand(many(3.0, 3.0, -2.0), many(-2.0, 1.0, -2.5))
    after, force = jax.jit(lambda state: model.step(state, command, lambda trig: flat, None, DT))(state)
    np.testing.assert_allclose((after.left - state.left) / DT, [2.5, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose((after.right - state.right) / DT, [-4.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(force.x, [-0.75, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(force.y, [1.5 * 1.75, 6.867, -2.25 * 0.875], rtol=1e-5)


def test_grip_of_two_sides_that_stand() -> None:
    """Nothing that turns on the spot needs grip; it counts as 1 mm/s, so that 0.7 g allow 6867 rad/s."""
    model: Any = cast(DifferentialRover(track=1e-4, slip=0.0), np.float64)  # type: ignore[arg-type]
    flat = still(1)
    found = model.pose(DifferentialRoverState(flat, Euler(*flat.axes), many(3.0), many(-3.0)))
    np.testing.assert_allclose(found.rates_body.z, 6867.0, rtol=1e-9)


def test_commands_of_two_sides() -> None:
    """On a curvature k the sides run at v (1 +- 0.4/2/0.7 k), none faster than 3 m/s; so it starts as well."""
    model: Any = cast(DifferentialRover(), np.float64)
    found = model.drive(many(1.4, 5.0, -5.0), many(0.5, 3.5, -3.5))
    # 0.2/0.7 x 3.5 = 1: the inner side stands, the outer one runs at 3 m/s.
    np.testing.assert_allclose(found.left, [1.6, 3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.right, [1.2, 0.0, -3.0], atol=1e-12)
    flat = still(1)
    start = model.initial_state(
        flat, Euler(*flat.axes), Vec3(many(1.0), *flat.axes[1:]), Vec3(*flat.axes[:2], many(0.7))
    )
    np.testing.assert_allclose([start.left[0], start.right[0]], [1.2, 0.8], atol=1e-12)


def test_ground_without_surroundings_is_level_at_no_height() -> None:
    down, normal = ground_of(None, jnp.zeros(2))(still(2))
    assert [np.asarray(part).tolist() for part in (down, *normal.axes)] == [[0.0, 0.0]] * 3 + [[-1.0, -1.0]]
