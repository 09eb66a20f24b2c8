"""An environment that is pickled or deep-copied in mid-episode goes on as the original does, to the bit."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
import subprocess
import sys
from typing import Any

import gymnasium
import jax
import numpy as np
import pytest

from qrsim.envs import parallel_env

COPIES = pytest.mark.parametrize(
    "copy_of", [lambda item: pickle.loads(pickle.dumps(item)), copy.deepcopy], ids=["pickle", "deepcopy"]
)


def single() -> Any:
    return gymnasium.make("qrsim/keep_spot-v0")


def vector() -> Any:
    return gymnasium.make_vec("qrsim/keep_spot-v0", num_envs=3)


def parallel() -> Any:
    return parallel_env("cats_and_mouse/1A")


def act(env: Any, number: int) -> Any:
    """Step by actions that depend on nothing but their number."""
    random = np.random.default_rng(number)

    def action(space: Any) -> Any:
        return random.uniform(-0.3, 0.3, space.shape).astype(space.dtype)

    if hasattr(env, "possible_agents"):
        return env.step({agent: action(env.action_space(agent)) for agent in env.possible_agents})
    return env.step(action(env.action_space))


def fly(env: Any) -> list[Any]:
    """Return what five steps, a reset and two more bring, as arrays."""
    steps = [act(env, i) for i in range(5)]
    return jax.tree.leaves((steps, env.reset(), act(env, 5), act(env, 6)))


def same(some: list[Any], others: list[Any]) -> bool:
    return len(some) == len(others) and all(
        np.array_equal(a, b, equal_nan=np.asarray(a).dtype.kind == "f") for a, b in zip(some, others, strict=True)
    )


@COPIES
@pytest.mark.parametrize("make", [single, vector, parallel])
def test_goes_on_in_mid_episode(make: Any, copy_of: Any) -> None:
    env = make()
    env.reset(seed=4)
    for i in range(3):
        act(env, 100 + i)
    found = copy_of(env)
    after = fly(found)
    assert same(after, fly(env))
    # Another one goes elsewhere: the comparison can tell.
    env.reset(seed=5)
    assert not same(after, fly(env))


@pytest.mark.long
def test_computed_by_xla_in_double_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("QRSIM_COMPILER", "xla")
    env = gymnasium.make("qrsim/keep_spot-v0", precision="float64")
    env.reset(seed=4)
    act(env, 0)
    found = pickle.loads(pickle.dumps(env))
    assert same(jax.tree.leaves(act(found, 1)), jax.tree.leaves(act(env, 1)))
    assert found.unwrapped.batch.seen.dtype == "float64"


@pytest.mark.long
def test_in_another_process() -> None:
    env = single()
    env.reset(seed=4)
    act(env, 0)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        after = pool.apply_async(fly, (env,)).get(timeout=240)
    assert same(after, fly(env))


def test_one_that_has_not_started() -> None:
    found = pickle.loads(pickle.dumps(single()))
    env = single()
    assert same(jax.tree.leaves(found.reset(seed=3)), jax.tree.leaves(env.reset(seed=3)))


FORKED = """
import multiprocessing, warnings
import gymnasium, numpy as np, qrsim, qrsim.envs
warnings.simplefilter("ignore")
qrsim.configure(cpu_devices=2)
env = gymnasium.make_vec("qrsim/keep_spot-v0", num_envs=64)
env.reset(seed=1)
def act(number):
    return float(env.step(np.zeros(env.action_space.shape, np.float32))[1].sum())
act(0)
with multiprocessing.get_context("fork").Pool(1) as pool:
    found = pool.apply_async(act, (1,)).get(timeout=60)
assert found == act(1)
"""


@pytest.mark.long
def test_in_a_process_that_is_forked_off_after_threads_have_flown() -> None:
    """It has none of the threads, and used to wait for them for ever."""
    subprocess.run([sys.executable, "-c", FORKED], check=True, timeout=300)
