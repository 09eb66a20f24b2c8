"""Orbits, follow-me and sticks, as PX4's flight tasks fly them, and ArduPilot's CIRCLE and LOITER."""

from __future__ import annotations

import math

import pytest
from puppet import DT, EAST_DEG, NORTH_DEG, Puppet

from qrsim.links.mavlink.stack.codes import Landed
from qrsim.links.mavlink.stack.contracts import NAN, FollowTarget
from qrsim.links.mavlink.stack.modes import Mode

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
POSITION, ALTITUDE, STABILIZED, FOLLOW = 0x00030000, 0x00020000, 0x00070000, 0x08040000
# Inner 100 m of the fence that the area of a scenario is.
AREA = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))


def there(north: float, east: float, up: float) -> tuple[float, float, float]:
    """Latitude, longitude [deg] and altitude above the sea [m]."""
    return 47.397742 + north * NORTH_DEG, 8.545594 + east * EAST_DEG, 488.0 + up


def flying(flavour: str = "px4", **more) -> Puppet:
    """Return a puppet that hovers 10 m above the ground."""
    puppet = Puppet(flavour, **more)
    if flavour == "ardupilot":
        assert puppet.stack.set_mode(1, 4) == ACCEPTED
        assert puppet.do(400, 1) == ACCEPTED
        assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 10.0) == ACCEPTED
        assert puppet.run(40.0, lambda now: now.stack.mode is Mode.HOLD)
    else:
        puppet.fly_up()
    return puppet


# ---- orbits ----


@pytest.mark.parametrize(
    ("radius", "speed", "looks", "flown"),
    # PX4 allows 2 m/s^2 towards the centre, 10 m/s, and 1 m at least; the puppet's controller 8 m/s.
    [(10.0, 3.0, 0, 3.0), (-10.0, 3.0, 3, 3.0), (4.0, 9.0, 1, math.sqrt(8.0)), (60.0, 30.0, 2, 8.0)],
)
def test_an_orbit_goes_to_its_circle_and_round_it(radius, speed, looks, flown):
    puppet = flying()
    # MAVSDK's frame is that of altitudes over home, its altitude is above the sea.
    assert puppet.do(34, radius, speed, looks, NAN, *there(20.0, 5.0, 14.0), frame=3) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == 0x01030000
    puppet.run(40.0)
    assert puppet.stack.orbiting().radius == radius
    here, before = puppet.seen, puppet.seen.position_ned
    north, east = before[0] - 20.0, before[1] - 5.0
    assert math.hypot(north, east) == pytest.approx(abs(radius), abs=1.0)
    assert before[2] == pytest.approx(-14.0, abs=0.2)
    assert math.hypot(*here.velocity_ned[:2]) == pytest.approx(flown, rel=0.1)
    # Clockwise from above is north to east.
    turning = north * here.velocity_ned[1] - east * here.velocity_ned[0]
    assert math.copysign(1.0, turning) == math.copysign(1.0, radius)
    inwards = math.atan2(-east, -north)
    heading = {0: inwards, 3: inwards - math.copysign(math.pi / 2, radius), 1: 0.0}.get(looks)
    if heading is not None:
        assert math.remainder(here.attitude[2] - heading, 2.0 * math.pi) == pytest.approx(0.0, abs=0.15)


def test_an_orbit_that_leaves_some_numbers_out_keeps_them():
    puppet = flying()
    # Round where it is: PX4's circle of 1 m at 1 m/s.
    assert puppet.do(34) == ACCEPTED
    puppet.run(10.0)
    assert puppet.stack.orbiting() is not None
    assert math.hypot(*puppet.seen.position_ned[:2]) == pytest.approx(1.0, abs=0.3)
    assert puppet.do(34, 10.0, 4.0) == ACCEPTED
    centre = puppet.stack.orbiting().centre
    assert puppet.do(34, NAN, 2.0, 5.0, NAN, *there(centre[0], centre[1], 10.0)) == ACCEPTED
    puppet.run(15.0)
    assert puppet.stack.orbiting().radius == 10.0
    assert math.hypot(*puppet.seen.velocity_ned[:2]) == pytest.approx(2.0, rel=0.1)
    puppet.stack.set_mode(1, 0x03040000)
    assert puppet.stack.orbiting() is None


def test_orbits_that_cannot_be_flown_are_refused():
    puppet = Puppet(fence=AREA, z_min=-50.0)
    assert puppet.do(34, 10.0, 2.0, 0, NAN, *there(0.0, 0.0, 10.0)) == REJECTED
    assert puppet.stack.texts()[-1].text == "Orbit command rejected: not in the air"
    puppet.fly_up()
    for radius, where in (
        (10.0, there(95.0, 0.0, 10.0)),
        (10.0, there(0.0, 0.0, 60.0)),
        (110.0, there(0.0, 0.0, 10.0)),
    ):
        assert puppet.do(34, radius, 2.0, 0, NAN, *where) == DENIED
        assert puppet.stack.texts()[-1].text == "Orbit command rejected: outside the fence"
    assert puppet.do(34, 10.0, 2.0, 0, NAN, 91.0, 8.5, 500.0) == DENIED
    assert puppet.stack.mode is Mode.HOLD
    assert Puppet("ardupilot").do(34, 10.0, 2.0, 0, NAN, *there(0.0, 0.0, 10.0)) == UNSUPPORTED


def test_circle_of_ardupilot_goes_round_a_place_ahead():
    puppet = Puppet("ardupilot")
    assert puppet.stack.set_mode(1, 7) == FAILED
    assert puppet.stack.texts()[-1].text == "Mode change to CIRCLE failed: not in the air"
    puppet = flying("ardupilot")
    assert puppet.stack.set_mode(1, 7) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == 7
    puppet.run(12.0)
    # CIRCLE_RADIUS is 10 m and CIRCLE_RATE 20 deg/s.
    here = puppet.seen.position_ned
    assert math.hypot(here[0] - 10.0, here[1]) == pytest.approx(10.0, abs=1.0)
    assert math.hypot(*puppet.seen.velocity_ned[:2]) == pytest.approx(10.0 * math.radians(20.0), rel=0.1)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (21, "Mode change to SMART_RTL failed: not flown here"),
        (1, "Mode change to ACRO failed: not flown here"),
        (2, "Mode change to ALT_HOLD failed: no manual control input"),
        (99, "No such mode 99"),
    ],
)
def test_modes_of_ardupilot_that_cannot_be_had_are_refused_by_name(number, text):
    puppet = flying("ardupilot")
    assert puppet.stack.set_mode(1, number) == FAILED
    assert puppet.stack.texts()[-1].text == text


def test_while_it_is_disarmed_a_copter_takes_modes_by_sticks_and_is_not_armed_in_them():
    puppet = Puppet("ardupilot")
    assert puppet.stack.set_mode(1, 0) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == 0
    assert puppet.do(400, 1) == FAILED
    assert puppet.stack.texts()[-1].text == "PreArm: no manual control input"


# ---- follow-me ----


def lead(speed: float, up: float = 0.0, until: float = math.inf):
    """Return what tells a target that goes north, twice a second."""

    def each(now: Puppet) -> None:
        if now.seen.time < until and round(now.seen.time / DT) % 25 == 0:
            now.stack.follow_target(FollowTarget(*there(speed * now.seen.time, 6.0, up), (speed, 0.0, 0.0)))

    return each


def test_a_target_is_followed_from_behind_and_looked_at():
    puppet = flying()
    assert puppet.stack.set_mode(1, FOLLOW) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == FOLLOW
    # Without a target it stays.
    puppet.run(3.0)
    assert puppet.seen.position_ned == pytest.approx((0.0, 0.0, -10.0), abs=0.2)
    puppet.run(40.0, each=lead(3.0))
    north, east, down = puppet.seen.position_ned
    # PX4's defaults: 8 m behind, 8 m over home.
    assert (north - 3.0 * puppet.seen.time, east, down) == pytest.approx((-8.0, 6.0, -8.0), abs=1.0)
    assert puppet.seen.velocity_ned == pytest.approx((3.0, 0.0, 0.0), abs=0.3)
    assert puppet.seen.attitude[2] == pytest.approx(0.0, abs=0.1)
    # From the right, at twice the distance, and above the target; a target that is silent for 3 s stands.
    for name, value in (("FLW_TGT_FA", 90.0), ("FLW_TGT_DST", 16.0), ("FLW_TGT_ALT_M", 2), ("FLW_TGT_HT", 20.0)):
        puppet.stack.parameters.set(name, value)
    last = puppet.seen.time + 30.0
    puppet.run(60.0, each=lead(3.0, 5.0, last))
    north, east, down = puppet.seen.position_ned
    assert (north - 3.0 * last, east, down) == pytest.approx((0.0, 22.0, -25.0), abs=2.0)
    assert puppet.seen.velocity_ned == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
    assert puppet.seen.attitude[2] == pytest.approx(-math.pi / 2, abs=0.1)


def test_a_target_far_below_is_not_followed_into_the_ground():
    puppet = flying()
    puppet.stack.parameters.set("FLW_TGT_ALT_M", 2)
    puppet.stack.set_mode(1, FOLLOW)
    puppet.run(20.0, each=lead(0.0, -50.0))
    assert puppet.seen.position_ned[2] == pytest.approx(-1.0, abs=0.1)
    for target in (
        FollowTarget(NAN, 8.5, 500.0),
        FollowTarget(47.0, 8.5, 1e30),
        FollowTarget(47.0, 8.5, 0.0, (1e30, 0, 0)),
    ):
        puppet.stack.follow_target(target)
    puppet.run(1.0)
    assert puppet.seen.position_ned[2] == pytest.approx(-1.0, abs=0.1)


# ---- sticks ----


def hold(roll: float = 0.0, pitch: float = 0.0, throttle: float = 0.0, yaw: float = 0.0):
    """Return what holds sticks, ten times a second."""

    def each(now: Puppet) -> None:
        if round(now.seen.time / DT) % 5 == 0:
            now.stack.sticks(roll, pitch, throttle, yaw)

    return each


def by_sticks(custom_mode: int) -> Puppet:
    """Return a puppet that hovers by sticks in the middle."""
    puppet = flying()
    puppet.stack.sticks(0.0, 0.0, 0.0, 0.0)
    assert puppet.stack.set_mode(1, custom_mode) == ACCEPTED
    puppet.run(1.0, each=hold())
    told = puppet.stack.heartbeat()
    # Custom, stabilised, manual input, armed.
    assert (told.custom_mode, told.base_mode) == (custom_mode, 1 + 16 + 64 + 128)
    return puppet


def test_sticks_fly_velocities_along_the_heading_and_hold_a_place():
    puppet = by_sticks(POSITION)
    # Half a turn a second is 150 deg/s times 0.4 x + 0.6 x^3 of the stick beyond a tenth.
    puppet.run(1.5, each=hold(yaw=0.55))
    assert puppet.seen.attitude[2] == pytest.approx(1.5 * math.radians(150.0) * (0.4 * 0.5 + 0.6 * 0.125), rel=0.05)
    puppet.run(8.0, each=hold(pitch=1.0))
    yaw = puppet.seen.attitude[2]
    north, east, down = puppet.seen.velocity_ned
    # Its controller flies 8 m/s at most.
    assert (north, east, down) == pytest.approx((8.0 * math.cos(yaw), 8.0 * math.sin(yaw), 0.0), abs=0.2)
    puppet.run(8.0, each=hold(roll=-0.55))
    assert puppet.seen.velocity_ned[:2] == pytest.approx((2.2 * math.sin(yaw), -2.2 * math.cos(yaw)), abs=0.1)
    puppet.run(4.0, each=hold(pitch=-0.09, throttle=0.09))
    here = puppet.seen.position_ned
    puppet.run(5.0, each=hold())
    assert puppet.seen.position_ned == pytest.approx(here, abs=0.05)
    puppet.run(5.0, each=hold(throttle=1.0))
    assert puppet.seen.velocity_ned[2] == pytest.approx(-3.0, abs=0.1)


def test_sticks_take_off_land_and_disarm():
    puppet = Puppet()
    assert puppet.stack.set_mode(1, POSITION) == REJECTED
    assert "'Position' is currently not possible: no manual control input" in puppet.stack.texts()[-1].text
    puppet.stack.sticks(0.0, 0.0, -1.0, 0.0)
    assert puppet.stack.set_mode(1, POSITION) == ACCEPTED
    puppet.run(1.0)
    # They are gone again.
    assert puppet.do(400, 1) == REJECTED
    assert puppet.stack.texts()[-1].text == "Preflight Fail: no manual control input"
    puppet.run(0.2, each=hold(throttle=-1.0))
    assert puppet.do(400, 1) == ACCEPTED
    # 0.3 of the way up takes off, without a lean while it stands.
    puppet.run(2.0, each=hold(pitch=1.0, throttle=0.25))
    assert puppet.seen.on_ground
    assert puppet.order.kind == "attitude"
    puppet.run(4.0, each=hold(throttle=0.8))
    assert puppet.seen.position_ned[2] < -3.0
    assert puppet.stack.heartbeat().landed is Landed.IN_AIR
    puppet.run(1.0, each=hold())
    assert puppet.run(30.0, lambda now: now.seen.on_ground, hold(throttle=-1.0))
    assert puppet.stack.heartbeat().landed is Landed.LANDING
    assert puppet.run(5.0, lambda now: not now.stack.armed, hold(throttle=-1.0))
    assert puppet.texts[-2:] == ["Landing detected", "Disarmed by landing"]


def test_altitude_leans_by_the_sticks_and_keeps_its_height():
    puppet = by_sticks(ALTITUDE)
    puppet.run(6.0, each=hold(pitch=1.0))
    # MPC_MAN_TILT_MAX, forwards.
    assert puppet.order.kind == "attitude"
    assert puppet.order.numbers[:2] == pytest.approx((0.0, -math.radians(35.0)))
    assert puppet.seen.position_ned[2] == pytest.approx(-10.0, abs=0.4)
    assert puppet.seen.velocity_ned[0] > 1.5
    puppet.run(6.0, each=hold(throttle=1.0))
    assert puppet.seen.velocity_ned[2] == pytest.approx(-3.0, abs=0.2)
    assert puppet.run(40.0, lambda now: not now.stack.armed, hold(throttle=-1.0))


def test_stabilized_is_tilt_and_thrust():
    puppet = by_sticks(STABILIZED)
    for throttle, thrust in ((0.0, 0.5), (0.5, 0.75), (1.0, 1.0), (-0.5, 0.25), (-1.0, 0.04)):
        puppet.run(0.2, each=hold(roll=1.0, pitch=1.0, throttle=throttle))
        roll, pitch, _, lift = puppet.order.numbers
        # Sticks in a corner tilt no more than in the middle of a side; the least thrust is 0.08 of both halves.
        tilt = math.radians(35.0) * math.sqrt(0.5)
        assert (roll, pitch, lift) == pytest.approx((tilt, -tilt, max(thrust, 0.08)), abs=1e-6)


@pytest.mark.parametrize(("action", "mode"), [(1, Mode.HOLD), (2, Mode.RTL), (3, Mode.LAND), (0, Mode.HOLD)])
def test_lost_sticks_are_a_failsafe(action, mode):
    puppet = by_sticks(POSITION)
    puppet.stack.parameters.set("NAV_RCL_ACT", action)
    puppet.run(0.45)
    assert puppet.stack.mode is Mode.POSITION
    puppet.run(0.2)
    assert puppet.stack.mode is mode
    assert "Failsafe: no manual control input" in puppet.texts


def test_sticks_that_move_take_over_from_automatic_modes():
    puppet = flying()
    puppet.do(20)
    puppet.run(1.0, each=hold())
    assert puppet.stack.mode is Mode.RTL
    puppet.stack.sticks(0.25, 0.0, 0.0, 0.0)
    assert puppet.stack.mode is Mode.RTL
    puppet.stack.sticks(0.6, 0.0, 0.0, 0.0)
    assert puppet.stack.mode is Mode.POSITION
    assert puppet.stack.texts()[-1].text == "Pilot took over using sticks"
    puppet.stack.set_mode(1, 0x03040000)
    puppet.stack.parameters.set("COM_RC_OVERRIDE", 0)
    puppet.stack.sticks(-0.6, 0.0, 0.0, 0.0)
    assert puppet.stack.mode is Mode.HOLD


def test_loiter_of_ardupilot_is_moved_by_sticks_while_there_are_any():
    puppet = flying("ardupilot")
    assert puppet.stack.set_mode(1, 5) == ACCEPTED
    puppet.run(3.0, each=hold(pitch=1.0))
    assert puppet.seen.velocity_ned[0] > 4.0
    assert puppet.stack.heartbeat().custom_mode == 5
    # RC_OVERRIDE_TIME is 3 s; then it stops.
    puppet.run(12.0)
    assert puppet.seen.velocity_ned == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    assert puppet.stack.heartbeat().custom_mode == 5
    puppet.stack.sticks(0.0, 0.0, 0.0, 0.0)
    assert puppet.stack.set_mode(1, 16) == ACCEPTED
    assert puppet.stack.heartbeat().custom_mode == 16
