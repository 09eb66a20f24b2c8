"""Missions: the path of every leg, what waits for a vehicle, and what counts as reached."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control import Mission, MissionGuidance
from qrsim.control.paths import Leg, Limits, corner_speed, flown_seconds, mission_of, plan
from qrsim.core.tree import cast, replace
from qrsim.core.vectors import Vec3

DT, SECONDS = 0.05, 120.0
LIMITS = Limits()
START = (0.0, 0.0, -20.0)
SQUARE = tuple(
    Leg(place, number=i + 1) for i, place in enumerate([(40, 0, -20), (40, 40, -20), (0, 40, -20), (0, 0, -20)])
)
ALONG = math.nan
Floats = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Case:
    """Legs, and what the vehicle does that is led along them: it is where it is led to but for what stands here.

    Attributes:
        beside: how far west of it, before and after ``change`` [m].
        speed: its speed, before and after ``change``; ALONG: that of the path.
        stands: it never moves.
        ground: down coordinate that it does not pass, and from which on it stands on the ground.
        bounces: it leaves the ground for 0.15 s in 0.8 s, at 1 m/s.
        hangs: it does not move up or down, and stands on the ground only from 60 s on.
        again: index of the leg after the last.
        aside: where it believes it stands until it is led 0.05 m above that; None: it begins in the air.
    """

    legs: tuple[Leg, ...]
    beside: tuple[float, float] = (0.0, 0.0)
    speed: tuple[float, float] = (ALONG, ALONG)
    change: float = 20.0
    stands: bool = False
    ground: float = 1e6
    bounces: bool = False
    hangs: bool = False
    again: int | None = None
    aside: tuple[float, float, float] | None = None


LANDING = (Leg((0, 0, -30), stop=True), Leg((0, 0, 0), "land", hold=2.0), Leg((0, 0, -10), stop=True, number=3))
HOLDS = (Leg((10, 0, -20), hold=3.0, stop=True), Leg((20, 0, -20)))
NEAR = (Leg((10, 0, -20), stop=True, accept_radius=1.25),)
CASES = {
    "laps": Case(SQUARE + SQUARE, again=4),
    "circle": Case(
        (
            Leg((40, 0, -20), stop=True),
            Leg((40, 0, -20), "circle", speed=9.0, centre_ned=(50, 0), angle=-4.0 * math.pi),
        )
    ),
    "headings": Case(
        (
            Leg((0, 10, -20), stop=True),
            Leg((0, 10, -25), stop=True),
            Leg((0, 20, -25), yaw=0.3, stop=True),
            Leg((10, 20, -25), facing_ned=(10.0, 120.0)),
        )
    ),
    "left behind": Case((Leg((400, 0, -20)),), stands=True),
    "beside a corner": Case(SQUARE, beside=(2.6, 1.0)),
    "too fast": Case(HOLDS, speed=(0.6, 0.4)),
    "too far": Case(NEAR, beside=(1.4, 1.4)),
    "near enough": Case(NEAR, beside=(1.1, 1.1)),
    "lands": Case(LANDING, ground=1.0),
    "bounces": Case(LANDING, ground=0.0, bounces=True),
    "hangs": Case(LANDING, ground=0.0, hangs=True),
    "believes": Case((Leg((0, 0, -30), stop=True), Leg((60, 0, -30), stop=True)), aside=(-8.0, 6.0, -20.4)),
}


def fly(legs: Mission, cases: list[Case], dt: float, **own: Any) -> Any:
    """Fly what cases say; return states and set-points (T, n)."""
    guidance = MissionGuidance(**own)
    like = legs.yaw[0]

    def each(pick: Any) -> Any:
        return np.array([pick(case) for case in cases], like.dtype)

    def tick(carry: Any, time: Any) -> Any:
        state, asked = carry
        late = time >= each(lambda case: case.change)
        off = jnp.where(late, each(lambda case: case.beside[1]), each(lambda case: case.beside[0]))
        place, ground = asked.position_ned - Vec3(0.0 * off, off, 0.0 * off), each(lambda case: case.ground)
        up = jnp.where((time % 0.8 < 0.15) & (each(lambda case: case.bounces) > 0), 0.2, 0.0)
        place = Vec3(place.x, place.y, jnp.minimum(place.z, ground) - up)
        rests = each(lambda case: case.stands) > 0
        place = Vec3(*(jnp.where(rests, a, b) for a, b in zip(START, (place.x, place.y, place.z), strict=True)))
        speed = jnp.where(late, each(lambda case: case.speed[1]), each(lambda case: case.speed[0]))
        own = jnp.where(jnp.isnan(speed), asked.velocity_ned.x, speed)
        low = (each(lambda case: case.bounces) > 0) & (place.z > -5.0)
        sinks = jnp.where(low, 1.0, asked.velocity_ned.z)
        sinks = jnp.where(each(lambda case: case.hangs) > 0, 0.0, sinks)
        velocity = Vec3(own, asked.velocity_ned.y, sinks)
        stands = (place.z >= ground) & ((time >= 60.0) | ~(each(lambda case: case.hangs) > 0))
        aside = [each(lambda case, axis=axis: case.aside[axis] if case.aside else math.nan) for axis in range(3)]
        waits = (state.index == 0) & (asked.position_ned.z > aside[2] - 0.05)
        place = Vec3(*(jnp.where(waits, a, b) for a, b in zip(aside, (place.x, place.y, place.z), strict=True)))
        now = guidance.step(state, legs, place, velocity_ned=velocity, dt=dt, on_ground=stands | waits)
        return now, now

    state = guidance.init(legs)
    times = dt * jnp.arange(round(SECONDS / dt), dtype=like.dtype)
    return jax.jit(partial(jax.lax.scan, tick))((state, guidance.setpoint(state, legs)), times)[1]


@dataclass(frozen=True)
class Flown:
    """What happened to one vehicle, (T,) and (T, 3)."""

    states: Any
    asked: Any
    vehicle: int

    def rows(self, name: str) -> Floats:
        """Return a vector of the set-point."""
        return np.asarray(getattr(self.asked, f"{name}_ned").stack())[:, self.vehicle]

    def of(self, name: str) -> Floats:
        """Return a number of the state, or of the set-point."""
        owner = self.states if hasattr(self.states, name) else self.asked
        return np.asarray(getattr(owner, name))[:, self.vehicle]

    def first(self, name: str, least: float = 1) -> float:
        """Return when a number first is so large [s]."""
        return float(np.argmax(self.of(name) >= least) * DT)


@pytest.fixture(scope="module")
def flown() -> dict[str, Flown]:
    cases = list(CASES.values())
    plans = [plan(START, case.legs, LIMITS, case.again) for case in cases]
    missions = cast(mission_of(plans, [case.again for case in cases], LIMITS), np.dtype(np.float32))
    states, asked = jax.device_get(fly(missions, cases, DT))
    return {name: Flown(states, asked, i) for i, name in enumerate(CASES)}


WAYS = (
    SQUARE,
    tuple(Leg((2.0 * i, (-1.0) ** i, -20.0 - 0.5 * i), speed=9.0) for i in range(1, 12)),
    (Leg((30, 0, -20)), Leg((0, 0, -20), speed=2.0), Leg((0, 0, -50), speed=8.0), Leg(START)),
    (Leg((10, 0, -20)), Leg((20, 0, -20), speed=2.0), Leg((21, 0, -20)), Leg((60, 0, -20))),
    (Leg((8, 8, -20), stop=True), Leg((8, 8, -20), hold=1.0), Leg((0, 16, -25), hold=0.5)),
)


class TestPath:
    """What a vehicle that follows exactly is led along."""

    def test_it_keeps_speed_acceleration_and_jerk_and_passes_every_corner(self) -> None:
        dt = 0.01
        with jax.enable_x64(True):
            plans = [plan(START, legs, LIMITS) for legs in WAYS]
            missions = cast(mission_of(plans, [None] * 5, LIMITS), np.dtype(np.float64))
            states, asked = jax.device_get(fly(missions, [Case(legs) for legs in WAYS], dt))
        assert states.finished[-1].all()
        for i, legs in enumerate(WAYS):
            one = Flown(states, asked, i)
            assert one.of("reached")[-1] == len(legs)
            place, velocity, force = (one.rows(name) for name in ("position", "velocity", "acceleration"))
            assert np.abs(np.diff(place, axis=0) / dt - 0.5 * (velocity[1:] + velocity[:-1])).max() < 1e-3
            assert np.linalg.norm(velocity, axis=1).max() <= max(leg.speed for leg in legs) + 1e-9
            assert velocity[:, 2].min() >= -3.0 - 1e-9
            assert velocity[:, 2].max() <= 1.5 + 1e-9
            assert np.linalg.norm(force, axis=1).max() <= 3.0 + 1e-6
            assert np.linalg.norm(np.diff(force, axis=0), axis=1).max() / dt <= 8.0 + 1e-6
            for leg in legs:
                assert np.linalg.norm(place - leg.position_ned, axis=1).min() <= 0.375 * 2.0 + 1e-3
            assert np.linalg.norm(place[-1] - legs[-1].position_ned) < 1e-9

    def test_speed_through_a_right_angle(self) -> None:
        """By hand: sqrt(3 m/s2 2 m / (1.5 sin 45)) = 2.378 m/s, and cbrt(8 m/s3 (2 m)^2 / (3 sin 45)) = 2.471 m/s."""
        assert corner_speed(2.0, math.pi / 2, LIMITS) == pytest.approx(2.378, abs=5e-4)
        assert corner_speed(2.0, math.pi / 2, Limits(acceleration=30.0)) == pytest.approx(2.471, abs=5e-4)
        assert corner_speed(2.0, 0.0, LIMITS) == math.inf
        assert [part.leave for part in plan(START, SQUARE, LIMITS)] == pytest.approx([2.378] * 3 + [0.0], abs=5e-4)

    def test_a_polynomial_takes_forty_metres_in_fifteen_seconds(self) -> None:
        limits = Limits(quintic=True)
        (part,) = parts = plan(START, [Leg((40, 0, -20))], limits)
        assert flown_seconds(part) == pytest.approx(15.0)
        guidance, legs = MissionGuidance(path="quintic"), cast(mission_of([parts], [None], limits), np.float32)
        state = guidance.init(legs)
        # Of 10 x^3 - 15 x^4 + 6 x^5 at a quarter and a half, and its slope there.
        for time, way, speed in ((3.75, 4.140625, 2.8125), (7.5, 20.0, 5.0), (15.0, 40.0, 0.0), (99.0, 40.0, 0.0)):
            due = guidance.setpoint(_at(state, time), legs)
            assert float(due.position_ned.x[0]) == pytest.approx(way, abs=1e-4)
            assert float(due.velocity_ned.x[0]) == pytest.approx(speed, abs=1e-4)

    def test_round_and_round(self, flown: dict[str, Flown]) -> None:
        """From the second time on the first leg begins at the last place, at the speed of that corner."""
        one = flown["laps"]
        assert not one.of("finished").any()
        assert np.linalg.norm(np.diff(one.rows("velocity"), axis=0), axis=1).max() / DT <= 3.0 + 1e-2
        laps = np.flatnonzero(np.diff(one.of("index")) < 0) * DT
        # Four turns of 4 m at 2.378 m/s, and four sides: two ramps of 1.403 s at 3.689 m/s in the mean, the rest at 5.
        assert np.diff(laps) == pytest.approx(4 * (4 / 2.378 + 2 * 1.4025 + (36 - 2 * 1.4025 * 3.689) / 5), abs=0.06)
        assert len(laps) == 2
        assert one.of("reached")[-1] == 12

    def test_circle(self, flown: dict[str, Flown]) -> None:
        """Two turns the other way, at 10 m round (50, 0); faster than 3 m/s2 allows is not flown."""
        one = flown["circle"]
        assert one.of("finished")[-1]
        on_it = np.flatnonzero(one.of("index") == 1)[5:]
        arm = one.rows("position")[on_it, :2] - (50.0, 0.0)
        assert np.linalg.norm(arm, axis=1) == pytest.approx(10.0, abs=1e-3)
        turned = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
        assert turned[-1] - turned[0] == pytest.approx(-4.0 * math.pi, abs=2e-2)
        velocity = one.rows("velocity")[on_it]
        speed = np.linalg.norm(velocity, axis=1)
        assert speed.max() == pytest.approx(math.sqrt(30.0), abs=1e-3)
        fast = speed > 5.4
        assert np.linalg.norm(one.rows("acceleration")[on_it[fast]], axis=1) == pytest.approx(3.0, rel=3e-2)
        along = np.arctan2(velocity[fast, 1], velocity[fast, 0])
        assert np.cos(one.of("yaw")[on_it[fast]] - along) == pytest.approx(1.0, abs=1e-4)

    def test_headings(self, flown: dict[str, Flown]) -> None:
        """Along the way, kept on the way up; a given one; and towards a place."""
        index, yaw = flown["headings"].of("index")[:-1], flown["headings"].of("yaw")[1:]
        for number, expected in ((0, math.pi / 2), (1, math.pi / 2), (2, 0.3)):
            assert yaw[index == number] == pytest.approx(expected, abs=1e-6)
        facing = yaw[index == 3]
        assert facing[0] == pytest.approx(math.atan2(100.0, 10.0), abs=1e-3)
        assert facing[-1] == pytest.approx(math.pi / 2, abs=1e-3)


def _at(state: Any, time: float) -> Any:
    """Return a state at a time on the path of its leg."""
    return replace(state, time=jnp.full_like(state.time, time))


class TestWaiting:
    """What a vehicle that falls behind, or does not do what it is to do, is led along."""

    def test_the_path_does_not_run_away(self, flown: dict[str, Flown]) -> None:
        """It slows from 2 m on and stands before 5 m; alone it would be 400 m away."""
        one = flown["left behind"]
        ahead = one.rows("position")[:, 0]
        assert 4.0 < ahead[-1] < 5.0
        assert abs(one.rows("velocity")[-1, 0]) < 0.05
        assert one.of("behind")[-1] == pytest.approx(ahead[-1], abs=0.01)
        # Half-way between 2 and 5 m it goes at half the speed of the ramp of 2.5 s to 5 m/s.
        half = np.argmax(ahead > 3.5)
        x = min(one.of("time")[half - 1] / 2.5, 1.0)
        assert one.rows("velocity")[half, 0] == pytest.approx(0.5 * 5.0 * x * x * (3.0 - 2.0 * x), abs=0.1)

    def test_it_is_told_once_that_a_leg_takes_too_long(self, flown: dict[str, Flown]) -> None:
        """Planned 82.5 s: 80 s for 400 m at 5 m/s, and 1.25 s lost on each of two ramps of 2.5 s; and 30 s on top."""
        one = flown["left behind"]
        assert one.of("late")[-1] == 1
        assert one.first("late") == pytest.approx(82.5 + 30.0, abs=0.1)
        assert one.of("index")[-1] == 0

    def test_a_corner_waits_half_way_for_who_has_not_come_near(self, flown: dict[str, Flown]) -> None:
        """A vehicle 2.6 m beside the path is let on once it is 1 m beside it; half-way is 0.375 m off on each side."""
        one = flown["beside a corner"]
        index, time = one.of("index"), np.arange(len(one.of("index"))) * DT
        waits = (time > 15.0) & (time < 20.0)
        assert (index[waits] == 0).all()
        assert one.rows("position")[waits][:, :2] == pytest.approx(np.array([[39.625, 0.375]] * waits.sum()), abs=0.01)
        assert one.first("index") == pytest.approx(20.0 + 0.5 * 4.0 / 2.378, abs=0.1)
        assert one.of("finished")[-1]

    def test_reached_means_near_and_slow_where_a_leg_stops(self, flown: dict[str, Flown]) -> None:
        """At 0.6 m/s nothing is reached, at 0.4 m/s it is; then comes the hold."""
        assert flown["too fast"].first("reached") == pytest.approx(20.0, abs=0.1)
        assert flown["too fast"].first("index") == pytest.approx(23.0, abs=0.1)

    def test_near_is_the_accept_radius(self, flown: dict[str, Flown]) -> None:
        assert not flown["too far"].of("finished")[-1]
        assert flown["near enough"].of("finished")[-1]


class TestLanding:
    """Down to the ground, and up again."""

    def test_quick_then_slow_then_idle_then_up(self, flown: dict[str, Flown]) -> None:
        """The ground is 1 m lower than the mission believes."""
        one = flown["lands"]
        assert one.of("finished")[-1]
        index, down, sink = one.of("index"), one.rows("position")[:, 2], one.rows("velocity")[:, 2]
        comes = index == 1
        assert sink[comes & (down < -12.0)].max() == pytest.approx(1.5, abs=1e-3)
        assert sink[comes & (down > -10.0) & (down < 1.0)] == pytest.approx(0.7, abs=1e-3)
        touches = np.argmax(comes & (down >= 1.0))
        idle = np.flatnonzero(one.of("idle"))
        # After half a second on the ground its motors idle; it has landed after a second, and stays for two more.
        assert (idle[0] - touches) * DT == pytest.approx(0.5, abs=0.11)
        assert (idle[-1] - idle[0]) * DT == pytest.approx(2.5, abs=0.11)
        assert down[idle].max() < 1.0 + 5.0
        assert np.argmax(index == 2) == idle[-1]

    def test_who_is_held_by_the_ground_idles_until_it_stands(self, flown: dict[str, Flown]) -> None:
        """At 0.7 m/s the point that is due is 0.6 m below after 0.86 s, and half a second later motors idle."""
        one = flown["hangs"]
        idle = np.flatnonzero(one.of("idle"))
        comes = (one.of("index") == 1) & (one.rows("position")[:, 2] > 0.0)
        assert (idle[0] - np.argmax(comes)) * DT == pytest.approx(0.6 / 0.7 + 0.5, abs=0.08)
        assert one.of("index")[round(59.0 / DT)] == 1
        assert np.argmax(one.of("index") == 2) * DT == pytest.approx(62.0, abs=0.15)

    def test_a_bounce_does_not_count(self, flown: dict[str, Flown]) -> None:
        assert flown["bounces"].of("index")[-1] == 1


def test_who_stands_elsewhere_than_planned_goes_straight_up_from_there_and_joins_the_path(
    flown: dict[str, Flown],
) -> None:
    """It believes it stands 10 m beside the start and 0.4 m higher; then the two paths close by 1 m/s."""
    one = flown["believes"]
    place, motion, index = one.rows("position"), one.rows("velocity"), one.of("index")
    assert np.abs(place[index == 0][:-1, :2] - (-8.0, 6.0)).max() < 1e-4
    assert np.abs(motion[index == 0][:, :2]).max() < 1e-6
    low = one.of("low")
    # It is kept upright until it has risen by half a metre.
    lifted = int(np.argmin(low))
    assert low[:lifted].all()
    assert 0.5 <= -20.4 - place[lifted - 1, 2] < 0.58
    # Its own height of arrival is as much above its start as was planned.
    turns = int(np.argmax(index == 1))
    assert place[turns - 1] == pytest.approx((-8.0, 6.0, -30.4), abs=0.01)
    assert place[turns + round(4.0 / DT), 1] == pytest.approx(6.0 * (1.0 - 4.0 / 10.008), abs=0.05)
    assert place[-1] == pytest.approx((60.0, 0.0, -30.0), abs=1e-3)
    assert one.of("reached")[-1] == 2
    assert one.of("finished")[-1]
