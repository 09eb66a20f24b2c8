"""Wrong arguments, seeds, actions and policies, in every form of an environment: one line each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

from qrsim import cli
from qrsim.envs import Functional, parallel_env, vector_parallel_env
from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import UsageError

SHORT = ["duration=1"]
SEEDS = [
    (1.5, "1.5"),
    (2.0, "2.0"),
    ("7", "'7'"),
    (float("nan"), "nan"),
    (-1, "-1"),
    (np.int64(-1), "-1"),
    (True, "True"),
    (2**63, "9223372036854775808"),
    (1j, "1j"),
]
# Of five numbers, and how a message goes on after "expected ".
ACTIONS: list[tuple[Any, str]] = [
    (np.zeros((1, 5)), "shape (5,) (pitch, roll, throttle, yaw_rate, battery), found (1, 5)"),
    ([[1.0, 2.0], [3.0]], "numbers of shape (5,), found [[1.0, 2.0], [3.0]]"),
    ([1j] * 5, "numbers of shape (5,), found [1j, 1j, 1j, 1j, 1j]"),
    ("up", "numbers of shape (5,), found 'up'"),
    (None, "numbers of shape (5,), found None"),
    ({"act": 1}, "numbers of shape (5,), found {'act': 1}"),
]


@pytest.fixture(scope="module")
def single() -> SingleTask:
    return SingleTask("keep_spot", SHORT)


@pytest.fixture(scope="module")
def vector() -> VectorTask:
    return VectorTask("keep_spot", 2, overrides=SHORT)


@pytest.fixture(scope="module")
def cats() -> Any:
    return parallel_env("cats_and_mouse/1A", overrides=SHORT)


def refused(call: Any, message: str) -> None:
    with pytest.raises(UsageError, match=f"^{re.escape(message)}$") as raised:
        call()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("seed", "found"), SEEDS)
def test_a_seed_that_is_no_integer(seed: Any, found: str, single: SingleTask, vector: VectorTask, cats: Any) -> None:
    message = f"seed: {found} is not an integer from 0 to 2**63 - 1"
    for env in (single, vector, cats):
        refused(lambda env=env: env.reset(seed=seed), message)
    refused(lambda: vector.reset(seed=[1, seed]), message)


def test_seeds_of_numpy_are_seeds(single: SingleTask) -> None:
    one, other = single.reset(seed=np.int64(3))[0], single.reset(seed=3)[0]  # type: ignore[arg-type]
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seed", [1.5, "7", -1, True, 2**32, np.zeros(2)])
def test_a_seed_of_functions(seed: Any) -> None:
    env = Functional.of("keep_spot", SHORT)
    with pytest.raises(UsageError, match=r"^seed: .* is neither an integer from 0 to 2\*\*32 - 1 nor one of keys"):
        env.reset(seed)
    if not isinstance(seed, int):
        with pytest.raises(UsageError, match=r"^seed: .* is no array of integers from 0 to 2\*\*63 - 1$"):
            env.keys(seed)


@pytest.mark.parametrize(("action", "message"), ACTIONS)
def test_an_action_that_is_no_row_of_numbers(action: Any, message: str, single: SingleTask, cats: Any) -> None:
    single.reset(seed=1)
    refused(lambda: single.step(action), f"action: expected {message}")
    if not isinstance(action, np.ndarray):
        cats.reset(seed=1)
        actions = dict.fromkeys(cats.agents, action)
        refused(lambda: cats.step(actions), f"action of cat_0: expected {message}".replace("(5,)", "(2,)"))


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((3, 5)), "expected shape (2, 5) (pitch, roll, throttle, yaw_rate, battery), found (3, 5)"),
        ([[0, 1], [2]], "expected numbers of shape (2, 5), found [[0, 1], [2]]"),
        (np.diag([0.0, np.nan])[:, [0, 1, 0, 0, 0]], "roll of 'pelicans_0' in environment 1 is nan; allowed: -1 to 1"),
    ],
)
def test_actions_of_a_batch(actions: Any, message: str, vector: VectorTask) -> None:
    vector.reset(seed=1)
    refused(lambda: vector.step(actions), f"actions: {message}")


def test_functions_refuse_another_shape() -> None:
    env = Functional.of("keep_spot", SHORT)
    episode: Any = None  # not looked at
    refused(lambda: env.step(episode, jnp.zeros((1, 3))), "action: expected shape (1, 5), found (1, 3)")


POLICIES = """
import numpy as np

def named(seen): return {"cat_0": np.zeros(2)}
def two(seen): return np.zeros((2, 2))
def nothing(seen): return None
def jagged(seen): return [[1, 2], [3]]
def unknown(seen): return np.full((3, 2), np.nan)
def broken(seen): raise ValueError("no such\\nthing")

class Still: pass

class Unmade:
    def __init__(self): pass
    def act(self, seen): return np.zeros((3, 2))
"""
SHAPE = "expected actions of shape (3, 2) (agents, axes), found"


@pytest.mark.parametrize(
    ("policy", "code", "message"),
    [
        ("named", 2, f"policy own.py:named: {SHAPE} {{'cat_0': array([0., 0.])}}"),
        ("two", 2, f"policy own.py:two: {SHAPE} (2, 2)"),
        ("nothing", 2, f"policy own.py:nothing: {SHAPE} None"),
        ("jagged", 2, f"policy own.py:jagged: {SHAPE} [[1, 2], [3]]"),
        ("unknown", 2, "policy own.py:unknown: velocity_north of 'cat_0' in environment 0 is nan; allowed: -1 to 1"),
        ("broken", 1, "policy own.py:broken: step 1: ValueError: no such thing"),
        ("Still", 2, "--policy: the class Still has no act(seen)"),
        ("Unmade", 1, "policy own.py:Unmade: making it of (play, seed): TypeError: Unmade.__init__() takes 1"),
    ],
)
def test_a_policy_of_score(
    policy: str, code: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(POLICIES, "utf-8")
    options = ["--policy", f"own.py:{policy}", "--seeds", "1", "--set", "duration=1"]
    assert cli.main(["score", "cats_and_mouse/1A", *options]) == code
    said = capsys.readouterr().err.strip()
    assert said.startswith(f"error: {message}")
    assert "\n" not in said


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"duration": 2}, "{}; a value of the scenario is set by overrides=['duration=2']"),
        ({"durration": "2"}, "{}; a value of the scenario is set by overrides=['duration=2']"),
        ({"overides": []}, "{}; did you mean 'overrides'?"),
        ({"seed": 3}, "{}; a seed is that of reset(seed=...)"),
        ({"wind": [1.0]}, "{}; a value of the scenario is set by overrides=['duration=20']"),
        ({"overrides": {"duration": 2}}, "overrides: expected a list such as ['path=value'], found {'duration': 2}"),
        ({"precision": "f32"}, "precision: 'f32' is not known; did you mean 'float32'?"),
        ({"precision": None}, "precision: 'None' is not known; known: float32, float64"),
    ],
)
def test_arguments_of_environments(given: dict[str, Any], message: str) -> None:
    several = "scenario, num_envs, overrides, precision, render_mode, autoreset_mode"
    makers: list[tuple[Any, str]] = [
        (lambda: gymnasium.make("qrsim/keep_spot-v0", **given), "scenario, overrides, precision, render_mode"),
        (lambda: gymnasium.make_vec("qrsim/keep_spot-v0", num_envs=2, **given), several),
        (lambda: parallel_env("cats_and_mouse/1A", **given), "scenario, overrides, precision, render_mode"),
        (lambda: vector_parallel_env("cats_and_mouse/1A", **given), several),
        (lambda: Functional.of("keep_spot", **given), "scenario, overrides, precision"),
    ]
    [name] = given
    for make, allowed in makers:
        refused(make, message.replace("{}", f"{name}: no such argument of an environment; allowed: {allowed}"))


def test_an_environment_of_no_scenario() -> None:
    words = "scenario: missing; expected a name, the path of a .yaml file or a dict"
    makers = (lambda: gymnasium.make("qrsim/task-v0"), lambda: gymnasium.make_vec("qrsim/task-v0"), parallel_env)
    for make in makers:
        refused(make, words)
