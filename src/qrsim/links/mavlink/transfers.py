"""Plans over the wire: missions, fences and rally points are uploaded, downloaded and cleared."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from qrsim.links.mavlink.dialect import Message
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import ARDUPILOT, UNSET_INT, PlanKind, PlanResult, Severity
from qrsim.links.mavlink.stack.contracts import Item, Stack, Text

# An item that does not come is asked for again after so long [s, wall clock], so many times; every third time in the
# other of the two dialects.
ASK_AGAIN_S, MOST_ASKS, OTHER_DIALECT = 0.25, 10, 3
# ``current`` of a MISSION_ITEM of ArduPilot that is no part of a mission: go there; change the altitude.
GO_THERE, ALTITUDE_ONLY = 2, 3
MOST_ITEMS = 1000
ALL_KINDS = 255
# MAV_FRAMEs whose x and y are metres, sent as 1e-4 of them, and the one where they are plain numbers.
_LOCAL_FRAMES = (1, 4, 7, 8, 9, 12, 20, 21)
_MISSION_FRAME = 2
Partner = tuple[int, int]


@dataclass
class Upload:
    """A plan that is on its way to the vehicle.

    Attributes:
        integers: it is asked for by MISSION_REQUEST_INT, else by MISSION_REQUEST, which older clients speak alone.
    """

    link: Link
    partner: Partner
    kind: PlanKind
    count: int
    integers: bool
    items: list[Item] = field(default_factory=list)
    asked: float = 0.0
    asks: int = 0


class Transfers:
    """The plans of one vehicle, for clients.

    Args:
        stack: whose plans these are.
        say: tells all clients a text.

    Attributes:
        upload: what is on its way; None while there is nothing.
    """

    def __init__(self, stack: Stack, say: Callable[[Text], None]):
        self._stack, self._say = stack, say
        self._ardupilot = stack.heartbeat().autopilot == ARDUPILOT
        self.upload: Upload | None = None
        # Partner, kind and seq of the last item of the last upload.
        self._last: tuple[Partner, int, int] | None = None

    # ---- upload ----

    def begin(self, link: Link, partner: Partner, message: Message) -> None:
        """Begin a plan upload, as MISSION_COUNT asks: request its first item, or accept an empty plan at once."""
        kind = _kind(message.mission_type)
        if kind is None:
            self._ack(link, partner, PlanResult.UNSUPPORTED, message.mission_type)
            return
        if self.upload is not None and self.upload.partner != partner:
            self._ack(link, partner, PlanResult.DENIED, kind)
            return
        if message.count > MOST_ITEMS:
            self._ack(link, partner, PlanResult.NO_SPACE, kind)
            return
        # ArduPilot asks by MISSION_REQUEST alone (MissionItemProtocol::queued_request_send).
        self.upload = Upload(link, partner, kind, message.count, not self._ardupilot)
        self._go_on()

    def item(self, link: Link, partner: Partner, message: Message) -> None:
        """Store a MISSION_ITEM or MISSION_ITEM_INT of a plan upload and request the next; after an item out of order,
        request the due one again."""
        upload, kind = self.upload, message.mission_type
        if self._ardupilot and kind == PlanKind.MISSION and message.current in (GO_THERE, ALTITUDE_ONLY):
            self._ack(link, partner, self._guided(message), kind)
        elif upload is None or kind != upload.kind:
            # Where the last acknowledgement was lost, the last item comes again, as PX4 takes it.
            again = self._last == (partner, kind, message.seq)
            self._ack(link, partner, PlanResult.ACCEPTED if again else PlanResult.ERROR, kind)
        elif upload.partner != partner:
            self._ack(link, partner, PlanResult.DENIED, kind)
        elif message.seq >= len(upload.items):
            if message.seq == len(upload.items):
                upload.items.append(item_of(message))
                upload.asks = 0
                # PX4 asks in the dialect of the answer.
                upload.integers = not self._ardupilot and message.layout.name == "MISSION_ITEM_INT"
            self._go_on()

    def _guided(self, message: Message) -> PlanResult:
        """Execute an ArduPilot guided mission item: fly there, or only change the altitude; return the result."""
        if message.current == ALTITUDE_ONLY:
            # As GCS_MAVLINK::handle_mission_item, whatever the vehicle does about it.
            self._stack.change_altitude(item_of(message))
            return PlanResult.ACCEPTED
        return PlanResult.ACCEPTED if self._stack.go_to(item_of(message)) else PlanResult.ERROR

    def _go_on(self) -> None:
        """Request the next item of the running upload, or accept the plan after the last one."""
        upload = self.upload
        assert upload is not None
        if len(upload.items) == upload.count:
            self.upload = None
            result, _ = self._stack.accept(upload.kind, upload.items)
            last = upload.partner, int(upload.kind), upload.count - 1
            self._last = last if result is PlanResult.ACCEPTED else None
            self._ack(upload.link, upload.partner, result, upload.kind)
            return
        upload.asked = time.monotonic()
        upload.asks += 1
        integers = upload.integers is not (upload.asks % OTHER_DIALECT == 0)
        name = "MISSION_REQUEST_INT" if integers else "MISSION_REQUEST"
        upload.link.say(name, **_to(upload.partner), seq=len(upload.items), mission_type=upload.kind)

    def ask_again(self, wall: float) -> None:
        """Request an overdue item of the upload again, or abort the upload; ``wall`` [s] is the time of
        ``time.monotonic``."""
        upload = self.upload
        if upload is None or wall - upload.asked < ASK_AGAIN_S:
            return
        if upload.asks > MOST_ASKS:
            self._give_up(upload)
            return
        self._go_on()

    def cancel(self) -> None:
        """Abort the upload and send its client MISSION_ACK (cancelled); the old plan remains."""
        if self.upload is not None:
            upload, self.upload = self.upload, None
            self._ack(upload.link, upload.partner, PlanResult.CANCELLED, upload.kind)

    def _give_up(self, upload: Upload) -> None:
        """Abort an upload whose client no longer answers, and warn all clients; the old plan remains."""
        self.cancel()
        what = f"{upload.kind.name.capitalize()} upload timed out at item {len(upload.items)} of {upload.count}"
        self._say(Text(Severity.WARNING, f"{what}; the one of before stays"))

    def clear(self, link: Link, partner: Partner, message: Message) -> None:
        """Delete the plan of a kind, as MISSION_CLEAR_ALL asks, and send MISSION_ACK."""
        kind = _kind(message.mission_type)
        kinds = tuple(PlanKind) if message.mission_type == ALL_KINDS else () if kind is None else (kind,)
        result = PlanResult.ACCEPTED if kinds else PlanResult.UNSUPPORTED
        for each in kinds:
            found, _ = self._stack.accept(each, [])
            result = result if found == PlanResult.ACCEPTED else found
        self._ack(link, partner, result, message.mission_type)

    def heard_ack(self, partner: Partner, message: Message) -> None:
        """Handle MISSION_ACK of an uploading client: abort, or, for UNSUPPORTED, switch between MISSION_ITEM and
        MISSION_ITEM_INT."""
        upload = self.upload
        if upload is None or upload.partner != partner or message.type == PlanResult.ACCEPTED:
            return
        if message.type != PlanResult.UNSUPPORTED:
            self.upload = None
        elif upload.asks > MOST_ASKS:
            self._give_up(upload)
        else:
            upload.integers = not upload.integers
            self._go_on()

    def forget(self, link: Link) -> None:
        """Abort the plan upload that runs over a closed link, if any; the stored plan stays."""
        if self.upload is not None and self.upload.link is link:
            self.upload = None

    # ---- download ----

    def count(self, link: Link, partner: Partner, message: Message) -> None:
        """Answer MISSION_REQUEST_LIST with MISSION_COUNT, the number of items of a plan."""
        kind = _kind(message.mission_type)
        if kind is None:
            self._ack(link, partner, PlanResult.UNSUPPORTED, message.mission_type)
            return
        link.say("MISSION_COUNT", **_to(partner), count=len(self._stack.items(kind)), mission_type=kind)

    def send(self, link: Link, partner: Partner, message: Message, integers: bool) -> None:
        """Answer MISSION_REQUEST_INT or MISSION_REQUEST: send an item of a plan as MISSION_ITEM_INT (``integers``) or
        as MISSION_ITEM with floats."""
        kind = _kind(message.mission_type)
        items = () if kind is None else self._stack.items(kind)
        home = self._stack.home_item() if kind is PlanKind.MISSION and message.seq == 0 else None
        if kind is None or (message.seq >= len(items) and home is None):
            self._ack(link, partner, PlanResult.INVALID_SEQUENCE, message.mission_type)
            return
        item = home or items[message.seq]
        x, y = (item.x, item.y) if integers else (_as_float(item.frame, axis) for axis in (item.x, item.y))
        current = kind is PlanKind.MISSION and self._stack.mission().seq == item.seq
        values: dict[str, float] = dict(zip(("param1", "param2", "param3", "param4"), item.params, strict=True))
        link.say(
            "MISSION_ITEM_INT" if integers else "MISSION_ITEM",
            **_to(partner),
            seq=message.seq,
            frame=item.frame,
            command=item.command,
            current=int(current),
            autocontinue=item.autocontinue,
            **values,
            x=x,
            y=y,
            z=item.z,
            mission_type=kind,
        )

    def refuse(self, link: Link, partner: Partner, message: Message) -> None:
        """Refuse to transfer only a part of a plan: answer with MISSION_ACK, unsupported."""
        self._ack(link, partner, PlanResult.UNSUPPORTED, message.mission_type)

    @staticmethod
    def _ack(link: Link, partner: Partner, result: PlanResult, kind: int) -> None:
        """Send MISSION_ACK with a result for a kind of plan (MAV_MISSION_TYPE), addressed to ``partner``."""
        link.say("MISSION_ACK", **_to(partner), type=int(result), mission_type=int(kind))


def _kind(number: int) -> PlanKind | None:
    """Return the kind of plan (mission, fence, rally) of a MAV_MISSION_TYPE number; None for an unknown one."""
    return PlanKind(number) if number in tuple(PlanKind) else None


def _to(partner: Partner) -> dict[str, int]:
    """Return the message fields target_system and target_component that address ``partner`` (system id, component
    id)."""
    return {"target_system": partner[0], "target_component": partner[1]}


def item_of(message: Message) -> Item:
    """Convert a MISSION_ITEM_INT or MISSION_ITEM message to an Item, with x and y as integers."""
    x, y = message.x, message.y
    if isinstance(x, float):
        x, y = _as_integer(message.frame, x), _as_integer(message.frame, y)
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.seq, message.frame, message.command, params, x, y, message.z, message.autocontinue)


def _scale(frame: int) -> float:
    """Return the integer units per degree (1e7) or metre (1e4; 1 in the mission frame) in x and y of a mission item, by
    its MAV_FRAME."""
    return 1.0 if frame == _MISSION_FRAME else 1e4 if frame in _LOCAL_FRAMES else 1e7


def _as_integer(frame: int, value: float) -> int:
    """Convert x or y of a mission item from a float to its integer form; UNSET_INT for NaN."""
    number = value * _scale(frame)
    return round(number) if math.isfinite(number) and abs(number) < UNSET_INT else UNSET_INT


def _as_float(frame: int, value: int) -> float:
    """Convert x or y of a mission item from its integer form to the nearest float32; NaN for UNSET_INT."""
    number = math.nan if value == UNSET_INT else value / _scale(frame)
    return float(struct.unpack("<f", struct.pack("<f", number))[0])
