"""One connection: bytes in, one message out for each request, in order."""

from __future__ import annotations

import asyncio
import socket
import time
from contextlib import suppress
from typing import cast

from qrsim.errors import QrsimError, UsageError
from qrsim.links.reference.episode_session import EpisodeSession
from qrsim.links.reference.protocol import DecodeError
from qrsim.links.reference.protocol.framing import HEAD_SIZE, LARGEST_REQUEST, Deframer, frame
from qrsim.links.reference.protocol.qrsim_pb2 import Ack, Message
from qrsim.links.reference.requests import known_step, parsed_step, step
from qrsim.links.reference.roles import Host
from qrsim.links.reference.session import Session

# Bytes that may wait to be sent: then a client's next request waits, and a watcher misses states.
MOST_WAITING = 4 << 20
LONGEST_TEXT = 4000
LINGER_S = 1.0
# So long a connection may answer what it has been sent already before the others have their turn.
TURN_S = 0.002
# Timers of the loop are up to a millisecond late, the sleep of a thread is not.
COARSE_S = 0.0015
# Of Linux; where there is none, delayed acknowledgements are not known to take as long.
QUICKACK: int | None = getattr(socket, "TCP_QUICKACK", None)
KEEPALIVE = {"TCP_KEEPIDLE": 20, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 3}


class Connection(asyncio.Protocol):
    """The connection of one client.

    Attributes:
        server: whose client it is.
        session: what it controls, None until INIT or OPEN.
        lost: why it controls that no more, "" where it was not taken away.
        reasons: whether it asked for states of invalid vehicles.
        gone: set when nothing can be sent any more, or the server ends.
        leaving: set when the client sends nothing more, or is gone.
        number: of the client, from 1.
    """

    def __init__(self, server: Host):
        self.server = server
        self.session: Session | EpisodeSession | None = None
        self.lost = ""
        self._waits_since: float | None = None
        self.reasons = False
        self.number = 0
        self.gone, self.leaving = asyncio.Event(), asyncio.Event()
        self._deframer = Deframer(LARGEST_REQUEST)
        self._more: asyncio.Future[None] | None = None
        self._can_write = asyncio.Event()
        self._can_write.set()
        self._full = self._discard = False
        self._held: list[bytes] = []
        self.finished: asyncio.Task[None] | None = None

    # ---- called by asyncio ----

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to serve the client that has connected."""
        self.transport = cast("asyncio.Transport", transport)
        self.transport.set_write_buffer_limits(high=MOST_WAITING)
        found = self._socket = transport.get_extra_info("socket")
        found.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE.items():
            if hasattr(socket, name):
                found.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        refused = self.server.admit(self)
        self.finished = asyncio.get_running_loop().create_task(self._serve(refused))

    def data_received(self, data: bytes) -> None:
        """Append received bytes; stop reading while more bytes wait than the largest request has."""
        if self._discard:
            return
        self._deframer.feed(data)
        if self._deframer.waiting > HEAD_SIZE + LARGEST_REQUEST and not self._full:
            self._full = True
            self.transport.pause_reading()
        if self._full or self._deframer.ready:
            self._wake()
        else:
            self._ask_for_the_rest()

    def _ask_for_the_rest(self) -> None:
        """Make the kernel acknowledge a partly received request at once (TCP_QUICKACK), so that the client sends its
        rest.

        The reference client writes length and message apart, and its system holds the second back until the first is
        acknowledged (Nagle's algorithm), which ours would do some 40 ms later: there is no reply to say it with.
        """
        if QUICKACK is not None:
            with suppress(OSError):  # the client has gone
                self._socket.setsockopt(socket.IPPROTO_TCP, QUICKACK, 1)

    def eof_received(self) -> bool:
        """Handle the client's end of stream: answer pending requests, but stop long steps and pauses; return True (stay
        open)."""
        self.leaving.set()
        self._wake()
        return True

    def pause_writing(self) -> None:
        """Stop answering requests, because the client does not read its replies."""
        self._can_write.clear()

    def resume_writing(self) -> None:
        """Continue answering requests, because the client reads its replies again."""
        self._can_write.set()

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the connection has ended, so that all that waits for this client stops."""
        self.gone_soon()

    def gone_soon(self) -> None:
        """Note that the client is leaving: the connection is closed after the present request."""
        self.leaving.set()
        self.gone.set()
        self._can_write.set()
        self._wake()

    def _wake(self) -> None:
        """Wake the coroutine that waits for more bytes of a request."""
        if self._more is not None and not self._more.done():
            self._more.set_result(None)

    # ---- answering ----

    def send(self, message: Message) -> None:
        """Send a protobuf message at once, framed, together with the held ones."""
        self.send_frame(frame(message.SerializeToString()))

    def send_frame(self, content: bytes) -> None:
        """Send a framed message (``content``) at once, together with the held ones."""
        self.hold_frame(content)
        self.send_held()

    def hold_frame(self, content: bytes) -> None:
        """Hold a framed message (``content``) until the next write, or until this connection waits."""
        self._held.append(content)

    def send_held(self) -> None:
        """Send the messages that ``hold_frame`` has held back."""
        if self._held and not (self.gone.is_set() or self.transport.is_closing()):
            self.transport.write(b"".join(self._held))
        self._held.clear()

    def acknowledge(self, error: str | None = None, note: str = "") -> None:
        """Send an ACK with an optional note; with ``error``, send a refusal with that text instead."""
        text = note if error is None else error
        if len(text) > LONGEST_TEXT:
            text = f"{text[:LONGEST_TEXT]} ..."
        ack = Ack(error=error is not None, msg=text) if text else Ack(error=error is not None)
        self.send(Message(type=Message.ACK, ack=ack))

    @property
    def backlog(self) -> int:
        """Number of bytes that wait to be sent to the client."""
        return self.transport.get_write_buffer_size()

    def any_session(self) -> Session | EpisodeSession:
        """Return the client's session, of a simulation or of a task's episodes; raises UsageError without one.

        Raises:
            UsageError: there is none.
        """
        if self.session is None and self.server.sharing is not None:
            return cast("Session", self.server.sharing.session)
        if self.session is None:
            raise UsageError(self.lost or "there is no session on this connection: send INIT first")
        return self.session

    def required_session(self) -> Session:
        """Return the client's session if it is one of a simulation; raises UsageError otherwise.

        Raises:
            UsageError: there is none, or it plays a task.
        """
        session = self.any_session()
        if isinstance(session, EpisodeSession):
            raise UsageError("this session plays a task: ACT advances it, and PLAY starts its next episode")
        return session

    def required_episodes(self) -> EpisodeSession:
        """Return the client's session if it is one of a task's episodes; raises UsageError otherwise.

        Raises:
            UsageError: there is none, or it plays no task.
        """
        if self.session is None and self.lost:
            raise UsageError(self.lost)
        if not isinstance(self.session, EpisodeSession):
            raise UsageError("no task is played on this connection: send PLAY first")
        return self.session

    def idle_s(self) -> float:
        """Return for how long [s] the server has waited for the client's next request; 0 while it answers one."""
        since = self._waits_since
        return 0.0 if since is None else asyncio.get_running_loop().time() - since

    async def pause(self, seconds: float) -> None:
        """Wait for a time [s], but stop early if the client leaves."""
        self.send_held()
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        if seconds > COARSE_S:
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds - COARSE_S):
                    await self.leaving.wait()
        rest = end - loop.time()
        if rest > 0.0 and not self.leaving.is_set():
            await loop.run_in_executor(None, time.sleep, rest)

    async def _serve(self, refused: str | None) -> None:
        """Serve the client until it leaves, then end its session; with ``refused``, a reason, only send it."""
        try:
            if refused is not None:
                self.acknowledge(refused)
            else:
                await self._answer_all()
        finally:
            try:
                await self.server.forget(self)
            finally:
                await self._close()

    async def _answer_all(self) -> None:
        """Answer the client's requests one after the other, until the connection is to be closed."""
        clock = asyncio.get_running_loop().time
        turn_ends = clock() + TURN_S
        while not self.gone.is_set():
            try:
                payload = self._deframer.next()
            except UsageError as error:
                self.acknowledge(str(error))
                return
            if self._full and self._deframer.waiting < LARGEST_REQUEST // 2:
                self._full = False
                self.transport.resume_reading()
            if payload is not None:
                if not await self._answer(payload):
                    return
                if self._can_write.is_set() and clock() < turn_ends:
                    continue
            self.send_held()
            if not self._can_write.is_set():
                self._waits_since = clock()
                await self._can_write.wait()
                self._waits_since = None
            elif payload is not None:
                await asyncio.sleep(0)
            elif self.leaving.is_set():
                return
            else:
                self._more = asyncio.get_running_loop().create_future()
                self._waits_since = clock()
                await self._more
                self._waits_since = None
            turn_ends = clock() + TURN_S

    async def _answer(self, payload: bytes) -> bool:
        """Answer the request in ``payload`` (protobuf bytes); return False if the connection is to be closed.

        After an INIT that fails the connection is closed, because the reference client waits for a second message.
        """
        message = Message()
        try:
            asked = known_step(self, payload)
            if asked is None:
                message.ParseFromString(payload)
                if not message.IsInitialized():
                    raise UsageError("message: a required field is missing, or a kind is unknown")
                if message.type != Message.STEP:
                    self.send_held()
                    await self.server.answer(self, message)
                    return message.type != Message.DISCONNECT
                asked = parsed_step(self, message, payload)
            await step(self, *asked)
            return True
        except DecodeError:
            self.acknowledge(f"message: {len(payload)} bytes that are no Message")
        except QrsimError as error:
            self.acknowledge(str(error))
        except Exception as error:
            self.server.report_bug(error)
            self.acknowledge(f"internal error of the server ({type(error).__name__}); see its output")
        return message.type != Message.INIT

    async def _close(self) -> None:
        """Close the connection once the client has read the last message, or after LINGER_S."""
        if not self.gone.is_set():
            self._discard = True
            if self._full:
                self.transport.resume_reading()
            with suppress(OSError, RuntimeError):
                self.transport.write_eof()
            loop = asyncio.get_running_loop()
            deadline = loop.time() + LINGER_S
            while not self.leaving.is_set() and loop.time() < deadline:
                self._more = loop.create_future()
                timer = loop.call_at(deadline, self._wake)
                await self._more
                timer.cancel()
        if self.backlog:
            asyncio.get_running_loop().call_later(LINGER_S, self.transport.abort)
        self.transport.close()
