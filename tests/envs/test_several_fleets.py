"""Agents of several fleets, each with actions and observations of its own."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test
from pettingzoo.utils.conversions import parallel_to_aec
from tests.by_numpy import uncompiled

from qrsim.envs import ANY_TASK, Functional, parallel_env, vector_parallel_env
from qrsim.envs.parallel import ParallelTask
from qrsim.errors import QrsimError, UsageError

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).parents[2] / "examples" / "meeting"
MEETING = str(EXAMPLES / "meeting.yaml")
FLIES, DRIVES = ("quadrotors_0", "quadrotors_1"), "rover_0"
AHEAD = np.array([0.0, 1.0], np.float32)
SHORT = ["duration=4.0"]


@cache
def team() -> ParallelTask:
    return parallel_env(MEETING, overrides=SHORT)


def still() -> dict[str, Any]:
    return dict.fromkeys(FLIES, np.zeros(2, np.float32)) | {DRIVES: AHEAD}


def test_each_has_spaces_of_its_own() -> None:
    env = team()
    assert env.possible_agents == [*FLIES, DRIVES]
    assert [env.observation_space(agent).shape for agent in env.possible_agents] == [(9,), (9,), (4,)]
    assert [axis.name for axis in env.batch.axes[2]] == ["steering", "speed"]
    assert sorted(env.observation_axes) == ["quadrotors", "rover"]


def test_each_does_what_it_is_told() -> None:
    env = team()
    env.reset(seed=3)
    for _ in range(8):
        _, rewards, terminated, truncated, truth = env.step(still())
    assert all(truncated.values())
    assert not any(terminated.values())
    # The rover has driven north for 4 s at up to 2 m/s, and the quadrotors have stayed; all began 40 m apart.
    assert -17.0 < truth[DRIVES]["position_ned"][0] <= -12.0
    assert truth[DRIVES]["position_ned"][1] == pytest.approx(0.0, abs=0.05)
    assert truth[FLIES[0]]["position_ned"] == pytest.approx([20.0, 6.0, -15.0], abs=4.0)
    for agent in FLIES:
        offset = truth[agent]["position_ned"][:2] - truth[DRIVES]["position_ned"][:2]
        assert rewards[agent] == pytest.approx(-float(offset @ offset) / 100.0 / 8.0, rel=1e-4)
    assert rewards[DRIVES] == pytest.approx(0.5 * (rewards[FLIES[0]] + rewards[FLIES[1]]), rel=1e-5)


def test_pettingzoo_takes_it_in_both_forms() -> None:
    parallel_api_test(team(), num_cycles=20)
    api_test(parallel_to_aec(team()), num_cycles=20)


def test_all_forms_are_the_same() -> None:
    env, pure, many = team(), Functional.of(MEETING, SHORT), vector_parallel_env(MEETING, 2, overrides=SHORT)
    seen, _ = env.reset(seed=5)
    episode, told = uncompiled(pure.reset)(5)
    wide, _ = many.reset(seed=4)
    assert np.asarray(told["rover"][0]) == pytest.approx(seen[DRIVES], abs=1e-5)
    assert wide[DRIVES][1] == pytest.approx(seen[DRIVES], abs=1e-5)
    seen, rewards, *_ = env.step(still())
    act = {"quadrotors": jnp.zeros((2, 2)), "rover": jnp.asarray(AHEAD)[None]}
    episode, step = uncompiled(pure.step)(episode, act)
    wide, rewarded, *_ = many.step({agent: np.tile(act, (2, 1)) for agent, act in still().items()})
    assert np.asarray(step.observation["quadrotors"]) == pytest.approx(np.stack([seen[a] for a in FLIES]), abs=1e-4)
    assert np.asarray(step.reward) == pytest.approx(list(rewards.values()), rel=1e-5)
    assert [rewarded[agent][1] for agent in rewards] == pytest.approx(list(rewards.values()), rel=1e-5)


def test_all_that_speak_are_heard_by_the_others() -> None:
    pure = Functional.of(MEETING, [*SHORT, "world.radio={preset: sik_915, size: 3}"])
    episode, seen = jax.eval_shape(pure.reset, np.uint32(1))
    assert {fleet: part["see"].shape for fleet, part in seen.items()} == {"quadrotors": (2, 9), "rover": (1, 4)}
    assert seen["rover"]["heard"].shape[::2] == (1, 3)
    said = {"quadrotors": jnp.zeros((2, 2)), "rover": {"act": jnp.zeros((1, 2)), "say": jnp.ones((1, 3))}}
    _, step = jax.eval_shape(pure.step, episode, said)
    assert step.observation["quadrotors"]["sender"].shape[0] == 2
    with pytest.raises(UsageError, match=r"action of fleet 'rover': say: expected shape \(1, 3\), found \(1, 2\)"):
        pure.step(episode, said | {"rover": {"act": jnp.zeros((1, 2)), "say": jnp.ones((1, 2))}})


def test_who_stops_leaves_and_without_a_fleet_it_ends(tmp_path: Path) -> None:
    code = (EXAMPLES / "meeting.py").read_text()
    leaves = code.replace(
        "    rover: str", '    leave: bool = qrsim.setting(True, doc="who stops leaves")\n    rover: str'
    )
    (tmp_path / "meeting.py").write_text(leaves)
    narrow = (EXAMPLES / "meeting.yaml").read_text().replace("y_max: 60.0", "y_max: 12.0")
    (tmp_path / "meeting.yaml").write_text(narrow)
    env = parallel_env(str(tmp_path / "meeting.yaml"))
    env.reset(seed=1)
    east = np.array([0.0, 1.0], np.float32)
    acted, ends = [], {}
    # The first quadrotor flies 6 m east out of the area, at 3 m/s, and the second, from 12 m farther west, later.
    while env.agents:
        acted.append(len(env.agents))
        actions = dict.fromkeys(env.agents, east) | {DRIVES: np.array([0.0, -1.0], np.float32)}
        _, rewards, terminated, *_ = env.step({agent: actions[agent] for agent in env.agents})
        ends |= {agent: (len(acted), rewards[agent]) for agent, gone in terminated.items() if gone}
    assert [ends[agent][1] for agent in FLIES] == [-10.0, -10.0]
    assert ends[FLIES[0]][0] + 4 <= ends[FLIES[1]][0] == ends[DRIVES][0] < 40
    assert set(acted) == {3, 2}


def test_wrong_actions_are_one_line() -> None:
    env = team()
    env.reset(seed=1)
    with pytest.raises(UsageError, match=r"action of rover_0: expected shape \(2,\) \(steering, speed\), found \(3,\)"):
        env.step(still() | {DRIVES: np.zeros(3)})
    pure = Functional.of(MEETING)
    episode, _ = jax.eval_shape(pure.reset, np.uint32(0))
    flies, drives = jnp.zeros((2, 2)), jnp.zeros((1, 2))
    for action, words in (
        (flies, "expected a dict with one for each fleet, quadrotors, rover; found"),
        ({"quadrotors": flies}, "there is none for fleet rover"),
        ({"quadrotors": flies, "rovr": drives}, "no fleet of agents is called 'rovr'; did you mean 'rover'"),
        ({"quadrotors": flies, "rover": flies}, r"fleet 'rover': expected shape \(1, 2\) \(steering, speed\), found"),
    ):
        with pytest.raises(UsageError, match=words):
            pure.step(episode, action)


def test_one_vehicle_alone_is_not_an_environment_of_gymnasium() -> None:
    with pytest.raises(QrsimError, match=r"3 vehicles are commanded, .*; it is an environment of PettingZoo"):
        gymnasium.make(ANY_TASK, scenario=MEETING)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("self.rover: -jnp.mean", "'rovr': -jnp.mean", "the reward is a dict of quadrotors, rovr; expected a dict"),
        ("believed(flies), ", "believed(flies)[:1], ", r"the observation of fleet 'quadrotors' has shape \(1, 9\)"),
        ("return self.fleet, self.rover", 'return self.fleet, "rovr"', "no fleet is called 'rovr'; did you mean"),
        ("qrsim.VelocityHeightSetpoint if fleet", "dict if fleet", "asks for, dict; no controller does"),
        (' Axis("way_east", "m")', "", "the observation of fleet 'rover' has 4 numbers, but Meeting.sees names 3"),
    ],
)
def test_wrong_tasks_are_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    code = (EXAMPLES / "meeting.py").read_text()
    assert old in code
    (tmp_path / "meeting.py").write_text(code.replace(old, new))
    (tmp_path / "meeting.yaml").write_text((EXAMPLES / "meeting.yaml").read_text())
    with pytest.raises(QrsimError, match=words) as found:
        Functional.of(str(tmp_path / "meeting.yaml"))
    assert ": 1 problem\n" in str(found.value)
