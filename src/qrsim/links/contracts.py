"""Protocol of links to other software, as sessions use them (reference/ and others)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

# Who moves a session on: its owner's steps; its claimers together; the session itself, at a real-time factor.
Pace = Literal["owner", "barrier", "free"]


@dataclass(frozen=True)
class Stamp:
    """Time of validity and time of sending of a message.

    Attributes:
        tick: of the state.
        sampled: simulated time [s] at which the reading of each sensor was true, by "FLEET/SENSOR".
        sent: monotonic time of the wall clock [s].
    """

    tick: int
    sampled: Mapping[str, float]
    sent: float


@dataclass(frozen=True)
class Order:
    """A command or set-point (n,) for vehicles of one fleet.

    Attributes:
        vehicles: names of the n vehicles.
        action: one of the fleet's action records.
        computed_from: tick of the readings that it was computed from; None: unknown.
        until_tick: tick to advance to, for pace "barrier"; None: one tick.
    """

    vehicles: tuple[str, ...]
    action: Any
    computed_from: int | None = None
    until_tick: int | None = None


@runtime_checkable
class Link(Protocol):
    """A connected external controller or watcher of a session.

    Attributes:
        kind: name of the protocol.
        pace: who moves the session on while it is connected.
    """

    kind: ClassVar[str]
    pace: Pace = "owner"

    @abstractmethod
    def claims(self) -> tuple[str, ...]:
        """Return the names of the vehicles that it commands alone; the others fly their scenario's guidance."""

    @abstractmethod
    def refused(self, vehicle: str, holder: str) -> None:
        """Receive notice that a claimed vehicle belongs to another link."""

    @abstractmethod
    def orders(self) -> list[Order]:
        """Return the orders received since the last call, oldest first; empty if there are none."""

    @abstractmethod
    def publish(self, reading: Any, stamp: Stamp) -> None:
        """Send its vehicles' readings (interface/readings.py); must not block on a slow receiver."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection and release its claims."""
