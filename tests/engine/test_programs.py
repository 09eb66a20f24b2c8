"""Programs of a process: each is made once, and so many are kept."""

from __future__ import annotations

import functools
import gc
import weakref
from types import SimpleNamespace
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


@pytest.mark.filterwarnings("ignore::qrsim.errors.CompilerWarning")
def test_the_reason_keeps_nothing_that_was_in_use_when_it_was_found(made: list[int]):
    class Policy:
        pass

    def fails(policy: Policy) -> int:
        raise UnsupportedError("a test of a policy", "a line")

    policy = Policy()
    seen = weakref.ref(policy)
    for _ in range(2):
        with pytest.raises(UnsupportedError, match="a test of a policy at a line") as found:
            programs.compiled(("test", sameness(policy)), functools.partial(fails, policy))
        assert found.value.__context__ is None
        del found
    del policy
    gc.collect()
    assert seen() is None


def test_the_oldest_are_discarded_where_their_code_is_too_large(made: list[int], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(programs, "MOST_BYTES", 100)
    for number in (1, 2, 3):
        programs.compiled(("test", number), lambda: SimpleNamespace(code_bytes=60))
    assert [key[1] for key in programs._MADE] == [2, 3]


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
