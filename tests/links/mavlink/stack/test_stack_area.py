"""Ceiling and floor of the area, headings on the way, pauses, and what a reboot does."""

from __future__ import annotations

import math

import pytest
from puppet import NAN, SITE, Puppet, item, place

from qrsim.links.mavlink.stack.codes import PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import LocalTarget
from qrsim.links.mavlink.stack.fence import Fence, items_of
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.models.scene.zone import Zone

TAKEOFF, WAYPOINT, LAND, TURNS = 22, 16, 21, 18
ACCEPTED, REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3


@pytest.mark.parametrize(
    ("bad", "flown"),
    [
        # 488 m above the sea is home, and the ceiling is 30 m higher.
        (item(1, WAYPOINT, 10.0, 0.0, 31.0), False),
        (item(1, WAYPOINT, 10.0, 0.0, 29.0), True),
        (item(1, WAYPOINT, 10.0, 0.0, 519.0, frame=5), False),
        (item(1, WAYPOINT, up=31.0), False),
        (item(1, WAYPOINT, 10.0, 0.0, -1.0), False),
        (item(1, LAND, 10.0, 0.0, -1.0), True),
        (item(1, TAKEOFF, up=31.0), False),
    ],
)
def test_items_above_the_ceiling_or_below_the_floor_are_not_flown(bad, flown):
    puppet = Puppet(z_min=-30.0, z_max=0.0)
    assert puppet.stack.accept(PlanKind.MISSION, [item(0, TAKEOFF, up=10.0), bad]) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == (ACCEPTED if flown else REJECTED)
    puppet.run(0.02)
    assert ("Mission rejected: item 1 is outside the fence" in puppet.texts) is not flown


def test_take_off_and_reposition_above_the_ceiling_are_denied():
    puppet = Puppet(z_min=-30.0, z_max=0.0)
    assert puppet.do(400, 1) == ACCEPTED
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 519.0) == DENIED
    puppet.run(0.02)
    assert puppet.texts[-1] == "Takeoff rejected: above the ceiling of the area"
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 498.0) == ACCEPTED
    assert puppet.run(30.0, lambda now: now.stack.mode is Mode.HOLD)
    north, east = (number * 1e-7 for number in place(5.0, 5.0))
    assert puppet.do(192, -1, 1, 0, NAN, north, east, 519.0) == DENIED
    puppet.run(0.02)
    assert puppet.texts[-1] == "Reposition is outside the fence"
    assert puppet.do(192, -1, 1, 0, NAN, north, east, 517.0) == ACCEPTED


def test_a_return_stays_below_the_ceiling():
    puppet = Puppet(z_min=-30.0, z_max=0.0)
    puppet.fly_up(10.0)
    north, east = (number * 1e-7 for number in place(25.0, 0.0))
    assert puppet.do(192, -1, 1, 0, NAN, north, east, 498.0) == ACCEPTED
    puppet.run(15.0)
    assert puppet.do(20) == ACCEPTED
    puppet.run(30.0)
    # RTL_RETURN_ALT is 60 m; 3 m below the ceiling.
    assert puppet.highest == pytest.approx(27.0, abs=0.6)


def test_a_climb_stops_below_the_ceiling():
    puppet = Puppet(fence=((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0)), z_min=-30.0, z_max=0.0)
    puppet.fly_up(10.0)
    up = LocalTarget(1, 0xDC7, velocity=(0.0, 0.0, -3.0))
    assert puppet.stack.setpoint(up)
    assert puppet.do(176, 1, 6) == ACCEPTED
    assert puppet.run(12.0, lambda now: now.stack.mode is Mode.HOLD, lambda now: now.stack.setpoint(up))
    assert "Geofence breached: about to leave the area of the scenario" in puppet.texts
    puppet.run(5.0)
    assert 22.0 < puppet.highest < 30.0


# 30 m east of home, to a place 40 m further north; at 20 m on the way home is at atan2(-30, -20).
AT_20 = math.atan2(-30.0, -20.0)


@pytest.mark.parametrize(("mode", "heading"), [(0, 0.0), (1, AT_20), (2, AT_20 + math.pi), (3, 0.0), (4, 0.0)])
def test_the_heading_on_the_way_is_that_of_the_parameter(mode, heading):
    puppet = Puppet()
    puppet.fly_up(10.0)
    puppet.stack.parameters.set("MPC_YAW_MODE", mode)
    items = [item(seq, WAYPOINT, 40.0 * seq + 0.001, 30.0, 10.0, params=(0, 1, 0, NAN)) for seq in (0, 1)]
    assert puppet.stack.accept(PlanKind.MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == ACCEPTED
    assert puppet.run(40.0, lambda now: now.seen.position_ned[0] > 20.0)
    assert math.remainder(puppet.seen.attitude[2] - heading, 2.0 * math.pi) == pytest.approx(0.0, abs=0.07)


def test_a_turn_comes_before_the_way_where_the_parameter_says_so():
    puppet = Puppet()
    puppet.fly_up(10.0)
    puppet.stack.parameters.set("MPC_YAW_MODE", 4)
    assert puppet.stack.accept(PlanKind.MISSION, [item(0, WAYPOINT, 40.0, 0.0, 10.0, params=(0, 1, 0, NAN))])
    assert puppet.do(300) == ACCEPTED

    def looks(degrees):
        return lambda now: setattr(now.seen, "attitude", (0.0, 0.0, math.radians(degrees)))

    # 12 deg are allowed.
    puppet.run(5.0, each=looks(14.0))
    assert puppet.seen.position_ned[0] == pytest.approx(0.0, abs=0.1)
    puppet.run(5.0, each=looks(10.0))
    assert puppet.seen.position_ned[0] > 5.0


def test_pauses_are_those_of_ground_stations():
    puppet = Puppet()
    puppet.fly_up(10.0)
    north, east = (number * 1e-7 for number in place(60.0, 0.0))
    assert puppet.do(192, -1, 1, 0, NAN, north, east, 498.0) == ACCEPTED
    puppet.run(6.0)
    assert puppet.seen.velocity_ned[0] > 4.0
    assert puppet.do(192, -1, 1, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    puppet.run(6.0)
    # It brakes with MPC_ACC_HOR, and stays.
    assert 15.0 < puppet.seen.position_ned[0] < 35.0
    assert math.hypot(*puppet.seen.velocity_ned) < 0.1
    # PX4's Commander does not know DO_PAUSE_CONTINUE.
    assert puppet.do(193, 0) == UNSUPPORTED


def test_a_vehicle_whose_flight_has_ended_moves_after_a_reboot():
    puppet = Puppet()
    puppet.seen.stopped = "crashed: impact_speed = 9.1"
    puppet.run(0.04)
    for number in (20, 21, 22, 192, 300):
        assert puppet.do(number) == REJECTED
    puppet.run(0.02)
    assert puppet.texts[-1] == "Command 300 rejected: flight has ended: crashed: impact_speed = 9.1; reboot"
    assert puppet.do(246, 1) == ACCEPTED
    # Its world puts it back, and starts it again.
    assert puppet.stack.events()[-1].kind == "reboot"
    puppet.seen.stopped = ""
    puppet.stack.reset()


HOLE = ((-50.0, 40.0), (-40.0, 50.0), (-50.0, 50.0))
FIELD = Zone(True, (((-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, -60.0)), HOLE))
SCHOOL = Zone(False, (), (30.0, 0.0), 10.0, ceiling=15.0, name="school")


@pytest.mark.parametrize(("height", "holds"), [(10.0, True), (25.0, False)])
def test_the_zones_of_the_scenario_are_the_fence_with_their_heights(height, holds):
    """GF_ACTION is hold: below its ceiling the school is not entered, above it is flown over."""
    puppet = Puppet(zones=(FIELD, SCHOOL))
    puppet.fly_up(height)
    north = LocalTarget(1, 0xDC7, velocity=(4.0, 0.0, 0.0))
    assert puppet.stack.setpoint(north)
    assert puppet.do(176, 1, 6) == ACCEPTED

    def go(now):
        now.stack.setpoint(north)

    assert puppet.run(12.0, lambda now: now.stack.mode is Mode.HOLD, go) == holds
    puppet.run(4.0)
    assert ("Geofence breached: about to leave the area of the scenario" in puppet.texts) == holds
    assert puppet.seen.position_ned[0] < 20.0 if holds else puppet.seen.position_ned[0] > 40.0


def test_a_plan_of_the_zones_is_the_same_fence_without_heights():
    geodesy = Geodesy(SITE)
    items = items_of((FIELD, SCHOOL), geodesy)
    # Four corners and three of the hole, which is an exclusion, and a circle to stay out of.
    assert [item.command for item in items] == [5001] * 4 + [5002] * 3 + [5004]
    assert [item.params[0] for item in items] == [4.0] * 4 + [3.0] * 3 + [10.0]
    fence, result, bad = Fence.of(items, geodesy)
    assert (result, bad) == (PlanResult.ACCEPTED, -1)
    places = [(0.0, 0.0), (30.0, 5.0), (45.0, 0.0), (61.0, 0.0), (-48.0, 48.0)]
    assert [fence.inside(*place) for place in places] == [True, False, True, False, False]
    scenario = Fence((FIELD, SCHOOL))
    assert [scenario.inside(*place, -20.0) for place in places] == [True, True, True, False, False]
    guarded, _, _ = Fence.of(items, geodesy, scenario)
    assert not guarded.inside(30.0, 5.0, -20.0)
    assert scenario.crosses((0.0, 0.0, -10.0), (50.0, 0.0, -10.0))
    assert not scenario.crosses((0.0, 0.0, -20.0), (50.0, 0.0, -20.0))
