"""Reliable reading and writing: which sequence numbers have come, and which are kept to be sent again."""

from __future__ import annotations

from collections import OrderedDict

from qrsim.links.ros2.rtps import wire

# Of what is far ahead of what is missing, only so much is remembered.
_MOST_AHEAD = 1024
_KEPT = 50


class Received:
    """The sequence numbers of one remote writer."""

    def __init__(self) -> None:
        self._low = 1
        self._above: set[int] = set()
        self._count = 0

    def take(self, sequence: int) -> bool:
        """Note that a sequence number has been received; return whether it is new."""
        if sequence < self._low or sequence in self._above or len(self._above) >= _MOST_AHEAD:
            return False
        self._above.add(sequence)
        self._advance_low()
        return True

    def skip(self, first: int, last: int) -> None:
        """Mark the sequence numbers ``first`` to ``last`` as never to come, so that they are not requested."""
        for sequence in range(max(first, self._low), min(last, self._low + _MOST_AHEAD) + 1):
            self._above.add(sequence)
        self._advance_low()

    def answer(self, reader: bytes, writer: bytes, first: int, last: int) -> bytes:
        """Return the ACKNACK submessage that answers a HEARTBEAT (``first`` to ``last``); ``reader``, ``writer``:
        entity ids."""
        if first > self._low:
            self._low = first
            self._above = {each for each in self._above if each >= first}
            self._advance_low()
        self._count += 1
        near = range(self._low, min(last, self._low + _MOST_AHEAD) + 1)
        return wire.acknack(reader, writer, self._low, (each for each in near if each not in self._above), self._count)

    def _advance_low(self) -> None:
        """Move the lowest missing sequence number past all numbers received without a gap."""
        while self._low in self._above:
            self._above.remove(self._low)
            self._low += 1


class Kept:
    """What one writer has written, of which the last messages are kept.

    Attributes:
        writer: its entity.
        last: sequence number.
    """

    def __init__(self, writer: bytes, most: int = _KEPT):
        self.writer, self.last, self._most = writer, 0, most
        self._messages: OrderedDict[int, tuple[bytes, bytes]] = OrderedDict()
        self._count = 0

    def add(self, payload: bytes, inline: bytes = b"") -> int:
        """Store a message under the next sequence number, and return that number; ``inline``: its inline parameters."""
        self.last += 1
        self._messages[self.last] = payload, inline
        while len(self._messages) > self._most:
            self._messages.popitem(last=False)
        return self.last

    def message(self, reader: bytes, sequence: int) -> bytes:
        """Return the RTPS submessage for a sequence number: DATA, or GAP if it is no longer stored; ``reader``: entity
        id."""
        if sequence not in self._messages:
            return wire.gap(reader, self.writer, sequence)
        payload, inline = self._messages[sequence]
        return wire.data(reader, self.writer, sequence, payload, inline)

    def all(self, reader: bytes) -> list[bytes]:
        """Return the DATA submessages of all stored messages; ``reader``: entity id of the receiver."""
        return [self.message(reader, sequence) for sequence in self._messages]

    def heartbeat(self, reader: bytes) -> bytes:
        """Return the HEARTBEAT submessage with the range of stored sequence numbers; ``reader``: entity id of the
        receiver."""
        self._count += 1
        first = next(iter(self._messages), self.last + 1)
        return wire.heartbeat(reader, self.writer, first, self.last, self._count)
