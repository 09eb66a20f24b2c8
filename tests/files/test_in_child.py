"""A function in a process of its own: its result, its errors, and whatever ends it."""

from __future__ import annotations

import os
import time

import pytest

from qrsim.errors import UsageError
from qrsim.files.in_child import ChildError, in_child


def joined(words: list[str], count: int) -> dict[str, object]:
    os.write(1, b"printed by a library")
    return {"words": "-".join(words), "bytes": b"x" * count, "process": os.getpid()}


def refuse(_: str) -> None:
    raise UsageError("FILE: has no 'u'")


def fail() -> None:
    raise KeyError("gone")


def crash() -> None:
    os.abort()


def leave() -> None:
    os._exit(3)


def grow() -> int:
    return len(bytearray(400 * 2**20))


def sleep() -> None:
    time.sleep(60.0)


def test_its_result_comes_back() -> None:
    found = in_child(joined, ["a", "b"], 100_000)
    assert found["words"] == "a-b"
    assert found["bytes"] == b"x" * 100_000
    assert found["process"] != os.getpid()


def test_its_errors_come_back() -> None:
    with pytest.raises(UsageError, match=r"^FILE: has no 'u'$"):
        in_child(refuse, "x")
    with pytest.raises(ChildError, match="gone"):
        in_child(fail)


def test_what_ends_it_is_told() -> None:
    with pytest.raises(ChildError, match=r"its decoder crashed \(SIGABRT\)"):
        in_child(crash)
    with pytest.raises(ChildError, match="its decoder ended with code 3"):
        in_child(leave)
    with pytest.raises(ChildError, match=r"it takes longer than 0\.5 s"):
        in_child(sleep, seconds=0.5)


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="the limit is one of Linux")
def test_its_memory_has_a_limit() -> None:
    assert in_child(grow) == 400 * 2**20
    with pytest.raises(ChildError, match=r"it needs more than 0\.195 GB of memory"):
        in_child(grow, memory=200 * 2**20)
