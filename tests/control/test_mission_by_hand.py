"""Single steps along missions by hand.

Ramps and polynomials, arrivals and landings of docs/explanation/models/control.md, C18 to C22.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import jax
import numpy as np

from qrsim.control import Mission, MissionGuidance, MissionState
from qrsim.control.mission import _ramp
from qrsim.control.paths import Leg, Limits, mission_of, plan
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
HOME = (0.0, 0.0, -20.0)


# Vehicles at a time, so that little is compiled.
N = 8


def planned(leg: Leg, **limits: Any) -> Mission:
    """The mission of vehicles that all fly the same leg from home."""
    own = Limits(**limits)
    mission: Mission = cast(mission_of([plan(HOME, [leg], own)] * N, [None] * N, own), np.dtype(np.float32))
    return mission


def filled(numbers: Any, dtype: type = np.float32) -> Any:
    """Numbers of the first vehicles, and the last one of all others."""
    return np.array([*numbers, *[numbers[-1]] * (N - len(numbers))], dtype)


def started(**own: Any) -> MissionState:
    """The state of vehicles that begin, but for what is given."""
    zero, count, no = np.zeros(N, np.float32), np.zeros(N, np.int32), np.zeros(N, bool)
    begin: Any = (count, count, zero, zero, count, count, no, no, count, zero, no, Vec3(zero, zero, zero), no)  # type: ignore[arg-type]
    return replace(MissionState(*begin), **own)


@cache
def _compiled(name: str) -> Any:
    functions: dict[str, Any] = {"setpoint": MissionGuidance().setpoint, "step": _step, "ramp": _ramp}
    return jax.jit(functions[name], compiler_options=QUICK)


def _step(state: MissionState, mission: Mission, place: Vec3, velocity: Vec3, stands: Any, dt: Any) -> Any:
    return MissionGuidance().step(state, mission, place, velocity_ned=velocity, dt=dt, on_ground=stands)


def due(mission: Mission, times: Any) -> Any:
    """What is asked for at times on the path, (N,)."""
    return _compiled("setpoint")(started(time=filled(times)), mission)


def after_step(mission: Mission, dt: float, down: Any, sinking: Any, stands: Any, **own: Any) -> MissionState:
    """The state (N,) after a step of vehicles north and east of home at 0, so far down, that sink so fast."""
    found: MissionState = stepped(mission, dt, down, sinking, stands, **own)[0]
    return found


def stepped(mission: Mission, dt: float, down: Any, sinking: Any, stands: Any, **own: Any) -> Any:
    """That state, and what is asked for (N,)."""
    zero: Any = np.zeros(N, np.float32)
    place, velocity = Vec3(zero, zero, filled(down)), Vec3(zero, zero, filled(sinking))
    return _compiled("step")(started(**own), mission, place, velocity, filled(stands, bool), dt)


def test_acceleration_along_a_ramp() -> None:
    """C18: 6 x (1 - x) d/T; from 0 to 5 m/s in 2.5 s, cruise for 5.5 s, and back."""
    found = due(planned(Leg((40.0, 0.0, -20.0))), [0.0, 0.625, 1.25, 4.0, 9.25])
    np.testing.assert_allclose(found.acceleration_ned.x[:5], [0.0, 2.25, 3.0, 0.0, -3.0], atol=1e-5)


def test_acceleration_along_a_polynomial() -> None:
    """Of 10 x^3 - 15 x^4 + 6 x^5 it is 60 x (1 - x) (1 - 2 x): at a quarter 5.625, of 40 m in 15 s."""
    found = due(planned(Leg((40.0, 0.0, -20.0)), quintic=True), [1.875, 3.75, 7.5, 11.25])
    wanted = [60.0 * 0.125 * 0.875 * 0.75 * 40.0 / 225.0, 1.0, 0.0, -1.0]
    np.testing.assert_allclose(found.acceleration_ned.x[:4], wanted, atol=1e-5)


def test_a_polynomial_of_no_length_stays_and_takes_a_microsecond() -> None:
    """At half of that a speed of 1 m/s in the mean is 30/16 m/s."""
    mission = planned(Leg(HOME), quintic=True)
    np.testing.assert_array_equal(due(mission, [0.0, 1.0]).position_ned.stack(), [HOME] * N)
    one: Any = np.ones((1, N), np.float32)
    found = due(replace(mission, direction=Vec3(one, 0.0 * one, 0.0 * one), peak=one), [5e-7, 2e-6])
    np.testing.assert_allclose(found.velocity_ned.x[:2], [1.875, 0.0], rtol=1e-5)


def test_a_ramp_in_no_time_takes_a_microsecond() -> None:
    """So that at half of that the speed is between, and at the end of it the other one."""
    one: Any = np.ones(3, np.float32)
    way, speed, _ = _compiled("ramp")(2.0 * one, 4.0 * one, 0.0 * one, np.array([0.0, 5e-7, 1e-6], np.float32))
    np.testing.assert_allclose(speed, [2.0, 3.0, 4.0], rtol=1e-5)
    np.testing.assert_array_equal(way, 0.0)


def test_a_leg_is_over_a_twentieth_of_a_step_before_the_end_of_its_path() -> None:
    """A vehicle 6 m above an end that counts from 10 m on: the path waits at what is left of it, in steps of 1 s."""
    mission = planned(Leg((0.0, 0.0, -10.0), accept_radius=10.0, stop=True))
    # 10 m down at 1.5 m/s, and of each of two ramps of sqrt(6 1.5/8) s half.
    ends = 10.0 / 1.5 + math.sqrt(1.125)
    times = filled([ends - 0.045, ends - 0.055, ends])
    found = after_step(mission, 1.0, [-16.0], [0.0, 0.0, 0.6], [False], time=times)
    np.testing.assert_array_equal(found.arrived[:3], [True, False, False])


def test_who_stands_for_as_long_as_it_settles_has_landed() -> None:
    """1 s in steps of 0.25 s: in the fourth, and not in the third."""
    mission, waited = planned(Leg((0.0, 0.0, 0.0), "land")), filled([2, 3, 3], np.int32)
    found = after_step(mission, 0.25, [0.0], [0.0], [True, True, False], time=filled([40.0]), waited=waited)
    np.testing.assert_array_equal(found.arrived[:3], [False, True, False])


def test_who_is_above_what_is_due_and_does_not_sink_is_held_by_the_ground() -> None:
    """C21: 0.6 m above, not faster than 0.25 m/s; 1.2 m above, than 1 m/s."""
    cases = [(0.55, 0.0, 0), (0.65, 0.2, 1), (0.65, 0.3, 0), (1.15, 0.5, 0), (1.25, 0.5, 1), (1.25, 0.9, 1)]
    cases += [(1.25, 1.1, 0), (1.25, -0.9, 1)]
    above, sinking, held = np.array(cases).T
    found = after_step(planned(Leg((0.0, 0.0, 0.0), "land")), 0.25, -20.0 - above, sinking, [False])
    np.testing.assert_array_equal(found.waited, held)


def test_who_may_have_a_foot_on_the_ground_is_kept_level() -> None:
    """C21: 0.2 m above, not faster than 0.25 m/s, 3 s after the ramp to 0.7 m/s; or standing. Not on other legs."""
    cases = [(0.15, 0.0, 5.0, 0, 0), (0.25, 0.2, 5.0, 0, 1), (0.25, -0.2, 5.0, 0, 1), (0.25, 0.3, 5.0, 0, 0)]
    # The ramp takes sqrt(6 0.7 / 8) = 0.725 s.
    cases += [(0.25, 0.2, 3.7, 0, 0), (0.25, 0.2, 3.75, 0, 1), (0.25, 0.2, 1.0, 0, 0), (0.0, 0.0, 1.0, 1, 1)]
    above, sinking, times, stands, level = np.array(cases).T
    legs = [planned(Leg((0.0, 0.0, -20.0 + down), kind)) for down, kind in ((6.0, "land"), (6.0, "line"))]
    due_down = due(legs[0], times).position_ned.z
    asked = [stepped(leg, 0.02, due_down - above, sinking, stands, time=filled(times))[1] for leg in legs]
    np.testing.assert_array_equal(asked[0].level, level)
    assert not np.any(asked[1].level)
    assert not np.any(asked[0].idle)


def test_what_is_less_than_a_micrometre_beside_the_path_comes_back_by_its_part() -> None:
    """In no time, in which a path that is further away stays where it is."""
    mission, aside = planned(Leg((40.0, 0.0, -20.0))), filled([5e-7, 4.0])
    found = after_step(mission, 0.0, [-20.0], [0.0], [False], shift_ned=Vec3(aside, 0.0 * aside, 0.0 * aside))
    np.testing.assert_allclose(found.shift_ned.x[:2], [2.5e-7, 4.0], rtol=1e-5)
