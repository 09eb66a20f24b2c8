"""Episodes of tasks over TCP: those of the environments in this process, and what is refused."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from wires import HERE, TASK, Running, running

from qrsim.envs.parallel import ParallelTask
from qrsim.envs.single import SingleTask
from qrsim.errors import UsageError
from qrsim.links.reference.client import Client, Refused

SHORT = "extends: keep_spot\nname: short_keep_spot\nduration: 0.2\n"
TWO_SIDES = "extends: cats_and_mouse/1A\nname: two_sides\ntask: {mouse: agent}\n"
SLOW = "extends: keep_spot\nname: slow\nduration: 600.0\ntask: {period: 300.0}\n"
PLUMES = "extends: plume_mapping/3D\nname: short_plumes\nduration: 2.0\n"
# Out of its space within a second: full pitch.
DIVE, HOVER = [1.0, 0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture
def client(serving: Running):
    """A client of the shared server."""
    with Client(port=serving.port, timeout=300.0) as found:
        yield found


def same(told: Any, expected: Any) -> None:
    """Compare what is told of the agents, arrays (n, ...), with that of an environment of one agent."""
    if isinstance(expected, dict):
        assert list(told) == list(expected)
        for name in expected:
            same(told[name], expected[name])
    else:
        np.testing.assert_array_equal(told, np.asarray(expected)[None])


def test_an_episode_is_that_of_the_environment_bit_for_bit(client):
    environment = SingleTask(yaml.safe_load(SHORT))
    chance = np.random.default_rng(4)
    for number, seed in ((0, 5), (1, None), (0, 6)):
        episode = client.play(scenario=SHORT, seed=seed) if number == 0 else client.play()
        observation, info = environment.reset(seed=seed)
        assert (episode.scenario, episode.number, episode.steps) == ("short_keep_spot", number, 10)
        assert (episode.agents, episode.period, episode.answer_shape) == (("pelicans_0",), 0.02, ())
        assert [(axis.name, axis.low, axis.high) for axis in episode.axes][2] == ("throttle", 0.0, 1.0)
        same(episode.observation, observation)
        same(episode.info, info)
        for step in range(1, 11):
            action = chance.uniform(-0.5, 0.5, 5).astype(np.float32)
            outcome = client.act([action])
            observation, reward, terminated, truncated, info = environment.step(action)
            same(outcome.observation, observation)
            same(outcome.info, info)
            assert outcome.reward.tolist() == [reward]
            assert (outcome.terminated, outcome.truncated) == (terminated, truncated) == (False, step == 10)
            assert (outcome.step, outcome.time) == (step, pytest.approx(0.02 * step))
        with pytest.raises(Refused, match="the episode has ended; PLAY starts the next one"):
            client.act([HOVER])


@pytest.mark.long
def test_several_agents_see_by_name_and_hand_in_answers(client):
    environment = ParallelTask(yaml.safe_load(PLUMES))
    episode = client.play(scenario=PLUMES, seed=3)
    seen, _ = environment.reset(seed=3)
    assert (list(episode.agents), episode.answer_shape) == (environment.agents, (100,))
    assert isinstance(episode.observation, dict)
    answers = np.random.default_rng(1).uniform(0.0, 0.1, (3, 100)).astype(np.float32)
    flights = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 3)).astype(np.float32)
    names = environment.agents
    actions = {name: flights[i] for i, name in enumerate(names)}
    outcome = client.act(flights)
    environment.step(actions)
    for given, said in (
        (None, "answer: there are 0; expected 3, one of each agent"),
        (answers[:2], "answer: there are 2; expected 3"),
        (answers[:, :7], "answer of 'helicopters_0': 7 numbers; expected 100, of shape \\(100,\\)"),
        (np.where(answers == answers[1, 4], np.nan, answers), "answer of 'helicopters_1': number 4 is not finite"),
    ):
        with pytest.raises(Refused, match=said):
            client.act(flights, given)
    outcome = client.act(flights, answers)
    environment.hand_in({name: answers[i] for i, name in enumerate(names)})
    seen, rewards, _, truncations, _ = environment.step(actions)
    assert outcome.truncated
    assert all(truncations.values())
    assert outcome.reward.tolist() == list(rewards.values())
    for i, name in enumerate(names):
        for part in ("vehicle", "locations"):
            np.testing.assert_array_equal(outcome.observation[part][i], seen[name][part])


def test_a_vehicle_that_stops_ends_the_episode(client):
    client.play("TaskKeepSpotWithReward", seed=1)
    returned = 0.0
    while not (outcome := client.act([DIVE])).terminated:
        returned += outcome.reward[0]
        assert -1859.0 < returned < 0.0
        assert outcome.step < 200
    # The return after a crash: less than any flight of this task can cost.
    assert returned + outcome.reward[0] == pytest.approx(-1859.615, rel=1e-5)
    assert not outcome.truncated
    with pytest.raises(Refused, match="the episode has ended"):
        client.act([HOVER])
    assert client.play().number == 1
    assert client.act([HOVER]).step == 1


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda client: client.act([HOVER[:4]]), r"action of vehicle 0 \('pelicans_0'\): 4 numbers; expected 5"),
        (lambda client: client.act([HOVER, HOVER]), "action: 2 vectors; expected 1"),
        (lambda client: client.act(np.zeros((0, 5))), "action: 0 vectors; expected 1"),
        (lambda client: client.act([[np.nan, *HOVER[1:]]]), "action: pitch of 'pelicans_0' is nan; allowed: -1 to 1"),
        (lambda client: client.act([[*HOVER[:4], 1.1]]), "action: battery of 'pelicans_0' is 1.1; allowed: -1 to 1"),
        (lambda client: client.act([[1e300, *HOVER[1:]]]), "action: pitch of 'pelicans_0' is inf; allowed: -1 to 1"),
        (lambda client: client.act([HOVER], [[1.0]]), "answer: nothing is handed in in this task"),
        (lambda client: client.step_waypoint(0.02, [[*HERE, 0.0]]), "this session plays a task: ACT advances it"),
        (lambda client: client.reset(), "this session plays a task"),
        (lambda client: client.readings(), "this session plays a task"),
        (lambda client: client.play("hover"), "PLAY: scenario 'hover' has no task; INIT or OPEN let it be flown"),
        (
            lambda client: client.play(scenario=SLOW),
            "PLAY: a step of this task is 15000 time steps; allowed: up to 10000",
        ),
        (
            lambda client: client.play(scenario=TWO_SIDES),
            "PLAY: the agents are of several fleets, cats, mice; a session has those of one",
        ),
        (lambda client: client.play("keep_spott"), "did you mean 'keep_spot'"),
        (lambda client: client.play("keep_spot", scenario=SHORT), "give either a task or a scenario"),
    ],
)
def test_what_is_wrong_is_told_and_changes_nothing(wrong: Callable[[Client], object], said, client):
    client.play(scenario=SHORT)
    with pytest.raises(Refused, match=said):
        wrong(client)
    assert client.act([HOVER]).step == 1


def test_a_flown_session_plays_nothing(client):
    with pytest.raises(Refused, match="no task is played on this connection: send PLAY first"):
        client.act([HOVER])
    client.init(TASK)
    with pytest.raises(Refused, match="no task is played on this connection"):
        client.act([HOVER])
    client.play("keep_spot")
    client.init(TASK)
    client.step_waypoint(0.02, [[*HERE, 0.0]])


def test_the_client_says_what_is_wrong_with_an_action(client):
    client.play(scenario=SHORT)
    with pytest.raises(UsageError, match=r"action: expected numbers of shape \(vehicles, numbers of an action\)"):
        client.act("up")
    with pytest.raises(UsageError, match=r"answer: expected numbers of shape \(agents, ...\)"):
        client.act([HOVER], "many")


def test_others_watch_an_episode(serving, client):
    with Client(port=serving.port) as watcher:
        client.play(scenario=SHORT, seed=2)
        states = watcher.watch(timeout=20.0)
        for _ in range(3):
            outcome = client.act([HOVER])
            state = next(states)
            assert state.time == outcome.time
            # A state has both parts of a position, and the information of an environment is in single precision.
            np.testing.assert_array_max_ulp(np.float32(state.state[:, :3]), outcome.info["position_ned"], maxulp=1)
            np.testing.assert_array_equal(state.measured[:, 17:19], outcome.observation[:, 3:5])


def test_a_server_that_records_refuses_what_it_cannot_record(tmp_path: Path):
    with running(record=tmp_path) as served, Client(port=served.port) as client:
        with pytest.raises(Refused, match="episodes are neither recorded nor drawn"):
            client.play("keep_spot")
        client.init(TASK)
    with running() as served, contextlib.closing(Client(port=served.port)) as client:
        assert "episodes" in client.hello()["capabilities"]
