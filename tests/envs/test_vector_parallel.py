"""Many parallel environments side by side, against one of them after the other."""

from __future__ import annotations

import pickle
from functools import cache
from typing import Any

import numpy as np
import pytest

from qrsim.envs import parallel_env, vector_parallel_env
from qrsim.envs.vector_parallel import VectorParallelTask
from qrsim.errors import UsageError

# Three steps of a second an episode.
SHORT: dict[str, Any] = {"extends": "cats_and_mouse/1B", "name": "three_seconds", "duration": 3.0}
TALKING: dict[str, Any] = {**SHORT, "name": "talking", "world": {"radio": {"size": 2}}}


@cache
def two() -> VectorParallelTask:
    return vector_parallel_env(SHORT, num_envs=2, autoreset_mode="SAME_STEP")


def drawn(rng: np.random.Generator) -> dict[str, Any]:
    return {agent: rng.uniform(-1.0, 1.0, (2, 2)) for agent in two().possible_agents}


@pytest.mark.long
def test_each_environment_is_the_parallel_environment_of_its_seed() -> None:
    many, rng = two(), np.random.default_rng(0)
    single = [parallel_env(SHORT), parallel_env(SHORT)]
    seen, truth = many.reset(seed=5)
    begun = [one.reset(seed=5 + i) for i, one in enumerate(single)]
    agents = many.agents
    assert agents == ["cat_0", "cat_1", "cat_2"]
    for agent in agents:
        for i, (own, really) in enumerate(begun):
            np.testing.assert_allclose(seen[agent][i], own[agent], rtol=1e-5, atol=1e-5)
            assert set(truth[agent]) == set(really[agent])
    for step in range(3):
        actions = drawn(rng)
        seen, rewards, terminated, truncated, infos = many.step(actions)
        for i, one in enumerate(single):
            alone = one.step({agent: actions[agent][i] for agent in agents})
            for agent in agents:
                last = infos[agent]["final_obs"] if step == 2 else seen[agent]
                np.testing.assert_allclose(last[i], alone[0][agent], rtol=1e-4, atol=1e-4)
                assert rewards[agent][i] == pytest.approx(alone[1][agent], rel=1e-4)
                assert (terminated[agent][i], truncated[agent][i]) == (alone[2][agent], alone[3][agent])
    # What is seen after the end is of the next episode of the series.
    for agent in agents:
        assert infos[agent]["_final_obs"].tolist() == [True, True]
        assert many.observation_space(agent).contains(seen[agent][0])
    for i, one in enumerate(single):
        again, _ = one.reset()
        np.testing.assert_allclose(seen[agents[0]][i], again[agents[0]], rtol=1e-5, atol=1e-5)


def test_the_state_is_that_of_each() -> None:
    many, one = two(), parallel_env(SHORT)
    many.reset(seed=5)
    one.reset(seed=6)
    # Three cats and a mouse of 13 numbers each, and how much of the episode is over.
    assert many.state().shape == (2, 4 * 13 + 1)
    np.testing.assert_allclose(many.state()[1], one.state(), rtol=1e-5, atol=1e-5)


@pytest.mark.long
def test_agents_talk_in_each_environment() -> None:
    many = vector_parallel_env(TALKING, num_envs=2)
    many.reset(seed=1)
    agents = many.agents
    words = {agent: np.array([[10.0 * i + 1.0, 2.0], [10.0 * i + 3.0, 4.0]]) for i, agent in enumerate(agents)}
    still = {agent: {"act": np.zeros((2, 2)), "say": words[agent]} for agent in agents}
    many.step(still)
    seen, *_ = many.step(still)
    for row, first in ((0, 11.0), (1, 13.0)):
        heard = seen[agents[0]]
        from_second = heard["heard"][row][heard["sender"][row] == 1]
        assert first in from_second[:, 0]


def test_copies_go_on_alike() -> None:
    many = two()
    many.reset(seed=2)
    copied = pickle.loads(pickle.dumps(many))
    actions = drawn(np.random.default_rng(1))
    for found, expected in zip(copied.step(actions)[:2], many.step(actions)[:2], strict=True):
        for agent, value in expected.items():
            np.testing.assert_array_equal(found[agent], value)


@pytest.mark.parametrize(
    ("actions", "why"),
    [
        ([0.0, 0.0], "actions: expected a dict with one for each agent, found list"),
        ({"cat_0": np.zeros((2, 2))}, "actions: there is none for cat_1, cat_2"),
        ({"cats_1": np.zeros((2, 2))}, "actions: no agent is called 'cats_1'; did you mean 'cat_1'?"),
    ],
)
def test_wrong_actions(actions: Any, why: str) -> None:
    two().reset(seed=1)
    with pytest.raises(UsageError) as raised:
        two().step(actions)
    assert str(raised.value) == why


def test_an_action_of_another_shape_names_the_agent() -> None:
    two().reset(seed=1)
    agent, *others = two().possible_agents
    with pytest.raises(UsageError, match=rf"actions of {agent}: expected shape \(2, 2\) .*found \(2, 3\)"):
        two().step({agent: np.zeros((2, 3))} | {other: np.zeros((2, 2)) for other in others})


def test_without_reset_nothing_steps() -> None:
    fresh = vector_parallel_env(SHORT, num_envs=2, autoreset_mode="DISABLED")
    with pytest.raises(UsageError, match=r"nothing has begun: call reset\(\)"):
        fresh.state()
    fresh.reset(seed=1)
    still = {agent: np.zeros((2, 2)) for agent in fresh.agents}
    for _ in range(3):
        fresh.step(still)
    with pytest.raises(UsageError, match="the episode of environment 0 has ended"):
        fresh.step(still)


def test_answers_are_handed_in_by_agent() -> None:
    plume = vector_parallel_env("plume_mapping/3D", num_envs=2, overrides=["duration=2"])
    plume.reset(seed=1)
    agent = plume.agents[0]
    assert plume.answer_space is not None
    shape = plume.answer_space.shape
    plume.hand_in({agent: np.zeros((2, *shape))}, mask=np.array([True, False]))
    with pytest.raises(UsageError, match=f"samples of {agent}: expected those of 2 environments, found shape"):
        plume.hand_in({agent: np.zeros((3, *shape))})
    with pytest.raises(UsageError, match="samples: no agent is called 'nobody'"):
        plume.hand_in({"nobody": np.zeros((2, *shape))})
