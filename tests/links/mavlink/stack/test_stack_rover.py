"""Rovers: set-points of position and velocity, reposition, and what they cannot do."""

from __future__ import annotations

import math

import pytest
from puppet import DT, EAST_DEG, NORTH_DEG, SITE, command, item, place, polygon_zones

from qrsim.links.mavlink.stack.codes import GROUND_ROVER, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, AttitudeTarget, Facts, GlobalTarget, LocalTarget, Seen
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.rover_stack import RoverStack

# Position alone, velocity alone, both; the acceleration and yaw and its rate are left out of all.
POSITION, VELOCITY, BOTH = 0xDF8, 0xDC7, 0xDC0
FENCE = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))
ACCEPTED, REJECTED, DENIED = 0, 1, 2


class Cart:
    """A point on the ground that does what its stack orders, at 2.5 m/s at most."""

    def __init__(self, flavour="px4"):
        facts = Facts("r", mav_type=GROUND_ROVER, zones=polygon_zones(FENCE), speed_limit=2.5)
        self.stack = RoverStack(facts, SITE, flavour=flavour)
        self.seen = Seen(present=0xF, healthy=0xF, altitude=488.0, latitude=47.397742, longitude=8.545594)
        self.order, self.said = None, []
        self.run(2.0)

    def do(self, id, *params, frame=0):
        return int(self.stack.command(command(id, *params, frame=frame)).result)

    def run(self, seconds, each=None):
        for _ in range(round(seconds / DT)):
            if each is not None:
                assert self.stack.setpoint(each)
            self.order = self.stack.tick(self.seen) or self.order
            self.said += [text.text for text in self.stack.texts()]
            self._move()

    def offboard(self, target, seconds):
        """Send a set-point at every tick in OFFBOARD."""
        self.run(0.1, target)
        if self.stack.mode is not Mode.OFFBOARD:
            assert self.do(176, 1, 6) == ACCEPTED
            assert self.do(400, 1) == ACCEPTED
        self.run(seconds, target)

    def _move(self):
        kind, numbers, seen = self.order.kind, self.order.numbers, self.seen
        north, east, _ = seen.position_ned
        if kind == "velocity":
            vn, ve = numbers[:2]
        else:
            at, speed = (3, numbers[7]) if kind == "track" else (0, math.inf)
            ahead = numbers[3:5] if kind == "path" else (0.0, 0.0)
            vn, ve = (ahead[axis] + 0.8 * (numbers[at + axis] - (north, east)[axis]) for axis in (0, 1))
            ratio = min(1.0, speed / max(math.hypot(vn, ve), 1e-9))
            vn, ve = ratio * vn, ratio * ve
        seen.velocity_ned = (vn, ve, 0.0)
        seen.position_ned = (north + vn * DT, east + ve * DT, 0.0)
        seen.latitude, seen.longitude = 47.397742 + north * NORTH_DEG, 8.545594 + east * EAST_DEG
        seen.time = round(seen.time + DT, 6)


def test_a_place_is_driven_to_at_the_largest_speed_and_it_stops_there():
    cart = Cart()
    # No height is needed: its bit is left out too.
    cart.offboard(LocalTarget(1, POSITION | 0x4, (20.0, 10.0, NAN)), 4.0)
    assert math.hypot(*cart.seen.velocity_ned[:2]) == pytest.approx(2.5)
    # A line to the place from the place, to stop.
    assert cart.order.kind == "track"
    assert cart.order.numbers == pytest.approx((20.0, 10.0, 0.0, 20.0, 10.0, 0.0, 0.0, 2.5, 1.0))
    cart.run(15.0, LocalTarget(1, POSITION, (20.0, 10.0, -5.0)))
    assert cart.seen.position_ned == pytest.approx((20.0, 10.0, 0.0), abs=0.05)


def test_velocities_are_driven_and_limited_and_a_place_with_one_is_followed():
    cart = Cart()
    cart.offboard(LocalTarget(1, VELOCITY, velocity=(1.0, -0.5, 0.0)), 4.0)
    assert (cart.order.kind, cart.order.numbers[:3]) == ("velocity", (1.0, -0.5, 0.0))
    assert cart.seen.position_ned == pytest.approx((4.0, -2.0, 0.0), abs=0.2)
    cart.run(0.1, LocalTarget(1, VELOCITY, velocity=(30.0, 40.0, 0.0)))
    # 2.5 m/s along (0.6, 0.8).
    assert cart.order.numbers[:2] == pytest.approx((1.5, 2.0))
    cart.run(0.1, LocalTarget(1, BOTH, (5.0, 5.0, 0.0), (0.0, 1.0, 0.0)))
    assert (cart.order.kind, cart.order.numbers[:6]) == ("path", (5.0, 5.0, 0.0, 0.0, 1.0, 0.0))
    # Along the heading, which is east.
    cart.seen.attitude = (0.0, 0.0, math.pi / 2.0)
    cart.run(0.1, LocalTarget(8, VELOCITY, velocity=(2.0, 0.0, 0.0)))
    assert cart.order.numbers[:2] == pytest.approx((0.0, 2.0), abs=1e-9)


def test_places_of_latitude_and_longitude():
    cart = Cart()
    x, y = place(-30.0, 12.0)
    cart.offboard(GlobalTarget(6, POSITION, x, y, 0.0), 0.1)
    assert cart.order.numbers[3:5] == pytest.approx((-30.0, 12.0), abs=0.05)


def test_without_setpoints_it_stops():
    cart = Cart()
    cart.offboard(LocalTarget(1, VELOCITY, velocity=(2.0, 0.0, 0.0)), 2.0)
    cart.run(0.9)
    assert cart.stack.mode is Mode.OFFBOARD
    # COM_OF_LOSS_T is 1 s.
    cart.run(0.2)
    assert cart.stack.mode is Mode.HOLD
    assert cart.order.numbers == (0.0, 0.0, 0.0, 0.0)
    assert "Failsafe: no offboard set-points" in cart.said


@pytest.mark.parametrize(
    ("target", "why"),
    [
        (LocalTarget(1, 0xC3F, acceleration=(1.0, 0.0, 0.0)), "a rover needs a place or a velocity, of both axes"),
        (LocalTarget(1, POSITION | 0x1, (NAN, 1.0, 0.0)), "x has no number"),
        (AttitudeTarget(0x7, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5), "a rover has no attitude to fly"),
    ],
)
def test_setpoints_that_it_cannot_drive(target, why):
    cart = Cart()
    assert not cart.stack.setpoint(target)
    cart.run(DT)
    assert cart.said[-1] == f"Set-point refused: {why}"
    assert cart.do(176, 1, 6) == REJECTED


def test_reposition_drives_there_and_holds():
    cart = Cart()
    north, east = (number * 1e-7 for number in place(-8.0, 6.0))
    assert cart.do(192, -1, 1, 0, NAN, north, east, 0, frame=6) == REJECTED
    assert cart.do(400, 1) == ACCEPTED
    assert cart.do(192, 1.5, 1, 0, NAN, north, east, 0, frame=6) == ACCEPTED
    cart.run(3.0)
    assert cart.stack.mode is Mode.HOLD
    assert math.hypot(*cart.seen.velocity_ned[:2]) == pytest.approx(1.5)
    cart.run(15.0)
    assert cart.seen.position_ned == pytest.approx((-8.0, 6.0, 0.0), abs=0.1)
    north, east = (number * 1e-7 for number in place(120.0, 0.0))
    assert cart.do(192, -1, 1, 0, NAN, north, east, 0, frame=6) == DENIED
    assert cart.do(400, 0) == ACCEPTED
    cart.run(DT)
    assert cart.order.numbers == (0.0, 0.0, 0.0, 0.0)


def test_it_neither_lands_nor_takes_off():
    cart = Cart()
    for number in (21, 22):
        assert cart.do(number) == DENIED
    assert cart.stack.accept(PlanKind.MISSION, [item(0, 22, 5.0, 0.0, 5.0)]) == (PlanResult.UNSUPPORTED, 0)


def test_guided_of_ardupilots_rover_drives_setpoints_at_once():
    cart = Cart("ardupilot")
    assert cart.stack.heartbeat().custom_mode == 4
    assert cart.do(176, 1, 15) == ACCEPTED
    assert cart.do(400, 1) == ACCEPTED
    cart.run(1.0, LocalTarget(1, VELOCITY, velocity=(1.0, 0.0, 0.0)))
    assert cart.stack.heartbeat().custom_mode == 15
    assert cart.order.numbers[0] == 1.0
    cart.run(2.9)
    assert cart.order.numbers[0] == 1.0
    cart.run(0.2)
    assert (cart.stack.heartbeat().custom_mode, cart.order.numbers[0]) == (15, 0.0)
