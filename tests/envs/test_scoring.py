"""What policies score: hand-made returns, paired differences, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from qrsim.envs.batch import Batch
from qrsim.envs.scoring import HOVER, RANDOM, Interval, Scored, maker, play_policy, score_task
from qrsim.errors import UsageError

SHORT = ["duration=1"]


def fleeing(seen: Any) -> Any:
    """Return the command of a dive, which ends in the ground."""
    return np.tile([1.0, 0.0, -1.0, 0.0, 1.0], (len(seen), 1))


def leaning(seen: Any) -> Any:
    """Return the command of the hover throttle and 0.3 rad of pitch."""
    return np.tile([1.0 / 3.0, 0.0, 0.0, 0.0, 1.0], (len(seen), 1))


def test_the_same_episodes_are_flown_by_every_policy() -> None:
    batch = Batch("keep_spot", 3, SHORT)
    play = batch.functional.play
    told: list[tuple[str, int]] = []
    makers = {"one": maker(HOVER, play), "two": maker(HOVER, play), "lean": maker(leaning, play)}
    one, two, lean = score_task(batch, makers, 7, told=lambda name, step: told.append((name, step)))
    np.testing.assert_array_equal(one.returns, two.returns)
    assert one.less(two) == Interval(0.0, 0.0, 0.0)
    assert one.alive.all()
    # A throttle of 0.59 costs nothing; in a second it drifts by centimetres, whose square is paid.
    assert -0.1 < one.returns.min() < one.returns.max() < 0.0
    # The effort (2/pi 0.3)^2 of a second, 0.0365; and at some 2 m/s^2 a way of at most 1 m, squared.
    assert -1.1 < lean.less(one).mean < -0.0365
    assert told[49] == ("one", 50)
    assert len(told) == 150
    # Of seed 8 alone the second of these three.
    alone = play_policy(Batch("keep_spot", 1, SHORT), "one", maker(HOVER, play), np.array([8]))
    np.testing.assert_allclose(alone.returns, one.returns[1:2], rtol=1e-4)


def test_a_crash_ends_an_episode() -> None:
    batch = Batch("keep_spot", 2, ["duration=5", "task.crash=published"])
    found = play_policy(batch, "dive", maker(fleeing, batch.functional.play), np.array([1, 2]))
    assert found.alive.tolist() == [False, False]
    np.testing.assert_allclose(found.returns, -1000.0, rtol=1e-6)


def test_intervals_are_those_of_a_bootstrap() -> None:
    values = np.random.default_rng(3).normal(5.0, 2.0, 400)
    found = Interval.of(values)
    assert found.mean == pytest.approx(values.mean())
    # 1.96 standard errors of 0.1 either way.
    assert found.low == pytest.approx(found.mean - 0.196, abs=0.03)
    assert found.high == pytest.approx(found.mean + 0.196, abs=0.03)
    assert np.isnan(Interval.of(np.array([1.0])).low)
    one, other = Scored("a", values, values > 0.0), Scored("b", values - 3.0, values > 0.0)
    assert one.less(other).low == pytest.approx(3.0)
    assert one.less(other).high == pytest.approx(3.0)
    assert one.persons_found_interval is None
    counted = Scored("c", values, values > 0.0, persons_found=np.array([0, 1] * 200))
    # 1.96 standard errors of 0.025 either way.
    assert counted.persons_found_interval is not None
    assert counted.persons_found_interval.low == pytest.approx(0.451, abs=0.008)
    assert counted.persons_found_interval.high == pytest.approx(0.549, abs=0.008)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (lambda seen: np.zeros(3), r"policy own: expected actions of shape \(1, 5\) \(agents, axes\), found \(3,\)"),
        (lambda seen: "up", r"policy own: expected actions of shape \(1, 5\) \(agents, axes\), found 'up'"),
        (lambda seen: np.full((1, 5), np.nan), "policy own: pitch of 'pelicans_0' in environment 0 is nan"),
        (
            lambda seen: np.full((1, 5), 2.0),
            "policy own: pitch of 'pelicans_0' in environment 0 is 2; allowed: -1 to 1",
        ),
        (4, "--policy: 4 is neither a function of what is seen nor a class with act"),
    ],
)
def test_what_cannot_be_flown_is_refused(policy: Any, message: str) -> None:
    batch = Batch("keep_spot", 1, SHORT)
    with pytest.raises(UsageError, match=message):
        play_policy(batch, "own", maker(policy, batch.functional.play), np.array([0]))


@pytest.mark.long
def test_what_is_handed_in_counts() -> None:
    """A class is made for each episode; nothing handed in is zeros, whose score is minus the sum of squares."""

    class Half:
        def __init__(self, play: Any, seed: int):
            self.seed = seed

        def act(self, seen: Any) -> Any:
            return np.zeros((1, 3))

        def answer(self) -> Any:
            return np.full((1, 100), 0.5)

    batch = Batch("plume_mapping/3A", 2, ["duration=2"])
    play = batch.functional.play
    half, nothing, random = score_task(
        batch, {"half": maker(Half, play), "nothing": maker(HOVER, play), "random": maker(RANDOM, play)}
    )
    assert -25.0 < half.returns.max() < -5.0
    assert -10.0 < nothing.returns.min() < nothing.returns.max() < 0.0
    np.testing.assert_allclose(random.returns, nothing.returns, rtol=1e-4)
