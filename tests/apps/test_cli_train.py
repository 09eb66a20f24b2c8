"""``qrsim train``: a policy from the command line to a flight, Ctrl-C, and what is refused."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest
from tests.envs.test_wrong_rewards import THIRD, climb
from tests.interrupting import INTERRUPTIBLE

from qrsim import cli
from qrsim.errors import UsageError
from qrsim.tasks.learned import read_policy

TINY = ["--envs", "16", "--steps", "2048", "--set", "duration=2"]


@pytest.fixture(autouse=True)
def _there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("full").mkdir()
    Path("full/notes.txt").write_text("mine")
    Path("full/damaged.npz").write_bytes(b"PK")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["keep_sopt"], "no scenario is called 'keep_sopt'; did you mean 'keep_spot'?"),
        (["outdoor_patrol"], "scenario outdoor_patrol: it has no task, and nothing to be rewarded for"),
        (["keep_spot", "--envs", "0"], "--envs 0: expected 1 to 65536"),
        (["keep_spot", "--envs", "65537"], "--envs 65537: expected 1 to 65536"),
        (["keep_spot", "--steps", "0"], "--steps 0: expected 1 to 1000000000000"),
        (["keep_spot", "--minutes", "nan"], "--minutes nan: expected a positive number"),
        (["keep_spot", "--seed", "-1"], "--seed -1: expected 0 to 2**32 - 1"),
        (["keep_spot", "--out", "full"], "full exists and is never overwritten; choose another --out, or add --resume"),
        (
            ["keep_spot", "--start", "basline"],
            "--start basline: expected baseline, nothing or a policy file (.npz); did you mean 'baseline'?",
        ),
        (["keep_spot", "--start", "none.npz"], "none.npz: cannot be read: No such file"),
        (["keep_spot", "--start", "full/damaged.npz"], "is no NumPy archive of numbers, or it is damaged"),
        (["keep_spot", "--others", "none.npz"], "--others none.npz: all agents of keep_spot learn"),
        (["keep_spot", "--fleet", "pelican"], "--fleet pelican: keep_spot has agents of pelicans only"),
        (
            ["cats_and_mouse/1A", "--set", "task.mouse=agent"],
            "cats_and_mouse_1A: agents are of the fleets cats, mice; choose the one that learns by --fleet",
        ),
        (
            ["cats_and_mouse/1A", "--set", "task.mouse=agent", "--fleet", "mouse"],
            "no fleet of agents is called 'mouse'; known: cats, mice",
        ),
        (
            ["plume_mapping/3A"],
            "plume_mapping_3A: its score is of an answer that agents hand in, which a learned policy does not give",
        ),
        (
            ["search_and_rescue/2A"],
            "search_and_rescue_2A: a learned policy observes an array of numbers of one fleet; this task gives a dict",
        ),
    ],
)
def test_what_is_refused(capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert cli.main(["train", *words]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert shown.err.count("\n") == 1
    assert not Path("runs").exists()


def test_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def missing(extra: str, purpose: str, *modules: str) -> None:
        raise UsageError(f"{extra} {purpose}")

    monkeypatch.setattr("qrsim.apps.train.require", missing)
    assert cli.main(["train", "keep_spot"]) == 2
    assert capsys.readouterr().err == "error: learn qrsim train\n"


def test_tensorboard_needs_a_package(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    assert cli.main(["train", "keep_spot", "--tensorboard", "--out", "none"]) == 2
    said = "error: --tensorboard needs tensorboardX: python -m pip install 'qrsim[tensorboard]'\n"
    assert capsys.readouterr().err == said
    assert not Path("none").exists()


@pytest.mark.long
def test_a_policy_is_trained_scored_and_flown(capsys: pytest.CaptureFixture[str]) -> None:
    board = ["--tensorboard"] if find_spec("tensorboardX") else []
    assert cli.main(["train", "keep_spot", *TINY, "--out", "kept", "--json", *board]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["task"], found["seed"], found["steps"], found["policy"]) == ("keep_spot", 0, 2048, "kept/policy.npz")
    assert found["curve"] == [found["best"]]
    names = "cycle,steps,seconds,mean_return,flown_to_the_end,reward,divergence"
    assert Path("kept/curve.csv").read_text().splitlines()[0] == names

    for events in Path("kept").glob("events.*") if board else ():
        # Names of the numbers are text in TensorBoard's records.
        assert b"training/mean_return" in events.read_bytes()
    assert len(list(Path("kept").glob("events.*"))) == len(board)

    policy = ["--policy", "kept/policy.npz"]
    assert cli.main(["score", "keep_spot", *policy, "--seeds", "1", "--set", "duration=2", "--json"]) == 0
    scored = json.loads(capsys.readouterr().out)["policies"]
    assert [row["policy"] for row in scored] == ["kept/policy.npz", "baseline", "hover"]
    assert cli.main(["run", "keep_spot", *policy, "--duration", "2", "--no-figure", "--out", "run", "--json"]) == 0
    run = json.loads(capsys.readouterr().out)
    # The same episode by the same policy.
    assert run["score"]["return"] == pytest.approx(scored[0]["returns"][0], rel=1e-3)

    # Of another task, as no task's and in a world of other sensors it is refused.
    said = "policy kept/policy.npz: it was trained on keep_spot (version 0); this task is goto_waypoint (version 0)"
    assert cli.main(["score", "goto_waypoint", *policy]) == 2
    assert said in capsys.readouterr().err
    assert cli.main(["run", "outdoor_patrol", *policy, "--out", "other"]) == 2
    assert "scenario outdoor_patrol has no task" in capsys.readouterr().err
    assert cli.main(["run", "keep_spot", *policy, "--policy-ticks", "2"]) == 2
    assert "a learned policy is called once per step of its task" in capsys.readouterr().err
    # So is one of an earlier version, in which 0.18 was the throttle of hover.
    kept = read_policy("kept/policy.npz")
    earlier = replace(kept, view=replace(kept.view, centre=(0.0, 0.0, 0.18, 0.0, 1.0)))
    Path("earlier.npz").write_bytes(earlier.content())
    assert cli.main(["score", "keep_spot", "--policy", "earlier.npz"]) == 2
    assert "its throttle of hover is not 0, as the task's is; train it again" in capsys.readouterr().err


@pytest.mark.long
def test_a_reward_that_is_not_a_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = climb(tmp_path, THIRD.format('float("nan")'))
    assert cli.main(["train", str(scenario), "--envs", "2", "--out", "none"]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith(
        "error: climb: task Climb: step 3, episode 0 of seed 1000000000, 'pelicans_0': the reward is"
    )
    assert shown.count("\n") == 1


@pytest.mark.long
def test_an_interrupted_training_keeps_the_best(tmp_path: Path) -> None:
    words = ["train", "keep_spot", "--envs", "16", "--set", "duration=2", "--out", "stopped"]
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("cycle 1, 2048 steps, ")
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said.splitlines() == ["the best policy so far is in stopped/policy.npz", "interrupted"]
    assert Path("stopped/policy.npz").exists()
