"""What is installed by name: running needs none of it, and what needs it says how to get it."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from qrsim import extras
from qrsim.extras import EXTRAS, ON_DEMAND, MissingExtraError, load, require

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Runs commands in one process in which no extra can be imported: prints exit codes and errors as JSON.
WITHOUT_EXTRAS = """
import contextlib, io, json, sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if any(name == gone or name.startswith(gone + ".") for gone in {absent!r}):
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
        return None

sys.meta_path.insert(0, Absent())
from qrsim.cli import main
results = []
for words in json.loads(sys.argv[1]):
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = main(words)
    results.append((code, said.getvalue()))
print(json.dumps(results))
"""


def without_extras(*commands: list[str]) -> list[tuple[int, str]]:
    absent = [module for modules in EXTRAS.values() for module in modules]
    script = WITHOUT_EXTRAS.format(absent=absent)
    done = subprocess.run(
        [sys.executable, "-c", script, json.dumps(commands)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return [(code, said) for code, said in json.loads(done.stdout.splitlines()[-1])]


def test_every_extra_is_one_of_the_package():
    extras = PROJECT["optional-dependencies"]
    assert set(EXTRAS) | {"all", "dev", "docs", "release"} == set(extras)
    assert extras["brief"] == ["qrsim[sweep,validate,terrain,weather,buildings]"]
    assert extras["all"] == [f"qrsim[{','.join(name for name in EXTRAS if name not in ON_DEMAND)}]"]


@pytest.mark.long
def test_flying_plotting_and_exporting_need_no_extra(tmp_path: Path):
    run, fetched = str(tmp_path / "run"), str(tmp_path / "fetched")
    commands = {
        "run": ["run", "hover_ideal", "--duration", "1", "--out", run],
        "plot": ["plot", run],
        "csv": ["export", run, "--format", "csv", "--out", str(tmp_path / "csv")],
        "check": ["check", "hover_ideal", "--seeds", "1", "--duration", "1"],
        "mcap": ["export", run, "--format", "mcap"],
        "serve": ["serve", "hover_ideal"],
        "view": ["view", run],
        "ros2": ["ros2", "hover_ideal"],
        "bag": ["export", run, "--format", "rosbag2"],
        "run view": ["run", "hover_ideal", "--view", "--out", str(tmp_path / "seen")],
        "data": ["data", "fetch", "--folder", fetched],
        "dataset": ["score", "keep_spot", "--dataset", "mine-v0"],
        "train": ["train", "keep_spot"],
        "sweep": ["sweep", "swarm_collisions", "--out", str(tmp_path / "study")],
    }
    said = dict(zip(commands, without_extras(*commands.values()), strict=True))
    for name in ("run", "plot", "csv", "check"):
        assert said[name][0] == 0, said[name][1]
    extras = {
        "mcap": "export",
        "serve": "serve",
        "view": "view",
        "run view": "view",
        "sweep": "sweep",
        "ros2": "ros2",
        "bag": "ros2",
        "dataset": "datasets",
        "train": "learn",
    }
    for name, extra in extras.items():
        code, text = said[name]
        assert code == 2, (name, text)
        assert f"python -m pip install 'qrsim[{extra}]'" in text, (name, text)
        assert text.count("\n") == 1, (name, text)


def test_what_is_missing_is_named_by_its_package(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    monkeypatch.setitem(sys.modules, "deap", None)
    with pytest.raises(MissingExtraError) as caught:
        require("serve", "a server")
    assert str(caught.value) == "a server needs protobuf: python -m pip install 'qrsim[serve]'"
    with pytest.raises(MissingExtraError) as caught:
        load("identify", "discovering laws", "deap.gp")
    assert str(caught.value) == "discovering laws needs deap: python -m pip install 'qrsim[identify]'"


def test_a_python_without_wheels_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(extras, "_present", lambda name: name != "cyclonedds")
    monkeypatch.setattr(sys, "version_info", (3, 14, 1))
    with pytest.raises(MissingExtraError) as caught:
        require("ros2", "qrsim ros2")
    assert str(caught.value) == "qrsim ros2 needs cyclonedds, which Python 3.14 cannot install: use 3.11 to 3.13"
    monkeypatch.setattr(sys, "version_info", (3, 13, 9))
    with pytest.raises(MissingExtraError, match=r"qrsim ros2 needs cyclonedds: python -m pip install 'qrsim\[ros2\]'"):
        require("ros2", "qrsim ros2")
    assert "cyclonedds>=11.0,<12; python_version < '3.14'" in PROJECT["optional-dependencies"]["ros2"]


def test_what_makes_machine_code_is_bounded_from_above():
    bounded = [line for line in PROJECT["dependencies"] if line.startswith(("jax", "llvmlite"))]
    assert len(bounded) == 2
    assert all("<" in line for line in bounded), bounded


def test_no_room_is_left_out_of_the_wheel():
    """What .gitignore names at any depth, the builder of the wheel leaves out at any depth."""
    root = Path(__file__).parents[1]
    lines = (root / ".gitignore").read_text(encoding="utf-8").split()
    anywhere = {line.strip("/") for line in lines if not line.startswith("/")}
    rooms = {path.parent.name for path in (root / "src").rglob("*.py")}
    assert "runs" in rooms
    assert not rooms & anywhere
