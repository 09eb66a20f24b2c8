"""Records that links to other software exchange with the world that they share (shared/)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

# Who moves a world on: its owner's steps; its claimers together; the wall clock, at a real-time factor.
Pace = Literal["owner", "barrier", "free"]
PACES: tuple[str, ...] = get_args(Pace)
# What a vehicle does that hears nothing from its controller: it holds its place, returns to above its start at the
# height that it has, or stops its motors.
OnSilence = Literal["hold", "return", "stop"]
ON_SILENCE: tuple[str, ...] = get_args(OnSilence)


@dataclass(frozen=True)
class Order:
    """The order of one vehicle, until its next one.

    Attributes:
        vehicle: name.
        kind: a set-point by its name in a scenario ("waypoint", "velocity", ...), or "control".
        numbers: of it, in the order of shared/kinds.py.
    """

    vehicle: str
    kind: str
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class Words:
    """A message that one vehicle sends by radio.

    Attributes:
        vehicle: name.
        numbers: of the message.
        to: name of the only recipient; None: all.
    """

    vehicle: str
    numbers: tuple[float, ...]
    to: str | None = None


@dataclass(frozen=True)
class Silence:
    """Behaviour of a vehicle without its controller.

    Attributes:
        does: "hold", "return" or "stop".
        after: without an order for so long [s]; 0: never, it flies on the last one. Where the world runs faster than
            the wall clock, this is a time of the wall clock.
    """

    does: OnSilence = "hold"
    after: float = 0.5
