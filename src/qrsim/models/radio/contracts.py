"""Messages, their recipients, and the contract of the radio."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import Array

from qrsim.core.noise import Draw, StreamKeys
from qrsim.core.tree import quantity, record
from qrsim.core.vectors import Vec3
from qrsim.models.radio.tables import NOBODY, Heard
from qrsim.models.scene.obstacles import Obstacles

# Names of the radio's noise streams; a fleet has no slash in its name, so these are no fleet's.
STREAMS = ("/radio.packet", "/radio.jitter", "/radio.backoff")
FIELD_STREAM = "/radio.field"


@record
class Inbox:
    """Received messages of each vehicle (n,): the newest of each of at most K senders, D numbers each."""

    payload: Array = quantity(doc="(n, K, D) numbers; 0 where there is no message")
    sender: Array = quantity(doc="(n, K) int32 number of the sender in the world; -1: no message")
    age: Array = quantity(unit="s", doc="(n, K) time since it was handed to the sender's radio; NaN: no message")
    rssi: Array = quantity(unit="dBm", doc="(n, K) strength at which it was received; NaN: no message")
    mask: Array = quantity(doc="(n, K) bool: there is a message")


@record
class Outbox:
    """Messages that vehicles (n,) send."""

    payload: Array = quantity(doc="(D, n) numbers")
    send: Array = quantity(doc="(n,) bool: it is sent now")
    to: Array = quantity(doc="(n,) int32 number in the world of the only recipient; -1: all")
    beacons: Array | None = quantity(default=None, doc="(n,) bool: has no message, and sends beacons; None: none does")


@record
class Surfaces:
    """Positions of the ends of links, and obstacles between them."""

    position_ned: Vec3 = quantity(unit="m", doc="true position of each vehicle (n,)")
    works: Array = quantity(doc="(n,) bool: has a radio that is on, and flies")
    obstacles: Obstacles | None = quantity(
        default=None, doc="obstacles of the world; None: every line of sight is free"
    )
    height: Array | None = quantity(
        default=None, unit="m", doc="(n,) above the ground, for radios that ask; None: unknown"
    )


class Exchange(NamedTuple):
    """One call of the radio.

    Attributes:
        said: what users have to say; None: nothing.
        beacons: what those say who have nothing to say.
        ids: (n,) uint32 what the draws of each vehicle belong to.
        tick: () int32 now.
        due: () int32 the same, not batched.
        time_step: [s].
        lost: (n,) part of the packets of each vehicle, sent and received, that faults lose; None: no fault does.
    """

    said: Outbox | None
    beacons: Outbox | None
    surfaces: Surfaces
    ids: npt.NDArray[np.uint32]
    tick: Array
    due: Array
    time_step: float
    lost: Array | None = None


@runtime_checkable
class Radio(Protocol):
    """Messages between the n vehicles of a world; all shapes are static, and worlds are vmapped over from outside.

    Attributes:
        size: numbers of a message (D).
        beacon: whether those who have nothing to say send their own estimates.
        own: what fleets have of their own, with ``works`` (n,); None: nothing.
    """

    size: int
    beacon: bool
    own: Any

    @property
    @abstractmethod
    def period(self) -> float:
        """Time [s] from one exchange of packets to the next, a multiple of the time step."""

    @property
    def asks_height(self) -> bool:
        """True if ``exchange`` needs the radios' heights above the ground."""
        return False

    @property
    @abstractmethod
    def field_ids(self) -> int:
        """Number of random ids for which ``init`` draws numbers once an episode."""

    @abstractmethod
    def init(self, draw: Draw, keys: StreamKeys, like: Array) -> object:
        """Return the radio network's state at the start of an episode, without messages; ``like``: any array (n,)."""

    @abstractmethod
    def exchange(self, state: Any, now: Exchange) -> object:
        """Return the network's state after a tick: messages queued or sent; these arrive at the next tick or later."""

    @abstractmethod
    def received(self, state: Any, tick: Array, time_step: float) -> Inbox:
        """Return the messages that each vehicle has received by a tick, the newest of each sender."""

    @abstractmethod
    def heard(self, state: Any, tick: Array, time_step: float) -> Heard:
        """Return the messages received by a tick as a table, with the ticks at which each was sent and arrived."""

    def last_heard(self, state: Any, senders: slice, tick: Array, time_step: float) -> Array:
        """Return the tick (n,) int32 when the newest message received from ``senders`` was sent; -1 if none was."""
        heard = self.heard(state, tick, time_step)
        counts = (heard.sender >= senders.start) & (heard.sender < senders.stop)
        return jnp.max(jnp.where(counts, heard.sent, NOBODY), axis=0)

    @abstractmethod
    def counted(self, state: Any) -> dict[str, Array]:
        """Return the counts of packets since the start by name, such as "sent" and "lost_noise", each (n,)."""

    @abstractmethod
    def links(self, state: Any) -> object:
        """Return the radio links between vehicles in the last period, with each packet's outcome."""

    @abstractmethod
    def handed(self, state: Any, vehicle: int, payload: Any, to: int, tick: int) -> Any:
        """Return a state with a message to ``to`` appended to the send queue of ``vehicle``; called on the host."""
