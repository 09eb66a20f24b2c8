"""The parameter protocol of one vehicle: PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET."""

from __future__ import annotations

import struct
import zlib

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.frames import Frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import ARDUPILOT
from qrsim.links.mavlink.stack.parameters import INT32, Outcome, Parameter
from qrsim.links.mavlink.system import System

# The value as its four bytes: an integer may look like a float that is no number, which a float would not keep.
_VALUE = struct.Struct("<4sHH16sB")
_REAL, _INTEGER = struct.Struct("<f"), struct.Struct("<i")
_NUMBER = LAYOUTS["PARAM_VALUE"].number
# MAV_PARAM_ERROR.
DOES_NOT_EXIST, READ_ONLY = 1, 5
# param_index of a request by name, and of a reply that has no index.
BY_NAME = -1
# The hash of all parameters, its MAV_PARAM_TYPE, and its index, for it is in no list.
HASH, UINT32, NO_INDEX = "_HASH_CHECK", 5, 0xFFFF


def send_all(system: System, link: Link) -> None:
    """Answer PARAM_REQUEST_LIST: send every parameter as a PARAM_VALUE, with its index and the count."""
    if _has_hash(system):
        link.put(_NUMBER, _hash(system))
    for parameter in system.stack.parameters:
        link.put(_NUMBER, _payload(system, parameter))
    link.flush()


def send_one(system: System, link: Link, frame: Frame) -> None:
    """Answer PARAM_REQUEST_READ: send the PARAM_VALUE of one parameter, requested by index or name."""
    request = frame.message()
    table, index = system.stack.parameters, request.param_index
    name = request.param_id.decode("ascii", "replace")
    parameter = table.parameter(name) if index == BY_NAME else table.at(index)
    if index == BY_NAME and name == HASH and _has_hash(system):
        link.put(_NUMBER, _hash(system))
        link.flush()
    elif parameter is None:
        _refuse(link, frame, request.param_id, index, DOES_NOT_EXIST)
    else:
        link.put(_NUMBER, _payload(system, parameter))
        link.flush()


def set_one(system: System, link: Link, frame: Frame) -> None:
    """Set a parameter as PARAM_SET asks; its resulting value is sent on all links."""
    request, table = frame.message(), system.stack.parameters
    name = request.param_id.decode("ascii", "replace")
    parameter = table.parameter(name)
    if name == HASH and _has_hash(system):
        # A client that has the table already stops the list by it, which is sent as a whole here.
        return
    if parameter is None:
        _refuse(link, frame, request.param_id, BY_NAME, DOES_NOT_EXIST)
        return
    raw = frame.payload[:4].ljust(4, b"\0")
    kind = _format(system, request.param_type)
    outcome = table.set(name, float(kind.unpack(raw)[0]), request.param_type)
    if outcome is Outcome.READ_ONLY:
        _refuse(link, frame, request.param_id, table.index(name), READ_ONLY)
    payload = _payload(system, parameter)
    told = system.links if outcome in (Outcome.SET, Outcome.CLAMPED) else [link]
    for each in told:
        each.put(_NUMBER, payload)
        each.flush()


def _has_hash(system: System) -> bool:
    """Return whether a vehicle offers PX4's ``_HASH_CHECK``, a hash of all parameters."""
    return system.stack.heartbeat().autopilot != ARDUPILOT


def _hash(system: System) -> bytes:
    """Return the PARAM_VALUE payload of ``_HASH_CHECK``: the hash of all parameters' names and values, as PX4's
    ``param_hash_check``."""
    table, state = system.stack.parameters, 0
    for parameter in table:
        value = table[parameter.name]
        raw = _INTEGER.pack(int(value)) if parameter.type == INT32 else _REAL.pack(value)
        # PX4 begins with 0 and does not invert the end.
        state = zlib.crc32(parameter.name.encode() + raw, state ^ 0xFFFFFFFF) ^ 0xFFFFFFFF
    return _VALUE.pack(struct.pack("<I", state), len(table), NO_INDEX, HASH.encode(), UINT32)


def _format(system: System, type: int) -> struct.Struct:
    """Return the struct that packs a value (of MAV_PARAM_TYPE ``type``) into PARAM_VALUE: PX4 sends integers bytewise,
    ArduPilot floats."""
    return _INTEGER if type == INT32 and system.stack.heartbeat().autopilot != ARDUPILOT else _REAL


def _payload(system: System, parameter: Parameter) -> bytes:
    """Return the PARAM_VALUE payload of a parameter with its present value."""
    table = system.stack.parameters
    value = table[parameter.name]
    kind = _format(system, parameter.type)
    raw = kind.pack(int(value) if kind is _INTEGER else value)
    return _VALUE.pack(raw, len(table), table.index(parameter.name), parameter.name.encode(), parameter.type)


def _refuse(link: Link, frame: Frame, name: bytes, index: int, error: int) -> None:
    """Send PARAM_ERROR about a parameter, by name and index, to the sender of ``frame``."""
    link.say(
        "PARAM_ERROR",
        target_system=frame.system,
        target_component=frame.component,
        param_id=name,
        param_index=index,
        error=error,
    )
