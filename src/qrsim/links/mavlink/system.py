"""One vehicle as a MAVLink system, and the links on which it is heard."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from qrsim.links.mavlink.dialect import LAYOUTS, NUMBERS
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import Severity
from qrsim.links.mavlink.stack.contracts import Event, Stack, Text
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.transfers import Transfers
from qrsim.links.mavlink.view import View

# Without a heartbeat of its client for so long, a link has the streams again that it began with [s, wall clock].
PEER_TIMEOUT_S = 10.0
_CHUNK = 50
# So many different lines are said once; of more, nobody reads any.
_MOST_TOLD = 4000
_ATTITUDE = NUMBERS["ATTITUDE"]
# What clients are told at once when it changes.
_AT_ONCE = {
    "mission": ("MISSION_CURRENT",),
    "landed": ("EXTENDED_SYS_STATE",),
    "mode": ("HEARTBEAT", "CURRENT_MODE"),
    "armed": ("HEARTBEAT",),
    "home": ("HOME_POSITION",),
    "fence": ("FENCE_STATUS",),
}


class System:
    """One vehicle on the wire.

    Args:
        stack: its flight stack.
        name: of the vehicle.
        number: of its MAVLink system.
        unix: when the scenario starts, in seconds since 1970.
        log: told one line of what its clients are told.

    Attributes:
        view: what its messages are made of.
        links: on which it is heard.
        transfers: of plans.
        reboots: whether it is to start again before the next tick.
        muted: whether it neither hears its clients nor is heard by them.
    """

    def __init__(
        self, stack: Stack, name: str, number: int, unix: float = 0.0, log: Callable[[str], None] = lambda line: None
    ):
        self.stack, self.name, self.number, self._log = stack, name, number, log
        self.view = View(stack, unix)
        self.links: list[Link] = []
        self.transfers = Transfers(stack, self.text)
        self.tick = 0
        self._text = 0
        self._payloads: dict[int, bytes | None] = {}
        self.told: set[str] = set()
        self.reboots = self.muted = False
        # Does again what ends with a boot, but is meant to last.
        self.booted: Callable[[], None] = lambda: None

    def restart(self) -> None:
        """Restart the vehicle's flight stack as after a boot; an unfinished plan upload is dropped."""
        self.stack.reset()
        self.transfers.cancel()
        self.told.clear()
        self.text(Text(Severity.INFO, "Started again"))

    def publish(self, tick: int, wall: float) -> None:
        """Send every message, event and text that is due at a tick on all links; ``wall`` [s] is the time of
        ``time.monotonic``."""
        self.announce(tick)
        for link in self.links:
            if self.streams_on(link, wall):
                numbers = link.streams.due(tick, self.view.fresh)
                for number in numbers:
                    payload = self.payload(number)
                    if payload is not None:
                        link.put(number, payload)
                link.owes |= _ATTITUDE in numbers and self.payload(_ATTITUDE) is not None
            link.flush()
        if self.transfers.upload is not None:
            self.transfers.ask_again(wall)

    def announce(self, tick: int) -> None:
        """Queue the flight stack's events and texts of a tick on all links, and drop payloads cached for the previous
        tick."""
        self.tick = tick
        self._payloads.clear()
        for event in self.stack.events():
            self._tell(event)
        for text in self.stack.texts():
            self.text(text)

    def streams_on(self, link: Link, wall: float) -> bool:
        """Return whether telemetry may be sent on a link at ``wall`` [s]; a link whose client has left goes back to its
        default rates."""
        link.muted = self.muted
        if self.muted:
            return False
        if link.streams.changed and wall - link.heard > PEER_TIMEOUT_S:
            link.streams.restart()
            link.streams.begin_at(self.tick)
        return link.ready()

    def payload(self, number: int) -> bytes | None:
        """Return the payload of message ``number`` at this tick, computed once for all links; None if the vehicle does
        not send it."""
        if number not in self._payloads:
            self._payloads[number] = ENCODERS[number](self.view)
        return self._payloads[number]

    def _tell(self, event: Event) -> None:
        """Send the messages that an event of the flight stack triggers (mode, home or landed state changed, item
        reached)."""
        if event.kind == "item_reached":
            self._broadcast("MISSION_ITEM_REACHED", LAYOUTS["MISSION_ITEM_REACHED"].payload(seq=event.number))
        self.reboots |= event.kind == "reboot"
        for name in _AT_ONCE.get(event.kind, ()):
            payload = ENCODERS[NUMBERS[name]](self.view)
            if payload is not None:
                self._broadcast(name, payload)

    def text(self, text: Text) -> None:
        """Send a STATUSTEXT on all links, in chunks if it is long, and log it."""
        self._note(text.text)
        whole = text.text.encode("ascii", "replace")
        pieces = [whole[at : at + _CHUNK] for at in range(0, len(whole), _CHUNK)] or [b""]
        if len(pieces) > 1:
            self._text = self._text % 0xFFFF + 1
            if len(pieces[-1]) == _CHUNK:
                # Only a piece that is not full says that it is the last.
                pieces.append(b"")
        for chunk, piece in enumerate(pieces):
            values: Mapping[str, object] = {
                "severity": int(text.severity),
                "text": piece,
                "id": self._text if len(pieces) > 1 else 0,
                "chunk_seq": chunk,
            }
            self._broadcast("STATUSTEXT", LAYOUTS["STATUSTEXT"].payload(**values))

    def present(self) -> None:
        """Send a HEARTBEAT on all links; called while the simulation waits and no ticks are flown."""
        payload = ENCODERS[NUMBERS["HEARTBEAT"]](self.view)
        assert payload is not None
        self._broadcast("HEARTBEAT", payload)
        for link in self.links:
            link.flush()

    def _note(self, line: str) -> None:
        """Log a line for the operator, with the simulated time and the vehicle's name in front."""
        self._log(f"t = {self.view.seen.time:.10g} s, '{self.name}': {line}")

    def note_once(self, line: str) -> None:
        """Log a line for the operator, not for clients, unless the same line was logged before."""
        if line not in self.told and len(self.told) < _MOST_TOLD:
            self.told.add(line)
            self._note(line)

    def tell_once(self, key: str, text: Text) -> None:
        """Send a STATUSTEXT on all links unless one with the same ``key`` was sent since the last restart."""
        if key not in self.told:
            self.told.add(key)
            self.text(text)

    def _broadcast(self, name: str, payload: bytes) -> None:
        """Queue a message, given by name and payload, on all links of the vehicle."""
        for link in self.links:
            link.put(NUMBERS[name], payload)
