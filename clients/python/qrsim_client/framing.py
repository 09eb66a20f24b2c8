# Written by generate.py from src/qrsim/links/reference/protocol/framing.py: change that.
"""Frames: each message preceded by a length message of five bytes."""

from __future__ import annotations

import struct

from qrsim_client.errors import UsageError

# Field 1 of the message Size, of wire type fixed32.
TAG = 0x0D
_HEAD = struct.Struct("<BI")
HEAD_SIZE = _HEAD.size
# What a server takes, and what the reference client can.
LARGEST_REQUEST = 1 << 20
LARGEST_FOR_REFERENCE_CLIENT = 10_000


def frame(payload: bytes) -> bytes:
    """Return the payload with its length message in front, as the protocol sends it, in one piece."""
    return _HEAD.pack(TAG, len(payload)) + payload


class Deframer:
    """Cuts a byte stream into payloads.

    Args:
        largest: payloads of more bytes are refused.

    Attributes:
        waiting: how many bytes have arrived that were not handed out.
    """

    def __init__(self, largest: int = LARGEST_REQUEST):
        self.largest = largest
        self._buffer = bytearray()

    @property
    def waiting(self) -> int:
        """Number of received bytes that have not been returned as payloads yet."""
        return len(self._buffer)

    @property
    def ready(self) -> bool:
        """Whether ``next`` would return a payload or raise an error: a complete payload or an invalid length has
        arrived."""
        buffer = self._buffer
        if len(buffer) < HEAD_SIZE:
            return bool(buffer) and buffer[0] != TAG
        tag, size = _HEAD.unpack_from(buffer)
        return tag != TAG or size > self.largest or len(buffer) >= HEAD_SIZE + size

    def feed(self, data: bytes) -> None:
        """Append received bytes to the stream."""
        self._buffer += data

    def next(self) -> bytes | None:
        """Return the next complete payload, None while it is incomplete.

        Raises:
            UsageError: this is no length message, or the length is beyond the largest; what follows makes no sense.
        """
        buffer = self._buffer
        if buffer and buffer[0] != TAG:
            raise UsageError(f"framing: a message starts with 0x{buffer[0]:02X}; expected 0x{TAG:02X} and its length")
        if len(buffer) < HEAD_SIZE:
            return None
        _, size = _HEAD.unpack_from(buffer)
        if size > self.largest:
            raise UsageError(f"framing: a message of {size} bytes; allowed: up to {self.largest}")
        end = HEAD_SIZE + size
        if len(buffer) < end:
            return None
        payload = bytes(buffer[HEAD_SIZE:end])
        del buffer[:end]
        return payload
