"""A clock by which a world runs by itself: when its ticks are due, which are late, and that it does not hurry."""

from __future__ import annotations

import pytest

from qrsim.errors import UsageError
from qrsim.links.pacing import Metronome


def metronome(factor: float = 2.0) -> tuple[Metronome, list[float]]:
    """A clock of ticks of 0.02 s from 100 s of the wall clock on, which stands where the list says."""
    wall = [100.0]
    return Metronome(factor, 0.0, 0.02, clock=lambda: wall[0]), wall


def test_a_tick_is_due_when_the_wall_clock_is_there():
    found, wall = metronome()
    # At twice real time a tick takes 10 ms.
    assert found.until_s(0.02) == pytest.approx(0.01)
    wall[0] = 100.013
    assert found.until_s(0.04) == pytest.approx(0.007)
    assert found.until_s(0.02) == pytest.approx(-0.003)


def test_a_tick_is_late_when_the_next_one_is_due():
    found, wall = metronome()
    for simulated, out, overruns in ((0.02, 100.012, 0), (0.04, 100.0299, 0), (0.06, 100.041, 1), (0.08, 100.045, 1)):
        wall[0] = out
        found.ended(simulated)
        assert found.overruns == overruns
    assert found.worst_delay == pytest.approx(0.011)
    report = found.report()
    assert (report.steps, report.factor, report.simulated) == (4, 2.0, pytest.approx(0.08))
    # Its time is made up for.
    assert found.until_s(0.10) == pytest.approx(0.005)


def test_after_a_quarter_of_a_second_it_starts_anew():
    found, wall = metronome()
    wall[0] = 100.27
    found.ended(0.02)
    assert found.until_s(0.04) == pytest.approx(0.01)
    # Not before.
    other, wall = metronome()
    wall[0] = 100.25
    other.ended(0.02)
    assert other.until_s(0.04) == pytest.approx(-0.23)


def test_it_needs_a_factor():
    with pytest.raises(UsageError, match="needs one above 0"):
        Metronome(0.0, 0.0, 0.02)
