"""Plans in scenarios: where a vehicle starts and flies, over hills and above the sea, and what is told of it."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.scenarios.plans.test_formats import gpx, route
from tests.scenarios.plans.test_legs import at, fly, order
from tests.scenarios.plans.test_qgc import item, plan

from qrsim.errors import ScenarioError
from qrsim.files.yaml_text import parse_yaml
from qrsim.links.mavlink.fleet import plan_parameters, start_rally
from qrsim.scenarios.plan_lines import plan_lines
from qrsim.scenarios.scenario import Scenario, load_scenario

# The geoid is 48.39 m above the ellipsoid there.
PLACE = {"latitude_deg": 47.0, "longitude_deg": 8.0}
Load = Callable[..., Scenario]


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., str]:
    def write_it(*items: Any, name: str = "field.plan", **more: Any) -> str:
        path = tmp_path / name
        path.write_text(json.dumps(plan(*items, **more), indent=1), "utf-8")
        return str(path)

    return write_it


def mission(spec: Any, *, site: Any = PLACE, world: Any = None, **fleet: Any) -> dict[str, Any]:
    """A scenario of one vehicle that flies a plan as a mission."""
    fleet = {
        "controller": {"type": "cascade", "feed": "truth"}, "guidance": {"type": "mission"},
        "vehicles": [{"plan": spec}], **fleet,
    }  # fmt: skip
    return {"name": "x", "duration": 10.0, "site": site, "world": world or {}, "fleets": {"a": fleet}}


def quietly(content: dict[str, Any]) -> tuple[Scenario, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loaded = load_scenario(content)
    return loaded, [str(each.message) for each in caught]


def places(loaded: Scenario) -> list[list[float]]:
    (vehicle,) = loaded.spec.fleets["a"].vehicles
    return [[round(number, 1) for number in leg.to_ned] for leg in vehicle.legs if getattr(leg, "to_ned", None)]


def test_rally_points_of_a_plan_are_those_of_failsafes(write: Callable[..., str], tmp_path: Path) -> None:
    """Heights are above the home of the plan, which is on the ground at z = 0."""
    rally = {"version": 2, "points": [[*at(200, 0), 45], [*at(0, 300), 10]]}
    file = write(fly(50, 0, 20), fly(100, 0, 20), rallyPoints=rally)
    fleet = {"vehicle": {"type": "multirotor", "model": "x500"}, "sensors": {"gnss": {"type": "ideal_gnss"}}}
    for guidance in ("mission", "route"):
        loaded, _ = quietly(mission(file, guidance={"type": guidance}, failsafes={}, **fleet))
        (vehicle,) = loaded.spec.fleets["a"].vehicles
        np.testing.assert_allclose(vehicle.rally_ned, [[200, 0, -45], [0, 300, -10]], atol=0.03)
    saved = tmp_path / "saved.yaml"
    saved.write_text(loaded.to_yaml())
    Path(file).unlink()
    assert load_scenario(saved).spec == loaded.spec
    # Without its plan the link has the same points.
    given, written = start_rally(loaded, loaded.world())[0], start_rally(load_scenario(saved), loaded.world())[0]
    numbers = [[(each.x, each.y, each.z) for each in items] for items in (given, written)]
    np.testing.assert_allclose(numbers[0], numbers[1], rtol=0.0, atol=1.0)
    assert [each.z for each in written] == pytest.approx([45.0, 10.0])
    failsafes = loaded.world("float64").fleets[0].failsafes
    assert failsafes is not None
    assert [float(point.place_ned.z[0]) for point in failsafes.rally] == [-45.0, -10.0]
    assert [float(point.ground_down[0]) for point in failsafes.rally] == [0.0, 0.0]


def test_a_take_off_begins_on_the_feet_of_the_model(write: Callable[..., str]) -> None:
    """An x500 stands 0.2 m above the ground on its legs."""
    file = write(item(22, 0, 0, 0, None, *at(0, 0), 10), fly(30, 0, 10), order(20))
    loaded, _ = quietly(mission(file, vehicle={"type": "multirotor", "model": "x500"}))
    (vehicle,) = loaded.spec.fleets["a"].vehicles
    assert vehicle.position_ned == pytest.approx([0.0, 0.0, -0.2], abs=1e-6)
    assert [leg.type for leg in vehicle.legs] == ["take_off", "fly", "land"]
    # The speed of the whole plan is that of its ways, and not of the take-off.
    assert [leg.speed for leg in vehicle.legs] == [None, 5.0, 5.0]
    text = loaded.to_yaml()
    assert "plan" not in text.replace("planned", "")
    assert load_scenario(parse_yaml(text, "again")).spec == loaded.spec


def test_altitudes_above_the_sea_need_the_height_of_the_site(write: Callable[..., str], tmp_path: Path) -> None:
    """Home is 500 m above the sea: 20 m above it are 520 m above the sea, and 30 m above a site at 490 m."""
    file = write(fly(30, 0, 520, frame=0), fly(60, 0, 20))
    assert places(quietly(mission(file))[0]) == [[30.0, 0.0, -20.0], [60.0, 0.0, -20.0]]
    above = {**PLACE, "height_amsl": 490.0}
    assert places(quietly(mission(file, site=above))[0]) == [[30.0, 0.0, -30.0], [60.0, 0.0, -20.0]]
    ellipsoidal = {**PLACE, "height": 490.0 + 48.39}
    (first, _) = places(quietly(mission(file, site=ellipsoidal))[0])
    assert first == pytest.approx([30.0, 0.0, -30.0], abs=0.03)
    assert places(quietly(mission(file, site={"plan": file}))[0])[0] == [30.0, 0.0, -20.0]
    drawn = tmp_path / "way.gpx"
    drawn.write_text(gpx(route("r", (*at(30, 0), 520.0), (*at(60, 0), 530.0))), "utf-8")
    spec = {"file": str(drawn), "home": [*at(0, 0)]}
    assert places(quietly(mission(spec, site=above))[0]) == [[30.0, 0.0, -30.0], [60.0, 0.0, -40.0]]
    spec = {"file": str(drawn), "home": [*at(0, 0), 510.0]}
    assert places(quietly(mission(spec))[0]) == [[30.0, 0.0, -10.0], [60.0, 0.0, -20.0]]


def test_a_plan_over_a_hill_starts_and_flies_above_its_ground(write: Callable[..., str], tmp_path: Path) -> None:
    """The ground rises by 20 m from the west to the east of the area, as 1 in 100, from 0 at the site."""
    rows = "-10 10\n-10 10\n"
    (tmp_path / "hill.asc").write_text(
        f"ncols 2\nnrows 2\nxllcenter -1000\nyllcenter -1000\ncellsize 2000\n{rows}", "utf-8"
    )
    world = {"ground": {"type": "dem", "file": str(tmp_path / "hill.asc"), "frame": "local"}}
    world["area"] = {"type": "box", "x_min": -500, "x_max": 500, "y_min": -500, "y_max": 500, "z_min": -120}
    home = [*at(0, 200), 500.0]
    content = plan(item(22, 0, 0, 0, None, *at(0, 200), 10), fly(0, 300, 20, frame=10), fly(0, 400, 20))
    content["mission"]["plannedHomePosition"] = home
    file = tmp_path / "hill.plan"
    file.write_text(json.dumps(content), "utf-8")
    loaded, said = quietly(mission(str(file), site={**PLACE, "height_amsl": 498.0}, world=world))
    (vehicle,) = loaded.spec.fleets["a"].vehicles
    # At home the ground is 2 m high, at 300 m east 3 m.
    assert vehicle.position_ned[2] == pytest.approx(-2.0, abs=0.1)
    assert vehicle.legs[0].height == pytest.approx(12.0, abs=0.02)
    assert np.array(places(loaded))[:, 2] == pytest.approx([-23.0, -22.0], abs=0.02)
    assert not any("flat" in words or "its home is" in words for words in said)
    # The ground at home is 500 m above the sea; the site 498 m.
    content["mission"]["plannedHomePosition"] = [*at(0, 200), 493.0]
    file.write_text(json.dumps(content), "utf-8")
    _, said = quietly(mission(str(file), site={**PLACE, "height_amsl": 498.0}, world=world))
    home = f"{file}: its home is 493 m above the sea, 7 m below the ground there; it is flown from the ground there; "
    assert any(words.startswith(home) for words in said)


def test_altitudes_above_flat_ground_are_told(write: Callable[..., str]) -> None:
    file = write(fly(30, 0, 20, frame=10))
    loaded, said = quietly(mission(file))
    assert places(loaded) == [[30.0, 0.0, -20.0]]
    assert f"{file}: altitudes above the ground are above z = 0, because world.ground is flat" in said


def test_the_lines_of_a_plan_are_shown(write: Callable[..., str]) -> None:
    file = write(fly(0, 0, 20), fly(40, 0, 20), order(206, 9), fly(40, 40, 20, command=82), fly(0, 40, 20))
    loaded, _ = quietly(mission(file))
    text = Path(file).read_text("utf-8").splitlines()
    begins = [i + 1 for i, words in enumerate(text) if words.strip() == "{" and '"SimpleItem"' in text[i + 1]]
    lines = list(plan_lines(loaded.planned))
    assert lines[0] == f"fleets.a.vehicles.0.legs, from {file}:"
    assert lines[1] == "  home: latitude 47 deg, longitude 8 deg, 500 m above the sea"
    assert lines[2] == f"  0: NAV_WAYPOINT (item 1, line {begins[0]})"
    (last,) = (len(vehicle.legs) - 1 for vehicle in loaded.spec.fleets["a"].vehicles)
    assert lines[4] == f"  2 to {last - 1}: NAV_SPLINE_WAYPOINT (item 4, line {begins[3]})"
    assert lines[-1] == "  skipped: DO_SET_CAM_TRIGG_DIST (item 3)"


def test_rally_points_are_items_at_the_start(write: Callable[..., str]) -> None:
    file = write(fly(30, 0, 20), rallyPoints={"version": 2, "points": [[47.001, 8.0, 25.0]]})
    loaded, _ = quietly(mission(file, ground="parked"))
    (found,) = start_rally(loaded, loaded.world()).values()
    assert [(each.command, each.frame, each.x, each.y, each.z) for each in found] == [
        (5100, 6, 470010000, 80000000, 25.0)
    ]


def test_parameters_beside_a_plan_are_those_of_the_link(write: Callable[..., str], tmp_path: Path) -> None:
    """QGroundControl's file beside the plan, or one that the plan names, here of Mission Planner."""
    file = write(fly(30, 0, 20))
    (tmp_path / "field.params").write_text(
        "# Onboard parameters for Vehicle 1\n#\n1\t1\tRTL_RETURN_ALT\t35.5\t9\n1\t1\tMPC_XY_P\t0.95\t9\n", "utf-8"
    )
    (tmp_path / "own.param").write_text("RTL_RETURN_ALT,20\n", "utf-8")
    loaded, _ = quietly(mission(file, ground="parked"))
    with pytest.warns(UserWarning, match="plans: parameters that are not used: 1, such as MPC_XY_P"):
        assert plan_parameters(loaded, loaded.world()) == {0: {"RTL_RETURN_ALT": 35.5}}
    loaded, _ = quietly(mission({"file": file, "params": str(tmp_path / "own.param")}, ground="parked"))
    assert plan_parameters(loaded, loaded.world()) == {0: {"RTL_RETURN_ALT": 20.0}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\t1\tA\tfast\t9\n", "line 1: '1\\t1\\tA\\tfast\\t9' has no name and number of a parameter"),
        ("A,1\nA\n", "line 2: 'A' has no name and number of a parameter"),
        ("A,nan\n", "line 1: 'A,nan' has no name"),
        ("A,1\n" * 5001, "has 5001 lines; allowed: 5000"),
        (None, "No such file"),
    ],
)
def test_bad_files_of_parameters(write: Callable[..., str], tmp_path: Path, text: str | None, words: str) -> None:
    params = tmp_path / "own.params"
    if text is not None:
        params.write_text(text, "utf-8")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(mission({"file": write(fly(30, 0, 20)), "params": str(params)}))
    (problem,) = caught.value.problems
    assert problem.startswith(f"fleets.a.vehicles.0.plan.params: {params}: ")
    assert words in problem


SPECS: dict[str, tuple[Any, str]] = {
    "swapped home": ({"home": [151.2, -33.0]}, ".home: [151.2, -33.0] is no latitude, longitude; is it longitude"),
    "short home": ({"home": [47.0]}, ".home: "),
    "no height of the site": ({}, ": item 1 is 520 m above the sea, and the height of the site is not given; give"),
    "no such route": ({"route": "R"}, ": no route is called 'R'"),
    "a typo": ({"hieght": 5}, ".hieght: "),
}


@pytest.mark.parametrize("case", SPECS)
def test_bad_plans_of_vehicles(tmp_path: Path, case: str) -> None:
    more, words = SPECS[case]
    drawn = tmp_path / "way.gpx"
    drawn.write_text(gpx(route("r", (*at(30, 0), 520.0))), "utf-8")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(mission({"file": str(drawn), **more}))
    (problem,) = caught.value.problems
    assert problem.replace(f": {drawn}", "").replace(", route 'R'", "").startswith(f"fleets.a.vehicles.0.plan{words}")


def test_a_site_has_no_map_as_its_plan(tmp_path: Path) -> None:
    content = mission("field.plan", site={"plan": "way.kml"})
    with pytest.raises(ScenarioError) as caught:
        load_scenario(content)
    assert any("way.kml' has no home; expected a .plan" in problem for problem in caught.value.problems)
