"""Environments with a radio: what agents say and hear, what is refused, and the checks of the libraries."""

from __future__ import annotations

from functools import cache
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test
from tests.by_numpy import uncompiled

from qrsim.envs import Functional, parallel_env
from qrsim.envs.parallel import ParallelTask
from qrsim.envs.single import SingleTask
from qrsim.errors import UsageError
from qrsim.models.radio.contracts import Outbox
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import Play
from qrsim.tasks.speaking import at_first_period
from qrsim.world.state import Saying

# Everybody within 300 m hears everything; periods of 0.2 s, and steps of 1 s.
RADIO: dict[str, Any] = {
    "preset": "sphere",
    "size": 2,
    "inbox": {"size": 3, "candidates": 3},
    "path_loss": {"waves": 1},
}
CHASE = {"name": "talk", "extends": "cats_and_mouse/1A", "duration": 6.0, "world": {"radio": RADIO}}
# With a vehicle that is no agent, and does nothing but send its beacon.
SPOT = {
    "name": "listen",
    "extends": "keep_spot",
    "duration": 0.6,
    "task": {"period": 0.1},
    "world": {"radio": RADIO},
    "fleets": {
        "others": {
            "controller": {"type": "waypoint", "feed": "truth"},
            "vehicles": [{"position_ned": [6.0, 0.0, -10.0]}],
        }
    },
}
STILL = np.zeros(2, np.float32)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


@cache
def chase() -> ParallelTask:
    return parallel_env(CHASE)


def saying(env: ParallelTask, **words: Any) -> dict[str, Any]:
    """Return actions that stand still; who is not named says nothing."""
    return {agent: {"act": STILL} | ({"say": words[agent]} if agent in words else {}) for agent in env.agents}


@pytest.mark.long
def test_what_one_agent_says_the_others_hear_one_step_later() -> None:
    env = chase()
    seen, _ = env.reset(seed=1)
    for agent in env.agents:
        assert env.observation_space(agent).contains(seen[agent])
        assert seen[agent]["sender"].tolist() == [-1, -1, -1]
        assert not seen[agent]["mask"].any()
    seen, *_ = env.step(saying(env, cat_1=[1.5, -2.0], cat_2=np.array([0.0, 7.0])))
    assert env.observation_space("cat_0").contains(seen["cat_0"])
    heard = {int(who): row for row, who in enumerate(seen["cat_0"]["sender"])}
    assert sorted(heard) == [1, 2, 3]
    assert seen["cat_0"]["heard"][heard[1]].tolist() == [1.5, -2.0]
    assert seen["cat_0"]["heard"][heard[2]].tolist() == [0.0, 7.0]
    # Said at the beginning of a step of 1 s, once; beacons of the mouse at each 0.2 s.
    assert seen["cat_0"]["age"][[heard[1], heard[3]]].tolist() == pytest.approx([1.0, 0.2])
    # Who says nothing sends its beacon, which is where it is.
    heard = {int(who): row for row, who in enumerate(seen["cat_1"]["sender"])}
    np.testing.assert_allclose(seen["cat_1"]["heard"][heard[0]], seen["cat_0"]["see"][:2], atol=3.0)
    assert seen["cat_1"]["heard"][heard[2]].tolist() == [0.0, 7.0]
    # What is not said again grows old, and after 2 s is forgotten; its beacon takes its place.
    seen, *_ = env.step(saying(env, cat_1=[3.0, 3.0]))
    heard = {int(who): row for row, who in enumerate(seen["cat_0"]["sender"])}
    assert seen["cat_0"]["heard"][heard[1]].tolist() == [3.0, 3.0]
    np.testing.assert_allclose(seen["cat_0"]["heard"][heard[2]], seen["cat_2"]["see"][:2], atol=3.0)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (STILL, "action of cat_0: expected a dict of act and say, for there is a radio, found ndarray"),
        ({"say": STILL}, "action of cat_0: expected a dict of act and say, .* found dict of say"),
        ({"act": STILL, "sya": STILL}, "action of cat_0: there is no part 'sya'; did you mean 'say'"),
        ({"act": STILL, "say": np.zeros(3)}, r"say: expected shape \(2,\) \(world.radio.size\), found \(3,\)"),
        ({"act": STILL, "say": [0.0, np.nan]}, "say: nan is no finite number; without say nothing is said"),
        ({"act": STILL, "say": "hello"}, r"say: expected numbers of shape \(2,\), found 'hello'"),
        ({"act": np.zeros(3), "say": STILL}, r"expected shape \(2,\) \(velocity_north, velocity_east\), found \(3,\)"),
    ],
)
def test_a_message_that_cannot_be_is_refused_in_one_line(action: Any, message: str) -> None:
    env = chase()
    env.reset(seed=1)
    with pytest.raises(UsageError, match=message) as caught:
        env.step(saying(env) | {"cat_0": action})
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_pettingzoo_finds_nothing_wrong_with_a_radio() -> None:
    parallel_api_test(parallel_env(CHASE), num_cycles=20)
    parallel_seed_test(lambda: parallel_env(CHASE))


@pytest.mark.long
def test_gymnasium_finds_nothing_wrong_and_its_batch_hears_the_same() -> None:
    env = SingleTask(SPOT)
    check_env(env)
    many: Any = gymnasium.make_vec(
        "qrsim/keep_spot-v0", num_envs=2, vectorization_mode="vector_entry_point", scenario=SPOT
    )
    assert isinstance(env.action_space, spaces.Dict)
    assert env.action_space["say"].shape == (2,)
    many.reset(seed=7)
    env.reset(seed=8)
    act = np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32)
    for _ in range(4):
        rows, *_ = many.step({"act": np.stack([act, act]), "say": np.zeros((2, 2), np.float32)})
        alone, *_ = env.step({"act": act, "say": np.zeros(2, np.float32)})
    assert alone["sender"].tolist() == [1, -1, -1]
    # 6 m and 0 m of the vehicle that is no agent, within its errors.
    np.testing.assert_allclose(alone["heard"][0], [6.0, 0.0], atol=5.0)
    for name in ("heard", "sender", "age", "rssi", "mask"):
        np.testing.assert_allclose(rows[name][1], alone[name], rtol=1e-4, atol=1e-4)


@pytest.mark.long
def test_pure_functions_hear_what_the_environment_hears() -> None:
    env, pure = chase(), Functional.of(CHASE)
    env.reset(seed=5)
    words = np.arange(6.0, dtype=np.float32).reshape(3, 2)
    seen, *_ = env.step({agent: {"act": STILL, "say": words[i]} for i, agent in enumerate(env.agents)})
    episode, _ = uncompiled(pure.reset)(jnp.uint32(5))
    step = uncompiled(pure.step)
    _, after = step(episode, {"act": jnp.zeros((3, 2)), "say": jnp.asarray(words)})
    for i, agent in enumerate(env.possible_agents):
        assert seen[agent]["sender"].tolist() == after.observation["sender"][i].tolist()
        np.testing.assert_allclose(seen[agent]["heard"], after.observation["heard"][i], rtol=1e-5, atol=1e-5)
    # Actions alone: who says nothing is heard by its beacon.
    _, quiet = step(episode, jnp.zeros((3, 2)))
    assert sorted(quiet.observation["sender"][0].tolist()) == [1, 2, 3]
    assert not np.allclose(quiet.observation["heard"], after.observation["heard"])


def test_spaces_are_as_without_a_radio_where_there_is_none_and_wrong_shapes_are_refused() -> None:
    pure = Functional.of("cats_and_mouse/1A")
    play: Play = pure.play
    assert (play.message, pure.play.axes[0].name) == (0, "velocity_north")
    with pytest.raises(
        UsageError, match=r"action: say: expected shape \(3, 0\), found \(3, 6\); there is no world.radio"
    ):
        pure.step(None, {"act": np.zeros((3, 2)), "say": np.zeros((3, 6))})  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"action: expected shape \(3, 2\), found \(2, 2\)"):
        pure.step(None, np.zeros((2, 2)))  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="action: expected a dict of act and say, found actt"):
        pure.step(None, {"actt": np.zeros((3, 2))})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("begun", "ticks", "handed"),
    # The radio begins a period at every tenth tick. A step of 5 ticks hears of none, or of one at its beginning; one of
    # 50 ticks of five, and speaks at the first.
    [(0, 5, [0]), (5, 5, []), (10, 5, [0]), (0, 50, [0]), (50, 50, [0]), (8, 4, [2])],
)
def test_a_message_is_handed_to_the_radio_once_a_step_at_most(begun: int, ticks: int, handed: list[int]) -> None:
    world = load_scenario(CHASE).world()
    words = Outbox(jnp.zeros((2, 3)), jnp.array([True, False, True]), jnp.full(3, -1), jnp.array([False, True, False]))
    found = []
    for number in range(ticks):
        kept, after = at_first_period(world, (None, Saying(None, words)), jnp.int32(begun + number), number)
        assert kept is None
        assert isinstance(after, Saying)
        assert after.outbox.beacons is words.beacons
        assert not after.outbox.send[1]
        if after.outbox.send.all() or after.outbox.send[0]:
            found.append(number)
    assert found == handed
