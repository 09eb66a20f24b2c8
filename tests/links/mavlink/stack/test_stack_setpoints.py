"""Set-points from outside: what is refused, how they are flown in every frame, and what happens without them."""

from __future__ import annotations

import math

import pytest
from puppet import DT, EAST_DEG, NORTH_DEG, Puppet

from qrsim.links.mavlink.stack.codes import Landed
from qrsim.links.mavlink.stack.contracts import NAN, AttitudeTarget, GlobalTarget, LocalTarget
from qrsim.links.mavlink.stack.modes import Mode

OFFBOARD = 0x00060000
NONE = (NAN, NAN, NAN)
# The masks that MAVSDK sends.
POSITION, VELOCITY, BOTH, ACCELERATION, BODY, ATTITUDE, RATES = 0x9F8, 0x9C7, 0x9C0, 0xC3F, 0x5C7, 0x07, 0x80


def position(north: float, east: float, down: float, frame: int = 1, yaw: float = 0.0) -> LocalTarget:
    return LocalTarget(frame, POSITION, (north, east, down), yaw=yaw)


def velocity(north: float, east: float, down: float, frame: int = 1, yaw: float = 0.0) -> LocalTarget:
    return LocalTarget(frame, VELOCITY, velocity=(north, east, down), yaw=yaw)


def flying(target, height: float = 10.0, **more) -> Puppet:
    """Return a puppet in OFFBOARD by a set-point, in the air."""
    puppet = Puppet(**more)
    puppet.fly_up(height)
    assert puppet.stack.setpoint(target)
    assert puppet.stack.set_mode(1, OFFBOARD) == 0
    return puppet


def keep(target):
    """Return what sends a set-point at every tick."""
    return lambda puppet: puppet.stack.setpoint(target)


def test_places_are_flown_to_with_their_heading():
    target = position(15.0, -8.0, -14.0, yaw=0.7)
    puppet = flying(target)
    puppet.run(20.0, each=keep(target))
    assert puppet.seen.position_ned == pytest.approx((15.0, -8.0, -14.0), abs=0.1)
    assert puppet.seen.attitude[2] == pytest.approx(0.7)
    assert puppet.stack.heartbeat().custom_mode == OFFBOARD


@pytest.mark.parametrize(("origin", "reached"), [("start", (41.0, -29.0, -12.0)), ("site", (1.0, 1.0, -12.0))])
def test_local_places_are_those_of_the_frame_that_began_with_the_estimator(origin, reached):
    puppet = Puppet(local_origin=origin)
    # It is elsewhere when it starts again.
    puppet.seen.position_ned = (40.0, -30.0, 0.0)
    puppet.stack.reset()
    puppet.run(2.0)
    puppet.fly_up(10.0)
    target = position(1.0, 1.0, -12.0)
    assert puppet.stack.setpoint(target)
    assert puppet.stack.set_mode(1, OFFBOARD) == 0
    puppet.run(20.0, each=keep(target))
    assert puppet.seen.position_ned == pytest.approx(reached, abs=0.1)


@pytest.mark.parametrize(("frame", "alt"), [(0, 500.0), (5, 500.0), (3, 12.0), (6, 12.0), (10, 12.0), (11, 12.0)])
def test_places_on_earth_are_flown_to(frame, alt):
    x, y = round((47.397742 + 6.0 * NORTH_DEG) * 1e7), round((8.545594 - 9.0 * EAST_DEG) * 1e7)
    target = GlobalTarget(frame, POSITION, x, y, alt, yaw=0.0)
    puppet = flying(target)
    puppet.run(12.0, each=keep(target))
    assert puppet.seen.position_ned == pytest.approx((6.0, -9.0, -12.0), abs=0.1)


@pytest.mark.parametrize(
    ("frame", "yaw", "flown"),
    [(1, 0.0, (2.0, 1.0, -0.5)), (7, 1.0, (2.0, 1.0, -0.5)), (8, math.pi / 2, (-1.0, 2.0, -0.5)),
     (9, math.pi, (-2.0, -1.0, -0.5)), (12, -math.pi / 2, (1.0, -2.0, -0.5))],
)  # fmt: skip
def test_velocities_are_flown_along_their_frame(frame, yaw, flown):
    target = velocity(2.0, 1.0, -0.5, frame, yaw)
    puppet = flying(target)
    # It turns first: frames of the body are those of the heading that it has.
    puppet.run(3.0, each=keep(target))
    assert puppet.seen.velocity_ned == pytest.approx(flown, abs=0.02)


def test_masks_of_old_examples_are_taken():
    # 0b0000111111000111: velocities alone, with the bit of forces.
    target = LocalTarget(1, 0b0000111111000111, (9.0, 9.0, 9.0), (1.0, 0.0, 0.0), (9.0, 9.0, 9.0))
    puppet = flying(target)
    puppet.run(3.0, each=keep(target))
    assert puppet.seen.velocity_ned == pytest.approx((1.0, 0.0, 0.0), abs=0.02)


def test_a_yaw_rate_turns_with_a_velocity_of_the_body():
    target = LocalTarget(8, BODY, velocity=(0.0, 0.0, 0.0), yaw_rate=0.5)
    puppet = flying(target)
    puppet.run(2.0, each=keep(target))
    assert puppet.seen.attitude[2] == pytest.approx(1.0, abs=0.02)


def test_a_place_with_a_velocity_is_followed_and_an_acceleration_felt():
    target = LocalTarget(1, BOTH, (5.0, 0.0, -10.0), (1.5, 0.0, 0.0), yaw=0.0)
    puppet = flying(target)
    puppet.run(DT, each=keep(target))
    assert puppet.order.kind == "path"
    assert puppet.order.numbers[:6] == (5.0, 0.0, -10.0, 1.5, 0.0, 0.0)
    target = LocalTarget(1, ACCELERATION, acceleration=(0.5, 0.0, 0.0))
    puppet.run(2 * DT, each=keep(target))
    assert puppet.order.numbers[6:9] == (0.5, 0.0, 0.0)


def test_speeds_are_limited_by_the_parameters_and_the_controller():
    target = velocity(30.0, 40.0, -9.0)
    puppet = flying(target)
    puppet.run(DT, each=keep(target))
    # The controller's 8 m/s, and 3 m/s up.
    assert puppet.order.numbers[:3] == pytest.approx((4.8, 6.4, -3.0))
    puppet.stack.parameters.set("MPC_XY_VEL_MAX", 5.0)
    puppet.stack.parameters.set("MPC_Z_VEL_MAX_UP", 2.0)
    puppet.run(DT, each=keep(target))
    assert puppet.order.numbers[:3] == pytest.approx((3.0, 4.0, -2.0))


def test_attitude_and_thrust_are_handed_on():
    # Roll 0.2, pitch -0.1, yaw 0.5, as the product of three turns.
    cr, sr, cp, sp, cy, sy = *(f(0.1) for f in (math.cos, math.sin)), math.cos(-0.05), math.sin(-0.05), *(
        f(0.25) for f in (math.cos, math.sin)
    )  # fmt: skip
    q = (
        cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy,
    )  # fmt: skip
    target = AttitudeTarget(ATTITUDE, q, (0.0, 0.0, 0.0), 0.55)
    puppet = flying(target)
    puppet.run(DT, each=keep(target))
    assert puppet.order.kind == "attitude"
    assert puppet.order.numbers == pytest.approx((0.2, -0.1, 0.5, 0.55))


@pytest.mark.parametrize(("thrust", "throttle"), [(0.0, 0.0), (0.25, 0.385), (0.5, 0.77), (0.75, 0.885), (1.0, 1.0)])
def test_half_thrust_carries_every_vehicle(thrust, throttle):
    puppet = Puppet()
    object.__setattr__(puppet.stack.facts, "hover_throttle", 0.77)
    assert puppet.stack.craft.throttle_of(thrust) == pytest.approx(throttle)
    assert puppet.stack.thrust_of(throttle) == pytest.approx(thrust)


GUIDED, GUIDED_NOGPS, COPTERS_LAND = 4, 20, 9


def climb(thrust: float, pitch: float = 0.0, mask: int = 0x04) -> AttitudeTarget:
    """DroneKit's example set_attitude_target has the mask 0b00000100."""
    return AttitudeTarget(mask, (math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0), (0.0, 0.0, 0.0), thrust)


@pytest.mark.parametrize("mode", [GUIDED, GUIDED_NOGPS])
def test_the_thrust_of_a_copters_attitude_is_a_climb(mode):
    """ArduPilot's GCS_MAVLINK_Copter: 0.5 holds the height, 1 climbs at WPNAV_SPEED_UP, 0 sinks at WPNAV_SPEED_DN."""
    puppet = Puppet("ardupilot")
    assert puppet.stack.set_mode(1, mode) == 0
    assert puppet.do(400, 1) == 0
    # On the ground neither takes off.
    puppet.run(2.0, each=keep(climb(0.5)))
    assert puppet.seen.on_ground
    assert puppet.run(20.0, lambda now: now.seen.position_ned[2] < -3.0, keep(climb(0.7)))
    puppet.run(4.0, each=keep(climb(0.5)))
    height = puppet.seen.position_ned[2]
    puppet.run(5.0, each=keep(climb(0.5, -0.2)))
    assert puppet.order.numbers[1] == pytest.approx(-0.2)
    assert puppet.seen.position_ned[2] == pytest.approx(height, abs=0.3)
    assert puppet.seen.velocity_ned[0] > 1.0
    # Of 3 m/s.
    puppet.run(4.0, each=keep(climb(0.75)))
    assert puppet.seen.velocity_ned[2] == pytest.approx(-1.5, abs=0.1)
    assert puppet.run(60.0, lambda now: not now.stack.armed, keep(climb(0.0)))
    assert puppet.texts[-2:] == ["Landing detected", "Disarmed by landing"]


def test_without_positions_a_copter_takes_attitudes_alone_and_is_level_without_them():
    puppet = flying_copter()
    assert puppet.stack.set_mode(1, GUIDED_NOGPS) == 0
    assert puppet.stack.heartbeat().custom_mode == GUIDED_NOGPS
    puppet.run(2.0, each=keep(climb(0.5, 0.1)))
    # After GUID_TIMEOUT, 3 s.
    puppet.run(2.9)
    assert puppet.order.numbers[1] == pytest.approx(0.1)
    puppet.run(0.2)
    assert puppet.order.numbers[:2] == (0.0, 0.0)
    height = puppet.seen.position_ned[2]
    puppet.run(10.0)
    assert puppet.seen.position_ned[2] == pytest.approx(height, abs=0.3)
    assert not puppet.stack.setpoint(position(0.0, 0.0, -20.0))
    assert puppet.stack.texts()[-1].text == "Set-point refused: GUIDED_NOGPS flies attitudes alone"
    assert puppet.stack.set_mode(1, COPTERS_LAND) == 0
    assert puppet.run(60.0, lambda now: not now.stack.armed)


def flying_copter() -> Puppet:
    puppet = Puppet("ardupilot")
    assert puppet.stack.set_mode(1, GUIDED) == 0
    assert puppet.do(400, 1) == 0
    assert puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 6.0) == 0
    assert puppet.run(40.0, lambda now: now.stack.mode.value == "hold")
    return puppet


def test_with_guid_options_8_thrust_is_thrust():
    puppet = flying_copter()
    puppet.stack.parameters.set("GUID_OPTIONS", 8)
    puppet.run(DT, each=keep(climb(0.6)))
    assert puppet.order.numbers[3] == pytest.approx(0.6)
    # PX4's OFFBOARD does not look at it.
    assert 20 not in [info.custom_mode for info in Puppet().stack.modes()]


@pytest.mark.parametrize("mask", [ATTITUDE, RATES])
def test_an_attitude_leans_nothing_that_stands(mask):
    """MAVSDK's example offboard_attitude arms, sends zero thrust and then 70 %; here with a lean from the start."""
    half = math.sin(0.2), math.cos(0.2)
    target = AttitudeTarget(mask, (half[1], half[0], 0.0, 0.0), (0.4, 0.0, 0.0), 0.4)
    puppet = Puppet()
    assert puppet.do(400, 1) == 0
    puppet.stack.setpoint(target)
    assert puppet.stack.set_mode(1, OFFBOARD) == 0
    puppet.run(2.0, each=keep(target))
    assert puppet.order.numbers == pytest.approx((0.0, 0.0, 0.0, 0.4))
    rising, rolls = AttitudeTarget(mask, target.q, target.rates, 0.7), []

    def lift(now: Puppet) -> None:
        keep(rising)(now)
        rolls.append(now.order.numbers[0])

    # It leans as it is asked once it is half a metre above the ground.
    assert puppet.run(2.0, lambda now: now.stack.craft.rose, lift)
    assert max(rolls) < 0.4
    assert sorted(rolls) == rolls
    puppet.run(1.0, each=lift)
    assert puppet.order.numbers[0] == pytest.approx(0.4, abs=0.05) or mask == RATES


def test_rates_add_up():
    target = AttitudeTarget(RATES, (1.0, 0.0, 0.0, 0.0), (0.2, -0.1, 0.4), 0.5)
    puppet = flying(target)
    puppet.run(0.5, each=keep(target))
    assert puppet.order.numbers == pytest.approx((0.1, -0.05, 0.2, 0.5), abs=0.001)


def test_a_tilt_is_commanded_as_the_platform_takes_it():
    puppet = flying(velocity(0.0, 0.0, 0.0))
    facts = puppet.stack.facts
    # The identified quadrotor settles at 0.745 of a command.
    object.__setattr__(facts, "roll_gain", 0.745)
    object.__setattr__(facts, "pitch_gain", 0.5)
    order = puppet.stack.craft.lean(0.149, 0.1, 0.4)
    assert order.numbers == pytest.approx((0.2, 0.2, puppet.stack.craft.yaw, 0.4))
    assert puppet.stack.craft.lean(2.0, -2.0, 0.4).numbers[:2] == (0.9, -0.9)


@pytest.mark.parametrize(
    ("target", "why"),
    [
        (position(NAN, 0.0, 0.0), "x has no number"),
        (velocity(0.0, 0.0, NAN), "z has no number"),
        (LocalTarget(1, 0xFFF, (0.0, 0.0, 0.0)), "x has no number"),
        (velocity(math.inf, 0.0, 0.0), "numbers too large"),
        (position(0.0, 1.1e6, 0.0), "numbers too large"),
        (LocalTarget(1, POSITION, (0.0, 0.0, 0.0), yaw=math.inf), "numbers too large"),
        (position(0.0, 0.0, 0.0, frame=2), "frame 2 is not supported"),
        (LocalTarget(1, 0xE3F, acceleration=(0.0, 0.0, 0.0)), "forces are not supported"),
        (GlobalTarget(1, POSITION, 0, 0, 0.0), "frame 1 is not supported"),
        (GlobalTarget(6, POSITION, 910_000_000, 0, 0.0), "no such place"),
        (GlobalTarget(6, POSITION, 0, 0, NAN), "x has no number"),
        (AttitudeTarget(ATTITUDE, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), NAN), "thrust nan, 0 to 1 needed"),
        (AttitudeTarget(ATTITUDE, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.1), "thrust 1.1, 0 to 1 needed"),
        (AttitudeTarget(ATTITUDE, (NAN, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), "quaternion is none"),
        (AttitudeTarget(ATTITUDE, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), "quaternion is none"),
        (AttitudeTarget(0x87, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), "neither attitude nor rates"),
        (AttitudeTarget(RATES, (1.0, 0.0, 0.0, 0.0), (NAN, 0.0, 0.0), 0.5), "rates are not finite"),
        (AttitudeTarget(0x47, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), "no thrust"),
    ],
)
def test_bad_set_points_are_refused_and_said_once(target, why):
    puppet = Puppet()
    for _ in range(20):
        assert not puppet.stack.setpoint(target)
    assert [text.text for text in puppet.stack.texts()] == [f"Set-point refused: {why}"]
    # They are no proof of life either.
    assert puppet.stack.set_mode(1, OFFBOARD) == 1
    assert "Offboard rejected" in puppet.stack.texts()[-1].text


@pytest.mark.parametrize("factor", [0.5, 1.0, 5.0])
def test_offboard_is_lost_after_its_time_which_is_of_the_wall_when_faster(factor):
    target = velocity(1.0, 0.0, 0.0)
    puppet = flying(target, factor=factor)
    puppet.run(2.0, each=keep(target))
    last = puppet.seen.time
    assert puppet.run(20.0, lambda now: now.stack.mode is not Mode.OFFBOARD)
    # COM_OF_LOSS_T, 1 s.
    assert puppet.seen.time - last == pytest.approx(1.0 * max(1.0, factor), abs=1.01 * DT)
    assert puppet.stack.mode is Mode.HOLD
    assert puppet.stack.heartbeat().system_status == 5
    assert puppet.texts[-2:] == ["Failsafe: no offboard set-points", "Failsafe activated: hold"]
    puppet.run(5.0)
    here = puppet.seen.position_ned
    puppet.run(2.0)
    assert puppet.seen.position_ned == pytest.approx(here, abs=0.05)


@pytest.mark.parametrize(("action", "mode", "armed"), [(3, Mode.RTL, True), (4, Mode.LAND, True), (5, Mode.HOLD, True),
                                                       (6, Mode.HOLD, False), (7, Mode.HOLD, False)])  # fmt: skip
def test_what_follows_a_loss_of_offboard(action, mode, armed):
    puppet = flying(velocity(0.0, 0.0, 0.0))
    puppet.stack.parameters.set("COM_OBL_RC_ACT", action)
    puppet.run(1.5)
    assert (puppet.stack.mode, puppet.stack.armed) == (mode, armed)
    assert puppet.stack.craft.terminated == (action == 6)


def test_offboard_takes_off_lands_and_disarms():
    puppet = Puppet()
    up, down = velocity(0.0, 0.0, -1.0), velocity(0.0, 0.0, 0.7)
    puppet.stack.setpoint(down)
    puppet.stack.set_mode(1, OFFBOARD)
    assert puppet.do(400, 1) == 0
    puppet.run(1.0, each=keep(down))
    assert puppet.order.numbers[3] == 0.0
    puppet.run(5.0, each=keep(up))
    assert puppet.highest > 4.0
    assert puppet.stack.heartbeat().landed is Landed.IN_AIR
    assert puppet.run(20.0, lambda now: not now.stack.armed, keep(down))
    assert puppet.seen.on_ground
    assert puppet.texts[-2:] == ["Landing detected", "Disarmed by landing"]


@pytest.mark.parametrize(("down", "lands"), [(3.0, True), (0.0, True), (-0.19, True), (-0.21, False)])
def test_a_place_below_the_ground_or_hardly_above_lands(down, lands):
    # At the end of a square at (0, 0, 0) again, the estimate of height has drifted: a hover there drags the feet.
    target = position(0.0, 0.0, down)
    puppet = flying(target, 4.0)
    assert puppet.run(30.0, lambda now: not now.stack.armed, keep(target)) is lands


def test_guided_flies_set_points_at_once_and_holds_without():
    puppet = Puppet("ardupilot")
    puppet.do(400, 1)
    puppet.do(176, 1, 4)
    puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 5.0)
    puppet.run(10.0)
    target = velocity(1.0, 0.0, 0.0)
    puppet.run(2.0, each=keep(target))
    assert puppet.seen.velocity_ned[0] == pytest.approx(1.0, abs=0.02)
    assert puppet.stack.heartbeat().custom_mode == 4
    # GUID_TIMEOUT of ArduPilot, 3 s.
    puppet.run(2.9)
    assert puppet.seen.velocity_ned[0] == pytest.approx(1.0, abs=0.02)
    puppet.run(5.0)
    assert puppet.stack.heartbeat().custom_mode == 4
    assert puppet.stack.heartbeat().system_status == 4
    assert not [text for text in puppet.texts if "ailsafe" in text]
    assert abs(puppet.seen.velocity_ned[0]) < 0.05


def guided(target) -> Puppet:
    """Return a puppet in ArduPilot's GUIDED, 5 m up, that has had one set-point."""
    puppet = Puppet("ardupilot", fence=((-30.0, -30.0), (-30.0, 30.0), (30.0, 30.0), (30.0, -30.0)))
    puppet.do(400, 1)
    puppet.do(176, 1, 4)
    puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 5.0)
    puppet.run(10.0)
    assert puppet.stack.setpoint(target)
    return puppet


def test_a_place_is_kept_in_guided_where_it_is_said_once():
    puppet = guided(position(20.0, 0.0, -6.0))
    # At the speed that is asked for.
    assert puppet.do(178, 1, 2, -1) == 0
    puppet.run(5.0)
    assert math.hypot(*puppet.seen.velocity_ned[:2]) == pytest.approx(2.0, abs=0.1)
    puppet.run(15.0)
    assert puppet.seen.position_ned == pytest.approx((20.0, 0.0, -6.0), abs=0.1)
    assert puppet.stack.heartbeat().custom_mode == 4
    assert not [text for text in puppet.texts if "ailsafe" in text]
    # A velocity is not, after 3 s.
    back = velocity(-2.0, 0.0, 0.0)
    puppet.run(2.0, each=keep(back))
    puppet.run(10.0)
    assert 8.0 < puppet.seen.position_ned[0] < 12.0


def test_a_place_that_is_said_before_a_take_off_is_over_is_flown_to():
    puppet = Puppet("ardupilot")
    puppet.do(400, 1)
    puppet.do(176, 1, 4)
    puppet.do(22, NAN, NAN, NAN, NAN, NAN, NAN, 10.0)
    # On the ground it is not.
    assert puppet.stack.setpoint(position(20.0, 0.0, -12.0))
    assert puppet.stack.mode is Mode.TAKEOFF
    assert puppet.run(20.0, lambda now: -now.seen.position_ned[2] > 9.5)
    assert puppet.stack.mode is Mode.TAKEOFF
    assert puppet.stack.setpoint(position(20.0, 0.0, -12.0))
    puppet.run(15.0)
    assert puppet.seen.position_ned == pytest.approx((20.0, 0.0, -12.0), abs=0.1)


def test_the_fence_ends_guided_while_set_points_come():
    target = velocity(4.0, 0.0, 0.0)
    puppet = guided(target)
    puppet.run(20.0, each=keep(target))
    # LOITER, inside.
    assert puppet.stack.heartbeat().custom_mode == 5
    assert 20.0 < puppet.seen.position_ned[0] < 30.0


def test_who_holds_below_the_height_where_it_stood_stays_there():
    """Over a valley, 50 m below the hill that it took off from."""
    puppet = Puppet()
    puppet.fly_up(10.0)
    puppet.stack.craft.stood_z = -60.0
    assert puppet.stack.set_mode(1, 0x03040000) == 0
    puppet.run(10.0)
    assert puppet.stack.armed
    assert puppet.seen.position_ned[2] == pytest.approx(-10.0, abs=0.5)


def test_a_landing_before_counts_for_nothing_at_the_next_one():
    puppet = Puppet()
    puppet.fly_up(10.0)
    assert puppet.do(21) == 0
    assert puppet.run(60.0, lambda now: not now.stack.armed)
    puppet.run(5.0)
    puppet.fly_up(10.0)
    assert puppet.do(192, -1, 1, 0, NAN, 47.397742, 8.545594, 0.1, frame=6) == 0
    orders = set()
    puppet.run(1.0, each=lambda now: orders.add(now.order.kind))
    assert orders == {"path"}
    assert puppet.run(60.0, lambda now: not now.stack.armed)


def test_a_place_with_a_velocity_on_the_ground_lands_there():
    """A hundred metres from where it began: the descent begins where the vehicle is."""
    puppet = Puppet()
    puppet.fly_up(10.0)
    begin = puppet.seen.time

    def target(now):
        t = now.seen.time - begin
        down = min(max(-10.0 + 0.7 * (t - 25.0), -10.0), 0.0)
        speed = (4.0, 0.0, 0.0) if t < 25.0 else (0.0, 0.0, 0.7 if down < 0.0 else 0.0)
        now.stack.setpoint(LocalTarget(1, BOTH, (min(4.0 * t, 100.0), 0.0, down), speed, yaw=0.0))

    target(puppet)
    assert puppet.stack.set_mode(1, OFFBOARD) == 0
    assert puppet.run(70.0, lambda now: not now.stack.armed, target)
    assert puppet.seen.position_ned[0] == pytest.approx(100.0, abs=1.0)
    assert puppet.fastest < 12.5
