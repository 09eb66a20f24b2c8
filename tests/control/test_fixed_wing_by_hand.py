"""One step of a fixed wing's controller by hand.

L1 and total energy of docs/explanation/models/fixed_wing.md, W11 and W12.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from qrsim.control.fixed_wing import FixedWingController
from qrsim.control.setpoints import Estimate, TrackSetpoint
from qrsim.core.tree import replace
from qrsim.models.vehicles.fixed_wing import FixedWing

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
GRAVITY, DT = 9.81, 0.02
# At 10 m/s over ground, to what lies across: 4 0.75^2 (10 m/s)^2/L1 [m/s^2], where L1 = 12 s 0.75/pi 10 m/s = 28.6 m.
ACROSS = 225.0 / (12.0 * 0.75 / math.pi * 10.0)
# Of a circle: omega^2 and 2 0.75 omega, of a period of 12 s.
SPRING, DAMPER = (math.pi / 6.0) ** 2, 1.5 * math.pi / 6.0
SINE_20, COSINE_20 = math.sin(math.radians(20.0)), math.cos(math.radians(20.0))


class Case(NamedTuple):
    """An aeroplane, the line or circle that it keeps to, and its acceleration to the right.

    Attributes:
        wanted: [m/s^2].
        end, begin: north and east of the line or the centre [m]; without a begin straight to the end.
        radius: of the circle [m]; 0: a line.
        place: where it is [m].
        course: from north [deg].
        speed: over ground [m/s].
    """

    wanted: float
    end: tuple[float, float] = (0.0, 0.0)
    begin: tuple[float, float] | None = None
    radius: float = 0.0
    place: tuple[float, float] = (0.0, 0.0)
    course: float = 0.0
    speed: float = 10.0


RIGHT_30 = (50.0 * math.sqrt(3.0), 50.0)
CASES = {
    "from far it flies to a line at 45 deg": Case(-math.sqrt(0.5) * ACROSS, end=(1000.0, -900.0), begin=(0.0, -900.0)),
    "at rest its course is north, at 0.1 m/s": Case(0.5 * ACROSS / 100.0, end=RIGHT_30, speed=0.0),
    "to what is behind, on the right": Case(ACROSS, end=(-RIGHT_30[0], RIGHT_30[1])),
    "to what is behind, on the left": Case(-ACROSS, end=(-RIGHT_30[0], -RIGHT_30[1])),
    "along a line of 1.1 mm": Case(ACROSS, end=(0.0, 0.0011), begin=(0.0, 0.0), place=(0.0, 50.0)),
    "to the end of a line of 0.9 mm": Case(-ACROSS, end=(0.0, 0.0009), begin=(0.0, 0.0), place=(0.0, 50.0)),
    "at a place north is there": Case(0.0),
    "on a circle to the right": Case(100.0 / 150.0, radius=150.0, place=(0.0, -150.0)),
    "on a circle to the left": Case(-100.0 / 150.0, radius=-150.0, place=(0.0, 150.0)),
    "coming back to a circle": Case(
        SPRING * 5.0 - DAMPER * 10.0 * SINE_20 + (10.0 * COSINE_20) ** 2 / 155.0,
        radius=150.0,
        place=(0.0, -155.0),
        course=20.0,
    ),
    "deep inside a circle": Case(SPRING * -14.0 + 100.0 / 10.0, radius=20.0, place=(0.0, -6.0)),
    "no circle is smaller than 1 m": Case(SPRING * 4.0 + 25.0 / 5.0, radius=0.5, place=(0.0, -5.0), speed=5.0),
    "at the centre it is 1 cm away": Case(SPRING * (0.01 - 1.0), radius=1.0),
    "16 m outside, more than L1/2, to the centre": Case(ACROSS, radius=150.0, place=(0.0, -166.0), course=-30.0),
    "10 m outside, round the circle": Case(
        SPRING * 10.0 + DAMPER * 5.0 * math.sqrt(3.0) + 25.0 / 160.0,
        radius=150.0,
        place=(0.0, -160.0),
        course=-60.0,
    ),
}


def step(estimate: Estimate, track: TrackSetpoint, before: Any) -> Any:
    """State and command of a step, after one at an airspeed before."""
    controller = FixedWingController().fitted(FixedWing())
    state = replace(controller.init(estimate), airspeed=before)
    return controller.step(state, estimate, track, DT)


def roll(east: Any, over_east: Any, estimate: Estimate, track: TrackSetpoint) -> Any:
    """The roll that is asked for of who is somewhere east, and flies east so fast."""
    place, velocity = replace(estimate.position_ned, y=east), replace(estimate.velocity_ned, y=over_east)
    moved = replace(estimate, position_ned=place, velocity_ned=velocity)
    return step(moved, track, 0.0 * east)[1].roll


def flown(cases: list[Case]) -> tuple[Any, Any, Estimate, TrackSetpoint]:
    """What ``roll`` is given."""
    courses, speeds = (np.array([getattr(case, name) for case in cases]) for name in ("course", "speed"))
    zero = np.zeros(len(cases))

    def level(pairs: Any) -> Any:
        return np.column_stack([np.array(pairs), zero])

    velocity = level(np.column_stack([np.cos(np.radians(courses)), np.sin(np.radians(courses))]) * speeds[:, None])
    estimate = Estimate.of(level([case.place for case in cases]), velocity, np.zeros((len(cases), 3)))
    track = TrackSetpoint.line(level([case.begin or case.end for case in cases]), level([case.end for case in cases]))
    track = replace(track, radius=np.array([case.radius for case in cases]))
    return estimate.position_ned.y, estimate.velocity_ned.y, estimate, track


def test_accelerations_to_the_right() -> None:
    """W11; the roll is the arctangent of it by g, below 45 deg in every case."""
    with jax.enable_x64(True):
        found = np.asarray(jax.jit(roll, compiler_options=QUICK)(*flown([*CASES.values()])))
    for name, angle in zip(CASES, found, strict=True):
        assert GRAVITY * math.tan(angle) == pytest.approx(CASES[name].wanted, rel=1e-6, abs=1e-9), name


def test_slopes_where_there_is_no_direction() -> None:
    """They are finite: the arctangent's, of east by 1 m/s north at rest, and of east by 1 mm north at the place itself.

    The roll turns with that angle: at rest to a place 30 deg to the right, and 10 m/s north over the place.
    """
    with jax.enable_x64(True):
        slopes = jax.jit(jax.grad(lambda *given: roll(*given).sum(), (0, 1)), compiler_options=QUICK)
        cases = [CASES["at rest its course is north, at 0.1 m/s"], CASES["at a place north is there"]]
        by_place, by_speed = (np.asarray(slope) for slope in slopes(*flown(cases)))
    slow = ACROSS / 100.0 / GRAVITY
    assert by_speed[0] == pytest.approx(-slow * math.sqrt(0.75) / (1.0 + (0.5 * slow) ** 2), rel=1e-6)
    assert by_place[1] == pytest.approx(-1000.0 * ACROSS / GRAVITY, rel=1e-6)


def test_height_by_total_energy() -> None:
    """W12, level at 25 m/s, and 3 m and 7.5 m too low: a climb of 1 m/s and 2.5 m/s is wanted, 0.04 and 0.1 of 25 m/s.

    Throttle and pitch of level flight are those of the trim, within 1 %. The last one was 0.1 m/s slower before.
    """
    still, north = np.zeros((4, 3)), np.tile([25.0, 0.0, 0.0], (4, 1))
    begins = np.array([[0.0, 0.0, down] for down in (0.0, -3.0, -7.5, 0.0)])
    before = np.array([25.0, 25.0, 25.0, 24.9])
    with jax.enable_x64(True):
        estimate = replace(Estimate.of(still, north, still), airspeed=np.full(4, 25.0))
        track = TrackSetpoint.line(begins, begins + np.array([900.0, 0.0, 0.0]))
        state, asked = jax.device_get(jax.jit(step, compiler_options=QUICK)(estimate, track, before))
    assert asked.throttle[0] == pytest.approx(0.775341, rel=0.01)
    assert asked.pitch[0] == pytest.approx(0.052986, rel=0.01)
    assert asked.throttle[1] - asked.throttle[0] == pytest.approx((1.5 + 2.0) * 0.04)
    pitches = asked.pitch[:3] - asked.pitch[0]
    np.testing.assert_allclose(pitches, (0.8 + 0.4 + 0.3 * DT) * np.array([0.0, 0.04, 0.1]))
    # 0.78 and 3.5 times 0.1 are more than full throttle, for which nothing is integrated.
    assert asked.throttle[2] == 1.0
    np.testing.assert_allclose(state.energy_integral[:3], [0.0, DT * 0.04, 0.0], atol=1e-12)
    # 5 m/s^2, of which the filter of 0.5 s takes 0.02/0.52.
    np.testing.assert_allclose(state.acceleration, [0.0, 0.0, 0.0, 5.0 * 0.02 / 0.52], atol=1e-12)
