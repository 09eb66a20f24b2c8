"""Tasks whose vehicles are multirotors: they are taken as they are, and their baselines fly them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

import qrsim
from qrsim.cli import main
from qrsim.models.vehicles.multirotor import Multirotor

TASKS = {
    "keep_spot": ("pelicans",),
    "cats_and_mouse/1C": ("cats", "mice"),
    "search_and_rescue/2C": ("helicopters",),
    "plume_mapping/3B": ("helicopters",),
}


def scenario(name: str) -> dict[str, Any]:
    part = {"vehicle": {"type": "multirotor", "model": "x500"}, "controller": {"type": "cascade", "feed": "filter"}}
    return {"name": "x", "extends": name, "fleets": dict.fromkeys(TASKS[name], part)}


@pytest.mark.parametrize("name", TASKS)
def test_a_task_takes_multirotors(name: str) -> None:
    world = qrsim.load_scenario(scenario(name)).world()
    assert [type(fleet.vehicle) for fleet in world.fleets] == [Multirotor] * len(TASKS[name])


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name in TASKS if name != "keep_spot"])
def test_its_baseline_flies_them(name: str, tmp_path: Path) -> None:
    file = tmp_path / "x.yaml"
    file.write_text(yaml.safe_dump(scenario(name), sort_keys=False))
    main(["run", str(file), "--policy", "baseline", "--duration", "4", "--out", str(tmp_path / "out")])
    run = qrsim.open_run(tmp_path / "out")
    assert run["truth"]["valid"].all()
    # They fly as they are told, and in none of the tasks is that to stay.
    start, end = run["truth"]["position_ned.x"][0], run["truth"]["position_ned.x"][-1]
    assert abs(end - start).max() > 2.0
