"""Plans over the wire: missions, fences and rally points are uploaded, downloaded and cleared."""

from __future__ import annotations

import math
import struct
import time
from dataclasses import dataclass, field
from typing import Any

from qrsim.links.mavlink.dialect import Message
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import UNSET_INT, PlanKind, PlanResult
from qrsim.links.mavlink.stack.contracts import Item, Stack

# An item that does not come is asked for again after so long [s, wall clock], so many times.
ASK_AGAIN_S, MOST_ASKS = 0.25, 10
MOST_ITEMS = 1000
ALL_KINDS = 255
# MAV_FRAMEs whose x and y are metres, sent as 1e-4 of them, and the one where they are plain numbers.
_LOCAL_FRAMES = (1, 4, 7, 8, 9, 12, 20, 21)
_MISSION_FRAME = 2
Partner = tuple[int, int]


@dataclass
class Upload:
    """A plan that is on its way to the vehicle."""

    link: Link
    partner: Partner
    kind: PlanKind
    count: int
    items: list[Item] = field(default_factory=list)
    asked: float = 0.0
    asks: int = 0


class Transfers:
    """The plans of one vehicle, for clients.

    Args:
        stack: whose plans these are.

    Attributes:
        upload: what is on its way; None while there is nothing.
    """

    def __init__(self, stack: Stack):
        self._stack = stack
        self.upload: Upload | None = None

    # ---- upload ----

    def begin(self, link: Link, partner: Partner, message: Message) -> None:
        """Answer MISSION_COUNT: ask for the first item, or take a plan without any."""
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
        self.upload = Upload(link, partner, kind, message.count)
        self._go_on()

    def item(self, partner: Partner, message: Message) -> None:
        """Take MISSION_ITEM or MISSION_ITEM_INT; what was not asked for is asked for again."""
        upload = self.upload
        if upload is None or upload.partner != partner or message.mission_type != upload.kind:
            return
        if message.seq == len(upload.items):
            upload.items.append(item_of(message))
            upload.asks = 0
        elif message.seq < len(upload.items):
            return  # the same once more
        self._go_on()

    def _go_on(self) -> None:
        upload = self.upload
        assert upload is not None
        if len(upload.items) == upload.count:
            self.upload = None
            result, _ = self._stack.accept(upload.kind, upload.items)
            self._ack(upload.link, upload.partner, result, upload.kind)
            return
        upload.asked = time.monotonic()
        upload.asks += 1
        upload.link.say("MISSION_REQUEST_INT", **_to(upload.partner), seq=len(upload.items), mission_type=upload.kind)

    def ask_again(self, wall: float) -> None:
        """Ask for an item that has not come, or give up; the plan of before stays."""
        upload = self.upload
        if upload is None or wall - upload.asked < ASK_AGAIN_S:
            return
        if upload.asks > MOST_ASKS:
            self.upload = None
            self._ack(upload.link, upload.partner, PlanResult.ERROR, upload.kind)
            return
        self._go_on()

    def clear(self, link: Link, partner: Partner, message: Message) -> None:
        """Answer MISSION_CLEAR_ALL."""
        kind = _kind(message.mission_type)
        kinds = tuple(PlanKind) if message.mission_type == ALL_KINDS else () if kind is None else (kind,)
        result = PlanResult.ACCEPTED if kinds else PlanResult.UNSUPPORTED
        for each in kinds:
            found, _ = self._stack.accept(each, [])
            result = result if found == PlanResult.ACCEPTED else found
        self._ack(link, partner, result, message.mission_type)

    def heard_ack(self, partner: Partner, message: Message) -> None:
        """Take MISSION_ACK: a client that breaks an upload off says so by it."""
        if self.upload is not None and self.upload.partner == partner and message.type != PlanResult.ACCEPTED:
            self.upload = None

    def forget(self, link: Link) -> None:
        """Break off what comes over a link that has gone; the plan of before stays."""
        if self.upload is not None and self.upload.link is link:
            self.upload = None

    # ---- download ----

    def count(self, link: Link, partner: Partner, message: Message) -> None:
        """Answer MISSION_REQUEST_LIST."""
        kind = _kind(message.mission_type)
        if kind is None:
            self._ack(link, partner, PlanResult.UNSUPPORTED, message.mission_type)
            return
        link.say("MISSION_COUNT", **_to(partner), count=len(self._stack.items(kind)), mission_type=kind)

    def send(self, link: Link, partner: Partner, message: Message, integers: bool) -> None:
        """Answer MISSION_REQUEST_INT, or MISSION_REQUEST with floats."""
        kind = _kind(message.mission_type)
        items = () if kind is None else self._stack.items(kind)
        if kind is None or message.seq >= len(items):
            self._ack(link, partner, PlanResult.INVALID_SEQUENCE, message.mission_type)
            return
        item = items[message.seq]
        x, y = (item.x, item.y) if integers else (_as_float(item.frame, axis) for axis in (item.x, item.y))
        current = kind is PlanKind.MISSION and self._stack.mission().seq == item.seq
        values: dict[str, Any] = dict(zip(("param1", "param2", "param3", "param4"), item.params, strict=True))
        link.say(
            "MISSION_ITEM_INT" if integers else "MISSION_ITEM", **_to(partner), seq=message.seq, frame=item.frame,
            command=item.command, current=int(current), autocontinue=item.autocontinue, **values, x=x, y=y, z=item.z,
            mission_type=kind,
        )  # fmt: skip

    def refuse(self, link: Link, partner: Partner, message: Message) -> None:
        """Answer requests for a part of a list."""
        self._ack(link, partner, PlanResult.UNSUPPORTED, message.mission_type)

    @staticmethod
    def _ack(link: Link, partner: Partner, result: PlanResult, kind: int) -> None:
        link.say("MISSION_ACK", **_to(partner), type=int(result), mission_type=int(kind))


def _kind(number: int) -> PlanKind | None:
    return PlanKind(number) if number in tuple(PlanKind) else None


def _to(partner: Partner) -> dict[str, int]:
    return {"target_system": partner[0], "target_component": partner[1]}


def item_of(message: Message) -> Item:
    """Return the item of a MISSION_ITEM_INT, or of a MISSION_ITEM, whose place becomes integers."""
    x, y = message.x, message.y
    if isinstance(x, float):
        x, y = _as_integer(message.frame, x), _as_integer(message.frame, y)
    params = (message.param1, message.param2, message.param3, message.param4)
    return Item(message.seq, message.frame, message.command, params, x, y, message.z, message.autocontinue)


def _scale(frame: int) -> float:
    return 1.0 if frame == _MISSION_FRAME else 1e4 if frame in _LOCAL_FRAMES else 1e7


def _as_integer(frame: int, value: float) -> int:
    number = value * _scale(frame)
    return round(number) if math.isfinite(number) and abs(number) < UNSET_INT else UNSET_INT


def _as_float(frame: int, value: int) -> float:
    number = math.nan if value == UNSET_INT else value / _scale(frame)
    return float(struct.unpack("<f", struct.pack("<f", number))[0])
