"""Scenarios that extend others: what is merged, where files are looked for, and what can be wrong with it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.reading import merged, parse_yaml
from qrsim.scenarios.scenario import Scenario, json_schema, load_scenario

BASE = """
name: base
description: The base.
duration: 20.0
world:
  wind: {type: log_shear, speed_20ft: 5.0, wind_from_deg: 225.0}
  turbulence: {type: dryden_first_order}
fleets:
  scouts:
    controller: {type: waypoint, feed: truth}
    sensors: {height: {type: barometer}, gyro: {type: gyroscope}}
    vehicles:
      - position_ned: [0.0, 0.0, -10.0]
      - position_ned: [0.0, 10.0, -10.0]
"""


def written(folder: Path, **files: str) -> Path:
    """Write files NAME.yaml and return the path of the first."""
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text, "utf-8")
    return folder / f"{next(iter(files))}.yaml"


def child_of_base(folder: Path, text: str) -> Scenario:
    return load_scenario(written(folder, child=f"extends: base.yaml\n{text}", base=BASE))


def test_what_the_child_leaves_out_is_the_parents(tmp_path: Path) -> None:
    spec = child_of_base(tmp_path, "duration: 30.0\nworld: {wind: {speed_20ft: 3.0}}\n").spec
    assert spec.duration == 30.0
    assert spec.world.wind.speed_20ft == 3.0
    assert math.isclose(spec.world.wind.wind_from_rad, math.radians(225.0))
    assert spec.fleets == load_scenario(tmp_path / "base.yaml").spec.fleets


def test_the_name_is_the_childs_own(tmp_path: Path) -> None:
    """The stem of its file unless it gives one; a scenario in Python has to give one."""
    assert child_of_base(tmp_path, "").name == "child"
    assert child_of_base(tmp_path, "name: mine\n").name == "mine"
    assert child_of_base(tmp_path, "").spec.description == ""
    with pytest.raises(ScenarioError, match=r"scenario \(extends hover_ideal\): 1 problem\n  name: missing"):
        load_scenario({"extends": "hover_ideal"})


def test_a_list_replaces_a_list(tmp_path: Path) -> None:
    spec = child_of_base(tmp_path, "fleets: {scouts: {vehicles: [{position_ned: [5.0, 5.0, -5.0]}]}}\n").spec
    assert [vehicle.position_ned for vehicle in spec.fleets["scouts"].vehicles] == [[5.0, 5.0, -5.0]]
    assert list(spec.fleets["scouts"].sensors) == ["height", "gyro"]


def test_a_component_of_another_type_replaces_the_parents_wholly(tmp_path: Path) -> None:
    wind = child_of_base(tmp_path, "world: {wind: {type: veering_shear, speed_20ft: 2, wind_from_deg: 0}}\n").spec.world
    assert wind.wind.type == "veering_shear"
    with pytest.raises(ScenarioError, match=r"world\.wind\.speed_20ft: missing"):
        child_of_base(tmp_path, "world: {wind: {type: veering_shear, wind_from_deg: 0}}\n")
    # Of the same type it keeps what it does not say.
    same = child_of_base(tmp_path, "world: {wind: {type: log_shear, speed_20ft: 2}}\n").spec.world
    assert math.isclose(same.wind.wind_from_rad, math.radians(225.0))


@pytest.mark.parametrize(("key", "value"), [("wind_from_rad", 1.0), ("wind_from_deg", math.degrees(1.0))])
def test_an_angle_replaces_that_in_the_other_unit(key: str, value: float, tmp_path: Path) -> None:
    spec = child_of_base(tmp_path, f"world: {{wind: {{{key}: {value}}}}}\n").spec
    assert math.isclose(spec.world.wind.wind_from_rad, 1.0)
    with pytest.raises(ScenarioError, match="gives both 'wind_from_rad' and 'wind_from_deg'"):
        child_of_base(tmp_path, "world: {wind: {wind_from_rad: 1.0, wind_from_deg: 57.3}}\n")


def test_a_wind_at_a_height_replaces_that_at_20_ft(tmp_path: Path) -> None:
    # 6 m/s at 6.096 m, which is 20 ft.
    spec = child_of_base(tmp_path, "world: {wind: {speed: 6.0, at_height: 6.096}}\n").spec
    assert math.isclose(spec.world.wind.speed_20ft, 6.0, rel_tol=1e-6)
    with pytest.raises(ScenarioError, match="gives both 'speed' and 'speed_20ft'"):
        child_of_base(tmp_path, "world: {wind: {speed: 6.0, speed_20ft: 5.0}}\n")
    assert load_scenario("hover", ["world.wind.speed=6"]).spec.world.wind.speed_20ft < 6.0
    # A gust is lost with the speed that it belongs to, and never alone.
    with pytest.raises(ScenarioError, match="speed: missing; expected the mean speed"):
        load_scenario("hover", ["world.wind.gust=9", "world.wind.speed_20ft=5"])


def test_null_takes_out_what_the_parent_has(tmp_path: Path) -> None:
    text = "world: {turbulence: null}\nfleets: {scouts: {sensors: {gyro: null}}}\n"
    spec = child_of_base(tmp_path, text).spec
    assert spec.world.turbulence.type == "still"
    assert list(spec.fleets["scouts"].sensors) == ["height"]
    with pytest.raises(ScenarioError, match=r"duraton: no such parameter .*did you mean 'duration'"):
        child_of_base(tmp_path, "duraton: null\n")


def test_merging_leaves_both_as_they_were() -> None:
    parent, child = parse_yaml(BASE, "base"), {"world": {"wind": {"speed_20ft": 1.0}}}
    result = merged(parent, child)
    result["world"]["wind"]["speed_20ft"] = 9.0
    assert parent == parse_yaml(BASE, "base")
    assert child == {"world": {"wind": {"speed_20ft": 1.0}}}


def test_a_chain_of_three_with_files_beside_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths are relative to the file that has them, wherever the command is typed."""
    series = "time,north,east,down\n" + "".join(f"{10 * i},1,2,0\n" for i in range(8))
    windy = "extends: base.yaml\nworld: {wind: {type: series, file: wind.csv}, turbulence: null}\n"
    written(tmp_path / "deep", base=BASE, windy=windy)
    (tmp_path / "deep" / "wind.csv").write_text(series, "utf-8")
    top = written(tmp_path / "top", top="extends: ../deep/windy.yaml\nduration: 40.0\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    spec = load_scenario(top).spec
    assert spec.world.wind.file == str(tmp_path / "deep" / "wind.csv")
    assert (spec.name, spec.duration) == ("top", 40.0)
    # In Python, paths are relative to the working folder.
    monkeypatch.chdir(tmp_path / "top")
    again = load_scenario({"extends": "../deep/windy.yaml", "name": "top", "duration": 40.0}).spec
    assert again == spec


def test_the_scenario_that_is_saved_extends_nothing(tmp_path: Path) -> None:
    scenario = child_of_base(tmp_path, "duration: 30.0\n")
    text = scenario.to_yaml()
    assert "extends" not in text
    assert load_scenario(parse_yaml(text, "again")).spec == scenario.spec


def test_a_built_in_scenario_can_be_extended_and_overridden(tmp_path: Path) -> None:
    path = written(tmp_path, mine="extends: patrol_plain\nworld: {wind: {speed_20ft: 3.0}}\n")
    spec = load_scenario(path, ["world.wind.speed_20ft=1"]).spec
    assert spec.world.wind.speed_20ft == 1.0
    assert len(spec.fleets["pelicans"].vehicles) == 5
    with pytest.raises(ScenarioError, match=r"extends: can only be given in the scenario itself"):
        load_scenario(path, ["extends=hover"])


def test_editors_know_the_key() -> None:
    assert "extends" in json_schema()["properties"]


def test_a_circle_is_shown(tmp_path: Path) -> None:
    a = written(tmp_path, a="extends: b.yaml\n", b="extends: ./c.yaml\n", c="extends: a.yaml\n")
    chain = " -> ".join(str(tmp_path / f"{name}.yaml") for name in "abca")
    with pytest.raises(ScenarioError, match=rf"a\.yaml: 1 problem\n  extends: .*{re.escape(chain)}$"):
        load_scenario(a)
    own = written(tmp_path, own="extends: own.yaml\n")
    with pytest.raises(ScenarioError, match=rf"{re.escape(f'{own} -> {own}')}$"):
        load_scenario(own)
    with pytest.raises(ScenarioError, match=rf"{re.escape(f'scenario -> {own} -> {own}')}$"):
        load_scenario({"extends": str(own)})


@pytest.mark.parametrize(
    ("extends", "expected"),
    [
        ("hovr", r"extends: no scenario is called 'hovr'; did you mean 'hover'\?"),
        ("bse.yaml", r"extends: scenario file .*bse\.yaml: no such file; did you mean '.*base\.yaml'\?"),
        ("5", r"extends: expected a built-in name or the path of a \.yaml file, found 5"),
        ("", r"extends: expected a built-in name or the path of a \.yaml file, found None"),
        ("[base.yaml]", r"extends: expected a built-in name .*, found \['base\.yaml'\]"),
    ],
)
def test_a_parent_that_is_not_there_is_named_with_the_nearest(extends: str, expected: str, tmp_path: Path) -> None:
    path = written(tmp_path, child=f"extends: {extends}\n", base=BASE)
    with pytest.raises(UsageError, match=rf"child\.yaml: 1 problem\n  {expected}"):
        load_scenario(path)


def test_odd_content_is_found_by_the_check() -> None:
    odd: dict[Any, Any] = {"extends": "hover_ideal", "name": "x", 5: 3, "fleets": None, "world": []}
    with pytest.raises(ScenarioError) as caught:
        load_scenario(odd)
    problems = sorted(problem.partition(":")[0] for problem in caught.value.problems)
    assert problems == ["5", "fleets", "world"]
    with pytest.raises(ScenarioError, match=r"extends: scenario file .*~no_such_user/x\.yaml: no such file"):
        load_scenario({"extends": "~no_such_user/x.yaml"})


def test_a_fault_of_the_parent_says_where_it_is(tmp_path: Path) -> None:
    broken = written(tmp_path, child="extends: base.yaml\n", base="a: [1\n")
    with pytest.raises(ScenarioError, match=r"base\.yaml: 1 problem\n  line 2"):
        load_scenario(broken)
    with pytest.raises(ScenarioError, match=r"child\.yaml \(extends .*base\.yaml\): 1 problem\n  duration: -1"):
        child_of_base(tmp_path, "duration: -1\n")
