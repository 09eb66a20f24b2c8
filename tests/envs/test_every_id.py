"""What users' tools do to environments, done to every one: wrappers, conversions, copies, specs and checks."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any

import cloudpickle
import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, NormalizeObservation, RecordVideo
from pettingzoo.test import api_test
from pettingzoo.utils.conversions import parallel_to_aec
from tests.envs.ids import every

from qrsim.envs import SEVERAL, SINGLE, gymnasium_id, parallel_env

# Steps of an episode that a copy goes on in.
STEPS = 3


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    # Gymnasium warns of every space without bounds, PettingZoo of dicts.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@cache
def made(name: str) -> Any:
    """Return an environment that the cases of a name share."""
    return gymnasium.make(gymnasium_id(name)) if name in SINGLE else parallel_env(name)


def act(env: Any, number: int) -> Any:
    """Step by small actions that depend on nothing but their number."""
    random = np.random.default_rng(number)

    def action(space: Any) -> Any:
        return random.uniform(-0.2, 0.2, space.shape).astype(space.dtype)

    if hasattr(env, "possible_agents"):
        return env.step({agent: action(env.action_space(agent)) for agent in env.possible_agents})
    return env.step(action(env.action_space))


def flown(env: Any) -> list[Any]:
    """Return all numbers of some steps and of the episode after."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves(([act(env, i) for i in range(STEPS)], env.reset()))]


def same(some: list[Any], others: list[Any]) -> bool:
    """Return whether two flights are the same to the bit."""
    return len(some) == len(others) and all(
        np.array_equal(one, other, equal_nan=one.dtype.kind == "f") for one, other in zip(some, others, strict=True)
    )


@pytest.mark.nightly
@every([*SINGLE, *SEVERAL])
@pytest.mark.parametrize(
    "copied", [lambda item: cloudpickle.loads(cloudpickle.dumps(item)), copy.deepcopy], ids=["cloudpickle", "deepcopy"]
)
def test_a_copy_goes_on_alike(name: str, copied: Any) -> None:
    env = made(name)
    env.reset(seed=3)
    act(env, 99)
    other = copied(env)
    after = flown(other)
    assert same(after, flown(env))
    # Of another seed it is another flight.
    env.reset(seed=4)
    act(env, 99)
    assert not same(after, flown(env))


@every(SINGLE)
def test_its_spec_makes_an_equal_one(name: str) -> None:
    env = made(name)
    other = gymnasium.make(env.spec)
    assert (other.observation_space, other.action_space) == (env.observation_space, env.action_space)
    assert other.spec == env.spec
    assert same(jax.tree.leaves(other.reset(seed=5)), jax.tree.leaves(env.reset(seed=5)))
    assert same(flown(other), flown(env))


def test_a_spec_keeps_what_was_asked_for() -> None:
    env = gymnasium.make("qrsim/keep_spot-v0", overrides=["duration=0.1"], render_mode="rgb_array")
    other = gymnasium.make(env.spec)  # type: ignore[arg-type]
    assert other.render_mode == "rgb_array"
    other.reset(seed=1)
    # Five steps of 0.02 s.
    assert [other.step(np.zeros(5, np.float32))[3] for _ in range(5)] == [False] * 4 + [True]


@every(SINGLE)
def test_wrappers_of_gymnasium_take_it(name: str) -> None:
    env: Any = NormalizeObservation(FlattenObservation(made(name)))
    seen, _ = env.reset(seed=1)
    sizes = [seen.shape]
    for i in range(STEPS):
        seen, *_ = act(env, i)
        sizes.append(seen.shape)
        assert np.isfinite(seen).all()
    inside = env.env.env.observation_space
    assert set(sizes) == {(gymnasium.spaces.flatdim(inside),)}


@every(SINGLE)
def test_a_seed_is_an_episode(name: str) -> None:
    env = made(name)
    flights = []
    for seed in (6, 7, 6):
        first = jax.tree.leaves(env.reset(seed=seed)[0])
        flights.append([np.asarray(leaf) for leaf in (*first, *jax.tree.leaves(act(env, 1)[0]))])
    assert same(flights[0], flights[2])
    assert not same(flights[0], flights[1])


@pytest.mark.long
@every(SINGLE)
def test_stable_baselines_finds_nothing_wrong(name: str) -> None:
    pytest.importorskip("stable_baselines3", reason="needs Stable-Baselines3: pip install stable-baselines3")
    from stable_baselines3.common.env_checker import check_env

    check_env(made(name).unwrapped, skip_render_check=True)


@pytest.mark.long
@every(SINGLE)
def test_it_is_recorded(name: str, tmp_path: Any) -> None:
    pytest.importorskip("moviepy", reason="needs moviepy: pip install moviepy")
    with RecordVideo(gymnasium.make(gymnasium_id(name), render_mode="rgb_array"), str(tmp_path), video_length=2) as env:
        env.reset(seed=1)
        for i in range(STEPS):
            act(env, i)
    assert next(tmp_path.glob("*.mp4")).stat().st_size > 500


@every(SEVERAL)
def test_it_is_one_agent_after_the_other_too(name: str) -> None:
    api_test(parallel_to_aec(made(name)), num_cycles=30)
