"""Pictures of episodes, and the state that a critic may know."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest

from qrsim.envs import parallel_env
from qrsim.envs.single import SingleTask
from qrsim.envs.vector import VectorTask
from qrsim.errors import UsageError
from qrsim.runs.colours import STOPPED, VEHICLES

HOVER = np.array([0.0, 0.0, 0.0, 0.0, 1.0], np.float32)
DIVE = np.array([1.0, 0.0, -1.0, 0.0, 1.0], np.float32)


def pixels(picture: Any, colour: Any) -> int:
    """Return how many pixels of a picture have a colour."""
    return int(np.all(np.asarray(picture) == np.asarray(colour, np.uint8), axis=-1).sum())


def test_a_picture_shows_where_a_vehicle_is_and_that_it_has_stopped() -> None:
    env: Any = gymnasium.make("qrsim/keep_spot-v0", render_mode="rgb_array")
    with pytest.raises(UsageError, match=r"call reset\(\) before render"):
        env.unwrapped.render()
    env.reset(seed=1)
    first = env.render()
    assert (first.shape, first.dtype) == ((480, 640, 3), np.uint8)
    assert env.metadata["render_fps"] == 50.0
    # A disc of 7 points across in the plan, and one of the height.
    assert pixels(first, VEHICLES[0]) > 60
    assert pixels(first, STOPPED) == 0
    ended = False
    while not ended:
        *_, ended, _, _ = env.step(DIVE)
    last = env.render()
    assert pixels(last, STOPPED) > 20
    env.reset()
    assert pixels(env.render(), STOPPED) == 0


@pytest.mark.parametrize("copy_of", [lambda item: pickle.loads(pickle.dumps(item)), copy.deepcopy])
def test_a_copy_draws_the_same(copy_of: Any) -> None:
    env = SingleTask("keep_spot", render_mode="rgb_array")
    env.reset(seed=1)
    env.step(HOVER)
    env.render()
    np.testing.assert_array_equal(copy_of(env).render(), env.render())


def test_each_environment_of_a_vector_has_a_picture() -> None:
    many = VectorTask("keep_spot", num_envs=2, render_mode="rgb_array")
    many.reset(seed=1)
    many.step(np.stack([HOVER, DIVE]))
    pictures = many.render()
    assert pictures is not None
    assert [picture.shape for picture in pictures] == [(480, 640, 3)] * 2
    assert VectorTask("keep_spot").render() is None


@pytest.mark.long
@pytest.mark.parametrize("name", ["search_and_rescue/2A", "plume_mapping/3B", "plume_mapping/3E", "goto_waypoint"])
def test_every_kind_of_task_is_drawn(name: str) -> None:
    env = SingleTask(name, render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    # The blue of the vehicle, the axes in black, and white in between.
    assert pixels(picture, VEHICLES[0]) > 60
    assert 0.5 < pixels(picture, (255, 255, 255)) / (480 * 640) < 0.98


def test_the_state_of_all_vehicles_is_what_the_infos_say() -> None:
    cats = parallel_env("cats_and_mouse/1A", render_mode="rgb_array")
    with pytest.raises(UsageError, match="nothing has begun"):
        cats.state()
    cats.reset(seed=1)
    *_, truth = cats.step({agent: np.array([0.5, -0.5], np.float32) for agent in cats.agents})
    state = cats.state()
    # Three cats and the mouse, 13 numbers each, and the part that is over: a second of 1000.
    assert cats.state_space.contains(state)
    assert state.shape == (4 * 13 + 1,)
    assert state[-1] == pytest.approx(0.001)
    rows = state[:-1].reshape(4, 13)
    for i, agent in enumerate(cats.possible_agents):
        for first, name in ((0, "position_ned"), (3, "attitude"), (6, "velocity_body")):
            np.testing.assert_array_equal(rows[i, first : first + 3], truth[agent][name])
    assert rows[:, 12].tolist() == [0.0] * 4
    picture = cats.render()
    assert all(pixels(picture, VEHICLES[i]) > 30 for i in range(4))


@pytest.mark.long
def test_a_video_can_be_recorded(tmp_path: Any) -> None:
    pytest.importorskip("moviepy", reason="needs moviepy: pip install moviepy")
    env: Any = gymnasium.make(
        "qrsim/keep_spot-v0",
        render_mode="rgb_array",
        scenario={"extends": "keep_spot", "name": "short", "duration": 0.2},
    )
    with gymnasium.wrappers.RecordVideo(env, str(tmp_path)) as recorded:
        recorded.reset(seed=1)
        while not recorded.step(HOVER)[3]:
            pass
    assert (tmp_path / "rl-video-episode-0.mp4").stat().st_size > 1000
