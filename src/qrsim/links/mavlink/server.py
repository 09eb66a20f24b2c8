"""The server: one asyncio loop that has the world tick by the wall clock, and the sockets of all vehicles."""

from __future__ import annotations

import asyncio
import socket
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.frames import Frame, Reader
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.lockstep import Lockstep
from qrsim.links.mavlink.ports import GROUND_PEER, Ports
from qrsim.links.mavlink.streams import GROUND, ONBOARD, Streams
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.world import FlownWorld
from qrsim.links.pacing import Metronome, PaceReport

Address = tuple[str, int]
# Bytes that wait for a client by TCP: with more, streams are left out; with far more, it is given up.
MOST_STALE, MOST_WAITING = 1 << 16, 1 << 22
MOST_CLIENTS = 32
# Who sends so many bytes by TCP without a frame among them speaks another language, and is given up.
MOST_NONSENSE = 1 << 16
# So many bugs are reported with their traceback.
MOST_REPORTS = 5


@dataclass(frozen=True)
class Wire:
    """How a server speaks.

    Attributes:
        factor: simulated seconds per second of the wall clock.
        host: where vehicles speak to a program at first.
        ground: the same of a ground station.
        by_simulated_time: streams may go out more often than 100 times a second of the wall clock.
        lockstep: the world waits for those who fly its vehicles by set-points.
    """

    factor: float = 1.0
    host: str = "127.0.0.1"
    ground: str = "127.0.0.1"
    by_simulated_time: bool = False
    lockstep: bool = False


class Server:
    """MAVLink for the vehicles of a world.

    Args:
        world: whose vehicles they are.
        ports: bound.
        wire: how it speaks.
        say: told one line of what happens.
    """

    def __init__(self, world: FlownWorld, ports: Ports, wire: Wire, say: Callable[[str], None]):
        self._world, self._ports, self._wire, self._say = world, ports, wire, say
        self.systems = {system.number: system for system in world.systems}
        self.clients: set[_Connection] = set()
        self._bugs = 0
        step = world.simulation.world.time_step
        self._pacer = Metronome(wire.factor, 0.0, step)
        self._lockstep: Lockstep | None = None

    async def serve(self) -> None:
        """Open the sockets and advance the simulation at its pace, until the coroutine is cancelled."""
        loop = asyncio.get_running_loop()
        if self._wire.lockstep:
            self._lockstep = Lockstep(self._world.systems, self._say)
        count, ports = len(self._world.systems), self._ports
        for i, system in enumerate(self._world.systems):
            await self._open(ports.sockets[i], system, ONBOARD, (self._wire.host, ports.peers[i]), i / count)
            await self._open(ports.sockets[count + i], system, GROUND, (self._wire.ground, GROUND_PEER), i / count)
        if ports.tcp:
            await loop.create_server(lambda: _Connection(self), sock=ports.sockets[2 * count])
        if self._lockstep is not None:
            await self._lockstep.begun()
        step = self._world.simulation.world.time_step
        self._pacer = Metronome(self._wire.factor, self._world.simulation.time, step)
        while True:
            if self._lockstep is not None:
                await self._lockstep.answered()
            wait = self._pacer.until_s(self._world.simulation.time + step)
            # Also where it is late: others have their turn.
            await asyncio.sleep(max(0.0, wait))
            self._world.tick(time.monotonic())
            self._pacer.ended(self._world.simulation.time)

    def report(self) -> PaceReport:
        """Return statistics of the real-time pace."""
        return self._pacer.report()

    async def _open(
        self, sock: socket.socket, system: System, rates: dict[str, float], peer: Address, phase: float
    ) -> None:
        """Serve one vehicle on a UDP socket, sending to ``peer`` until a client writes; ``rates`` [Hz] by message,
        ``phase``: 0 to 1 of a period."""
        loop = asyncio.get_running_loop()
        await loop.create_datagram_endpoint(lambda: _Datagrams(self, system, rates, peer, phase), sock=sock)

    def streams(self, rates: dict[str, float], phase: float) -> Streams:
        """Return the message schedule of a new link, with default rates [Hz] by message name and a phase (0 to 1 of a
        period)."""
        step = self._world.simulation.world.time_step
        # Who waits for clients is as fast as they are, and they are to hear of every tick.
        by_simulated_time = self._wire.by_simulated_time or self._wire.lockstep
        return Streams(rates, step, self._wire.factor, by_simulated_time, phase)

    def heard(self, links: Iterable[tuple[System, Link]], frame: Frame) -> None:
        """Pass a received frame to each vehicle in ``links``; an exception in its answer is logged and does not end the
        flight."""
        for system, link in links:
            try:
                handle(system, link, frame)
            except Exception as error:
                self._bugs += 1
                if self._bugs <= MOST_REPORTS:
                    self._say(f"bug in the answer to {frame.layout.name}: {type(error).__name__}: {error}")
                    self._say("".join(traceback.format_exception(error)).rstrip())
        if self._lockstep is not None:
            self._lockstep.heard()

    def say(self, line: str) -> None:
        """Print a line for the operator."""
        self._say(line)


class _Datagrams(asyncio.DatagramProtocol):
    """A UDP socket of one vehicle; it speaks to whoever was heard last."""

    def __init__(self, server: Server, system: System, rates: dict[str, float], peer: Address, phase: float):
        self._server, self._system, self._peer = server, system, peer
        self._reader = Reader()
        self._link = Link(system.number, server.streams(rates, phase), self._send)
        self._transport: Any = None

    def connection_made(self, transport: object) -> None:
        """Store the transport, and add this client's address to the links of the vehicle."""
        self._transport = transport
        self._system.links.append(self._link)

    def datagram_received(self, data: bytes, address: Address) -> None:
        """Handle the MAVLink frames of a datagram, and send to its sender from now on."""
        for frame in self._reader.datagram(data):
            self._peer = address
            self._server.heard([(self._system, self._link)], frame)

    def error_received(self, error: Exception) -> None:
        """Ignore socket errors, such as a client that does not listen on the peer's port yet."""

    def _send(self, data: bytes) -> None:
        """Send bytes to the address that sent the last datagram."""
        if self._transport is not None:
            self._transport.sendto(data, self._peer)


class _Connection(asyncio.Protocol):
    """A client by TCP, who hears all vehicles."""

    def __init__(self, server: Server):
        self._server = server
        self._reader = Reader()
        self._links: dict[int, Link] = {}
        self._transport: asyncio.Transport | None = None
        self._nonsense = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Give a new TCP client a link to each vehicle; refuse it if there are too many clients."""
        assert isinstance(transport, asyncio.Transport)
        server = self._server
        if len(server.clients) >= MOST_CLIENTS:
            server.say(f"a client by TCP is refused: there are {MOST_CLIENTS}")
            transport.close()
            return
        self._transport = transport
        server.clients.add(self)
        for number, system in server.systems.items():
            streams = server.streams(ONBOARD, number / (len(server.systems) + 1))
            streams.begin_at(system.tick)
            link = Link(number, streams, self._send, self._has_room)
            self._links[number] = link
            system.links.append(link)

    def connection_lost(self, error: Exception | None) -> None:
        """Remove a closed TCP client's links from the vehicles."""
        self._transport = None
        self._server.clients.discard(self)
        for number, link in self._links.items():
            system = self._server.systems[number]
            system.links.remove(link)
            system.transfers.forget(link)

    def data_received(self, data: bytes) -> None:
        """Handle the frames in bytes from a TCP client; disconnect a client that sends too many bytes outside
        frames."""
        systems = self._server.systems
        self._nonsense += len(data)
        for frame in self._reader.feed(data):
            self._nonsense = 0
            self._server.heard([(systems[number], link) for number, link in self._links.items()], frame)

        if self._nonsense > MOST_NONSENSE:
            self._give_up("sends no MAVLink")

    def _has_room(self) -> bool:
        """Return whether the client reads fast enough: its send buffer is not full."""
        return self._transport is not None and self._transport.get_write_buffer_size() < MOST_STALE

    def _send(self, data: bytes) -> None:
        """Send bytes to the client; disconnect one that reads too slowly."""
        if self._transport is None or self._transport.is_closing():
            return
        if self._transport.get_write_buffer_size() > MOST_WAITING:
            self._give_up("does not read")
            return
        self._transport.write(data)

    def _give_up(self, why: str) -> None:
        """Close the connection to this client and log why."""
        if self._transport is not None:
            self._server.say(f"a client by TCP {why}, and is given up")
            self._transport.abort()
            self._transport = None
