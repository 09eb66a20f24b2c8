"""The server: connections, sessions and watchers."""

from __future__ import annotations

import asyncio
import errno
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from qrsim.errors import RunError, UsageError
from qrsim.links.reference.connection import MOST_WAITING, Connection
from qrsim.links.reference.episode_session import EpisodeSession
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.requests import HANDLERS, NEEDED, OWNED, SHARED
from qrsim.links.reference.roles import Options
from qrsim.links.reference.seeds import Seeds
from qrsim.links.reference.session import Session, SessionOptions
from qrsim.links.reference.shared_requests import has_no_owner
from qrsim.links.reference.shared_session import SharedSession
from qrsim.links.reference.sharing import Sharing
from qrsim.links.reference.tasks import Tasks

T = TypeVar("T")
S = TypeVar("S", Session, EpisodeSession)
# A client that reconnects can be here before it is known that its old connection has gone, or before its last step has
# ended.
PATIENCE_S, LEAVING_S = 0.3, 30.0
BACKLOG = 256
MOST_BETWEEN_LOOKS_S = 5.0


@dataclass
class Watching:
    """The session that a connection watches.

    Attributes:
        session: id; None: whichever runs.
        period: least simulated time between two states [s].
        last: simulated time of the last one [s].
        missed: states that it was too slow for.
    """

    session: int | None
    period: float
    last: float = -1.0
    missed: int = 0


class Server:
    """Serves clients until it is stopped.

    Args:
        options: the operator's.
        tasks: what clients can ask for.
        say: called with one line for whoever watches the server.

    Attributes:
        sessions: id -> session.
        seeds: of the episodes of all clients that ask for no seed of their own.
        sharing: the world that all clients share; None where each session has an owner.
    """

    def __init__(self, options: Options, tasks: Tasks, say: Callable[[str], None] = lambda line: None):
        self.options, self.tasks, self.say = options, tasks, say
        self.sessions: dict[int, Session | EpisodeSession] = {}
        self.seeds = Seeds(options.seed, options.episodes)
        self._connections: set[Connection] = set()
        self._watching: dict[Connection, Watching] = {}
        self._opened = 0
        self._opening = 0
        # Of those whose owner has lost them already.
        self._ending = 0
        self._endings: set[asyncio.Task[None]] = set()
        self._stopped = threading.Event()
        self._stopping = asyncio.Event()
        self._others = ThreadPoolExecutor(1, thread_name_prefix="load")
        self._numbered = 0
        self.sharing: Sharing | None = None

    # ---- life ----

    async def serve(self, ready: Callable[[str, int], None] = lambda host, port: None) -> None:
        """Listen for clients and serve them until ``stop`` is called; ``ready`` is called with the host and port.

        Args:
            ready: called with the address as soon as clients can connect.

        Raises:
            RunError: the port is in use, or the host is not this machine's.
        """
        loop = asyncio.get_running_loop()
        try:
            listening = await loop.create_server(
                lambda: Connection(self), self.options.host, self.options.port, backlog=BACKLOG, start_serving=False
            )
        except OSError as error:
            raise RunError(self._listen_error(error)) from None
        except OverflowError:
            raise UsageError(f"--port {self.options.port}: expected 0 to 65535") from None
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                with suppress(NotImplementedError):
                    loop.add_signal_handler(number, self.stop)
        if self.options.idle_timeout:
            threading.Thread(target=self._watch_idle, args=(loop,), name="idle", daemon=True).start()
        # Nobody gets in before there is a world to share.
        begun = await self._start_shared() if self.options.pace != "owner" else ""
        try:
            await listening.start_serving()
        except OSError as error:
            # Another server can have begun to listen there meanwhile.
            raise RunError(self._listen_error(error)) from None
        ready(*listening.sockets[0].getsockname()[:2])
        if begun:
            self.say(begun)
        try:
            await self._stopping.wait()
        finally:
            self._stopped.set()
        listening.close()
        await self._end_all()

    async def _start_shared(self) -> str:
        """Start the world that all clients share, and return a line about it for the operator."""
        options = self.options
        scenario = await self.run_in_thread(lambda: self.tasks.offboard(""))
        session_options = SessionOptions(
            scenario, self.seeds, realtime=options.realtime, events=True, record=options.record
        )
        self._opened += 1
        session = SharedSession(
            self._opened, session_options, options.view, pace=options.pace, silence=options.silence, say=self.say
        )
        begun = await self._start_session(session)
        self.sharing = Sharing(self, session, options.barrier_timeout)
        return f"{begun}, pace {session.pace}"

    async def _start_session(self, session: Session | EpisodeSession) -> str:
        """Start a session in a thread for it, and return a line about it for the operator."""
        try:
            await asyncio.get_running_loop().run_in_executor(session.thread, session.begin)
        except BaseException:
            session.end()
            raise
        self.sessions[session.number] = session
        count = f"{session.size} vehicle{'s' if session.size != 1 else ''}"
        return f"session {session.number} begins: {session.scenario.name}, {count}, seed {session.seed}"

    def _listen_error(self, error: OSError) -> str:
        """Return the message for a host and port on which the server cannot listen."""
        where = f"{self.options.host}:{self.options.port}"
        if error.errno == errno.EADDRINUSE:
            return f"cannot listen on {where}: the port is in use; choose another with --port, or 0 for any"
        return f"cannot listen on {where}: {error.strerror or error}"

    def stop(self) -> None:
        """Stop the server; call it only from the server's own thread."""
        self._stopping.set()

    async def _end_all(self) -> None:
        """Close all connections, the shared world and all threads, waiting at most 5 s for the clients."""
        for connection in list(self._connections):
            connection.gone_soon()
        tasks = [connection.finished for connection in self._connections if connection.finished]
        tasks += self._endings
        if tasks:
            await asyncio.wait(tasks, timeout=5.0)
        if self.sharing is not None:
            await self._end_sharing(self.sharing)
        self._others.shutdown(wait=False)

    async def _end_sharing(self, sharing: Sharing) -> None:
        """Stop the world that clients share, once its present tick is over."""
        session = sharing.session
        async with sharing.lock:
            sharing.end()
        await self._end_session(session)

    def admit(self, connection: Connection) -> str | None:
        """Register a client's connection; return the reason for refusing it, or None."""
        self._numbered += 1
        connection.number = self._numbered
        refused = None
        if len(self._connections) >= self.options.max_clients:
            refused = f"the server has {self.options.max_clients} clients, which is all that its operator allows"
        self._connections.add(connection)
        return refused

    async def forget(self, connection: Connection) -> None:
        """End the session of a connection that closes, and stop sending states to it."""
        await self.close_session(connection)
        if self.sharing is not None:
            self.sharing.forget(connection)
        self._watching.pop(connection, None)
        self._connections.discard(connection)

    def report_bug(self, error: Exception) -> None:
        """Print an unexpected exception for the operator."""
        print("".join(traceback.format_exception(error)), file=sys.stderr, flush=True)

    # ---- requests ----

    async def answer(self, connection: Connection, message: Message) -> None:
        """Answer a client's request by the handler of its message type.

        Raises:
            QrsimError: it was wrong; nothing was sent.
        """
        name = Message.Type.Name(message.type)
        handler = HANDLERS.get(message.type)
        if handler is None:
            raise UsageError(f"{name} is not a request")
        needed = NEEDED.get(message.type)
        if needed is not None and not message.HasField(needed):
            raise UsageError(f"{name}: the message has no '{needed}'")
        if self.sharing is None:
            if message.type in SHARED:
                raise UsageError(
                    f"{name}: this server's worlds are flown by one client each; its operator can have several fly one "
                    "(--pace barrier or free)"
                )
        elif message.type in OWNED:
            raise has_no_owner(self, name)
        await handler(connection, message)

    async def open(self, connection: Connection, make: Callable[[int], S]) -> S:
        """Start the session that ``make(id)`` returns for a connection, in place of its present one, and return it.

        Args:
            connection: whose it is to be.
            make: returns the session of a number.

        Raises:
            UsageError: another client has the only session.
            RunError: it cannot be recorded, or a fleet found no place.
        """
        await self.close_session(connection)
        if not self.options.sessions:
            begun = asyncio.get_running_loop().time()
            while self._opening or self.sessions:
                patience = LEAVING_S if self._owner_leaves() else PATIENCE_S
                if asyncio.get_running_loop().time() > begun + patience:
                    raise UsageError(
                        "another client controls this server's simulation; watch it (WATCH), or ask the operator for "
                        "a session of your own (--sessions)"
                    )
                await asyncio.sleep(0.01)
        self._watching.pop(connection, None)
        self._opened += 1
        self._opening += 1
        session = make(self._opened)
        try:
            line = await self._start_session(session)
        finally:
            self._opening -= 1
        connection.session, connection.lost = session, ""
        self.say(line)
        return session

    def _watch_idle(self, loop: asyncio.AbstractEventLoop) -> None:
        """Look for idle owners from a thread, since a timer of the event loop would slow down every request."""
        while not self._stopped.wait(min(0.25 * self.options.idle_timeout, MOST_BETWEEN_LOOKS_S)):
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._end_idle)

    def _end_idle(self) -> None:
        """End the sessions of clients that have sent no request for too long."""
        longest = self.options.idle_timeout
        for connection in self._connections:
            session = connection.session
            if session is None or connection.idle_s() < longest:
                continue
            why = f"its owner asked for nothing for {longest:g} s (--idle-timeout)"
            connection.session = None
            connection.lost = f"session {session.number} has ended, because {why}; INIT or OPEN begin another"
            ending = asyncio.get_running_loop().create_task(self._end_session(session, f", because {why}"))
            self._endings.add(ending)
            ending.add_done_callback(self._endings.discard)

    def _owner_leaves(self) -> bool:
        """Return whether a session is just ending, or the client that owns one is leaving."""
        return self._ending > 0 or any(
            other.session is not None and other.leaving.is_set() for other in self._connections
        )

    async def close_session(self, connection: Connection) -> None:
        """End the session of a connection, if it has one."""
        session = connection.session
        if session is None:
            return
        connection.session = None
        await self._end_session(session)

    async def _end_session(self, session: Session | EpisodeSession, why: str = "") -> None:
        """End a session in its thread, remove it, and print its summary for the operator; ``why``: reason of the
        end."""
        self._ending += 1
        try:
            await self.run(session, session.end)
        finally:
            self._ending -= 1
            self.sessions.pop(session.number, None)
        self.say(f"session {session.number} ended{why}: {session.summary()}")

    async def run_in_thread(self, work: Callable[[], T]) -> T:
        """Await the result of slow work that belongs to no session, run in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._others, work)

    async def run(self, session: Session | EpisodeSession, work: Callable[[], T]) -> T:
        """Await the result of slow work on a session, run in that session's thread."""
        return await asyncio.get_running_loop().run_in_executor(session.thread, work)

    async def advance(self, connection: Connection, session: Session, command: object, ticks: int) -> None:
        """Advance a session by ``ticks`` with a command, in the session's thread; raises UsageError if the client
        leaves first.

        Raises:
            UsageError: the command cannot be flown, and nothing has changed; or its client leaves meanwhile.
        """
        connection.send_held()
        loop = asyncio.get_running_loop()
        left = ticks
        while left:
            count = session.piece(command, left)
            await loop.run_in_executor(session.thread, session.advance, command, count)
            left -= count
            if left and connection.leaving.is_set():
                raise UsageError(f"STEP: ended at {session.time:g} s, because the client closes the connection")

    # ---- watching ----

    def watch(self, connection: Connection, session: int | None, period: float, stop: bool) -> None:
        """Start or stop (``stop``) sending a session's states to a connection; ``period``: least simulated time between
        two [s].

        Raises:
            UsageError: there is no such session, or it is not said which.
        """
        if stop:
            self._watching.pop(connection, None)
            return
        if session is not None and session not in self.sessions:
            running = ", ".join(map(str, sorted(self.sessions))) or "none"
            raise UsageError(f"WATCH: there is no session {session}; running: {running}")
        if session is None and self.options.sessions:
            if len(self.sessions) != 1:
                raise UsageError(f"WATCH: {len(self.sessions)} sessions run; name one")
            session = next(iter(self.sessions))
        self._watching[connection] = Watching(session, period)

    def broadcast(self, session: Session | EpisodeSession, states: dict[bool, bytes] | None = None) -> None:
        """Send a session's state to all clients that watch it, except those that read too slowly; ``states``: already
        encoded.

        Args:
            session: whose state.
            states: its frames with and without reasons, as far as they are there already.
        """
        states = states or {}
        for connection, watching in self._watching.items():
            if watching.session not in (None, session.number):
                continue
            # A time that has gone back is another episode.
            if 0.0 <= session.time - watching.last < watching.period * (1.0 - 1e-9) and session.time:
                continue
            if connection.backlog > MOST_WAITING:
                watching.missed += 1
                continue
            watching.last = session.time
            if connection.reasons not in states:
                states[connection.reasons] = session.states.frame(connection.reasons)
            connection.send_frame(states[connection.reasons])
