"""``qrsim.slam`` on run folders, and ``qrsim slam``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim import cli
from qrsim.errors import RunError, UsageError
from qrsim.runs.recorder import fly
from qrsim.scenarios.scenario import load_scenario

pytestmark = pytest.mark.long

# As many states as the problems of the other tests, so that they are one program.
SECONDS = 29.9


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the built-in scenario."""
    folder = tmp_path_factory.mktemp("slam") / "run"
    fly(load_scenario("range_only_slam", [f"duration={SECONDS}"]), folder, seed=5, precision="float32")
    return folder


@pytest.fixture(scope="module")
def solved(run: Path) -> Any:
    return qrsim.slam.from_run(run)


def test_a_run_is_solved_and_others_can_be_scored(run: Path, solved: Any) -> None:
    assert solved.converged
    assert solved.position_ned.shape == (300, 3)
    assert solved.trajectory_rmse_m < 1.5
    begun = solved.score(solved.flight.estimate[:, :3], solved.ranging.guess_ned)
    assert solved.landmark_rmse_m < begun["landmark_rmse_m"]
    assert solved.score(solved.flight.truth[:, :3], solved.ranging.true_ned) == {
        "trajectory_rmse_m": 0.0,
        "landmark_rmse_m": 0.0,
    }
    with pytest.raises(UsageError, match=r"expected an array of shape \(300, 3\)"):
        solved.score(solved.position_ned[:-1])


def test_the_flight_is_that_of_the_log(run: Path, solved: Any) -> None:
    """Commands and states belong together: the model leads from each state to the next but for the process noise."""
    recorded = qrsim.open_run(run)
    flight = solved.flight
    assert np.array_equal(flight.truth[:, 0], recorded["truth"]["position_ned.x"][:1496:5, 0])
    assert np.array_equal(flight.commands[:, 0, 2], recorded["commands"]["throttle"][1::5, 0][:299])
    # Fixes come at every second state and are half a metre wrong, not what the vehicle flies in a period.
    assert np.isfinite(flight.fixes[::2]).all()
    assert np.isnan(flight.fixes[1::2]).all()
    assert 0.1 < flight.fix_std < 1.5


def test_ones_own_ranges(run: Path, solved: Any) -> None:
    """The simulated ranges given as a user's own lead to the same place."""
    states, numbers = np.nonzero(np.isfinite(solved.ranging.ranges))
    rows = np.stack([solved.time[states], numbers, solved.ranging.ranges[states, numbers]], axis=1)
    again = qrsim.slam.from_run(run, ranges=rows, landmarks_guess_ned=solved.ranging.guess_ned)
    np.testing.assert_allclose(again.position_ned, solved.position_ned, atol=1e-6)
    assert np.isnan(again.landmark_rmse_m)
    with pytest.raises(UsageError, match="row 0 is"):
        qrsim.slam.from_run(run, ranges=[[0.0, 0.0, np.nan]], landmarks_guess_ned=[[0.0, 0.0, 0.0]])
    with pytest.raises(UsageError, match="give the number of landmarks"):
        qrsim.slam.from_run(run, ranges=rows)


def test_a_late_fix_belongs_to_the_state_at_which_it_was_made(tmp_path: Path) -> None:
    """A receiver without errors that reports two periods late: its fixes are the truth of their own epochs."""
    late = "fleets.pelicans.sensors.gnss={type: gnss_receiver, range_noise_std: 0.0, delay: 2}"
    errors = "world.sky.errors={type: ou, std: 0.0}"
    folder = tmp_path / "late"
    fly(load_scenario("range_only_slam", [late, errors, "duration=6"]), folder, seed=1, precision="float64")
    flight = qrsim.slam.from_run(folder, states="poses", graph="paper", iterations=1, fix_std=1.0).flight
    assert len(flight.fix_error) == 29
    # The linearised solution is good to 1e-4 m.
    assert np.abs(flight.fix_error).max() < 1e-3


def test_where_a_receiver_goes_on_without_satellites_there_is_no_fix(tmp_path: Path) -> None:
    """No satellite sends from 2 to 4 s; the receiver goes on for a second, which the log has as positions."""
    content = {
        "name": "outage",
        "extends": "range_only_slam",
        "duration": 8.0,
        "world": {
            "sky": {"orbits": {"type": "nominal_constellations"}, "errors": {"type": "error_budget"}},
            "interference": [{"kind": "outage", "systems": "GERC", "start": 2.0, "end": 4.0}],
        },
        "fleets": {"pelicans": {"sensors": {"gnss": {"type": "gnss", "preset": "f9p_single"}}}},
    }
    fly(load_scenario(content), tmp_path / "outage", seed=1, precision="float32")
    flight = qrsim.slam.from_run(tmp_path / "outage", states="poses", graph="paper", iterations=1).flight
    without = flight.time[~np.isfinite(flight.fixes[:, 0])]
    fixed = flight.time[np.isfinite(flight.fixes[:, 0])]
    # Satellites that are back are used a second later.
    assert not np.any((fixed > 2.0) & (fixed < 4.9))
    assert np.sum(fixed <= 2.0) == 10 + 1 * bool(np.any(np.isclose(fixed, 2.0)))
    assert fixed.max() > 7.0
    assert len(without)


@pytest.mark.nightly
def test_coloured_flights_with_a_receiver_of_another_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--gnss", "m8n", "--graph", "paper", "--seeds", "2", "--duration", "20", "--states", "poses", "--json"]
    assert cli.main(["slam", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["gnss"] == "m8n"
    # CEP of a kind of receiver is about 1.7 m, so that each axis has 1.4 m; white fixes are as large, and fall.
    assert 0.3 < found["fixes"]["coloured"]["rms_m"] < 4.0
    assert found["fixes"]["white"]["rms_m"] == pytest.approx(found["fixes"]["coloured"]["rms_m"], rel=0.2)
    assert found["fixes"]["white"]["allan"]["slope"] < -0.3
    assert found["fixes"]["coloured"]["allan"]["slope"] > 0.3


def test_a_run_without_commands(run: Path, tmp_path: Path) -> None:
    without = tmp_path / "without"
    shutil.copytree(run, without)
    shutil.rmtree(without / "commands")
    info = json.loads((without / "run.json").read_text("utf-8"))
    del info["parts"]["commands"]
    (without / "run.json").write_text(json.dumps(info), "utf-8")
    with pytest.raises(RunError, match=r"there are no commands in it .* slam needs those of every tick"):
        qrsim.slam.from_run(without)


def test_a_run_with_every_tenth_command(tmp_path: Path) -> None:
    folder = tmp_path / "sparse"
    scenario = load_scenario("range_only_slam", ["duration=2"])
    fly(scenario, folder, seed=5, precision="float32", every={"commands": 10})
    with pytest.raises(RunError, match=r"commands: only every 10th tick was kept; .* without --every commands="):
        qrsim.slam.from_run(folder)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"vehicle": "pelicans2"}, "no vehicle 'pelicans2'"),
        ({"state_period": 0.03}, "state_period: 0.03 s is not a multiple of the simulator's step, 0.02 s"),
        ({"state_period": 0.16}, "fixes every 0.2 s are not all at states every 0.16 s"),
        ({"range_std": 0.0}, "range_std: 0.0 is not a positive number"),
        ({"range_limit": 1.0}, "no landmark comes within 1 m of the flight"),
        ({"landmarks_ned": [[1.0, 2.0]]}, r"landmarks_ned: expected finite places \(L, 3\)"),
    ],
)
def test_wrong_options(run: Path, options: dict[str, Any], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        qrsim.slam.from_run(run, **options)


def test_the_command_solves_a_run(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert cli.main(["slam", "--run", str(run), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((out / "result.json").read_text("utf-8"))
    assert result["states"] == 300
    assert result["converged"] is True
    assert len(result["landmarks_ned"]) == 10
    assert np.shape(result["position_std_ned_m"]) == (300, 3)
    # Between what ten ranges of 5 m beside fixes could tell at best and the fixes alone.
    assert 0.01 < np.median(np.array(result["position_std_ned_m"])[:, :2]) < 1.0
    for covariance, place in zip(result["landmarks_covariance_m2"], result["landmarks_ned"], strict=True):
        assert (covariance is None) == (place[0] is None)
    assert (out / "trajectory.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--seeds", "0"], "--seeds 0: expected a positive number"),
        (["--duration", "-1"], "--duration -1: expected a positive number"),
        (["--duration", "1e300"], "--duration 1e+300: expected a positive number of seconds, at most 10 000 000"),
        (["--vehicle", "a"], "--vehicle: only with --run"),
        (["--run", "nowhere"], "no run at nowhere"),
        (["--run", "nowhere", "--sweep"], "--sweep: not with --run"),
        (["--run", "nowhere", "--seeds", "3"], "--seeds: not with --run, because its flight is recorded"),
        (["--run", "nowhere", "--noise", "white"], "--noise: not with --run"),
        (["--run", "nowhere", "--gnss", "m8n"], "--gnss: not with --run"),
        (["--run", "nowhere", "--duration", "3"], "--duration: not with --run"),
        (["--duration", "20.01"], "duration: 20.01 s is not a multiple of the simulator's step, 0.02 s"),
        (["--noise", "white", "--sweep"], "leave out --noise white"),
    ],
)
def test_wrong_words(words: list[str], reason: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["slam", *words]) == 2
    assert reason in capsys.readouterr().err


def test_a_study_that_does_not_fit_is_refused_before_it_flies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def flown(*_: Any, **__: Any) -> None:
        pytest.fail("it flew")

    monkeypatch.setattr("qrsim.studies.slam.study.fly", flown)
    monkeypatch.setattr("qrsim.studies.slam.study.available_bytes", lambda: 2**33)
    out = tmp_path / "out"
    assert cli.main(["slam", "--duration", "200000", "--seeds", "1", "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "2000001 states of 15 numbers and 10 landmarks need" in said
    assert "take a shorter --duration" in said
    # Short flights, but so many that they do not fit beside each other.
    assert cli.main(["slam", "--duration", "100", "--seeds", "10000", "--out", str(out)]) == 1
    assert "1001 states of 15 numbers and 10 landmarks" in capsys.readouterr().err
    assert not out.exists()


def test_figures_are_not_mixed_with_those_of_another_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "result.json").write_text("{}")
    assert cli.main(["slam", "--out", str(tmp_path)]) == 2
    assert "it exists and is not empty; choose another folder" in capsys.readouterr().err


def test_a_flight_that_determines_no_landmark(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One second: there is a trajectory, but no error of landmarks, and of one flight there are no intervals."""
    out = tmp_path / "out"
    words = ["slam", "--duration", "1", "--seeds", "1", "--states", "poses", "--noise", "coloured", "--out", str(out)]
    assert cli.main(words) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert "graph gnss, 1 flight of 1 s" in said.out
    assert "landmarks that the ranges determine: 0 of 10" in said.out
    assert "not converged after 100 iterations: 2 of the solutions" in said.out
    result = json.loads((out / "result.json").read_text("utf-8"))
    found = result["errors"]["coloured"]["plain"]
    assert found["landmarks_m"] == {}
    assert set(found["trajectory_m"]) == {"mean", "median"}
    (row,) = (line for line in said.out.splitlines() if line.startswith("  converged  "))
    assert row.split()[-1] == "-"
