"""UDP sockets of a participant: the multicast of discovery, and its own port."""

from __future__ import annotations

import os
import re
import socket
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress

from qrsim.links.ros2.rtps.wire import Locator

GROUP = "239.255.0.1"
# Ports of RTPS: 7400 + 250 times the domain.
_FIRST, _PER_DOMAIN = 7400, 250
_LARGEST, _MOST_AT_ONCE = 65536, 256
_SIOCGIFADDR = 0x8915


def addresses() -> list[str]:
    """Return this machine's IPv4 addresses, only those of CYCLONEDDS_URI if set; loopback only if there is no other."""
    chosen = re.findall(r"NetworkInterface[^>]*\bname=[\"']([^\"']+)", os.environ.get("CYCLONEDDS_URI", ""))
    found = {name: address for name, address in _interfaces() if not chosen or name in chosen}
    # The loopback is for who has nothing else.
    others = [address for address in found.values() if not address.startswith("127.")]
    return others or list(found.values()) or ["127.0.0.1"]


def _interfaces() -> Iterator[tuple[str, str]]:
    """Yield (name, IPv4 address) of each network interface of this machine."""
    if sys.platform != "linux":
        with suppress(OSError):
            yield "", socket.gethostbyname(socket.gethostname())
        return
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            with suppress(OSError):
                found = fcntl.ioctl(asked.fileno(), _SIOCGIFADDR, struct.pack("256s", name[:15].encode()))
                yield name, socket.inet_ntoa(found[20:24])


class Sockets:
    """The sockets of a participant.

    Args:
        domain: of DDS.

    Raises:
        OSError: there is no port, or no multicast.

    Attributes:
        own: addresses and port at which others reach it.
    """

    def __init__(self, domain: int):
        self._port = _FIRST + _PER_DOMAIN * domain
        places = addresses()
        self._discovery = socket.socket(socket.AF_INET, socket.SOCK_DGRAM, socket.IPPROTO_UDP)
        self._discovery.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._discovery.bind((GROUP if sys.platform == "linux" else "", self._port))
        self._unicast = socket.socket(socket.AF_INET, socket.SOCK_DGRAM, socket.IPPROTO_UDP)
        self._unicast.bind(("", 0))
        self._senders = []
        for address in places:
            joined = socket.inet_aton(GROUP) + socket.inet_aton(address)
            self._discovery.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM, socket.IPPROTO_UDP)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
            self._senders.append(sender)
        for each in (self._discovery, self._unicast, *self._senders):
            each.setblocking(False)
        port = self._unicast.getsockname()[1]
        self.own: list[Locator] = [(address, port) for address in places]

    def received(self) -> Iterator[bytes]:
        """Yield the packets that have arrived, without waiting."""
        for each in (self._discovery, self._unicast):
            for _ in range(_MOST_AT_ONCE):
                try:
                    yield each.recv(_LARGEST)
                except OSError:
                    break

    def announce(self, packet: bytes) -> None:
        """Send a packet to the multicast address of participant discovery."""
        for each in self._senders:
            with suppress(OSError):
                each.sendto(packet, (GROUP, self._port))

    def send(self, packet: bytes, place: Locator) -> None:
        """Send a packet to one address and port; never waits."""
        with suppress(OSError):
            self._unicast.sendto(packet, place)

    def close(self) -> None:
        """Close all sockets."""
        for each in (self._discovery, self._unicast, *self._senders):
            each.close()
