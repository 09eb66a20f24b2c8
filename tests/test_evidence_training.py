"""The study of learning in its small form, the parts of its example, and what the full form must have found."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evidence import training as study
from evidence.__main__ import plain
from examples import keep_spot_ppo as ppo

from qrsim.envs import Functional
from qrsim.errors import UsageError

pytestmark = pytest.mark.long

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "training.json"


def test_the_small_form_learns_from_its_episodes() -> None:
    # The example is written as users write JAX, who do not forbid what the package forbids itself.
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        found = plain(study.run(full=False))
    learner = found["learner_0"]
    assert list(learner["curve"]) == ["iteration_1", "iteration_2"]
    assert all(np.isfinite(value) and value < 0.0 for value in learner["curve"].values())
    assert learner["mean"] != found["hover"]["mean"]
    # In a wind of 3 m/s who only hovers is carried away by metres, most of them out of the area.
    assert found["hover"]["mean"] < -100.0


def test_stable_baselines_learns_in_its_small_form() -> None:
    pytest.importorskip("stable_baselines3", reason=study.INSTALL)
    found = plain(study.sb3(*study.SB3_SMALL))
    assert found["steps"] == 2048
    assert found["mean"] < 0.0
    assert found["flown_to_the_end"] < 1.0


def test_without_stable_baselines_the_full_form_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(UsageError, match=r"part 'sb3' needs: pip install torch==2.13.0 stable-baselines3==2.9.2"):
        study.run(full=True)


def test_advantages_are_those_of_the_definition() -> None:
    """Against the sum of discounted differences, for an episode that is cut off and one that is lost."""
    numbers = np.random.default_rng(0)
    steps, reward, value = 5, -numbers.uniform(0.0, 300.0, (5, 2)), numbers.normal(size=(5, 2))
    terminated = np.zeros((5, 2), bool)
    terminated[4, 1] = True
    nothing = jnp.zeros((5, 2))
    made = ppo.Steps(nothing, nothing, nothing, *map(jnp.asarray, (value, reward, ~terminated, terminated)))
    found = np.asarray(ppo.advantages(made))
    after = np.concatenate([value[1:], value[-1:]])
    differences = reward / 100.0 + np.where(terminated, 0.0, ppo.DISCOUNT) * after - value
    for step in range(steps):
        weights = (ppo.DISCOUNT * ppo.TRACE) ** np.arange(steps - step)
        expected = np.sum(weights[:, None] * differences[step:], axis=0)
        np.testing.assert_allclose(found[step], expected, rtol=1e-5)


def test_the_policy_looks_along_its_heading() -> None:
    """Who has its goal and its motion to the east and heads east has them ahead."""
    seen = jnp.zeros(12).at[4].set(1.0).at[8].set(jnp.pi / 2).at[10].set(3.0)
    found = np.asarray(ppo.features_of(seen))
    np.testing.assert_allclose(found, [1.5, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0], atol=1e-6)


@pytest.fixture(scope="module")
def full() -> dict[str, Any]:
    """The recorded results."""
    results: dict[str, Any] = json.loads(REPORT.read_text(encoding="utf-8"))["results"]
    return results


def test_the_example_pays_nothing_beforehand() -> None:
    """With 100 steps to an episode its learners would end far away, where most is given back."""
    assert float(Functional.of("keep_spot", ppo.OVERRIDES).play.task.stake) == 0.0


def test_every_learner_rises_above_hovering_and_the_controller(full: dict[str, Any]) -> None:
    assert full["learners"] == study.FULL[0] == 3
    for seed in range(full["learners"]):
        learner = full[f"learner_{seed}"]
        assert len(learner["curve"]) == full["iterations"] == ppo.ITERATIONS
        assert learner["low"] > full["controller"]["high"] > full["controller"]["low"] > full["hover"]["high"]
        assert learner["flown_to_the_end"] == 1.0


def test_stable_baselines_has_learned_to_fly_without_a_crash(full: dict[str, Any]) -> None:
    """With its defaults, on the registered environment; hovering leaves the area in most of the same episodes."""
    learned = full["sb3"]
    assert learned["trials"] == study.SB3_FULL[3] == 1000
    assert learned["flown_to_the_end"] == 1.0 > 0.5 > learned["hover"]["flown_to_the_end"]
    assert learned["low"] > -25.0 > learned["hover"]["high"]
