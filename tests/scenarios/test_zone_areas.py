"""Areas of zones: what scenarios and files may give, and what is refused."""

from __future__ import annotations

import json
import zipfile
from typing import Any

import numpy as np
import pytest

from qrsim.errors import ScenarioError
from qrsim.models.scene.zones import ZonesArea
from qrsim.scenarios.making import make_scenario
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.scenarios.zone_schema import zones_of

FIELD = [[-60, -60], [-60, 60], [60, 60], [60, -60]]
CORNERS = [[51.711, -0.212], [51.711, -0.209], [51.713, -0.209], [51.713, -0.212]]
INNER = [[51.7125, -0.2115], [51.7125, -0.211], [51.7128, -0.211]]
SCHOOL = {"circle_ned": [30, 0], "radius": 10, "ceiling": 30, "name": "school"}


def content(area: dict[str, Any], vehicle: dict[str, Any] | None = None) -> dict[str, Any]:
    return {
        "extends": "hover_ideal",
        "name": "zoned",
        "site": {"latitude_deg": 51.7119, "longitude_deg": -0.21052, "height": 90.0},
        "world": {"area": {"type": "zones", **area}},
        "fleets": {"pelicans": {"vehicles": [vehicle or {"position_ned": [0, 0, -15]}]}},
    }


def load(*args: Any) -> Scenario:
    return load_scenario(content(*args))


def fault(*args: Any) -> str:
    with pytest.raises(ScenarioError) as caught:
        load(*args)
    return "\n".join(caught.value.problems)


@pytest.mark.parametrize(
    ("area", "message"),
    [
        ({}, "world.area: has no zones; give stay_in, stay_out or both"),
        ({"stay_inn": [{"polygon_ned": FIELD}]}, "did you mean 'stay_in'"),
        ({"stay_in": [{"name": "x"}]}, "gives no shape; give one of file, polygon_ned"),
        ({"stay_in": [{"polygon_ned": FIELD, "circle_ned": [0, 0], "radius": 1}]}, "'polygon_ned' and 'circle_ned'"),
        ({"stay_in": [{"circle_ned": [0, 0]}]}, "gives 'circle_ned' without 'radius'"),
        ({"stay_in": [{"polygon_ned": FIELD, "floor": 50, "ceiling": 20}]}, "ceiling 20 m is not above floor, 50 m"),
        ({"stay_in": [{"polygon_ned": [[0, 0], [9, 9], [0, 9], [9, 0]]}]}, "stay_in.0.polygon_ned: crosses itself"),
        (
            {"stay_in": [{"polygon_ned": FIELD, "holes_ned": [[[70, 70], [80, 70], [80, 80]]]}]},
            "ned.0: is not inside",
        ),
        ({"stay_in": [{"polygon_ned": FIELD}], "breach": "reprot"}, "breach"),
        ({"stay_in": [{"polygon_geodetic": [[-0.21, 51.71], [-0.2, 51.71], [-0.2, 51.72]]}]}, "longitude swapped"),
        ({"stay_out": [{"circle_ned": [500 + i, 0], "radius": 1} for i in range(201)]}, "200"),
        ({"stay_in": [{"polygon_ned": FIELD}], "stay_out": [{"circle_ned": [0, 0], "radius": 200}]}, "nothing is left"),
        (
            {"stay_in": [{"circle_ned": [99, 0], "radius": 9}]},
            "starts 90 m outside the zones to stay in",
        ),
    ],
)
def test_faults_name_place_and_what_is_allowed(area: dict[str, Any], message: str) -> None:
    assert message in fault(area)


def test_a_start_inside_a_zone_to_stay_out_of() -> None:
    found = fault({"stay_out": [SCHOOL]}, {"position_ned": [23.2, 0, -15]})
    assert found == "fleets.pelicans.vehicles.0.position_ned: starts 3.2 m inside 'school', to stay out of"


def test_legs_across_a_zone() -> None:
    area = {"stay_in": [{"polygon_ned": FIELD}], "stay_out": [SCHOOL]}
    route = {"position_ned": [0, 0, -15], "waypoints_ned": [[50, 0, -15], [50, 20, -15], [50, 90, -15]]}
    found = fault(area, route).splitlines()
    assert found[0].endswith("vehicles.0.waypoints_ned.0: 20 m of it are inside 'school', first at north 20, east 0 m")
    assert found[1].endswith("ned.2: 30 m of it are outside the zones to stay in, first at north 50, east 60 m")
    with pytest.warns(UserWarning, match="20 m of it are inside 'school'"):
        load({**area, "allow_crossing": True}, route)
    # Above the school.
    high = {"position_ned": [0, 0, -35], "waypoints_ned": [[50, 0, -35]]}
    assert len(zones_of(load(area, high).spec.world.area)) == 2


def test_legs_and_starts_above_a_slope(tmp_path: Any) -> None:
    """The ground rises by 1 m in 10 m to the north, so 23 m over the origin are 17 m over the middle of the zone."""
    axis = np.linspace(-200.0, 200.0, 41)
    np.savez(tmp_path / "slope.npz", north=axis, east=axis, height=0.1 * axis[:, None] + 0.0 * axis)
    zone = {"circle_ned": [60, 0], "radius": 10, "ceiling": 18, "above": "terrain", "name": "barn"}
    slope = content(
        {"stay_in": [{"polygon_ned": [[-90, -90], [-90, 90], [90, 90], [90, -90]]}], "stay_out": [zone]},
        {"position_ned": [0, 0, -23], "waypoints_ned": [[85, 0, -23]]},
    )
    slope["world"]["ground"] = {"type": "dem", "file": str(tmp_path / "slope.npz"), "frame": "local"}
    with pytest.raises(ScenarioError) as caught:
        load_scenario(slope)
    (problem,) = caught.value.problems
    # From 18 m over the ground, at its edge.
    assert problem.endswith("waypoints_ned.0: 20 m of it are inside 'barn', first at north 50, east 0 m")
    slope["fleets"]["pelicans"]["vehicles"] = [{"position_ned": [60, 0, -22.5]}]
    with pytest.raises(ScenarioError, match=r"starts 1\.5 m inside 'barn', to stay out of"):
        load_scenario(slope)


def plan_file(tmp_path: Any, polygons: list[tuple[bool, Any]]) -> str:
    circle = {"version": 1, "inclusion": False, "circle": {"center": [51.7121, -0.2115], "radius": 10}}
    fence = {
        "version": 2,
        "circles": [circle],
        "polygons": [{"version": 1, "inclusion": inside, "polygon": corners} for inside, corners in polygons],
    }
    mission = {"version": 2, "plannedHomePosition": [51.7119, -0.21052, 90.0], "items": []}
    path = tmp_path / "field.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission, "geoFence": fence}))
    return str(path)


def test_a_plan_with_several_fences(tmp_path: Any) -> None:
    file = plan_file(tmp_path, [(True, CORNERS), (False, INNER)])
    spec = load({"stay_in": [{"file": file, "ceiling": 60}]}).spec
    names = [(zone.keep, zone.name, zone.ceiling) for zone in zones_of(spec.world.area)]
    assert names == [(True, "field #1", 60.0), (False, "field #2", float("inf")), (False, "field #3", float("inf"))]
    both = load({"stay_in": [{"file": file}], "stay_out": [{"file": file, "ceiling": 40}]}).spec
    assert [zone.ceiling for zone in zones_of(both.world.area)] == [float("inf"), 40.0, 40.0]
    fence = content({})
    fence["world"]["area"] = {"type": "fence", "file": file, "z_min": -60}
    area: Any = load_scenario(fence).spec.world.area
    assert (area.type, area.z_min, len(area.stay_in), len(area.stay_out)) == ("zones", -60.0, 1, 2)
    assert area.stay_out[1].radius == 10.0
    # 111.26 m a minute of latitude divided by 60, as on the ellipsoid at 51.7 degrees, and less along a parallel.
    assert area.stay_in[0].polygon_ned[0] == pytest.approx([-100.1, -102.3], abs=0.2)


def test_kml_and_geojson_with_a_hole(tmp_path: Any) -> None:
    rings = [" ".join(f"{east},{north}" for north, east in [*ring, ring[0]]) for ring in (CORNERS, INNER)]
    boundaries = "".join(
        f"<{kind}><LinearRing><coordinates>{ring}</coordinates></LinearRing></{kind}>"
        for kind, ring in zip(("outerBoundaryIs", "innerBoundaryIs"), rings, strict=True)
    )
    kml = tmp_path / "field.kml"
    kml.write_text(f"<kml><Placemark><name>Field</name><Polygon>{boundaries}</Polygon></Placemark></kml>")
    coordinates = [[[east, north] for north, east in [*ring, ring[0]]] for ring in (CORNERS, INNER)]
    feature = {"type": "Feature", "properties": {"name": "Field"}}
    feature["geometry"] = {"type": "Polygon", "coordinates": coordinates}  # type: ignore[assignment]
    geojson = tmp_path / "field.geojson"
    geojson.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    found = [load({"stay_in": [{"file": str(file)}]}).spec.world.area for file in (kml, geojson)]
    assert found[0] == found[1]
    (zone,) = zones_of(found[0])
    assert (zone.name, len(zone.rings[0]), len(zone.rings[1])) == ("Field", 4, 3)
    by_hand = {"polygon_geodetic": CORNERS, "holes_geodetic": [INNER], "name": "Field"}
    assert load({"stay_in": [by_hand]}).spec.world.area == found[0]
    archive = tmp_path / "field.kmz"
    with zipfile.ZipFile(archive, "w") as packed:
        packed.write(kml, "doc.kml")
    assert load({"stay_in": [{"file": str(archive)}]}).spec.world.area == found[0]
    misspelt = {"stay_in": [{"file": str(kml), "name": "Feild"}]}
    assert "no polygon is called 'Feild'; did you mean 'Field'" in fault(misspelt)
    assert "allowed: files that end in .plan, .kml" in fault({"stay_in": [{"file": "field.shp"}]})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ('{"type": "Point", "coordinates": [0, 0]}', "zones.geojson: has no Polygon and no MultiPolygon"),
        (
            '{"type": "Polygon", "coordinates": [[["a", 1]]]}',
            "feature 0, corner 0: ['a', 1]; expected [longitude, latitude]",
        ),
        (
            '{"type": "Polygon", "coordinates": [[[51.7, 151.2], [1, 2], [3, 4]]]}',
            "latitude 151.2; allowed: -90 to 90 deg; is it",
        ),
        (
            '{"type": "Polygon", "coordinates": [[[0.1, 51.7], [0.1, 51.7]]]}',
            "feature 0: has 1 corner; a polygon needs at least 3",
        ),
        ('{"type": "Polygon", "coordinates": []}', "feature 0: expected a list of rings, found none"),
        ('{"type": "Polygone", "coordinates": []}', "its type is 'Polygone'; expected GeoJSON with a Polygon; did you"),
        ('{"type": "Polygon", "coordinates": 3}', "feature 0: expected a list, found 3"),
    ],
)
def test_bad_geojson(tmp_path: Any, text: str, message: str) -> None:
    file = tmp_path / "zones.geojson"
    file.write_text(text)
    assert message in fault({"stay_in": [{"file": str(file)}]})


def test_saved_zones_are_the_same_and_need_no_file(tmp_path: Any) -> None:
    file = plan_file(tmp_path, [(True, CORNERS)])
    scenario = load({"stay_in": [{"file": file, "above": "terrain", "ceiling": 50}], "breach": "report"})
    saved = tmp_path / "saved.yaml"
    saved.write_text(scenario.to_yaml())
    (tmp_path / "field.plan").unlink()
    assert load_scenario(saved).spec == scenario.spec
    assert "file" not in saved.read_text()
    area = scenario.world().area
    assert isinstance(area, ZonesArea)
    assert (area.breach, area.names, area.ground is not None) == ("report", ("field #1", "field #2"), True)


def test_from_python() -> None:
    area: Any = load({"stay_in": [{"polygon_ned": FIELD, "ceiling": 50}], "stay_out": [SCHOOL]}).world("float64").area
    made = make_scenario([[0.0, 0.0, -15.0]], area=area)
    assert [zone.name for zone in zones_of(made.spec.world.area)] == ["stay_in.0", "school"]
    assert made.world("float64").area.zones == area.zones  # type: ignore[attr-defined]
