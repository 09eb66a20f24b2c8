"""Conditions of a study: names, each of which sets several values; and vehicles in rows, whose number varies."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import pytest

from qrsim.cli import main
from qrsim.errors import ScenarioError
from qrsim.scenarios.reading import dump_yaml
from qrsim.studies.sweep.axes import axes_of, overrides
from qrsim.studies.sweep.prepare import plan_of
from qrsim.studies.sweep.report import replay
from qrsim.studies.sweep.results import Results
from qrsim.studies.sweep.study import load_study
from qrsim.studies.sweep.varying import Condition

STUDY: dict[str, Any] = {
    "name": "two_airs",
    "scenario": {
        "duration": 0.2,
        "world": {"wind": {"type": "log_shear", "speed_20ft": 1.0, "wind_from_deg": 90.0}},
        "fleets": {
            "team": {
                "controller": {"type": "waypoint", "feed": "truth"},
                "vehicles": {"count": 4, "spacing": 5.0, "position_ned": [0.0, 0.0, -10.0]},
            }
        },
    },
    "vary": {
        "air": {
            "conditions": {
                "still": {"world.wind.speed_20ft": 0.0},
                "gusty": {"world.wind.speed_20ft": 6.0, "world.turbulence.type": "dryden"},
                "as given": {},
            }
        },
        "fleets.team.vehicles.count": {"values": [2, 9], "name": "vehicles"},
        "fleets.team.vehicles.spacing": {"values": [3.0, 8.0], "name": "spacing", "unit": "m"},
    },
    "seeds": 2,
    "metrics": ["wind_max_m_s", "separation_min_m"],
}


def written(tmp_path: Path, vary: dict[str, Any] | None = None) -> str:
    """Return the path of the study, with other parameters."""
    content = copy.deepcopy(STUDY)
    if vary is not None:
        content["vary"] = vary
    path = tmp_path / "two_airs.yaml"
    path.write_text(dump_yaml(content), "utf-8")
    return str(path)


@pytest.mark.long
def test_conditions_are_flown_stored_by_name_and_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Still air, 6 m/s with gusts and 1 m/s as given; two vehicles and nine, 3 m and 8 m apart."""
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", written(tmp_path), "--workers", "1"]) == 0
    results = Results(tmp_path / "sweeps" / "two_airs.zarr")
    data = results.dataset
    assert data.air.values.tolist() == ["still", "gusty", "as given"]
    assert dict(data.sizes) == {"air": 3, "vehicles": 2, "spacing": 2, "seed": 2}
    wind = data.wind_max_m_s.mean(["seed", "vehicles", "spacing"])
    assert float(wind.sel(air="still")) == 0.0
    assert float(wind.sel(air="gusty")) > 4.0
    # At 10 m the logarithmic law has 1.1 of the wind at 20 ft.
    assert float(wind.sel(air="as given")) == pytest.approx(1.13, abs=0.03)
    near = data.separation_min_m.sel(air="still").mean(["seed", "vehicles"])
    assert near.values.tolist() == pytest.approx([3.0, 8.0], abs=0.01)
    found = results.values_at(4 * 2)
    assert found["air"] == "gusty"
    command = replay(results, 4 * 2, tmp_path / "report")
    assert "world.wind.speed_20ft=6.0" in command
    assert 'world.turbulence.type="dryden"' in command
    capsys.readouterr()
    assert main(["sweep-report", "sweeps/two_airs.zarr"]) == 0
    assert "gusty" in capsys.readouterr().out


def test_values_thins_conditions_too(tmp_path: Path) -> None:
    """Of three the first and the last are left."""
    study = load_study(written(tmp_path), values=2)
    assert [str(name) for name in axes_of(study.spec)[0].values or ()] == ["still", "as given"]


def test_a_condition_is_a_name_that_knows_what_it_sets() -> None:
    """It goes to other processes, and sets what it says in its order."""
    found = pickle.loads(pickle.dumps(Condition("gusty", {"duration": 2.0, "world.wind": "calm"})))
    assert (found, found.settings) == ("gusty", {"duration": 2.0, "world.wind": "calm"})
    assert overrides({}, "air", found) == ["duration=2.0", 'world.wind="calm"']


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"air": {"conditions": {"a": {}}, "values": [1]}}, "give either values, or conditions, or low and high"),
        (
            {"air": {"conditions": {"a": {"world.wind.sped": 1.0}}}},
            "vary.air: world.wind.sped: no such parameter of 'log_shear'; did you mean 'speed'",
        ),
        ({"air": {"conditions": {"a": {}, "b": {"world.wind.speed_20ft": -1.0}}}}, "'b': world.wind.speed_20ft: -1"),
        ({"air": {"conditions": {"a": {"fleets.tem.radius": 1.0}}}}, "tem"),
        ({"air": {"conditions": {"a": 3}}}, "vary.air.conditions.a"),
        ({"air": {"conditions": {}}}, "vary.air.conditions"),
        ({"fleets.team.vehicles.count": {"values": [0, 2]}}, "count: 0 is out of range"),
    ],
)
def test_wrong_conditions_are_refused_before_anything_is_flown(
    tmp_path: Path, vary: dict[str, Any], message: str
) -> None:
    """The parameter and the condition are named."""
    with pytest.raises(ScenarioError, match=message.replace("(", r"\(")):
        plan_of(load_study(written(tmp_path, vary)))
