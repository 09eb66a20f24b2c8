"""Which sockets vehicles have, and where they speak to at first."""

from __future__ import annotations

import errno
import socket
from contextlib import suppress
from dataclasses import dataclass

from qrsim.errors import RunError

ONBOARD, ONBOARD_PEER, LAST_OWN_PEER = 14580, 14540, 9
GROUND, GROUND_PEER, TCP = 18570, 14550, 5760
# Where a block of ports is taken, the next one is so far away: at least this, and past the vehicles.
STEP, TCP_STEP, MOST_BLOCKS = 100, 10, 20
HERE, EVERYWHERE = "127.0.0.1", "0.0.0.0"


@dataclass(frozen=True)
class Ports:
    """The sockets of n vehicles.

    Attributes:
        block: 0, or how many blocks of ports were taken.
        onboard: the first of their ports for programs; the others follow.
        ground: the first of their ports for a ground station.
        peers: where each vehicle speaks to a program until it hears from one.
        tcp: port of the listener; 0: none.
        sockets: onboard of each vehicle, then for the ground station of each, then the listener if there is one.
    """

    block: int
    onboard: int
    ground: int
    peers: tuple[int, ...]
    tcp: int
    sockets: tuple[socket.socket, ...]

    def close(self) -> None:
        """Close all sockets."""
        for each in self.sockets:
            with suppress(OSError):
                each.close()


def opened(count: int, host: str, tcp: bool, own_ports: bool) -> Ports:
    """Bind the sockets of ``count`` vehicles (UDP, and TCP if ``tcp``) on ``host``, in the first free block of ports.

    Args:
        count: vehicles.
        host: address of this machine.
        tcp: whether there is a listener.
        own_ports: whether each vehicle speaks to a port of its own, beyond the tenth too.

    Raises:
        RunError: no block is free, or the address is not of this machine.
    """
    step = STEP * -(-(count + 40) // STEP)
    for block in range(MOST_BLOCKS):
        shift = block * step
        onboard, ground, listener = ONBOARD + shift, GROUND + shift, (TCP + block * TCP_STEP) if tcp else 0
        last = count - 1 if own_ports else LAST_OWN_PEER
        peers = tuple(ONBOARD_PEER + shift + min(i, last) for i in range(count))
        found: list[socket.socket] = []
        try:
            for first in (onboard, ground):
                for i in range(count):
                    found.append(_bound(socket.SOCK_DGRAM, host, first + i))
            if tcp:
                found.append(_bound(socket.SOCK_STREAM, host, listener))
        except OSError as error:
            for each in found:
                each.close()
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                continue
            raise RunError(f"{host}: {error.strerror or error}") from None
        return Ports(block, onboard, ground, peers, listener, tuple(found))
    raise RunError(
        f"ports {ONBOARD} and {GROUND} and the {MOST_BLOCKS - 1} blocks {step} apart after them are all taken: other "
        "simulations run on this machine"
    )


def _bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Return a non-blocking socket, of UDP or TCP (``kind``), bound to a host and port."""
    found = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host, port))
        found.setblocking(False)
    except BaseException:
        found.close()
        raise
    return found
