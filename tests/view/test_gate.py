"""Browsers get a frame once they have acknowledged the one before."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest

from qrsim.view.gate import Gate, Link
from qrsim.view.server import address, start_server


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


def status(address: str, **headers: str) -> int:
    """Return the status of a WebSocket handshake."""
    import viser
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    protocol: Any = f"viser-v{viser.__version__}"
    wanted = {name.capitalize(): value for name, value in headers.items()}
    try:
        with connect(
            address.replace("http", "ws"), subprotocols=[protocol], additional_headers=wanted, proxy=None
        ) as found:
            found.recv(20.0)
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def test_other_origins_and_other_names_are_refused():
    server = start_server(0)
    try:
        own = address(server)
        assert status(own) == 101
        assert status(own, origin=own) == 101
        for origin in ("http://evil.example", "null", own.replace("127.0.0.1", "evil.example"), own + "1"):
            assert status(own, origin=origin) == 403, origin
    finally:
        server.stop()
    # A name of somebody else's that leads here.
    assert Gate().refusal("/", "evil.example:8080", "http://evil.example:8080") is not None
    assert Gate().refusal("/", "localhost:8080", "http://localhost:8080") is None


def test_elsewhere_the_address_has_a_token():
    from urllib.error import HTTPError
    from urllib.request import urlopen

    server = start_server(0, host="127.0.0.2")
    try:
        own = address(server)
        place, token = own.rsplit("/", 1)
        assert len(token) >= 20
        with urlopen(f"{own}/") as answer:
            assert b"<html" in answer.read(2000)
        assert status(own, origin=place) == 101
        assert status(own, origin="http://evil.example") == 403
        for wrong in (place, f"{place}/{token[:-1]}", f"{place}/{token}x"):
            assert status(wrong) == 403
            with pytest.raises(HTTPError, match="403"):
                urlopen(f"{wrong}/")
    finally:
        server.stop()


def test_a_connection_without_a_request_does_not_delay_the_end():
    """Browsers open some in advance; viser waits up to 6 s for its thread, which waited 10 s for them."""
    server = start_server(0)
    thread = server._websock_server._server_thread
    with socket.create_connection((server.get_host(), server.get_port())) as early:
        status(address(server))
        server.stop()
        assert not thread.is_alive()
        assert early.recv(1) == b""
