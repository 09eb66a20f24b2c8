"""Episodes that are left early, and policies that are tried in the starts of more episodes."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.studies.learn.training import Plan, Training, in_parts

PLAN = Plan("keep_spot", ("duration=1",), shorter=("duration=0.5",), envs=2, tries=2, early=0.3, starts=3)


@pytest.mark.long
def test_half_of_the_episodes_are_left_early_and_more_are_tried_in_the_start() -> None:
    training = Training(PLAN)
    flights = training.flights
    flights.begin(np.array([1, 2]))
    ended = []
    for _ in range(5):
        outputs = np.zeros((2, len(training.view.flown)), np.float32)
        decided = flights.decide(outputs, training.view.action(outputs, flights.seen))
        assert not decided.terminated.any()
        ended.append(decided.ended.tolist())
        flights.follow(decided.ended)
    # Decisions take 0.1 s: the first of two episodes is left after 0.3 s, and the other ends after 0.5 s.
    assert ended == [[False, False], [False, False], [True, False], [False, False], [False, True]]
    assert isinstance(flights.batch, Batch)
    assert flights.batch.numbers.tolist() == [1, 1]
    _, flown = training._outcome(training._policy())
    assert training.starts is not None
    assert (training.trials.lasted.tolist(), training.starts.lasted.tolist(), flown) == ([10, 10], [5, 5, 5], 1.0)


def test_crashes_in_the_start_are_counted_in_the_starts() -> None:
    # The first of four whole episodes has crashed in the start, and the second later; so has one of ten starts.
    whole = np.array([-900.0, -1000.0, -4.0, -6.0]), np.array([False, False, True, True])
    later = np.array([False, True, True, True])
    starts = np.array([-950.0] + 9 * [0.0]), np.array([False] + 9 * [True])
    mean, flown = in_parts(whole, later, starts)
    # Nine tenths of -1010 / 3, and a tenth of -950; nine tenths of two thirds.
    assert (mean, flown) == pytest.approx((-398.0, 0.6))
    assert in_parts(whole, np.zeros(4, bool), starts) == (-477.5, 0.5)
