"""What stands between browsers and the page's server: each gets a frame once it has the one before.

viser sends every window of messages as soon as the last one is in the system's buffers, which on a slow link hold many
seconds of them. Here a window is sent when the browser has acknowledged the one before (its answer to a WebSocket
ping that follows each), and viser composes it only then, from the newest values: what is older was never sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from hmac import compare_digest
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from qrsim.view.clock import FRAME_S

LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
# Where the timeline of a page asks.
WISHES = "/timeline"
# Lag [s] from which a page says that a browser is behind.
NOTABLE_S = 0.3
# Of a link whose answers take longer [s] this is because it is narrow.
LONGEST_WAY_S = 0.3


class Link:
    """A browser's connection, with the methods of one that viser uses; ``send`` returns when the next may be sent.

    Attributes:
        answer_s: how long the last acknowledgement took [s].
    """

    def __init__(self, connection: Any):
        self._connection = connection
        # When the windows were sent that are not acknowledged yet.
        self._sent: deque[float] = deque()
        self._freed = asyncio.Condition()
        self.answer_s = 0.0
        self._quickest_s: float | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    @property
    def lag_s(self) -> float:
        """Delay [s] of the browser: age of the oldest unacknowledged message window, at least the last round trip."""
        oldest = next(iter(tuple(self._sent)), None)
        return self.answer_s if oldest is None else max(self.answer_s, time.perf_counter() - oldest)

    @property
    def _most(self) -> int:
        """Number of message windows that may be sent before the first one is acknowledged."""
        # Of a link that is far but not narrow, as many as fill the time of its answers.
        return 1 + int((self._quickest_s or 0.0) / FRAME_S)

    async def send(self, window: bytes) -> None:
        """Send a window (batch) of messages to a browser, and wait until another may be sent."""
        if self._quickest_s is None:
            # How far it is while nothing else is on its way.
            begun = time.perf_counter()
            await (await self._connection.ping())
            self._quickest_s = min(LONGEST_WAY_S, time.perf_counter() - begun)
        self._sent.append(time.perf_counter())
        await self._connection.send(window)
        answer = await self._connection.ping()
        answer.add_done_callback(self._acknowledged)
        async with self._freed:
            await self._freed.wait_for(lambda: len(self._sent) < self._most)

    def _acknowledged(self, answer: asyncio.Future[float]) -> None:
        """Measure the round trip of the oldest message window, and allow the next to be sent."""
        # Also where the connection has ended.
        if not answer.cancelled() and answer.exception() is None:
            self.answer_s = time.perf_counter() - self._sent[0]
            self._quickest_s = min(self._quickest_s or LONGEST_WAY_S, self.answer_s)
        self._sent.popleft()
        self._waking = asyncio.ensure_future(self._wake())

    async def _wake(self) -> None:
        """Wake the sender that waits for an acknowledgement."""
        async with self._freed:
            self._freed.notify_all()


class Gate:
    """The links of the browsers that look at a page, and who may look.

    A page of any other site can open a WebSocket to this machine; its browser says so, by the Origin, and is refused.

    Args:
        token: that an address has to begin with; "": the server is of this machine alone, and so are the names that it
            may be called by.
    """

    def __init__(self, token: str = "") -> None:
        self.token = token
        self._links: set[Link] = set()
        self.wish: Callable[[Any], bytes | None] = lambda wish: None

    def refusal(self, path: str, host: str | None, origin: str | None) -> str | None:
        """Return why an HTTP request is refused, from its path, Host and Origin; None if it is allowed."""
        if self.token and not compare_digest(path.split("/")[1].split("?")[0].encode(), self.token.encode()):
            return "the address lacks the token that qrsim has printed"
        name = urlsplit(f"//{host or ''}").hostname
        if not self.token and name not in LOCAL_NAMES:
            return f"this page is at one of {', '.join(LOCAL_NAMES)}, not at {name}"
        if origin is not None and urlsplit(origin).netloc != host:
            return f"pages of {origin} may not view this page"
        return None

    def _request(self, answer: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Wrap viser's HTTP handler ``answer`` with a check of path, Host and Origin."""

        def process(connection: Any, request: Any) -> Any:
            """Answer 403 to a refused request; pass others on with the access token removed from their path."""
            headers = request.headers
            found = [headers.get_all(name) for name in ("Host", "Origin")]
            host, origin = (values[0] if len(values) == 1 else None for values in found)
            why = "it names several origins" if len(found[1]) > 1 else self.refusal(request.path, host, origin)
            if why is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"refused: {why}\n")
            if self.token:
                request = dataclasses.replace(request, path=request.path[len(self.token) + 1 :] or "/")
            return answer(connection, request)

        return process

    @property
    def lag_s(self) -> float:
        """Delay [s] of the slowest browser; 0 without browsers."""
        return max((link.lag_s for link in tuple(self._links)), default=0.0)

    def _guarded(self, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Wrap viser's WebSocket handler so that messages to each browser are sent through a ``Link``."""

        async def handle(connection: Any) -> None:
            """Serve the WebSocket of a page through a ``Link``, or the one of the page's own script."""
            if connection.request.path.partition("?")[0].endswith(WISHES):
                return await self._listen(connection)
            link = Link(connection)
            self._links.add(link)
            try:
                await handler(link)
            finally:
                self._links.discard(link)

        return handle

    async def _listen(self, connection: Any) -> None:
        """Answer the requests of the page's own script, one after the other."""
        loop = asyncio.get_running_loop()
        async for text in connection:
            with contextlib.suppress(ValueError):
                wish = json.loads(text)
                answer = await loop.run_in_executor(None, lambda: self.wish(wish))  # noqa: B023
                if answer is not None:
                    await connection.send(answer)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Return a context in which a server that viser starts accepts only allowed requests."""
        import websockets.asyncio.server

        library: Any = websockets.asyncio.server
        with _installing:
            plain = library.serve

            class Closed(plain):  # type: ignore[misc, valid-type]
                """A server that drops unused connections when it closes.

                Browsers open connections in advance. websockets waits until each has timed out, after 10 s.
                """

                async def __aexit__(self, *error: object) -> None:
                    """Abort connections without a request, and close the others."""
                    for connection in tuple(self.server.handlers):
                        if connection.request is None:
                            connection.transport.abort()
                    await super().__aexit__(*error)

            def serve(handler: Any, *place: Any, **options: Any) -> object:
                """Start a WebSocket server; a server of viser gets this gate's checks, others are unchanged."""
                if not getattr(handler, "__module__", "").startswith("viser."):
                    return plain(handler, *place, **options)
                options["process_request"] = self._request(options["process_request"])
                return Closed(self._guarded(handler), *place, **options)

            library.serve = serve
            try:
                yield
            finally:
                library.serve = plain


_installing = threading.Lock()
