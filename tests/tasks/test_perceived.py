"""Agents that see by their own sensors: what they observe, its names and bounds, in every kind of environment."""

from __future__ import annotations

import math
import warnings
from functools import cache
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from qrsim.envs import Functional, parallel_env
from qrsim.envs.parallel import ParallelTask
from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import ScenarioError, UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks.baselines import baseline

EYES = {"type": "ideal_neighbours", "slots": 3, "range_max": 40.0, "velocity": True}
LIDAR = {"type": "ideal_scan", "rays": 4}
CATS: dict[str, Any] = {
    "extends": "cats_and_mouse/1A",
    "name": "seeing_cats",
    "duration": 3.0,
    "task": {"senses": ["eyes", "lidar"]},
    "fleets": {"cats": {"sensors": {"eyes": EYES, "lidar": LIDAR}}},
}
NOISY = {
    "eyes": {"type": "neighbours", "identity": False, "range_max": 6.0, "false_alarms": 0.5},
    "lidar": {"type": "scan"},
    "below": {"type": "rangefinder"},
}
SPOT: dict[str, Any] = {
    "extends": "keep_spot",
    "name": "seeing_spot",
    "task": {"senses": ["below", "eyes", "lidar"]},
    "fleets": {"pelicans": {"sensors": NOISY}},
    "ranges": [{"path": "fleets.pelicans.sensors.lidar.range_max", "low": 10.0, "high": 30.0}],
}


@cache
def cats() -> ParallelTask:
    return parallel_env(CATS)


def test_cats_see_by_what_they_carry() -> None:
    """Three others in slots of eight numbers, the nearest first, and four rays into the open; places by the truth."""
    env = cats()
    names = [axis.name for axis in env.observation_axes]
    assert names[:4] == ["position_north", "position_east", "velocity_north", "velocity_east"]
    assert names[4:12] == [
        "eyes_0_x",
        "eyes_0_y",
        "eyes_0_z",
        "eyes_0_velocity_x",
        "eyes_0_velocity_y",
        "eyes_0_velocity_z",
        "eyes_0_mate",
        "eyes_0_seen",
    ]
    assert names[28:] == ["lidar_0", "lidar_1", "lidar_2", "lidar_3"]
    space = env.observation_space("cat_0")
    assert space.low[4:7].tolist() == [-40.0] * 3
    assert space.high[10:12].tolist() == [1.0, 1.0]
    assert math.isinf(space.high[7])
    assert (space.low[28], space.high[28]) == (0.0, 100.0)
    seen, _ = env.reset(seed=4)
    actions = {agent: np.array([0.5, 0.0]) for agent in env.agents}
    for _ in range(2):
        seen, *_ = env.step(actions)
    vehicles = env.batch.episodes.episode(0).state.fleets
    places = np.concatenate([np.stack([fleet.vehicle.position_ned.stack()]).reshape(-1, 3) for fleet in vehicles])
    for number, agent in enumerate(env.agents):
        assert space.contains(seen[agent])
        found, away = seen[agent][4:28].reshape(3, 8), np.linalg.norm(places - places[number], axis=1)
        order = [other for other in np.argsort(away) if other != number and away[other] < 40.0]
        assert len(order) >= 2
        # The axes are those of the body, which heads north and tilts a little; distances are not turned.
        np.testing.assert_allclose(np.linalg.norm(found[: len(order), :3], axis=1), away[order], rtol=1e-4)
        north = places[order, 0] - places[number, 0]
        np.testing.assert_allclose(found[: len(order), 0], north, atol=0.15 * away[order].max())
        assert found[:, 6].tolist() == [float(other < 3) for other in order] + [0.0] * (3 - len(order))
        assert found[:, 7].tolist() == [1.0] * len(order) + [0.0] * (3 - len(order))
        assert (found[len(order) :] == 0.0).all()
        # All cats do the same, and the mouse does not.
        mates = found[: len(order)][found[: len(order), 6] == 1.0]
        assert np.abs(mates[:, 3:6]).max() < 0.5
        mouse = found[: len(order)][found[: len(order), 6] == 0.0]
        assert np.linalg.norm(mouse[:, 3:6], axis=1) > 1.0
        # At 10 m rays that lean down meet the ground, and no others.
        assert (seen[agent][28:] > 20.0).all()


@pytest.mark.long
def test_it_is_the_same_as_a_function() -> None:
    env = Functional.of(CATS)
    assert env.observation_axes == cats().observation_axes
    _, seen = jax.eval_shape(env.reset, jnp.uint32(4))
    assert seen.shape == (3, 4 + 3 * 8 + 4)
    assert Functional.of("cats_and_mouse/1A").observation_axes[4].name == "mouse_0_offset_north"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": {"senses": ["eye"]}}, r"task.senses: no sensor of fleet 'cats' is called 'eye'; did you mean 'eyes'"),
        ({"task": {"senses": ["gnss"]}}, "task.senses: 'gnss' is a sensor of type 'ideal_gnss'; allowed: ideal_neigh"),
        ({"task": {"senses": ["eyes", "eyes"]}}, "task.senses: 'eyes' is named twice"),
        ({"fleets": {"cats": {"sensors": {"eyes": {"slots": 0}}}}}, r"eyes.slots: 0 is out of range; allowed: 1 to 32"),
        ({"task": {"sense": ["eyes"]}}, "did you mean 'senses'"),
    ],
)
def test_what_cannot_be_seen_by_is_one_line(change: dict[str, Any], message: str) -> None:
    fleets = {"cats": {"sensors": {"eyes": EYES, "lidar": LIDAR} | {"eyes": {**EYES, "slots": 0}}}}
    with pytest.raises(ScenarioError, match=message) as refused:
        load_scenario({**CATS, **(change if "task" in change else {"fleets": fleets})})
    assert len(refused.value.problems) == 1


def test_the_baseline_needs_the_offsets() -> None:
    with pytest.raises(UsageError, match="policy baseline: it reads the offsets that the observation lacks"):
        baseline(cats().batch.functional.play)


@pytest.mark.long
def test_others_check_them() -> None:
    """PettingZoo and Gymnasium; noise, false alarms and a drawn reach stay within the bounds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        parallel_api_test(cats(), num_cycles=50)
        single = SingleTask(SPOT)
        check_env(single)
    assert isinstance(single.observation_space, gymnasium.spaces.Box)
    # 12 numbers of the task, the range below, four slots of four numbers, and 36 rays of at most 30 m.
    assert single.observation_space.shape == (12 + 1 + 16 + 36,)
    assert single.observation_space.high[12] == 50.0
    assert single.observation_space.high[-36:].tolist() == [30.0] * 36
    many = VectorTask(SPOT, num_envs=20)
    many.reset(seed=1)
    seen_false, reaches = 0, set()
    for _ in range(30):
        seen, *_ = many.step(np.tile(np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32), (20, 1)))
        assert many.observation_space.contains(seen)
        seen_false += int(seen[:, 12 + 1 + 3].sum())
        reaches |= set(seen[:, -1].round(3).tolist())
    # Nobody else is there.
    assert 300 * 0.3 < seen_false < 600 * 0.7
    assert len(reaches) > 10


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "fleet"), [("search_and_rescue/2A", "helicopters"), ("plume_mapping/3A", "helicopters")]
)
def test_dicts_have_an_entry_for_them(name: str, fleet: str) -> None:
    scenario = {
        "extends": name,
        "name": "seeing",
        "task": {"senses": ["lidar"]},
        "fleets": {fleet: {"sensors": {"lidar": LIDAR}}},
    }
    env = SingleTask(scenario)
    seen, _ = env.reset(seed=1)
    assert seen["sensed"].shape == (4,)
    assert [axis.name for axis in env.observation_axes["sensed"]] == ["lidar_0", "lidar_1", "lidar_2", "lidar_3"]
    assert env.observation_space.contains(seen)
    assert env.observation_space["sensed"].high.tolist() == [100.0] * 4
