"""Many frames of MAVLink 2 at once, byte for byte those of ``frames.frame``."""

from __future__ import annotations

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.checksum import checks_of
from qrsim.links.mavlink.frames import EXTRA, VERSION_2

# Bytes before the payload.
_HEAD = 10


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
    filled = payloads[:, ::-1] != 0
    filled[:, -1] = True
    lengths = wide - filled.argmax(axis=1)
    found = np.empty((count, _HEAD + wide + 1), np.uint8)
    found[:, 0], found[:, 1], found[:, 2:4], found[:, 4], found[:, 5] = VERSION_2, lengths, 0, sequences, systems
    found[:, 6], found[:, 7:_HEAD] = component, numbers.astype("<u4").view(np.uint8).reshape(count, 4)[:, :3]
    found[:, _HEAD:-1] = payloads
    # CRC_EXTRA comes last in a check, which leaves the first byte out, and is not sent.
    rows, ends = np.arange(count), _HEAD + lengths
    found[rows, ends] = [EXTRA[number] for number in numbers.tolist()]
    begins = rows * found.shape[1]
    ends += begins
    data, starts, stops = found.tobytes(), begins.tolist(), ends.tolist()
    checks = checks_of(data, (begins + 1).tolist(), (ends + 1).tolist())
    return [data[start:stop] + check for start, stop, check in zip(starts, stops, checks, strict=True)]
