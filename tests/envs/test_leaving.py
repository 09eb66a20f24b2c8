"""Agents that stop leave, and the others fly on."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pettingzoo.test import parallel_api_test

import qrsim
from qrsim import cli
from qrsim.envs import parallel_env, vector_parallel_env
from qrsim.envs.parallel import ParallelTask

# At 3 m/s north the second is over the edge of the area, at 212.132 m, in its fourth second, the third in its ninth.
THREE: dict[str, Any] = {
    "extends": "search_and_rescue/2C",
    "name": "leavers",
    "duration": 12.0,
    "task": {"leave": True, "penalty": -50.0},
    "fleets": {
        "helicopters": {
            "placement": {"type": "given"},
            "vehicles": [{"position_ned": [north, east, -45.0]} for north, east in ((0, 0), (206, 40), (191, 80))],
        }
    },
}
FIRST, SECOND, THIRD = (f"helicopters_{i}" for i in range(3))
NORTH = np.array([1.0, 0.0, 0.0], np.float32)


@cache
def team() -> ParallelTask:
    return parallel_env(THREE)


def flown(env: ParallelTask) -> list[Any]:
    env.reset(seed=1)
    found = []
    while env.agents:
        found.append((list(env.agents), *env.step(dict.fromkeys(env.agents, NORTH))))
    return found


@pytest.mark.long
def test_the_others_fly_on() -> None:
    steps = flown(team())
    assert len(steps) == 12
    acted = [len(agents) for agents, *_ in steps]
    assert acted == sorted(acted, reverse=True)
    assert (acted[0], acted[-1]) == (3, 1)
    ends = {
        agent: (number, rewards[agent], truncated[agent])
        for number, (agents, _, rewards, terminated, truncated, _) in enumerate(steps)
        for agent in agents
        if terminated[agent] or truncated[agent]
    }
    assert list(ends) == [SECOND, THIRD, FIRST]
    # Who leaves pays the penalty in its last step, and the other goes on to the end.
    assert 1 <= ends[SECOND][0] <= 4 < 6 <= ends[THIRD][0] <= 10
    assert ends[SECOND][1:] == ends[THIRD][1:] == (-50.0, False)
    assert ends[FIRST][0] == 11
    assert ends[FIRST][2] is True
    # What it sees last is what it saw in flight.
    last, before = (steps[ends[SECOND][0] - i][1][SECOND] for i in (0, 1))
    assert before["grid"].all()
    for name, numbers in last.items():
        np.testing.assert_array_equal(numbers, before[name])
    for agents, seen, rewards, *_, infos in steps:
        assert list(seen) == list(rewards) == list(infos) == agents
        # A person that somebody finds is 1 for all who fly, and a step without one costs a twelfth.
        going = [rewards[agent] for agent in agents if rewards[agent] != -50.0]
        assert all(value == pytest.approx(going[0]) for value in going)
        assert going[0] == pytest.approx(-1 / 12) or going[0] >= 1.0


@pytest.mark.long
def test_without_leaving_the_episode_ends_for_all() -> None:
    ended = flown(parallel_env({**THREE, "name": "stayers", "task": {"leave": False, "penalty": -50.0}}))
    assert len(ended) <= 5
    assert ended[-1][2] == dict.fromkeys((FIRST, SECOND, THIRD), -50.0)
    assert all(ended[-1][3].values())


@pytest.mark.long
def test_side_by_side_who_has_left_stays_terminated_at_no_reward() -> None:
    many = vector_parallel_env(THREE, num_envs=2, autoreset_mode="SAME_STEP")
    many.reset(seed=1)
    alone = flown(team())
    actions = dict.fromkeys(many.agents, np.tile(NORTH, (2, 1)))
    left = False
    for agents, _, rewards, terminated, truncated, _ in alone:
        _, paid, over, cut, _ = many.step(actions)
        for agent in many.agents:
            if agent in agents:
                assert paid[agent][0] == pytest.approx(rewards[agent])
                assert (over[agent][0], cut[agent][0]) == (terminated[agent], truncated[agent])
            else:
                left = True
                assert (paid[agent][0], over[agent][0], cut[agent][0]) == (0.0, True, False)
    assert left
    # The next episodes have begun, with everybody.
    assert not any(each.any() for each in many.step(actions)[2].values())


@pytest.mark.long
def test_a_run_is_scored_alike(tmp_path: Path) -> None:
    """By a policy of the command line, which has readings and returns set-points."""
    (tmp_path / "leavers.yaml").write_text(yaml.safe_dump(THREE), encoding="utf-8")
    (tmp_path / "pilot.py").write_text(
        "import numpy as np\nimport qrsim\n\n\ndef north(reading):\n"
        "    return qrsim.VelocitySetpoint.of(np.tile([3.0, 0.0, 0.0], (3, 1)), np.zeros(3))\n",
        encoding="utf-8",
    )
    words = ["--policy", f"{tmp_path / 'pilot.py'}:north", "--seed", "1", "--no-figure", "--out", str(tmp_path / "run")]
    assert cli.main(["run", str(tmp_path / "leavers.yaml"), *words]) == 0
    found = qrsim.open_run(tmp_path / "run").info.score or {}
    assert (found["outcome"], found["steps"]) == ("flown_to_the_end", 12)
    going = dict.fromkeys((FIRST, SECOND, THIRD), 0.0)
    for _, _, rewards, *_ in flown(team()):
        going = {agent: total + rewards.get(agent, 0.0) for agent, total in going.items()}
    assert found["agents"] == pytest.approx(going, rel=1e-4)


@pytest.mark.long
def test_what_they_hand_in_is_nothing_worth() -> None:
    plume = parallel_env(
        {
            "extends": "plume_mapping/3D",
            "name": "leaving_plume",
            "duration": 12.0,
            "task": {"leave": True},
            "fleets": {"helicopters": {"placement": {"type": "given"}}},
        }
    )
    seen, _ = plume.reset(seed=1)
    assert seen
    total = dict.fromkeys(plume.possible_agents, 0.0)
    lost = plume.possible_agents[0]
    while plume.agents:
        # One falls, the others stay.
        actions = {agent: np.array([0.0, 0.0, float(agent == lost)], np.float32) for agent in plume.agents}
        for agent, reward in plume.step(actions)[1].items():
            total[agent] += reward
    # -1000 for a crash and no more; zeros that are handed in cost something.
    assert total.pop(lost) == -1000.0
    assert all(-1.0 < value < 0.0 for value in total.values())


def test_others_find_nothing_wrong() -> None:
    parallel_api_test(team(), num_cycles=30)
