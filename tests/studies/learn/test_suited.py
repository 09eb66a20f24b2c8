"""Plans of trainings: a pursuit has other numbers than a task of one vehicle, and is seen towards the mouse."""

from __future__ import annotations

import pytest

from qrsim.envs.functional import Functional
from qrsim.envs.viewing import view_of
from qrsim.errors import QrsimError, UsageError
from qrsim.studies.learn.ppo import Settings
from qrsim.studies.learn.suited import plan_of
from qrsim.studies.learn.training import Plan, Training


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
    assert (plan.start, plan.settings.rate, plan.settings.falling) == ("baseline", 3e-4, True)
    assert (plan.steps, plan_of("cats_and_mouse/1A", steps=7).steps, plan_of("keep_spot").steps) == (
        2_400_000,
        7,
        3_000_000,
    )
    # Long episodes are learned in shorter ones, half of them in their first 40 s, and policies are tried in both.
    assert (plan.shorter, plan.early, plan.tries, plan.starts) == (("duration=200",), 40.0, 64, 1000)
    short = plan_of("cats_and_mouse/1A", ("duration=200",))
    assert (short.shorter, short.early, short.tries, short.starts) == ((), 40.0, 200, 0)
    assert (plan_of("keep_spot").shorter, plan_of("keep_spot").early) == ((), None)
    begun = plan_of("cats_and_mouse/1A", start=None)
    assert (begun.settings.spread, begun.settings.rate, begun.tries) == (0.3, 1e-3, 64)
    assert (begun.steps, begun.early, begun.starts) == (3_000_000, None, 0)
    assert plan_of("cats_and_mouse/1A", envs=3).envs == 3
    # Asked for, the settings are those.
    assert plan_of("cats_and_mouse/1A", settings=Settings(rate=0.5)).settings.rate == 0.5


def test_policies_are_tried_in_whole_episodes() -> None:
    training = Training(Plan("keep_spot", ("duration=2",), shorter=("duration=1",), envs=1, tries=2))
    assert [each.batch.functional.play.steps for each in (training.flights, training.trials)] == [10, 20]


def test_slow_decisions_have_fewer_episodes_and_more_passes() -> None:
    for task in ("keep_formation", "search_small"):
        plan = plan_of(task)
        assert (plan.envs, plan.settings) == (64, Settings(epochs=4, minibatches=8, spread=0.4))


def test_an_integral_is_an_input_where_an_offset_is_observed() -> None:
    plain, more = (view_of(Functional.of("keep_spot"), integral) for integral in (False, True))
    # Three offsets to the goal, of which north and east turn with the heading.
    assert (plain.inputs, plain.summed, more.inputs, more.summed) == (12, (), 15, (9, 10, 11))
    assert set(more.pairs) - set(plain.pairs) == {(12, 13)}
    assert view_of(Functional.of("keep_velocity"), True).summed == (9, 10, 11)
    with pytest.raises(UsageError, match="search_small: it observes no offset to a goal or velocity"):
        view_of(Functional.of("search_small"), True)


def test_a_search_by_pictures_is_refused_with_the_way_out() -> None:
    with pytest.raises(UsageError, match=r"this task gives a dict; task\.observes=likeliest gives numbers"):
        view_of(Functional.of("search_and_rescue/2A"))


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
