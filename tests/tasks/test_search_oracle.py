"""Tours of the oracle of a search, and how vehicles come to rest near a person."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.envs.scoring import maker, play_policy
from qrsim.errors import UsageError
from qrsim.tasks.baselines.tours import length, tours, untangled
from qrsim.tasks.baselines.visiting import toward


def test_two_opt_takes_the_crossing_out_of_a_square() -> None:
    """Corners of a square of 10 m in crossed order: 10 + 14.14 + 10 + 14.14 m; along three sides 30 m from a corner."""
    start, points = np.array([0.0, 0.0]), np.array([[10.0, 10.0], [10.0, 0.0], [0.0, 10.0]])
    assert length(start, points, [0, 1, 2]) == pytest.approx(38.2843, abs=1e-4)
    best = untangled(start, points, [0, 1, 2])
    assert length(start, points, best) == pytest.approx(30.0)
    assert best in ([1, 0, 2], [2, 0, 1])


def test_every_vehicle_takes_the_points_of_its_side() -> None:
    """Two vehicles 100 m apart with three points in a row beyond each: each goes straight along its own."""
    starts = np.array([[0.0, 0.0], [0.0, 100.0]])
    points = np.array([[0.0, -30.0], [0.0, 110.0], [0.0, -10.0], [0.0, 130.0], [0.0, -20.0], [0.0, 120.0]])
    assert tours(starts, points, 5.0) == [[2, 4, 0], [1, 5, 3]]


def test_nobody_to_visit_is_no_tour() -> None:
    assert tours(np.zeros((2, 2)), np.zeros((0, 2)), 5.0) == [[], []]


def test_a_vehicle_comes_to_rest_where_a_person_is_found() -> None:
    """A point that takes 0.7 s to follow, for 40 s over 60 m: within 5 m of the person in the end, and at rest."""
    place, velocity = np.array([0.0, 0.0, -45.0]), np.zeros(3)
    person = np.array([50.0, -30.0])
    for _ in range(40):
        asked = toward(place, person)
        assert np.abs(asked).max() <= 3.0
        for _ in range(10):
            velocity = velocity + 0.1 / 0.7 * (asked - velocity)
            place = place + 0.1 * velocity
    assert np.linalg.norm(place - [*person, 0.0]) < 5.0
    assert -place[2] > 2.0
    assert np.linalg.norm(velocity) < 0.1


@pytest.mark.long
def test_the_oracle_finds_who_lies_within_its_reach() -> None:
    """In 60 s a vehicle of 3 m/s visits two persons or more, hovering in place none, for -1 in all."""
    batch = Batch("search_and_rescue/2A", 1, ["duration=60"])
    found = play_policy(batch, "oracle", maker("oracle", batch.functional.play), np.array([5]))
    assert found.alive.all()
    assert found.returns[0] > 0.9
    people = batch.episodes.episode(0).state.contents.persons
    assert found.returns[0] == pytest.approx(int(np.sum(people.found_tick >= 0)) - 1.0, abs=0.1)


def test_a_task_without_an_oracle_says_so() -> None:
    play = Batch("keep_spot", 1).functional.play
    with pytest.raises(UsageError, match="policy oracle: this task has none; a search has"):
        maker("oracle", play)
