"""The score of a run: that of the same episode in `qrsim score`, whoever flies, however it ends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qrsim
from qrsim import cli
from qrsim.envs.batch import Batch
from qrsim.envs.scoring import BASELINE, HOVER, maker, play_policy
from qrsim.runs.recorder import fly
from qrsim.runs.summary import score_text
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.tasks.play import Play
from qrsim.tasks.referee import Referee

CLIMB = Path(__file__).parents[2] / "examples" / "outside"


def flown(folder: Path, scenario: str, *more: str) -> dict[str, Any]:
    """Fly a scenario as a user does, and return the score in its run folder."""
    assert cli.main(["run", scenario, "--out", str(folder / "run"), "--no-figure", *more]) == 0
    return dict(qrsim.open_run(folder / "run").info.score or {})


def scored(scenario: str, policy: str, seed: int, *overrides: str) -> float:
    batch = Batch(scenario, 1, overrides)
    return float(play_policy(batch, policy, maker(policy, batch.functional.play), np.array([seed])).returns[0])


@pytest.mark.long
@pytest.mark.parametrize(
    ("scenario", "seconds"),
    [
        # An action at every tick; and several agents, one for several ticks, of a world that is drawn.
        ("keep_spot", 1.5),
        pytest.param("cats_and_mouse/1C", 4.0, marks=pytest.mark.long),
        pytest.param("plume_mapping/3C", 3.0, marks=pytest.mark.long),
    ],
)
def test_it_is_that_of_qrsim_score(tmp_path: Path, scenario: str, seconds: float) -> None:
    found = flown(tmp_path, scenario, "--policy", "baseline", "--seed", "5", "--duration", str(seconds))
    assert found["return"] == pytest.approx(scored(scenario, BASELINE, 5, f"duration={seconds}"), rel=1e-4)
    assert found["outcome"] == "flown_to_the_end"
    assert found["steps"] == found["of_steps"]
    assert found["handed_in"] is (True if scenario.startswith("plume") else None)


@pytest.mark.long
def test_the_scenarios_own_controllers_are_judged_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Cats that nobody commands stay, some 20 m and more from a mouse that flees; of 3 s only the last counts."""
    found = flown(tmp_path, "cats_and_mouse/1A", "--seed", "2", "--duration", "3", "--json")
    last = qrsim.open_run(tmp_path / "run")["truth"]
    place = np.stack([np.asarray(last[f"position_ned.{axis}"])[-1] for axis in "xyz"], axis=-1)
    away = np.linalg.norm(place[:3] - place[3], axis=1)
    # (T3) with the collision distance of 2 m.
    assert found["return"] == pytest.approx(-np.sum(np.maximum(away - 4.0, 0.0) ** 2), rel=1e-4)
    assert found["agents"] == dict.fromkeys(("cat_0", "cat_1", "cat_2"), found["return"])
    assert json.loads(capsys.readouterr().out)["score"] == found
    assert json.loads((tmp_path / "run" / "run.json").read_text())["score"] == found


def test_a_crash_ends_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A gale carries the vehicle out of the area; the published return of a crash is -1000."""
    gale = (
        "task.crash=published",
        "world.wind.type=log_shear",
        "world.wind.speed_20ft=12",
        "world.wind.wind_from_deg=90",
    )
    found = flown(tmp_path, "keep_spot", "--duration", "6", *(word for each in gale for word in ("--set", each)))
    assert (found["outcome"], found["return"]) == ("crashed", pytest.approx(-1000.0, rel=1e-6))
    stopped = next(event for event in qrsim.open_run(tmp_path / "run").events if event.kind == "out_of_area")
    # Steps are ticks of 0.02 s.
    assert found["steps"] == round(stopped.time / 0.02)
    assert f"(a vehicle stopped in step {found['steps']} of 300, which ended the episode)" in capsys.readouterr().out


@pytest.mark.long
def test_nothing_is_handed_in(tmp_path: Path) -> None:
    """Steady plumes are the same for who hovers and who does something else, and zeros are what both hand in."""
    found = flown(tmp_path, "plume_mapping/3A", "--seed", "3", "--duration", "2")
    assert found["return"] == pytest.approx(scored("plume_mapping/3A", HOVER, 3, "duration=2"), rel=1e-4)
    assert found["handed_in"] is False


def test_an_interrupted_flight_is_unfinished(tmp_path: Path) -> None:
    def stop(simulated_s: float, wall_s: float) -> None:
        if simulated_s > 1.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fly(load_scenario("keep_spot"), tmp_path / "run", seed=1, precision="float32", progress=stop)
    found = qrsim.open_run(tmp_path / "run").info.score
    assert found is not None
    # After chunks of 50 ticks, the first of which is a single one.
    assert (found["outcome"], found["steps"], found["of_steps"]) == ("unfinished", 101, 3000)


@pytest.mark.long
def test_a_reward_that_is_not_finite_loses_no_flight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (CLIMB / "climb.py").read_text(encoding="utf-8")
    paid = "-jnp.abs(self.height + position.z) * self.period"
    assert paid in text
    (tmp_path / "climb.py").write_text(text.replace(paid, f"jnp.where(step == 3, jnp.inf, {paid})"), encoding="utf-8")
    (tmp_path / "climb.yaml").write_text((CLIMB / "climb.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    found = flown(tmp_path, str(tmp_path / "climb.yaml"), "--duration", "1")
    assert (found["outcome"], found["return"], found["steps"]) == ("not_finite", None, 3)
    assert "score:      none, not finite, after step 3 of 10\n" in capsys.readouterr().out


def test_it_does_not_matter_in_which_pieces_a_flight_comes() -> None:
    """A step is two ticks; pieces end within steps, and hold one tick, a whole chunk, and more than one."""
    scenario = load_scenario("keep_spot", ["duration=4", "task.period=0.04"])
    found = []
    for pieces in ((50, 50, 50, 50), (1, 50, 7, 50, 92), (200,), (199, 1)):
        simulation = Simulation(scenario.world(), seed=2)
        simulation.reset()
        play = Play(scenario.task(), simulation.world, scenario.steps)
        referee = Referee(play, 2, 0, simulation.history)
        for ticks in pieces:
            referee.watch(simulation.record(ticks))
        found.append(referee.finish())
    assert {(score.steps, score.of, score.outcome) for score in found} == {(100, 100, "flown_to_the_end")}
    assert [score.mean for score in found] == pytest.approx([found[0].mean] * 4, rel=1e-6)
    assert -5.0 < (found[0].mean or 0.0) < -0.01


def test_without_a_task_there_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert flown(tmp_path, "hover_ideal", "--duration", "0.2") == {}
    assert "score" not in capsys.readouterr().out


def test_it_is_told_in_words() -> None:
    score = {
        "return": -0.5,
        "agents": {"a": -0.25, "b": -0.75},
        "outcome": "flown_to_the_end",
        "steps": 9,
        "of_steps": 9,
    }
    assert score_text(score) == "-0.5, mean of a -0.25, b -0.75 (flown to the end)"
    same = score | {"agents": {"a": -0.5, "b": -0.5}, "handed_in": False}
    assert score_text(same) == (
        "-0.5, the same for all 2 agents (flown to the end; nothing was handed in, which counts as zeros)"
    )
    many = score | {"agents": {f"v{i}": -1.0 - i for i in range(9)}, "return": -5.0, "outcome": "unfinished"}
    assert score_text(many) == "-5, mean of 9 agents, -9 to -1 (unfinished, step 9 of 9)"
