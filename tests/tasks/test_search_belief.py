"""Belief maps of the search: where a picture was taken, what it says of a cell, and what is left to look at."""

from __future__ import annotations

import numpy as np
import pytest

from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import Play
from qrsim.tasks.baselines.belief import Belief, view
from qrsim.tasks.baselines.coverage import Coverage
from qrsim.tasks.baselines.separation import apart
from qrsim.tasks.baselines.visiting import over_ground

# A camera of 1280 x 960 px and 2280 px focal length at 45 m, level and heading north: 51 x 38 windows of 25 x 25 px
# from 2 px left and 5 px top of the picture, and the rectangle on the ground that they show.
GRID = np.array([38, 51])
SCALE = 45.0 / 2280.0
CORNERS = SCALE * np.array([(475.0, -638.0), (475.0, 637.0), (-475.0, 637.0), (-475.0, -638.0)])


def search() -> Play:
    scenario = load_scenario("search_and_rescue/2A")
    return Play(scenario.task(), scenario.world(), scenario.steps)


def test_the_pose_of_a_picture_is_in_its_corners() -> None:
    shown = view(CORNERS + np.array([10.0, -20.0]), GRID, Belief(search()).camera)
    np.testing.assert_allclose(shown.place, [10.0, -20.0, -45.0], atol=1e-6)
    middle = shown.windows @ [10.0, -20.0, 1.0]
    np.testing.assert_allclose(middle[:2] / middle[2], [638.0 / 25.0, 475.0 / 25.0], atol=1e-6)


def test_a_window_speaks_for_the_cell_that_it_shows_and_against_others() -> None:
    """Row 18, column 25 shows 0.01 m south to 0.5 m north of the middle of the picture, and 0.25 m on either side."""
    belief = Belief(search())
    ratio = np.full((68, 90), -3.0)
    ratio[18, 25] = 8.0
    shown = view(CORNERS, GRID, belief.camera)
    belief.look(ratio, shown, CORNERS, GRID)
    point, odds = belief.best(np.zeros(2), 8.0)
    assert np.abs(point).max() < 0.75
    # 7.5 persons on the inner 38400 m2, in cells of 0.25 m2.
    assert belief.prior == pytest.approx(-9.9269, abs=1e-3)
    assert odds > belief.prior + 1.0
    far, less = belief.best(np.array([5.0, 5.0]), 2.0)
    assert less < belief.prior - 1.0
    assert np.linalg.norm(far - point) > 2.0


def test_pictures_of_a_person_make_it_suspected_once_and_a_visit_ends_it() -> None:
    belief = Belief(search())
    ratio = np.full((68, 90), -3.0)
    ratio[18:20, 24:27] = 3.0
    for _ in range(4):
        belief.look(ratio, view(CORNERS, GRID, belief.camera), CORNERS, GRID)
    found = belief.suspected(0.0, 3.0)
    assert len(found) == 1
    assert np.abs(found[0]).max() < 1.0
    belief.forget(found[0], 2.5)
    assert len(belief.suspected(0.0, 3.0)) == 0


def test_nobody_is_expected_at_the_edge_of_the_area() -> None:
    """Persons lie in the inner 80 %: 122.47 m less 10 % of 244.95 m are 97.98 m."""
    belief = Belief(search())
    assert belief.best(np.array([95.0, 0.0]), 1.0)[1] == pytest.approx(belief.prior)
    assert belief.best(np.array([110.0, 0.0]), 1.0)[1] == -25.0


def test_evidence_of_a_window_falls_with_distance() -> None:
    """Kullback-Leibler divergence of the two scores, by hand: at 35 m N(0.54, 0.03715) from N(0.416, 0.0634)."""
    coverage = Coverage(np.array([-50.0, -50.0]), np.array([100.0, 100.0]), Belief(search()).camera)
    assert coverage.evidence(35.0) == pytest.approx(2.119, abs=0.005)
    assert coverage.evidence(50.0) == pytest.approx(0.468, abs=0.005)
    assert coverage.evidence(75.0) == coverage.evidence(50.0)


def test_a_vehicle_turns_to_what_nobody_has_seen() -> None:
    low, extent = np.array([-50.0, -50.0]), np.array([100.0, 100.0])
    coverage = Coverage(low, extent, Belief(search()).camera)
    north = np.stack(np.meshgrid(np.arange(-49.0, 50.0), np.arange(-49.0, 50.0)), axis=-1).reshape(-1, 2)
    for _ in range(10):
        coverage.look(north[north[:, 0] > -20.0], 25.0)
    way = coverage.heading(0, np.zeros((1, 2)), np.zeros(2), 20.0, 0.0)
    assert way[0] < -0.7
    for _ in range(10):
        coverage.look(north, 25.0)
    assert not coverage.heading(0, np.zeros((1, 2)), np.zeros(2), 20.0, 0.0).any()


def test_nobody_is_pushed_into_the_ground() -> None:
    """At 2.5 m, 7.5 m below another one: 0.45 1/s of the half metre above 2 m is left, of a push of 4.5 m/s down."""
    place = np.array([[0.0, 0.0, -2.5], [0.0, 0.0, -10.0], [90.0, 0.0, -1.0]])
    pushed = apart(place, 12.0)
    np.testing.assert_allclose(pushed[:, 2], [4.5, -4.5, 0.0])
    np.testing.assert_allclose(over_ground(pushed, place), [[0.0, 0.0, 0.225], [0.0, 0.0, -4.5], [0.0, 0.0, -0.45]])
