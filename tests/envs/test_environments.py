"""Environments: the checks of Gymnasium and PettingZoo for every one, restarts in a batch, and what is refused."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test, parallel_seed_test
from tests.envs.ids import every

from qrsim.envs import SEVERAL, SINGLE, Functional, gymnasium_id, parallel_env
from qrsim.envs.parallel import ParallelTask
from qrsim.envs.single import SingleTask
from qrsim.errors import UsageError
from qrsim.scenarios.scenario import built_in_names, load_scenario

# Out of its space within a second: full pitch.
DIVE = np.array([1.0, 0.0, -1.0, 0.0, 1.0], np.float32)
HOVER = np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32)


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    # Gymnasium warns of every space without bounds.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def test_every_scenario_with_a_task_is_an_environment() -> None:
    playable = {name for name in built_in_names() if load_scenario(name).steps}
    assert playable == {*SINGLE, *SEVERAL}
    assert all(gymnasium_id(name) in gymnasium.registry for name in SINGLE)


@every(SINGLE)
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    check_env(gymnasium.make(gymnasium_id(name)).unwrapped)


@every(SEVERAL)
def test_pettingzoo_finds_nothing_wrong(name: str) -> None:
    parallel_api_test(parallel_env(name), num_cycles=1000)
    parallel_seed_test(lambda: parallel_env(name))


@cache
def single() -> SingleTask:
    found: Any = gymnasium.make(gymnasium_id("keep_spot")).unwrapped
    return found


def test_a_batch_restarts_what_has_ended_in_the_same_step() -> None:
    """Environment i of seed s is that of one environment with seed s + i, and so are the episodes that follow."""
    batch = gymnasium.make_vec(gymnasium_id("keep_spot"), num_envs=4, autoreset_mode="SAME_STEP")
    assert batch.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    seen, infos = batch.reset(seed=11)
    assert infos["position_ned"].shape == (4, 3)
    alone = single()
    own, _ = alone.reset(seed=13)
    np.testing.assert_allclose(seen[2], own, rtol=1e-5, atol=1e-5)
    assert own[2] != -10.0, "the barometer says so, not the truth"
    actions, returned = np.stack([HOVER, HOVER, DIVE, HOVER]), np.zeros(2)
    for _ in range(300):
        seen, rewards, terminated, truncated, infos = batch.step(actions)
        before = own
        own, reward, ended, _, info = alone.step(DIVE)
        returned += reward, rewards[2]
        assert terminated[2] == ended
        if ended:
            break
        np.testing.assert_allclose(seen[2], own, rtol=1e-4, atol=1e-4)
    assert ended, "a dive ends in the ground or out of the area"
    np.testing.assert_array_equal(own, before, "its sensors report nothing any more, so it sees what it saw last")
    np.testing.assert_allclose(own[:3], info["position_ned"], atol=3.0)
    assert np.linalg.norm(own[3:6]) > 3.0
    # A minute of the command that costs most, and the corner (20, 10, 10) m from the start.
    np.testing.assert_allclose(returned, -1859.615, rtol=1e-5)
    assert list(terminated) == [False, False, True, False]
    assert not truncated.any()
    assert list(infos["_final_obs"]) == list(infos["_final_info"]) == list(terminated)
    np.testing.assert_allclose(infos["final_obs"][2], own, rtol=1e-4, atol=1e-4)
    assert infos["final_info"]["reason"][2] == info["reason"] != 0
    assert infos["reason"][2] == 0, "the new episode flies"
    np.testing.assert_allclose(infos["final_info"]["position_ned"][2], info["position_ned"], atol=1e-4)
    np.testing.assert_allclose(seen[2], alone.reset()[0], rtol=1e-5, atol=1e-5)
    assert not np.array_equal(seen[2], alone.reset(seed=13)[0]), "it is another episode"
    assert np.from_dlpack(seen).shape == (4, 12)


def test_an_episode_ends_after_its_last_step() -> None:
    env = SingleTask("keep_spot", overrides=["duration=0.1"])
    env.reset(seed=0)
    ends = [env.step(HOVER)[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    with pytest.raises(UsageError, match="has ended, or has not begun: call reset"):
        env.step(HOVER)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(4), r"expected shape \(5,\) \(pitch, roll, throttle, yaw_rate, battery\), found \(4,\)"),
        (np.array([0.0, np.nan, 0.0, 0.0, 0.0]), "roll of 'pelicans_0' in environment 0 is nan; allowed: -1 to 1"),
        (np.array([0.0, 0.0, 1.5, 0.0, 0.0]), "throttle of 'pelicans_0' in environment 0 is 1.5; allowed: -1 to 1"),
    ],
)
def test_an_action_that_cannot_be_flown_is_refused(action: Any, message: str) -> None:
    env = single()
    env.reset(seed=1)
    with pytest.raises(UsageError, match=message):
        env.step(action)


def test_a_plume_rewards_at_the_end_what_was_handed_in_last() -> None:
    """Nothing handed in where the concentration is high costs its square; the truth costs nothing."""
    env = SingleTask("plume_mapping/3A", overrides=["duration=2.0"])
    flight = np.zeros(3, np.float32)
    env.reset(seed=3)
    assert env.answer_space is not None
    assert (env.action_space.shape, env.answer_space.shape) == ((3,), (100,))
    play, episode = env.batch.functional.play, env.batch.episodes.episode(0)
    at = episode.memory.locations_ned, episode.state.contents.plume
    sources, std, yaw = at[1].sources, np.asarray(at[1].std.stack())[0], float(at[1].yaw[0])
    offset = np.asarray(at[0].stack()) - np.asarray(sources.position_ned.stack())
    turned = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    truth = np.exp(-0.5 * np.sum((offset @ turned.T / std) ** 2, axis=1)).astype(np.float32)
    assert (truth > 1e-3).mean() >= 0.8
    assert (truth.shape, play.task.locations) == ((100,), 100)
    env.hand_in(truth)
    env.hand_in(np.zeros(100))
    assert env.step(flight)[1:4] == (0.0, False, False)
    last = env.step(flight)
    assert last[1] == pytest.approx(-np.sum(truth**2), rel=1e-4)
    assert last[3]
    with pytest.raises(UsageError, match="has ended, or has not begun: hand in before its last step"):
        env.hand_in(truth)
    env.reset(seed=3)
    env.hand_in(truth)
    env.step(flight)
    assert env.step(flight)[1] == pytest.approx(0.0, abs=1e-8)
    # What was handed in in one episode counts for no other.
    env.reset(seed=3)
    env.step(flight)
    assert env.step(flight)[1] == pytest.approx(-np.sum(truth**2), rel=1e-4)


def test_what_cannot_be_handed_in_is_refused() -> None:
    env = SingleTask("plume_mapping/3A", overrides=["duration=2.0"])
    with pytest.raises(UsageError, match="hand in before its last step"):
        env.hand_in(np.zeros(100))
    env.reset(seed=3)
    for wrong, message in (
        (np.zeros(7), r"samples: expected shape \(100,\) of each agent, found \(7,\)"),
        (np.full(100, np.nan), "samples: number 0 is not finite"),
        ("much", "samples: expected numbers of shape"),
        ([[1.0], [2.0, 3.0]], "samples: expected numbers of shape"),
    ):
        with pytest.raises(UsageError, match=message):
            env.hand_in(wrong)
    other = single()
    other.reset(seed=1)
    with pytest.raises(UsageError, match="keep_spot: nothing is handed in in this task"):
        other.hand_in(np.zeros(100))


def test_a_task_of_several_vehicles_is_none_of_gymnasium() -> None:
    with pytest.raises(
        UsageError, match="3 vehicles are commanded, cat_0, cat_1, cat_2; it is an environment of Petting"
    ):
        SingleTask("cats_and_mouse/1A")
    with pytest.raises(UsageError, match="hover_ideal: it has no task"):
        SingleTask("hover_ideal")


def test_every_cat_needs_an_action() -> None:
    env: ParallelTask = parallel_env("cats_and_mouse/1A")
    with pytest.raises(UsageError, match="has not begun"):
        env.step({})
    env.reset(seed=1)
    with pytest.raises(UsageError, match="there is none for cat_1, cat_2"):
        env.step({"cat_0": np.zeros(2)})
    with pytest.raises(UsageError, match="no agent is called 'mouse'"):
        env.step({"mouse": np.zeros(2)})
    with pytest.raises(UsageError, match="expected a dict with one for each agent, found ndarray"):
        env.step(np.zeros((3, 2)))  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="action"):
        env.step({agent: [10**400, 0] for agent in env.agents})


@pytest.mark.long
def test_functions_can_be_compiled_and_mapped_over_seeds_and_scanned() -> None:
    """And a reset by the number of a seed is that of an environment."""
    env = Functional.of("keep_spot")

    @jax.jit
    def fly(seeds: Any) -> Any:
        def one(seed: Any) -> Any:
            episode, seen = env.reset(seed)
            action = jnp.asarray(HOVER)[None]
            last, steps = jax.lax.scan(lambda now, _: env.step(now, action), episode, length=5)
            return seen, steps.reward, env.truth(last)

        return jax.vmap(one)(seeds)

    seen, rewards, truth = fly(jnp.arange(3, dtype=jnp.uint32))
    np.testing.assert_allclose(seen[1, 0], single().reset(seed=1)[0], atol=1e-6)
    assert rewards.shape == (3, 5, 1)
    # A hover costs nothing but how far it gets, and on the way the stake: half of a crash's 1859.615 at 10 m.
    away = np.sum((np.asarray(truth["position_ned"])[:, 0] - [0.0, 0.0, -10.0]) ** 2, axis=-1)
    np.testing.assert_allclose(np.sum(rewards, axis=(1, 2)), -away * (1.0 + 9.298), rtol=1e-3)
    assert truth["position_ned"].shape == (3, 1, 3)


def test_other_numbers_compile_nothing_anew_and_count() -> None:
    """Domain randomisation: a mass of its own for every episode."""
    heavy = {"path": "fleets.pelicans.vehicle.mass", "low": 1.5, "high": 2.0}
    env = Functional.of({"extends": "keep_spot", "name": "any_mass", "ranges": [heavy]})
    drawn = jax.jit(lambda seed: env.reset(seed)[0].state.drawn[0])
    masses = [float(drawn(jnp.uint32(seed))) for seed in range(20)]
    assert 1.5 < min(masses) < max(masses) < 2.0
    assert len(set(masses)) == 20
