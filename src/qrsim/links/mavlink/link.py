"""A way from a vehicle to its clients: frames, counted, several in a datagram."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from qrsim.links.mavlink.dialect import LAYOUTS, NUMBERS
from qrsim.links.mavlink.frames import frame
from qrsim.links.mavlink.streams import Streams

# Frames that go out together, in a datagram that every network takes.
LARGEST_DATAGRAM = 1200
# MAV_COMP_ID_AUTOPILOT1, which all vehicles speak as.
COMPONENT = 1


class Link:
    """A way to clients of one vehicle: frames of it, counted.

    Args:
        system: number of the vehicle's system.
        streams: what is sent on it by itself.
        send: sends bytes.
        ready: returns whether there is room for streams; what answers a request is sent in any case.

    Attributes:
        heard: when a frame for the vehicle came [s], of ``time.monotonic``.
        flies: set-points come on it.
        owes: none has since the last ATTITUDE went out on it.
        muted: what is sent is lost, by a fault of the vehicle's link.
        sequence: number of the next frame.
    """

    def __init__(
        self, system: int, streams: Streams, send: Callable[[bytes], None], ready: Callable[[], bool] = lambda: True
    ):
        self.system, self.streams, self._send, self.ready = system, streams, send, ready
        self.sequence = 0
        self._parts: list[bytes] = []
        self._size = 0
        self.heard = time.monotonic()
        self.flies = self.owes = self.muted = False

    def put(self, number: int, payload: bytes) -> None:
        """Queue message ``number`` until ``flush``, which is called by itself when a datagram is full."""
        self._queue(frame(number, payload, self.sequence, self.system, COMPONENT))

    def put_frames(self, frames: Sequence[bytes]) -> None:
        """Queue encoded frames, numbered from this link's next sequence number on, until ``flush``."""
        size = self._size + sum(map(len, frames))
        if size > LARGEST_DATAGRAM:
            for each in frames:
                self._queue(each)
            return
        self._parts += frames
        self._size, self.sequence = size, (self.sequence + len(frames)) & 0xFF

    def _queue(self, part: bytes) -> None:
        """Queue one encoded frame, and advance the sequence number; flushes first if it no longer fits into a
        datagram."""
        self.sequence = (self.sequence + 1) & 0xFF
        size = len(part)
        if self._size + size > LARGEST_DATAGRAM:
            self.flush()
        self._parts.append(part)
        self._size += size

    def say(self, name: str, **values: object) -> None:
        """Send a message, given by name and field values, at once, together with the queued ones."""
        self.put(NUMBERS[name], LAYOUTS[name].payload(**values))
        self.flush()

    def flush(self) -> None:
        """Send the queued messages as one datagram."""
        if self._parts:
            data = self._parts[0] if len(self._parts) == 1 else b"".join(self._parts)
            self._parts, self._size = [], 0
            if not self.muted:
                self._send(data)
