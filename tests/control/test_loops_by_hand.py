"""Single steps of loops, of the cascade and of those who flee.

By hand from docs/explanation/models/control.md and docs/explanation/task_design.md.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import numpy as np
import pytest

from qrsim.control.cascade import CascadeController, CascadeState
from qrsim.control.flee import FleeGuidance
from qrsim.control.guidance import Route
from qrsim.control.loops import HeightLoop, VelocityLoop
from qrsim.control.setpoints import Estimate, VelocitySetpoint
from qrsim.core.vectors import Vec3
from qrsim.models.vehicles.contracts import Handling

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}


class Round:
    """2 kg at 10 m/s^2, at most 40 N at full throttle, in proportion; three quarters of a tilt command are flown."""

    command_type: ClassVar[type[Any]] = dict

    def handling(self) -> Handling:
        curve: Any = (0.0, 40.0, 0.0)
        answers: Any = {"tilt_gain": 0.75, "yaw_rate_gain": 1.0, "tilt_max": 0.9}
        return Handling(2.0, 10.0, 40.0, curve, **answers)  # type: ignore[arg-type]

    def tilt_command(self, pitch: Any, roll: Any, throttle: Any, yaw_rate: Any) -> Any:
        return pitch, roll, throttle


def vec(*axes: float) -> Vec3:
    return Vec3(*(np.array([axis]) for axis in axes))  # type: ignore[arg-type]


def _climb(state: CascadeState) -> Any:
    controller = CascadeController(nominal=Round(), thrust_fraction=1.0)  # type: ignore[arg-type]
    still = np.zeros((1, 3))
    wanted = VelocitySetpoint.of(np.array([[8.0, 0.0, -3.0]]))
    return controller.step(state, Estimate.of(still, still, still), wanted, 0.02)


def test_at_full_thrust_half_a_metre_per_second_squared_is_left_to_lean_with() -> None:
    """Up at 3 m/s takes 4 * 3 + 10 of the 20 m/s^2 there are; of 2.2 * 8 to the north 0.5 are left, at 0.75 (C12).

    The state is one that has not run, as saved ones have it: 1e9 m/s for a velocity, from which nothing is derived.
    """
    none, never = vec(0.0, 0.0, 0.0), vec(1e9, 1e9, 1e9)
    with jax.enable_x64(True):
        state, found = jax.jit(_climb, compiler_options=QUICK)(CascadeState(none, never, none))
    pitch, roll, throttle = (float(value[0]) for value in found)
    assert (pitch, roll, throttle) == pytest.approx((-math.atan(0.5 / 20.0) / 0.75, 0.0, 1.0), abs=1e-9)
    assert [float(axis[0]) for axis in state.acceleration.axes] == [0.0, 0.0, 0.0]


def test_loops_begin_with_a_set_point_that_is_never_asked_for() -> None:
    """1e9, as saved states have it, so that the first set-point is a new one and shows as no spike."""
    zero: Any = np.zeros(1, np.float32)
    assert float(HeightLoop().init(zero).z_wanted[0]) == 1e9
    assert [float(axis[0]) for axis in VelocityLoop().init(zero).wanted_ned.axes] == [1e9] * 3


def test_it_flees_from_the_nearer_one_more() -> None:
    """2 m south and 4 m west of pursuers: (-1/2, -1/4) of d/|d|^2, and (-2, -1)/sqrt(5) of 3 m/s."""
    count: Any = np.ones(1, np.int32)
    route = Route(Vec3(*np.zeros((3, 1, 1))), np.zeros((1, 1)), count)  # type: ignore[arg-type]
    others = Vec3(np.array([2.0, 0.0]), np.array([0.0, 4.0]), np.zeros(2))  # type: ignore[arg-type]

    def wanted(speed: Any, others: Vec3) -> Any:
        guidance = FleeGuidance(speed=speed)
        return guidance.step(guidance.init(route), route, vec(0.0, 0.0, 0.0), others)[1]

    with jax.enable_x64(True):
        found = jax.jit(wanted, compiler_options=QUICK)(3.0, others)
    velocity = float(found.velocity_north[0]), float(found.velocity_east[0])
    assert velocity == pytest.approx((-6.0 / math.sqrt(5.0), -3.0 / math.sqrt(5.0)))
