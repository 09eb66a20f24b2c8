"""What damaged files and wrong arguments come to: one clear error, in no time."""

from __future__ import annotations

import contextlib
import copy
import json
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.runs.small_run import COLUMNS, VEHICLES, append_chunk

import qrsim
from qrsim.cli import main
from qrsim.errors import QrsimError, RunError, ScenarioError, UsageError
from qrsim.runs import RunInfo, RunWriter, open_run
from qrsim.scenarios.scenario import load_scenario
from qrsim.studies.flight_logs import read_log
from qrsim.studies.sweep.study import load_study


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    info = RunInfo.collect(scenario="x", seed=1, precision="float64", time_step=0.02, vehicles=VEHICLES)
    with RunWriter.create(folder, info=info, scenario_yaml="name: x\n", columns=COLUMNS) as writer:
        append_chunk(writer, 1)
    return folder


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vehicles": []}, "vehicles: there are none"),
        ({"vehicles": ["a", "a"]}, "vehicles: a name is there twice"),
        ({"parts": {"truth": 10**12}}, r"parts.truth: 1000000000000; expected 0 to"),
        ({"parts": {"../x": 1}}, "no name of a stream"),
        ({"time_step": 0.0}, "time_step: 0; expected above 0"),
        ({"ticks": -1}, "ticks: -1"),
        ({"format": [1]}, "format"),
        ({"format": "x" * 9000}, "format"),
    ],
)
def test_a_run_json_that_no_run_wrote(run_folder: Path, change: dict[str, Any], words: str) -> None:
    path = run_folder / "run.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(RunError, match=words):
        open_run(run_folder)


def test_a_recorded_scenario_that_is_no_text(run_folder: Path) -> None:
    (run_folder / "scenario.yaml").write_bytes(b"name: \xff\n")
    with pytest.raises(RunError, match="byte 0xff in line 1 is no UTF-8 text"):
        open_run(run_folder)
    (run_folder / "scenario.yaml").write_text("name: [x\n")
    with pytest.raises(RunError, match=r"scenario.yaml is damaged: line 2"):
        _ = open_run(run_folder).scenario


def test_flipped_bits_in_parquet(run_folder: Path) -> None:
    """Each byte of a part in turn: read as it was, or one RunError."""
    part = run_folder / "truth" / "part-00000.parquet"
    whole, expected = part.read_bytes(), open_run(run_folder)["truth"].arrays()
    refused = 0
    for place in range(0, len(whole), 7):
        part.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1 :])
        try:
            run = open_run(run_folder)
            run.describe("truth")
            found = run["truth"].arrays()
        except (RunError, UsageError):
            refused += 1
            continue
        assert set(found) <= set(expected) or len(found) == len(expected)
    assert refused > 100
    part.write_bytes(whole)
    assert np.array_equal(open_run(run_folder)["truth"]["thrust"], expected["thrust"])


def test_a_clock_that_jumps(tmp_path: Path) -> None:
    rows = [f"{0.02 * i + (1e6 if i >= 300 else 0.0):.3f},0.1,0.2" for i in range(600)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time [s],roll [rad],roll_command [rad]", *rows]))
    with pytest.raises(UsageError, match=r"allowed: up to 36000 s; the largest step of the clock: \w+ from 5.98 s to"):
        read_log(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("vary: {world.wind.speed_20ft: {low: 1.0, high: 2.0, count: 1000000000}}", "allowed: 2 to 100 000"),
        ("vary: {a.b: {low: 1.0, high: 2.0, count: 90000}, c.d: {low: 1.0, high: 2.0, count: 90000}}", "8.1e.10 epis"),
        ("vary: {a.b: {low: 1.0, high: 2.0}}\nsampling: {type: sobol, points: 1000000000}", "points: 1000000000"),
    ],
)
def test_studies_of_any_size(tmp_path: Path, change: str, words: str) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(f"name: x\nscenario: hover\nseeds: 10\nmetrics: [stopped]\n{change}\n")
    with pytest.raises(ScenarioError, match=words):
        load_study(str(path))


@pytest.mark.parametrize(
    "command", [["run", "hover_ideal", "--view"], ["serve", "hover_ideal", "--view", "--port", "0"]]
)
def test_a_page_without_viser(command: list[str], monkeypatch: Any, capsys: Any) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "viser" or name.startswith("qrsim.view")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(command) == 2
    assert "needs viser: python -m pip install 'qrsim[view]'" in capsys.readouterr().err


def test_overrides_are_a_list() -> None:
    with pytest.raises(UsageError, match=r"overrides: expected a list such as \['path=value'\], found the text 'a=b'"):
        qrsim.load("hover_ideal", overrides="a=b")
    with pytest.raises(UsageError, match="expected texts such as 'path=value', found 1"):
        qrsim.load("hover_ideal", overrides=[1])  # type: ignore[list-item]


def deep(levels: int) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for _ in range(levels):
        content = {"a": content}
    return content


def test_content_from_python_is_limited_too() -> None:
    inside: dict[str, Any] = {"name": "x"}
    inside["fleets"] = {"a": inside}
    for content in (inside, deep(5000)):
        with pytest.raises(ScenarioError, match="nested deeper than 64 levels"):
            load_scenario(content)
    with pytest.raises(ScenarioError, match="more than 4000000 values"):
        load_scenario({"name": "x", "fleets": [0] * (4 * 10**6)})


@pytest.mark.parametrize(
    "override",
    [
        "fleets.pelicans.controller.type=[1]", "fleets.pelicans.sensors.gnss.type={a: 1}", "world.wind.type=[[]]",
        "world.wind=[1]", "world={type: [1]}", "fleets=[]", "fleets.pelicans.vehicles=7", f"{'a.' * 3000}b=1",
        f"{'x' * 100_000}=1", f"name={'x' * 100_000}", "world.wind.speed_20ft=" + "9" * 5000, "duration=&a [*a]",
        "world.sky.orbits={type: sp3, file: \"a\\0b\"}", "extends=hover",
    ],
)  # fmt: skip
def test_overrides_that_are_refused(override: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_scenario("patrol_plain", [override])
    assert len(str(caught.value)) < 6000


LONG = "x" * 5000


@pytest.mark.parametrize(
    "command",
    [
        ["plot", LONG],
        ["compare", LONG, LONG],
        ["run", "hover_ideal", "--out", LONG],
        ["sweep-report", LONG],
        ["run", "hover_ideal", "--policy", f"{LONG}.py:f"],
        ["show", f"{LONG}.yaml"],
        ["sweep-report", "."],
    ],
)
def test_names_that_no_file_can_have(command: list[str], capsys: Any) -> None:
    assert main(command) == 2
    said = capsys.readouterr().err
    assert any(words in said for words in ("File name too long", "there is no file", "it is no store"))
    assert "Traceback" not in said


def test_a_run_of_such_a_name() -> None:
    for name in (LONG, "a\0b"):
        with pytest.raises(UsageError, match="no run at "):
            open_run(name)


def test_a_folder_that_is_written_while_it_is_read(run_folder: Path) -> None:
    """A run that was killed before its first tick has no parts, and that is said."""
    shutil.rmtree(run_folder / "truth")
    with pytest.raises(QrsimError, match="it is missing"):
        open_run(run_folder)["truth"].arrays()


def paths_of(content: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place of a content, the inner ones too."""
    parts = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    inner = [found for key, part in parts for found in paths_of(part, (*path, key))]
    return [*([path] if path else []), *inner]


@pytest.mark.parametrize("name", ["hover", "patrol_plain", "cats_and_mouse/1C", "search_and_rescue/2D"])
@pytest.mark.parametrize("value", [[1], {"type": [1]}, None, "x", 10**30, math.nan, 1e-320], ids=repr)
def test_any_value_at_any_place(name: str, value: Any) -> None:
    """What is not taken is refused in words, where a name of a type is expected too."""
    from qrsim.scenarios.reading import read_scenario

    _, content = read_scenario(name)
    for path in paths_of(content):
        # Of the many vehicles and waypoints, the first are as good as all.
        if any(isinstance(key, int) and key > 0 for key in path):
            continue
        changed = copy.deepcopy(content)
        target: Any = changed
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = value
        with contextlib.suppress(UsageError):
            load_scenario(changed, quiet=True)


def test_control_characters_of_an_input_are_written_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "no\x1b[31msuch\x07"]) == 2
    told = capsys.readouterr().err
    assert "\x1b" not in told
    assert "\x07" not in told
    assert "no\\x1b[31msuch\\x07" in told
