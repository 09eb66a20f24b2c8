"""A task in the form that learners like, as an environment of Gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import qrsim.envs
from qrsim.envs.learner import LearnerTask
from qrsim.errors import UsageError

SHORT = ["duration=2"]


@pytest.fixture(scope="module")
def env() -> gymnasium.Env[Any, Any]:
    return gymnasium.make(qrsim.envs.learner_id("keep_spot"), overrides=SHORT)


def test_older_versions_of_gymnasium_read_the_render_modes_of_the_class(env: gymnasium.Env[Any, Any]) -> None:
    assert LearnerTask.metadata == {"render_modes": ["rgb_array"]}
    # Decisions are made every 0.1 s.
    assert env.metadata == {"render_modes": ["rgb_array"], "render_fps": 10.0}


def test_an_episode_by_hand(env: gymnasium.Env[Any, Any]) -> None:
    seen, _ = env.reset(seed=3)
    # Velocity, roll and pitch, offset to the goal; then the last of four actions.
    assert seen.shape == (12,)
    assert seen[-4:].tolist() == [0.0] * 4
    seen, reward, terminated, truncated, info = env.step(np.array([0.5, 0.0, 0.25, 0.0]))
    assert seen[-4:].tolist() == [0.5, 0.0, 0.25, 0.0]
    assert (terminated, truncated) == (False, False)
    # Within centimetres of the start: the effort of 0.5^2 + 0.25^2 is most of it, 0.1 * 0.1 * 0.05 * 0.3125.
    assert -0.01 < float(reward) < 0.0
    assert info["task_reward"] < 0.0
    count = 1
    while not truncated:
        _, _, terminated, truncated, _ = env.step(np.zeros(4))
        assert not terminated
        count += 1
    # Decisions of 0.1 s.
    assert count == 20
    with pytest.raises(UsageError, match=r"the episode has ended, or has not begun: call reset\(\)"):
        env.step(np.zeros(4))


def test_the_same_seed_gives_the_same_episode(env: gymnasium.Env[Any, Any]) -> None:
    both: list[Any] = []
    for _ in range(2):
        env.reset(seed=9)
        both.append(env.step(np.full(4, 0.1))[:2])
    np.testing.assert_array_equal(both[0][0], both[1][0])
    assert both[0][1] == both[1][1]


@pytest.mark.filterwarnings("ignore:.*")
def test_gymnasium_has_no_complaint(env: gymnasium.Env[Any, Any]) -> None:
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("action", [np.zeros(3), np.full(4, np.nan), "left", None, np.zeros((1, 4))])
def test_wrong_actions_are_refused(env: gymnasium.Env[Any, Any], action: object) -> None:
    env.reset(seed=1)
    with pytest.raises(UsageError, match="action: expected 4 finite numbers from -1 to 1, found "):
        env.step(action)


def test_wrong_arguments_are_refused() -> None:
    with pytest.raises(UsageError, match=r"discount: 1\.0; allowed: 0 to less than 1"):
        LearnerTask("keep_spot", discount=1.0)
    with pytest.raises(UsageError, match="did you mean 'discount'"):
        LearnerTask("keep_spot", discuont=0.9)  # type: ignore[call-arg]
