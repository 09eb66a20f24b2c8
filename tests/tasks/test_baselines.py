"""Baselines against simple worlds in which it is plain what they should do."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from qrsim.errors import UsageError
from qrsim.scenarios.scenario import load_scenario
from qrsim.tasks import Play
from qrsim.tasks.baselines import Chasing, Searching, baseline


def play(name: str | dict[str, Any]) -> Play:
    scenario = load_scenario(name)
    return Play(scenario.task(), scenario.world(), scenario.steps)


@pytest.mark.parametrize(("noise", "wind"), [(0.0, 0.0), (0.6, 0.15)])
def test_points_that_move_as_asked_keep_a_fleeing_mouse_in_the_area_and_end_near_it(noise: float, wind: float) -> None:
    """Points that take 0.7 s to follow, for 300 s; who does nothing loses the mouse after 47 s.

    With errors of measured places [m] that change slowly, and a wind that carries all of them [m/s].
    """
    game, carried = play("cats_and_mouse/1A"), np.array([wind, 0.0])
    short: Any = SimpleNamespace(world=game.world, task=game.task, agents=game.agents, axes=game.axes, steps=300)
    for seed in (0, 1, 2):
        numbers = np.random.default_rng(seed)
        angle = numbers.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi / 3.0 * np.arange(3)
        place = np.concatenate([17.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.zeros((1, 2))])
        velocity, error = np.zeros((4, 2)), noise * numbers.normal(size=(4, 2))
        chasing = Chasing(short)
        for _ in range(300):
            error = 0.98 * error + 0.2 * noise * numbers.normal(size=(4, 2))
            cats, mouse = (place + error)[:3], (place + error)[3]
            others = [cats[[(i + j) % 3 for i in range(3)]] - cats for j in (1, 2)]
            asked = 3.0 * chasing.act(np.concatenate([cats, velocity[:3], mouse - cats, *others], axis=1))
            for _ in range(10):
                offset = (place + error)[3] - (place + error)[:3]
                away = np.sum(offset / np.sum(offset**2, axis=1, keepdims=True), axis=0)
                wanted = np.concatenate([asked, 3.0 * away[None] / max(float(np.linalg.norm(away)), 1e-9)])
                velocity = velocity + 0.1 / 0.7 * (wanted + carried - velocity)
                place = place + 0.1 * velocity
            assert np.abs(place).max() < 140.0
            assert np.linalg.norm(place[:3] - place[3], axis=1).min() > 2.0
        assert np.linalg.norm(place[:3] - place[3], axis=1).max() < 10.0


def test_cats_of_many_episodes_fly_as_those_of_each() -> None:
    game = play("cats_and_mouse/1A")
    short: Any = SimpleNamespace(world=game.world, task=game.task, agents=game.agents, axes=game.axes, steps=60)
    seen = np.random.default_rng(4).normal(0.0, 20.0, (40, 2, 3, 10))
    alone, many = [Chasing(short), Chasing(short), Chasing(short)], Chasing(short)
    many.begin(2)
    for step, both in enumerate(seen):
        if step == 30:
            many.begin(2, np.array([1]))
        # The second row begins its next episode at step 30.
        expected = np.stack([alone[0].act(both[0]), alone[1 if step < 30 else 2].act(both[1])])
        np.testing.assert_array_equal(many.act(both), expected)


def test_cats_without_a_clock_are_near_while_the_mouse_is_led() -> None:
    game = play("cats_and_mouse/1A")
    # The mouse is 45 m north of the middle, where it is to run east; the cats are west of it, in their fan.
    mouse, angle = np.array([45.0, 0.0]), 0.8 * np.array([-1.0, 0.0, 1.0])
    way = -np.stack([np.sin(angle), np.cos(angle)], axis=1)

    def asked(behind: float, timeless: bool) -> float:
        """Return how fast the cat in the middle, so far behind, runs after the mouse [m/s]."""
        cats = mouse + np.array([[12.0], [behind], [12.0]]) * way
        seen = np.concatenate([cats, np.tile([0.0, 3.0], (3, 1)), mouse - cats, np.zeros((3, 4))], axis=1)
        north, east = 3.0 * Chasing(game, timeless=timeless).act(seen)[1]
        assert abs(north) < 0.01
        return float(east)

    # It is to be 4.4 m behind, and closes half of what it lacks in a second, up to its limit: 3.6 - 0.5 * 1.4.
    assert asked(6.0, timeless=True) == pytest.approx(3.0)
    assert asked(4.8, timeless=True) == pytest.approx(3.0)
    # At 3 m these are 2.9, and it would be 3.15 m from the mouse in 1.5 s: less by 2 for each metre that lacks of 4 m.
    assert asked(3.0, timeless=True) == pytest.approx(2.9 - 2.0 * 0.85)
    # With the whole episode before it, it is to be 9 m behind a mouse of 3 m/s: 3 - 0.7 * 3.
    assert asked(6.0, timeless=False) == pytest.approx(0.9)


def test_cats_without_a_clock_keep_clear_of_a_mouse_that_turns_round() -> None:
    # The mouse runs south at 3 m/s, towards a cat that meets it at 3 m/s. In 1.5 s they are 1 m apart: 7 m are
    # missing of 8 in front of it, 2 m/s for each. Of the 4 m behind it, nothing is missing to a cat that follows.
    velocity, offset = np.array([[3.0, 0.0], [-3.0, 0.0]]), np.array([[10.0, 0.0], [-4.4, 0.0]])
    found = Chasing._clear(velocity, np.array([[-1.0, 0.0]]), offset)
    np.testing.assert_allclose(found, [[-14.0, 0.0], [0.0, 0.0]])
    # Behind a mouse that runs where it is to run they are at 4.4 m and 3.6 m apart. With the mouse between two of them
    # it is 0.75 / 0.8 of the way to 9 m and 6 m.
    for second, behind, room in ((5.0, 4.4, 3.6), (-5.0, 8.7125, 5.85)):
        offset, length = np.array([[5.0, 0.0], [second, 0.0]]), np.full((2, 1), 5.0)
        far, apart = Chasing._by_state(np.zeros(1), offset, length)
        np.testing.assert_allclose(far, behind)
        np.testing.assert_allclose(apart, room)


@pytest.mark.long
def test_a_searcher_goes_down_where_windows_speak_for_a_person() -> None:
    """The windows that show one place say so again and again; after a hover there it goes on."""
    game = play("search_and_rescue/2A")
    short: Any = SimpleNamespace(world=game.world, task=game.task, agents=game.agents, axes=game.axes, steps=90)
    searcher = Searching(short)
    place, low = np.array([0.0, 0.0, -35.0]), np.inf
    path = []
    for _ in range(90):
        half = np.array([0.21, 0.28]) * max(-place[2], 1.0)
        rows, columns = max(1, round(2 * half[0] / 0.5)), max(1, round(2 * half[1] / 0.5))
        ratio = np.full((rows, columns), -2.0)
        north = place[0] + half[0] - (np.arange(rows) + 0.5) * 2.0 * half[0] / rows
        east = place[1] - half[1] + (np.arange(columns) + 0.5) * 2.0 * half[1] / columns
        ratio[(np.abs(north - 5.0) < 0.5)[:, None] & (np.abs(east - 2.0) < 0.5)] = 3.0
        corners = np.array([[half[0], -half[1]], [half[0], half[1]], [-half[0], half[1]], [-half[0], -half[1]]])
        vehicle = np.array([*place, *np.zeros(6)])
        seen = {
            "vehicle": vehicle[None],
            "ratio": ratio[None],
            "corners": (place[:2] + corners)[None],
            "grid": np.array([[rows, columns]]),
        }
        place = place + 3.0 * searcher.act(seen)[0]
        path.append(place)
        low = min(low, -place[2])
    nearest = min(np.linalg.norm(point - [5.0, 2.0, 0.0]) for point in path)
    assert nearest < 5.0
    assert low > 1.0
    assert np.linalg.norm(path[-1][:2] - [5.0, 2.0]) > 10.0, "it has gone on"


def test_a_task_without_a_baseline_says_so() -> None:
    part = {"vehicle": {"type": "multirotor", "model": "x500"}, "controller": {"type": "cascade"}}
    with pytest.raises(
        UsageError, match="it gives pitch, roll, throttle, yaw_rate, battery; these vehicles take pitch"
    ):
        baseline(play({"name": "x", "extends": "keep_spot", "fleets": {"pelicans": part}}))
