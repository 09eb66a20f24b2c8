"""When the next episode of a vector environment begins, and what Gymnasium's wrappers make of it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import FlattenObservation, NormalizeObservation, RecordEpisodeStatistics

from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import UsageError

# Three steps of 0.02 s an episode.
SHORT: dict[str, Any] = {"extends": "keep_spot", "name": "three_steps", "duration": 0.06}
HOVER = np.tile(np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32), (2, 1))


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


@pytest.mark.long
def test_the_next_step_begins_the_next_episode() -> None:
    """As Gymnasium's own vector of single environments does it, number for number."""
    ours = VectorTask(SHORT, num_envs=2)
    assert ours.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    theirs = gymnasium.vector.SyncVectorEnv([lambda: SingleTask(SHORT), lambda: SingleTask(SHORT)])
    np.testing.assert_allclose(ours.reset(seed=5)[0], theirs.reset(seed=5)[0], rtol=1e-5, atol=1e-5)
    ends = []
    for step in range(9):
        # In the step that begins an episode nobody looks at the action.
        actions = np.full_like(HOVER, np.nan) if step in (3, 7) else HOVER
        found = ours.step(actions)
        for got, expected in zip(found[:4], theirs.step(actions)[:4], strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)
        ends.append(bool(found[3].all()))
        if step in (3, 7):
            assert found[1].tolist() == [0.0, 0.0]
    assert ends == [False, False, True, False, False, False, True, False, False]


def test_nothing_begins_by_itself_where_that_is_disabled() -> None:
    env: Any = gymnasium.make_vec("qrsim/keep_spot-v0", num_envs=2, scenario=SHORT, autoreset_mode="DISABLED")
    first, _ = env.reset(seed=5)
    for _ in range(3):
        seen, *_, truncated, infos = env.step(HOVER)
    assert truncated.tolist() == [True, True]
    assert "final_obs" not in infos
    with pytest.raises(UsageError, match=r"the episode of environment 0 has ended: call reset\(\) with a reset_mask"):
        env.step(HOVER)
    fresh, _ = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(fresh[1], seen[1])
    assert not np.array_equal(fresh[0], seen[0])
    with pytest.raises(UsageError, match="environment 1 has ended"):
        env.step(HOVER)
    again, _ = env.reset(seed=[5, 6], options={"reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(again[1], first[1])
    assert not env.step(HOVER)[3].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"autoreset_mode": "NEXTSTEP"}, "autoreset_mode: there is no 'NEXTSTEP'; did you mean 'NEXT_STEP'"),
        ({"render_mode": "human"}, "render_mode: 'human'; allowed: None, 'rgb_array'"),
        ({"num_envs": 0}, "num_envs: 0 is not a positive whole number"),
    ],
)
def test_what_cannot_be_had_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        VectorTask(SHORT, **options)


def test_masks_are_checked() -> None:
    env = VectorTask(SHORT, num_envs=2)
    with pytest.raises(UsageError, match="reset_mask: nothing has begun yet"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=1)
    with pytest.raises(UsageError, match=r"reset_mask: expected shape \(2,\) of bool, found \(3,\) of bool"):
        env.reset(options={"reset_mask": np.ones(3, bool)})
    with pytest.raises(UsageError, match=r"reset_mask: expected shape \(2,\) of bool, found \(2,\) of int64"):
        env.reset(options={"reset_mask": np.array([0, 1])})
    with pytest.raises(UsageError, match="seed: expected one for each of 2 environments, found 1"):
        env.reset(seed=[1])


def test_wrappers_of_gymnasium_take_it() -> None:
    """They refuse SAME_STEP, which was all there was."""
    wrapped = RecordEpisodeStatistics(NormalizeObservation(FlattenObservation(VectorTask(SHORT, num_envs=2))))
    wrapped.reset(seed=1)
    lengths = []
    for _ in range(8):
        seen, *_, infos = wrapped.step(HOVER)
        assert np.abs(seen).max() < 10.0
        lengths += infos["episode"]["l"].tolist() if "episode" in infos else []
    assert lengths == [3, 3, 3, 3]


@pytest.mark.long
def test_answers_of_some_environments() -> None:
    """Those without an answer are scored as if they had handed in zeros."""
    many = VectorTask("plume_mapping/3A", num_envs=2, overrides=["duration=2.0"])
    still = np.zeros((2, 3), np.float32)
    with pytest.raises(UsageError, match="call reset"):
        many.hand_in(np.zeros((2, 100)))
    many.reset(seed=3)
    with pytest.raises(UsageError, match=r"samples: expected those of 2 environments, found shape \(100,\)"):
        many.hand_in(np.zeros(100))
    many.step(still)
    nothing = many.step(still)[1]
    many.step(still)
    many.reset(seed=3)
    many.hand_in(np.full((2, 100), 0.5), np.array([False, True]))
    many.step(still)
    handed = many.step(still)[1]
    assert handed[0] == nothing[0] < 0.0
    # 100 squared errors of nearly 0.5 where nothing is.
    assert -25.0 < handed[1] < -5.0 < nothing[1]
