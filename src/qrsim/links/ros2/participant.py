"""A participant of DDS that looks like a node of ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from qrsim.errors import RunError, UsageError
from qrsim.links.ros2.profiles import PROFILES, Profile
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types, dds_name, packed

# Ports of DDS are 7400 + 250 times the domain, below 65536.
LAST_DOMAIN = 232
_INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_DISCOVERY = "ros_discovery_info"
_MOST_AT_ONCE = 32


def checked_domain(domain: int) -> int:
    """Check the number of a domain and return it; raises UsageError."""
    if not 0 <= domain <= LAST_DOMAIN:
        raise UsageError(f"domain {domain}: expected 0 to {LAST_DOMAIN}, as ROS_DOMAIN_ID")
    return domain


class Participant:
    """A node of ROS 2 for others, with its topics.

    Args:
        types: of the distribution.
        domain: as ROS_DOMAIN_ID.
        node: its name.
        resend: whether readings of sensors are sent again where they are lost.

    Raises:
        UsageError: there is no such domain.
        RunError: DDS finds no network interface, or no port.
    """

    def __init__(self, types: Types, domain: int, node: str = "qrsim", resend: bool = False):
        self._types, self._node, self._resend = types, node, resend
        try:
            self._participant = DomainParticipant(checked_domain(domain), qos=Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException:
            raise RunError(
                f"DDS does not start in domain {domain}: no network interface that does multicast, or no free port; "
                "CYCLONEDDS_URI chooses an interface, 'lo' for this machine alone"
            ) from None
        self._writers: list[Writer] = []
        self._readers: list[Reader] = []
        # By the name of each topic that is read, its types.
        self._read: dict[str, set[str]] = {}
        self._heard = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._info: Any = None

    def writer(self, topic: Topic) -> Writer:
        """Return a new writer of a topic."""
        profile = PROFILES[topic.quality]
        if topic.quality == "sensor" and self._resend:
            profile = Profile(reliable=True, depth=profile.depth)
        sample, found = self._topic(topic)
        writer = Writer(DataWriter(self._participant, found, qos=self._qos(profile, topic.type)), sample)
        self._writers.append(writer)
        return writer

    def reader(self, topic: Topic) -> Reader:
        """Return a new reader of a topic."""
        _, found = self._topic(topic)
        qos = self._qos(PROFILES[topic.quality], topic.type)
        reader = Reader(self._types, topic, DataReader(self._participant, found, qos=qos))
        self._readers.append(reader)
        self._read.setdefault(f"rt{topic.name}", set()).add(dds_name(topic.type))
        return reader

    def announce(self) -> None:
        """Tell other nodes which readers and writers are this node's."""
        if self._info is None:
            kind = self._types.sample(_INFO)
            topic: Any = DdsTopic(self._participant, _DISCOVERY, kind)
            self._info = Writer(DataWriter(self._participant, topic, qos=_plain(Profile(True, 1, True))), kind)
        node = self._types["rmw_dds_common/msg/NodeEntitiesInfo"](
            "/", self._node, [self._gid(each.entity) for each in self._readers],
            [self._gid(each.entity) for each in self._writers],
        )  # fmt: skip
        info = self._types[_INFO](self._gid(self._participant), [node])
        self._info.write(self._types.encode(info))

    def strangers(self) -> list[tuple[str, str]]:
        """Return topics that this node reads and others have begun to write as another type, with that type."""
        known, found = self._read, []
        for each in self._heard.take(_MOST_AT_ONCE):
            name, kind = str(each.topic_name), str(each.type_name)
            if name in known and kind not in known[name]:
                found.append((name.removeprefix("rt"), kind.replace("::dds_::", "::").replace("::", "/").rstrip("_")))
        return found

    def _topic(self, topic: Topic) -> tuple[Any, Any]:
        sample = self._types.sample(topic.type)
        return sample, DdsTopic(self._participant, f"rt{topic.name}", sample)

    def _qos(self, profile: Profile, name: str) -> Any:
        known = self._types.hash(name)
        return _plain(profile, *((Policy.Userdata(f"typehash={known};".encode()),) if known else ()))

    def _gid(self, entity: Any) -> Any:
        kind = "rmw_dds_common/msg/Gid"
        size = self._types.fields(kind)[0][1][1][1]
        return self._types[kind](np.frombuffer(entity.guid.bytes.ljust(size, b"\0"), np.uint8))


def _plain(profile: Profile, *more: Any) -> Any:
    """Return qualities of service: XCDR1, as ROS has it, and no waiting for slow readers."""
    latched = (
        Policy.Durability.TransientLocal,
        Policy.DurabilityService(0, Policy.History.KeepLast(profile.depth), -1, -1, -1),
    )
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=0)) if profile.reliable else Policy.Reliability.BestEffort,
        Policy.History.KeepLast(profile.depth),
        *(latched if profile.latched else (Policy.Durability.Volatile,)),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        *more,
    )


class Writer:
    """Writes messages as bytes.

    Attributes:
        entity: of DDS.
        lost: messages for which there was no room, because a reader is slow.
    """

    def __init__(self, entity: Any, sample: Any):
        self.entity = entity
        self._sample = packed(sample, b"")
        self.lost = 0

    def write(self, cdr: bytes) -> None:
        """Write a message in CDR; never waits."""
        self._sample.cdr = cdr
        try:
            self.entity.write(self._sample)
        except DDSException:
            self.lost += 1


class Reader:
    """Reads messages.

    Attributes:
        entity: of DDS.
        topic: that it reads.
    """

    def __init__(self, types: Types, topic: Topic, entity: Any):
        self._types, self.topic, self.entity = types, topic, entity

    def take(self) -> list[Any]:
        """Return what has come, oldest first; a writer that leaves is an ``InvalidSample``."""
        return [
            self._types.decode(sample.cdr, self.topic.type)
            for sample in self.entity.take(_MOST_AT_ONCE)
            if not isinstance(sample, InvalidSample)
        ]
