"""``qrsim list``, ``qrsim show`` and ``qrsim schema``."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest
import yaml

from qrsim import cli
from qrsim.scenarios.scenario import built_in_names, load_scenario


def printed(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(words) == 0
    output = capsys.readouterr()
    assert output.err == ""
    return output.out


# ---------------------------------------------------------------- list


@pytest.mark.long
def test_list_has_one_line_per_scenario(capsys):
    lines = printed(["list"], capsys).splitlines()
    assert [line.split()[0] for line in lines] == built_in_names()
    [patrol] = [line for line in lines if line.startswith("patrol_plain ")]
    assert patrol.split()[1:5] == ["5", "vehicles", "120", "s"]
    assert patrol.endswith(load_scenario("patrol_plain").spec.description)


def test_list_of_components(capsys):
    """Of every kind, built in and from outside; as JSON too."""
    lines = printed(["list", "--components"], capsys).splitlines()
    assert any(line.split()[:2] == ["sensor", "barometer"] and "built in" in line for line in lines)
    rows = json.loads(printed(["list", "--components", "--json"], capsys))
    assert len(rows) == len(lines)
    assert {
        "kind": "task",
        "name": "search",
        "class": "qrsim.tasks.search:Search",
        "from": "built in: qrsim.tasks.search",
    } in rows


def test_list_as_json(capsys):
    rows = json.loads(printed(["list", "--json"], capsys))
    assert [row["name"] for row in rows] == built_in_names()
    for row in rows:
        spec = load_scenario(row["name"]).spec
        assert row["vehicles"] == sum(len(fleet.vehicles) for fleet in spec.fleets.values())
        assert row["duration_s"] == spec.duration
        assert row["description"] == spec.description


# ---------------------------------------------------------------- show


@pytest.mark.parametrize("name", built_in_names())
def test_what_show_prints_is_the_scenario(name, tmp_path, capsys):
    """As YAML and as JSON, and loading the YAML and showing it again changes nothing."""
    text = printed(["show", name], capsys)
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    assert load_scenario(path).spec == load_scenario(name).spec
    assert printed(["show", str(path)], capsys) == text
    assert json.loads(printed(["show", name, "--json"], capsys)) == yaml.safe_load(text)


def test_show_fills_in_every_default(capsys):
    def leaves(value: Any) -> int:
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        return sum(map(leaves, parts)) if parts else 1

    shown = yaml.safe_load(printed(["show"], capsys))
    assert shown["name"] == "outdoor_patrol"
    assert shown["world"]["sky"]["period"] == 0.2
    assert leaves(shown) == leaves(load_scenario("outdoor_patrol").spec.model_dump())


def test_show_with_changes(capsys):
    words = ["show", "--set", "world.wind.speed_20ft=7", "--set", "world.turbulence=still"]
    changed, plain = yaml.safe_load(printed(words, capsys)), yaml.safe_load(printed(["show"], capsys))
    assert changed["world"]["wind"]["speed_20ft"] == 7.0
    assert changed["world"]["turbulence"]["type"] == "still"
    for content in (changed, plain):
        del content["world"]["wind"]["speed_20ft"], content["world"]["turbulence"]
    assert changed == plain


def test_show_has_both_heights_of_the_site(capsys):
    """The geoid is 47.22 m above the ellipsoid at the site of mavlink_field, 46.29 m at the default one."""
    text = printed(["show", "mavlink_field", "--set", "site.height_amsl=488"], capsys)
    (line,) = (line for line in text.splitlines() if line.startswith("# site: "))
    assert line.startswith("# site: 535.22 m above the WGS-84 ellipsoid, 488.00 m above mean sea level; ")
    assert line.endswith("; undulation of the geoid (EGM96): 47.22 m")
    assert yaml.safe_load(text)["site"]["height"] == pytest.approx(535.22, abs=0.01)
    derived = printed(["show", "hover_ideal", "--derived"], capsys)
    assert derived.startswith("site: 0.00 m above the WGS-84 ellipsoid, -46.29 m above mean sea level; ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["outdoor_patrl"], "no scenario is called 'outdoor_patrl'; did you mean 'outdoor_patrol'?"),
        (["--set", "world.wind.speed_20ft=-3"], "world.wind.speed_20ft: -3 is out of range; allowed: 0 to"),
        (["--set", "world.wnd=calm"], "world.wnd: no such parameter of 'world'; did you mean 'wind'?"),
        (["--set", "fleets.pelicans.vehicles.9.yaw_rad=0"], "expected an index from 0 to 4, found '9'"),
    ],
)
def test_show_refuses_what_run_refuses(words, message, refused):
    refused(["show", *words], message)


def test_a_faulty_file_is_told_with_line_and_name(tmp_path, refused):
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\nfleets: {a: {vehicles: [}\n")
    refused(["show", str(path)], str(path), "line 2")
    path.write_text("name: mine\nfleets: {a: {vehicles: [{position_ned: [0, 0]}]}}\n")
    refused(["show", str(path)], f"{path}: ", "fleets.a.vehicles.0.position_ned")
    path.write_text("- 1\n")
    refused(["show", str(path)], "expected keys and values")


# ---------------------------------------------------------------- schema


def test_schema_covers_every_scenario(capsys):
    """Every key of every built-in scenario is in the schema, where it says; followed by hand through its references."""
    schema = json.loads(printed(["schema"], capsys))

    def check(value: Any, part: dict[str, Any], where: str) -> None:
        while "$ref" in part:
            part = schema["$defs"][part["$ref"].removeprefix("#/$defs/")]
        choices = part.get("oneOf") or part.get("anyOf")
        if choices and isinstance(value, dict):
            if "discriminator" not in part:
                (one,) = [choice for choice in choices if choice.get("type") not in ("null", "string")]
                return check(value, one, where)
            mapping = part["discriminator"]["mapping"]
            return check(value, {"$ref": mapping[value["type"]]}, where)
        if isinstance(value, dict):
            if "properties" not in part:
                part = {"properties": dict.fromkeys(value, part["additionalProperties"])}
            for key, inner in value.items():
                assert key in part["properties"], f"{where}.{key}"
                check(inner, part["properties"][key], f"{where}.{key}")
        if isinstance(value, list) and "items" in part:
            for inner in value:
                check(inner, part["items"], where)
        return None

    for name in built_in_names():
        check(load_scenario(name).spec.model_dump(mode="json"), schema, name)
    # It is strict, as the loader is, and knows angles in both units.
    assert schema["additionalProperties"] is False
    assert {"name", "fleets"} <= set(schema["required"])
    vehicle = schema["$defs"]["VehicleSpec"]["properties"]
    assert {"yaw_rad", "yaw_deg"} <= set(vehicle)


# ---------------------------------------------------------------- the output


@pytest.mark.skipif(os.name != "posix", reason="needs a pipe")
@pytest.mark.long
def test_a_reader_that_is_gone():
    """As ``qrsim show | head -1`` where head is quick: exit code 141 and not a word."""
    reader, pipe = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "qrsim.cli", "show"], stdout=pipe, stderr=subprocess.PIPE, text=True, check=False
        )
    finally:
        os.close(pipe)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.long
def test_nothing_but_ascii_on_a_terminal_that_knows_no_more():
    program = "import sys; from qrsim.cli import main; sys.exit(main(['list']) or main(['run', '--help']))"
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.isascii()
    assert b"--realtime" in done.stdout


@pytest.mark.parametrize("words", [["list", "x"], ["schema", "--json"], ["show", "--seed", "1"]], ids=" ".join)
def test_options_that_do_not_exist(words, capsys):
    assert cli.main(words) == 2
    assert f"qrsim {words[0]} --help" in capsys.readouterr().err


# ---------------------------------------------------------------- show --program


def test_the_forms_of_a_program(capsys, refused):
    graph = printed(["show", "hover_ideal", "--program", "graph"], capsys)
    # An operation with what it reads: of a vehicle on its own, numbers without an axis.
    assert re.search(r"^%\d+: float32\[\] = mul\(%\d+, %\d+\)$", graph, re.MULTILINE)
    steps = printed(["show", "hover_ideal", "--program", "steps"], capsys)
    assert steps.index("before the first tick:") < steps.index("every tick:") < steps.index("working memory:")
    assert re.search(r"^  \d+\. loop over scalars: .*\d+ mul", steps, re.MULTILINE)
    text = printed(["show", "hover_ideal", "--program", "llvm"], capsys)
    assert text.count("define void @advance(") == 1
    refused(["show", "hover_ideal", "--program", "step"], "'step' is no form of a program", "did you mean 'steps'?")
