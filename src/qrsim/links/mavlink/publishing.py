"""What the vehicles of a world send at a tick: one by one, or, of many, the frequent messages of all at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.bulk_frames import frames
from qrsim.links.mavlink.dialect import BY_NUMBER, NUMBERS
from qrsim.links.mavlink.link import COMPONENT, Link
from qrsim.links.mavlink.streams import STREAMED, Schedule
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.telemetry_rows import BY_ROWS, Blanks, Rows

# Fewest vehicles that are encoded together; fewer take less time one by one.
MANY = 4
_NUMBERS = np.array(STREAMED)
_SIZES = np.array([BY_NUMBER[number].struct.size for number in STREAMED])
_ATTITUDE = STREAMED.index(NUMBERS["ATTITUDE"])


class Publisher:
    """Sends what is due on the links of systems.

    Args:
        systems: of all vehicles of a world.
    """

    def __init__(self, systems: Sequence[System]):
        self._systems = systems
        self._views = [system.view for system in systems]
        # Links with a common schedule; of each the index of its system, and the number of that.
        self._links: list[Link] = []
        self._owners = self._numbers = np.zeros(0, np.intp)
        self._schedule: Schedule | None = None
        self._blanks: Blanks = {}

    def publish(self, tick: int, wall: float) -> None:
        """Send the messages due at a tick on all links; ``wall`` [s] is the time of ``time.monotonic``."""
        if len(self._systems) < MANY:
            for system in self._systems:
                system.publish(tick, wall)
            return
        for system in self._systems:
            system.announce(tick)
        links = [(owner, link) for owner, system in enumerate(self._systems) for link in system.links
                 if system.streams_on(link, wall)]  # fmt: skip
        if links:
            self._stream(links, tick)
        for system in self._systems:
            for link in system.links:
                link.flush()
            if system.transfers.upload is not None:
                system.transfers.ask_again(wall)

    def _stream(self, links: list[tuple[int, Link]], tick: int) -> None:
        """Queue what is due on links, each with the index of its system."""
        present = [link for _, link in links]
        if self._schedule is None or present != self._links:
            self._links, self._schedule = present, Schedule([link.streams for link in present])
            self._owners = np.array([owner for owner, _ in links])
            self._numbers = np.array([link.system for link in present])
        fresh = [self._views[owner].fresh for owner, _ in links]
        at, columns = self._schedule.due(tick, fresh)
        payloads, sent = self._payloads(self._owners[at], columns)
        at, columns, payloads = at[sent], columns[sent], payloads[sent]
        for i in at[columns == _ATTITUDE].tolist():
            present[i].owes = True
        ends = np.cumsum(np.bincount(at, minlength=len(present)))
        # Frames are counted on each link, from its next number on.
        first = np.array([link.sequence for link in present]) - np.append(0, ends[:-1])
        sequences = (first[at] + np.arange(len(at))) & 0xFF
        done = frames(_NUMBERS[columns], payloads, sequences, self._numbers[at], COMPONENT)
        begin = 0
        for link, end in zip(present, ends.tolist(), strict=True):
            link.put_frames(done[begin:end])
            begin = end

    def _payloads(self, owners: NumpyArray, columns: NumpyArray) -> tuple[NumpyArray, NumpyArray]:
        """Return the payloads of messages, with zeros after them.

        Args:
            owners: (m,) of which system each is.
            columns: (m,) of ``STREAMED``.

        Returns:
            (m, w) uint8, and which are sent (m,).
        """
        width = int(_SIZES[columns].max(initial=1))
        found, sent = np.zeros((len(columns), width), np.uint8), np.zeros(len(columns), bool)
        rows: Rows | None = None
        order = np.argsort(columns, kind="stable")
        counts = np.bincount(columns, minlength=len(STREAMED)).tolist()
        end = 0
        for column, count in enumerate(counts):
            if not count:
                continue
            where, number, size = order[end : end + count], STREAMED[column], _SIZES[column]
            end += count
            systems = owners[where]
            if number in BY_ROWS and len(where) >= MANY:
                rows = rows or Rows.of(self._views, self._blanks)
                _, known = BY_ROWS[number](rows)
                found[where, :size] = self._blanks[BY_NUMBER[number].name][1][systems]
                sent[where] = known[systems]
                continue
            for i, system in zip(where.tolist(), systems.tolist(), strict=True):
                payload = self._systems[system].payload(number)
                if payload is not None:
                    found[i, :size], sent[i] = np.frombuffer(payload, np.uint8), True
        return found, sent
