"""The multirotor against rotorpy, an independent simulator, on rotorpy's own Hummingbird.

Folk, Paulos and Kumar, "RotorPy: a Python-based multirotor simulator with aerodynamics", 2023; version 3.0.0, whose
integrator is asked for a relative error of 1e-11.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from tests.models.vehicles.multirotor.flying import Flown

from qrsim.core.quaternions import Quaternion
from qrsim.core.tree import replace
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.multirotor import MotorCommand
from qrsim.models.vehicles.multirotor.sets import SETS

# From north, east, down to north, west, up, and from forward, right, down to forward, left, up.
TURNED = np.diag([1.0, -1.0, -1.0])
# Of each of our rotors (front right, rear right, rear left, front left) its number there.
THERE = [1, 2, 3, 0]
SPEED_MAX, STEPS, STEP_S, HEIGHT = 1500.0, 250, 0.02, 2e4
HOVER = float(np.sqrt(0.5 * 9.81 / (4 * 5.57e-6)))
WIND = np.array([3.0, -2.0, 0.5])


def commanded(step: int) -> np.ndarray[Any, Any]:
    """Return speeds of the rotors [rad/s] that differ from rotor to rotor."""
    each = np.arange(4)
    return HOVER * (1.0 + 0.01 * np.sin(2.0 * np.pi * (0.7 + 0.2 * each) * STEP_S * step + each))


def matrix(w: float, x: float, y: float, z: float) -> np.ndarray[Any, Any]:
    """Return the rotation from body axes to the ground's."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.long
def test_five_seconds_of_rotor_commands_in_wind() -> None:
    reason = "needs rotorpy: pip install --no-deps rotorpy==3.0.0"
    theirs = pytest.importorskip("rotorpy.vehicles.multirotor", reason=reason)
    numbers = pytest.importorskip("rotorpy.vehicles.hummingbird_params", reason=reason).quad_params
    quaternion = np.array([0.98, 0.05, -0.03, 0.19])
    quaternion /= np.linalg.norm(quaternion)
    velocity, rates = np.array([1.0, 0.2, -0.1]), np.array([0.1, -0.2, 0.3])

    other = theirs.Multirotor(dict(numbers), integrator_kwargs={"method": "RK45", "rtol": 1e-11, "atol": 1e-12})
    w, x, y, z = quaternion
    state = {
        "x": TURNED @ np.array([0.0, 0.0, -HEIGHT]),
        "v": TURNED @ matrix(w, x, y, z) @ velocity,
        "q": np.array([x, -y, -z, w]),
        "w": TURNED @ rates,
        "wind": TURNED @ WIND,
        "rotor_speeds": np.full(4, HOVER),
    }

    # Its rotors follow within 5 ms up and down, it has no ground effect, as here at this height, and one density.
    own = replace(SETS["hummingbird"](), spin_up=0.005, spin_down=0.005, longest_substep=0.001, thin_air="ignored")
    flight = Flown(own, STEP_S, tuple(WIND))
    first = replace(
        flight.start((0.0, 0.0, -HEIGHT)),
        quaternion=Quaternion(*(np.array([part]) for part in quaternion)),
        velocity_body=Vec3(*(np.array([part]) for part in velocity)),
        rates_body=Vec3(*(np.array([part]) for part in rates)),
        rotor_speed=tuple(np.array([HOVER]) for _ in range(4)),
    )
    commands = [MotorCommand.of(commanded(step)[None] / SPEED_MAX) for step in range(STEPS)]
    for step, (found, _) in enumerate(flight.fly(first, commands)):
        asked = np.empty(4)
        asked[THERE] = commanded(step)
        state = other.step(state, {"cmd_motor_speeds": asked}, STEP_S)
        position, speed, turning = (
            np.concatenate(jax.tree.leaves(part))
            for part in (found.position_ned, found.velocity_body, found.rates_body)
        )
        turned = matrix(*(float(part[0]) for part in jax.tree.leaves(found.quaternion)))
        np.testing.assert_allclose(TURNED @ state["x"], position, rtol=0.0, atol=5e-8)
        np.testing.assert_allclose(TURNED @ state["v"], turned @ speed, rtol=0.0, atol=5e-8)
        np.testing.assert_allclose(TURNED @ state["w"], turning, rtol=0.0, atol=5e-8)
        np.testing.assert_allclose(state["rotor_speeds"][THERE], np.concatenate(found.rotor_speed), rtol=0.0, atol=1e-5)
