"""CRC-16/MCRF4XX, which MAVLink calls X.25: of all frames that are sent or read, so it has to be quick."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Sequence

# The standard library has the same polynomial with its bits in the other order.
_TURNED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
# By its check with the bits in that order, each check as it is sent.
_SENT = tuple(bytes((_TURNED[word >> 8], _TURNED[word & 0xFF])) for word in range(1 << 16))


def check_of(data: bytes) -> bytes:
    """Return the MAVLink checksum (CRC-16/MCRF4XX) of bytes as it is sent: two bytes, the low one first."""
    return _SENT[crc_hqx(data.translate(_TURNED), 0xFFFF)]


def checks_of(data: bytes, starts: Sequence[int], stops: Sequence[int]) -> list[bytes]:
    """Return the MAVLink checksum, two bytes, of each slice ``data[start:stop]``."""
    turned = data.translate(_TURNED)
    return [_SENT[crc_hqx(turned[start:stop], 0xFFFF)] for start, stop in zip(starts, stops, strict=True)]


def x25(data: bytes) -> int:
    """Return the MAVLink checksum (CRC-16/MCRF4XX) of bytes as an integer, 0 to 65535; that of b"123456789" is
    0x6F91."""
    return int.from_bytes(check_of(data), "little")
