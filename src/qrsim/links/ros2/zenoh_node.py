"""A session of zenoh that looks like a node of ROS 2 with rmw_zenoh: the second transport, of the same bytes.

Keys, attachments and liveliness tokens are those of rmw_zenoh_cpp (its design.md, liveliness_utils.cpp and
attachment_helpers.cpp).
"""

from __future__ import annotations

import hashlib
import json
import struct
import time

import zenoh
import zenoh.ext

from qrsim.errors import RunError
from qrsim.links.ros2 import Message
from qrsim.links.ros2.participant import checked_domain
from qrsim.links.ros2.profiles import PROFILES, Profile
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types, dds_name, other_type

# Of rmw_zenohd, to which nodes of ROS 2 connect.
ROUTER = "tcp/localhost:7447"
# What stands in keys of distributions without type hashes.
_NO_HASH = "TypeHashNotSupported"
_MOST_AT_ONCE = 32
# Of rmw_qos_reliability_policy_e and rmw_qos_durability_policy_e; what is empty is the default, reliable and volatile.
_BEST_EFFORT, _TRANSIENT_LOCAL = 2, 1


class ZenohNode:
    """A node of ROS 2 for others, with its topics; as ``Participant``.

    Args:
        types: of the distribution.
        domain: as ROS_DOMAIN_ID.
        node: its name.
        resend: whether readings of sensors are told to be reliable.
        router: where it connects to; it goes on without, and tries again.
        listen: where it can be connected to.

    Raises:
        UsageError: there is no such domain.
        RunError: zenoh does not start.
    """

    def __init__(
        self,
        types: Types,
        domain: int,
        node: str = "qrsim",
        resend: bool = False,
        router: str = ROUTER,
        listen: str = "tcp/localhost:0",
    ):
        self._types, self._node, self._resend, self._domain = types, node, resend, checked_domain(domain)
        try:
            self._session = zenoh.open(_config(router, listen))
        except zenoh.ZError as error:
            # Its own words are lines of where in the library; the first says what.
            raise RunError(f"zenoh does not start with the router {router}: {str(error).splitlines()[0]}") from None
        self._zid = str(self._session.zid())
        # What nobody holds any more is undeclared.
        self._kept: list[object] = []
        self._entities = 0
        self._read: dict[str, set[str]] = {}
        self._others = self._session.liveliness().declare_subscriber(
            f"@ros2_lv/{domain}/**", zenoh.handlers.FifoChannel(4096), history=True
        )
        self._declare("NN", "")

    def has_router(self, patience: float) -> bool:
        """Return whether a zenoh router answers within ``patience`` [s]."""
        end = time.monotonic() + patience
        while not self._session.info.routers_zid():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def writer(self, topic: Topic) -> ZenohWriter:
        """Return a new publisher of a topic."""
        profile = PROFILES[topic.quality]
        if topic.quality == "sensor" and self._resend:
            profile = Profile(reliable=True, depth=profile.depth)
        key, token = self._key_expression(topic), self._declare("MP", self._token_fields(topic, profile))
        options: dict[str, object] = {"congestion_control": zenoh.CongestionControl.DROP}
        if profile.latched:
            cache = zenoh.ext.CacheConfig(profile.depth)
            made = zenoh.ext.declare_advanced_publisher(
                self._session, key, cache=cache, publisher_detection=True, **options
            )
        else:
            made = self._session.declare_publisher(key, **options)
        self._kept.append(made)
        return ZenohWriter(made, hashlib.blake2b(token.encode(), digest_size=16).digest())

    def reader(self, topic: Topic) -> ZenohReader:
        """Return a new subscriber of a topic."""
        self._declare("MS", self._token_fields(topic, PROFILES[topic.quality]))
        self._read.setdefault(topic.name, set()).add(dds_name(topic.type))
        channel = zenoh.handlers.RingChannel(_MOST_AT_ONCE)
        if PROFILES[topic.quality].latched:
            made = zenoh.ext.declare_advanced_subscriber(
                self._session,
                self._key_expression(topic),
                channel,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            )
        else:
            made = self._session.declare_subscriber(self._key_expression(topic), channel)
        self._kept.append(made)
        return ZenohReader(self._types, topic, made)

    def service(self, name: str, kind: str) -> ZenohService:
        """Return a new service: a zenoh queryable, as in rmw_zenoh, whose replies carry the query's attachment."""
        own = self._types.service_hash(kind) or _NO_HASH
        told = f"/{_mangled(name)}/{dds_name(kind)}/{own}/{_qualities(PROFILES['service'])}"
        self._declare("SS", told)
        key = f"{self._domain}/{name.strip('/')}/{dds_name(kind)}/{own}"
        channel = zenoh.handlers.RingChannel(_MOST_AT_ONCE)
        made = self._session.declare_queryable(key, channel, complete=True)
        self._kept.append(made)
        return ZenohService(self._types, kind, key, made)

    def announce(self) -> None:
        """Do nothing, since zenoh's liveliness tokens have already announced every topic."""

    def has_news(self) -> bool:
        """Return True, since zenoh has no common place to ask for messages of all subscribers."""
        return True

    def remarks(self) -> list[str]:
        """Return a warning for each subscribed topic that another node publishes with another type.

        Qualities of service need not match: rmw_zenoh delivers whatever they are.
        """
        found = []
        for _ in range(_MOST_AT_ONCE):
            sample = self._others.try_recv()
            if sample is None:
                break
            parts = str(sample.key_expr).split("/")
            if sample.kind == zenoh.SampleKind.PUT and len(parts) == 13 and parts[5] == "MP":
                name, kind = parts[9].replace("%", "/"), parts[10].replace("%", "/")
                if name in self._read and kind not in self._read[name]:
                    found.append(other_type(name, kind))
        return found

    def close(self) -> None:
        """Undeclare all publishers, subscribers and tokens, and close the zenoh session."""
        self._session.close()

    def _key_expression(self, topic: Topic) -> str:
        """Return the zenoh key expression of a topic: ROS domain, name, type and type hash."""
        return f"{self._domain}/{topic.name.strip('/')}/{dds_name(topic.type)}/{self._type_hash(topic.type)}"

    def _type_hash(self, name: str) -> str:
        """Return the hash of a message type, or the text that rmw_zenoh uses for a missing hash."""
        return self._types.hash(name) or _NO_HASH

    def _token_fields(self, topic: Topic, profile: Profile) -> str:
        """Return the part of a liveliness token that describes a topic: name, type, hash and QoS."""
        return f"/{_mangled(topic.name)}/{dds_name(topic.type)}/{self._type_hash(topic.type)}/{_qualities(profile)}"

    def _declare(self, what: str, told: str) -> str:
        """Declare a liveliness token (``what``: NN node, MP publisher, MS subscriber, SS service) with content
        ``told``; return it."""
        token = f"@ros2_lv/{self._domain}/{self._zid}/0/{self._entities}/{what}/%/%/{self._node}{told}"
        self._entities += 1
        self._kept.append(self._session.liveliness().declare_token(token))
        return token


def _config(router: str, listen: str) -> object:
    """Return rmw_zenoh's session settings for the addresses ``router`` and ``listen``, except that a missing router is
    no error."""
    config = zenoh.Config()
    for path, value in (
        ("mode", "peer"),
        ("connect/endpoints", [router]),
        ("connect/exit_on_failure", False),
        ("connect/timeout_ms", 0),
        ("listen/endpoints", [listen]),
        ("scouting/multicast/enabled", False),
        ("timestamping/enabled", True),
    ):
        config.insert_json5(path, json.dumps(value))
    return config


def _qualities(profile: Profile) -> str:
    """Encode a QoS profile as text for a liveliness token."""
    reliability = "" if profile.reliable else _BEST_EFFORT
    durability = _TRANSIENT_LOCAL if profile.latched else ""
    return f"{reliability}:{durability}:,{profile.depth}:,:,:,,"


def _mangled(name: str) -> str:
    """Return a topic or node name with "/" replaced by "%", as in liveliness tokens."""
    return name.replace("/", "%")


class ZenohWriter:
    """Writes messages as bytes; as ``participant.Writer``.

    Attributes:
        lost: always 0, because zenoh does not say what it drops.
    """

    def __init__(self, publisher: zenoh.Publisher | zenoh.ext.AdvancedPublisher, gid: bytes):
        self._publisher, self._gid = publisher, _length_prefixed("source_gid") + bytes([len(gid)]) + gid
        self._number, self.lost = 0, 0

    def write(self, cdr: bytes) -> None:
        """Publish a message, encoded in CDR; never waits."""
        self._number += 1
        self._publisher.put(cdr, attachment=attachment(self._number, time.time_ns()) + self._gid)


class ZenohReader:
    """Reads messages; as ``participant.Reader``.

    Attributes:
        topic: that it reads.
    """

    def __init__(self, types: Types, topic: Topic, subscriber: zenoh.Subscriber | zenoh.ext.AdvancedSubscriber):
        self._types, self.topic, self._subscriber = types, topic, subscriber

    def take(self) -> list[Message]:
        """Return the messages that have arrived, oldest first."""
        found = []
        for _ in range(_MOST_AT_ONCE):
            sample = self._subscriber.try_recv()
            if sample is None:
                break
            if sample.kind == zenoh.SampleKind.PUT:
                found.append(sample.payload.to_bytes())
        return self._types.heard(found, self.topic.type)


class ZenohService:
    """Answers requests; as ``participant.Service``."""

    def __init__(self, types: Types, kind: str, key: str, queryable: zenoh.Queryable):
        self._types, self._kind, self._key_expression, self._queryable = types, kind, key, queryable

    def take(self) -> list[tuple[zenoh.Query, Message]]:
        """Return the requests that have arrived, oldest first, each as (zenoh query, message)."""
        found = []
        for _ in range(_MOST_AT_ONCE):
            query = self._queryable.try_recv()
            if query is None:
                break
            if query.payload is not None:
                cdr = query.payload.to_bytes()
                found += [(query, each) for each in self._types.heard([cdr], f"{self._kind}_Request")]
        return found

    def reply(self, request: Message, response: Message) -> None:
        """Send the response to a request that ``take`` returned."""
        own = request.attachment
        request.reply(
            self._key_expression, self._types.encode(response), attachment=None if own is None else own.to_bytes()
        )
        request.drop()


def _length_prefixed(name: str) -> bytes:
    """Encode a name as bytes with its length in front, as zenoh does."""
    return bytes([len(name)]) + name.encode()


_SEQUENCE, _TIME = _length_prefixed("sequence_number"), _length_prefixed("source_timestamp")


def attachment(number: int, nanoseconds: int) -> bytes:
    """Return the first two parts of a zenoh attachment: sequence number and time [ns]."""
    return _SEQUENCE + struct.pack("<q", number) + _TIME + struct.pack("<q", nanoseconds)
