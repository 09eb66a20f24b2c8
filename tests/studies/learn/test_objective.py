"""The learner's reward by hand: an error of position that falls from 3 m to 2 m, with and without a crash."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.studies.learn.objective import CRASH, Reached


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
