"""A flight stack takes off, flies, returns and lands; arming is refused with reasons, and vehicles disarm in time."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from puppet import DT, EAST_DEG, NORTH_DEG, Puppet, command, item

from qrsim.links.mavlink.stack.codes import Landed, PlanKind, Result
from qrsim.links.mavlink.stack.contracts import NAN
from qrsim.links.mavlink.stack.modes import Mode

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3
# main << 16 | sub << 24, of px4_custom_mode.h.
LOITER, TAKEOFF, RTL, LAND, OFFBOARD = 0x03040000, 0x02040000, 0x05040000, 0x06040000, 0x00060000


def test_a_vehicle_boots_in_loiter_disarmed_and_idle():
    puppet = Puppet()
    told = puppet.stack.heartbeat()
    assert (told.autopilot, told.base_mode, told.custom_mode, told.system_status) == (12, 29, LOITER, 3)
    assert told.landed is Landed.ON_GROUND
    assert puppet.order.kind == "attitude"
    assert puppet.order.numbers == (0.0, 0.0, 0.0, 0.0)
    assert puppet.kinds("home") == [0]
    # The order stands until something changes.
    assert puppet.stack.tick(puppet.seen) is None


def test_take_off_hold_reposition_and_land():
    puppet = Puppet()
    assert puppet.do(400, 1) == ACCEPTED
    assert puppet.stack.heartbeat().base_mode == 29 + 128
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 498.0) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == TAKEOFF
    assert puppet.run(20.0, lambda now: now.stack.heartbeat().landed is Landed.TAKEOFF)
    assert puppet.run(20.0, lambda now: now.stack.heartbeat().custom_mode == LOITER)
    assert -puppet.seen.position_ned[2] == pytest.approx(10.0, abs=0.3)
    puppet.run(5.0)
    assert puppet.stack.heartbeat().landed is Landed.IN_AIR
    assert puppet.seen.position_ned == pytest.approx((0.0, 0.0, -10.0), abs=0.1)
    # 30 m north and 40 m east at 20 m, 50 m away at 5 m/s.
    goal = (47.397742 + 30.0 * NORTH_DEG, 8.545594 + 40.0 * EAST_DEG, 508.0)
    assert puppet.do(192, -1, 1, 0, NAN, *goal) == ACCEPTED
    puppet.fastest = 0.0
    puppet.run(18.0)
    assert puppet.seen.position_ned == pytest.approx((30.0, 40.0, -20.0), abs=0.3)
    assert puppet.fastest == pytest.approx(5.0, rel=0.03)
    # It looks where it flies: atan2(40, 30).
    assert puppet.seen.attitude[2] == pytest.approx(0.927, abs=0.05)
    assert puppet.do(21) == ACCEPTED
    assert puppet.run(60.0, lambda now: now.seen.on_ground)
    assert puppet.stack.heartbeat().landed is Landed.LANDING
    touched = puppet.seen.time
    assert puppet.run(3.0, lambda now: now.stack.heartbeat().landed is Landed.ON_GROUND)
    assert puppet.stack.armed
    landed = puppet.seen.time
    # On the ground with a descent asked for.
    assert landed - touched == pytest.approx(1.0, abs=0.05)
    assert puppet.run(10.0, lambda now: not now.stack.armed)
    # COM_DISARM_LAND.
    assert puppet.seen.time - landed == pytest.approx(2.0, abs=0.05)
    assert puppet.stack.heartbeat().custom_mode == LOITER
    assert puppet.texts[-2:] == ["Landing detected", "Disarmed by landing"]
    assert puppet.order.numbers[3] == 0.0


def test_the_last_metres_of_a_landing_are_slow():
    puppet = Puppet()
    puppet.fly_up(20.0)
    puppet.do(21)
    sinks = {}
    puppet.run(
        40.0,
        until=lambda now: now.seen.on_ground,
        each=lambda now: sinks.update({round(-now.seen.position_ned[2]): now.seen.velocity_ned[2]}),
    )
    # MPC_Z_VEL_MAX_DN above 10 m, MPC_LAND_SPEED below 5 m.
    assert sinks[12] == pytest.approx(1.5, abs=0.1)
    assert sinks[2] == pytest.approx(0.7, abs=0.05)


def test_a_landing_vehicle_that_something_holds_up_is_kept_level():
    """At 0.7 m/s the path is 0.2 m below it after 0.29 s; the motors idle only once it is 0.6 m below, and stay so.

    From 5 m to 2.75 m it takes 3.2 s, a little longer than a landing has to be slow before it counts.
    """
    puppet = Puppet()
    puppet.fly_up(6.0)
    puppet.do(21)
    held_since, kinds = [], {}

    def held(now):
        if -now.seen.position_ned[2] <= 2.75:
            held_since.append(now.seen.time)
            x, y, _ = now.seen.position_ned
            now.seen = replace(now.seen, position_ned=(x, y, -2.75), velocity_ned=(0.0, 0.0, 0.0))
            kinds.setdefault((now.order.kind, *now.order.numbers[:2], now.order.numbers[3]), now.seen.time)

    puppet.run(9.0, each=held)
    # Four fifths of the throttle 0.5 of a hover.
    assert kinds[("attitude", 0.0, 0.0, 0.4)] - held_since[0] == pytest.approx(0.29, abs=0.06)
    assert kinds[("attitude", 0.0, 0.0, 0.0)] - held_since[0] == pytest.approx(0.86 + 0.5, abs=0.1)
    # Above, where the descent has just become slow, gusts are no ground.
    puppet = Puppet()
    puppet.fly_up(6.0)
    puppet.do(21)
    assert puppet.run(20.0, lambda now: -now.seen.position_ned[2] <= 4.5)
    puppet.seen = replace(puppet.seen, position_ned=(0.0, 0.0, -4.8), velocity_ned=(0.0, 0.0, 0.0))
    puppet.stack.tick(puppet.seen)
    assert puppet.stack.tick(puppet.seen).kind == "path"


def test_who_takes_off_again_after_a_landing_is_not_disarmed():
    puppet = Puppet()
    puppet.fly_up(3.0)
    puppet.do(21)
    assert puppet.run(20.0, lambda now: now.stack.on_ground)
    puppet.run(1.9)
    assert puppet.do(22) == ACCEPTED
    puppet.run(5.0)
    assert puppet.stack.armed
    assert -puppet.seen.position_ned[2] == pytest.approx(2.5, abs=0.3)


@pytest.mark.parametrize(("factor", "seconds"), [(1.0, 10.0), (3.0, 30.0)])
def test_an_armed_vehicle_that_does_not_take_off_disarms_after_10_s_of_its_clients(factor, seconds):
    puppet = Puppet(factor=factor)
    assert puppet.do(400, 1) == ACCEPTED
    armed = puppet.seen.time
    assert puppet.run(40.0, lambda now: not now.stack.armed)
    assert puppet.seen.time - armed == pytest.approx(seconds, abs=0.05)
    assert puppet.texts[-1] == "Disarmed by auto preflight disarming"
    assert puppet.highest == 0.0
    assert puppet.kinds("armed") == [1, 0]


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("fix_type", 2, "GNSS fix type 2, 3 needed"),
        ("valid", False, "attitude or position estimate not valid"),
        ("charge", 0.07, "battery 7 %, more than 7 % needed"),
        ("healthy", 0xF - 1, "gyroscope not healthy"),
        ("healthy", 0xF - 2, "accelerometer not healthy"),
        ("healthy", 0xF - 4, "magnetometer not healthy"),
        ("healthy", 0xF - 8, "barometer not healthy"),
        ("stopped", "crashed", "flight has ended: crashed; reboot"),
        ("on_ground", False, "not on the ground"),
    ],
)
def test_arming_is_refused_with_the_reason(field, value, reason):
    puppet = Puppet()
    assert puppet.stack.health().healthy & 0x10000000
    setattr(puppet.seen, field, value)
    puppet.stack.tick(puppet.seen)
    assert not puppet.stack.health().healthy & 0x10000000
    assert puppet.stack.health().present & 0x10000000
    assert puppet.do(400, 1) == TEMPORARILY_REJECTED
    assert not puppet.stack.armed
    texts = [text.text for text in puppet.stack.texts()]
    assert texts == ["Arming denied: Resolve system health failures first", f"Preflight Fail: {reason}"]


def test_a_fix_has_to_hold_for_a_second():
    puppet = Puppet(settle=0.5)
    assert puppet.do(400, 1) == TEMPORARILY_REJECTED
    assert puppet.stack.texts()[-1].text == "Preflight Fail: GNSS fix too new"
    puppet.run(0.6)
    assert puppet.do(400, 1) == ACCEPTED


def test_arming_outside_the_fence_is_refused():
    puppet = Puppet(fence=((10.0, 10.0), (10.0, 20.0), (20.0, 15.0)))
    assert puppet.do(400, 1) == TEMPORARILY_REJECTED
    assert "Preflight Fail: outside the fence" in [text.text for text in puppet.stack.texts()]


def test_force_arms_in_spite_of_checks_but_not_what_has_crashed():
    puppet = Puppet()
    puppet.seen.charge = 0.01
    assert puppet.do(400, 1, 21196) == ACCEPTED
    puppet = Puppet()
    puppet.seen.stopped = "crashed"
    assert puppet.do(400, 1, 21196) == TEMPORARILY_REJECTED


def test_disarming_in_the_air_is_refused_and_a_kill_is_not():
    puppet = Puppet()
    puppet.fly_up()
    assert puppet.do(400, 0) == TEMPORARILY_REJECTED
    assert puppet.stack.texts()[-1].text == "Disarming denied: not landed"
    assert puppet.do(400, 0, 21196) == ACCEPTED
    assert not puppet.stack.armed
    puppet.run(0.5)
    assert puppet.order.numbers[3] == 0.0
    assert puppet.run(10.0, lambda now: now.seen.on_ground)
    # A kill is over with the flight.
    puppet.run(2.0)
    assert puppet.do(400, 1) == ACCEPTED


def test_a_terminated_flight_needs_a_reboot():
    puppet = Puppet()
    puppet.fly_up()
    assert puppet.do(246, 1) == DENIED
    assert puppet.do(185, 1) == ACCEPTED
    assert not puppet.stack.armed
    assert puppet.stack.heartbeat().system_status == 8
    puppet.run(6.0)
    assert puppet.seen.on_ground
    assert puppet.do(400, 1) == TEMPORARILY_REJECTED
    assert puppet.do(246, 1) == ACCEPTED
    assert puppet.stack.events()[-1].kind == "reboot"
    puppet.stack.reset()
    puppet.run(2.0)
    assert puppet.do(400, 1) == ACCEPTED


def test_a_vehicle_whose_flight_has_ended_disarms():
    puppet = Puppet()
    puppet.fly_up()
    puppet.seen.stopped = "collision"
    puppet.run(DT)
    assert not puppet.stack.armed
    assert puppet.texts[-1] == "Flight has ended: collision"


def test_return_climbs_flies_home_and_lands():
    puppet = Puppet()
    puppet.fly_up()
    assert puppet.do(192, -1, 1, 0, NAN, 47.397742 + 60.0 * NORTH_DEG, 8.545594, 498.0) == ACCEPTED
    puppet.run(20.0)
    assert puppet.seen.position_ned[0] == pytest.approx(60.0, abs=0.5)
    puppet.stack.parameters.set("RTL_RETURN_ALT", 25.0)
    assert puppet.do(20) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == RTL
    # It climbs first.
    assert puppet.run(20.0, lambda now: now.seen.position_ned[2] < -24.4)
    assert puppet.seen.position_ned[0] == pytest.approx(60.0, abs=0.5)
    assert puppet.run(120.0, lambda now: not now.stack.armed)
    assert puppet.highest == pytest.approx(25.0, abs=0.5)
    assert math.hypot(*puppet.seen.position_ned[:2]) < 0.5


def test_return_from_beside_home_stays_in_a_cone():
    puppet = Puppet()
    puppet.fly_up(3.0)
    puppet.do(192, -1, 1, 0, NAN, 47.397742 + 8.0 * NORTH_DEG, 8.545594, 491.0)
    puppet.run(10.0)
    puppet.highest = 0.0
    puppet.do(20)
    assert puppet.run(80.0, lambda now: not now.stack.armed)
    # 8 m away it climbs to 8 m, not to 60.
    assert puppet.highest == pytest.approx(8.0, abs=0.5)


def test_speeds_change_in_flight_and_by_parameter():
    puppet = Puppet()
    puppet.fly_up()
    assert puppet.do(178, 1, 2.5, -1) == ACCEPTED
    puppet.fastest = 0.0
    puppet.do(192, -1, 1, 0, NAN, 47.397742 + 30.0 * NORTH_DEG, 8.545594, 498.0)
    puppet.run(20.0)
    assert puppet.fastest == pytest.approx(2.5, rel=0.03)
    assert puppet.do(178, 1, -2, -1) == ACCEPTED
    puppet.stack.parameters.set("MPC_XY_CRUISE", 4.0)
    puppet.do(192, -1, 1, 0, NAN, 47.397742, 8.545594, 498.0)
    puppet.run(20.0)
    assert puppet.fastest == pytest.approx(4.0, rel=0.03)
    assert puppet.do(178, 4, 2.0, -1) == DENIED
    assert puppet.do(178, 1, 0.0, -1) == DENIED


@pytest.mark.parametrize(("place", "up"), [((0.0, 0.0), 3.0), ((NAN, NAN), 487.0)])
def test_a_take_off_below_the_vehicle_goes_up_all_the_same(place, up):
    puppet = Puppet()
    puppet.do(400, 1)
    assert puppet.do(22, NAN, NAN, NAN, NAN, *place, up) == ACCEPTED
    puppet.run(8.0)
    # MIS_TAKEOFF_ALT.
    assert -puppet.seen.position_ned[2] == pytest.approx(2.5, abs=0.2)
    assert "Takeoff altitude is below me" in puppet.texts[1] + puppet.texts[0]


def test_a_take_off_that_is_ordered_first_flies_once_armed():
    puppet = Puppet()
    assert puppet.do(22) == ACCEPTED
    puppet.run(2.0)
    assert puppet.highest == 0.0
    assert puppet.do(400, 1) == ACCEPTED
    puppet.run(6.0)
    assert puppet.highest == pytest.approx(2.5, abs=0.3)


def test_modes_that_cannot_be_flown_are_refused():
    puppet = Puppet()
    stack = puppet.stack
    # No sticks: MANUAL, ALTCTL, POSCTL, ACRO, STABILIZED; no set-points; no mission.
    for main in (1, 2, 3, 5, 7):
        assert stack.set_mode(1, main << 16) is Result.TEMPORARILY_REJECTED
    assert stack.set_mode(1, OFFBOARD) is Result.TEMPORARILY_REJECTED
    assert stack.set_mode(1, 0x04040000) is Result.TEMPORARILY_REJECTED
    assert puppet.do(300) == TEMPORARILY_REJECTED
    assert puppet.stack.texts()[-1].text == "Mission rejected: no mission"
    # Precision landing and Acro have names, 77 has none; the answers and texts are those of Commander.
    for custom, text in ((0x09040000, "Precision Landing"), (0x00050000, "Acro"), (0x004D0000, "")):
        assert stack.set_mode(1, custom) is Result.TEMPORARILY_REJECTED
        said = f"Switching to mode '{text}' is currently not possible: not flown here" if text else "Unsupported mode"
        assert puppet.stack.texts()[-1].text == said
    assert stack.set_mode(0, LOITER) is Result.UNSUPPORTED
    assert puppet.do(176, 1, 4, 3) == ACCEPTED
    assert puppet.do(176, 1, 4, 6) == ACCEPTED
    assert stack.mode is Mode.LAND


def test_every_command_has_one_answer_and_most_are_not_known():
    puppet = Puppet()
    known = {20, 21, 22, 34, 176, 178, 179, 185, 192, 224, 246, 262, 300, 400, 410}
    for id in range(3001):
        result = puppet.stack.command(command(id)).result
        assert (result is Result.UNSUPPORTED) == (id not in known or id == 176), id
    assert puppet.do(400, math.inf) == DENIED


def test_home_is_set_by_command_and_at_arming():
    puppet = Puppet()
    assert puppet.do(179, 0, 0, 0, 0, 47.397742 + 20.0 * NORTH_DEG, 8.545594, 490.0) == ACCEPTED
    assert puppet.stack.home.position_ned == pytest.approx((20.0, 0.0, -2.0), abs=0.01)
    assert puppet.do(179, 0, 0, 0, 0, 91.0, 8.5, 490.0) == DENIED
    assert puppet.do(179, 0) == DENIED
    assert puppet.do(179, 1) == ACCEPTED
    assert puppet.stack.home.position_ned == (0.0, 0.0, 0.0)
    assert puppet.do(410) == ACCEPTED


def test_ardupilot_takes_off_in_guided_to_a_height_over_home():
    puppet = Puppet("ardupilot")
    told = puppet.stack.heartbeat()
    assert (told.autopilot, told.custom_mode) == (3, 5)
    assert puppet.do(400, 1) == ACCEPTED
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 10.0) == 4
    assert puppet.do(176, 1, 4) == ACCEPTED
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 10.0) == ACCEPTED
    puppet.run(15.0)
    assert puppet.stack.heartbeat().custom_mode == 4
    assert -puppet.seen.position_ned[2] == pytest.approx(10.0, abs=0.2)
    # CONDITION_YAW, in degrees.
    assert puppet.do(115, 90.0, 0, 1, 0) == ACCEPTED
    puppet.run(1.0)
    assert puppet.seen.attitude[2] == pytest.approx(math.pi / 2.0, abs=0.01)
    assert puppet.do(176, 1, 9) == ACCEPTED
    assert puppet.run(40.0, lambda now: not now.stack.armed)


def test_ardupilot_says_prearm_and_keeps_home_in_the_first_item():
    puppet = Puppet("ardupilot")
    puppet.seen.fix_type = 1
    puppet.run(DT)
    assert puppet.do(400, 1) == 4
    assert puppet.stack.texts()[-1].text == "PreArm: GNSS fix type 1, 3 needed"
    puppet.seen.fix_type = 3
    puppet.run(1.5)
    puppet.stack.accept(PlanKind.MISSION, [item(0, 16, 200, 0, 0.0, frame=0), item(1, 16, 20, 0, 6.0)])
    assert puppet.stack.mission().seq == 1
    assert puppet.do(300) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == 3
    assert puppet.run(30.0, lambda now: now.stack.mode is Mode.HOLD)
    assert puppet.kinds("item_reached") == [1]


def test_arming_with_nothing_set_stops_no_motor():
    puppet = Puppet()
    puppet.do(400, 1)
    assert puppet.do(400, NAN) == DENIED
    assert puppet.stack.armed
