"""The server and its connections as the handlers of requests see them, and the operator's options."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from qrsim.links.contracts import Pace, Silence
from qrsim.links.reference.episode_session import EpisodeSession
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.seeds import Seeds
from qrsim.links.reference.session import Session
from qrsim.links.reference.tasks import Tasks

if TYPE_CHECKING:
    from qrsim.view.live import LiveView

T = TypeVar("T")
S = TypeVar("S", Session, EpisodeSession)


@dataclass(frozen=True)
class Options:
    """The operator's options; see ``qrsim serve``."""

    host: str = "127.0.0.1"
    port: int = 10000
    realtime: float = 0.0
    allow_quit: bool = False
    max_clients: int = 32
    record: Path | None = None
    sessions: bool = False
    seed: int = 0
    episodes: str = "new"
    idle_timeout: float = 0.0
    view: LiveView | None = None
    pace: Pace = "owner"
    silence: Silence = field(default_factory=Silence)
    barrier_timeout: float = 0.0
    allow_inject: bool = False


class Host(Protocol):
    """The server (server.py); ``connection`` is a Client."""

    options: Options
    tasks: Tasks
    seeds: Seeds

    @property
    def sessions(self) -> Mapping[int, Any]:
        """Sessions of the server by their ids."""

    @property
    def say(self) -> Callable[[str], None]:
        """Function that prints a line for the server's operator."""

    @property
    def sharing(self) -> Any:
        """World that all clients share (sharing.py); None if each session has a world to itself."""

    def stop(self) -> None:
        """Stop the server."""

    def admit(self, connection: Any) -> str | None:
        """Register a client's connection; return the reason for refusing it, or None."""

    def report_bug(self, error: Exception) -> None:
        """Print an internal error for the operator."""

    def forget(self, connection: Any) -> Awaitable[None]:
        """End the session of a closed connection, and stop sending states to it."""

    def answer(self, connection: Any, message: Message) -> Awaitable[None]:
        """Answer a request of a connection."""

    def open(self, connection: Any, make: Callable[[int], S]) -> Awaitable[S]:
        """Start the session that ``make(id)`` returns for a connection, in place of its present one, and return it."""

    def close_session(self, connection: Any) -> Awaitable[None]:
        """End the session of a connection, if it has one."""

    def run_in_thread(self, work: Callable[[], T]) -> Awaitable[T]:
        """Await the result of slow work, run in a thread."""

    def run(self, session: Session | EpisodeSession, work: Callable[[], T]) -> Awaitable[T]:
        """Await the result of slow work on a session, run in that session's thread."""

    def advance(self, connection: Any, session: Session, command: Any, ticks: int) -> Awaitable[None]:
        """Advance a session by ``ticks`` with a command, in the session's thread."""

    def watch(self, connection: Any, session: int | None, period: float, stop: bool) -> None:
        """Start or stop (``stop``) sending a session's states to a connection; ``period``: least simulated time between
        two [s]."""

    def broadcast(self, session: Session | EpisodeSession, states: dict[bool, bytes] | None = None) -> None:
        """Send a session's state to all clients that watch it; ``states``: already encoded, without and with
        reasons."""


class Client(Protocol):
    """A connection (connection.py)."""

    server: Host
    session: Session | EpisodeSession | None
    reasons: bool
    number: int
    leaving: asyncio.Event

    @property
    def backlog(self) -> int:
        """Number of bytes that wait to be sent to this client."""

    def send(self, message: Message) -> None:
        """Send a protobuf message to this client."""

    def send_frame(self, content: bytes) -> None:
        """Send framed messages, as bytes, to this client."""

    def hold_frame(self, content: bytes) -> None:
        """Hold framed messages, as bytes, until the next send to this client."""

    def acknowledge(self, error: str | None = None, note: str = "") -> None:
        """Send an ACK with an optional note; with ``error``, a refusal with that text instead."""

    def any_session(self) -> Session | EpisodeSession:
        """Return the client's session, of a simulation or of a task's episodes; raises UsageError without one."""

    def required_session(self) -> Session:
        """Return the client's session of a simulation; raises UsageError without one."""

    def required_episodes(self) -> EpisodeSession:
        """Return the client's session of a task's episodes; raises UsageError without one."""

    def pause(self, seconds: float) -> Awaitable[None]:
        """Wait for a time [s]; end early if the client leaves."""
