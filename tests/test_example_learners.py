"""The recipes of examples/learners, in a short form."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.links.mavlink.driven_clients import Field

LEARNERS = Path(__file__).parents[1] / "examples" / "learners"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("recipe", "package", "words", "said"),
    [
        ("with_sb3.py", "stable_baselines3", ["--steps", "2048", "--episodes", "1"], '{"flown_to_the_end": '),
        ("with_torch.py", "torch", ["2048"], "mean reward of a decision: -"),
        # Continuous integration does not install these two, which are large.
        ("with_torchrl.py", "torchrl", ["2048"], "mean reward of a decision: -"),
        ("with_rllib.py", "ray.rllib", ["--steps", "1"], "mean return of an episode -"),
    ],
)
def test_a_recipe_learns_for_a_moment(recipe: str, package: str, words: list[str], said: str) -> None:
    pytest.importorskip(package, reason=f"needs {package}")
    run = subprocess.run(
        [sys.executable, str(LEARNERS / recipe), *words], capture_output=True, text=True, check=False, timeout=300
    )
    assert run.returncode == 0, run.stderr
    assert said in run.stdout


@pytest.mark.nightly
def test_a_learned_policy_keeps_a_spot_by_velocities_through_mavlink(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink", reason="needs pymavlink")
    pytest.importorskip("optax", reason="needs optax")
    policy = tmp_path / "learned" / "policy.npz"
    words = ["train", "keep_spot", "--steps", "250000", "--envs", "256", "--out", str(policy.parent)]
    words += ["--set", "task.actions=velocity", "--set", "fleets.pelicans.controller.type=velocity"]
    subprocess.run([sys.executable, "-m", "qrsim.cli", *words], check=True, timeout=900, stdout=subprocess.DEVNULL)
    field = Field(factor=2.0)
    try:
        example = [sys.executable, str(LEARNERS / "offboard.py"), str(policy), f"udpin:127.0.0.1:{field.port}"]
        run = subprocess.run(example, capture_output=True, text=True, check=False, timeout=600)
        assert run.returncode == 0, run.stdout + run.stderr
    finally:
        field.process.kill()
        field.process.wait()
    found = json.loads(run.stdout)
    # It starts 2 m away, in a wind of 6 m/s; the error is by the vehicle's own estimate.
    assert found["decisions"] > 200
    assert found["mean_distance_m"] < 1.5


@pytest.mark.nightly
def test_a_policy_of_stable_baselines_scores_in_the_published_task_as_for_its_learner(tmp_path: Path) -> None:
    """The view and the pace of ``sb3_policy.py`` are those of the environment that the policy was trained in."""
    pytest.importorskip("stable_baselines3", reason="needs stable_baselines3")
    recipe = [str(LEARNERS / "with_sb3.py"), "--steps", "2048", "--episodes", "2", "--out", "keep_spot_sb3.zip"]
    policy = f"{LEARNERS / 'sb3_policy.py'}:Learned"
    words = ["-m", "qrsim.cli", "score", "keep_spot", "--policy", policy, "--first-seed", "1000000", "--seeds", "2"]
    said = [
        subprocess.run([sys.executable, *each], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
        for each in (recipe, [*words, "--set", "task.period=0.1", "--json"])
    ]
    assert [each.returncode for each in said] == [0, 0], said[-1].stderr
    learned, scored = (json.loads(each.stdout) for each in said)
    assert scored["policies"][0]["mean"] == pytest.approx(learned["mean_return"], rel=1e-4)
