"""Many frames of MAVLink 2 at once, byte for byte those of ``frames.frame``."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.checksum import x25
from qrsim.links.mavlink.frames import EXTRA, VERSION_2

# Bytes before the payload, and the largest payload.
_HEAD, _LARGEST = 10, 255


@lru_cache(maxsize=1)
def _checks() -> tuple[NumpyArray, NumpyArray]:
    """Return what each byte adds to a check, and the check of zeros alone.

    A CRC is linear: that of a frame is the exclusive or of what each byte adds, by its place from the end.

    Returns:
        (places * 256,) of a byte by its place from the end, and (places + 1,) by the length of the frame.
    """
    places = _HEAD + _LARGEST
    # The check of one byte, without the preset of the register.
    table = np.array([x25(bytes([byte])) ^ x25(b"\0") for byte in range(256)], np.uint16)
    found, empty = np.empty((places, 256), np.uint16), np.empty(places + 1, np.uint16)
    found[0], empty[0] = table, 0xFFFF
    for place in range(places):
        if place:
            before = found[place - 1]
            found[place] = (before >> 8) ^ table[before & 0xFF]
        empty[place + 1] = (empty[place] >> 8) ^ table[empty[place] & 0xFF]
    return found.reshape(-1), empty


def frames(
    numbers: NumpyArray, payloads: NumpyArray, sequences: NumpyArray, systems: NumpyArray, component: int
) -> list[bytes]:
    """Return the frames of version 2 of m messages.

    Args:
        numbers: (m,) of the messages.
        payloads: (m, w) uint8, whole, with zeros after them.
        sequences: (m,) numbers of the frames on their links, 0 to 255.
        systems: (m,) who sends them.
        component: of all.
    """
    count, wide = payloads.shape
    # Zeros at the end of a payload are not sent; one byte is sent, whatever it is.
    lengths = np.maximum(wide - np.argmax(payloads[:, ::-1] != 0, axis=1), 1)
    lengths[~payloads.any(axis=1)] = 1
    found = np.zeros((count, _HEAD + wide + 2), np.uint8)
    found[:, 0], found[:, 1], found[:, 4], found[:, 5], found[:, 6] = VERSION_2, lengths, sequences, systems, component
    found[:, 7:_HEAD] = numbers.astype("<u4").view(np.uint8).reshape(count, 4)[:, :3]
    found[:, _HEAD:-2] = payloads
    adds, empty = _checks()
    # The first byte is not checked, and CRC_EXTRA comes last.
    places = (_HEAD - 1 + lengths)[:, None] - np.arange(_HEAD - 1 + wide)
    # Bytes after the end are zeros, and add nothing.
    each = adds.take(places * 256 + found[:, 1:-2], mode="clip")
    extras = np.array([EXTRA[number] for number in numbers.tolist()])
    checks = np.bitwise_xor.reduce(each, axis=1) ^ adds[extras] ^ empty[_HEAD + lengths]
    rows, ends = np.arange(count), _HEAD + lengths
    found[rows, ends], found[rows, ends + 1] = checks & 0xFF, checks >> 8
    data, width = found.tobytes(), found.shape[1]
    begins = rows * width
    return [data[at:end] for at, end in zip(begins.tolist(), (begins + ends + 2).tolist(), strict=True)]
