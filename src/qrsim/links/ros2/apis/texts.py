"""What a vehicle tells its MAVLink clients, for APIs that have no MAVLink."""

from __future__ import annotations

from collections import deque

from qrsim.links.mavlink.dialect import NUMBERS
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.streams import Streams

_STATUSTEXT, _LONGEST = NUMBERS["STATUSTEXT"], 50
# Of texts that nobody fetches, the last ones are kept.
_MOST = 64


class Texts(Link):
    """A link of a vehicle that keeps its texts, and sends nothing.

    Attributes:
        waiting: severity (MAV_SEVERITY) and text, oldest first.
    """

    def __init__(self, system: int, time_step: float):
        super().__init__(system, Streams({}, time_step), lambda data: None)
        self.waiting: deque[tuple[int, str]] = deque(maxlen=_MOST)

    def put(self, number: int, payload: bytes) -> None:
        """Store a MAVLink message if it is a STATUSTEXT; drop others."""
        if number == _STATUSTEXT:
            text = payload[1 : 1 + _LONGEST].rstrip(b"\0").decode("ascii", "replace")
            self.waiting.append((payload[0], text))
