"""A pursuit in which the mouse is an agent too."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pettingzoo.test import api_test, parallel_api_test
from pettingzoo.utils.conversions import parallel_to_aec

from qrsim import cli
from qrsim.envs import Functional, parallel_env
from qrsim.envs.batch import Batch
from qrsim.envs.parallel import ParallelTask
from qrsim.envs.scoring import Scored, maker, play_policy
from qrsim.errors import QrsimError
from qrsim.runs.summary import score_text
from qrsim.tasks.baselines import Fleeing

BOTH = "task.mouse=agent"
CATS = ("cat_0", "cat_1", "cat_2")


@cache
def pursuit() -> ParallelTask:
    return parallel_env("cats_and_mouse/1A", overrides=[BOTH, "duration=2.0"])


@pytest.mark.long
def test_both_sides_are_agents() -> None:
    env = pursuit()
    assert env.possible_agents == [*CATS, "mouse"]
    # Own place and velocity, and the ways to one mouse and two cats, or to three cats.
    assert [env.observation_space(agent).shape for agent in env.possible_agents] == [(10,), (10,), (10,), (10,)]
    names = [axis.name for axis in env.observation_axes["mice"]]  # type: ignore[call-overload]
    assert names[4:] == [f"cat_{i}_offset_{axis}" for i in range(3) for axis in ("north", "east")]
    assert env.action_space("mouse").shape == (2,)


def test_what_the_mouse_sees_is_the_way_to_each_cat() -> None:
    seen, truth = pursuit().reset(seed=2)
    mouse = truth["mouse"]["position_ned"][:2]
    for i, cat in enumerate(CATS):
        way = truth[cat]["position_ned"][:2] - mouse
        assert seen["mouse"][4 + 2 * i : 6 + 2 * i] == pytest.approx(way, abs=1e-3)
        assert seen[cat][4:6] == pytest.approx(-way, abs=1e-3)


def test_what_cats_lose_the_mouse_gains() -> None:
    env = pursuit()
    env.reset(seed=2)
    still = dict.fromkeys(env.possible_agents, np.zeros(2, np.float32))
    _, first, *_ = env.step(still)
    _, last, _, truncated, truth = env.step(still)
    assert set(first.values()) == {0.0}
    assert all(truncated.values())
    mouse = truth["mouse"]["position_ned"]
    away = [float(np.linalg.norm(truth[cat]["position_ned"] - mouse)) for cat in CATS]
    # The reach is two collision distances of 2 m.
    expected = -sum((distance - 4.0) ** 2 for distance in away)
    assert expected < -100.0
    assert [last[cat] for cat in CATS] == pytest.approx([expected] * 3, rel=1e-4)
    assert last["mouse"] == pytest.approx(-expected, rel=1e-4)


@pytest.mark.long
def test_a_mouse_that_leaves_the_area_gains_nothing() -> None:
    env = parallel_env("cats_and_mouse/1A", overrides=[BOTH, "duration=12.0", "world.area.x_max=25.0"])
    env.reset(seed=2)
    north = dict.fromkeys(CATS, np.zeros(2, np.float32)) | {"mouse": np.array([1.0, 0.0], np.float32)}
    while env.agents:
        _, rewards, terminated, *_ = env.step(north)
    assert all(terminated.values())
    assert set(rewards.values()) == {-1000.0}


def test_pettingzoo_takes_it_in_both_forms() -> None:
    parallel_api_test(pursuit(), num_cycles=10)
    api_test(parallel_to_aec(pursuit()), num_cycles=10)


def test_its_baseline_runs_as_the_script_does() -> None:
    # Cats 3 m north, 4 m east and far off: the sum of d/|d|^2 away from them is -(1/3, 1/4), along -(0.8, 0.6).
    play = Functional.of("cats_and_mouse/1A", [BOTH]).play
    far = [3.0, 0.0, 0.0, 4.0, 0.0, 4.0e6]
    act = Fleeing(play).act(np.array([[0.0, 0.0, 0.0, 0.0, *far]]))
    assert act == pytest.approx(np.array([[-0.8, -0.6]]), abs=1e-5)


def flown(mouse: str) -> tuple[Scored, np.ndarray]:
    batch = Batch("cats_and_mouse/1A", 2, ["task.period=0.02", "duration=4.0", f"task.mouse={mouse}"])
    scored = play_policy(batch, "baseline", maker("baseline", batch.functional.play), np.arange(2))
    return scored, np.asarray(batch.episodes.episode(1).state.fleets[1].vehicle.position_ned.stack())


@pytest.mark.long
def test_with_both_baselines_the_episode_is_that_of_the_script() -> None:
    # The script looks at every tick, so here agents act at every tick; what NumPy and the compiled guidance round
    # differently is left.
    (script, place), (agent, same) = flown("scripted"), flown("agent")
    assert np.linalg.norm(place[0, :2]) > 3.0
    assert same == pytest.approx(place, abs=1e-3)
    assert agent.returns == pytest.approx(script.returns, rel=1e-4)
    assert agent.others["mice"] == pytest.approx(-script.returns, rel=1e-4)
    assert script.others == {}


@pytest.mark.long
def test_run_and_score_tell_both_sides(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    told = ["--policy", "baseline", "--set", "duration=4", "--set", BOTH, "--json"]
    assert cli.main(["score", "cats_and_mouse/1A", "--first-seed", "3", "--seeds", "1", *told]) == 0
    scored = json.loads(capsys.readouterr().out)["policies"][0]
    assert scored["others"]["mice"]["mean"] == pytest.approx(-scored["mean"])
    assert scored["mean"] < -10.0
    run = ["run", "cats_and_mouse/1A", "--seed", "3", "--out", str(tmp_path / "kept"), "--no-figure"]
    assert cli.main([*run, *told]) == 0
    score = json.loads(capsys.readouterr().out)["score"]
    assert score["return"] == pytest.approx(scored["mean"], rel=1e-3)
    assert score["fleets"] == pytest.approx({"cats": score["return"], "mice": -score["return"]})
    assert f"{score['return']:.4g}, mean of cats; mice {-score['return']:.4g} (" in score_text(score)


def test_who_flies_the_mouse_is_one_of_two() -> None:
    with pytest.raises(QrsimError, match=r"task.mouse: .*scripted.*agent"):
        Functional.of("cats_and_mouse/1A", ["task.mouse=agents"])


def test_functions_take_both_by_fleet() -> None:
    pure = Functional.of("cats_and_mouse/1A", [BOTH])
    episode, seen = jax.eval_shape(pure.reset, np.uint32(3))
    assert {fleet: part.shape for fleet, part in seen.items()} == {"cats": (3, 10), "mice": (1, 10)}
    _, step = jax.eval_shape(pure.step, episode, {"cats": jnp.zeros((3, 2)), "mice": jnp.zeros((1, 2))})
    assert step.reward.shape == (4,)
