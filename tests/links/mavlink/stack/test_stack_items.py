"""Plan items beside places: those that move nothing, gates, and what ArduPilot waits for on the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from puppet import Puppet, flown, item

from qrsim.links.mavlink.stack.codes import MissionState, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import NAN

TAKEOFF, WAYPOINT, SPEED = 22, 16, 178
MISSION = PlanKind.MISSION


# Numbers of MAV_CMD that PX4's FeasibilityChecker and MavlinkMissionManager, and ArduPilot's AP_Mission, take in a plan
# and that turn cameras, gimbals, grippers, winches, relays and servos, which no vehicle here has.
BY_PX4 = (80, 187, 189, 195, 196, 197, 200, 201, 203, 204, 205, 206, 211, 212, 214, 260, 530, 531, 532, 1000, 1001,
          2000, 2001, 2003, 2500, 2501, 2502, 2503, 42600)  # fmt: skip
BY_ARDUPILOT = (181, 182, 183, 184, 189, 195, 201, 203, 205, 206, 207, 211, 2000, 42600)


@pytest.mark.parametrize(("flavour", "commands"), [("px4", BY_PX4), ("ardupilot", BY_ARDUPILOT)])
def test_items_that_move_nothing_are_reached_at_once(flavour, commands):
    nothing = [item(i, one, frame=2, params=(1, 0, 0, 0)) for i, one in enumerate(commands, 2)]
    last = len(nothing) + 2
    items = [item(0, TAKEOFF, up=5.0), item(1, WAYPOINT, 5, 0, 5.0), *nothing, item(last, WAYPOINT, 5, 5, 5.0)]
    puppet = flown(items, flavour=flavour)
    assert puppet.kinds("item_reached") == list(range(1 if flavour == "ardupilot" else 0, last + 1))
    at = {event.number: time for time, event in puppet.told if event.kind == "item_reached"}
    assert at[last - 1] - at[2] < 0.1


@pytest.mark.parametrize(
    ("flavour", "command"),
    [
        *(("px4", one) for one in (82, 114, 115, 181, 183, 207, 208, 3000)),
        *(("ardupilot", one) for one in (4501, 208, 3000)),
    ],
)
def test_items_of_the_other_autopilot_are_refused(flavour, command):
    puppet = Puppet(flavour)
    items = [item(0, WAYPOINT, 5, 0, 5.0), item(1, command, 9, 0, 5.0, params=(1, 0, 0, 0))]
    assert puppet.stack.accept(MISSION, items) == (PlanResult.UNSUPPORTED, 1)


def reached_at(items: list, flavour: str) -> dict[int, tuple[float, float]]:
    """Fly a mission, and return where (north, heading) each item was reached."""
    puppet, found = Puppet(flavour), {}
    assert puppet.stack.accept(MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.stack.set_mode(1, 3 if flavour == "ardupilot" else 0x04040000) == 0
    assert puppet.do(400, 1) == 0

    def note(now: Puppet) -> None:
        for number in now.kinds("item_reached"):
            found.setdefault(number, (now.seen.position_ned[0], now.seen.attitude[2]))

    assert puppet.run(90.0, lambda now: now.stack.mission().state is MissionState.COMPLETE, note)
    return found


def test_a_gate_is_passed_on_the_way_to_the_next_place():
    # The plane lies 20 m north; how far beside it is passed does not count.
    slower = item(2, SPEED, frame=2, params=(1, 3, 0, 0))
    items = [item(0, TAKEOFF, up=5.0), item(1, 4501, 20, 30, 0.0), slower, item(3, WAYPOINT, 40, 30, 5.0)]
    found = reached_at(items, "px4")
    assert found[1][0] == pytest.approx(20.0, abs=0.3)
    assert found[2][0] == pytest.approx(20.0, abs=0.3)
    # Without a place to fly to nothing is waited for.
    assert list(reached_at([item(0, TAKEOFF, up=5.0), item(1, 4501, 20, 0, 0.0)], "px4")) == [0]


def test_conditions_of_ardupilot_hold_on_the_way_to_the_next_place():
    items = [
        item(0, WAYPOINT, up=0.0),
        item(1, TAKEOFF, up=5.0),
        item(2, 114, frame=2, params=(8.0, 0, 0, 0)),
        item(3, 115, frame=2, params=(90.0, 0, 0, 0)),
        item(4, 82, 30, 0, 5.0, params=(0, 0, 0, 0)),
        item(5, 115, frame=2, params=(30.0, 0, -1, 1)),
        item(6, WAYPOINT, 60, 0, 5.0, params=(0, 0, 0, 180.0)),
        item(7, WAYPOINT, 90, 0, 5.0),
    ]
    found = reached_at(items, "ardupilot")
    # Eight metres before the spline waypoint it turns east, and flies on so; then 30 degrees to the left of that.
    assert found[2][0] == pytest.approx(22.0, abs=0.3)
    assert found[4] == pytest.approx((28.0, math.pi / 2), abs=0.3)
    assert found[6] == pytest.approx((58.0, math.pi / 3), abs=0.3)


@pytest.mark.parametrize(
    ("changed", "home"),
    [
        ({"params": (1, 0, 0, 0)}, (10.0, 0.0, 5.0)),
        ({}, (20.0, 8.0, 3.0)),
        ({"frame": 2, "z": 491.0}, (20.0, 8.0, 3.0)),
    ],
)
def test_home_is_set_by_an_item(changed, home):
    there = replace(item(2, 179, 20, 8, 3.0, params=(0, 0, 0, 0)), **changed)
    puppet = flown(
        [
            item(0, TAKEOFF, up=5.0),
            item(1, WAYPOINT, 10, 0, 5.0, params=(0, 0.1, NAN, NAN)),
            there,
            item(3, WAYPOINT, 11, 0, 5.0),
        ]
    )
    north, east, down = puppet.stack.home.position_ned
    assert (north, east, -down) == pytest.approx(home, abs=0.9)


def track(items: list, flavour: str, **more) -> np.ndarray:
    """Fly a mission, and return the places NED [m] of every tick."""
    puppet, found = Puppet(flavour, **more), []
    assert puppet.stack.accept(MISSION, items) == (PlanResult.ACCEPTED, -1)
    assert puppet.stack.set_mode(1, 3 if flavour == "ardupilot" else 0x04040000) == 0
    assert puppet.do(400, 1) == 0
    assert puppet.run(
        240.0,
        lambda now: now.stack.mission().state is MissionState.COMPLETE,
        lambda now: found.append(now.seen.position_ned),
    )
    return np.array(found)


def test_a_spline_is_flown_along_its_curve():
    """North 40 to east 40 and on to the south: the cubic of ArduPilot is farthest north at 45 m, 20 m east."""
    items = [
        item(0, WAYPOINT, up=0.0),
        item(1, TAKEOFF, up=10.0),
        item(2, WAYPOINT, 20, 0, 10.0),
        item(3, WAYPOINT, 40, 0, 10.0),
        item(4, 82, 40, 40, 10.0, params=(0, 0, 0, 0)),
        item(5, WAYPOINT, 20, 40, 10.0),
    ]
    places = track(items, "ardupilot")
    # Tangents of 20 m at both ends: 40 + 20 (t - t^2) and 40 (3 t^2 - 2 t^3).
    time = np.linspace(0.0, 1.0, 201)[:, None]
    curve = np.hstack([40.0 + 20.0 * (time - time**2), 40.0 * (3.0 * time**2 - 2.0 * time**3)])
    over = places[(places[:, 0] > 39.0) & (places[:, 1] > 3.0) & (places[:, 1] < 37.0)]
    off = np.linalg.norm(over[:, None, :2] - curve[None], axis=2).min(axis=1)
    assert len(over) > 100
    assert off.max() < 0.8
    assert over[:, 0].max() == pytest.approx(45.0, abs=0.5)


def test_a_line_above_the_ground_follows_it():
    """Over a ridge of 15 m, 20 m above the ground within 2 m; below a ceiling above home it would be 5 m."""

    def ridge(north, east):
        return -15.0 * np.exp(-(((np.asarray(north) - 60.0) / 20.0) ** 2)) + 0.0 * np.asarray(east)

    items = [
        item(0, TAKEOFF, up=20.0),
        item(1, WAYPOINT, 5, 0, 20.0, frame=11),
        item(2, WAYPOINT, 120, 0, 20.0, frame=11),
    ]
    places = track(items, "px4", ground_down=ridge)
    over = places[(places[:, 0] > 8.0) & (places[:, 0] < 115.0)]
    above = ridge(over[:, 0], 0.0) - over[:, 2]
    assert (float(above.min()), float(above.max())) == pytest.approx((20.0, 20.0), abs=2.0)
    assert -over[:, 2].min() == pytest.approx(35.0, abs=1.5)
