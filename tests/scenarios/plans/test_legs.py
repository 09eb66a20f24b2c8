"""Legs of plans: heights, lines over hills, splines, conditions, headings, scans and landing patterns."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.scenarios.plans.test_qgc import item, plan

from qrsim.models.site import Site
from qrsim.scenarios.plans.heights import Levels, over_ground
from qrsim.scenarios.plans.legs import legs_of
from qrsim.scenarios.plans.reading import read_plan
from qrsim.scenarios.plans.splines import end_tangent, spline_points

SITE = Site.from_degrees(47.0, 8.0, 0.0)
MISSION = 2
Legs = Callable[..., list[dict[str, Any]]]


def at(north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude [deg] of a place near the home of the plans [m]."""
    latitude, longitude, _ = SITE.ned_to_geodetic((north, east, 0.0))
    return math.degrees(float(latitude)), math.degrees(float(longitude))


def flat(north: Any, east: Any) -> Any:
    return np.zeros(np.broadcast(north, east).shape)


def fly(north: float, east: float, up: float, *first: Any, command: int = 16, frame: int = 3) -> dict[str, Any]:
    """A waypoint; ``first`` are its first parameters."""
    params = [*first, *[0, 0, 0, None][len(first) :]]
    return item(command, *params, *at(north, east), up, frame=frame)


def order(command: int, *params: Any) -> dict[str, Any]:
    return item(command, *params, *[0] * (7 - len(params)), frame=MISSION)


@pytest.fixture
def legs(tmp_path: Path) -> Legs:
    def legs_of_items(*items: Any, ground: Any = flat, **more: Any) -> list[dict[str, Any]]:
        path = tmp_path / "field.plan"
        content = plan(*items, **more)
        content["mission"]["hoverSpeed"] = None
        path.write_text(json.dumps(content), "utf-8")
        read = read_plan(path)

        def to_ned(place: tuple[float, float]) -> list[float]:
            north, east, _ = SITE.geodetic_to_ned(math.radians(place[0]), math.radians(place[1]), 0.0)
            return [round(float(north), 6), round(float(east), 6), 0.0]

        levels = Levels(0.0, read.home.altitude_amsl, None)
        places = []
        for waypoint in read.waypoints:
            north, east, _ = to_ned((waypoint.latitude_deg, waypoint.longitude_deg))
            places.append([north, east, levels.down(waypoint, float(ground(north, east)))])
        found, _ = legs_of(read, [0.0, 0.0, 0.0], places, ground, to_ned)
        return found

    return legs_of_items


def points(found: list[dict[str, Any]]) -> list[list[float]]:
    return [[round(number, 2) for number in leg["to_ned"]] for leg in found if "to_ned" in leg]


def test_altitudes_are_above_home_the_sea_and_the_ground(legs: Legs) -> None:
    """Home is 500 m above the sea; a plan of frame 0 is that of frame 3."""

    def hill(north: Any, east: Any) -> Any:
        return flat(north, east) - 7.0

    for frame, up in ((3, 20.0), (6, 20.0), (0, 520.0), (5, 520.0), (10, 13.0), (11, 13.0)):
        assert points(legs(fly(50, 0, up, frame=frame), ground=hill)) == [[50.0, 0.0, -20.0]]
    # An item without an altitude or a place has that of the item before it.
    found = legs(fly(50, 0, 20), item(16, 0, 0, 0, None, *at(50, 30), None), item(19, 3, 0, 0, None, 0, 0, 25))
    assert points(found) == [[50.0, 0.0, -20.0], [50.0, 30.0, -20.0], [50.0, 30.0, -25.0]]
    found = legs(item(22, 0, 0, 0, None, None, None, None), fly(9, 0, 5), item(21, 0, 0, 0, None, None, None, None))
    assert (found[0]["height"], found[-1]["type"], found[-1]["at_ned"]) == (2.5, "land", [9.0, 0.0])


def test_a_line_between_heights_above_the_ground_follows_it(legs: Legs) -> None:
    """A hill of 30 m and a slope of 20 %: the height of 40 m is kept within 1 m."""

    def hill(north: Any, east: Any) -> Any:
        return -0.2 * np.asarray(north) - 30.0 * np.exp(-(((np.asarray(north) - 200.0) / 60.0) ** 2)) + 0.0 * east

    found = points(legs(fly(0, 10, 40, frame=10), fly(400, 10, 40, frame=10), ground=hill))
    assert found[0] == [0.0, 10.0, -40.0]
    assert found[-1] == [400.0, 10.0, -120.0]
    north = np.linspace(0.0, 400.0, 2001)
    path = np.interp(north, [each[0] for each in found], [each[2] for each in found])
    assert np.abs(hill(north, 10.0) - path - 40.0).max() < 1.0
    assert 5 < len(found) < 30
    # Over a plane it stays one line; and lines between other heights are straight.
    assert over_ground([0, 0, -40], [400, 0, -120], lambda n, e: -0.2 * np.asarray(n)) == []
    assert len(legs(fly(0, 10, 40, frame=10), fly(400, 10, 40), ground=hill)) == 2


def test_splines_have_the_tangents_of_ardupilot(legs: Legs) -> None:
    """AC_WPNav: along the straight way before; to a spline parallel to the chord round it; to a line along that."""
    assert end_tangent([0, 0, 0], [10, 0, 0], [10, 10, 0], True) == (10, 10, 0)
    assert end_tangent([0, 0, 0], [10, 0, 0], [10, 10, 0], False) == (0, 10, 0)
    assert end_tangent([0, 0, 0], [10, 0, 0], None, False) == (0, 0, 0)
    # Half way on the cubic of two equal tangents v lies the middle of the chord; of v and -v, v / 4 beside it.
    curve = spline_points([0.0, 0.0, 0.0], [80.0, 0.0, 0.0], [0.0, 60.0, 0.0], [0.0, -60.0, 0.0])
    middle = curve[len(curve) // 2 - 1]
    assert len(curve) % 2 == 0
    assert middle == pytest.approx([40.0, 15.0, 0.0])
    # Tangents together longer than four times the way are shortened to that: 600 of 320.
    curve = spline_points([0.0, 0.0, 0.0], [80.0, 0.0, 0.0], [0.0, 300.0, 0.0], [0.0, -300.0, 0.0])
    assert curve[len(curve) // 2 - 1][1] == pytest.approx(40.0, rel=0.01)
    found = legs(fly(0, 0, 20), fly(100, 0, 20), fly(100, 100, 20, command=82), fly(0, 100, 20))
    curve = points(found)[1:-1]
    assert curve[0] == [100.0, 0.0, -20.0]
    assert curve[-1] == [100.0, 100.0, -20.0]
    # North is 100 + 100 (t - t^2) with tangents of 100 m to the north at its begin and to the south at its end.
    assert max(place[0] for place in curve) == pytest.approx(125.0, abs=0.25)
    assert not any(leg.get("stop") for leg in found)


def test_conditions_hold_on_the_way(legs: Legs) -> None:
    """The speed and heading before CONDITION_DISTANCE hold until so far from the place, and before a gate to there."""
    slower = (order(178, 1, 3, -1), order(115, 90))
    found = legs(fly(0, 0, 20), order(114, 25), *slower, fly(100, 0, 20))
    assert points(found) == [[0.0, 0.0, -20.0], [75.0, 0.0, -20.0], [100.0, 0.0, -20.0]]
    assert [leg.get("speed") for leg in found] == [None, None, 3.0]
    assert [leg.get("yaw_rad") for leg in found] == [None, None, math.radians(90)]
    gate = item(4501, 0, 0, 0, 0, *at(40, 30), 0)
    found = legs(fly(0, 0, 20), gate, *slower, fly(100, 30, 20))
    north, east, _ = points(found)[1]
    assert (north - 40.0) * 60.0 + (east - 30.0) * 0.0 == pytest.approx(0.0, abs=1.0)
    # Met at the begin, and only at the end.
    assert len(legs(fly(0, 0, 20), order(114, 150), *slower, fly(100, 0, 20))) == 2
    assert [leg.get("speed") for leg in legs(fly(0, 0, 20), order(114, 0), *slower, fly(100, 0, 20))] == [None, None]
    found = legs(fly(0, 0, 20), order(112, 7), fly(100, 0, 20))
    assert [leg["hold"] for leg in found] == [7.0, 0.0]


def test_speeds_and_headings_of_legs(legs: Legs) -> None:
    found = legs(
        order(178, 2, 1.5, -1), order(178, 3, 0.5, -1), fly(0, 50, 20), order(115, 30, 0, -1, 1), fly(50, 50, 20)
    )
    assert [(leg["climb_speed"], leg["sink_speed"]) for leg in found] == [(1.5, 0.5)] * 2
    # From east 30 degrees to the left.
    assert found[1]["yaw_rad"] == pytest.approx(math.radians(60.0))


def test_a_return_leads_to_the_nearest_rally_point(legs: Legs) -> None:
    rally = {"version": 2, "points": [[*at(200, 0), 45], [*at(0, 300), 10]]}
    found = legs(fly(150, 0, 20), order(20), rallyPoints=rally)
    assert points(found)[1:] == [[150.0, 0.0, -45.0]]
    assert [round(each, 2) for each in found[-1]["at_ned"]] == [200.0, 0.0]
    assert legs(fly(50, 0, 20), order(20), rallyPoints=rally)[-1]["at_ned"] == [0.0, 0.0]
    # A new home, where the vehicle is.
    assert legs(fly(50, 0, 20), order(179, 1), fly(90, 0, 20), order(20))[-1]["at_ned"] == [50.0, 0.0]


SCAN = {
    "type": "ComplexItem", "complexItemType": "StructureScan", "version": 3, "EntranceAltitude": 50,
    "GimbalPitch": 0, "Layers": 2, "ScanBottomAlt": 4, "StartFromTop": False, "StructureHeight": 20,
    "CameraCalc": {
        "AdjustedFootprintFrontal": 8, "AdjustedFootprintSide": 10, "CameraName": "Manual (no camera specs)",
        "DistanceToSurface": 10, "DistanceToSurfaceRelative": True, "version": 1,
    },
    "polygon": [list(at(*corner)) for corner in ((20, 20), (20, 60), (-20, 60), (-20, 20))],
}  # fmt: skip


def test_a_scan_of_a_structure_goes_round_it(legs: Legs) -> None:
    """StructureScanComplexItem: in at the entrance, rounds at 8 and 16 m, 10 m outside, and out where it began."""
    found = legs(fly(0, 0, 9), SCAN)
    ring = [[30.0, 10.0], [30.0, 70.0], [-30.0, 70.0], [-30.0, 10.0], [30.0, 10.0]]
    expected = [[30.0, 10.0, -50.0], *([*place, -8.0] for place in ring), *([*place, -16.0] for place in ring)]
    assert np.array(points(found)[1:]) == pytest.approx(np.array([*expected, [30.0, 10.0, -50.0]]), abs=0.02)
    # It faces inwards: south along the northern edge, west along the eastern one.
    headings = [math.degrees(leg["yaw_rad"]) for leg in found[3:7]]
    assert [math.remainder(each, 360.0) for each in headings] == pytest.approx([180.0, -90.0, 0.0, 90.0], abs=0.1)
    falls = legs(fly(0, 0, 9), {**SCAN, "StartFromTop": True, "polygon": SCAN["polygon"][::-1]})
    assert {place[2] for place in points(falls)} == {-9.0, -50.0, -16.0, -8.0}
    assert points(falls)[2][2] == -16.0


@pytest.mark.parametrize(("relative", "z"), [(True, 0.0), (False, 500.0)])
def test_a_scan_of_version_2_begins_with_its_first_round(legs: Legs, relative: bool, z: float) -> None:
    """QGroundControl 3.4: the altitude is that of the bottom, and there is no altitude of entrance."""
    old = {"version": 2, "Altitude": z + 4, "altitudeRelative": relative}
    kept = ("type", "complexItemType", "Layers", "StructureHeight", "CameraCalc", "polygon")
    found = legs(fly(0, 0, 9), {**{key: SCAN[key] for key in kept}, **old})
    ring = [[30.0, 10.0], [30.0, 70.0], [-30.0, 70.0], [-30.0, 10.0], [30.0, 10.0]]
    expected = [*([*place, -8.0] for place in ring), *([*place, -16.0] for place in ring)]
    assert np.array(points(found)[1:]) == pytest.approx(np.array(expected), abs=0.02)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"CameraCalc": {**SCAN["CameraCalc"], "DistanceToSurface": -5}},
            ": DistanceToSurface is -5 m; allowed: above 0",
        ),
        ({"Layers": 0}, ".Layers: 0 is out of range; allowed: 1 to 500"),
        ({"version": 1}, ".version: version 1 is not supported; supported: 2, 3"),
        ({"version": 2}, ".Altitude: expected a number [m], found null"),
        ({"polygon": SCAN["polygon"][:2]}, ".polygon: has 2 corners; a polygon needs at least 3"),
        ({"EntranceAltitude": None}, ".EntranceAltitude: expected a number [m], found null"),
    ],
)
def test_bad_scans(legs: Legs, changed: dict[str, Any], words: str) -> None:
    from qrsim.errors import ScenarioError

    with pytest.raises(ScenarioError) as caught:
        legs({**SCAN, **changed})
    assert caught.value.problems[0].startswith(f"mission.items.0{words}")


def test_a_landing_pattern_is_an_approach_and_a_landing(legs: Legs) -> None:
    pattern = {
        "type": "ComplexItem", "complexItemType": "fwLandingPattern", "version": 2, "altitudesAreRelative": True,
        "landCoordinate": [*at(0, 0), 0], "landingApproachCoordinate": [*at(-200, 0), 40], "loiterClockwise": True,
        "loiterRadius": 75, "useLoiterToAlt": True, "useDoChangeSpeed": True, "finalApproachSpeed": 9,
        "stopTakingPhotos": True, "stopVideoPhotos": True, "valueSetIsDistance": False,
    }  # fmt: skip
    found = legs(fly(50, 0, 20), pattern)
    assert points(found) == [[50.0, 0.0, -20.0], [-200.0, 0.0, -40.0]]
    assert (found[-1]["type"], found[-1]["speed"]) == ("land", 9.0)
    old = {
        key: value for key, value in pattern.items() if key not in ("landingApproachCoordinate", "altitudesAreRelative")
    }
    old |= {"loiterCoordinate": [*at(-200, 0), 540], "loiterAltitudeRelative": False, "landingAltitudeRelative": True}
    assert points(legs(fly(50, 0, 20), old))[1] == [-200.0, 0.0, -40.0]


def test_a_line_over_a_hill_bends_where_the_tolerance_needs_it() -> None:
    """Over a hill of 20 m: the larger the tolerance, the fewer the bends, and none where the hill is within it."""

    def hill(north: Any, east: Any) -> Any:
        return flat(north, east) - 20.0 * np.exp(-(((np.asarray(north) - 200.0) / 60.0) ** 2))

    counts = []
    for tolerance in (0.5, 1.0, 5.0, 30.0):
        bends = over_ground([0.0, 0.0, -30.0], [400.0, 0.0, -30.0], hill, tolerance)
        line = np.array([[0.0, 0.0, -30.0], *bends, [400.0, 0.0, -30.0]])
        north = np.linspace(0.0, 400.0, 801)
        above = hill(north, 0.0) - np.interp(north, line[:, 0], line[:, 2])
        assert np.abs(above - 30.0).max() <= tolerance
        counts.append(len(bends))
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) == 4
    assert counts[-1] == 0
