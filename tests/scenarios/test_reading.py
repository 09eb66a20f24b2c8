"""Reading scenario files: YAML with no surprises, names, paths, and ``--set`` overrides."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.reading import anchor_files, apply_override, built_in_names, dump_yaml, parse_yaml, read_scenario
from qrsim.scenarios.scenario import load_scenario

SMALLEST = "name: small\nfleets:\n  a:\n    controller: {type: waypoint, feed: truth}\n    vehicles:\n"
SMALLEST += "      - position_ned: [0.0, 0.0, -10.0]\n"


def yaml_problem(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        parse_yaml(text, "some.yaml")
    assert str(caught.value).startswith("some.yaml: 1 problem\n")
    (problem,) = caught.value.problems
    return problem


def test_a_key_given_twice_is_an_error_with_both_lines() -> None:
    assert yaml_problem("a: 1\nb: 2\na: 3\n") == "line 3, column 1: 'a' is given twice, first in line 1"
    assert yaml_problem("x:\n  a: 1\n  a: 1\n") == "line 3, column 3: 'a' is given twice, first in line 2"
    assert yaml_problem("x: {a: 1, a: 2}\n") == "line 1, column 11: 'a' is given twice, first in line 1"


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("a: [1, 2\nb: 3\n", "line 2, column 2: "),
        ("a: b: c\n", "line 1, column 5: "),
        ("a:\n\t- b\n", "line 2, column 1: "),
        ("a: 'open\n", "line 2, column 1: "),
        ("a: 1\n---\nb: 2\n", "line 2, column 1: "),
        ("a: !!python/object:os.system x\n", "line 1, column 4: "),
        ("5: 3\n", "line 1, column 1: the key 5 is not a text"),
        ("x: &x {y: 1}\nz:\n  <<: *x\n", "line 3, column 3: '<<' is not supported; write the values out"),
    ],
)
def test_a_fault_of_the_yaml_is_an_error_with_line_and_column(text: str, start: str) -> None:
    problem = yaml_problem(text)
    assert problem.startswith(start), problem
    assert len(problem) > len(start) or not start.endswith(": "), "the place alone does not say what is wrong"


def test_characters_that_no_yaml_has_are_an_error() -> None:
    assert "#x0000" in yaml_problem("a: \x00\n")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 1e-3), ("1E3", 1e3), ("-2.5e+2", -250.0), (".5", 0.5), ("5e1", 50.0), ("1.e2", 100.0), ("3", 3)],
)
def test_numbers_are_numbers_in_every_usual_notation(text: str, value: float) -> None:
    read = parse_yaml(f"a: {text}\n", "some.yaml")["a"]
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize("text", ["1e", "e3", "1e3m", "v1e3", "1.2.3"])
def test_what_only_looks_like_a_number_stays_a_text(text: str) -> None:
    assert parse_yaml(f"a: {text}\n", "some.yaml") == {"a": text}


@pytest.mark.parametrize(("text", "found"), [("", "nothing"), ("- a\n", "a list"), ("hello\n", "a text"), ("5\n", "5")])
def test_a_file_without_keys_is_an_error(text: str, found: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=rf"odd.yaml: 1 problem\n.*expected keys and values.*, found {found}$"):
        load_scenario(path)


def test_a_path_can_be_a_text_or_a_path(tmp_path: Path) -> None:
    path = tmp_path / "small.yml"
    path.write_text(SMALLEST)
    assert load_scenario(path).spec == load_scenario(str(path)).spec
    assert load_scenario(path).name == "small"


def test_the_faults_of_a_file_are_headed_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(SMALLEST + "duration: -1\n")
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}: 1 problem\n  duration: -1 is out of range")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("hovr", "did you mean 'hover'?"),
        ("outdoor-patrol", "did you mean 'outdoor_patrol'?"),
        ("zzz", "known: hover, patrol_plain"),
        ("", "known: hover, patrol_plain"),
    ],
)
def test_an_unknown_name_is_an_error_with_the_nearest_one(name: str, hint: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_scenario(name)
    assert f"no scenario is called '{name}'" in str(caught.value)
    assert hint.removeprefix("known: ").split(",")[0] in str(caught.value)


def test_a_missing_file_is_an_error_with_the_nearest_one(tmp_path: Path) -> None:
    (tmp_path / "patrol.yaml").write_text(SMALLEST)
    with pytest.raises(UsageError, match=r"patrl.yaml: no such file; did you mean '.*patrol.yaml'\?"):
        read_scenario(tmp_path / "patrl.yaml")
    with pytest.raises(UsageError, match=r"hover.yaml: no such file; did you mean 'hover'\?"):
        read_scenario("hover.yaml")
    with pytest.raises(UsageError, match=r"nothing.yaml: no such file$"):
        read_scenario(tmp_path / "no_folder" / "nothing.yaml")


def test_a_file_that_cannot_be_read_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"name: \xff\xfe")
    with pytest.raises(UsageError, match=r"binary.yaml: cannot be read"):
        read_scenario(path)
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(UsageError, match=r"folder.yaml: cannot be read"):
        read_scenario(folder)


@pytest.mark.parametrize("source", [None, 5, b"hover", ["hover"]])
def test_what_is_no_source_at_all_is_an_error(source: Any) -> None:
    with pytest.raises(UsageError, match="expected a name, the path of a"):
        read_scenario(source)


def test_the_built_in_names_are_those_of_the_files() -> None:
    assert {"hover", "patrol_plain"} <= set(built_in_names())
    assert built_in_names() == sorted(built_in_names())


def patrol(*overrides: str) -> Any:
    return load_scenario("patrol_plain", overrides).spec


def test_an_override_sets_one_value() -> None:
    before, after = patrol(), patrol("world.wind.speed_20ft=7")
    assert (before.world.wind.speed_20ft, after.world.wind.speed_20ft) == (5.0, 7.0)
    unchanged = after.model_copy(update={"world": before.world})
    assert unchanged == before


def test_an_override_reaches_into_lists() -> None:
    spec = patrol("fleets.pelicans.vehicles.1.position_ned.2=-15", "fleets.pelicans.vehicles.0.name=first")
    assert spec.fleets["pelicans"].vehicles[1].position_ned == [-60.0, 20.0, -15.0]
    assert spec.fleets["pelicans"].vehicles[0].name == "first"
    assert spec.fleets["pelicans"].vehicles[2] == patrol().fleets["pelicans"].vehicles[2]
    spec = patrol("fleets.pelicans.vehicles.3.waypoints_ned=[[1.0, 2.0, -30.0]]")
    assert spec.fleets["pelicans"].vehicles[3].waypoints_ned == [[1.0, 2.0, -30.0]]


def test_overrides_count_in_their_order() -> None:
    assert patrol("duration=60", "duration=40").duration == 40.0


@pytest.mark.parametrize(
    ("override", "slot", "kind"),
    [
        ("world.turbulence=still", "world.turbulence", "still"),
        ("world.sky.errors=ou", "world.sky.errors", "ou"),
        ("world.area=box", "world.area", "box"),
        ("fleets.pelicans.vehicle=pelican", "fleets.pelicans.vehicle", "pelican"),
        ("fleets.pelicans.sensors.barometer=ideal_barometer", "fleets.pelicans.sensors.barometer", "ideal_barometer"),
        ("fleets.pelicans.sensors.spare=gyroscope", "fleets.pelicans.sensors.spare", "gyroscope"),
        ("fleets.pelicans.sensors.spare.type=gyroscope", "fleets.pelicans.sensors.spare", "gyroscope"),
        ("fleets.pelicans.battery=lithium_polymer", "fleets.pelicans.battery", "lithium_polymer"),
        ("world.gust=none", "world.gust", "none"),
        ("world.turbulence={type: still}", "world.turbulence", "still"),
    ],
)
def test_a_component_is_replaced_by_the_name_of_its_type(override: str, slot: str, kind: str) -> None:
    value: Any = patrol(override)
    for part in slot.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    assert value.type == kind


def test_a_type_alone_names_a_component_in_a_file_too(tmp_path: Path) -> None:
    text = "extends: hover\nworld: {wind: calm, turbulence: still}\nfleets: {pelicans: {controller: %s}}\n"
    (tmp_path / "short.yaml").write_text(text % "waypoint")
    spec = load_scenario(tmp_path / "short.yaml").spec
    found = (spec.world.wind.type, spec.world.turbulence.type, spec.fleets["pelicans"].controller.type)
    assert found == ("calm", "still", "waypoint")
    (tmp_path / "short.yaml").write_text(text % "waypont")
    with pytest.raises(ScenarioError, match=r"controller\.type: no such type 'waypont'; did you mean 'waypoint'"):
        load_scenario(tmp_path / "short.yaml")


def test_a_replaced_component_keeps_nothing_of_the_old_one() -> None:
    before = patrol().world.sky.errors
    after = patrol("world.sky.errors=ou").world.sky.errors
    assert before.std != 12.35
    assert after.std == 12.35, "the type's own default"


def test_a_slot_that_the_scenario_leaves_out_can_be_given_by_type_name() -> None:
    content: dict[str, Any] = {"name": "x"}
    apply_override(content, "world.wind=calm")
    apply_override(content, "name=y")
    assert content == {"name": "y", "world": {"wind": {"type": "calm"}}}


def test_degrees_override_radians_and_the_other_way_round() -> None:
    assert math.isclose(patrol("world.wind.wind_from_rad=1.5").world.wind.wind_from_rad, 1.5)
    assert math.isclose(patrol("world.wind.wind_from_deg=90").world.wind.wind_from_rad, math.pi / 2)
    both = patrol("world.wind.wind_from_rad=1.5", "world.wind.wind_from_deg=180")
    assert math.isclose(both.world.wind.wind_from_rad, math.pi)
    turned = patrol("fleets.pelicans.vehicles.0.yaw_rad=1.0", "fleets.pelicans.vehicles.0.yaw_deg=45")
    assert math.isclose(turned.fleets["pelicans"].vehicles[0].yaw_rad, math.pi / 4)


def test_a_sensor_of_a_set_is_changed_where_sensors_are_listed(tmp_path: Path) -> None:
    file = tmp_path / "set.yaml"
    file.write_text("name: set\nfleets: {one: {sensors: noisy, vehicles: [{position_ned: [0, 0, -20]}]}}\n")
    with pytest.raises(UsageError, match=r"sensors is the value 'noisy', it has no parts; 'qrsim show' lists the"):
        load_scenario(file, ["fleets.one.sensors.attitude=attitude_estimator"])


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("world.wind.speed_20ft", "expected path=value, for example world.wind.speed_20ft=7"),
        ("=3", "expected path=value"),
        ("world..wind=calm", "expected path=value"),
        ("world.wind.speed_20ft.x=3", "world.wind.speed_20ft is the value 5.0, it has no parts"),
        ("name.x=3", "name is the value 'patrol_plain', it has no parts"),
        (
            "fleets.pelicans.vehicles.9.name=x",
            "fleets.pelicans.vehicles.9: expected an index from 0 to 4, found '9'",
        ),
        (
            "fleets.pelicans.vehicles.-1.name=x",
            "fleets.pelicans.vehicles.-1: expected an index from 0 to 4, found '-1'",
        ),
        ("fleets.pelicans.vehicles.²=x", "expected an index from 0 to 4, found '²'"),
        ("fleets.pelicans.vehicles.9999999999=x", "expected an index from 0 to 4, found '9999999999'"),
        (
            "fleets.pelicans.vehicles.first.name=x",
            "fleets.pelicans.vehicles.first: expected an index from 0 to 4, found 'first'",
        ),
        (
            "fleets.pelicans.vehicles.0.position_ned.3=1",
            "fleets.pelicans.vehicles.0.position_ned.3: expected an index from 0 to 2, found '3'",
        ),
        ("fleets.pelican.controller.feed=truth", "no fleet is called 'pelican'; did you mean 'pelicans'?"),
        ("world.wind={type:calm}", "'type:calm' is one key in YAML; write 'type: calm'"),
        ("fleets.pelicans.vehicles=[{a: [b, {speed:3}]}]", "'speed:3' is one key in YAML; write 'speed: 3'"),
        ("fleets.pelicans.sensors.gns.period=0.4", "no sensor is called 'gns'; did you mean 'gnss'?"),
    ],
)
def test_a_bad_override_path_is_an_error_that_repeats_it(override: str, expected: str) -> None:
    with pytest.raises(UsageError) as caught:
        patrol(override)
    assert str(caught.value).startswith(f"--set {override}: ")
    assert expected in str(caught.value)


def test_an_index_of_thousands_of_digits_is_an_error_of_a_line() -> None:
    with pytest.raises(UsageError, match=r"^--set fleets.pelicans.vehicles.9+ ... 9+=x: expected path=value") as caught:
        patrol(f"fleets.pelicans.vehicles.{'9' * 5000}=x")
    assert len(str(caught.value)) < 2200


def test_an_override_that_the_scenario_does_not_know_is_found_by_its_check() -> None:
    with pytest.raises(ScenarioError, match=r"world.wind.sped_20ft: no such parameter.*did you mean 'speed_20ft'"):
        patrol("world.wind.sped_20ft=7")
    with pytest.raises(ScenarioError, match=r"wrld: no such parameter of 'scenario'; did you mean 'world'"):
        patrol("wrld.wind=calm")
    with pytest.raises(ScenarioError, match=r"world.wind.type: no such type 'clam'; did you mean 'calm'"):
        patrol("world.wind=clam")
    with pytest.raises(ScenarioError, match=r"duration: '' is not a number"):
        patrol("duration=")


def test_an_override_whose_value_is_no_yaml_is_an_error_with_its_column() -> None:
    with pytest.raises(ScenarioError, match=r"--set duration: 1 problem\n  line 1, column 2: "):
        patrol("duration=[")


def test_overrides_leave_the_content_they_are_applied_to_alone() -> None:
    content = parse_yaml(SMALLEST, "small.yaml")
    load_scenario(content, ["duration=5"])
    assert "duration" not in content


def test_a_file_is_looked_for_beside_the_scenario_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "field").mkdir()
    (tmp_path / "elsewhere").mkdir()
    series = "time,north,east,down\n" + "".join(f"{10 * i},1,2,0\n" for i in range(8))
    (tmp_path / "field" / "wind.csv").write_text(series, "utf-8")
    content = dump_yaml({**parse_yaml(SMALLEST, "small"), "world": {"wind": {"type": "series", "file": "wind.csv"}}})
    (tmp_path / "field" / "windy.yaml").write_text(content, "utf-8")
    monkeypatch.chdir(tmp_path / "elsewhere")
    scenario = load_scenario("../field/windy.yaml")
    assert scenario.spec.world.wind.file == str(tmp_path / "field" / "wind.csv")
    # On the command line it is relative to where the command is typed, and the saved scenario says where it was.
    (tmp_path / "elsewhere" / "calm.csv").write_text(series, "utf-8")
    overridden = load_scenario("../field/windy.yaml", ["world.wind.file=calm.csv"])
    assert f"file: {tmp_path}/elsewhere/calm.csv" in overridden.to_yaml()
    with pytest.raises(ScenarioError, match=r"world\.wind: .*elsewhere/wind\.csv"):
        load_scenario({**parse_yaml(SMALLEST, "small"), "world": {"wind": {"type": "series", "file": "wind.csv"}}})


def test_a_recording_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QRSIM_DATA_DIR", str(tmp_path / "recordings"))
    name = "ngs15992_16to17.sp3"
    content = {"world": {"sky": {"orbits": {"type": "sp3", "file": name}}}}
    anchor_files(content, tmp_path)
    assert content["world"]["sky"]["orbits"]["file"] == str(tmp_path / "recordings" / name)
    # One that lies beside the scenario comes first.
    (tmp_path / name).touch()
    content = {"world": {"sky": {"orbits": {"type": "sp3", "file": name}}}}
    anchor_files(content, tmp_path)
    assert content["world"]["sky"]["orbits"]["file"] == str(tmp_path / name)
