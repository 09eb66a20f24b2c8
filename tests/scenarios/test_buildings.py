"""Prisms and files of buildings in scenarios: what they become, and what is said of files that are wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.models.scene.prisms import PrismObstacle
from qrsim.scenarios import skylines
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.scenario import load_scenario

pytest.importorskip("shapely", reason="the extra 'buildings' is not installed")

BLOCK = Path(__file__).parents[2] / "examples" / "buildings" / "city_block.geojson"
# One second of arc along a meridian is 30.9 m; 18 m east of the site and 20 m north of it at its latitude.
SQUARE = [[10.0, 20.0], [10.0, 40.0], [30.0, 40.0], [30.0, 20.0]]
Written = Callable[..., dict[str, Any]]


def with_world(world: dict[str, Any], start: tuple[float, float, float] = (0.0, 0.0, -3.0)) -> dict[str, Any]:
    fleet = {"controller": {"type": "waypoint", "feed": "truth"}, "vehicles": [{"position_ned": list(start)}]}
    return {"name": "x", "duration": 1.0, "world": world, "fleets": {"a": fleet}}


def feature(corners: Any, *holes: Any, **properties: Any) -> dict[str, Any]:
    """Return a polygon of corners north, east [m], for ``frame: local``."""
    rings = [[[east, north] for north, east in (*ring, ring[0])] for ring in (corners, *holes)]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": rings}}


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Return a function that writes features and returns the scenario with that file."""

    def write(*features: Any, text: str | None = None, frame: str = "local", **more: Any) -> dict[str, Any]:
        content = json.dumps({"type": "FeatureCollection", "features": features, **more.pop("also", {})})
        (tmp_path / "block.geojson").write_text(content if text is None else text)
        return with_world({"buildings": {"file": str(tmp_path / "block.geojson"), "frame": frame}}, **more)

    return write


def problem_of(content: dict[str, Any]) -> str:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    (problem,) = caught.value.problems
    return problem.replace(str(Path(content["world"]["buildings"]["file"]).parent) + "/", "")


def test_a_file_becomes_prisms_in_the_order_of_the_file_and_its_defaults_are_said() -> None:
    content = with_world(
        {
            "buildings": {"file": str(BLOCK)},
            "obstacles": [{"type": "cylinder", "x": 90.0, "y": 0.0, "radius": 1.0, "z_min": -9.0}],
        }
    )
    with pytest.warns(UserWarning, match=r"1 of 9 buildings have neither height.*feature 6 \(shed\), taken to be 9 m"):
        scenario = load_scenario(content)
    kind, *buildings = scenario.spec.world.obstacles
    assert kind.type == "cylinder"
    assert [round(-b.z_min, 6) for b in buildings] == [18.0, 18.0, 21.0, 15.0, 45.0, 12.0, 9.0, 9.0, 9.0]
    assert buildings[5].z_max == -4.0
    # The file was written from these [m], to a centimetre.
    np.testing.assert_allclose(buildings[0].corners_ned, [[8, -60], [8, -2], [22, -2], [22, -60]], atol=0.02)
    np.testing.assert_allclose(buildings[2].holes_ned, [[[20, 52], [20, 68], [36, 68], [36, 52]]], atol=0.02)
    again = load_scenario(scenario.spec.model_dump(mode="json"))
    assert again.spec == scenario.spec, "what a run keeps has them once, and needs no file"
    assert again.world().obstacles.prisms is not None


def test_who_starts_or_flies_into_a_building_is_told_which(written: Written) -> None:
    content = written(feature(SQUARE, height=10.0, id="town hall"), start=(20.0, 30.0, -3.0))
    assert problem_of(content) == (
        "fleets.a.vehicles.0.position_ned: inside world.obstacles.0 (feature 0 (town hall)); allowed: at least 1 m "
        "from it (half of world.collision_distance)"
    )


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda w: w(text="{\n  nonsense"), "block.geojson: is no JSON: line 2: Expecting property name"),
        (lambda w: w(text="[1]"), "its type is None; expected GeoJSON, a FeatureCollection of polygons"),
        (lambda w: w(text='{"type": "Topology"}'), "its type is 'Topology'; expected GeoJSON"),
        (lambda w: w(), "block.geojson: has no polygon"),
        (
            lambda w: w({"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}, "properties": {}}),
            "has no polygon among 1 features",
        ),
        (
            lambda w: w(feature([[0, 0], [20, 20], [20, 0], [0, 20]], id="bow tie")),
            "feature 0 (bow tie): its outline crosses itself: the edge from corner 0 to 1 meets the edge from corner 2 "
            "to 3 at north 10 m, east 10 m; allowed: an outline that does not cross itself, with its holes inside it",
        ),
        (
            lambda w: w(feature(SQUARE, [[60, 60], [60, 70], [70, 70]])),
            "feature 0: Hole lies outside shell at north 60 m, east 60 m; allowed: an outline that does not",
        ),
        (lambda w: w(feature(SQUARE[:2])), "feature 0: a ring has 2 corners; allowed: 3 to 1000"),
        *(
            (
                lambda w, kind=kind, c=c: w({**feature(SQUARE), "geometry": {"type": kind, "coordinates": c}}),
                "feature 0: its coordinates are no rings of pairs of numbers",
            )
            for kind, c in (
                ("Polygon", 7),
                ("Polygon", [None]),
                ("Polygon", [[[10**400, 0]] * 4]),
                ("MultiPolygon", [None]),
                ("MultiPolygon", [[]]),
            )
        ),
        (lambda w: w(feature([["a", "b"]] * 4)), "feature 0: its coordinates are no rings of pairs of numbers"),
        (lambda w: w(feature(SQUARE, height=-3)), "feature 0: its height is -3 m; allowed: above 0, up to 1000"),
        (lambda w: w(feature(SQUARE, min_height=12)), "begins at 12 m, which is not below the height it gets, 9 m"),
        (
            lambda w: w(feature([[5.7e6, 5.5e5], [5.7e6, 5.6e5], [5.8e6, 5.5e5]]), frame="geodetic"),
            "feature 0: 550000, 5700000 is no longitude and latitude [deg]; metres east and north of the site are "
            "frame: local, and other coordinates have to be converted (ogr2ogr -t_srs EPSG:4326)",
        ),
        (
            lambda w: w(feature(SQUARE), frame="geodetic", also={"crs": {"properties": {"name": "EPSG:27700"}}}),
            "its coordinates are EPSG:27700; allowed: longitude and latitude (ogr2ogr -t_srs EPSG:4326 makes them)",
        ),
        (
            lambda w: w(feature([[5.7e6, 5.5e5], [5.7e6, 5.6e5], [5.8e6, 5.5e5]])),
            "feature 0: it is 5826 km from the site; allowed: at most 50 km; frame: local is for metres east and north",
        ),
        (lambda w: w(feature(SQUARE), frame="geodetic"), "km from the site; allowed: at most 50 km (see site."),
        (
            lambda w: w(feature((np.array(SQUARE) + 9000.0).tolist(), height=9)),
            "all 1 buildings are far from world.area: at north 9010 to 9030 m, east 9020 to 9040 m; look at "
            "site.latitude_deg",
        ),
        (
            lambda w: w(*[feature([[n, 0.0], [n, 1.0], *[[n + 0.5, 0.5]] * 998]) for n in range(51)]),
            "block.geojson: has 51051 corners; allowed: at most 50000 in all; cut it to the area, or simplify",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_place(written: Written, make: Any, said: str) -> None:
    problem = problem_of(make(written))
    assert problem.startswith("world.buildings.file: block.geojson: ")
    assert said in problem
    assert "\n" not in problem


def test_a_file_that_is_not_there_is_told_with_the_nearest_name(written: Written) -> None:
    content = written(feature(SQUARE, height=9))
    file = content["world"]["buildings"]["file"]
    content["world"]["buildings"]["file"] = file.replace("block", "blok")
    assert "blok.geojson: cannot be read: No such file or directory; did you mean" in problem_of(content)


def test_heights_are_read_as_people_write_them(written: Written) -> None:
    given: list[dict[str, Any]] = [
        {"height": "12,5"}, {"height": "30 ft"}, {"building:levels": "4"}, {"building:height": 7},
        {"height": "tall", "building:levels": 2}, {"building:levels": 3, "building:min_level": 1},
        {"height": "39'4\""}, {"height": "30 Ft"}, {"building:levels": "1,2"},
        {"building:levels": "2", "roof:levels": 1},
        {"building:levels": "2", "roof:height": 2.5}, {"height": 0, "building:levels": 0}, {"height": 10**400},
        {"height": "39 ft 4 in"}, {"height": "120\""}, {"height": "12 metres"}, {"height": " "},
        {"building:levels": 0, "roof:levels": 1}, {"building:levels": 2, "building:min_level": -1},
        {"building:levels": -1},
    ]  # fmt: skip
    features = [feature(SQUARE, **properties) for properties in given]
    world = load_scenario(written(*features, start=(-9.0, 0.0, -3.0))).spec.world
    assert [-round(prism.z_min, 3) for prism in world.obstacles] == [
        12.5, 9.144, 12.0, 7.0, 6.0, 9.0, 11.989, 9.144, 6.0, 9.0, 8.5, 9.0, 9.0,
        11.989, 3.048, 12.0, 9.0, 3.0, 6.0, 9.0,
    ]  # fmt: skip
    assert [-prism.z_max for prism in world.obstacles] == [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, *[0.0] * 14]


def test_what_is_no_building_is_left_out_and_counted(written: Written) -> None:
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [0, 0]}, "properties": {"building": "yes"}}
    wood, house, none = (
        feature(SQUARE, height=9, **tags) for tags in ({"natural": "wood"}, {"building": "yes"}, {"building": "no"})
    )
    words = r"left out: 2 are no buildings \(building=\*\), 1 are neither polygons nor multipolygons"
    with pytest.warns(UserWarning, match=words):
        scenario = load_scenario(written(wood, house, none, point, start=(-9.0, 0.0, -3.0)))
    assert [prism.name for prism in scenario.spec.world.obstacles] == ["feature 1"]


def test_of_an_export_without_buildings_nothing_is_one(written: Written) -> None:
    wood, water, plain = feature(SQUARE, natural="wood", height=12), feature(SQUARE, natural="water"), feature(SQUARE)
    no_building = feature(SQUARE, building="no"), feature(SQUARE, building=None), feature(SQUARE, **{"@id": "way/1"})
    for features in ((water, plain, plain), no_building):
        ending = "has 3 polygons, none of them a building (building=*) among 3 features"
        assert problem_of(written(*features)).endswith(ending)
    ending = "among 1 features; 1 are woods or trees (world.buildings.trees makes them obstacles)"
    assert problem_of(written(wood)).endswith(ending)


def test_woods_and_trees_are_obstacles_where_they_are_asked_for(written: Written) -> None:
    point = {"type": "Point", "coordinates": [50.0, 5.0]}
    features = [
        feature(SQUARE, natural="wood"),
        feature(SQUARE, landuse="forest", height=12),
        feature(SQUARE, building="yes", height=5),
        feature(SQUARE, natural="water"),
        {"type": "Feature", "geometry": point, "properties": {"natural": "tree", "diameter_crown": 8}},
        {"type": "Feature", "geometry": {**point, "coordinates": [5.0, 50.0]}, "properties": {"natural": "tree"}},
        {"type": "Feature", "geometry": point, "properties": {"amenity": "bench"}},
    ]
    content = written(*features, start=(-9.0, 0.0, -3.0))
    with pytest.warns(UserWarning, match=r"out: 3 are no buildings \(building=\*\), 3 are neither .*; 4 are woods"):
        assert len(load_scenario(content).spec.world.obstacles) == 1
    content["world"]["buildings"]["trees"] = 15.0
    with pytest.warns(UserWarning, match=r"left out: 1 are no buildings \(building=\*\), 1 are neither [a-z ]*$"):
        found = load_scenario(content).spec.world.obstacles
    assert [-prism.z_min for prism in found] == [15.0, 12.0, 5.0, 15.0, 15.0]
    for prism, middle, radius in zip(found[3:], ([5.0, 50.0], [50.0, 5.0]), (4.0, 2.5), strict=True):
        corners = np.array(prism.corners_ned)
        np.testing.assert_allclose(corners.mean(axis=0), middle, atol=1e-9)
        np.testing.assert_allclose(np.hypot(*(corners - middle).T), radius)


def test_corners_of_what_is_no_building_do_not_count(written: Written) -> None:
    wood = feature([[float(i), 0.0] for i in range(1000)], natural="wood")
    house = feature(SQUARE, building="yes", height=5)
    scenario = load_scenario(written(*[wood] * 51, house, start=(-9.0, 0.0, -3.0)), quiet=True)
    assert len(scenario.spec.world.obstacles) == 1


def test_prisms_in_a_scenario_are_checked_and_can_be_made_in_python() -> None:
    bow_tie = {"type": "prism", "corners_ned": [[5, 0], [25, 20], [25, 0], [5, 20]], "z_min": -9.0}
    with pytest.raises(ScenarioError, match=r"world.obstacles.0.corners_ned: crosses itself: the edge from corner 0"):
        load_scenario(with_world({"obstacles": [bow_tie]}))
    solid = PrismObstacle.of(SQUARE, -9.0, 0.0, [[[15, 25], [15, 30], [20, 30]]])
    (found,) = make_scenario([[0.0, 0.0, -5.0]], obstacles=[solid]).spec.world.obstacles
    assert found.corners_ned == SQUARE
    assert found.holes_ned == [[[15.0, 25.0], [15.0, 30.0], [20.0, 30.0]]]


def seen_by(obstacles: list[Any], **buildings: Any) -> dict[str, Any]:
    """Return a scenario with a receiver, in the area of 2 km by 2 km that scenarios have by default."""
    content = with_world({"obstacles": obstacles, **({"buildings": buildings} if buildings else {})})
    content["fleets"]["a"]["sensors"] = {"gnss": {"type": "gnss"}}
    return content


def test_a_table_that_would_not_fit_is_refused_with_the_pitch_that_does() -> None:
    far = [{"type": "prism", "corners_ned": (np.array(SQUARE) + at).tolist(), "z_min": -30.0} for at in (-990, 960)]
    with pytest.raises(ScenarioError) as caught:
        load_scenario(seen_by(far))
    # 2 km by 2 km in cells of 4 m, at 0, 2, 5, 10, 15, 20 and 30 m, 64 azimuths, 4 bytes each: 427 MB. 5 m make it 273.
    assert caught.value.problems == [
        "world.buildings.table.pitch: 4 m makes a table of 427 MB of what obstacles hide of the sky; allowed: at most "
        "256 MB; a pitch of 5.5 m fits, or a smaller world.area"
    ]
    coarse = load_scenario(seen_by(far, table={"pitch": 20.0, "azimuths": 32})).world().skyline
    assert coarse is not None
    assert (coarse.rows, coarse.columns, coarse.azimuths) == (100, 100, 32)
    assert load_scenario(with_world({"obstacles": far})).world().skyline is None, "nobody looks at satellites"


@pytest.mark.parametrize(("half", "pitch"), [(20.0, 1.0), (100.0, 2.0), (400.0, 4.0)])
def test_the_cells_of_a_table_are_as_fine_as_is_cheap(half: float, pitch: float) -> None:
    """A tower of 60 m is seen at 340 m above 10 degrees: areas of 40, 200 and 800 m, of 64 x 9 entries of 4 bytes."""
    tower = [{"type": "box", "x_min": 5.0, "x_max": 15.0, "y_min": 5.0, "y_max": 15.0, "z_min": -60.0}]
    content = seen_by(tower)
    content["world"]["area"] = {
        "type": "box",
        "x_min": -half,
        "x_max": half,
        "y_min": -half,
        "y_max": half,
        "z_min": -90,
    }
    plan = skylines._plan(load_scenario(content).spec)
    assert plan is not None
    assert plan.frame.pitch == pitch


def test_a_table_is_kept_and_made_anew_where_it_is_damaged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("QRSIM_CACHE_DIR", str(tmp_path / "qrsim"))
    monkeypatch.delenv("QRSIM_COMPILATION_CACHE", raising=False)
    monkeypatch.setattr(skylines, "LEAST_KEPT", 0)
    block = [{"type": "prism", "corners_ned": SQUARE, "z_min": -3.0}]
    spec = load_scenario(seen_by(block, table={"pitch": 10.0, "azimuths": 16})).spec

    def words() -> Any:
        skylines._made.cache_clear()
        table = skylines.skyline(spec)
        assert table is not None
        return np.asarray(table.words)

    first = words()
    (kept,) = (tmp_path / "qrsim" / "skylines").iterdir()
    monkeypatch.setattr(skylines, "make_table", None)
    np.testing.assert_array_equal(words(), first)
    monkeypatch.undo()
    monkeypatch.setenv("QRSIM_CACHE_DIR", str(tmp_path / "qrsim"))
    monkeypatch.delenv("QRSIM_COMPILATION_CACHE", raising=False)
    monkeypatch.setattr(skylines, "LEAST_KEPT", 0)
    kept.write_bytes(b"nonsense")
    np.testing.assert_array_equal(words(), first)
    assert kept.read_bytes() != b"nonsense"


@pytest.mark.parametrize(
    ("properties", "said"),
    [
        (
            {"height": "ca. 12 m"},
            r"feature 0: its height 'ca. 12 m' is not understood; expected metres.*taken to be 9 m",
        ),
        ({"building:levels": "four"}, "its building:levels 'four' is not understood"),
        ({"height": "", "levels": True}, "its levels True is not understood"),
    ],
)
def test_a_height_that_is_not_understood_is_told_as_it_is(
    properties: dict[str, Any], said: str, written: Written
) -> None:
    content = written(feature(SQUARE, **properties), start=(0.0, 0.0, -3.0))
    with pytest.warns(UserWarning, match=said) as caught:
        load_scenario(content)
    assert not [each for each in caught if "neither height" in str(each.message)]
