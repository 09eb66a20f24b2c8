"""The site of a scenario and the home of its plans: the one from the other, or how far they are apart."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.scenarios.test_places import SITE, item, polygon, problems_of, scenario

from qrsim.errors import ScenarioError
from qrsim.scenarios.scenario import load_scenario

Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a plan with one waypoint 12 m above its home, and its fences."""

    def write_it(home: tuple[float, float, float], name: str = "survey.plan", *polygons: dict[str, Any]) -> str:
        mission = {"version": 2, "plannedHomePosition": home, "items": [item(16, *home[:2], 12.0)]}
        fence = {"version": 2, "polygons": polygons, "circles": []}
        path = tmp_path / name
        path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission, "geoFence": fence}), "utf-8")
        return str(path)

    return write_it


def warnings_of(content: dict[str, Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_scenario(content)
    return [str(each.message) for each in caught]


def test_a_plan_far_from_the_site_is_told_once(write: Write) -> None:
    """21 km are 0.1889 degrees of latitude at 47 degrees; the limits are 1 km and 5 m. The site is at 401.6 m."""

    def told(*homes: tuple[float, ...], **more: Any) -> list[str]:
        plans = [write(home, f"{i}.plan") for i, home in enumerate(homes)]
        vehicles = [{"plan": {"file": plan}, "position_ned": [0, 9 * i, -5]} for i, plan in enumerate(plans)]
        area = {"type": "box", "x_min": -30e3, "x_max": 30e3}
        return warnings_of({**scenario(*vehicles, area=area), **more})

    assert told((47.0089, 8.0, 406.4)) == []
    (words,) = told((47.0091, 8.0, 402.0))
    assert "0.plan: its home is 1.01 km from the site; site: {plan: FILE} takes the site from it" in words
    (words,) = told((47.0, 8.0, 550.0), site={**SITE, "height": 450.0})
    assert "0.plan: its home is 550 m above the sea, 148 m above the site; it is flown from the ground there; " in words
    (words,) = told((47.0, 8.0, 390.0), (47.1889, 8.0, 350.0))
    assert (
        "1.plan: its home is 21 km from the site and 350 m above the sea, 51.6 m below the site (and 1 more of its "
        "kind); it is flown from the ground there; site: {plan: FILE} takes the site from it"
    ) in words
    fence = write((47.0, 8.0, 550.0), "fence.plan", polygon())
    (words,) = warnings_of(scenario({"position_ned": [0, 0, -5]}, area={"type": "fence", "file": fence}))
    assert "550 m above the sea, 148 m above the site" in words
    # On a hillside the ground at home counts, here that of the site.
    rows = Path(fence).with_name("hill.asc")
    rows.write_text("ncols 2\nnrows 2\nxllcenter -5000\nyllcenter -5000\ncellsize 10000\n0 40\n0 40\n")
    hill = scenario({"plan": {"file": write((47.0, 8.0, 420.0), "hill.plan")}, "position_ned": [0, 0, -60]})
    hill["world"]["ground"] = {"type": "dem", "file": str(rows)}
    (words,) = warnings_of(hill)
    assert "420 m above the sea, 18.4 m above the ground there; " in words


def test_the_site_may_be_the_home_of_a_plan(write: Write) -> None:
    file = write((-33.0, 151.0, 135.0))
    content = {**scenario({"plan": {"file": file}}), "site": {"plan": {"file": file}}}
    assert warnings_of(content) == []
    spec = load_scenario(content).spec
    # Its altitude is above the sea; the geoid is 26.02 m above the ellipsoid there.
    assert (spec.site.latitude_deg, spec.site.longitude_deg, spec.site.height_amsl) == (-33.0, 151.0, 135.0)
    assert spec.site.height == pytest.approx(161.02, abs=0.02)
    assert spec.fleets["a"].vehicles[0].position_ned == [0.0, 0.0, -12.0]
    assert "plan" not in load_scenario(content).to_yaml()
    # The name of the file alone is enough, relative to the scenario's folder.
    short = {**scenario({"plan": file}), "site": {"plan": file}}
    assert load_scenario(short).spec == load_scenario(content).spec
    path = Path(file).with_name("short.yaml")
    path.write_text(
        "site: {plan: survey.plan}\nfleets: {a: {sensors: noisy, vehicles: [{plan: survey.plan}]}}\nname: x\n"
    )
    assert load_scenario(str(path)).spec.site == spec.site
    # It takes the place of the site of what is extended, and of the scenario's own by --set.
    alone = {"extends": "outdoor_patrol", "name": "x", "site": {"plan": {"file": file}}}
    assert load_scenario(alone).spec.site == spec.site
    assert load_scenario("outdoor_patrol", [f"site={{plan: {{file: {file}}}}}"]).spec.site == spec.site


def test_a_site_that_no_plan_can_give_is_named(write: Write) -> None:
    file = write((47.0, 8.0, 9500.0))
    content = {**scenario({"position_ned": [0, 0, -5]}), "site": {"plan": {"file": file}}}
    assert problems_of(content) == [f"site.plan: {file}: its home is at 9500 m; allowed: -500 to 9000"]
    content["site"] = {"height": 35.0, "plan": {"file": file}}
    assert problems_of(content) == [
        f"site.plan: {file}: gives latitude_deg, longitude_deg, height; leave out height of site, or the plan"
    ]
    unset = Path(write((47.0, 8.0, 450.0), "unset.plan"))
    unset.write_text(unset.read_text().replace("[47.0, 8.0, 450.0]", "[0.0, 0.0, 450.0]", 1))
    content["site"] = {"plan": str(unset)}
    (found,) = problems_of(content)
    assert found.endswith("unset.plan: its home is at latitude 0 and longitude 0, as where none was set")
    content["site"] = {"plan": ""}
    assert problems_of(content) == ["site.plan.file: '' is empty (a QGroundControl .plan file)"]
    content["site"] = {"plan": {"file": file.replace("survey", "survy")}}
    (found,) = problems_of(content)
    assert found.endswith("survy.plan: cannot be read: No such file or directory; did you mean 'survey.plan'?")


def test_the_height_of_the_site_may_be_above_the_sea() -> None:
    """The geoid is 47.22 m above the ellipsoid in Zurich, and 31.63 m below it at a place of NGA's (OUTINTPT.DAT)."""
    content = scenario({"position_ned": [0, 0, -5]})
    for latitude, longitude, geoid in ((47.397742, 8.545594, 47.22), (38.628155, -90.220845, -31.63)):
        content["site"] = {"latitude_deg": latitude, "longitude_deg": longitude, "height_amsl": 488.0}
        loaded = load_scenario(content)
        assert loaded.spec.site.height == loaded.site.height == pytest.approx(488.0 + geoid, abs=0.02)
        # A saved scenario has both heights, and is read again.
        assert "height_amsl: 488.0" in loaded.to_yaml()
        assert load_scenario(yaml.safe_load(loaded.to_yaml())).spec == loaded.spec
        moved = load_scenario(yaml.safe_load(loaded.to_yaml()), ["site.latitude_deg=0", "site.longitude_deg=0"])
        assert moved.site.height == pytest.approx(488.0 + 17.16, abs=0.02)
    # Each height takes the place of the other, of what is extended and by --set.
    alone = {"extends": "mavlink_field", "name": "x", "site": {"height_amsl": 100.0}}
    assert load_scenario(alone).site.height == pytest.approx(147.22, abs=0.02)
    assert load_scenario("mavlink_field", ["site.height_amsl=100"]).site.height == pytest.approx(147.22, abs=0.02)
    assert load_scenario(alone, ["site.height=100"]).site.height == 100.0


def test_a_height_above_the_sea_that_no_site_has_is_named(write: Write) -> None:
    content = scenario({"position_ned": [0, 0, -5]})

    def told(**site: Any) -> str:
        (found,) = problems_of({**content, "site": site})
        return found

    assert told(height=3.0, height_amsl=4.0) == "site: height and height_amsl are both given; allowed: one"
    for height in (9500.0, -451.0):
        assert f"site.height_amsl: {height} is out of range; allowed: -450 to 9000 (" in told(height_amsl=height)
    assert told(height_amsl=math.nan).startswith("site.height_amsl: nan is not a finite number")
    assert told(amsl=4.0) == "site.amsl: no such parameter of 'site'; did you mean 'height_amsl'?"
    assert told(height_amsl=8990.0) == (
        "site.height_amsl: 8990 m above the sea is 9036.3 m above the WGS-84 ellipsoid there; allowed: -500 to 9000"
    )
    file = write((47.0, 8.0, 450.0))
    assert "leave out height_amsl of site, or the plan" in told(height_amsl=4.0, plan={"file": file})


def test_homes_of_plans_are_compared_with_the_height_above_the_sea(write: Write) -> None:
    """The geoid is 48 m above the ellipsoid there; 5 m are warned of."""
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    content = scenario({"plan": {"file": write((47.0, 8.0, 450.0))}})
    assert warnings_of({**content, "site": {**place, "height_amsl": 446.0}}) == []
    (words,) = warnings_of({**content, "site": {**place, "height_amsl": 400.0}})
    assert "its home is 450 m above the sea, 50 m above the site; " in words


def test_a_site_without_a_height_has_that_of_the_home(write: Write) -> None:
    """The geoid is 48.39 m above the ellipsoid there; a home 1.1 km away is on another field."""
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    file, higher = write((47.0, 8.0, 450.0)), write((47.0, 8.0, 453.0), "higher.plan")
    content = {**scenario({"plan": {"file": file}}, {"plan": {"file": higher}, "position_ned": [0, 9, -5]})}
    assert warnings_of({**content, "site": place}) == []
    loaded = load_scenario({**content, "site": place})
    assert (loaded.spec.site.height_amsl, loaded.site.height) == (450.0, pytest.approx(498.39, abs=0.02))
    # The air is that of the standard atmosphere at 450 m.
    assert float(loaded.world().air.temperature) == pytest.approx(288.15 - 0.0065 * 450.0, abs=0.002)
    far = {**content, "site": {"latitude_deg": 47.01, "longitude_deg": 8.0}}
    far["world"] = {"area": {"type": "box", "x_min": -2e3, "x_max": 2e3}}
    with pytest.warns(UserWarning, match="is 1.11 km from the site"):
        assert load_scenario(far).site.height == 0.0
    # A plan that cannot be read is told once, of the vehicle that flies it.
    broken = {**scenario({"plan": {"file": file.replace("survey", "none")}}), "site": place}
    (words,) = problems_of(broken)
    assert words.startswith("fleets.a.vehicles.0.plan: ")


@pytest.mark.parametrize(
    ("height", "top", "words"),
    [
        (400.0, 120.0, "is 400 m above home, above the top of world.area, 120 m; are the heights in feet? Plans have"),
        (130.0, 120.0, "metres: 130 ft are 39.6 m"),
        (400.0, 1000.0, "is 400 m above home, high for a vehicle that is no fixed wing; are the heights in feet?"),
        (110.0, 120.0, ""),
        (150.0, 1000.0, ""),
    ],
)
def test_heights_that_look_like_feet_are_told(tmp_path: Path, height: float, top: float, words: str) -> None:
    """A hundred and twenty metres are 400 ft, the limit of most countries; a foot is 0.3048 m."""
    items = [item(16, 47.0, 8.0, 20.0), item(16, 47.0003, 8.0, height)]
    mission = {"version": 2, "plannedHomePosition": [47.0, 8.0, 401.6], "items": items}
    path = tmp_path / "feet.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}), "utf-8")
    box = {"type": "box", "x_min": -100, "x_max": 100, "y_min": -100, "y_max": 100, "z_min": -top}
    content = scenario({"plan": {"file": str(path)}}, area=box)
    if height > top:
        with pytest.warns(UserWarning, match="in feet") as caught, pytest.raises(ScenarioError):
            load_scenario(content)
        told = [str(each.message) for each in caught]
    else:
        told = warnings_of(content)
    assert [words in each and "item 2 " in each for each in told] == ([True] if words else [])


def test_a_plan_far_from_its_home_and_one_for_two_vehicles_are_told(tmp_path: Path) -> None:
    """0.018 degrees of latitude are 2.0 km."""
    path = tmp_path / "far.plan"
    items = [item(16, 47.0, 8.0, 20.0), item(16, 47.0003, 8.0, 20.0)]

    def told(home: float, vehicles: int) -> list[str]:
        mission = {"version": 2, "plannedHomePosition": [home, 8.0, 450.0], "items": items}
        path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}), "utf-8")
        wide = {"type": "box", "x_min": -3000, "x_max": 3000, "y_min": -100, "y_max": 100, "z_min": -100}
        content = scenario({"plan": {"file": str(path)}}, area=wide)
        content["site"] = {"plan": {"file": str(path)}}
        (fleet,) = content["fleets"].values()
        fleet["vehicles"] = fleet["vehicles"] * vehicles
        for number, vehicle in enumerate(fleet["vehicles"]):
            fleet["vehicles"][number] = {**vehicle, "position_ned": [0.0, 5.0 * number, -20.0]}
        return [each.partition(": ")[2] for each in warnings_of(content)]

    assert told(47.0, 1) == []
    (words,) = told(46.982, 1)
    assert words == "item 1 is 2 km from the plan's home; is the home where it was planned?"
    (words,) = told(47.0, 2)
    assert words.startswith("2 vehicles fly it, on one path and to one place, where they may collide")


def test_a_plan_in_feet_is_told_in_a_few_lines(tmp_path: Path) -> None:
    """Eighteen waypoints of 60 m and more, written in feet, below a ceiling of 120 m."""
    items = [item(16, 47.0, 8.0 + 1e-5 * i, (60.0 + i) / 0.3048) for i in range(18)]
    mission = {"version": 2, "plannedHomePosition": [47.0, 8.0, 401.6], "items": items}
    path = tmp_path / "feet.plan"
    path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}), "utf-8")
    box = {"type": "box", "x_min": -100, "x_max": 100, "y_min": -100, "y_max": 100, "z_min": -120}
    with pytest.warns(UserWarning, match="item 18 is 253 m above home, .* are the heights in feet?"):
        found = problems_of(scenario({"plan": {"file": str(path)}}, area=box))
    assert len(found) == 19
    head, start, first, second, more = str(ScenarioError("x", found)).splitlines()
    assert (head, more) == ("x: 19 problems", "  ... and 16 more like it")
    assert "above home: z = -196.85 m" in start
    assert "item 1: z = -196.85 m is outside world.area; allowed: -120 to 0" in first
    assert "item 2: z = -200.131 m is outside world.area; allowed: -120 to 0" in second
