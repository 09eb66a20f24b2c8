"""Programs of a process: each is made once, and so many are kept."""

from __future__ import annotations

import gc
from typing import Any

import pytest

from qrsim.core.sameness import sameness
from qrsim.engine import programs
from qrsim.engine.llvm import UnsupportedError
from qrsim.errors import CompilerWarning


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What was made, of a process that keeps three programs and has none."""
    monkeypatch.setattr(programs, "_MADE", {})
    monkeypatch.setattr(programs, "_TOLD", set())
    monkeypatch.setattr(programs, "MOST_MADE", 3)
    return []


def program(made: list[int], number: int) -> Any:
    def make() -> int:
        made.append(number)
        return 10 * number + 1

    return programs.compiled(("test", number), make)


def test_it_is_made_once(made: list[int]):
    assert [program(made, 1), program(made, 1)] == [11, 11]
    assert made == [1]


def test_the_one_that_was_used_longest_ago_is_forgotten(made: list[int]):
    for number in (1, 2, 3, 1, 4):
        program(made, number)
    assert made == [1, 2, 3, 4]
    assert program(made, 1) == 11
    assert made == [1, 2, 3, 4]
    program(made, 2)
    assert made == [1, 2, 3, 4, 2]


def test_what_cannot_be_made_is_tried_once(made: list[int]):
    def fails() -> int:
        made.append(0)
        raise UnsupportedError("a test of what cannot be made")

    with pytest.warns(CompilerWarning, match="a test of what cannot be made"), pytest.raises(UnsupportedError):
        programs.compiled(("test", 0), fails)
    with pytest.raises(UnsupportedError, match="a test of what cannot be made"):
        programs.compiled(("test", 0), fails)
    assert made == [0]


@pytest.mark.parametrize("before", [True, False])
def test_no_garbage_is_searched_for_while_one_is_made(made: list[int], before: bool):
    was, seen = gc.isenabled(), []

    def fails() -> int:
        seen.append(gc.isenabled())
        raise ValueError("a fault")

    (gc.enable if before else gc.disable)()
    try:
        with pytest.raises(ValueError, match="a fault"):
            programs.compiled(("test", 0), fails)
        assert (seen, gc.isenabled()) == ([False], before)
    finally:
        (gc.enable if was else gc.disable)()


def test_those_of_objects_that_are_gone_are_discarded(made: list[int]):
    class Policy:
        pass

    kept, dropped = Policy(), Policy()
    for number, policy in enumerate((kept, dropped)):
        key = "test", number, ((sameness(policy), None), True)
        programs.compiled(key, lambda number=number: made.append(number) or number)
    del policy, dropped
    program(made, 2)
    assert [key[1] for key in programs._MADE] == [0, 2]
