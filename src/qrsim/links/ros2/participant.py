"""A participant of DDS that looks like a node of ROS 2."""

from __future__ import annotations

import atexit

import numpy as np
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
    DcpsEndpoint,
)
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic as DdsTopic
from cyclonedds.util import duration

from qrsim.errors import RunError, UsageError, os_error_as
from qrsim.links.ros2 import Message
from qrsim.links.ros2.profiles import PROFILES, Profile
from qrsim.links.ros2.rtps.services import RawService, Request, Services
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types, dds_name, other_type, packed

# Ports of DDS are 7400 + 250 times the domain, below 65536.
LAST_DOMAIN = 232
_INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_DISCOVERY = "ros_discovery_info"
_MOST_AT_ONCE = 32
_ALL_SAMPLES = ViewState.Any | InstanceState.Any | SampleState.Any


def checked_domain(domain: int) -> int:
    """Return a DDS domain number unchanged; raises UsageError if it is out of range."""
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
        self._types, self._node, self._resend, self._domain = types, node, resend, domain
        try:
            self._participant = DomainParticipant(checked_domain(domain), qos=Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException:
            raise RunError(
                f"DDS does not start in domain {domain}: no network interface that does multicast, or no free port; "
                "CYCLONEDDS_URI chooses an interface, 'lo' for this machine alone"
            ) from None
        self._writers: list[Writer] = []
        self._readers: list[Reader] = []
        self._services: list[RawService] = []
        self._rtps: Services | None = None
        # Profiles of the topics that are read and written, by name and type.
        self._read: dict[str, dict[str, Profile]] = {}
        self._written: dict[str, dict[str, Profile]] = {}
        self._remarked: set[str] = set()
        self._publishers = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._subscribers = BuiltinDataReader(self._participant, BuiltinTopicDcpsSubscription)
        self._info: Writer | None = None
        # Of all that is read, because to ask each reader takes longer than a tick of the world.
        self._unread = WaitSet(self._participant)
        for builtin in (self._publishers, self._subscribers):
            self._unread.attach(ReadCondition(builtin, _ALL_SAMPLES))

    def writer(self, topic: Topic) -> Writer:
        """Return a new publisher of a topic, as a DDS data writer."""
        profile = PROFILES[topic.quality]
        if topic.quality == "sensor" and self._resend:
            profile = Profile(reliable=True, depth=profile.depth)
        sample, found = self._dds_topic(topic)
        writer = Writer(DataWriter(self._participant, found, qos=self._endpoint_qos(profile, topic.type)), sample)
        self._writers.append(writer)
        self._written.setdefault(f"rt{topic.name}", {})[dds_name(topic.type)] = profile
        return writer

    def reader(self, topic: Topic) -> Reader:
        """Return a new subscriber of a topic, as a DDS data reader."""
        _, found = self._dds_topic(topic)
        profile = PROFILES[topic.quality]
        reader = Reader(
            self._types, topic, DataReader(self._participant, found, qos=self._endpoint_qos(profile, topic.type))
        )
        self._readers.append(reader)
        self._unread.attach(ReadCondition(reader.entity, _ALL_SAMPLES))
        self._read.setdefault(f"rt{topic.name}", {})[dds_name(topic.type)] = profile
        return reader

    def service(self, name: str, kind: str) -> Service:
        """Return a new service, in the form that clients of rmw_fastrtps and rmw_cyclonedds expect."""
        if self._rtps is None:
            with os_error_as(RunError, f"services do not start in domain {self._domain}"):
                self._rtps = Services(self._domain)
                # So that clients do not wait for who has left.
                atexit.register(self._rtps.close)
        raw = self._rtps.service(name, dds_name(f"{kind}_Request"), dds_name(f"{kind}_Response"))
        self._services.append(raw)
        return Service(self._types, kind, self._rtps, raw)

    def announce(self) -> None:
        """Publish which readers and writers belong to this node, on ros_discovery_info, so that ROS tools list them."""
        if self._info is None:
            kind = self._types.sample(_INFO)
            topic = DdsTopic(self._participant, _DISCOVERY, kind)
            self._info = Writer(DataWriter(self._participant, topic, qos=_dds_qos(Profile(True, 1, True))), kind)
        readers = [*(each.entity.guid.bytes for each in self._readers), *(each.reader for each in self._services)]
        writers = [*(each.entity.guid.bytes for each in self._writers), *(each.writer for each in self._services)]
        node = self._types["rmw_dds_common/msg/NodeEntitiesInfo"](
            "/", self._node, list(map(self._gid_message, readers)), list(map(self._gid_message, writers))
        )
        info = self._types[_INFO](self._gid_message(self._participant.guid.bytes), [node])
        self._info.write(self._types.encode(info))

    def has_news(self) -> bool:
        """Return whether a message for a reader or an announcement of another node has not been taken yet."""
        return self._unread.wait(0) > 0

    def remarks(self) -> list[str]:
        """Return a warning for each topic that another node has begun to use with an incompatible type or QoS.

        The reason is another type, or a quality of service that does not match; the words are those of rclcpp.
        """
        found = []
        for each in self._publishers.take(_MOST_AT_ONCE):
            found += self._publisher_remarks(each)
        for each in self._subscribers.take(_MOST_AT_ONCE):
            found += self._subscriber_remarks(each)
        new = [line for line in dict.fromkeys(found) if line not in self._remarked]
        self._remarked.update(new)
        return new

    def _publisher_remarks(self, other: DcpsEndpoint) -> list[str]:
        """Return a warning if another node's publisher has a type or QoS that this node's subscribers cannot
        receive."""
        known, name = self._read.get(str(other.topic_name)), str(other.topic_name).removeprefix("rt")
        if known is None:
            return []
        profile = known.get(str(other.type_name))
        if profile is None:
            return [other_type(name, str(other.type_name))]
        if profile.reliable and _is_best_effort(other.qos):
            return [
                f"{name}: new publisher discovered, offering incompatible QoS. No messages will be received from it. "
                "Last incompatible policy: RELIABILITY (it publishes best effort, and reliable is needed)"
            ]
        return []

    def _subscriber_remarks(self, other: DcpsEndpoint) -> list[str]:
        """Return a warning if another node's subscriber has a QoS that this node's publishers cannot serve."""
        profile = self._written.get(str(other.topic_name), {}).get(str(other.type_name))
        if profile is None:
            return []
        policy = ""
        if not profile.reliable and not _is_best_effort(other.qos):
            policy = "RELIABILITY (it requests reliable, and best effort is offered; --reliable offers it)"
        elif not profile.latched and _is_latched(other.qos):
            policy = "DURABILITY (it requests transient local, and volatile is offered)"
        name = str(other.topic_name).removeprefix("rt")
        line = (
            f"{name}: new subscription discovered, requesting incompatible QoS. No messages will be sent to it. "
            f"Last incompatible policy: {policy}"
        )
        return [line] if policy else []

    def _dds_topic(self, topic: Topic) -> tuple[object, object]:
        """Return the CDR sample class and the DDS topic for a ROS topic."""
        sample = self._types.sample(topic.type)
        return sample, DdsTopic(self._participant, f"rt{topic.name}", sample)

    def _endpoint_qos(self, profile: Profile, name: str) -> object:
        """Return the DDS QoS of a topic's reader or writer, with the hash of type ``name`` in its user data."""
        known = self._types.hash(name)
        return _dds_qos(profile, *((Policy.Userdata(f"typehash={known};".encode()),) if known else ()))

    def _gid_message(self, guid: bytes) -> object:
        """Convert a DDS GUID to a message of rmw_dds_common/Gid."""
        kind = "rmw_dds_common/msg/Gid"
        size = self._types.fields(kind)[0][1][1][1]
        return self._types[kind](np.frombuffer(guid.ljust(size, b"\0"), np.uint8))


def _is_best_effort(qos: Qos) -> bool:
    """Return whether a DDS QoS is best effort, the default of a reader, and not reliable."""
    # Of a reader it is the default.
    return Policy.Reliability not in qos or qos[Policy.Reliability] == Policy.Reliability.BestEffort


def _is_latched(qos: Qos) -> bool:
    """Return whether a DDS QoS keeps samples for late subscribers (durability transient local)."""
    return Policy.Durability in qos and qos[Policy.Durability] != Policy.Durability.Volatile


def _dds_qos(profile: Profile, *more: object) -> object:
    """Convert a QoS profile to a DDS QoS: XCDR1, as ROS uses, and no waiting for slow readers; ``more``: further
    policies."""
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

    def __init__(self, entity: DataWriter, sample: Message):
        self.entity = entity
        self._sample = packed(sample, b"")
        self.lost = 0

    def write(self, cdr: bytes) -> None:
        """Publish a message, encoded in CDR; never waits."""
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

    def __init__(self, types: Types, topic: Topic, entity: DataReader):
        self._types, self.topic, self.entity = types, topic, entity

    def take(self) -> list[Message]:
        """Return the messages that have arrived, oldest first, without those that only report that a writer has
        left."""
        samples = self.entity.take(_MOST_AT_ONCE)
        return self._types.heard((each.cdr for each in samples if not isinstance(each, InvalidSample)), self.topic.type)


class Service:
    """Answers requests of a service.

    Args:
        types: of the distribution.
        kind: of the service.
        rtps: participant that has it.
        raw: the service as bytes.
    """

    def __init__(self, types: Types, kind: str, rtps: Services, raw: RawService):
        self._types, self._kind, self._rtps, self._raw = types, kind, rtps, raw

    def take(self) -> list[tuple[Request, Message]]:
        """Return the requests that have arrived, oldest first, each as (handle for ``reply``, message)."""
        self._rtps.spin()
        found = []
        while self._raw.waiting:
            request, cdr = self._raw.waiting.popleft()
            found += [(request, each) for each in self._types.heard([cdr], f"{self._kind}_Request")]
        return found

    def reply(self, request: Request, response: Message) -> None:
        """Send the response to a request that ``take`` returned."""
        self._rtps.reply(self._raw, request, self._types.encode(response))
