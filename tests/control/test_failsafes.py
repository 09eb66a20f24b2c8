"""Decisions of failsafes, with PX4's numbers, for Python's numbers and arrays alike; and the state they lead to."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.control import Estimate, PathSetpoint
from qrsim.control.failsafe_flight import CLIMB, DOWN, FLY, LOWER, STAY, Failsafes, FailsafeState, RallyPoint, Watched
from qrsim.control.failsafes import (
    DESCEND,
    DISARM,
    HOLD,
    LAND,
    NOTHING,
    RETURN,
    TERMINATE,
    battery_action,
    battery_level,
    fix_action,
    graver,
    is_lost,
    link_action,
    position_action,
)
from qrsim.core.tree import replace
from qrsim.core.vectors import Euler, Vec3

DT = 0.1


def test_the_graver_action_comes_later_as_in_px4() -> None:
    # failsafe/framework.h: Hold, RTL, Land, Descend, Disarm, Terminate.
    assert [NOTHING, HOLD, RETURN, LAND, DESCEND, DISARM, TERMINATE] == [0, 1, 2, 3, 4, 5, 6]
    assert graver(RETURN, LAND) == graver(LAND, RETURN) == LAND
    np.testing.assert_array_equal(graver(jnp.array([0, 3]), jnp.array([4, 2])), [4, 3])


# Charge, level, action with COM_LOW_BAT_ACT 2 and 3, at thresholds of 0.15, 0.07 and 0.05.
BATTERY = [
    (1.0, 0, NOTHING, NOTHING),
    (0.151, 0, NOTHING, NOTHING),
    (0.15, 1, NOTHING, NOTHING),
    (0.07, 2, LAND, RETURN),
    (0.05, 3, LAND, LAND),
    (0.0, 3, LAND, LAND),
    (math.nan, 0, NOTHING, NOTHING),
]


def test_levels_and_actions_of_a_battery() -> None:
    for charge, level, lands, returns in BATTERY:
        assert battery_level(charge, 0.15, 0.07, 0.05) == level
        assert [battery_action(level, act) for act in (0, 1, 2, 3)] == [NOTHING, NOTHING, lands, returns]
    charges, levels, lands, returns = (np.array(column) for column in zip(*BATTERY, strict=True))
    found = battery_level(jnp.asarray(charges), 0.15, 0.07, 0.05)
    assert found.dtype == jnp.int32
    np.testing.assert_array_equal(found, levels)
    np.testing.assert_array_equal(battery_action(found, 2), lands)
    np.testing.assert_array_equal(battery_action(found, 3), returns)
    # A charge that is not low is not critical either, whatever the thresholds.
    assert battery_level(0.2, 0.15, 0.3, 0.05) == 0


def test_actions_of_a_lost_link_fix_and_position() -> None:
    assert [link_action(True, act) for act in (0, 1, 2, 3, 4, 5, 6)] == [0, HOLD, RETURN, LAND, 0, TERMINATE, DISARM]
    assert [fix_action(True, act) for act in (0, 1, 2)] == [NOTHING, RETURN, LAND]
    np.testing.assert_array_equal(link_action(jnp.array([True, False]), 2), [RETURN, NOTHING])
    np.testing.assert_array_equal(position_action(jnp.array([True, False])), [DESCEND, NOTHING])
    assert not is_lost(10.0, 10.0)
    assert is_lost(10.1, 10.0)


def test_defaults_are_those_of_px4() -> None:
    own = Failsafes()
    names = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR", "COM_DL_LOSS_T", "EKF2_NOAID_TOUT", "RTL_LAND_DELAY")
    assert [getattr(own, name) for name in names] == [0.15, 0.07, 0.05, 10.0, 5e6, 0.0]
    assert (own.COM_LOW_BAT_ACT, own.NAV_DLL_ACT, own.COM_GNSSLOSS_ACT) == ("warn", "none", "warn")
    flight = ("RTL_RETURN_ALT", "RTL_MIN_DIST", "MPC_XY_CRUISE", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN")
    assert [getattr(own, name) for name in flight] == [60.0, 10.0, 5.0, 3.0, 1.5]
    # Of its multicopters (rc.mc_defaults).
    assert (own.RTL_DESCEND_ALT, own.MPC_LAND_SPEED, own.MPC_ACC_HOR) == (10.0, 0.7, 3.0)


class Rig:
    """One vehicle at a place, with a velocity, whose home is 10 m south of the origin on the ground."""

    def __init__(self, place: tuple[float, float, float], **parameters: Any):
        self.failsafes = Failsafes(**parameters)
        zero = jnp.zeros(1)
        self.state = FailsafeState.start(Vec3(zero - 10.0, zero, zero), zero + 0.5)
        self.seen = Watched(
            Estimate(Vec3(*(zero + axis for axis in place)), Vec3(zero, zero, zero), Euler(zero, zero, zero + 0.5)),
            jnp.zeros(1, bool),
            jnp.int32(0),
            charge=zero + 1.0,
            fixed=jnp.ones(1, bool),
            heard=jnp.zeros(1, jnp.int32),
        )
        self.setpoint = PathSetpoint.of(np.array([[1.0, 2.0, -3.0]]))

    def step(self, ticks: int = 1, **changes: Any) -> PathSetpoint:
        self.seen = self.seen._replace(**changes)
        for _ in range(ticks):
            # Without compiling, which takes longer than these few steps.
            with jax.disable_jit():
                self.state, asked = self.failsafes.step(self.state, self.seen, self.setpoint, DT)
            self.seen = self.seen._replace(tick=self.seen.tick + 1)
        return asked

    def put(self, **place: float) -> Estimate:
        own = self.seen.estimate
        now = replace(own.position_ned, **{axis: jnp.full(1, value) for axis, value in place.items()})
        return replace(own, position_ned=now)

    def lose_fix(self, ticks: int) -> None:
        self.state = replace(self.state, unfixed=jnp.full(1, ticks, jnp.int32))

    @property
    def action(self) -> int:
        return int(self.state.action[0])


def returning(x: float) -> Rig:
    """Return a vehicle 8 m over home that returns; its rally points are 60 m and 160 m north."""

    def rally(north: float, down: float, ground: float) -> RallyPoint:
        return RallyPoint(Vec3(*(jnp.full(1, axis) for axis in (north, 0.0, down))), jnp.full(1, ground))

    rig = Rig((x, 0.0, -8.0), COM_GNSSLOSS_ACT="return", RTL_RETURN_ALT=30.0)
    points = (rally(60.0, -20.0, -4.0), rally(160.0, -50.0, 2.0), rally(1e6, -9.0, 0.0))
    rig.failsafes = replace(rig.failsafes, rally=points)
    rig.state = replace(rig.state, rally_ned=rig.state.home_ned)
    rig.step(fixed=jnp.zeros(1, bool))
    return rig


@pytest.mark.long
@pytest.mark.parametrize(
    ("x", "safe", "z"),
    [
        # Nearest are home, 10 m south; a rally point on ground at -4 m; another one that is higher than the return.
        (-2.0, (-10.0, 0.0, 0.0), -8.0),
        (40.0, (60.0, 0.0, -4.0), -30.0),
        (140.0, (160.0, 0.0, 2.0), -50.0),
    ],
)
def test_a_return_leads_to_the_nearest_rally_point(x: float, safe: tuple[float, float, float], z: float) -> None:
    rig = returning(x)
    assert rig.action == RETURN
    found = rig.state.safe_ned
    assert [float(axis[0]) for axis in (found.x, found.y, found.z)] == list(safe)
    assert float(rig.state.goal_ned.z[0]) == pytest.approx(z, abs=0.01)


@pytest.mark.long
def test_a_return_lowers_over_the_ground_of_its_rally_point() -> None:
    rig = returning(59.5)
    rig.step(2, estimate=rig.put(z=-29.6))
    assert int(rig.state.phase[0]) == LOWER
    rig.step(2, estimate=rig.put(z=-14.6))
    assert int(rig.state.phase[0]) == LOWER
    rig.step(2, estimate=rig.put(z=-14.4))
    assert int(rig.state.phase[0]) == DOWN


@pytest.mark.long
def test_a_guidance_flies_until_something_fails() -> None:
    rig = Rig((20.0, 0.0, -20.0), COM_LOW_BAT_ACT="return_or_land")
    asked = rig.step()
    assert rig.action == NOTHING
    assert (float(asked.position_ned.x[0]), float(asked.position_ned.z[0]), float(asked.yaw[0])) == (1.0, -3.0, 0.0)
    assert not bool(asked.idle[0] | asked.level[0] | asked.blind[0])
    rig.step(charge=jnp.full(1, 0.1))
    assert (rig.action, int(rig.state.level[0])) == (NOTHING, 1)
    rig.step(charge=jnp.full(1, 0.06))
    assert (rig.action, int(rig.state.phase[0])) == (RETURN, CLIMB)
    # 60 m over home; a battery that recovers does not end it, and one that is worse lands.
    assert float(rig.state.goal_ned.z[0]) == -60.0
    rig.step(charge=jnp.full(1, 1.0))
    assert rig.action == RETURN
    rig.step(charge=jnp.full(1, 0.05))
    assert (rig.action, int(rig.state.phase[0])) == (LAND, DOWN)


@pytest.mark.long
def test_a_return_climbs_flies_home_lowers_waits_and_lands() -> None:
    rig = Rig((20.0, 0.0, -20.0), NAV_DLL_ACT="return", COM_DL_LOSS_T=5.0, RTL_RETURN_ALT=30.0, RTL_LAND_DELAY=0.5)
    rig.step(2, tick=jnp.int32(48))
    assert rig.action == NOTHING
    # At 50 ticks, 5 s after the newest message.
    rig.step()
    assert rig.action == RETURN
    assert bool(rig.state.link_lost[0])
    rig.step(estimate=rig.put(z=-29.45))
    assert int(rig.state.phase[0]) == CLIMB
    rig.step(estimate=rig.put(z=-29.55))
    assert int(rig.state.phase[0]) == FLY
    # Home is in the south; nearer than 2 m the heading stays.
    assert float(rig.step().yaw[0]) == pytest.approx(math.pi)
    assert float(rig.step(estimate=rig.put(x=-7.9, y=0.3)).yaw[0]) == pytest.approx(-math.atan2(0.3, -2.1), abs=1e-4)
    assert float(rig.step(estimate=rig.put(x=-8.1, y=0.0)).yaw[0]) == pytest.approx(-math.atan2(0.3, -2.1), abs=1e-4)
    rig.step(estimate=rig.put(x=-8.95))
    assert int(rig.state.phase[0]) == FLY
    rig.step(estimate=rig.put(x=-9.05))
    assert int(rig.state.phase[0]) == LOWER
    rig.step(2, estimate=rig.put(z=-10.55))
    assert (int(rig.state.phase[0]), int(rig.state.since[0])) == (LOWER, 0)
    rig.step(5, estimate=rig.put(z=-10.45))
    assert int(rig.state.phase[0]) == LOWER
    rig.step()
    assert int(rig.state.phase[0]) == DOWN
    # A link that is there again changes nothing.
    rig.step(heard=rig.seen.tick + jnp.zeros(1, jnp.int32))
    assert (rig.action, bool(rig.state.link_lost[0])) == (RETURN, False)


@pytest.mark.long
@pytest.mark.parametrize(
    ("place", "top", "z"),
    [
        # 60 m over home; not lower than it is; 3 m below a ceiling of 40 m; within 10 m of home as high as it is far.
        ((20.0, 0.0, -20.0), None, -60.0),
        ((20.0, 0.0, -80.0), None, -80.0),
        ((20.0, 0.0, -20.0), -40.0, -37.0),
        ((-4.0, 8.0, -5.0), None, -60.0),
        ((-4.0, 7.9, -5.0), None, -9.92),
    ],
)
def test_how_high_a_return_flies(place: tuple[float, float, float], top: float | None, z: float) -> None:
    rig = Rig(place, COM_GNSSLOSS_ACT="return")
    rig.failsafes = replace(rig.failsafes, top=top)
    rig.step(fixed=jnp.zeros(1, bool))
    assert rig.action == RETURN
    assert float(rig.state.goal_ned.z[0]) == pytest.approx(z, abs=0.01)


@pytest.mark.long
def test_a_vehicle_that_was_flown_away_begins_where_it_is() -> None:
    rig = Rig((20.0, 0.0, -60.0), COM_LOW_BAT_ACT="return_or_land")
    rig.step(5, charge=jnp.full(1, 0.06))
    assert (rig.action, int(rig.state.phase[0])) == (RETURN, FLY)
    # 15 m from its path it goes back to it, 40 m from it to the height of a return and home.
    asked = rig.step(estimate=rig.put(y=15.0))
    assert (int(rig.state.phase[0]), float(asked.position_ned.y[0])) == (FLY, pytest.approx(0.0, abs=0.1))
    asked = rig.step(estimate=rig.put(y=40.0, z=-30.0))
    assert (int(rig.state.phase[0]), float(rig.state.goal_ned.z[0])) == (CLIMB, -60.0)
    assert (float(asked.position_ned.y[0]), float(asked.position_ned.z[0])) == pytest.approx((40.0, -30.0), abs=0.1)


@pytest.mark.long
def test_a_hold_is_where_it_can_stop() -> None:
    rig = Rig((20.0, 0.0, -20.0), NAV_DLL_ACT="hold", COM_DL_LOSS_T=5.0)
    zero = jnp.zeros(1)
    moving = replace(rig.seen.estimate, velocity_ned=Vec3(zero + 6.0, zero, zero - 2.0))
    rig.step(estimate=moving, tick=jnp.int32(50))
    assert (rig.action, int(rig.state.phase[0])) == (HOLD, STAY)
    # 6^2 / (2 x 3), and 2^2 / (2 x 2).
    assert float(rig.state.goal_ned.x[0]) == pytest.approx(26.0)
    assert float(rig.state.goal_ned.z[0]) == pytest.approx(-21.0)


@pytest.mark.long
def test_without_a_position_it_descends_level_until_there_is_one() -> None:
    rig = Rig((20.0, 0.0, -20.0))
    zero = jnp.zeros(1)
    drifting = replace(rig.seen.estimate, velocity_ned=Vec3(zero + 4.0, zero, zero))
    # 5 s without a fix.
    rig.lose_fix(48)
    rig.step(fixed=jnp.zeros(1, bool), estimate=drifting)
    assert rig.action == NOTHING
    rig.step()
    assert rig.action == DESCEND
    asked = rig.step(5)
    assert bool(asked.blind[0])
    # Nothing is asked for to the sides, and 0.7 m/s down.
    assert (float(asked.position_ned.x[0]), float(asked.velocity_ned.x[0])) == (20.0, 4.0)
    assert float(asked.velocity_ned.z[0]) == pytest.approx(0.7)
    # Half as fast where the vehicle is 3.5 m behind.
    rig.state = replace(rig.state, place_ned=replace(rig.state.place_ned, z=jnp.full(1, -16.5)))
    assert float(rig.step().velocity_ned.z[0]) == pytest.approx(0.35)
    asked = rig.step(fixed=jnp.ones(1, bool))
    assert rig.action == NOTHING
    assert float(asked.position_ned.x[0]) == 1.0


@pytest.mark.long
def test_who_has_landed_stays_whatever_ends() -> None:
    rig = Rig((20.0, 0.0, -0.1))
    rig.lose_fix(50)
    rig.step(fixed=jnp.zeros(1, bool))
    assert rig.action == DESCEND
    asked = rig.step(4, standing=jnp.ones(1, bool))
    assert not bool(asked.idle[0])
    assert bool(asked.level[0])
    # Motors idle after 0.5 s on the ground, and after 1 s it has landed.
    asked = rig.step()
    assert bool(asked.idle[0])
    rig.step(4)
    assert not bool(rig.state.landed[0])
    rig.step()
    assert bool(rig.state.landed[0])
    asked = rig.step(2, fixed=jnp.ones(1, bool), standing=jnp.zeros(1, bool))
    assert rig.action == DESCEND
    assert bool(asked.idle[0])


@pytest.mark.long
def test_nothing_fails_over_on_the_ground() -> None:
    rig = Rig((0.0, 0.0, 0.0), COM_LOW_BAT_ACT="land", NAV_DLL_ACT="land", COM_DL_LOSS_T=5.0)
    no = jnp.zeros(1, bool)
    rig.lose_fix(300)
    rig.step(standing=~no, charge=jnp.full(1, 0.01), fixed=no, tick=jnp.int32(300))
    assert (rig.action, int(rig.state.latched[0]), int(rig.state.level[0])) == (NOTHING, NOTHING, 0)
