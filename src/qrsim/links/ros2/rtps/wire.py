"""Messages of RTPS 2.3 as bytes: headers, submessages, lists of parameters, sets of sequence numbers.

Source: OMG, The Real-time Publish-Subscribe Protocol DDSI-RTPS 2.3, chapter 9. All numbers are little endian here;
messages of others are read in their own order.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

HEADER = b"RTPS\x02\x03\x00\x00"
HEADER_SIZE, GUID_SIZE = 20, 16
# Kinds of submessages.
ACKNACK, HEARTBEAT, GAP, INFO_DST, DATA = 0x06, 0x07, 0x08, 0x0E, 0x15
# Flags: little endian; of DATA inline parameters and a payload; of ACKNACK and HEARTBEAT that no answer is needed.
LITTLE, INLINE, PAYLOAD, FINAL = 0x01, 0x02, 0x04, 0x02
_KEY = 0x08
# Parameters.
SENTINEL, LEASE, TOPIC, TYPE, DOMAIN, VERSION, VENDOR = 0x01, 0x02, 0x05, 0x07, 0x0F, 0x15, 0x16
RELIABILITY, DURABILITY, USER_DATA, UNICAST, DEFAULT_UNICAST, METATRAFFIC = 0x1A, 0x1D, 0x2C, 0x2F, 0x31, 0x32
PARTICIPANT_GUID, BUILTIN, ENDPOINT_GUID, STATUS, RELATED = 0x50, 0x58, 0x5A, 0x71, 0x83
# Of Fast DDS, before the standard had one.
RELATED_BEFORE = 0x800F
PL_CDR = b"\0\3\0\0"
# Of a status: the instance was disposed of and unregistered.
GONE = b"\0\0\0\3"
_UDP4 = 1
_MOST_BITS = 256
UNKNOWN_ENTITY = b"\0\0\0\0"
Locator = tuple[str, int]


@dataclass(frozen=True)
class Submessage:
    """One submessage of another participant.

    Attributes:
        kind, flags: of it.
        body: its bytes.
        prefix: of the GUID of who sends it.
        vendor: of that participant.
    """

    kind: int
    flags: int
    body: bytes
    prefix: bytes
    vendor: bytes

    @property
    def order(self) -> str:
        """Byte order of the submessage as ``struct`` writes it: "<" or ">"."""
        return "<" if self.flags & LITTLE else ">"


def submessages(packet: bytes, own: bytes) -> Iterator[Submessage]:
    """Yield the submessages of an RTPS packet that are addressed to all participants or to the one with GUID prefix
    ``own``.

    Args:
        packet: of anybody.
        own: prefix of the participant's GUID.
    """
    if len(packet) < HEADER_SIZE or packet[:4] != b"RTPS":
        return
    vendor, prefix, at, meant = packet[6:8], packet[8:20], HEADER_SIZE, True
    while at + 4 <= len(packet):
        kind, flags = packet[at], packet[at + 1]
        (size,) = struct.unpack_from("<H" if flags & LITTLE else ">H", packet, at + 2)
        # The last one may leave its size out.
        end = at + 4 + size if size else len(packet)
        body = packet[at + 4 : end]
        at = end
        if kind == INFO_DST:
            meant = body[:12] in (own, bytes(12))
        elif meant and len(body) >= 8:
            yield Submessage(kind, flags, body, prefix, vendor)


def packet(prefix: bytes, *parts: bytes, to: bytes | None = None) -> bytes:
    """Return an RTPS packet of encoded submessages (``parts``) from a GUID prefix, to one participant or (None) to
    all."""
    first = b"" if to is None else submessage(INFO_DST, 0, to)
    return HEADER + prefix + first + b"".join(parts)


def submessage(kind: int, flags: int, body: bytes) -> bytes:
    """Return an RTPS submessage: header (``kind``, ``flags``, length) and body."""
    return struct.pack("<BBH", kind, flags | LITTLE, len(body)) + body


def number(value: int) -> bytes:
    """Encode an RTPS sequence number, 8 bytes."""
    return struct.pack("<iI", value >> 32, value & 0xFFFFFFFF)


def number_at(message: Submessage, at: int) -> int:
    """Decode the sequence number at byte offset ``at`` of a submessage."""
    high, low = struct.unpack_from(message.order + "iI", message.body, at)
    return int(high) << 32 | int(low)


def numbers(base: int, members: Iterable[int]) -> bytes:
    """Encode a set of sequence numbers as ``base`` and a bit map; members too far above ``base`` are left out."""
    near = [each - base for each in members if 0 <= each - base < _MOST_BITS]
    count = max(near, default=-1) + 1
    words = [0] * -(-count // 32)
    for bit in near:
        words[bit // 32] |= 1 << (31 - bit % 32)
    return number(base) + struct.pack(f"<I{len(words)}I", count, *words)


def numbers_at(message: Submessage, at: int) -> tuple[int, list[int]]:
    """Decode the set of sequence numbers at byte offset ``at`` of a submessage to its base and members."""
    base = number_at(message, at)
    (count,) = struct.unpack_from(message.order + "I", message.body, at + 8)
    count = min(count, _MOST_BITS)
    words = struct.unpack_from(f"{message.order}{-(-count // 32)}I", message.body, at + 12)
    return base, [base + bit for bit in range(count) if words[bit // 32] & 1 << (31 - bit % 32)]


def data(
    reader: bytes, writer: bytes, sequence: int, payload: bytes, inline: bytes = b"", is_key: bool = False
) -> bytes:
    """Return a DATA submessage with a payload; ``inline``: an encoded parameter list; ``reader``, ``writer``: entity
    ids."""
    flags = (INLINE if inline else 0) | (_KEY if is_key else PAYLOAD)
    # Where the inline parameters or the payload begin, after what is before them.
    whole = payload + bytes(-len(payload) % 4)
    body = struct.pack("<HH", 0, 16) + reader + writer + number(sequence) + inline + whole
    return submessage(DATA, flags, body)


def heartbeat(reader: bytes, writer: bytes, first: int, last: int, count: int) -> bytes:
    """Return a HEARTBEAT submessage (sequence numbers ``first`` to ``last`` are available) that asks for an answer."""
    return submessage(HEARTBEAT, 0, reader + writer + number(first) + number(last) + struct.pack("<i", count))


def acknack(reader: bytes, writer: bytes, base: int, missing: Iterable[int], count: int) -> bytes:
    """Return an ACKNACK submessage: all numbers below ``base`` have arrived, the ones in ``missing`` have not."""
    asked = numbers(base, missing)
    flags = FINAL if asked[8:] == bytes(4) else 0
    return submessage(ACKNACK, flags, reader + writer + asked + struct.pack("<i", count))


def gap(reader: bytes, writer: bytes, missing: int) -> bytes:
    """Return a GAP submessage, which tells a reader that the sequence number ``missing`` will not be sent."""
    return submessage(GAP, 0, reader + writer + number(missing) + numbers(missing + 1, ()))


def data_parts(message: Submessage) -> tuple[list[tuple[int, bytes]], bytes]:
    """Return a DATA submessage's inline parameters, as (identifier, value) pairs, and its payload."""
    (skip,) = struct.unpack_from(message.order + "H", message.body, 2)
    at, inline = 4 + skip, list[tuple[int, bytes]]()
    if message.flags & INLINE:
        inline, at = _parameters_from(message.body, at, message.order)
    return inline, message.body[at:]


def parameters(payload: bytes) -> dict[int, list[bytes]]:
    """Return identifier -> values of an encoded parameter list with its encapsulation header."""
    order = {b"\0\2": ">", b"\0\3": "<"}.get(payload[:2])
    found: dict[int, list[bytes]] = {}
    if order is not None:
        for identifier, value in _parameters_from(payload, 4, order)[0]:
            found.setdefault(identifier, []).append(value)
    return found


def _parameters_from(message: bytes, at: int, order: str) -> tuple[list[tuple[int, bytes]], int]:
    """Decode (identifier, value) pairs from byte offset ``at`` on; also return the offset of their end. ``order``: "<"
    or ">"."""
    found = []
    while at + 4 <= len(message):
        identifier, size = struct.unpack_from(order + "HH", message, at)
        at += 4
        if identifier == SENTINEL:
            break
        found.append((identifier, message[at : at + size]))
        at += size
    return found, at


def listed(*values: tuple[int, bytes]) -> bytes:
    """Encode (identifier, value) pairs as an RTPS parameter list."""
    found = b""
    for identifier, value in values:
        padded = value + bytes(-len(value) % 4)
        found += struct.pack("<HH", identifier, len(padded)) + padded
    return found + struct.pack("<HH", SENTINEL, 0)


def text(value: str) -> bytes:
    """Encode a string as an RTPS parameter's value."""
    raw = value.encode() + b"\0"
    return struct.pack("<I", len(raw)) + raw


def text_of(value: bytes, little: bool) -> str:
    """Decode an RTPS parameter's value as a string; ``little``: its length is little-endian."""
    (size,) = struct.unpack_from("<I" if little else ">I", value)
    return value[4 : 3 + size].decode("utf-8", "replace")


def octets(value: bytes) -> bytes:
    """Encode bytes, with their length, as an RTPS parameter's value."""
    return struct.pack("<I", len(value)) + value


def locator(address: str, port: int) -> bytes:
    """Encode an IPv4 address and UDP port as an RTPS locator."""
    return struct.pack("<iI", _UDP4, port) + bytes(12) + bytes(int(part) for part in address.split("."))


def locator_of(value: bytes, little: bool) -> Locator | None:
    """Decode an RTPS locator to (IPv4 address, UDP port); None for other transports. ``little``: it is
    little-endian."""
    kind, port = struct.unpack_from("<iI" if little else ">iI", value)
    return (".".join(map(str, value[20:24])), port) if kind == _UDP4 and len(value) >= 24 and 0 < port < 65536 else None
