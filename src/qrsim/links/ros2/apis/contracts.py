"""What an API has for one vehicle: messages that are published, set-points that are taken, services that answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from qrsim.links.mavlink.view import View
from qrsim.links.ros2 import Message
from qrsim.links.ros2.topics import Topic

# Returns a message as CDR; None where there is none.
Make = Callable[[View], bytes | None]
# The rate of a message that is sent when there is one, several at a tick where there are several.
EACH = math.inf


@dataclass(frozen=True)
class Told:
    """A topic that is published.

    Attributes:
        topic: its name, type and quality of service.
        rate: messages per second of simulated time; 0: at changes alone; EACH.
        make: of a message.
        key: the message is published at once when this changes; None: at its rate alone.
    """

    topic: Topic
    rate: float
    make: Make
    key: Callable[[View], object] | None = None


@dataclass(frozen=True)
class Heard:
    """A topic that is subscribed to, and the function that takes its messages."""

    topic: Topic
    take: Callable[[Message], None]


@dataclass(frozen=True)
class Answered:
    """A service: its name, its type, and the function from a request to the response; None: it does not answer."""

    name: str
    type: str
    answer: Callable[[Message], Message]


@dataclass
class Interface:
    """All topics and services of one vehicle."""

    told: list[Told] = field(default_factory=list)
    heard: list[Heard] = field(default_factory=list)
    answered: list[Answered] = field(default_factory=list)
