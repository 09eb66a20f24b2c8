"""Missions, fences and rally points: what is accepted, which item is bad, and how they are flown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from puppet import EAST_DEG, NORTH_DEG, SITE, Puppet, flown, item, place

from qrsim.links.mavlink.stack.codes import Landed, MissionState, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN
from qrsim.links.mavlink.stack.fence import Fence
from qrsim.links.mavlink.stack.geodesy import Geodesy
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.models.geoid import undulation
from qrsim.models.scene.zone import in_polygon

TAKEOFF, WAYPOINT, LAND, RETURN, SPEED, DELAY, JUMP, LOITER_TIME, TURNS, TO_ALTITUDE = (
    22, 16, 21, 20, 178, 93, 177, 19, 18, 31
)  # fmt: skip
UNSET = (NAN,) * 4
MISSION, FENCE, RALLY = PlanKind.MISSION, PlanKind.FENCE, PlanKind.RALLY


def square() -> list:
    """A fence of 100 m round the origin, as a plan."""
    corners = [(-50, -50), (-50, 50), (50, 50), (50, -50)]
    return [item(i, 5001, *corner, 0.0, frame=5, params=(4, 0, 0, 0)) for i, corner in enumerate(corners)]


def test_a_mission_reaches_its_items_in_order_and_ends_landed_and_disarmed():
    items = [
        item(0, TAKEOFF, up=10.0, params=UNSET),
        item(1, WAYPOINT, 20, 0, 12.0),
        item(2, SPEED, frame=2, params=(1, 2.5, -1, NAN)),
        item(3, WAYPOINT, 20, 20, 12.0, params=(3.0, 1.0, NAN, 90.0)),
        item(4, DELAY, frame=2, params=(2, NAN, NAN, NAN)),
        item(5, 206, frame=2, params=(10, 0, 0, 0)),
        item(6, LAND, 10, 20, params=UNSET),
    ]
    puppet = flown(items)
    assert puppet.kinds("item_reached") == [0, 1, 2, 3, 4, 5, 6]
    assert puppet.stack.mission().seq == 6
    assert puppet.stack.mission().total == 7
    assert puppet.seen.position_ned == pytest.approx((10.0, 20.0, 0.0), abs=0.5)
    # LAND as the last item is reached where it has landed.
    assert puppet.stack.heartbeat().landed is Landed.ON_GROUND
    assert puppet.run(5.0, lambda now: not now.stack.armed)
    assert puppet.stack.mode is Mode.HOLD
    at = {event.number: time for time, event in puppet.told if event.kind == "item_reached"}
    # A hold of 3 s within 20 m at 2.5 m/s; the delay of 2 s.
    assert at[3] - at[2] > 20.0 / 2.5 - 1.0 + 3.0
    assert at[4] - at[3] == pytest.approx(2.0, abs=0.05)
    states = [Landed.TAKEOFF, Landed.IN_AIR, Landed.LANDING, Landed.ON_GROUND]
    assert len(puppet.kinds("landed")) == len(states)


def test_a_mission_without_a_take_off_rises_before_it_flies():
    puppet = Puppet()
    puppet.stack.accept(MISSION, [item(0, WAYPOINT, 40, 0, 8.0)])
    puppet.do(300)
    assert puppet.run(20.0, lambda now: now.seen.position_ned[2] < -7.1)
    assert abs(puppet.seen.position_ned[0]) < 0.5
    assert puppet.run(30.0, lambda now: now.stack.mode is Mode.HOLD)
    assert "Mission finished, loitering" in puppet.texts
    puppet.run(5.0)
    assert puppet.seen.position_ned == pytest.approx((40.0, 0.0, -8.0), abs=2.0)
    # Started again, it begins at its first item.
    assert puppet.stack.set_mode(1, 0x04040000) == 0
    assert puppet.stack.mission().seq == 0


def test_speed_changes_hold_from_there_on():
    items = [
        item(0, TAKEOFF, up=5.0),
        item(1, SPEED, frame=2, params=(1, 3.0, -1, 0)),
        item(2, WAYPOINT, 40, 0, 5.0),
    ]
    assert flown(items).fastest == pytest.approx(3.0, rel=0.03)
    items[1] = item(1, SPEED, frame=2, params=(1, 6.0, -1, 0))
    assert flown(items).fastest == pytest.approx(6.0, rel=0.03)


def test_a_mission_is_paused_resumed_and_set_to_an_item():
    items = [item(i, WAYPOINT, 30 * i + 1, 0, 10.0) for i in range(4)]
    puppet = Puppet()
    puppet.stack.accept(MISSION, items)
    assert puppet.stack.mission().state is MissionState.NOT_STARTED
    puppet.do(300)
    assert puppet.run(40.0, lambda now: now.stack.mission().seq == 2)
    assert puppet.stack.mission().in_mode
    puppet.stack.set_mode(1, 0x03040000)
    assert puppet.stack.mission().state is MissionState.PAUSED
    puppet.run(8.0)
    here = puppet.seen.position_ned
    puppet.run(2.0)
    assert puppet.seen.position_ned == pytest.approx(here, abs=0.05)
    assert not puppet.stack.set_current(4)
    assert puppet.do(224, 9) == 4
    assert puppet.do(224, 0) == 0
    puppet.stack.set_mode(1, 0x04040000)
    puppet.run(20.0, lambda now: now.stack.mission().seq == 1)
    assert puppet.seen.position_ned[0] < 5.0


def test_a_jump_repeats_as_often_as_it_says():
    items = [
        item(0, WAYPOINT, 5, 0, 5.0),
        item(1, WAYPOINT, 0, 5, 5.0),
        item(2, JUMP, frame=2, params=(0, 2, 0, 0)),
        item(3, RETURN, frame=2),
    ]
    puppet = flown(items)
    assert puppet.kinds("item_reached") == [0, 1, 2, 0, 1, 2, 0, 1, 2, 3]
    assert puppet.stack.mode is Mode.RTL


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_the_mission_item_is_set_and_the_mission_reset_as_autopilots_do(flavour):
    """PX4's navigator_main.cpp and the matrix of its tests: -1 keeps the item, 4 is FAILED, 2 DENIED."""
    puppet = Puppet(flavour)
    assert [puppet.do(224, *params) for params in ((-1, 1), (0, 0), (9, 1))] == [4, 4, 4]
    puppet.stack.accept(MISSION, [item(i, WAYPOINT, 5 * i + 5, 0, 5.0) for i in range(3)])
    given = {(-1, 0): 0, (-1, 1): 0, (2, 0): 0, (1, 1): 0, (3, 0): 4, (-2, 0): 2, (1.5, 0): 2, (1, 2): 2, (1, -1): 2}
    assert {params: puppet.do(224, *params) for params in given} == given
    assert puppet.stack.mission().seq == 1
    puppet.do(300)
    assert puppet.run(60.0, lambda now: now.stack.mission().state is MissionState.COMPLETE)
    assert puppet.do(224, -1, 0) == 0
    assert puppet.stack.mission().state is MissionState.COMPLETE
    assert puppet.do(224, -1, 1) == 0
    assert (puppet.stack.mission().state, puppet.stack.mission().seq) == (MissionState.PAUSED, 2)
    # ArduPilot's item 0 is home, and stands for the whole plan.
    assert puppet.do(224, 0) == 0
    assert puppet.stack.mission().seq == (0 if flavour == "px4" else 1)


@pytest.mark.parametrize(("reset", "visits"), [(0, 3), (1, 4)])
def test_a_reset_counts_jumps_from_zero_again(reset, visits):
    items = [item(0, TAKEOFF, up=5.0), item(1, WAYPOINT, 5, 0, 5.0), item(2, WAYPOINT, 0, 5, 5.0)]
    items += [item(3, JUMP, frame=2, params=(1, 2, 0, 0)), item(4, WAYPOINT, 5, 0, 5.0)]
    puppet = Puppet()
    puppet.stack.accept(MISSION, items)
    puppet.do(300)
    assert puppet.run(60.0, lambda now: now.kinds("item_reached").count(1) == 2)
    assert puppet.do(224, -1, reset) == 0
    assert puppet.run(60.0, lambda now: now.stack.mission().state is MissionState.COMPLETE)
    assert puppet.kinds("item_reached").count(1) == visits


@pytest.mark.parametrize(
    "others",
    [
        [item(1, JUMP, frame=2, params=(2, -1, 0, 0)), item(2, JUMP, frame=2, params=(1, -1, 0, 0))],
        [item(1, SPEED, frame=2, params=(1, 3.0, -1, 0)), item(2, JUMP, frame=2, params=(1, -1, 0, 0))],
    ],
)
def test_a_mission_that_jumps_for_ever_without_flying_ends(others):
    puppet = flown([item(0, WAYPOINT, 5, 0, 5.0), *others])
    assert puppet.stack.mode is Mode.HOLD
    assert puppet.texts[-2:] == ["DO JUMP is cycling, giving up", "Mission finished, loitering"]
    puppet.run(5.0)
    assert puppet.seen.position_ned == pytest.approx((5.0, 0.0, -5.0), abs=0.9)


def test_a_jump_for_ever_to_a_place_goes_on():
    puppet = Puppet()
    puppet.stack.accept(MISSION, [item(0, WAYPOINT, 1, 0, 5.0), item(1, JUMP, frame=2, params=(0, -1, 0, 0))])
    puppet.do(300)
    puppet.run(40.0)
    assert puppet.kinds("item_reached").count(1) > 255
    assert puppet.stack.mission().state is MissionState.ACTIVE


def test_loiters_take_their_time_and_turns_go_round():
    items = [
        item(0, LOITER_TIME, 0, 10, 6.0, params=(4.0, 0, 0, NAN)),
        item(1, TO_ALTITUDE, 0, 10, 12.0, params=UNSET),
        item(2, TURNS, 0, 10, 12.0, params=(1.5, 0, -6.0, NAN)),
    ]
    puppet = Puppet()
    puppet.stack.accept(MISSION, items)
    puppet.do(300)
    around: list[float] = []

    def watch(now: Puppet) -> None:
        if now.stack.mission().seq == 2:
            around.append(math.hypot(now.seen.position_ned[0], now.seen.position_ned[1] - 10.0))

    assert puppet.run(90.0, lambda now: now.stack.mission().state is MissionState.COMPLETE, watch)
    at = {event.number: time for time, event in puppet.told if event.kind == "item_reached"}
    assert -puppet.seen.position_ned[2] == pytest.approx(12.0, abs=0.3)
    # A turn and a half of 6 m radius at sqrt(0.5 * 3 * 6) = 3 m/s is 56.5 m, 18.8 s; 2 s for 5 of 6 m to its edge, and
    # 1 s for its slow end.
    assert at[2] - at[1] == pytest.approx(21.8, abs=1.5)
    assert np.median(around) == pytest.approx(6.0, abs=0.3)


def test_altitudes_are_over_sea_over_home_and_over_the_ground():
    for frame, up in ((0, 497.0), (5, 497.0), (3, 9.0), (6, 9.0), (10, 9.0), (11, 9.0)):
        puppet = flown([item(0, WAYPOINT, 10, 0, up, frame=frame, params=(2, 0, NAN, NAN))])
        assert -puppet.seen.position_ned[2] == pytest.approx(9.0, abs=0.85), frame
        puppet.run(4.0)
        assert -puppet.seen.position_ned[2] == pytest.approx(9.0, abs=0.1), frame


@pytest.mark.parametrize(
    ("changed", "result"),
    [
        ({"command": 82}, PlanResult.UNSUPPORTED),
        ({"frame": 1}, PlanResult.UNSUPPORTED_FRAME),
        ({"frame": 2}, PlanResult.UNSUPPORTED_FRAME),
        ({"x": 900_000_001}, PlanResult.INVALID_PARAM5_X),
        ({"y": -1_800_000_001}, PlanResult.INVALID_PARAM6_Y),
        ({"z": NAN}, PlanResult.INVALID_PARAM7),
        ({"z": math.inf}, PlanResult.INVALID_PARAM7),
        ({"params": (math.inf, 0.0, 0.0, 0.0)}, PlanResult.INVALID_PARAM1),
        ({"params": (0.0, 0.0, 0.0, -math.inf)}, PlanResult.INVALID_PARAM4),
        ({"command": JUMP, "params": (3.0, 1.0, 0.0, 0.0)}, PlanResult.INVALID_PARAM1),
        ({"command": SPEED, "params": (5.0, 1.0, 0.0, 0.0)}, PlanResult.INVALID_PARAM1),
        ({"command": SPEED, "params": (1.0, 0.0, 0.0, 0.0)}, PlanResult.INVALID_PARAM2),
        ({"command": TURNS, "params": (0.0, 0.0, 5.0, 0.0)}, PlanResult.INVALID_PARAM1),
    ],
)
def test_a_bad_item_is_named_and_the_old_mission_stays(changed, result):
    puppet = Puppet()
    good = [item(i, WAYPOINT, 10 * i + 1, 0, 5.0) for i in range(3)]
    puppet.stack.accept(MISSION, good)
    puppet.stack.texts()
    bad = [good[0], good[1], replace(good[2], **changed)]
    assert puppet.stack.accept(MISSION, bad) == (result, 2)
    assert puppet.stack.items(MISSION) == tuple(good)
    assert puppet.stack.texts()[-1].text == f"Mission refused at item 2: {result.name.lower()}"


def test_a_mission_outside_the_fence_is_kept_and_not_flown():
    puppet = Puppet()
    assert puppet.stack.accept(FENCE, square()) == (PlanResult.ACCEPTED, -1)
    items = [item(0, TAKEOFF, up=5.0), item(1, WAYPOINT, 60, 0, 5.0)]
    assert puppet.stack.accept(MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == 1
    assert not puppet.stack.armed
    assert [text.text for text in puppet.stack.texts()] == ["Mission rejected: item 1 is outside the fence"] * 2
    assert puppet.stack.accept(FENCE, []) == (PlanResult.ACCEPTED, -1)
    assert puppet.do(300) == 0


def test_a_mission_that_is_cleared_in_flight_is_held():
    puppet = Puppet()
    puppet.stack.accept(MISSION, [item(0, WAYPOINT, 80, 0, 8.0)])
    puppet.do(300)
    puppet.run(12.0)
    puppet.stack.accept(MISSION, [])
    assert puppet.stack.mode is Mode.HOLD
    assert puppet.stack.mission().state is MissionState.NO_MISSION
    puppet.run(10.0)
    assert 10.0 < puppet.seen.position_ned[0] < 60.0


# ---- fence and rally points ----


def test_a_reposition_outside_the_fence_is_denied():
    puppet = Puppet()
    puppet.stack.accept(FENCE, square())
    puppet.fly_up()
    assert puppet.do(192, -1, 1, 0, NAN, 47.397742 + 55.0 * NORTH_DEG, 8.545594, 498.0) == 2
    assert puppet.stack.texts()[-1].text == "Reposition is outside the fence"


def test_inclusions_are_united_and_exclusions_left_out():
    def circle(seq: int, command: int, north: float, radius: float):
        return item(seq, command, north, 1e-3, 0.0, frame=5, params=(radius, 0, 0, 0))

    geodesy = Geodesy(SITE)
    fence, result, bad = Fence.of([*square(), circle(4, 5003, 60.0, 20.0), circle(5, 5004, 20.0, 5.0)], geodesy)
    assert (result, bad) == (PlanResult.ACCEPTED, -1)
    inside = [fence.inside(north, 0.0) for north in (-51.0, -49.0, 14.0, 16.0, 24.0, 26.0, 55.0, 79.0, 81.0)]
    assert inside == [False, True, True, False, False, True, True, True, False]
    assert Fence().inside(1e6, 0.0)
    # A circle of radius 0 is none, as MAVSDK's example of a fence uploads it.
    fence, result, bad = Fence.of([circle(0, 5003, 60.0, 0.0)], geodesy)
    assert (fence.inside(0.0, 0.0), result, bad) == (True, PlanResult.ACCEPTED, -1)
    assert Fence().empty
    assert not in_polygon([(0, 0), (0, 2), (2, 0)], 1.5, 1.5)
    assert in_polygon([(0, 0), (0, 2), (2, 0)], 0.5, 0.5)


@pytest.mark.parametrize(
    ("changed", "result", "seq"),
    [
        ({2: {"params": (3.0, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 2),
        ({2: {"command": 5002}}, PlanResult.INVALID_PARAM1, 2),
        ({0: {"params": (2.0, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 0),
        ({0: {"params": (NAN, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 0),
        ({0: {"params": (1e300, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 0),
        ({0: {"params": (5.0, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 1),
        ({1: {"frame": 1}}, PlanResult.UNSUPPORTED_FRAME, 1),
        ({1: {"x": 2**31 - 1}}, PlanResult.INVALID_PARAM5_X, 1),
        ({0: {"command": 16}}, PlanResult.UNSUPPORTED, 0),
        ({0: {"command": 5003, "params": (-1.0, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 0),
        ({0: {"command": 5003, "params": (NAN, 0, 0, 0)}}, PlanResult.INVALID_PARAM1, 0),
    ],
)
def test_a_bad_fence_is_refused_and_the_old_one_stays(changed, result, seq):
    puppet = Puppet()
    puppet.stack.accept(FENCE, square())
    bad = [replace(corner, **changed.get(i, {})) for i, corner in enumerate(square())]
    assert puppet.stack.accept(FENCE, bad) == (result, seq)
    assert puppet.stack.items(FENCE) == tuple(square())


def test_a_fence_of_a_client_does_not_open_the_area_of_the_scenario():
    puppet = Puppet(fence=((-30.0, -30.0), (-30.0, 30.0), (30.0, 30.0), (30.0, -30.0)))
    # The square of the client reaches 50 m, and both hold; without a fence of a client the area does.
    for items in (square(), []):
        assert puppet.stack.accept(FENCE, items) == (PlanResult.ACCEPTED, -1)
        fence = puppet.stack.craft.fence
        assert [fence.inside(north, 0.0) for north in (-31.0, -29.0, 29.0, 31.0)] == [False, True, True, False]
        assert not fence.empty
    circle = item(0, 5003, 0.001, 0.0, 0.0, frame=5, params=(10.0, 0, 0, 0))
    assert puppet.stack.accept(FENCE, [circle]) == (PlanResult.ACCEPTED, -1)
    assert [puppet.stack.craft.fence.inside(north, 0.0) for north in (9.0, 11.0)] == [True, False]


@pytest.mark.parametrize(("name", "limit", "seq"), [("GF_MAX_HOR_DIST", 30.0, 1), ("GF_MAX_VER_DIST", 15.0, 2)])
def test_a_mission_beyond_the_largest_distance_is_not_flown(name, limit, seq):
    puppet = Puppet()
    puppet.stack.parameters.set(name, limit)
    items = [item(0, WAYPOINT, 29, 0, 14.0), item(1, WAYPOINT, 31, 0, 14.0), item(2, WAYPOINT, 29, 0, 16.0)]
    puppet.stack.accept(MISSION, items)
    assert puppet.stack.texts()[-1].text == f"Mission rejected: item {seq} is outside the fence"
    assert puppet.do(300) == 1
    puppet.stack.parameters.set(name, 40.0)
    assert puppet.do(300) == 0


def test_the_area_of_the_scenario_is_a_fence_that_is_downloaded():
    puppet = Puppet(fence=((-30.0, -30.0), (-30.0, 40.0), (20.0, 0.0)))
    items = puppet.stack.items(FENCE)
    assert [(one.command, one.frame, one.params[0]) for one in items] == [(5001, 5, 3.0)] * 3
    assert (items[1].x, items[1].y) == pytest.approx(place(-30.0, 40.0), abs=20)
    fence, result, _ = Fence.of(items, Geodesy(SITE))
    assert result is PlanResult.ACCEPTED
    assert fence.inside(0.0, 0.0)
    assert not fence.inside(21.0, 0.0)


def test_a_return_goes_to_the_nearest_rally_point():
    puppet = Puppet()
    puppet.stack.parameters.set("RTL_RETURN_ALT", 15.0)
    assert puppet.stack.accept(RALLY, [item(0, 5100, 60, 20, 12.0, frame=3)]) == (PlanResult.ACCEPTED, -1)
    assert puppet.stack.accept(RALLY, [item(0, 5100, 60, 20, NAN, frame=3)]) == (PlanResult.INVALID_PARAM7, 0)
    assert puppet.stack.accept(RALLY, [item(0, 16, 60, 20, 5.0)]) == (PlanResult.UNSUPPORTED, 0)
    puppet.fly_up()
    puppet.do(192, -1, 1, 0, NAN, 47.397742 + 50.0 * NORTH_DEG, 8.545594, 498.0)
    puppet.run(16.0)
    puppet.do(20)
    assert puppet.run(90.0, lambda now: not now.stack.armed)
    assert puppet.seen.position_ned[:2] == pytest.approx((60.0, 20.0), abs=0.5)


@pytest.mark.parametrize("datum", ["sea", "ellipsoid"])
def test_places_are_those_of_the_ellipsoid_and_altitudes_above_the_sea(datum):
    """Of the far place the geoid is extrapolated: to and fro agree, but it is not that of the place."""
    geodesy = Geodesy(SITE, datum)
    for north, east, down in ((0.0, 0.0, 0.0), (1500.0, -2300.0, -120.0), (-40_000.0, 30_000.0, 5.0)):
        latitude, longitude, height = SITE.ned_to_geodetic([north, east, down])
        degrees = math.degrees(latitude), math.degrees(longitude)
        found = geodesy.to_geodetic((north, east, down))
        assert found[:2] == pytest.approx(degrees, abs=1e-8)
        if datum == "ellipsoid":
            assert found[2] == pytest.approx(float(height), abs=1e-3)
        elif north > -40_000.0:
            assert float(height) - found[2] == pytest.approx(undulation(*degrees), abs=0.01)
        assert geodesy.to_ned(*degrees, found[2]) == pytest.approx((north, east, down), abs=1e-3)
    above = {"sea": 488.0, "ellipsoid": 535.22}[datum]
    assert geodesy.to_ned(47.397742 + 100 * NORTH_DEG, 8.545594 + 100 * EAST_DEG, above) == pytest.approx(
        (100.0, 100.0, 0.0), abs=0.1
    )
