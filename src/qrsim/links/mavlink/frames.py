"""Frames of MAVLink, versions 1 and 2: written and read."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from qrsim.links.mavlink.checksum import check_of
from qrsim.links.mavlink.dialect import BY_NUMBER, Layout, Message

VERSION_1, VERSION_2 = 0xFE, 0xFD
SIGNED = 0x01
SIGNATURE_SIZE = 13
# From the length of the payload to who sends it; the number of the message follows.
_HEAD = struct.Struct("<BxxBBB").pack
_MAGIC = bytes([VERSION_2])
EXTRA = {number: layout.extra for number, layout in BY_NUMBER.items()}
# Of each message its number as it is sent, and what its check is computed with.
_KINDS = {number: (number.to_bytes(3, "little"), bytes([extra])) for number, extra in EXTRA.items()}


def frame(number: int, payload: bytes, sequence: int, system: int, component: int = 1) -> bytes:
    """Return a complete MAVLink 2 frame (header, payload, checksum) for message ``number``.

    Args:
        number: of the message.
        payload: of it, whole; zeros at its end are not sent.
        sequence: number of the frame on its link, 0 to 255.
        system, component: who sends it.
    """
    # One byte is sent, whatever it is.
    short = payload if payload[-1:] > b"\0" else payload.rstrip(b"\0") or payload[:1]
    kind, extra = _KINDS[number]
    content = _HEAD(len(short), sequence, system, component) + kind + short
    return _MAGIC + content + check_of(content + extra)


@dataclass(frozen=True)
class Frame:
    """A frame that arrived whole and unharmed, of a message that is known.

    Attributes:
        layout: of its message.
        payload: as sent.
        sequence: its number.
        system, component: who sent it.
        version: 1 or 2.
    """

    layout: Layout
    payload: bytes
    sequence: int
    system: int
    component: int
    version: int

    def message(self) -> Message:
        """Decode the payload of this frame to a message with attributes by field name."""
        return self.layout.message(self.payload)


class Reader:
    """Cuts bytes into frames, whatever lies between them.

    Attributes:
        damaged: frames with a wrong check, and unknown messages, whose check nobody can know.
        skipped: bytes outside frames.
    """

    def __init__(self) -> None:
        self._kept = b""
        self.damaged = self.skipped = 0

    def datagram(self, data: bytes) -> Iterator[Frame]:
        """Parse a datagram on its own, and yield its frames; an incomplete frame at its end is dropped."""
        self._kept = b""
        yield from self.feed(data)
        self._kept = b""

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Append received bytes to the stream, and yield every frame that is now complete; an incomplete one is
        kept."""
        data = self._kept + data
        at, end = 0, len(data)
        while at < end:
            magic = data[at]
            if magic not in (VERSION_1, VERSION_2):
                at += 1
                self.skipped += 1
                continue
            if end - at < 3:
                break
            size = _size(data, at)
            if end - at < size:
                break
            found = _read(data, at, size)
            if found is not None:
                at += size
                yield found
                continue
            self.damaged += 1
            # What looked like a beginning may have been none; where another frame follows, it was one, unless that of
            # a piece of a frame, with a whole one behind it.
            if at + size == end or data[at + size] == data[at]:
                inner = _whole(data, at + 1, at + size)
                at = at + size if inner is None else inner
            else:
                at += 1
        self._kept = data[at:]

    def inside(self) -> Iterator[Frame]:
        """Yield whole frames hidden in the incomplete frame that is kept, in case its start byte was not the start of a
        frame."""
        kept = self._kept
        at = _whole(kept, 1, len(kept))
        if at is not None:
            self.damaged += 1
            self._kept = b""
            yield from self.feed(kept[at:])


def _whole(data: bytes, begin: int, end: int) -> int | None:
    """Return the offset of the first valid frame in ``data`` that starts in [begin, end); None without one."""
    for at in range(begin, min(end, len(data) - 2)):
        if data[at] in (VERSION_1, VERSION_2):
            size = _size(data, at)
            if at + size <= len(data) and _read(data, at, size) is not None:
                return at
    return None


def _size(data: bytes, at: int) -> int:
    """Return the length [bytes] of the frame whose header is at offset ``at``."""
    length = data[at + 1]
    if data[at] == VERSION_1:
        return length + 8
    return length + 12 + (SIGNATURE_SIZE if data[at + 2] & SIGNED else 0)


def _read(data: bytes, at: int, size: int) -> Frame | None:
    """Parse the frame of ``size`` bytes at offset ``at``; return None if its checksum or flags are wrong."""
    length = data[at + 1]
    if data[at] == VERSION_1:
        head = 6
        sequence, system, component, number = data[at + 2 : at + 6]
        version = 1
    else:
        if data[at + 2] & ~SIGNED:
            return None  # of flags that change the frame
        head = 10
        sequence, system, component = data[at + 4 : at + 7]
        number = int.from_bytes(data[at + 7 : at + 10], "little")
        version = 2
    layout = BY_NUMBER.get(number)
    if layout is None:
        return None
    inner = data[at + 1 : at + head + length]
    if check_of(inner + _KINDS[number][1]) != data[at + head + length : at + head + length + 2]:
        return None
    return Frame(layout, data[at + head : at + head + length], sequence, system, component, version)
