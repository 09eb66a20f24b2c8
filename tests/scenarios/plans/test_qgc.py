"""Reading QGroundControl plans: what is flown, what is only noted, and every bad file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.plans.commands import COMMANDS, SKIPPED
from qrsim.scenarios.plans.plan import FencePolygon, Plan, RallyPoint
from qrsim.scenarios.plans.reading import read_plan

HOME = [47.0, 8.0, 500.0]
ABOVE_SEA, ABOVE_HOME, MISSION = 0, 3, 2
Write = Callable[[Any], str]


def item(command: int, *params: Any, frame: int = ABOVE_HOME, **more: Any) -> dict[str, Any]:
    """A simple item; of fewer than seven parameters the first are zero."""
    padded = [0] * (7 - len(params)) + list(params)
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": padded, "autoContinue": True, **more}


def survey(*items: Any, **inner: Any) -> dict[str, Any]:
    """A survey as QGroundControl writes it, without what only its editor needs."""
    transects = {"version": 2, "TurnAroundDistance": 10, "Items": list(items), **inner}
    return {"type": "ComplexItem", "complexItemType": "survey", "version": 5, "TransectStyleComplexItem": transects}


def plan(*items: Any, **more: Any) -> dict[str, Any]:
    mission = {
        "version": 2, "cruiseSpeed": 15, "hoverSpeed": 5, "firmwareType": 12, "vehicleType": 2,
        "globalPlanAltitudeMode": 1, "plannedHomePosition": HOME, "items": list(items),
    }  # fmt: skip
    return {
        "fileType": "Plan", "version": 1, "groundStation": "QGroundControl", "mission": mission,
        "geoFence": {"version": 2, "circles": [], "polygons": []}, "rallyPoints": {"version": 2, "points": []}, **more,
    }  # fmt: skip


def fenced(polygons: Any = (), circles: Any = (), **more: Any) -> dict[str, Any]:
    return plan(geoFence={"version": 2, "polygons": list(polygons), "circles": list(circles), **more})


def polygon(*corners: list[float], inclusion: Any = True, **more: Any) -> dict[str, Any]:
    return {"version": 1, "inclusion": inclusion, "polygon": list(corners), **more}


def circle(radius: Any, center: Any = (47.0, 8.0), **more: Any) -> dict[str, Any]:
    return {"version": 1, "inclusion": False, "circle": {"center": list(center), "radius": radius}, **more}


TRIANGLE = [[47.0, 8.0], [47.0, 8.01], [47.01, 8.0]]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_it(content: Any) -> str:
        path = tmp_path / "field.plan"
        path.write_text(content if isinstance(content, str) else json.dumps(content, indent=4))
        return str(path)

    return write_it


def waypoints(read: Plan) -> list[tuple[float, float, float, int, str]]:
    return [(w.latitude_deg, w.longitude_deg, w.height_above_home, w.item, w.command) for w in read.waypoints]


def ignored(read: Plan) -> list[str]:
    """What a route does not fly."""
    return [each.route_text for each in read.ignored]


def missed(read: Plan) -> list[str]:
    """What a mission does not fly."""
    return [each.text for each in read.ignored if each.what]


# Good plans


def test_a_plan_with_everything(write: Write) -> None:
    """Numbers of items are those that QGroundControl shows: from 1, those inside a survey too."""
    content = plan(
        item(22, None, 47.0, 8.0, 20.0),
        item(178, 1, 6, -1, 0, 0, 0, 0, frame=MISSION),
        item(16, None, 47.001, 8.001, 30.0),
        survey(
            item(16, None, 47.002, 8.001, 40.0),
            item(206, 25, 0, 1, 0, 0, 0, 0, frame=MISSION),
            item(16, None, 47.002, 8.002, 40.0),
            item(206, 0, 0, 1, 0, 0, 0, 0, frame=MISSION),
        ),
        item(16, None, 47.003, 8.003, 545.0, frame=ABOVE_SEA),
        item(20, frame=MISSION),
        geoFence={
            "version": 2,
            "polygons": [polygon(*TRIANGLE), polygon(*TRIANGLE[::-1], inclusion=False)],
            "circles": [circle(50)],
            "breachReturn": [47.0, 8.0, 30.0],
        },
        rallyPoints={"version": 2, "points": [[47.0, 8.0, 30.0]]},
    )
    read = read_plan(write(content))
    assert (read.home.latitude_deg, read.home.longitude_deg, read.home.altitude_amsl) == (47.0, 8.0, 500.0)
    assert waypoints(read) == [
        (47.0, 8.0, 20.0, 1, "NAV_TAKEOFF"),
        (47.001, 8.001, 30.0, 3, "NAV_WAYPOINT"),
        (47.002, 8.001, 40.0, 4, "NAV_WAYPOINT"),
        (47.002, 8.002, 40.0, 6, "NAV_WAYPOINT"),
        (47.003, 8.003, 45.0, 8, "NAV_WAYPOINT"),
        (47.0, 8.0, 45.0, 9, "NAV_RETURN_TO_LAUNCH"),
    ]
    assert ignored(read) == [
        "item 2, DO_CHANGE_SPEED: not carried out",
        "item 5, DO_SET_CAM_TRIGG_DIST: not carried out",
        "item 7, DO_SET_CAM_TRIGG_DIST: not carried out",
        "geoFence.breachReturn: not used",
    ]
    assert read.rally == (RallyPoint(47.0, 8.0, 30.0),)
    assert (read.hover_speed, read.cruise_speed) == (5.0, 15.0)
    corners = tuple((latitude, longitude) for latitude, longitude in TRIANGLE)
    assert read.polygons == (FencePolygon(True, corners), FencePolygon(False, corners[::-1]))
    (around,) = read.circles
    assert (around.inclusion, around.latitude_deg, around.longitude_deg, around.radius) == (False, 47.0, 8.0, 50.0)


def test_nothing_but_a_mission_is_needed(write: Write) -> None:
    content = plan()
    del content["geoFence"], content["rallyPoints"], content["groundStation"]
    path = write(content)
    # As some editors on Windows write it.
    Path(path).write_bytes(b"\xef\xbb\xbf" + Path(path).read_bytes())
    read = read_plan(path)
    assert (read.waypoints, read.polygons, read.circles, read.ignored) == ((), (), (), ())


@pytest.mark.parametrize(("frame", "height"), [(0, 60.0), (5, 60.0), (3, 560.0), (6, 560.0)])
@pytest.mark.parametrize("command", [16, 17, 18, 19, 21, 22])
def test_altitudes_by_frame(write: Write, frame: int, height: float, command: int) -> None:
    # AltitudeMode is for the editor: the vehicle is told frame and parameters only.
    content = plan(item(command, 47.1, 8.1, 560.0, frame=frame, AltitudeMode=1, Altitude=1.0))
    read = read_plan(write(content))
    assert waypoints(read) == [(47.1, 8.1, height, 1, COMMANDS[command].name)]
    assert read.ignored == ()


@pytest.mark.parametrize("place", [0, None])
def test_a_take_off_without_a_place_is_where_the_vehicle_is(write: Write, place: Any) -> None:
    content = plan(
        item(22, place, place, 15.0), item(16, 47.1, 8.1, 20.0), item(21, 47.1, 8.1, 0.0), item(22, place, place, 25.0)
    )
    flown = [(latitude, height) for latitude, _, height, _, _ in waypoints(read_plan(write(content)))]
    assert flown == [(47.0, 15.0), (47.1, 20.0), (47.1, 0.0), (47.1, 25.0)]


def test_what_an_item_asks_for_beside_its_place_is_noted(write: Write) -> None:
    content = plan(
        item(22, 15, 0, 0, 90, 47.0, 8.0, 20.0),
        item(16, 5, 2, 1.5, None, 47.1, 8.0, 20.0),
        item(18, 3, 1, -50, 0, 47.1, 8.0, 20.0),
        item(19, 30, 0, 50, 0, 47.1, 8.0, 20.0, autoContinue=False),
        item(21, 10, 2, 0, None, 47.1, 8.0, 0.0),
        item(17, 0, 0, 25, None, 47.1, 8.0, 20.0),
    )
    assert ignored(read_plan(write(content))) == [
        "item 1, NAV_TAKEOFF: not flown: pitch 15 deg, yaw 90 deg",
        "item 2, NAV_WAYPOINT: not flown: hold for 5 s, acceptance radius 2 m, pass at 1.5 m",
        "item 3, NAV_LOITER_TURNS: not flown: 3 turns, parameter 2 = 1, loiter radius -50 m",
        "item 4, NAV_LOITER_TIME: not flown: loiter for 30 s, loiter radius 50 m, stop after it "
        "(autoContinue is false)",
        "item 5, NAV_LAND: not flown: abort altitude 10 m, precision landing mode 2",
        "item 6, NAV_LOITER_UNLIM: not flown: loiter radius 25 m",
    ]


def test_what_a_mission_is_asked_for_is_its_waypoints_own(write: Write) -> None:
    """Speeds hold on, headings of CONDITION_YAW are those of the next item, delays those of the last one."""
    content = plan(
        item(93, 4, frame=MISSION),
        item(22, 0, 0, 0, 90, 47.0, 8.0, 20.0),
        item(178, 1, 6.5, -1, 0, 0, 0, 0, frame=MISSION),
        item(16, 5, 2.5, 0, None, 47.1, 8.0, 20.0),
        item(93, 7, 0, 0, 0, 0, 0, 0, frame=MISSION),
        item(115, 350, 0, 0, 0, 0, 0, 0, frame=MISSION),
        item(18, 3, 1, -50, 0, 47.1, 8.0, 20.0),
        item(178, 0, -2, 0, 0, 0, 0, 0, frame=MISSION),
        item(19, 30, 0, 50, 0, 47.1, 8.0, 20.0),
        item(178, 2, 1, 0, 0, 0, 0, 0, frame=MISSION),
        item(115, 30, 0, 0, 1, 0, 0, 0, frame=MISSION),
        item(21, 0, 0, 0, None, 47.1, 8.0, 0.0),
    )
    content["mission"]["items"][0]["params"] = [4, 0, 0, 0, 0, 0, 0]
    read = read_plan(write(content))
    assert read.delay == 4.0
    asked = [(w.item, w.hold, w.accept_radius, w.yaw_deg, w.speed, w.turns, w.radius) for w in read.waypoints]
    assert asked == [
        (2, 0.0, None, 90.0, None, 0.0, 0.0),
        (4, 12.0, 2.5, None, 6.5, 0.0, 0.0),
        (7, 0.0, None, -10.0, 6.5, 3.0, -50.0),
        (9, 30.0, None, None, None, 0.0, 0.0),
        (12, 0.0, None, None, None, 0.0, 0.0),
    ]
    assert [(w.climb, w.sink, w.turn_deg) for w in read.waypoints[-2:]] == [(None, None, None), (1.0, None, 30.0)]
    assert missed(read) == [
        "item 7, NAV_LOITER_TURNS: not flown: parameter 2 = 1",
        "item 9, NAV_LOITER_TIME: not flown: loiter radius 50 m",
    ]


@pytest.mark.parametrize(
    ("bad", "expected"),
    [
        (
            item(178, 1, 80, 0, 0, 0, 0, 0),
            "mission.items.0.params.1 (speed): 80 is out of range; allowed: at most 50 m/s",
        ),
        (item(16, -5, 0, 0, 0, 47.0, 8.0, 9.0), "mission.items.0.params.0: -5 is out of range; allowed: 0 to 604800 s"),
        (
            item(18, 1e6, 0, 9, 0, 47.0, 8.0, 9.0),
            "mission.items.0.params.0: 1e+06 is out of range; allowed: 0 to 10000",
        ),
        (item(93, "x", 0, 0, 0, 0, 0, 0), "mission.items.0.params.0: expected a number, found 'x'"),
    ],
)
def test_what_no_mission_can_fly_is_refused(write: Write, bad: dict[str, Any], expected: str) -> None:
    bad["params"] = bad["params"][:7]
    path, _, words = expected.partition(": ")
    with pytest.raises(ScenarioError, match=rf"{re.escape(path)} \(line \d+\): {re.escape(words)}"):
        read_plan(write(plan(bad)))


def test_every_command_that_changes_no_path_is_noted_by_name(write: Write) -> None:
    read = read_plan(write(plan(*(item(command, 1, 0, 0, 0, 0, 0, 0) for command in sorted(SKIPPED)))))
    assert read.waypoints == ()
    assert [(each.item, each.name) for each in read.ignored] == [
        (i, COMMANDS[number].name) for i, number in enumerate(sorted(SKIPPED), 1)
    ]


def test_older_surveys_and_other_scans_are_read(write: Write) -> None:
    content = plan(survey(item(16, 47.1, 8.0, 20.0), version=1), survey(item(16, 47.2, 8.0, 20.0)))
    content["mission"]["items"][1]["complexItemType"] = "CorridorScan"
    assert [w.latitude_deg for w in read_plan(write(content)).waypoints] == [47.1, 47.2]


# Bad plans


def without(content: dict[str, Any], *path: Any) -> dict[str, Any]:
    target: Any = content
    for part in path[:-1]:
        target = target[part]
    del target[path[-1]]
    return content


def altered(content: dict[str, Any], value: Any, *path: Any) -> dict[str, Any]:
    target: Any = content
    for part in path[:-1]:
        target = target[part]
    target[path[-1]] = value
    return content


GOOD = (47.1, 8.1, 20.0)
FIRST = ("mission", "items", 0)
RTL = item(20, frame=MISSION)
SUPPORTED_FRAMES = "supported: 0, 3, 5, 6, 10, 11, and 2 where an item has no place"
BAD: dict[str, tuple[Any, str]] = {
    # No plan, or another version.
    "a list": ([1, 2], "is no plan; expected an object with fileType 'Plan'"),
    "other JSON": ({"type": "FeatureCollection"}, "is no plan; expected an object with fileType 'Plan'"),
    "old mission": ({"fileType": "Mission"}, "fileType: is 'Mission'; supported: 'Plan'"),
    "version": (plan(version=2), "version: version 2 is not supported; supported: 1"),
    "no version": (without(plan(), "version"), "version: is missing; expected a whole number"),
    "a version that is true": (plan(version=True), "version: expected a whole number, found True"),
    "mission version": (
        altered(plan(), 3, "mission", "version"),
        "mission.version: version 3 is not supported; supported: 2",
    ),
    "fence version": (plan(geoFence={"version": 1}), "geoFence.version: version 1 is not supported; supported: 2"),
    "survey version": (
        plan(survey(version=3)),
        "mission.items.0.TransectStyleComplexItem.version: version 3 is not supported; supported: 1, 2",
    ),
    # Parts that are missing or are something else.
    "no mission": (without(plan(), "mission"), "mission: is missing; expected an object"),
    "a typo": (
        {**plan(), "mission": {"version": 2, "plannedHomePositon": HOME, "items": []}},
        "mission.plannedHomePosition: is missing; expected [latitude, longitude, altitude], which QGroundControl saves "
        "once the launch position is set; found 'plannedHomePositon'",
    ),
    "no items": (without(plan(), "mission", "items"), "mission.items: is missing; expected a list"),
    "items": (altered(plan(), "all", "mission", "items"), "mission.items: expected a list, found 'all'"),
    "no home": (
        without(plan(), "mission", "plannedHomePosition"),
        "mission.plannedHomePosition: is missing; expected [latitude, longitude, altitude], which QGroundControl saves "
        "once the launch position is set",
    ),
    "home without altitude": (
        altered(plan(), [47.0, 8.0], "mission", "plannedHomePosition"),
        "mission.plannedHomePosition: expected [latitude, longitude, altitude], found 2 values",
    ),
    "home null": (
        altered(plan(), [47.0, 8.0, None], "mission", "plannedHomePosition"),
        "mission.plannedHomePosition: altitude: expected a number [m], found null, which means 'the current one'",
    ),
    "item": (plan(5), "mission.items.0: expected an object, found 5"),
    "item type": (
        plan({"type": "missionItem"}),
        "mission.items.0.type: is 'missionItem'; supported: 'SimpleItem', 'ComplexItem'",
    ),
    "no item type": (plan({}), "mission.items.0.type: is null; supported: 'SimpleItem', 'ComplexItem'"),
    "survey in a survey": (
        plan(survey(survey())),
        "mission.items.0.TransectStyleComplexItem.Items.0.type: is 'ComplexItem'; supported: 'SimpleItem'",
    ),
    "no command": (
        without(plan(item(16, *GOOD)), *FIRST, "command"),
        "mission.items.0.command: is missing; expected a whole number",
    ),
    "no frame": (
        without(plan(item(16, *GOOD)), *FIRST, "frame"),
        "mission.items.0.frame: is missing; expected a whole number",
    ),
    "no params": (
        without(plan(item(16, *GOOD)), *FIRST, "params"),
        "mission.items.0.params: is missing; expected a list",
    ),
    "older params": (
        altered(plan(item(16, *GOOD)), [0, 0, 0, 0], *FIRST, "params"),
        "mission.items.0.params: expected 7 values, found 4",
    ),
    # What cannot be flown.
    "jump to nowhere": (
        plan(item(16, *GOOD), item(177, 7, 3, 0, 0, 0, 0, 0)),
        "mission.items.1.params.0: no item has doJumpId 7; known: 1 to 2",
    ),
    "jump by text": (
        plan(item(16, *GOOD), item(177, "a", 3, 0, 0, 0, 0, 0)),
        "mission.items.1.params.0: expected a number, found 'a'",
    ),
    "jump too often": (
        plan(item(16, *GOOD), item(177, 1, 1e6, 0, 0, 0, 0, 0)),
        "mission.items.1 (DO_JUMP): more than 1000000 items when unrolled; allowed: 2000",
    ),
    "jumps of many items": (
        plan(*[item(16, *GOOD)] * 50, item(177, 1, 999, 0, 0, 0, 0, 0)),
        "mission.items.50 (DO_JUMP): 50000 legs when unrolled; allowed: 2000",
    ),
    "jump to itself": (
        plan(item(16, *GOOD), item(177, 2, 1, 0, 0, 0, 0, 0)),
        "mission.items.1 (DO_JUMP): jumps to itself",
    ),
    "after a jump for ever": (
        plan(item(16, *GOOD), item(177, 1, -1, 0, 0, 0, 0, 0), RTL),
        "mission.items.2: is never reached, because DO_JUMP (item 2) repeats endlessly",
    ),
    "jumps to each other": (
        plan(item(16, *GOOD), item(177, 3, -1, 0, 0, 0, 0, 0), item(177, 2, -1, 0, 0, 0, 0, 0)),
        "mission.items.1 (DO_JUMP): repeats endlessly without an item that leads to a place",
    ),
    "jump over a speed": (
        plan(item(16, *GOOD), item(178, 1, 3, 0, 0, 0, 0, 0), item(177, 2, -1, 0, 0, 0, 0, 0)),
        "mission.items.2 (DO_JUMP): repeats endlessly without an item that leads to a place",
    ),
    "payload": (
        plan(item(16, *GOOD), item(94, *GOOD)),
        "mission.items.1.command: 94 (NAV_PAYLOAD_PLACE) cannot be flown (item 2); flown: 16 (NAV_WAYPOINT), "
        "17 (NAV_LOITER_UNLIM), 18 (NAV_LOITER_TURNS), 19 (NAV_LOITER_TIME), 20 (NAV_RETURN_TO_LAUNCH), 21 (NAV_LAND), "
        "22 (NAV_TAKEOFF), 31 (NAV_LOITER_TO_ALT), 82 (NAV_SPLINE_WAYPOINT), 93 (NAV_DELAY), 112 (CONDITION_DELAY), "
        "114 (CONDITION_DISTANCE), 115 (CONDITION_YAW), 177 (DO_JUMP), 178 (DO_CHANGE_SPEED), 179 (DO_SET_HOME), "
        "4501 (CONDITION_GATE)",
    ),
    "VTOL landing": (
        plan(item(16, *GOOD), item(85, *GOOD)),
        "mission.items.1.command: 85 (NAV_VTOL_LAND): no vehicle of qrsim changes between hovering and gliding; take "
        "fixed_wing or multirotor",
    ),
    "VTOL pattern": (
        plan({"type": "ComplexItem", "complexItemType": "vtolLandingPattern"}),
        "mission.items.0: 'vtolLandingPattern': no vehicle of qrsim changes between hovering and gliding",
    ),
    "fence off": (
        plan(item(207, 0, 0, 0, 0, 0, 0, 0)),
        "mission.items.0.params.0: DO_FENCE_ENABLE turns the fence off; the area of a scenario always holds",
    ),
    "empty survey": (
        plan(survey()),
        "mission.items.0: TransectStyleComplexItem.Items is empty; open and save the plan in QGroundControl",
    ),
    "a long delay": (
        plan(item(16, 604_800, 0, 0, None, *GOOD), item(93, 1, 0, 0, 0, 0, 0, 0)),
        "mission.items.1.params.0: 604801 s in all are out of range; allowed: 0 to 604800 s",
    ),
    "kind of speed": (
        plan(item(178, 4, 1, 0, 0, 0, 0, 0)),
        "mission.items.0.params.0: 4 is no kind of speed; allowed: 0",
    ),
    "distance": (
        plan(item(114, -1, 0, 0, 0, 0, 0, 0)),
        "mission.items.0.params.0: -1 is out of range; allowed: 0 or more",
    ),
    "gate": (
        plan(item(4501, 0, 0, 0, 0, 95, 8, 0)),
        "mission.items.0.params.4 (latitude): 95 is out of range; allowed: -90 to 90 deg",
    ),
    "hover speed": (
        altered(plan(), 99, "mission", "hoverSpeed"),
        "mission.hoverSpeed: 99 is out of range; allowed: -50 to 50 m/s",
    ),
    "unknown command": (
        plan(item(999)),
        "mission.items.0.command: 999 cannot be flown (item 1); flown: 16 (NAV_WAYPOINT), 17",
    ),
    "local frame": (
        plan(item(16, *GOOD, frame=1)),
        f"mission.items.0.frame: 1 (LOCAL_NED) is not supported; {SUPPORTED_FRAMES}",
    ),
    "unknown frame": (
        plan(item(21, *GOOD, frame=99)),
        f"mission.items.0.frame: 99 is not supported; {SUPPORTED_FRAMES}",
    ),
    "unknown pattern": (
        plan({"type": "ComplexItem", "complexItemType": "Spiral"}),
        "mission.items.0: a ComplexItem of type 'Spiral' cannot be flown; supported: those with "
        "TransectStyleComplexItem.Items, such as 'survey' and 'CorridorScan', and 'StructureScan', 'fwLandingPattern'",
    ),
    "return first": (
        plan(item(178), RTL),
        "mission.items.1: NAV_RETURN_TO_LAUNCH has no waypoint before it to take a height from",
    ),
    "after the return": (
        plan(item(16, *GOOD), RTL, item(203), item(16, *GOOD)),
        "mission.items.3: NAV_WAYPOINT is never reached, "
        "because NAV_RETURN_TO_LAUNCH (item 2) before it ends the route",
    ),
    "after loitering": (
        plan(item(17, *GOOD), RTL),
        "mission.items.1: NAV_RETURN_TO_LAUNCH is never reached, "
        "because NAV_LOITER_UNLIM (item 1) before it ends the route",
    ),
    # Places.
    "null longitude": (
        plan(item(16, 47.0, None, 20.0)),
        "mission.items.0.params.5 (longitude): expected a number [deg], found null, which means 'the current one'",
    ),
    "null altitude": (
        plan(item(16, 47.0, 8.0, None)),
        "mission.items.0.params.6 (altitude): is null, which means 'as before', but no place is before it",
    ),
    "NaN": (
        plan(item(16, math.nan, 8.0, 20.0)),
        "mission.items.0.params.4 (latitude): nan is out of range; allowed: -90 to 90 deg",
    ),
    "latitude": (
        plan(item(16, 91.0, 8.0, 20.0)),
        "mission.items.0.params.4 (latitude): 91.0 is out of range; allowed: -90 to 90 deg",
    ),
    "longitude": (
        plan(item(16, 47.0, -181, 20.0)),
        "mission.items.0.params.5 (longitude): -181 is out of range; allowed: -180 to 180 deg",
    ),
    "altitude": (plan(item(16, 47.0, 8.0, 10**400)), "mission.items.0.params.6 (altitude): 1000"),
    "text": (
        plan(item(16, "47", 8.0, 20.0)),
        "mission.items.0.params.4 (latitude): expected a number [deg], found '47'",
    ),
    "a hold that is a text": (
        plan(item(16, "long", 0, 0, 0, *GOOD)),
        "mission.items.0.params.0: expected a number, found 'long'",
    ),
    # Fences.
    "fence without circles": (without(plan(), "geoFence", "circles"), "geoFence.circles: is missing; expected a list"),
    "polygon version": (
        fenced([polygon(*TRIANGLE, version=2)]),
        "geoFence.polygons.0.version: version 2 is not supported; supported: 1",
    ),
    "polygon inclusion": (
        fenced([polygon(*TRIANGLE, inclusion=1)]),
        "geoFence.polygons.0.inclusion: expected true or false, found 1",
    ),
    "two corners": (
        fenced([polygon(*TRIANGLE[:2])]),
        "geoFence.polygons.0.polygon: has 2 corners; a polygon needs at least 3",
    ),
    "crossing": (
        fenced([polygon([47, 8], [48, 9], [47, 9], [48, 8])]),
        "geoFence.polygons.0.polygon: crosses itself: the edge from corner 0 to 1 meets the edge from corner 2 to 3",
    ),
    "corner null": (
        fenced([polygon(*TRIANGLE[:2], [None, 8.0])]),  # type: ignore[list-item]
        "geoFence.polygons.0.polygon.2: latitude: expected a number [deg], found null",
    ),
    "corner of three": (
        fenced([polygon(*TRIANGLE[:2], [47.0, 8.0, 9.0])]),
        "geoFence.polygons.0.polygon.2: expected [latitude, longitude], found 3 values",
    ),
    "circle": (
        fenced(circles=[{"version": 1, "inclusion": True}]),
        "geoFence.circles.0.circle: is missing; expected an object",
    ),
    "no radius": (fenced(circles=[circle(0)]), "geoFence.circles.0.circle.radius: 0 m is not above 0"),
    "radius null": (
        fenced(circles=[circle(None)]),
        "geoFence.circles.0.circle.radius: expected a number [m], found null",
    ),
    "rally points": (plan(rallyPoints={"version": 2}), "rallyPoints.points: is missing; expected a list"),
    "rally point": (
        plan(rallyPoints={"version": 2, "points": [[47.0, 8.0]]}),
        "rallyPoints.points.0: expected [latitude, longitude, altitude], found 2 values",
    ),
    "twice": ('{"fileType": "Plan", "version": 1, "version": 2}', "'version' is given twice in one object"),
}


def jump(to: int, times: float) -> dict[str, Any]:
    return item(177, to, times, 0, 0, 0, 0, 0, frame=MISSION)


def speed(wanted: float) -> dict[str, Any]:
    return item(178, 1, wanted, -1, 0, 0, 0, 0, frame=MISSION)


def flown(path: str) -> tuple[list[int], int | None]:
    found = read_plan(path)
    return [waypoint.item for waypoint in found.waypoints], found.again


def test_jumps_are_followed_as_often_as_they_say(write: Write) -> None:
    """A jump of two repeats flies its items three times; one inside another counts once, as autopilots count."""
    places = [item(16, 47.0, 8.0 + 1e-4 * i, 10.0) for i in range(4)]
    assert flown(write(plan(*places[:3], jump(2, 2), places[3]))) == ([1, 2, 3, 2, 3, 2, 3, 5], None)
    assert flown(write(plan(*places[:2], jump(1, 0), places[2]))) == ([1, 2, 4], None)
    inner = plan(*places[:2], jump(2, 1), jump(1, 2), places[2])
    assert flown(write(inner)) == ([1, 2, 2, 1, 2, 1, 2, 5], None)
    assert flown(write(plan(places[0], jump(4, 1), places[1], places[2]))) == ([1, 4], None)
    # As QGroundControl writes it: a jump leads to the id of an item.
    named = [{**each, "doJumpId": 10 * i} for i, each in enumerate(places, 1)]
    assert flown(write(plan(*named[:2], jump(20, 1), named[2]))) == ([1, 2, 2, 4], None)
    # What is asked on the way is asked again.
    content = plan(places[0], speed(3.0), places[1], speed(6.0), jump(1, 1), places[2])
    assert [waypoint.speed for waypoint in read_plan(write(content)).waypoints] == [None, 3.0, 6.0, 3.0, 6.0]


def test_a_jump_for_ever_says_where_the_plan_goes_on(write: Write) -> None:
    places = [item(16, 47.0, 8.0 + 1e-4 * i, 10.0) for i in range(3)]
    path = write(plan(*places, jump(2, -1)))
    assert flown(path) == ([1, 2, 3, 2, 3], 3)
    texts = [(note.text, note.route_text) for note in read_plan(path).ignored]
    assert texts == [("item 4, DO_JUMP: ", "item 4, DO_JUMP: repeated once, not endlessly")]
    # A delay at the head of the loop is a hold at its end, every time.
    delayed = read_plan(write(plan(places[0], item(93, 5, 0, 0, 0, 0, 0, 0), places[1], jump(2, -1))))
    assert ([waypoint.hold for waypoint in delayed.waypoints], delayed.again) == ([5.0, 5.0, 5.0], 2)


@pytest.mark.parametrize("case", BAD)
def test_bad_plans(write: Write, case: str) -> None:
    content, words = BAD[case]
    path = write(content)
    with pytest.raises(ScenarioError) as caught:
        read_plan(path)
    assert str(caught.value).startswith(f"{path}: 1 problem\n  ")
    (problem,) = caught.value.problems
    assert re.sub(r" \(line \d+\)", "", problem, count=1).startswith(words)


def test_all_problems_are_reported_at_once(write: Write) -> None:
    content = plan(
        item(85), item(16, *GOOD, frame=1), item(16, *GOOD), survey(item(85, *GOOD)),
        geoFence={"version": 2, "polygons": [polygon()], "circles": [circle(-1)]},
    )  # fmt: skip
    with pytest.raises(ScenarioError) as caught:
        read_plan(write(content))
    assert [problem.split(" (line ")[0] for problem in caught.value.problems] == [
        "mission.items.0.command", "mission.items.1.frame", "mission.items.3.TransectStyleComplexItem.Items.0.command",
        "geoFence.polygons.0.polygon", "geoFence.circles.0.circle.radius",
    ]  # fmt: skip


def test_problems_say_their_line(tmp_path: Path) -> None:
    content = plan(
        item(16, *GOOD), survey(item(85, *GOOD)), geoFence={"version": 2, "polygons": [], "circles": [circle(-1)]}
    )
    path = tmp_path / "lines.plan"
    path.write_text(json.dumps(content, indent=1), "utf-8")
    with pytest.raises(ScenarioError) as caught:
        read_plan(path)
    lines = path.read_text("utf-8").splitlines()
    spline, ring = (int(problem.split("(line ")[1].split(")")[0]) for problem in caught.value.problems)
    item_of = next(i for i, line in enumerate(lines) if '"command": 85' in line)
    ring_of = next(i for i, line in enumerate(lines) if '"radius"' in line)
    # The braces before them open the objects that they are in.
    assert [spline, ring] == [max(i for i in range(at) if "{" in lines[i]) + 1 for at in (item_of, ring_of)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not JSON: line 1, column 1: Expecting value"),
        ('{"fileType": "Plan",\n "version" 1}', "is not JSON: line 2, column 12: Expecting ':' delimiter"),
        (
            "QGC WPL 110\n",
            "is not JSON: line 1, column 1: Expecting value; it begins as a QGC WPL file: call it .waypoints",
        ),
        ("[" * 100_000, "is no plan: "),
        ("1" * 5000, "is no plan: "),
    ],
)
def test_files_that_are_no_json(write: Write, text: str, words: str) -> None:
    path = write(text)
    with pytest.raises(UsageError) as caught:
        read_plan(path)
    assert str(caught.value).startswith(f"{path}: {words}")


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.plan: cannot be read: No such file"):
        read_plan(tmp_path / "nowhere.plan")
    with pytest.raises(UsageError, match="cannot be read: Is a directory"):
        read_plan(tmp_path)
    binary = tmp_path / "binary.plan"
    binary.write_bytes(b"\xff\xfe{")
    with pytest.raises(UsageError, match=r"binary\.plan: is not JSON: it is no UTF-8 text"):
        read_plan(binary)
