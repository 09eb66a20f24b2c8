"""Keeping a formation by radio: what is heard becomes offsets to places, the rewards, the baseline, wrong scenarios."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from evidence.returns import fly

from qrsim.control import Estimate
from qrsim.core.vectors import Euler, Vec3
from qrsim.envs.batch import Batch
from qrsim.envs.objective import InFormation, objective_of
from qrsim.errors import ScenarioError
from qrsim.models.radio.contracts import Inbox
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks.baselines import baseline
from qrsim.tasks.baselines.consensus import Consensus
from qrsim.tasks.formation import FormationMemory, KeepFormation

KIND: Any = KeepFormation


def vectors(*rows: tuple[float, float, float]) -> Vec3:
    """Return positions (n,) NED."""
    return Vec3(*(jnp.asarray(axis, jnp.float32) for axis in zip(*rows, strict=True)))


def one_leader_and_two_followers(*followers: tuple[float, float, float]) -> tuple[Any, Any]:
    """Return a world and a state: the leader at 1 m north, the followers where they are told to be.

    Their places are 4 m west and 4 m east of the leader, and 3 m behind it.
    """
    starts = vectors((-3.0, -4.0, -10.0), (-3.0, 4.0, -10.0))
    leaders = SimpleNamespace(name="leaders", size=1, start=SimpleNamespace(position_ned=vectors((0.0, 0.0, -10.0))))
    route = SimpleNamespace(position_ned=starts.map(lambda axis: axis[None]))
    fleets = (leaders, SimpleNamespace(name="followers", size=2, route=route))
    rows = {"leaders": slice(0, 1), "followers": slice(1, 3)}
    world = SimpleNamespace(fleets=fleets, rows_of=rows.__getitem__, time_step=0.02)
    own = vectors(*followers)
    zero = jnp.zeros(2, jnp.float32)
    estimate = Estimate(own, own.map(jnp.zeros_like), Euler(zero, zero, zero))
    states = (
        SimpleNamespace(vehicle=SimpleNamespace(position_ned=vectors((1.0, 0.0, -10.0)))),
        SimpleNamespace(vehicle=SimpleNamespace(position_ned=own), readings=(), estimate=estimate),
    )
    return world, SimpleNamespace(fleets=states)


def test_what_is_heard_becomes_offsets_to_the_own_place() -> None:
    world, state = one_leader_and_two_followers((0.0, -4.0, -10.0), (0.0, 5.0, -12.0))
    # The first follower hears the leader, 0.5 s ago at 2 m/s north, and nobody else; the second its mate, without age,
    # and a leader without a fix.
    payload = np.zeros((3, 2, 7), np.float32)
    payload[1, 1, :6] = 1.0, 0.0, -10.0, 2.0, 0.0, 0.0
    payload[2, 0, :6] = 0.0, -4.0, -10.0, 0.0, 1.5, 0.0
    payload[2, 1, :6] = np.nan
    sender = np.array([[-1, -1], [-1, 0], [1, 0]], np.int32)
    age = np.where(sender >= 0, np.float32(0.0), np.float32(np.nan))
    age[1, 1] = 0.5
    inbox = Inbox(*map(jnp.asarray, (payload, sender, age, age, sender >= 0)))
    seen = np.asarray(KIND().observe_received(None, world, state, inbox))
    assert seen.shape == (2, 25)
    # The leader is at 2 m north by now, so the place is at (-1, -4, -10) m.
    assert seen[0, 9:].tolist() == [-1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.5, 1.0] + [0.0] * 8
    # The mate is 8 m west of the second follower's place.
    assert seen[1, 9:].tolist() == [0.0] * 8 + [0.0, -1.0, 2.0, 0.0, 1.5, 0.0, 0.0, 1.0]
    assert not np.asarray(KIND().observe(None, world, state))[:, 9:].any()
    axes = [axis.name for axis in KIND().sees(world)]
    assert (len(axes), axes[9], axes[15:18]) == (
        25,
        "to_place_north",
        ["leader_age", "leader_heard", "mate_1_to_place_north"],
    )


def test_rewards_are_shares_of_the_mean_squared_error_and_a_crash_returns_the_penalty() -> None:
    # The places are at (-2, -4, -10) and (-2, 4, -10) m: one vehicle is 2 m off, the other 50 m.
    world, state = one_leader_and_two_followers((0.0, -4.0, -10.0), (-2.0, 4.0, -60.0))
    task = KIND(penalty=jnp.float32(-900.0), period=0.04)
    truth = task.truth(None, world, state)["to_place_ned"]
    assert np.asarray(truth).tolist() == [[-2.0, 0.0, 0.0], [0.0, 0.0, 50.0]]
    memory: Any = FormationMemory(jnp.zeros(2), jnp.zeros(2))
    for _ in range(2):
        memory = task.each_tick(memory, world, state)
    memory, reward = task.judge(memory, world, state, 1, 10)
    # A tenth of 4 m^2; and of 900 m^2, as no error counts more than a crash.
    np.testing.assert_allclose(reward, [-0.4, -90.0], rtol=1e-5)
    np.testing.assert_allclose(reward + task.crashed(memory, world, state, 10), -900.0, rtol=1e-5)


def test_the_baseline_weighs_those_that_it_hears() -> None:
    seen = np.zeros((3, 33), np.float32)
    others = seen[:, 9:].reshape(3, 3, 8)
    # Everybody; a mate alone; nobody.
    others[0] = [[2.0, 0, 0, 1.0, 0, 0, 0, 1], [0, 2.0, 0, 9.0, 9.0, 0, 0, 1], [0, 0, 2.0, 9.0, 9.0, 0, 0, 1]]
    others[1, 2] = [1.0, 0, 0, 0, 0.5, 0, 0, 1]
    play: Any = SimpleNamespace(axes=[SimpleNamespace(high=3.0)])
    found = 3.0 * Consensus(play).act(seen)
    # Half of 0.5 / s times 2 m by the leader, whose velocity counts, and a quarter by each mate.
    np.testing.assert_allclose(found, [[1.5, 0.25, 0.25], [0.5, 0.5, 0.0], [0.0, 0.0, 0.0]], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("task.leader=leader", "task.leader: no fleet is called 'leader'; did you mean 'leaders'"),
        ("task.leader=followers", "task.leader: 'followers' is the fleet of the agents"),
        ("world.radio=null", "world.radio: the task 'keep_formation' needs one; give a preset"),
        ("world.radio.beacon=false", "needs beacons; give world.radio beacon: true and a size of at least 6"),
        ("fleets.leaders.radio=none", "fleets.leaders.radio: none; the task 'keep_formation' needs one"),
    ],
)
def test_a_formation_without_leader_or_radio_is_refused(change: str, message: str) -> None:
    with pytest.raises(ScenarioError) as error:
        load_scenario("keep_formation", [change])
    assert message in str(error.value)


@pytest.mark.long
def test_what_the_baseline_hovering_and_a_fall_return() -> None:
    """One world: the baseline keeps its places, hovering does not, and a fall returns the penalty."""
    flown = Batch("keep_formation", 4, ["duration=20"])
    play = flown.functional.play
    policies = [baseline(play, seed) for seed in range(4)]
    kept, alive = fly(flown, lambda _, seen: np.stack([p.act(each) for p, each in zip(policies, seen, strict=True)]))
    # Satellites place vehicles next to each other alike, and gusts move them by half a metre.
    assert alive.all()
    assert ((kept > -3.0) & (kept < -0.05)).all()
    objective = objective_of(flown, 0.98)
    assert isinstance(objective, InFormation)
    away = np.linalg.norm(flown.truth["to_place_ned"], axis=-1)
    np.testing.assert_allclose(objective.errors(flown), away.ravel(), rtol=1e-5)
    # The leader flies 20 m north, then 10 m east, at 1.5 m/s.
    hovered, _ = fly(flown, 0.0)
    assert (hovered < -100.0).all()
    fallen, alive = fly(flown, np.array([0.0, 0.0, 1.0]))
    assert not alive.any()
    np.testing.assert_allclose(fallen, -1000.0, rtol=1e-5)
