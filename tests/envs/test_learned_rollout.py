"""A learned policy in a rollout flies as it does in an environment of the same seed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import qrsim
from qrsim.envs.batch import Batch
from qrsim.envs.learned import rollout_policy
from qrsim.envs.viewing import view_of
from qrsim.errors import CompilerWarning, UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks.learned import PolicyFile, Scaling

SHORT = ["duration=1"]


@pytest.mark.long
def test_a_rollout_flies_as_an_environment_does(tmp_path) -> None:
    batch = Batch("keep_spot", 2, SHORT)
    view = view_of(batch.functional, integral=True)
    assert view.summed == (9, 10, 11)
    assert view.observed[view.kept[0]] == "velocity_north"
    draw = np.random.default_rng(5)
    layers = tuple(
        (draw.normal(0.0, 0.5, shape).astype(np.float32), draw.normal(0.0, 0.6, shape[1]).astype(np.float32))
        for shape in ((view.inputs, 4), (4, len(view.flown)))
    )
    scaling = Scaling(np.zeros(view.inputs, np.float32), np.ones(view.inputs, np.float32))
    path = tmp_path / "policy.npz"
    path.write_bytes(PolicyFile(view, scaling, layers, {}).content())

    # The environments, one after the other: a policy is of the agents of an episode.
    batch.reset([3, 4])
    pilots = [PolicyFile(view, scaling, layers, {}).pilot(1, 0.02) for _ in range(2)]
    for _ in range(50):
        batch.step(np.stack([pilot.act(seen) for pilot, seen in zip(pilots, batch.seen, strict=True)]))
    scenario = load_scenario("keep_spot", SHORT)
    policy = rollout_policy(path, scenario)
    assert policy.ticks == 1
    with pytest.warns(CompilerWarning, match="dot_general"):
        found = qrsim.rollout(
            scenario,
            policy,
            seeds=[3, 4],
            record=lambda state: state.fleets[0].vehicle.position_ned.stack(),
            record_every=50,
        )
    np.testing.assert_allclose(found.recorded[:, -1, 0], batch.truth["position_ned"][:, 0], atol=2e-3)
    moved = np.abs(batch.truth["position_ned"][:, 0] - [0.0, 0.0, -10.0]).max(axis=1)
    assert moved.min() > 0.05


def test_a_scenario_without_a_task() -> None:
    with pytest.raises(UsageError, match=r"--policy some\.npz: scenario hover has no task"):
        rollout_policy("some.npz", load_scenario("hover"))


def test_a_decision_divides_the_episode() -> None:
    functional = Batch("keep_spot", 2, SHORT).functional
    assert view_of(functional).seconds == 0.1
    # 51 ticks are no multiple of five or four, but of three.
    longer = dataclasses.replace(functional, play=qrsim.core.tree.replace(functional.play, length=np.int32(51)))
    assert view_of(longer).seconds == 0.06
