"""``qrsim slam --vehicles``: several vehicles of new flights or of a run, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from qrsim import cli
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import load_scenario


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--vehicles", "0"], "--vehicles 0: expected a positive number"),
        (["--vehicles", "-2"], "--vehicles -2: expected a positive number"),
        (["--vehicles", "10"], "--vehicles 10: expected at most 9"),
        (["--vehicles", "2", "--graph", "paper"], "--vehicles: several are solved in --graph gnss only"),
        (["--vehicles", "2", "--sweep"], "--sweep: not with several --vehicles"),
        (["--vehicles", "2", "--noise", "white"], "--noise: not with several --vehicles"),
        (["--vehicles", "2", "--vehicle", "a", "--run", "x"], "--vehicle: not with several --vehicles"),
    ],
)
def test_what_does_not_go_together_is_one_line(words: list[str], reason: str, capsys: Any) -> None:
    assert cli.main(["slam", *words]) == 2
    assert capsys.readouterr().err.strip() == f"error: {reason}"


@pytest.mark.nightly
def test_a_team_is_flown_solved_and_drawn(tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    words = ["--vehicles", "2", "--seeds", "2", "--duration", "10", "--states", "poses", "--out", str(out)]
    assert cli.main(["slam", *words]) == 0
    printed = capsys.readouterr().out
    assert "2 vehicles, 2 flights of 10 s each" in printed
    assert {path.name for path in out.iterdir()} == {"team.png", "gain.png", "result.json"}
    found = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert len(found["cases"]) == 6
    # Alone a shared error is like one of one's own: vehicle 0 has the same flight.
    shared, own = (found["cases"][name]["alone_m"]["mean"] for name in ("shared_as_own_states", "own_as_own_states"))
    assert shared == pytest.approx(own, rel=1e-6)
    assert found["cases"]["own_as_own_states"]["gain_m"]["pairs"] == 2


@pytest.mark.long
def test_the_first_vehicles_of_a_run(tmp_path: Path, capsys: Any) -> None:
    places = [[0.0, 0.0, -20.0], [10.0, 5.0, -19.0]]
    vehicles = [{"position_ned": place, "waypoints_ned": [[-place[0], 12.0, place[2]]]} for place in places]
    sensors = {"uwb": {"type": "ranging", "beacons": []}}
    scenario: dict[str, Any] = {
        "name": "two",
        "extends": "range_only_slam",
        "duration": 6.0,
        "fleets": {"pelicans": {"sensors": sensors, "vehicles": vehicles}},
    }
    fly(load_scenario(scenario), tmp_path / "run", seed=3, precision="float32")
    words = ["slam", "--run", str(tmp_path / "run"), "--states", "poses"]
    assert cli.main([*words, "--vehicles", "3"]) == 2
    assert "has 2: pelicans_0, pelicans_1" in capsys.readouterr().err
    assert cli.main([*words, "--vehicles", "2", "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    # Every tenth of a second each ranges to the other one, and 2 % are lost.
    assert 105 < found["ranges_between"] <= 122
    assert len(found["trajectory_rmse_m"]) == 2
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"trajectory.png", "result.json"}
