"""Bounds of observations: where there are some they hold, and they are those of the scenario."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from gymnasium import spaces

from qrsim.envs import SEVERAL, SINGLE
from qrsim.envs.batch import Batch
from qrsim.envs.single import SingleTask
from qrsim.envs.spaces import observation_space

EPISODES, STEPS = 20, 12
# Of a family of tasks one variant is flown by day.
BY_DAY = ("cats_and_mouse/1A", "search_and_rescue/2B", "plume_mapping/3F")


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=(pytest.mark.nightly,) if "/" in n and n not in BY_DAY else ())
        for n in (*SINGLE, *SEVERAL)
    ],
)
def test_random_episodes_stay_inside(name: str) -> None:
    batch = Batch(name, EPISODES)
    batch.reset(np.arange(EPISODES))
    space = observation_space(batch.functional.play, batch.seen)
    agents, axes = len(batch.functional.agents), len(batch.functional.play.axes)
    random = np.random.default_rng(5)
    for step in range(STEPS):
        for row in range(EPISODES):
            for agent in range(agents):
                seen = jax.tree.map(lambda leaf, row=row, agent=agent: leaf[row, agent], batch.seen)
                assert space.contains(seen), (name, step, row, agent)
        _, terminated, truncated = batch.step(random.uniform(-1.0, 1.0, (EPISODES, agents, axes)))
        ended = np.flatnonzero(terminated | truncated)
        if len(ended):
            batch.again(ended)


@pytest.mark.long
def test_pictures_have_no_more_windows_than_there_is_room_for() -> None:
    grid: Any = SingleTask("search_and_rescue/2A").observation_space
    # Room for 68 rows of 90 columns.
    assert grid["grid"] == spaces.Box(0, np.array([68, 90], np.int32), (2,), np.int32)


@pytest.mark.long
def test_locations_are_in_the_area() -> None:
    area = ["world.area.x_min=-50", "world.area.x_max=60", "world.area.y_min=-70", "world.area.y_max=80"]
    env = SingleTask("plume_mapping/3A", overrides=[*area, "world.area.z_min=-90", "world.area.z_max=0"])
    space: Any = env.observation_space
    found = space["locations"]
    assert found.shape == (100, 3)
    assert (found.low == [-50.0, -70.0, -90.0]).all()
    assert (found.high == [60.0, 80.0, 0.0]).all()
    seen, _ = env.reset(seed=1)
    # Of twenty places anywhere some are in the outer parts.
    assert np.ptp(seen["locations"], axis=0).min() > 40.0
    assert env.observation_axes["locations"][3].name == "location_1_north"  # type: ignore[call-overload]
