"""Rewards and scores that are no finite numbers: refused in one line, in every form of an environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim import cli
from qrsim.envs import parallel_env
from qrsim.envs.batch import Batch
from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import RunError

CLIMB = Path(__file__).parents[2] / "examples" / "outside"
PAID = "return memory, -jnp.abs(self.height + position.z) * self.period"


def climb(folder: Path, paid: str) -> Path:
    """Write the task of climbing with another reward, and return its scenario, of five steps."""
    text = (CLIMB / "climb.py").read_text(encoding="utf-8")
    assert PAID in text
    (folder / "climb.py").write_text(text.replace(PAID, f"return memory, {paid}"), encoding="utf-8")
    scenario = folder / "climb.yaml"
    scenario.write_text((CLIMB / "climb.yaml").read_text(encoding="utf-8").replace("10.0", "0.5", 1), encoding="utf-8")
    return scenario


THIRD = "jnp.where(step == 3, {}, 0.0) * jnp.ones_like(position.z)"


@pytest.mark.long
@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_qrsim_score_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str], value: str) -> None:
    scenario = climb(tmp_path, THIRD.format(f'float("{value}")'))
    for more in ([], ["--json"]):
        assert cli.main(["score", str(scenario), "--seeds", "2", "--first-seed", "4", *more]) == 1
        shown = capsys.readouterr()
        assert shown.out == ""
        assert shown.err == (
            f"error: climb: task Climb: step 3, episode 0 of seed 4, 'pelicans_0': the reward is {value}\n"
        )


@pytest.mark.long
def test_every_environment_does(tmp_path: Path) -> None:
    scenario = climb(tmp_path, THIRD.format('float("nan")'))
    single, vector, parallel = SingleTask(scenario), VectorTask(scenario, 2), parallel_env(scenario)
    nothing = np.zeros(1, np.float32)
    steps: list[tuple[Any, Any]] = [
        (single, lambda: single.step(nothing)),
        (vector, lambda: vector.step(nothing[None].repeat(2, 0))),
        (parallel, lambda: parallel.step({"pelicans_0": nothing})),
    ]
    for env, step in steps:
        env.reset(seed=7)
        step()
        step()
        with pytest.raises(RunError, match=r"step 3, episode 0 of seed 7, 'pelicans_0': the reward is nan$"):
            step()
        env.reset()
        step()
        step()
        with pytest.raises(RunError, match=r"step 3, episode 1 of seed 7, 'pelicans_0': the reward is nan$"):
            step()


@pytest.mark.long
def test_what_comes_after_an_episode_has_no_meaning(tmp_path: Path) -> None:
    """The sixth step of five is not looked at, where others go on or the next episode is to begin."""
    scenario = climb(tmp_path, 'jnp.where(step > steps, float("nan"), 0.0) * jnp.ones_like(position.z)')
    vector = VectorTask(scenario, 2)
    vector.reset(seed=1)
    for _ in range(12):
        _, reward, *_ = vector.step(np.zeros((2, 1), np.float32))
        np.testing.assert_array_equal(reward, 0.0)


@pytest.mark.long
def test_a_score_of_what_is_handed_in() -> None:
    """The square of 1e30 is more than single precision holds."""
    # As long as the episodes of test_environments.py: another number of steps is another program.
    batch = Batch("plume_mapping/3A", 1, ["duration=2"])
    batch.reset([5])
    batch.step(np.zeros((1, 1, 3)))
    with pytest.raises(RunError, match="step 1, episode 0 of seed 5, 'helicopters_0': the score of what was handed in"):
        batch.score(0, np.full((1, *batch.answer_shape), 1e30))
