"""Ranges that grow with a number that the user sets."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim.envs import Functional, parallel_env
from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import UsageError

# The scenario's own mass is 1.68 kg.
HEAVY: dict[str, Any] = {
    "extends": "keep_spot",
    "name": "heavier",
    "duration": 0.06,
    "ranges": [{"path": "fleets.pelicans.vehicle.mass", "low": 1.5, "high": 2.5}],
}


@cache
def many() -> VectorTask:
    return VectorTask(HEAVY, num_envs=200, autoreset_mode="SAME_STEP")


def masses(env: Any) -> Any:
    return np.array([float(env.batch.episodes.episode(row).state.drawn[0]) for row in range(env.batch.size)])


@pytest.mark.parametrize(
    # Ends at 1.68 + x (1.5 - 1.68) and 1.68 + x (2.5 - 1.68).
    ("difficulty", "low", "high"),
    [(0.0, 1.68, 1.68), (0.5, 1.59, 2.09), (1.0, 1.5, 2.5), (0.25, 1.635, 1.885)],
)
def test_both_ends_grow_from_the_scenarios_own_number(difficulty: float, low: float, high: float) -> None:
    env = many()
    env.reset(seed=1, options={"difficulty": difficulty})
    found = masses(env)
    # Of 200 draws the outermost are within 5 % of the width of the ends, but once in 10^4.
    edge = 0.05 * (high - low) + 1e-6
    assert low - 1e-6 <= found.min() < low + edge
    assert high - edge < found.max() <= high + 1e-6


def test_episodes_under_way_go_on_and_later_ones_are_others() -> None:
    env = many()
    actions = np.tile(np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32), (200, 1))
    env.reset(seed=1, options={"difficulty": 1.0})
    before = masses(env)
    env.step(actions)
    env.set_difficulty(0.0)
    env.step(actions)
    np.testing.assert_array_equal(masses(env), before)
    env.step(actions)
    np.testing.assert_allclose(masses(env), 1.68, rtol=1e-6)
    copied = pickle.loads(pickle.dumps(env))
    copied.reset(seed=9)
    np.testing.assert_allclose(masses(copied), 1.68, rtol=1e-6)
    env.reset(seed=1, options={"difficulty": 1.0})
    np.testing.assert_array_equal(masses(env), before)


def test_the_pure_functions_have_it_too() -> None:
    half = Functional.of(HEAVY).at_difficulty(0.5)
    assert float(half.play.world.ranges[0].low) == pytest.approx(1.59)
    assert float(half.play.world.ranges[0].high) == pytest.approx(2.09)


@pytest.mark.parametrize("wrong", [1.5, -0.1, float("nan"), "hard", True, None])
def test_another_number_is_refused(wrong: Any) -> None:
    with pytest.raises(UsageError, match=r"difficulty: .*; allowed: a number from 0 to 1"):
        many().set_difficulty(wrong)


@pytest.mark.long
def test_without_ranges_there_is_none() -> None:
    for env in (SingleTask("keep_spot"), parallel_env("cats_and_mouse/1A")):
        with pytest.raises(UsageError, match="it has no ranges, and so no difficulty"):
            env.reset(seed=1, options={"difficulty": 0.5})


def test_an_option_that_nobody_knows_is_named() -> None:
    with pytest.raises(UsageError, match=r"reset: options has no 'dificulty'; did you mean 'difficulty'\?"):
        SingleTask("keep_spot").reset(seed=1, options={"dificulty": 0.5})


@pytest.mark.long
def test_times_and_sizes_of_faults_grow_as_other_numbers() -> None:
    """A receiver of a task drifts from 8 s on; times are drawn in ticks of 0.02 s."""
    drift = {"sensor": "gnss", "kind": "drift", "field": "position_ned.x", "rate": 0.0, "start": 8.0}
    ranges = [("start", 2.0, 10.0), ("rate", 0.0, 3.0)]
    env = Functional.of(
        {
            "extends": "keep_spot",
            "name": "failing",
            "fleets": {"pelicans": {"faults": [drift]}},
            "ranges": [
                {"path": f"fleets.pelicans.faults.0.{name}", "low": low, "high": high} for name, low, high in ranges
            ],
        }
    )
    for difficulty, starts, rates in ((0.0, (400, 400), (0.0, 0.0)), (0.5, (250, 450), (0.0, 1.5))):
        harder = env.at_difficulty(difficulty)
        drawn = jax.jit(jax.vmap(lambda seed, env=harder: env.reset(seed)[0].state.drawn))(
            jnp.arange(100, dtype=jnp.uint32)
        )
        for found, (low, high) in zip(drawn, (starts, rates), strict=True):
            edge = 0.06 * (high - low)
            assert low <= float(found.min()) <= low + edge
            assert high - edge <= float(found.max()) <= high
