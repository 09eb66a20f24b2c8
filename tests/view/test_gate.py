"""Browsers get a frame once they have acknowledged the one before."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from qrsim.view.gate import Link


class Slow:
    """A connection whose other end acknowledges when it is told to."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.answers: list[asyncio.Future[float]] = []

    async def send(self, window: bytes) -> None:
        self.sent.append(window)

    async def ping(self) -> asyncio.Future[float]:
        answer: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        self.answers.append(answer)
        return answer


def test_a_window_waits_until_the_one_before_is_acknowledged():
    async def go() -> None:
        slow: Any = Slow()
        link = Link(slow)
        first = asyncio.create_task(link.send(b"first"))
        await asyncio.sleep(0)
        # How far the browser is, is asked first.
        assert slow.sent == []
        slow.answers[0].set_result(0.0)
        await asyncio.sleep(0.01)
        assert slow.sent == [b"first"]
        assert not first.done(), "viser would compose the next window now"
        await asyncio.sleep(0.2)
        assert link.lag_s == pytest.approx(0.21, abs=0.15)
        slow.answers[1].set_result(0.0)
        await asyncio.wait_for(first, 5.0)
        # What it took is what is said until the next answer.
        assert link.lag_s >= 0.2

    asyncio.run(go())


def test_a_link_that_ends_holds_nobody():
    async def go() -> None:
        slow: Any = Slow()
        link = Link(slow)
        sending = asyncio.create_task(link.send(b"first"))
        await asyncio.sleep(0)
        slow.answers[0].set_result(0.0)
        await asyncio.sleep(0.01)
        slow.answers[1].set_exception(ConnectionError())
        await asyncio.wait_for(sending, 5.0)

    asyncio.run(go())
