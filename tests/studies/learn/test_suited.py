"""Plans of trainings: a pursuit has other numbers than a task of one vehicle, and is seen towards the mouse."""

from __future__ import annotations

import pytest

from qrsim.envs.functional import Functional
from qrsim.envs.viewing import view_of
from qrsim.errors import QrsimError
from qrsim.studies.learn.ppo import Settings
from qrsim.studies.learn.suited import plan_of


def test_a_task_of_one_vehicle_has_the_defaults() -> None:
    plan = plan_of("keep_spot", ("duration=5",), seed=7, steps=1000)
    assert (plan.task, plan.overrides, plan.envs) == ("keep_spot", ("duration=5",), 512)
    assert (plan.seed, plan.steps) == (7, 1000)
    assert plan.settings == Settings()
    assert plan_of("land_on_pad").settings == Settings(spread=0.4)
    assert plan_of("keep_spot").start is None
    assert plan_of("keep_spot", start="baseline").settings == Settings(spread=0.03, rate=1e-4, falling=True)


def test_a_pursuit_has_its_own() -> None:
    plan = plan_of("cats_and_mouse/1A")
    assert (plan.envs, plan.settings.discount, plan.settings.spread) == (128, 0.97, 0.03)
    # It starts with the baseline, changes it slowly, and sees a crash in a hundred episodes.
    assert (plan.start, plan.settings.rate, plan.settings.falling, plan.tries) == ("baseline", 1e-4, True, 200)
    begun = plan_of("cats_and_mouse/1A", start=None)
    assert (begun.settings.spread, begun.settings.rate, begun.tries) == (0.3, 1e-3, 64)
    assert plan_of("cats_and_mouse/1A", envs=3).envs == 3
    # Asked for, the settings are those.
    assert plan_of("cats_and_mouse/1A", settings=Settings(rate=0.5)).settings.rate == 0.5


def test_an_unknown_task_is_refused() -> None:
    with pytest.raises(QrsimError, match=r"did you mean 'land_on_pad'"):
        plan_of("land_on_pda")


def test_a_cat_sees_towards_the_mouse_and_moves_so() -> None:
    view = view_of(Functional.of("cats_and_mouse/1A"))
    # North and east of position, velocity, mouse and two cats, all turned; and both velocities that are commanded.
    assert view.pairs == ((0, 1), (2, 3), (4, 5), (6, 7), (8, 9))
    assert (view.ahead, view.turned, view.yaw, view.seconds) == ((4, 5), (0, 1), None, 1.0)
    # A task with a goal but no mouse is seen as before.
    plain = view_of(Functional.of("land_on_pad"))
    assert (plain.ahead, plain.turned, plain.yaw) == (None, None, 8)
