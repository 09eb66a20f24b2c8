"""What a session of a simulation asks of a link to other software (reference/ and those to come)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

# Who moves a session on: its owner's steps; its claimers together; the session itself, at a real-time factor.
Pace = Literal["owner", "barrier", "free"]


@dataclass(frozen=True)
class Stamp:
    """When what is sent was true, and when it was sent.

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
    """A controller or a watcher outside, connected to a session.

    Attributes:
        kind: name of the protocol.
        pace: who moves the session on while it is connected.
    """

    kind: ClassVar[str]
    pace: Pace = "owner"

    @abstractmethod
    def claims(self) -> tuple[str, ...]:
        """Return the names of the vehicles that it alone commands; the others fly their scenario's guidance."""

    @abstractmethod
    def refused(self, vehicle: str, holder: str) -> None:
        """Be told that a claimed vehicle belongs to another."""

    @abstractmethod
    def orders(self) -> list[Order]:
        """Return what has come in since the last call, oldest first; empty where nothing has."""

    @abstractmethod
    def publish(self, reading: Any, stamp: Stamp) -> None:
        """Send what its vehicles see (interface/readings.py); must not wait for a slow receiver."""

    @abstractmethod
    def close(self) -> None:
        """End the connection, which frees its claims."""
