"""A function in a process of its own: its result, its errors, and whatever ends it."""

from __future__ import annotations

import contextlib
import os
import time

import pytest

from qrsim.errors import UsageError
from qrsim.files.in_child import Child, ChildError, in_child


def joined(words: list[str], count: int) -> dict[str, object]:
    os.write(1, b"printed by a library")
    return {"words": "-".join(words), "bytes": b"x" * count, "process": os.getpid()}


def refuse(_: str) -> None:
    raise UsageError("FILE: has no 'u'")


def fail() -> None:
    try:
        os.stat("/nowhere/else")
    except OSError:
        raise KeyError("gone") from None


def half() -> None:
    for number in range(3, 20):
        with contextlib.suppress(OSError):
            os.write(number, b"\x80\x05half")
    os._exit(0)


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
    with pytest.raises(ChildError, match="gone") as caught:
        in_child(fail)
    assert [each.partition(":")[0] for each in caught.value.reasons] == ["KeyError", "FileNotFoundError"]


def test_what_ends_it_is_told() -> None:
    with pytest.raises(ChildError, match=r"its decoder crashed \(SIGABRT\)"):
        in_child(crash)
    with pytest.raises(ChildError, match="its decoder ended with code 3"):
        in_child(leave)
    with pytest.raises(ChildError, match="its decoder ended with code 0"):
        in_child(half)
    with pytest.raises(ChildError, match=r"it takes longer than 0\.5 s"):
        in_child(sleep, seconds=0.5)


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="the limit is one of Linux")
def test_its_memory_has_a_limit() -> None:
    assert in_child(grow) == 400 * 2**20
    with pytest.raises(ChildError, match=r"it needs more than 0\.195 GB of memory"):
        in_child(grow, memory=200 * 2**20)


def test_one_process_answers_until_it_ends() -> None:
    with Child(settings={"OF_A_CHILD": "set"}) as child:
        first = child.call(os.getpid)
        assert child.call(os.getenv, "OF_A_CHILD") == "set"
        with pytest.raises(UsageError, match="has no 'u'"):
            child.call(refuse, "x")
        with pytest.raises(ChildError, match="gone"):
            child.call(fail)
        assert child.call(os.getpid) == first == child.number
        with pytest.raises(ChildError, match="crashed"):
            child.call(crash)
        assert child.call(os.getpid) != first
    assert child.number is None
