"""The learner's reward by hand: an error of position that falls from 3 m to 2 m, with and without a crash."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.envs.objective import CRASH, Reached, Steady, objective_of


@pytest.mark.parametrize(
    ("crashed", "expected"),
    [
        # A tenth of: 0.5 (3 - 0.98 * 2) of potential, less 0.02 s of log(1 + 2^2), of 0.1 * 2 and of 0.05 * 0.6^2.
        (False, 0.1 * (0.52 - 0.02 * (np.log(5.0) + 0.2 + 0.018))),
        # The potential of the end is zero: 0.5 * 3, and a crash costs 110.
        (True, 0.1 * (1.5 - 0.02 * (np.log(5.0) + 0.2 + 0.018) - 110.0)),
    ],
)
def test_what_a_step_earns(crashed: bool, expected: float, monkeypatch: pytest.MonkeyPatch) -> None:
    batch = Batch("keep_spot", 1, ["duration=1"])
    assert batch.functional.play.task.period == 0.02
    objective, errors = Reached(batch, 0.98), iter([3.0, 2.0])
    monkeypatch.setattr(objective, "errors", lambda batch: np.array([next(errors)]))
    objective.begin(batch)
    found = objective.reward(batch, np.zeros((1, 1)), np.array([crashed]), np.array([[0.6]]))
    assert found.tolist() == pytest.approx([expected], rel=1e-5)


def test_no_crash_is_cheaper_than_the_longest_way() -> None:
    # 120 m away forever, at a discount of 0.98 for each decision of 0.1 s.
    assert sum(0.98**k * 0.1 * (np.log1p(120.0**2) + 0.1 * 120.0) for k in range(2000)) < CRASH < 120.0


def test_cats_share_half_of_what_the_distance_costs_them() -> None:
    batch = Batch("cats_and_mouse/1A", 1, ["duration=4"])
    batch.reset([1])
    objective = objective_of(batch, 0.98)
    # A collision is below 2 m, a catch at twice that. A mouse 5 m, 6 m or 2.5 m away is missed by 1 m, 2 m or nothing.
    batch.seen[0] = 0.0
    for row, north in enumerate((5.0, 6.0, 2.5)):
        batch.seen[0, row, 4:10] = north, 0.0, 9.0, 0.0, 0.0, 9.0
    objective.begin(batch)
    found = objective.reward(batch, np.zeros((1, 3)), np.array([False]), np.zeros((3, 2)))
    # 0.03 of: the potential 0.5 (1 - 0.98) of each metre, less log(1 + e^2) + 0.12 e for 1 s. The third has 2 m of room
    # less than the 4.5 m that it wants to have from everybody, which costs 3 * 2^2.
    own = [0.01 * e - np.log1p(e * e) - 0.12 * e for e in (1.0, 2.0, 0.0)]
    own[2] -= 12.0
    np.testing.assert_allclose(found, 0.03 * (0.5 * np.array(own) + 0.5 * np.mean(own)), rtol=1e-5)
    # The mouse 80 m north and 60 m east is 39.8 m beyond 0.43 of half of 280 m: a drop of 0.3 each, when it gets there.
    batch.seen[0, :, 0:2] = [[75.0, 60.0], [74.0, 60.0], [77.5, 60.0]]
    farther = objective.reward(batch, np.zeros((1, 3)), np.array([False]), np.zeros((3, 2)))
    np.testing.assert_allclose(farther - found, -0.03 * 0.98 * 0.3 * 39.8, rtol=1e-4)


def test_a_velocity_that_is_always_a_little_wrong_costs_more_and_more() -> None:
    batch = Batch("keep_velocity", 2, ["duration=2", "task.velocity_north=1.5"])
    batch.reset([1, 2])
    objective = objective_of(batch, 0.98)
    assert isinstance(objective, Steady)
    objective.begin(batch)
    # At rest with the heading north, wanted is 1.5 m/s north; nothing has drifted yet.
    batch.truth["velocity_body"][:] = 0.0
    np.testing.assert_allclose(objective.errors(batch), 1.5, atol=1e-5)
    nothing = (np.zeros((2, 1)), np.zeros(2, bool), np.zeros((2, 4)))
    for _ in range(4):
        objective.reward(batch, *nothing)
    # Four steps of 0.02 s at 1.5 m/s are 0.12 m, of which half counts for each second.
    np.testing.assert_allclose(objective.errors(batch), 1.5 + 0.06, atol=1e-5)
    # The next episode of the second row begins without.
    objective.begin(batch, np.array([False, True]))
    np.testing.assert_allclose(objective.errors(batch), [1.56, 1.5], atol=1e-5)
