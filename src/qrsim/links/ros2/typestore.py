"""ROS 2 message types of a distribution: their names, hashes and DDS types, from the descriptions of rosbags."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from copy import copy
from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.idl.annotations import final
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from qrsim.errors import UsageError, did_you_mean
from qrsim.links.ros2 import Message
from qrsim.links.ros2.definitions import EVENT_INFO, Fields, definitions_of, service_types

DISTROS = ("humble", "iron", "jazzy", "kilted", "lyrical")
# Humble knows no type hashes.
_WITHOUT_HASHES = ("humble",)
_PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": idl.uint8,
    "char": idl.uint8,
    "uint8": idl.uint8,
    "int8": idl.int8,
    "uint16": idl.uint16,
    "int16": idl.int16,
    "uint32": idl.uint32,
    "int32": idl.int32,
    "uint64": idl.uint64,
    "int64": idl.int64,
    "float32": idl.float32,
    "float64": idl.float64,
}


class Types:
    """The message types of a distribution.

    Args:
        distro: one of DISTROS.
        packages: whose types (``definitions``) are known too.

    Raises:
        UsageError: the distribution is not one of them.

    Attributes:
        store: of rosbags, which writes and reads messages.
    """

    def __init__(self, distro: str = "jazzy", packages: Sequence[str] = ()):
        if distro not in DISTROS:
            raise UsageError(f"distribution '{distro}': expected {', '.join(DISTROS)}{did_you_mean(distro, DISTROS)}")
        self.distro = distro
        self.store = get_typestore(Stores[f"ROS2_{distro.upper()}"])
        self.store.register(definitions_of(*packages))
        self._structs: dict[str, object] = {}
        self._samples: dict[str, object] = {}

    def __getitem__(self, name: str) -> Any:
        """Return the class of a message, such as ``types["std_msgs/msg/String"]``."""
        return self.store.types[name]

    def hash(self, name: str) -> str:
        """Return the RIHS01 hash of a message type; "" for a ROS distribution without hashes."""
        if self.distro in _WITHOUT_HASHES:
            return ""
        found: str = self.store.hash_rihs01(name)
        return found

    def service_hash(self, name: str) -> str:
        """Return the RIHS01 hash of a service type; "" for a ROS distribution without hashes."""
        if self.distro in _WITHOUT_HASHES:
            return ""
        # A copy of the store, for types of events are of no other use.
        store = copy(self.store)
        store.fielddefs = store.fielddefs | service_types(name, store.fielddefs[EVENT_INFO][1])
        found: str = store.hash_rihs01(name)
        return found

    def encode(self, message: Message) -> bytes:
        """Encode a ROS message as CDR bytes."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def decode(self, cdr: bytes, name: str) -> object:
        """Decode CDR bytes to a ROS message of the type ``name``."""
        return self.store.deserialize_cdr(cdr, name)

    def heard(self, samples: Iterable[bytes], name: str) -> list[Message]:
        """Decode messages that other nodes have sent in CDR; invalid ones are left out."""
        found = []
        for cdr in samples:
            # One node that sends garbage must not end the flights of all.
            with suppress(SerdeError):
                found.append(self.decode(cdr, name))
        return found

    def fields(self, name: str) -> Fields:
        """Return (field name, description) of each field of a message type, in order."""
        return self.store.fielddefs[name][1]

    def sample(self, name: str) -> Any:
        """Return the DDS class for a message type; its instances hold CDR bytes in ``cdr``, which qrsim encodes.

        The library would turn a message into an object of its own field by field; qrsim hands it bytes.
        """
        if name not in self._samples:
            made = self._struct(name, alone=True)
            made.serialize = _serialized
            made.deserialize = classmethod(packed)
            self._samples[name] = made
        return self._samples[name]

    def _struct(self, name: str, alone: bool = False) -> Any:
        """Return the DDS struct class for a message type, as rmw_cyclonedds describes it; ``alone``: a new one, not
        shared."""
        if name in self._structs and not alone:
            return self._structs[name]
        fields = {field: self._dds_type(description) for field, description in self.fields(name)}
        struct = final(make_idl_struct(f"{name.rpartition('/')[2]}_", dds_name(name), fields))
        if not alone:
            self._structs[name] = struct
        return struct

    def _dds_type(self, description: Any) -> object:
        """Return the DDS type of a message field from rosbags' description."""
        kind, content = description
        if kind == Nodetype.NAME:
            return self._struct(content)
        if kind == Nodetype.BASE:
            name, limit = content
            if name == "string":
                return idl.bounded_str[limit] if limit else str
            return _PRIMITIVES[name]
        element, count = content
        if kind == Nodetype.ARRAY:
            return idl.array[self._dds_type(element), count]
        return idl.sequence[self._dds_type(element), count] if count else idl.sequence[self._dds_type(element)]


def _serialized(sample: Message, *args: object, **options: object) -> bytes:
    """Return the CDR bytes that a DDS sample holds; in place of cyclonedds' serialisation."""
    cdr: bytes = sample.cdr
    return cdr


def packed(kind: Any, cdr: bytes, *args: Any, **options: Any) -> Any:
    """Return a sample of a DDS class that holds the received bytes; in place of cyclonedds' deserialisation."""
    sample = object.__new__(kind)
    sample.cdr = cdr
    return sample


def dds_name(name: str) -> str:
    """Return the DDS name of a ROS type: "sensor_msgs/msg/Imu" is "sensor_msgs::msg::dds_::Imu_"."""
    package, _, own = name.rpartition("/")
    return f"{package.replace('/', '::')}::dds_::{own}_"


def other_type(topic: str, kind: str) -> str:
    """Return the warning that another node writes a topic with an unexpected type; ``kind``: its DDS name."""
    name = kind.replace("::dds_::", "::").replace("::", "/").rstrip("_")
    return f"{topic}: another node writes it as {name}, which is not read"
