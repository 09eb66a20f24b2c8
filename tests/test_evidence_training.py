"""The study of learning in its small form, the parts of its example, and what the full form must have found."""

from __future__ import annotations

import importlib
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from evidence import _learners as learners
from evidence import training as study
from evidence.__main__ import plain
from examples import keep_spot_ppo as ppo

from qrsim.envs import Functional
from qrsim.errors import RunError

pytestmark = pytest.mark.long

REPORT = Path(__file__).parents[1] / "docs" / "evidence" / "training.json"


@pytest.mark.nightly
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


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["keep_spot", "keep_spot_learner"])
def test_stable_baselines_learns_in_its_small_form(name: str) -> None:
    pytest.importorskip("stable_baselines3", reason=learners.INSTALL)
    ppo_of_sb3 = importlib.import_module("evidence._ppo")
    small = replace(study.STUDIES[name], most=1, between=1, tries=1, trials=1)
    told = ppo_of_sb3.learn(asdict(small) | {"seed": 0})
    # A rollout of PPO.
    assert told["steps"] == 2048
    (tried,) = told["curve"].values()
    assert len(told["returns"]) == len(told["alive"]) == 1
    # Who has learned for some seconds crashes: -1000, or what is worse than any flight.
    assert tried["flown_to_the_end"] == 0.0
    assert tried["mean"] <= -1000.0


def test_a_learner_that_ends_with_an_error_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learners, "environment", lambda: Path(sys.executable))
    monkeypatch.setitem(study.STUDIES, "keep_spot", replace(study.STUDIES["keep_spot"], task="nothing", learners=1))
    with pytest.raises(RunError, match="learner 0 of nothing ended with 1"):
        study.learned("keep_spot")


def test_curves_are_drawn_beside_hovering_and_the_baseline() -> None:
    curve = {"step_100000": {"mean": -900.0, "flown_to_the_end": 0.1}, "step_200000": {"mean": -4.0}}
    found = {
        "learners": 1,
        "tries": 7,
        "learner_0": {"curve": curve},
        "hover": {"mean": -80.0},
        "baseline": {"mean": -9.0},
    }
    axes = learners.draw("keep_spot", found).axes[0]
    of_learner, hover, baseline = axes.lines
    np.testing.assert_allclose(of_learner.get_xydata(), [[0.1, -900.0], [0.2, -4.0]])
    assert (hover.get_ydata()[0], baseline.get_ydata()[0]) == (-80.0, -9.0)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["PPO, seed 0", "hovering", "baseline"]
    assert axes.get_ylabel() == "mean return of 7 new episodes"


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


def test_the_form_for_learners_is_learned_at_the_first_try(full: dict[str, Any]) -> None:
    learned = full["keep_spot_learner"]
    learners = [learned[f"learner_{seed}"] for seed in range(5)]
    assert [each["steps"] for each in learners] == [51200] * 5
    assert all(each["flown_to_the_end"] == 1.0 for each in learners)
    assert sum(each["mean"] > learned["baseline"]["mean"] for each in learners) == 2


def test_stable_baselines_has_learned_to_keep_a_spot_without_a_crash(full: dict[str, Any]) -> None:
    """With its defaults, on the registered environment, five seeds of five; hovering leaves the area in most cases."""
    learned = full["keep_spot"]
    assert (learned["learners"], learned["most"], learned["tries"], learned["trials"]) == (5, 1_000_000, 100, 200)
    assert learned["scale"] == 1.0
    assert learned["hover"]["flown_to_the_end"] < 0.5
    for seed in range(5):
        each = learned[f"learner_{seed}"]
        # All 100 episodes of the last try are flown to the end, and so are 200 others.
        assert list(each["curve"].values())[-1]["flown_to_the_end"] == each["flown_to_the_end"] == 1.0
        assert each["steps"] <= 301_056
        assert each["low"] > -100.0 > learned["hover"]["high"]
