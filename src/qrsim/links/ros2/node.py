"""What a transport has to be: a node of ROS 2 with writers and readers of topics, whatever carries the bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from qrsim.links.ros2 import Message
from qrsim.links.ros2.topics import Topic


class Writer(Protocol):
    """Writes messages of a topic."""

    lost: int

    def write(self, cdr: bytes) -> None:
        """Publish a message, encoded in CDR; never waits."""


class Reader(Protocol):
    """Reads messages of a topic."""

    topic: Topic

    def take(self) -> list[Message]:
        """Return the messages that have arrived, oldest first."""


class Service(Protocol):
    """Answers requests of a service."""

    def take(self) -> Sequence[tuple[object, Message]]:
        """Return the requests that have arrived, oldest first, each as (handle for ``reply``, message)."""

    def reply(self, request: Message, response: Message) -> None:
        """Send the response to a request that ``take`` returned."""


class Node(Protocol):
    """A node; made by ``participant.Participant`` over DDS, and ``zenoh_node.ZenohNode`` over zenoh."""

    def writer(self, topic: Topic) -> Writer:
        """Return a new publisher of a topic."""

    def reader(self, topic: Topic) -> Reader:
        """Return a new subscriber of a topic."""

    def service(self, name: str, kind: str) -> Service:
        """Return a new service with a name and a type, such as "std_srvs/srv/Trigger"."""

    def announce(self) -> None:
        """Announce this node's topics to other nodes; call it once all are created."""

    def has_news(self) -> bool:
        """Return False if no reader has a message and there is no remark; requests of services do not count."""

    def remarks(self) -> list[str]:
        """Return a warning for each topic that another node has begun to use with an incompatible type or QoS."""
