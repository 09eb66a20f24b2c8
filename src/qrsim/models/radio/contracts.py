"""Protocol of the radio between vehicles, as worlds use it; no radio is built in."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, Protocol, runtime_checkable

from jax import Array

from qrsim.core.noise import Draw
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3


@record
class Inbox:
    """Received messages of each vehicle (n,): the newest of each of at most K senders, D numbers each."""

    payload: Array = quantity(doc="(n, K, D) numbers")
    sender: Array = quantity(doc="(n, K) int32 number of the sender in the world; -1: no message")
    age: Array = quantity(unit="s", doc="(n, K) time since it was sent")
    rssi: Array = quantity(unit="dBm", doc="(n, K) strength at which it was received")
    mask: Array = quantity(doc="(n, K) bool: there is a message")


@runtime_checkable
class Radio(Protocol):
    """Messages between the n vehicles of a world; all shapes are static, and worlds are vmapped over from outside.

    Attributes:
        size: numbers of a message (D).
        inbox: messages kept for each vehicle (K).
        reads: what ``exchange`` is handed by name beside its other arguments: "obstacles".
    """

    size: int
    inbox: int
    reads: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def init(self, draw: Draw, position_ned: Vec3) -> Any:
        """Return the state at the start for vehicles at positions (n,) [m], without received messages."""

    @abstractmethod
    def exchange(
        self, state: Any, draw: Draw, position_ned: Vec3, outbox: Array, send: Array, to: Array, tick: Array,
        *args: Any, **reads: Any,
    ) -> tuple[Any, Inbox]:  # fmt: skip
        """Advance one tick.

        Args:
            state: of the tick before.
            draw: randomness of the tick.
            position_ned: (n,) [m].
            outbox: (n, D) what each vehicle has to say.
            send: (n,) bool, whether it says so now.
            to: (n,) int32 receiver, which alone hears it; -1: all.
            tick: () int32. What is sent at a tick is heard at the next one at the earliest.
        """
