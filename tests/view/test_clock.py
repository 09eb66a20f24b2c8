"""Play, pause, step and speed, against a clock that the test moves."""

from __future__ import annotations

import math
import threading

import pytest

from qrsim.errors import UsageError
from qrsim.view.clock import Clock

STEP = 0.02


class Wall:
    """A wall clock that stands until it is moved; what waits for it moves it on."""

    def __init__(self) -> None:
        self.time = 100.0

    def __call__(self) -> float:
        self.time += 1e-4
        return self.time


@pytest.mark.parametrize("speed", [0.1, 1.0, 5.0, 50.0])
def test_simulated_time_goes_at_the_speed(speed: float):
    wall = Wall()
    clock = Clock(speed, now=wall)
    begun, done = wall.time, 0
    while wall.time < begun + 20.0:
        wall.time += 0.01
        done += clock._due(STEP, 1000)
    assert done * STEP == pytest.approx(20.0 * speed, abs=2.0 * max(STEP, speed / 30.0))


def test_who_flies_is_sent_off_thirty_times_a_second():
    """However long a time step is, unless it is longer than that."""
    for step, rate in ((0.02, 30.0), (0.001, 30.0), (0.1, 10.0)):
        wall = Wall()
        clock, sent, begun = Clock(1.0, now=wall), 0, wall.time
        while wall.time < begun + 20.0:
            wall.time += 0.001
            sent += clock._due(step, 1000) > 0
        assert sent == pytest.approx(20.0 * rate, rel=0.05)


def test_who_is_too_slow_does_not_hurry_afterwards():
    wall = Wall()
    clock = Clock(1.0, now=wall)
    wall.time += 60.0
    assert clock.wait(STEP, most=50) == 13
    wall.time += 0.1
    assert clock.wait(STEP, most=50) <= 6


def test_as_fast_as_can_be_never_waits():
    clock = Clock(math.inf, now=lambda: 0.0)
    assert [clock.wait(STEP, most=7) for _ in range(3)] == [7, 7, 7]


def test_a_step_passes_while_paused_and_nothing_else_does():
    clock = Clock()
    clock.playing = False
    clock.step()
    clock.step()
    assert (clock.wait(STEP, 50), clock.wait(STEP, 50)) == (1, 1)
    waiting = threading.Thread(target=clock.wait, args=(STEP, 50), daemon=True)
    waiting.start()
    waiting.join(0.3)
    assert waiting.is_alive()
    clock.playing = True
    waiting.join(10.0)
    assert not waiting.is_alive()


def test_a_closed_clock_keeps_nobody_waiting():
    clock = Clock(playing=False)
    clock.close()
    assert clock.wait(STEP, 50) == 50


@pytest.mark.parametrize("speed", [0.0, -1.0, 0.09, 51.0, math.nan])
def test_other_speeds_are_refused(speed: float):
    with pytest.raises(UsageError, match=r"expected 0\.1 to 50"):
        Clock(speed)
