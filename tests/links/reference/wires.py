"""Servers in a thread of this process, and clients that speak bytes."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step
from qrsim.links.reference.server import Options, Server
from qrsim.links.reference.tasks import Tasks

# Every test flies this scenario where it can, so that it is compiled once.
TASK = "free_flight"
HERE = [6.0, -8.0, -9.0]


@dataclass
class Running:
    """A server that runs; ``lines`` is what it says."""

    server: Server
    port: int
    loop: asyncio.AbstractEventLoop
    thread: threading.Thread
    lines: list[str]


@contextlib.contextmanager
def running(tasks: Tasks | None = None, **options: Any) -> Iterator[Running]:
    """Serve in another thread until the block ends; what was unexpected there fails here."""
    started: list[Running] = []
    lines: list[str] = []
    bugs: list[Exception] = []
    ready = threading.Event()

    async def main() -> None:
        server = Server(Options(port=0, **options), tasks or Tasks(), lines.append)
        server.report_bug = bugs.append  # type: ignore[method-assign]
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: bugs.append(RuntimeError(str(context))))

        def listens(host: str, port: int) -> None:
            started.append(Running(server, port, loop, threading.current_thread(), lines))
            ready.set()

        await server.serve(listens)

    thread = threading.Thread(target=asyncio.run, args=(main(),))
    thread.start()
    assert ready.wait(30.0)
    try:
        yield started[0]
    finally:
        with contextlib.suppress(RuntimeError):  # it has ended already
            started[0].loop.call_soon_threadsafe(started[0].server.stop)
        thread.join(30.0)
    assert not thread.is_alive()
    assert bugs == []


class Wire:
    """A connection that sends and receives bytes."""

    def __init__(self, port: int):
        self.socket = socket.create_connection(("127.0.0.1", port), 60.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def __enter__(self) -> Wire:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def send(self, *messages: Message) -> None:
        """Send requests in one write."""
        self.socket.sendall(b"".join(frame(message.SerializeToString()) for message in messages))

    def exactly(self, size: int) -> bytes:
        """Receive so many bytes."""
        found = b""
        while len(found) < size:
            data = self.socket.recv(size - len(found))
            if not data:
                raise EOFError(f"{len(found)} of {size} bytes")
            found += data
        return found

    def payload(self) -> bytes:
        """Receive one message, as bytes."""
        head = self.exactly(5)
        assert head[0] == 0x0D
        return self.exactly(int.from_bytes(head[1:], "little"))

    def receive(self) -> Message:
        """Receive one message."""
        return Message.FromString(self.payload())

    def ask(self, message: Message) -> Message:
        """Send one request and receive one reply."""
        self.send(message)
        return self.receive()

    def refused(self, message: Message | bytes) -> str:
        """Send a request, framed already if it is bytes, and return the text of the error it gets."""
        if isinstance(message, bytes):
            self.socket.sendall(message)
            reply = self.receive()
        else:
            reply = self.ask(message)
        assert reply.type == Message.ACK
        assert reply.ack.error
        return reply.ack.msg

    def init(self, task: str = TASK) -> Message:
        """Start a task; return the STATE, the TASKINFO being checked."""
        state = self.ask(Message(type=Message.INIT, init=pb.Init(task=task)))
        assert state.type == Message.STATE, state
        assert self.receive().type == Message.TASKINFO
        return state

    def closed(self) -> bool:
        """Wait for the end of the connection; return whether nothing came before it."""
        return self.socket.recv(1) == b""


def step(kind: Step.Type = Step.WP, *rows: list[float], dt: float = 0.02) -> Message:
    """Return a STEP, by default one to hold the start."""
    rows = rows or ([*HERE, 0.0],)
    return Message(type=Message.STEP, step=Step(dt=dt, type=kind, cmd=[pb.Arrayd(value=row) for row in rows]))


HELLO = Message(type=Message.HELLO, hello=pb.Hello())
RESET = Message(type=Message.RESET, reset=pb.Reset(value=True))
DISCONNECT = Message(type=Message.DISCONNECT, disconnect=pb.Disconnect(quit=False))
QUIT = Message(type=Message.DISCONNECT, disconnect=pb.Disconnect(quit=True))
