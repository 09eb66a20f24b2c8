"""Places of a scenario by latitude and longitude, from plans, and fences from files: all are NED once it is loaded."""

from __future__ import annotations

import json
import math
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim.core.vectors import Vec3
from qrsim.errors import ScenarioError
from qrsim.models.scene.fence import PolygonArea
from qrsim.models.site import Site
from qrsim.scenarios.checks import distance_outside
from qrsim.scenarios.reading import parse_yaml
from qrsim.scenarios.scenario import load_scenario

SITE = {"latitude_deg": 47.0, "longitude_deg": 8.0, "height": 450.0}
HOME = (47.0005, 8.0)
# Of the site above the sea: the geoid is 48.4 m above the ellipsoid there.
LEVEL = 401.6
SQUARE = [[47.001, 8.001], [47.001, 7.999], [46.999, 7.999], [46.999, 8.001]]
LAND, TAKEOFF, WAYPOINT, CHANGE_SPEED = 21, 22, 16, 178
Item = dict[str, Any]


def scenario(*vehicles: dict[str, Any], area: dict[str, Any] | None = None, **fleet: Any) -> dict[str, Any]:
    """A scenario of one fleet that is flown on the truth."""
    fleet = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": list(vehicles), **fleet}
    return {
        "name": "x",
        "duration": 10.0,
        "site": SITE,
        "world": {"area": area or {"type": "box"}},
        "fleets": {"a": fleet},
    }


def geodetic(latitude: float, longitude: float, height: float) -> dict[str, float]:
    return {"latitude_deg": latitude, "longitude_deg": longitude, "height": height}


def item(command: int, latitude: float, longitude: float, height: float, first: float = 0.0) -> Item:
    params = [first, 0, 0, 0, latitude, longitude, height]
    return {"type": "SimpleItem", "command": command, "frame": 3, "params": params, "autoContinue": True}


SURVEY = (
    item(TAKEOFF, *HOME, 12.0),
    item(CHANGE_SPEED, 0.0, 0.0, 0.0),
    item(WAYPOINT, 47.0008, 8.0003, 20.0, first=5.0),
    item(CHANGE_SPEED, 0.0, 0.0, 0.0),
    item(WAYPOINT, 46.9995, 7.9995, 25.0),
    item(LAND, *HOME, 0.0),
)


@pytest.fixture
def write_plan(tmp_path: Path) -> Callable[..., str]:
    """Write a plan whose home is 56 m north of the site and as high as it, and return its path."""

    def write(*items: Item, name: str = "survey.plan", version: int = 1, **geofence: Any) -> str:
        mission = {"version": 2, "plannedHomePosition": [*HOME, LEVEL], "items": list(items)}
        fence = {"version": 2, "polygons": [], "circles": [], **geofence}
        content = {"fileType": "Plan", "version": version, "mission": mission, "geoFence": fence}
        path = tmp_path / name
        path.write_text(json.dumps(content), "utf-8")
        return str(path)

    return write


def polygon(inclusion: bool = True) -> dict[str, Any]:
    return {"version": 1, "inclusion": inclusion, "polygon": SQUARE}


def circle(radius: float, inclusion: bool = True) -> dict[str, Any]:
    return {"version": 1, "inclusion": inclusion, "circle": {"center": [47.0, 8.0], "radius": radius}}


@pytest.fixture
def write_kml(tmp_path: Path) -> Callable[..., str]:
    def write(*, hole: bool = False, names: tuple[str, ...] = ("Field",)) -> str:
        ring = f"<LinearRing><coordinates>{' '.join(f'{lon},{lat}' for lat, lon in SQUARE)}</coordinates></LinearRing>"
        inner = f"<innerBoundaryIs>{ring}</innerBoundaryIs>" if hole else ""
        shape = f"<Polygon><outerBoundaryIs>{ring}</outerBoundaryIs>{inner}</Polygon>"
        marks = "".join(f"<Placemark><name>{name}</name>{shape}</Placemark>" for name in names)
        path = tmp_path / "field.kml"
        path.write_text(f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document>{marks}</Document></kml>', "utf-8")
        return str(path)

    return write


def problems_of(content: dict[str, Any]) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    return caught.value.problems


def north_east(latitude: float, longitude: float) -> list[float]:
    """Metres along meridian and parallel, with the curvature of the ellipsoid at 47 degrees and 450 m."""
    axis, squared = 6378137.0, 0.00669437999014
    root = math.sqrt(1.0 - squared * math.sin(math.radians(47.0)) ** 2)
    along_meridian = axis * (1.0 - squared) / root**3 + SITE["height"]
    along_parallel = (axis / root + SITE["height"]) * math.cos(math.radians(47.0))
    return [math.radians(latitude - 47.0) * along_meridian, math.radians(longitude - 8.0) * along_parallel]


# ---------------------------------------------------------------- latitude and longitude


def test_positions_in_latitude_and_longitude_are_metres_from_the_site() -> None:
    vehicle = {
        "position_geodetic": geodetic(47.001, 8.0, 10.0),
        "waypoints_geodetic": [geodetic(47.0, 8.002, 30.0), geodetic(46.999, 7.999, 0.5)],
    }
    (loaded,) = load_scenario(scenario(vehicle)).spec.fleets["a"].vehicles
    found = [loaded.position_ned, *loaded.waypoints_ned]
    expected = [
        [*north_east(47.001, 8.0), -10.0],
        [*north_east(47.0, 8.002), -30.0],
        [*north_east(46.999, 7.999), -0.5],
    ]
    # 200 m from the site the plane and the ellipsoid are apart by millimetres in the horizontal.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.005)
    assert [z for _, _, z in found] == [-10.0, -30.0, -0.5]


def test_the_way_back_to_latitude_and_longitude_gives_the_same_place() -> None:
    place = geodetic(47.0123, 7.9871, 40.0)
    area = {"type": "box", "x_max": 2000.0}
    (vehicle,) = load_scenario(scenario({"position_geodetic": place}, area=area)).spec.fleets["a"].vehicles
    north, east, _ = vehicle.position_ned
    site = Site.from_degrees(*SITE.values())
    # At the height where a vertical through the plane meets the site's own height.
    down = float(site.geodetic_to_ned(math.radians(47.0123), math.radians(7.9871), SITE["height"])[2])
    latitude, longitude, _ = site.ned_to_geodetic([north, east, down])
    np.testing.assert_allclose(np.degrees([latitude, longitude]), [47.0123, 7.9871], rtol=0.0, atol=1e-12)


def test_ned_and_geodetic_can_be_mixed_but_each_is_given_once() -> None:
    vehicle = {"position_ned": [0.0, 0.0, -5.0], "waypoints_geodetic": [geodetic(47.0, 8.0, 9.0)]}
    (loaded,) = load_scenario(scenario(vehicle)).spec.fleets["a"].vehicles
    np.testing.assert_allclose(loaded.waypoints_ned, [[0.0, 0.0, -9.0]], rtol=0.0, atol=1e-8)
    place = geodetic(47.0, 8.0, 9.0)
    both = scenario({"position_ned": [0, 0, -5], "position_geodetic": place})
    where = "fleets.a.vehicles.0"
    assert problems_of(both) == [f"{where}: gives both 'position_ned' and 'position_geodetic'; give one"]
    both = scenario({"position_ned": [0, 0, -5], "waypoints_ned": [[0, 0, -5]], "waypoints_geodetic": [place]})
    assert problems_of(both) == [f"{where}: gives both 'waypoints_ned' and 'waypoints_geodetic'; give one"]
    both = scenario({"position_ned": [0, 0, -5], "waypoints_geodetic": [place], "plan": {"file": "a.plan"}})
    assert problems_of(both) == [f"{where}: gives both 'waypoints_geodetic' and 'plan'; give one"]
    neither = f"{where}: the start is missing; give position_ned, position_geodetic or plan"
    assert problems_of(scenario({"waypoints_geodetic": [place]})) == [neither]


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        (geodetic(91.0, 8.0, 9.0), "position_geodetic.latitude_deg: 91.0 is out of range; allowed: -90 to 90"),
        ({"latitude_deg": 47.0, "height": 3.0}, "position_geodetic.longitude_deg: missing"),
        ({**geodetic(47.0, 8.0, 9.0), "heigth": 3.0}, "position_geodetic.heigth: no such parameter of 'geodetic'; did"),
        (
            geodetic(46.0, 8.0, 9.0),
            "position_geodetic: latitude 46 deg, longitude 8 deg is 111 km from the site; allowed",
        ),
        (geodetic(47.01, 8.0, 9.0), "position_geodetic: x = 1111.79 m is outside world.area; allowed: -1000 to 1000"),
    ],
)
def test_a_bad_place_is_named(place: dict[str, float], expected: str) -> None:
    (problem,) = problems_of(scenario({"position_geodetic": place}))
    assert problem.startswith(f"fleets.a.vehicles.0.{expected}"), problem


def test_a_bad_waypoint_is_named() -> None:
    places = [geodetic(47.0, 8.0, 9.0), {**geodetic(47.0, 8.0, 9.0), "height": "high"}]
    (problem,) = problems_of(scenario({"position_ned": [0, 0, -5], "waypoints_geodetic": places}))
    assert problem.startswith("fleets.a.vehicles.0.waypoints_geodetic.1.height: 'high' is not a number")
    places[1] = geodetic(47.0, 8.0, 200.0)
    (problem,) = problems_of(scenario({"position_ned": [0, 0, -5], "waypoints_geodetic": places}))
    assert problem.startswith("fleets.a.vehicles.0.waypoints_geodetic.1: z = -200 m is outside world.area; allowed")


# ---------------------------------------------------------------- plans


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_plan_is_a_route_that_is_flown_once(write_plan: Callable[..., str]) -> None:
    """From above home at the height of the first waypoint to above the landing at the height it has."""
    content = scenario({"plan": {"file": write_plan(*SURVEY)}})
    fleet = load_scenario(content).spec.fleets["a"]
    (vehicle,) = fleet.vehicles
    home, first, second = north_east(*HOME), north_east(47.0008, 8.0003), north_east(46.9995, 7.9995)
    np.testing.assert_allclose(vehicle.position_ned, [*home, -12.0], rtol=0.0, atol=0.001)
    route = [[*home, -12.0], [*first, -20.0], [*second, -25.0], [*home, -25.0]]
    np.testing.assert_allclose(vehicle.waypoints_ned, route, rtol=0.0, atol=0.001)
    assert fleet.guidance.repeat is False
    content["fleets"]["a"]["guidance"] = {"type": "route", "repeat": True}
    content["fleets"]["a"]["vehicles"][0]["position_ned"] = [1.0, 2.0, -3.0]
    fleet = load_scenario(content).spec.fleets["a"]
    assert fleet.guidance.repeat is True
    assert fleet.vehicles[0].position_ned == [1.0, 2.0, -3.0]
    np.testing.assert_allclose(fleet.vehicles[0].waypoints_ned, route, rtol=0.0, atol=0.001)


def test_what_of_a_plan_is_not_flown_is_told_once_for_each_kind(write_plan: Callable[..., str]) -> None:
    file = write_plan(*SURVEY, polygons=[polygon()], breachReturn=[47.0, 8.0, 30.0])
    fleet = {"plan": {"file": file}}, {"position_ned": [0.0, 50.0, -30.0], "plan": {"file": file}}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario(scenario(*fleet))
    assert [str(warning.message) for warning in caught] == [
        f"{file}: item 2, DO_CHANGE_SPEED: not carried out (and 1 more of its kind)",
        f"{file}: item 3, NAV_WAYPOINT: not flown: hold for 5 s",
        f"{file}: geoFence.breachReturn: not used",
        f"{file}: item 6, NAV_LAND: not landed, but flown over",
        f"{file}: geoFence: not used, because world.area is 'box'; give {{type: fence, file: ...}}",
        f"{file}: 2 vehicles fly it, on one path and to one place, where they may collide; give each its own plan",
    ]
    # Where only its fence is used, what its mission asks for concerns nobody.
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario(scenario({"position_ned": [0, 0, -5]}, area={"type": "fence", "file": file}))
    assert [str(warning.message) for warning in caught] == [f"{file}: geoFence.breachReturn: not used"]


def test_a_plan_is_looked_for_beside_the_scenario(
    write_plan: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plan(item(WAYPOINT, *HOME, 12.0))
    text = f"name: x\nsite: {json.dumps(SITE)}\nfleets: {{a: {{controller: {{type: waypoint, feed: truth}}, "
    (tmp_path / "x.yaml").write_text(f"{text}vehicles: [{{plan: {{file: survey.plan}}}}]}}}}\n", "utf-8")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    loaded = load_scenario("../x.yaml")
    # The scenario that is saved needs neither the plan nor the site's geodesy.
    text = loaded.to_yaml()
    assert not any(word in text for word in ("plan", "geodetic", "fence"))
    assert load_scenario(parse_yaml(text, "again")).spec == loaded.spec


def test_a_bad_plan_is_named(write_plan: Callable[..., str]) -> None:
    def problem(file: str, **more: Any) -> str:
        (found,) = problems_of(scenario({"plan": {"file": file}, **more}))
        return found

    where = "fleets.a.vehicles.0.plan"
    old = write_plan(*SURVEY, version=2)
    assert problem(old) == f"{where}: {old}: version: version 2 is not supported; supported: 1"
    assert problem("gone.plan").startswith(f"{where}: {Path('gone.plan').absolute()}: cannot be read: No such file")
    empty = write_plan()
    assert problem(empty) == f"{where}: {empty}: has no waypoint to start at; give position_ned or position_geodetic"
    load_scenario(scenario({"plan": {"file": empty}, "position_ned": [0, 0, -5]}))
    lands = write_plan(item(LAND, *HOME, 0.0))
    assert "item 1, NAV_LAND, has no waypoint before it" in problem(lands)
    long = write_plan(*[item(WAYPOINT, *HOME, 12.0)] * 2001)
    assert problem(long) == f"{where}: {long}: has 2001 waypoints; allowed: at most 2000"
    far = write_plan(item(WAYPOINT, 46.0, 8.0, 12.0))
    assert "latitude 46 deg, longitude 8 deg is 111 km from the site; allowed: at most 50 km" in problem(far)


def test_a_waypoint_of_a_plan_outside_the_area_is_named(write_plan: Callable[..., str]) -> None:
    file = write_plan(item(WAYPOINT, *HOME, 12.0), item(WAYPOINT, 47.0, 8.0, 130.0))
    assert problems_of(scenario({"plan": {"file": file}})) == [
        f"fleets.a.vehicles.0.plan: {file}: item 2: z = -130 m is outside world.area; allowed: -120 to 0"
    ]
    high = write_plan(item(WAYPOINT, *HOME, 130.0))
    assert [problem.partition(": z")[0] for problem in problems_of(scenario({"plan": {"file": high}}))] == [
        f"fleets.a.vehicles.0.plan: {high}: above home",
        f"fleets.a.vehicles.0.plan: {high}: item 1",
    ]


# ---------------------------------------------------------------- polygons and fences

L_SHAPE = [[0.0, 0.0], [0.0, 60.0], [40.0, 60.0], [40.0, 40.0], [20.0, 40.0], [20.0, 0.0]]


def test_a_polygon_is_an_area() -> None:
    area = {"type": "polygon", "corners_ned": L_SHAPE, "z_min": -50.0}
    loaded = load_scenario(scenario({"position_ned": [10.0, 10.0, -5.0]}, area=area))
    built = loaded.world("float64").area
    assert isinstance(built, PolygonArea)
    np.testing.assert_array_equal(np.stack([built.north, built.east], axis=1), L_SHAPE)
    assert (float(built.z_min), float(built.z_max)) == (-50.0, 0.0)
    assert load_scenario(parse_yaml(loaded.to_yaml(), "again")).spec == loaded.spec


@pytest.mark.long
def test_places_are_checked_as_in_flight() -> None:
    """The check at load and the area of a world agree on what is outside, and by how much."""
    points = np.random.default_rng(1).uniform(-20.0, 80.0, (400, 3))
    north, east = np.array(L_SHAPE).T
    area = PolygonArea(north, east, np.array(-50.0), np.array(0.0))  # type: ignore[arg-type]
    distance = np.asarray(area.distance_to_fence(Vec3(*points.astype(np.float32).T)))  # type: ignore[arg-type]
    found = [distance_outside(L_SHAPE, point) for point in points.tolist()]
    np.testing.assert_allclose(found, np.maximum(-distance, 0.0), rtol=0.0, atol=1e-4)
    assert 50 < np.count_nonzero(found) < 350


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"corners_ned": [[0, 0], [1, 1]]}, "world.area.corners_ned: expected at least 3, found 2 ([north, east]"),
        (
            {"corners_ned": [[0, 0], [1, 1], [2]]},
            "world.area.corners_ned.2: expected 2 numbers, found 1 ([north, east]",
        ),
        ({"corners_ned": [[0, 0], [1, 1], [0, 1], [1, 0]]}, "world.area.corners_ned: crosses itself: the edge from"),
        ({"corners_ned": [[0, 0], [1, 1], [2, 2]]}, "world.area.corners_ned: encloses no area"),
        ({"corners_ned": [[0, 0], [0, 9], [math.nan, 0]]}, "world.area.corners_ned.2.0: nan is not a finite number"),
        ({"corners": L_SHAPE}, "world.area.corners: no such parameter of 'polygon'; did you mean 'corners_ned'?"),
        ({"z_min": 0.0}, "world.area.z_min: 0 m is not below z_max, 0 m"),
        ({"north": [1.0]}, "world.area.north: no such parameter of 'polygon'"),
    ],
)
def test_a_bad_polygon_is_named(change: dict[str, Any], expected: str) -> None:
    area = {"type": "polygon", "corners_ned": L_SHAPE, **change}
    problems = problems_of(scenario({"position_ned": [10.0, 10.0, -5.0]}, area=area))
    assert any(problem.startswith(expected) for problem in problems), problems


def test_a_place_outside_a_polygon_is_named_with_the_distance() -> None:
    area = {"type": "polygon", "corners_ned": L_SHAPE, "z_min": -50.0}
    vehicle = {"position_ned": [30.0, 20.0, -5.0], "waypoints_ned": [[10.0, 10.0, -5.0], [-3.0, -4.0, -60.0]]}
    assert problems_of(scenario(vehicle, area=area)) == [
        "fleets.a.vehicles.0.position_ned: north 30 m, east 20 m is 10 m outside the polygon of world.area; "
        "allowed: inside it",
        "fleets.a.vehicles.0.waypoints_ned.1: z = -60 m is outside world.area; allowed: -50 to 0",
        "fleets.a.vehicles.0.waypoints_ned.1: north -3 m, east -4 m is 5 m outside the polygon of world.area; "
        "allowed: inside it",
    ]


def fence_of(file: str, **more: Any) -> Any:
    vehicle = {"position_ned": [0.0, 0.0, -5.0]}
    return load_scenario(scenario(vehicle, area={"type": "fence", "file": file, **more})).spec.world.area


def test_a_fence_is_the_polygon_of_its_file(
    write_kml: Callable[..., str], write_plan: Callable[..., str], tmp_path: Path
) -> None:
    expected = [north_east(*corner) for corner in SQUARE]
    files = write_kml(), write_plan(polygons=[polygon()])
    packed, json_file = tmp_path / "packed.kmz", tmp_path / "field.geojson"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(files[0], "doc.kml")
    coordinates = [[[longitude, latitude] for latitude, longitude in SQUARE]]
    json_file.write_text(json.dumps({"type": "Polygon", "coordinates": coordinates}))
    for file in (*files, str(packed), str(json_file)):
        area = fence_of(file, z_min=-40.0)
        assert (area.type, area.z_min, area.z_max) == ("polygon", -40.0, 0.0)
        np.testing.assert_allclose(area.corners_ned, expected, rtol=0.0, atol=0.005)
    chosen = fence_of(write_kml(names=("A", "B")), name="B")
    np.testing.assert_allclose(chosen.corners_ned, expected, rtol=0.0, atol=0.005)


def test_a_circle_is_kept_in_by_a_polygon_inside_it(write_plan: Callable[..., str]) -> None:
    corners = np.array(fence_of(write_plan(circles=[circle(80.0)])).corners_ned)
    np.testing.assert_allclose(np.hypot(*corners.T), 80.0, rtol=1e-9)
    middles = 0.5 * (corners + np.roll(corners, -1, axis=0))
    assert 80.0 * 0.996 < np.min(np.hypot(*middles.T)) < 80.0


def test_a_bad_fence_is_named(write_kml: Callable[..., str], write_plan: Callable[..., str], tmp_path: Path) -> None:
    def problem(file: str, **more: Any) -> str:
        with pytest.raises(ScenarioError) as caught:
            fence_of(file, **more)
        (found,) = caught.value.problems
        return found

    hole = write_kml(hole=True)
    assert problem(hole).startswith(f"world.area: {hole}: polygon 'Field' has a hole, and a fence")
    two = write_kml(names=("North", "South"))
    assert problem(two) == f"world.area: {two}: has 2 polygons; choose one by its name: 'North', 'South'"
    assert "no polygon is called 'Soth'; did you mean 'South'?" in problem(two, name="Soth")
    assert "fence.shp: is no fence; allowed: files that end in .plan, .kml" in problem("fence.shp")
    assert "gone.kml: cannot be read: No such file" in problem("gone.kml")
    counts = "polygons or circles to stay in and {} to stay out of; supported: one to stay in"
    assert counts.format(0) in problem(write_plan())
    assert "have no names, so none is called 'A'" in problem(write_plan(polygons=[polygon()]), name="A")
    old = write_plan(polygons=[polygon()], version=3)
    assert problem(old) == f"world.area: {old}: version: version 3 is not supported; supported: 1"
    away = tmp_path / "away.kml"
    away.write_text(Path(write_kml()).read_text("utf-8").replace("47.001", "48.001"), "utf-8")
    assert "is 111 km from the site" in problem(str(away))


def test_a_vehicle_that_flies_out_of_a_fence_stops_there(write_plan: Callable[..., str]) -> None:
    """Along a straight line north at a few metres per second, from inside over the northern edge 111 m away."""
    area = {"type": "fence", "file": write_plan(polygons=[polygon()])}
    edge = north_east(47.001, 8.0)[0]
    vehicle = {"position_ned": [edge - 6.0, 0.0, -20.0], "velocity_body": [4.0, 0.0, 0.0]}
    content = scenario(
        vehicle,
        area=area,
        vehicle={"type": "pelican", "process_noise": 0.0},
        controller={"type": "velocity", "feed": "truth"},
        guidance={"type": "velocity", "velocity_north": 3.0},
    )
    simulation = qrsim.load(content)
    simulation.reset()
    simulation.step(ticks=200)
    assert not simulation.valid.any()
    (reason,) = simulation.reasons
    kind, _, value = reason.partition(" = -")
    assert kind == "out_of_area: fence"
    # It stopped within the step that crossed the edge.
    assert 0.0 < float(value.removesuffix(" m")) < 15.0 * simulation.world.time_step
    assert edge - 0.3 < float(simulation.truth.position_ned[0, 0]) <= edge
