"""Lists of waypoints and routes of maps: what is read of them, and every bad file."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.plans.plan import FencePolygon, Home, Plan
from qrsim.scenarios.plans.reading import read_plan

Write = Callable[[str, Any], str]
# In the layout of Mission Planner: home above the sea, then the items with tabs and eight or six digits.
LIST = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-35.3632621\t149.1652374\t584.090000\t1
1\t0\t3\t22\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t20.000000\t1
2\t0\t3\t16\t2.00000000\t0.00000000\t0.00000000\t0.00000000\t-35.36200000\t149.16520000\t20.000000\t1
3\t0\t0\t16\t0.00000000\t0.00000000\t0.00000000\t90.00000000\t-35.36200000\t149.16600000\t614.090000\t1
4\t0\t10\t82\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t-35.36300000\t149.16600000\t25.000000\t1
5\t0\t3\t177\t2.00000000\t1.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.000000\t1
6\t0\t3\t20\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.00000000\t0.000000\t1
"""
SQUARE = "8.0,47.0,0 8.001,47.0,0 8.001,47.001,0 8.0,47.001,0 8.0,47.0,0"
HOLE = "8.0004,47.0004 8.0006,47.0004 8.0006,47.0006 8.0004,47.0006 8.0004,47.0004"


def line(coordinates: str, mode: str = "absolute", name: str = "Route 1") -> str:
    return (
        f"<Placemark><name>{name}</name><LineString><altitudeMode>{mode}</altitudeMode><coordinates>{coordinates}"
        "</coordinates></LineString></Placemark>"
    )


def kml(inside: str) -> str:
    return f'<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>{inside}</Document></kml>'


def gpx(inside: str) -> str:
    return f'<?xml version="1.0"?><gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">{inside}</gpx>'


def route(name: str, *points: tuple[Any, ...]) -> str:
    marks = "".join(
        f'<rtept lat="{latitude}" lon="{longitude}">{f"<ele>{ele[0]}</ele>" if ele else ""}</rtept>'
        for latitude, longitude, *ele in points
    )
    return f"<rte><name>{name}</name>{marks}</rte>"


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def collection(*features: dict[str, Any]) -> str:
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_it(name: str, content: Any) -> str:
        path = tmp_path / name
        if isinstance(content, dict):
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
                for inner, text in content.items():
                    archive.writestr(inner, text)
        else:
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return str(path)

    return write_it


def places(read: Plan) -> list[tuple[float, float, float, str]]:
    return [(w.latitude_deg, w.longitude_deg, w.altitude, w.above) for w in read.waypoints]


# ---------------------------------------------------------------- lists of waypoints


def test_a_list_of_mission_planner(write: Write) -> None:
    """As Mission Planner writes it, and with a byte order mark, line ends of Windows and an empty line at the end."""
    read = read_plan(write("field.waypoints", LIST))
    assert read.home == Home(-35.3632621, 149.1652374, 584.09)
    assert [(w.command, w.hold, w.yaw_deg) for w in read.waypoints] == [
        ("NAV_TAKEOFF", 0.0, None),
        ("NAV_WAYPOINT", 2.0, None),
        ("NAV_WAYPOINT", 0.0, 90.0),
        ("NAV_SPLINE_WAYPOINT", 0.0, None),
        ("NAV_WAYPOINT", 2.0, None),
        ("NAV_WAYPOINT", 0.0, 90.0),
        ("NAV_SPLINE_WAYPOINT", 0.0, None),
        ("NAV_RETURN_TO_LAUNCH", 0.0, None),
    ]
    assert places(read)[:4] == [
        (-35.3632621, 149.1652374, 20.0, "home"),
        (-35.362, 149.1652, 20.0, "home"),
        (-35.362, 149.166, 614.09, "sea"),
        (-35.363, 149.166, 25.0, "ground"),
    ]
    assert [w.path for w in read.waypoints[:2]] == ["line 3", "line 4"]
    odd = "\ufeff" + LIST.replace("\t", "  ").replace("\n", "\r\n") + "\r\n"
    assert read_plan(write("odd.txt", odd)) == read
    # PX4's lists begin with the first item; home is where the scenario says, or the first place.
    px4 = "QGC WPL 120\n0\t1\t3\t22\t0\t0\t0\t0\t47.1\t8.1\t10\t1\n"
    assert read_plan(write("px4.txt", px4)).home.latitude_deg == 47.1
    assert read_plan(write("px4.txt", px4), home=Home(47.0, 8.0, 400.0)).home == Home(47.0, 8.0, 400.0)


def list_with(old: str, new: str) -> str:
    assert old in LIST
    return LIST.replace(old, new, 1)


# ---------------------------------------------------------------- routes of maps


def test_routes_of_maps_have_their_altitudes(write: Write) -> None:
    """KML and GPX are above the sea; GeoJSON is above the ellipsoid, 47.22 m below the geoid at this place."""
    ring = f"<LinearRing><coordinates>{SQUARE}</coordinates></LinearRing>"
    hole = f"<innerBoundaryIs><LinearRing><coordinates>{HOLE}</coordinates></LinearRing></innerBoundaryIs>"
    area = f"<Placemark><name>A</name><Polygon><outerBoundaryIs>{ring}</outerBoundaryIs>{hole}</Polygon></Placemark>"
    text = kml(line("8.0,47.0,480 8.001,47.0,490") + area)
    read = read_plan(write("way.kml", text))
    assert places(read) == [(47.0, 8.0, 480.0, "sea"), (47.0, 8.001, 490.0, "sea")]
    square = ((47.0, 8.0), (47.0, 8.001), (47.001, 8.001), (47.001, 8.0))
    inner = ((47.0004, 8.0004), (47.0004, 8.0006), (47.0006, 8.0006), (47.0006, 8.0004))
    assert read.polygons == (FencePolygon(True, square, (inner,), "A"),)
    packed = read_plan(write("way.kmz", {"files/a.png": "", "doc.kml": text}))
    assert (places(packed), packed.polygons) == (places(read), read.polygons)
    above = kml(line("8.0,47.0,20 8.001,47.0,30", "relativeToGround"))
    assert places(read_plan(write("above.kml", above))) == [(47.0, 8.0, 20.0, "ground"), (47.0, 8.001, 30.0, "ground")]
    drawn = kml(line("8.0,47.0,0 8.001,47.0,0", "clampToGround"))
    low = [(47.0, 8.0, 25.0, "ground"), (47.0, 8.001, 25.0, "ground")]
    assert places(read_plan(write("drawn.kml", drawn), height=25.0)) == low
    marks = kml(
        "".join(f"<Placemark><Point><coordinates>{at}</coordinates></Point></Placemark>" for at in ("8,47", "8.001,47"))
    )
    assert places(read_plan(write("marks.kml", marks), height=25.0)) == low

    two = gpx(route("out", (47.0, 8.0, 480.0), (47.0, 8.001)) + route("back", (47.0, 8.001, 480.0)))
    path = write("way.gpx", two)
    assert places(read_plan(path, route="back")) == [(47.0, 8.001, 480.0, "sea")]
    assert places(read_plan(path, route="out", height=30.0))[1] == (47.0, 8.001, 30.0, "ground")
    old = two.replace("/1/1", "/1/0").replace('"1.1"', '"1.0"')
    assert places(read_plan(write("old.gpx", old), route="back")) == [(47.0, 8.001, 480.0, "sea")]

    way = feature("LineString", [[8.545594, 47.397742, 535.22], [8.546, 47.3977, 535.22]], name="way")
    read = read_plan(write("way.geojson", collection(way)))
    assert [w.altitude for w in read.waypoints] == pytest.approx([488.0, 488.0], abs=0.03)
    assert {w.above for w in read.waypoints} == {"sea"}
    dots = [feature("Point", [8.0, 47.0, 1.0], height=12), feature("Point", [8.001, 47.0], height=14)]
    field = feature("Polygon", [[[8.0, 47.0], [8.001, 47.0], [8.001, 47.001], [8.0, 47.0]]], name="field")
    read = read_plan(write("dots.geojson", collection(*dots, field)))
    assert places(read) == [(47.0, 8.0, 12.0, "ground"), (47.0, 8.001, 14.0, "ground")]
    assert [(each.name, len(each.vertices)) for each in read.polygons] == [("field", 3)]


LOCKED = kml(line("8.0,47.0,0 8.001,47.0,0", "clampToGround"))
TRACK = "<trk><trkseg>" + '<trkpt lat="47" lon="8"/>' * 812 + "</trkseg></trk>"
BAD: dict[str, tuple[str, Any, dict[str, Any], str]] = {
    "list of another version": (
        "a.waypoints",
        list_with("110", "100"),
        {},
        "line 1: 'QGC WPL 100' is not supported; supported: 110, 120",
    ),
    "no list": ("a.waypoints", "hello\n", {}, "line 1: expected 'QGC WPL 110', found 'hello'"),
    "a line with eleven values": (
        "a.waypoints",
        list_with("614.090000\t1\n", "614.090000\n"),
        {},
        "line 5: 11 values; expected 12",
    ),
    "a text in a list": (
        "a.waypoints",
        list_with("614.09", "x614.09"),
        {},
        "line 5: column 11: 'x614.090000' is no number",
    ),
    "half a command": (
        "a.waypoints",
        list_with("\t82\t", "\t8.2\t"),
        {},
        "line 6: column 4: '8.2' is not a whole number",
    ),
    "a latitude of a list": (
        "a.waypoints",
        list_with("-35.36300000", "-95.36300000"),
        {},
        "line 6, column 9 (latitude): -95.363 is out of range; allowed: -90 to 90 deg",
    ),
    "a command of a list": ("a.waypoints", list_with("\t82\t", "\t85\t"), {}, "line 6: 85 (NAV_VTOL_LAND): no vehicle"),
    "a frame of a list": (
        "a.waypoints",
        list_with("\t10\t82\t", "\t1\t82\t"),
        {},
        "line 6: 1 (LOCAL_NED) is not supported",
    ),
    "a jump of a list": (
        "a.waypoints",
        list_with("\t177\t2.0", "\t177\t9.0"),
        {},
        "line 7, column 5: no item has number 9; known: 1 to 6",
    ),
    "a list without places": (
        "a.txt",
        "QGC WPL 120\n0\t1\t3\t178\t1\t5\t0\t0\t0\t0\t0\t1\n",
        {},
        "has no item with a place; give plan.home, [latitude, longitude]",
    ),
    "a list as a plan": (
        "a.plan",
        LIST,
        {},
        "is not JSON: line 1, column 1: Expecting value; it begins as a QGC WPL file: call it .waypoints",
    ),
    "a route of a list": (
        "a.waypoints",
        LIST,
        {"route": "x"},
        "plan.route is for .kml, .kmz, .gpx, .geojson, .json; leave it out",
    ),
    "a bomb": ("a.kmz", {"doc.kml": "0" * 17_000_000}, {}, "doc.kml unpacks to 17 MB; allowed: 16 MB"),
    "much in little": (
        "a.kmz",
        {"doc.kml": "0" * 1_000_000},
        {},
        "doc.kml unpacks to 1 MB; allowed: 16 MB, and 100 times",
    ),
    "two documents": (
        "a.kmz",
        {"a.kml": LOCKED, "b.kml": LOCKED},
        {},
        "has 2 .kml files in it; expected doc.kml or one",
    ),
    "no archive": ("a.kmz", b"PK\x03\x04 and more", {}, "is no KMZ archive: "),
    "on the ground": ("a.kml", LOCKED, {}, "'Route 1' is on the ground (altitudeMode clampToGround); give plan.height"),
    "a height too many": (
        "a.kml",
        kml(line("8,47,9 8,48,9")),
        {"height": 5.0},
        "every point has an altitude; leave out plan.height",
    ),
    "a recording": ("a.kml", kml("<Placemark><Track/></Placemark>"), {}, "has no route: its gx:Track is a recording"),
    "no route": ("a.kml", kml(""), {}, "has no route; expected a LineString or Points"),
    "one of two": (
        "a.kml",
        kml(line("8,47,9") + line("8,48,9")),
        {},
        "has 2 routes; choose one by plan.route: 'Route 1 #1', 'Route 1 #2'",
    ),
    "none of two": ("a.kml", kml(line("8,47,9") + line("8,48,9")), {"route": "Rout 1"}, "no route is called 'Rout 1'"),
    "words in a route": (
        "a.kml",
        kml(line("8,47,9 8;48")),
        {},
        "'Route 1', point 2: '8;48'; expected longitude,latitude or",
    ),
    "a swapped place": (
        "a.kml",
        kml(line("-33.0,151.2,9")),
        {},
        "'Route 1', point 1: latitude 151.2; allowed: -90 to 90 deg; is it longitude, latitude?",
    ),
    "a document type": ("a.kml", "<!DOCTYPE kml><kml/>", {}, "has a document type (<!DOCTYPE), which KML has not"),
    "a track": (
        "a.gpx",
        gpx(TRACK),
        {},
        "has no route; it has a track of 812 points: a recorded path is recorded_path",
    ),
    "marks alone": ("a.gpx", gpx('<wpt lat="47" lon="8"/>'), {}, "has no route; it has 1 waypoints without an order"),
    "no ele": ("a.gpx", gpx(route("r", (47, 8))), {}, "'r' has points without ele; give plan.height"),
    "no number": (
        "a.gpx",
        gpx(route("r", (47, "east", 3))),
        {},
        "point 1 of route 'r': lon is 'east'; expected a number",
    ),
    "a height of no number": (
        "a.gpx",
        gpx(route("r", (47, 8, "inf"))),
        {},
        "point 1 of route 'r': altitude inf; allowed: ",
    ),
    "an empty route": ("a.gpx", gpx(route("r")), {}, "its route has no points"),
    "a swapped corner": (
        "a.geojson",
        collection(feature("LineString", [[8, 47, 9]]), feature("Polygon", [[[8, 47], [8, 48], [33.9, 151.2]]])),
        {},
        "feature 1, corner 2: latitude 151.2; allowed: -90 to 90 deg; is it longitude, latitude?",
    ),
    "no GeoJSON": (
        "a.geojson",
        '{"type": "Topology"}',
        {},
        "its type is 'Topology'; expected GeoJSON with a LineString",
    ),
    "no JSON": (
        "a.geojson",
        "{",
        {},
        "is not JSON: line 1, column 2: Expecting property name enclosed in double quotes; expected GeoJSON",
    ),
    "a position of one": (
        "a.geojson",
        collection(feature("LineString", [[8]])),
        {},
        "feature 0, point 1: [8]; expected [longitude",
    ),
    "a huge number": ("a.geojson", collection(feature("Point", [10**400, 1])), {}, "feature 0: [1000"),
    "a height of words": (
        "a.geojson",
        collection(feature("Point", [8, 47], height="9 m")),
        {},
        "feature 0: its height is '9 m'; expected a number",
    ),
    "a home of a plan": ("a.plan", "{}", {"home": Home(47.0, 8.0)}, "has a home; leave out plan.home"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files(write: Write, case: str) -> None:
    name, content, options, words = BAD[case]
    path = write(name, content)
    with pytest.raises((UsageError, ScenarioError)) as caught:
        read_plan(path, **options)
    found = caught.value.problems[0] if isinstance(caught.value, ScenarioError) else str(caught.value)
    assert found.removeprefix(f"{path}: ").startswith(words)
