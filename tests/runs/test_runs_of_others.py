"""A run folder of somebody else: looking at it loads none of the code that its scenario names."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.cli import main
from qrsim.errors import ScenarioError
from qrsim.files.yaml_text import dump_yaml, parse_yaml
from qrsim.runs import Run, open_run
from qrsim.runs.export.tracks import ground_of
from qrsim.runs.surroundings import surroundings_of
from qrsim.runs.terrain import Terrain
from qrsim.view.recording import Recording

NEVER = r"is Python code, which is not loaded to read a run; if you trust its author, --code loads it"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown") / "run"
    assert main(["run", "hover_ideal", "--duration", "0.1", "--out", str(folder), "--no-figure"]) == 0
    return folder


def look(run: Run) -> None:
    """Ask for all that is built from a recorded scenario."""
    surroundings_of(run)
    Terrain(run).down(np.zeros(1), np.zeros(1))
    ground_of(run)(np.zeros((1, 3)))
    Recording(run)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("./{module}.py:Laser", "sensor"),
        ("{folder}/{module}.py:Laser", "controller"),
        ("{module}:Laser", "sensor"),
        ("{folder}/{module}.py:Laser", "parent"),
        ("{folder}/{module}.py:Laser", "text"),
    ],
)
def test_looking_at_a_run_loads_no_code(
    tmp_path: Path,
    flown: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    place: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    # It leaves a mark when it is run.
    module, mark = f"theirs_{tmp_path.name}", tmp_path / "mark"
    (tmp_path / f"{module}.py").write_text(f"open({str(mark)!r}, 'w').close()\n")
    folder = tmp_path / "run"
    shutil.copytree(flown, folder)
    content: Any = parse_yaml((folder / "scenario.yaml").read_text(), "scenario", own=True)
    fleet, named = content["fleets"]["pelicans"], {"type": name.format(folder=tmp_path, module=module)}
    fleet |= {"controller": named} if place == "controller" else {"sensors": {"laser": named}}
    content["world"] |= {"ground": {"type": "dem", "file": "hills.asc"}, "plume": {"type": "gaussian"}}
    if place in ("parent", "text"):
        (tmp_path / "parent.yaml").write_text(dump_yaml(content))
        content = str(tmp_path / "parent.yaml") if place == "text" else {"extends": str(tmp_path / "parent.yaml")}
    (folder / "scenario.yaml").write_text(dump_yaml(content))
    run = open_run(folder)
    with pytest.raises(ScenarioError, match="expected keys and values" if place == "text" else NEVER):
        run.built()
    look(run)
    for command in (["plot"], ["export", "--format", "kml"], ["compare", str(folder)]):
        # Without a site of its own, nothing has a place on a map.
        failed = command[0] == "export" and place in ("parent", "text")
        assert main([command[0], str(folder), *command[1:]]) == failed
    assert "this is a bug" not in capsys.readouterr().err
    assert not mark.exists()
    if place != "text":
        with pytest.raises(ScenarioError, match=r"has no 'Laser'"):
            open_run(folder, code=True).built()
        assert mark.exists()


def test_what_a_session_has_loaded_itself_is_built_again(tmp_path: Path) -> None:
    laser = Path(__file__).parents[2] / "examples" / "outside" / "laser.yaml"
    assert main(["run", str(laser), "--duration", "0.1", "--out", str(tmp_path / "run"), "--no-figure"]) == 0
    assert open_run(tmp_path / "run").built().world().fleets[0].vehicle_names
