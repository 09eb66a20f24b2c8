"""Fixed wings: missions of lines and circles, return, reposition, the fence, and what they cannot do."""

from __future__ import annotations

import math

import pytest
from puppet import DT, EAST_DEG, NORTH_DEG, SITE, command, item, place, polygon_zones

from qrsim.links.mavlink.stack.codes import FIXED_WING, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN, Facts, LocalTarget, Seen
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.stack.wing_stack import WingStack

WIDE = ((-1000.0, -1000.0), (-1000.0, 1000.0), (1000.0, 1000.0), (1000.0, -1000.0))
# Accepted, temporarily rejected, denied.
ACCEPTED, REJECTED, DENIED = 0, 1, 2


class Glider:
    """A point at 25 m/s that turns by at most 15 deg/s to what its stack orders, 100 m over the ground.

    Attributes:
        order: the last one, None while it goes by the scenario.
        trail: where it was, once a second [m].
    """

    def __init__(self, flavour="px4", fence=WIDE, z_min=-300.0, loiter_radius=150.0):
        facts = Facts(
            "w",
            kinds=frozenset({"track", "control"}),
            mav_type=FIXED_WING,
            zones=polygon_zones(fence),
            z_min=z_min,
            z_max=0.0,
            airspeed=25.0,
            airspeed_min=11.3,
            loiter_radius=loiter_radius,
            has_battery=True,
        )
        self.stack = WingStack(facts, SITE, flavour=flavour)
        self.seen = Seen(charge=0.8, present=0xF, healthy=0xF, on_ground=False)
        self.order, self.said, self.reached, self.trail = None, [], [], []
        self.put(0.0, 0.0, -100.0)
        self.run(2.0)

    def put(self, north, east, down, heading=0.0):
        seen = self.seen
        seen.position_ned, seen.attitude = (north, east, down), (0.0, 0.0, heading)
        seen.latitude, seen.longitude = 47.397742 + north * NORTH_DEG, 8.545594 + east * EAST_DEG
        seen.altitude = 488.0 - down

    def do(self, id, *params, frame=0):
        return int(self.stack.command(command(id, *params, frame=frame)).result)

    def upload(self, *items, kind=PlanKind.MISSION):
        return self.stack.accept(kind, items)

    def run(self, seconds, until=None):
        for tick in range(round(seconds / DT)):
            self.order = self.stack.tick(self.seen) or self.order
            self.said += [text.text for text in self.stack.texts()]
            self.reached += [event.number for event in self.stack.events() if event.kind == "item_reached"]
            self._move()
            if tick % 50 == 0:
                self.trail.append(self.seen.position_ned)
            if until is not None and until():
                return True
        return until is None

    def _move(self):
        seen = self.seen
        north, east, down = seen.position_ned
        heading, wanted, speed, climb = seen.attitude[2], seen.attitude[2], 25.0, 0.0
        if self.order is not None and self.order.kind == "track":
            *begin, x, y, z, radius, speed, _ = self.order.numbers
            wanted = self._bearing((north, east), begin, (x, y), radius)
            climb = min(max((z - down) / 3.0, -3.0), 3.0)
        turn = math.remainder(wanted - heading, 2.0 * math.pi)
        heading += min(max(turn, -0.26 * DT), 0.26 * DT)
        seen.velocity_ned = (speed * math.cos(heading), speed * math.sin(heading), climb)
        self.put(
            north + seen.velocity_ned[0] * DT,
            east + seen.velocity_ned[1] * DT,
            down + climb * DT,
            math.remainder(heading, 2.0 * math.pi),
        )
        seen.time = round(seen.time + DT, 6)

    @staticmethod
    def _bearing(here, begin, end, radius):
        """To a point ahead: 50 m on the line, 20 m on the circle."""
        if radius:
            away = math.atan2(here[1] - end[1], here[0] - end[0])
            ahead = away + math.copysign(20.0 / abs(radius), radius)
            goal = (end[0] + abs(radius) * math.cos(ahead), end[1] + abs(radius) * math.sin(ahead))
        else:
            way = math.atan2(end[1] - begin[1], end[0] - begin[0])
            along = (here[0] - begin[0]) * math.cos(way) + (here[1] - begin[1]) * math.sin(way) + 50.0
            goal = (begin[0] + along * math.cos(way), begin[1] + along * math.sin(way))
        return math.atan2(goal[1] - here[1], goal[0] - here[0])

    def radii(self, north, east, seconds):
        """Return the least and the largest distance from a place [m] in the last seconds."""
        away = [math.hypot(x - north, y - east) for x, y, _ in self.trail[-seconds:]]
        return min(away), max(away)


def test_it_goes_by_its_scenario_in_hold_until_it_is_asked():
    wing = Glider()
    beat = wing.stack.heartbeat()
    assert (wing.order, beat.custom_mode, beat.base_mode & 128, int(beat.landed)) == (None, 4 << 16 | 3 << 24, 128, 2)
    assert wing.do(176, 1, 4, 3) == ACCEPTED
    wing.run(60.0)
    # 2 s at 25 m/s, and round that place.
    assert wing.order.numbers[3:] == pytest.approx((50.0, 0.0, -100.0, 150.0, 25.0, 0.0), abs=0.6)
    assert wing.radii(50.0, 0.0, 30) == pytest.approx((150.0, 150.0), abs=8.0)


def test_a_change_of_altitude_of_ardupilot_holds_for_the_circle_that_it_flies():
    wing = Glider("ardupilot")
    for up, down in ((160.0, -160.0), (500.0, -160.0)):
        # Above home, in frame 3; the second one is above the ceiling.
        wing.stack.change_altitude(item(0, 16, up=up, frame=3))
        wing.run(60.0)
        assert wing.seen.position_ned[2] == pytest.approx(down, abs=1.0)
        assert wing.radii(50.0, 0.0, 20) == pytest.approx((150.0, 150.0), abs=8.0)
    assert wing.said[-1] == "Change of altitude denied: no height of the area"


def test_a_mission_of_lines_circles_and_speeds():
    wing = Glider()
    plan = (
        item(0, 16, 300.0, 0.0, 100.0),
        item(1, 178, params=(0, 20, -1, 0)),
        item(2, 18, 500.0, 300.0, 120.0, params=(1, 0, -160, 0)),
        item(3, 19, 0.0, 300.0, 120.0, params=(20, 0, 0, 0)),
        item(4, 16, -400.0, 0.0, 90.0, params=(5.0, 0, 0, NAN)),
    )
    assert wing.upload(*plan) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    assert wing.stack.mode is Mode.MISSION
    wing.run(1.0)
    # A line from where it was.
    assert wing.order.numbers == pytest.approx((50.0, 0.0, -100.0, 300.0, 0.0, -100.0, 0.0, 25.0, 0.0), abs=0.6)
    assert wing.run(30.0, lambda: wing.reached == [0, 1])
    # 40 m before its end the line is over: 250 - 40 m at 25 m/s.
    assert wing.seen.time == pytest.approx(2.0 + 210.0 / 25.0, abs=0.2)
    wing.run(1.0)
    # Home is the ground below the start: 120 m over it.
    assert wing.order.numbers[3:] == pytest.approx((500.0, 300.0, -120.0, -160.0, 20.0, 0.0), abs=0.6)
    begun = wing.seen.time
    assert wing.run(120.0, lambda: wing.reached == [0, 1, 2])
    # One turn of 160 m at 20 m/s is 50 s, and some way there.
    assert 50.0 < wing.seen.time - begun < 70.0
    assert wing.radii(500.0, 300.0, 40) == pytest.approx((160.0, 160.0), abs=8.0)
    assert wing.run(120.0, lambda: len(wing.reached) == 4)
    assert wing.run(120.0, lambda: len(wing.reached) == 5)
    assert wing.said[-1] == "Mission finished, loitering"
    wing.run(60.0)
    assert wing.stack.mode is Mode.HOLD
    # Round the last place.
    assert wing.order.numbers[3:7] == pytest.approx((-400.0, 0.0, -90.0, 150.0), abs=0.6)
    assert -wing.seen.position_ned[2] == pytest.approx(90.0, abs=1.0)


def test_a_circle_for_a_time_counts_from_when_it_is_reached():
    wing = Glider()
    assert wing.upload(item(0, 19, 600.0, 0.0, 100.0, params=(30, 0, 0, 0))) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    assert wing.run(80.0, lambda: wing.reached == [0])
    # To 190 m from it are 360 m, 14.4 s; then 30 s.
    assert wing.seen.time == pytest.approx(2.0 + 14.4 + 30.0, abs=2.0)


def test_a_line_that_ends_too_low_is_followed_by_a_climb_round_its_end():
    wing = Glider()
    assert wing.upload(item(0, 16, 300.0, 0.0, 200.0), item(1, 16, 800.0, 0.0, 200.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    wing.run(15.0)
    assert wing.reached == []
    assert wing.order.numbers[6] == 150.0
    assert wing.run(60.0, lambda: wing.reached == [0])
    # Within 10 m of it.
    assert -wing.seen.position_ned[2] == pytest.approx(190.0, abs=0.5)


def test_return_circles_home_at_the_height_of_a_return():
    wing = Glider()
    wing.run(20.0)
    assert wing.do(20) == ACCEPTED
    wing.run(90.0)
    # Home is where the first fix was, on the ground: RTL_RETURN_ALT is 60 m.
    assert wing.stack.home.position_ned == (0.0, 0.0, 0.0)
    assert wing.stack.mode is Mode.RTL
    assert wing.order.numbers[3:] == pytest.approx((0.0, 0.0, -60.0, 150.0, 25.0, 0.0), abs=0.6)
    assert wing.radii(0.0, 0.0, 30) == pytest.approx((150.0, 150.0), abs=8.0)
    assert -wing.seen.position_ned[2] == pytest.approx(60.0, abs=1.0)


def test_reposition_circles_there_at_a_radius_and_an_airspeed():
    wing = Glider()
    north, east = (number * 1e-7 for number in place(400.0, 200.0))
    assert wing.do(192, 22, 1, 110, 1, north, east, 80, frame=6) == ACCEPTED
    wing.run(60.0)
    # Yaw 1 is counterclockwise for planes.
    assert wing.order.numbers[3:] == pytest.approx((400.0, 200.0, -80.0, -110.0, 22.0, 0.0), abs=0.6)
    # 25 m/s squared over 9.81 m/s^2 tan 40 deg are 75.9 m.
    assert wing.do(192, 25, 1, 70, 0, north, east, 80, frame=6) == DENIED
    wing.run(DT)
    assert wing.said[-1] == "Command 192 denied: a radius of 70 m is too tight, at least 76 m"
    assert wing.do(192, 9, 1, 0, 0, north, east, 80, frame=6) == DENIED
    wing.run(DT)
    assert wing.said[-1] == "Command 192 denied: 9 m/s is below the stall at 11.3 m/s"
    north, east = (number * 1e-7 for number in place(900.0, 0.0))
    assert wing.do(192, -1, 1, 0, 0, north, east, 80, frame=6) == DENIED
    wing.run(DT)
    assert wing.said[-1] == "Command 192 denied: a circle of 150 m there leaves the fence"


@pytest.mark.parametrize(
    ("bad", "result", "why"),
    [
        (item(1, 22, 100.0, 0.0, 50.0), PlanResult.UNSUPPORTED, "there is no runway in this version"),
        (item(1, 21, 100.0, 0.0, 0.0), PlanResult.UNSUPPORTED, "there is no runway in this version"),
        (item(1, 18, 100.0, 0.0, 50.0, params=(1, 0, 60, 0)), PlanResult.INVALID_PARAM3, "at least 76 m"),
        (item(1, 17, 100.0, 0.0, 50.0, params=(0, 0, -20000, 0)), PlanResult.INVALID_PARAM3, "at most 10000 m"),
        (item(1, 31, 100.0, 0.0, 50.0, params=(1, 60, 0, 0)), PlanResult.INVALID_PARAM2, "at least 76 m"),
        (item(1, 178, params=(0, 10, -1, 0)), PlanResult.INVALID_PARAM2, "10 m/s is below the stall at 11.3 m/s"),
        (item(1, 178, params=(0, 38, -1, 0)), PlanResult.INVALID_PARAM2, "38 m/s is too fast, at most 37.5 m/s"),
        (item(1, 178, params=(2, 3, -1, 0)), PlanResult.INVALID_PARAM2, "changes its airspeed only"),
    ],
)
def test_items_that_it_cannot_fly_are_refused_with_the_reason(bad, result, why):
    wing = Glider()
    assert wing.upload(item(0, 16, 200.0, 0.0, 100.0), bad) == (result, 1)
    wing.run(DT)
    assert wing.said[0].startswith("Item 1: ")
    assert why in wing.said[0]


def test_a_circle_that_leaves_the_fence_is_not_flown():
    wing = Glider()
    assert wing.upload(item(0, 16, 900.0, 0.0, 100.0), item(1, 17, 900.0, 0.0, 100.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == REJECTED
    wing.run(DT)
    assert wing.said[-1] == "Mission rejected: item 1 is outside the fence"


def test_the_last_place_is_circled_inside_the_fence():
    wing = Glider()
    assert wing.upload(item(0, 16, 880.0, 0.0, 100.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    wing.run(120.0)
    assert (wing.stack.mode, wing.said[-1]) == (Mode.HOLD, "Mission finished, loitering")
    # From 880 m a tenth of the way to the middle of the area: 792 + 150 m and 20 m beside are inside 1000 m.
    assert wing.order.numbers[3:7] == pytest.approx((792.0, 0.0, -100.0, 150.0), abs=0.6)


def test_the_circle_of_a_climb_stays_inside_the_fence():
    wing = Glider()
    assert wing.upload(item(0, 16, 880.0, 0.0, 280.0), item(1, 16, 9.0, 0.0, 280.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    wing.run(37.0)
    assert wing.reached == []
    assert wing.order.numbers[3:7] == pytest.approx((792.0, 0.0, -280.0, 150.0), abs=0.6)
    assert wing.run(120.0, lambda: wing.reached == [0])
    assert not any("breached" in text for text in wing.said)


def test_a_plan_without_places_does_not_end_at_the_place_of_the_one_before():
    wing = Glider()
    assert wing.upload(item(0, 16, 700.0, 0.0, 100.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    wing.run(60.0)
    assert wing.upload(item(0, 93, params=(1.0, -1, -1, -1))) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    here = wing.seen.position_ned
    wing.run(2.0)
    # Within 50 m of where it was asked, not 150 m away on the circle round the place before.
    assert math.dist(wing.order.numbers[3:5], here[:2]) < 60.0


def test_commands_and_modes_that_it_cannot_obey():
    wing = Glider()
    for number in (21, 22):
        assert wing.do(number) == DENIED
        wing.run(DT)
        assert "neither takes off nor lands: there is no runway" in wing.said[-1]
    assert wing.do(178, 1, 8) == DENIED
    assert wing.do(176, 1, 6) == DENIED
    wing.run(DT)
    assert wing.said[-1] == "Mode denied: a fixed wing has no offboard"
    assert not wing.stack.setpoint(LocalTarget(1, 0xDF8, (0.0, 0.0, -10.0)))
    assert wing.do(400, 0) == REJECTED
    # By force the motor stops, and level wings glide.
    assert wing.do(400, 0, 21196) == ACCEPTED
    wing.run(DT)
    assert (wing.order.kind, wing.order.numbers) == ("control", (0.0, 0.0, 0.0))
    assert int(wing.stack.heartbeat().landed) == 2


def test_it_turns_before_it_leaves_the_area_and_circles_inside():
    wing = Glider(fence=((-400.0, -400.0), (-400.0, 400.0), (400.0, 400.0), (400.0, -400.0)))
    assert wing.upload(item(0, 16, 395.0, 0.0, 100.0), item(1, 17, 0.0, 0.0, 100.0)) == (PlanResult.ACCEPTED, -1)
    assert wing.do(300) == ACCEPTED
    assert wing.run(20.0, lambda: wing.stack.mode is Mode.HOLD)
    assert "Geofence breached: about to leave the area of the scenario" in wing.said
    # A second and a turn of 75.9 m before the edge.
    assert wing.seen.position_ned[0] == pytest.approx(400.0 - 25.0 - 75.9, abs=4.0)
    wing.run(90.0)
    assert max(abs(axis) for spot in wing.trail for axis in spot[:2]) < 400.0


def test_modes_of_ardupilots_plane():
    wing = Glider("ardupilot")
    assert wing.stack.heartbeat().custom_mode == 12
    # GUIDED, RTL.
    for number in (15, 11):
        assert wing.do(176, 1, number) == ACCEPTED
        assert wing.stack.heartbeat().custom_mode == number
