"""The time that a fit takes, told while it goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from qrsim.studies.identify import pace
from qrsim.studies.identify.pace import Pace

Told = Callable[[list[float], bool], list[str]]


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    """A function that counts steps that end at some times [s], and returns what is told."""

    def count(ends: list[float], first: bool) -> list[str]:
        clock: Iterator[float] = iter([0.0, *ends])
        monkeypatch.setattr(pace.time, "perf_counter", lambda: next(clock))
        lines: list[str] = []
        counted = Pace(148.0, 19, lines.append, first)
        for _ in ends:
            counted.step()
        return lines

    return count


def test_a_first_fit_tells_at_once_and_after_three_steps_how_long_it_takes(told: Told) -> None:
    assert told([], True) == ["fitting 19 numbers to 148 s of flight: half a minute to some minutes, compiling first"]
    # Compiling takes 20 s, and a step 2 s when nobody else is busy.
    _, after = told([20.0, 23.0, 25.0], True)
    assert after == (
        "a step takes 2 s, so a fit of 15 to 60 steps 30 s to 2.0 min; "
        "it is repeated without the constants that the logs do not show"
    )


def test_steps_are_told_every_ten_seconds(told: Told) -> None:
    assert told([4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 110.0], False)[1:] == [
        "step 3, 12 s",
        "step 6, 24 s",
        "step 7, 1.8 min",
    ]
