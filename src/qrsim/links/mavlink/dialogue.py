"""What a vehicle answers to the frames of clients."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable

from qrsim.links.mavlink import requests, table
from qrsim.links.mavlink.dialect import BY_NUMBER, LAYOUTS, Message
from qrsim.links.mavlink.frames import Frame
from qrsim.links.mavlink.link import COMPONENT, Link
from qrsim.links.mavlink.stack.codes import ARDUPILOT, Result, Severity
from qrsim.links.mavlink.stack.contracts import (
    Ack,
    AttitudeTarget,
    Command,
    FollowTarget,
    GlobalTarget,
    LocalTarget,
    Target,
    Text,
    Triple,
)
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.telemetry import ENCODERS

GROUND_STATION = 6
# MAV_CMD.
DO_SET_MODE = 176
# FILE_TRANSFER_PROTOCOL: a refusal, and why: no such file, or a request that is not known.
_NAK, _NO_FILE, _UNKNOWN = 129, 10, 7
_OPENS = (4, 5, 6, 11, 14, 15)
# An axis and channels that are not told.
_NO_AXIS, _NO_PULSE = 0x7FFF, (0, 0xFFFF)
Handler = Callable[[System, Link, Frame], None]


def handle(system: System, link: Link, frame: Frame) -> None:
    """Call the handler of a client's frame if it is addressed to this vehicle and its message is known; ignore all
    others.

    Args:
        system: the vehicle.
        link: on which it came, and the answer goes.
        frame: of a client.
    """
    handler = _HANDLERS.get(frame.layout.name)
    if handler is None or system.muted or not _is_for(system, frame):
        return
    link.heard = time.monotonic()
    handler(system, link, frame)


def _is_for(system: System, frame: Frame) -> bool:
    """Return whether a frame is addressed to this system (or all) and to the autopilot component (or all)."""
    places = _TARGETS.get(frame.layout.number)
    if places is None:
        return True
    payload, (at, component) = frame.payload, places
    target = payload[at] if at < len(payload) else 0
    part = payload[component] if 0 <= component < len(payload) else 0
    return target in (0, system.number) and part in (0, COMPONENT)


def _targets() -> dict[int, tuple[int, int]]:
    """Return message number -> (offset of target_system, of target_component) in the payload [bytes]; -1: no component
    field."""
    found = {}
    for number, layout in BY_NUMBER.items():
        places, at = {}, 0
        for field in layout.fields:
            places[field.name] = at
            at += struct.calcsize(f"<{field.format}")
        # MANUAL_CONTROL calls it otherwise.
        system = places.get("target_system", places.get("target"))
        if system is not None:
            found[number] = system, places.get("target_component", -1)
    return found


_TARGETS = _targets()

# ---- commands ----


def _command_long(system: System, link: Link, frame: Frame) -> None:
    """Execute the command of a COMMAND_LONG, by the flight stack or the link itself, and acknowledge it."""
    message = frame.message()
    params = tuple(getattr(message, f"param{number}") for number in range(1, 8))
    _obey(system, link, frame, Command(message.command, params))


def _command_int(system: System, link: Link, frame: Frame) -> None:
    """Execute the command of a COMMAND_INT, by the flight stack or the link itself, and acknowledge it."""
    m = frame.message()
    params = (m.param1, m.param2, m.param3, m.param4)
    _obey(system, link, frame, Command.of_int(m.command, m.frame, params, m.x, m.y, m.z))


def _obey(system: System, link: Link, frame: Frame, command: Command) -> None:
    """Execute a client's command, send COMMAND_ACK with the result, and send the messages that the command requests."""
    answer = requests.answer(system, link, command)
    ack, payloads = (system.stack.command(command), ()) if answer is None else answer
    acknowledge(link, frame, command.id, ack)
    if ack.result in (Result.DENIED, Result.UNSUPPORTED):
        # Clients repeat what is refused.
        system.note_once(f"command {command.id} of system {frame.system}: {ack.result.name.lower()}")
    for payload in payloads:
        link.put(*payload)
    link.flush()


def acknowledge(link: Link, frame: Frame, command: int, ack: Ack) -> None:
    """Send COMMAND_ACK for a command number with a result, addressed to the sender of ``frame``."""
    link.say(
        "COMMAND_ACK",
        command=command,
        result=int(ack.result),
        progress=ack.progress,
        target_system=frame.system,
        target_component=frame.component,
    )


def _set_mode(system: System, link: Link, frame: Frame) -> None:
    """Change the flight mode as a SET_MODE message asks, and answer with the COMMAND_ACK of DO_SET_MODE."""
    message = frame.message()
    acknowledge(link, frame, DO_SET_MODE, Ack(system.stack.set_mode(message.base_mode, message.custom_mode)))


# ---- set-points ----


def _axes(m: Message, x: str, y: str, z: str) -> Triple:
    """Return the values of a message's fields that are named ``x``, ``y`` and ``z`` as a tuple."""
    return getattr(m, x), getattr(m, y), getattr(m, z)


def _take(system: System, link: Link, target: Target) -> None:
    """Pass a client's set-point to the flight stack, and note whether this link now flies the vehicle (for
    lock-step)."""
    system.stack.setpoint(target)
    link.flies, link.owes = system.stack.takes_setpoints, False


def _local_target(system: System, link: Link, frame: Frame) -> None:
    """Pass the set-point of a SET_POSITION_TARGET_LOCAL_NED message to the flight stack."""
    m = frame.message()
    target = LocalTarget(
        m.coordinate_frame,
        m.type_mask,
        _axes(m, "x", "y", "z"),
        _axes(m, "vx", "vy", "vz"),
        _axes(m, "afx", "afy", "afz"),
        m.yaw,
        m.yaw_rate,
    )
    _take(system, link, target)


def _global_target(system: System, link: Link, frame: Frame) -> None:
    """Pass the set-point of a SET_POSITION_TARGET_GLOBAL_INT message to the flight stack."""
    m = frame.message()
    target = GlobalTarget(
        m.coordinate_frame,
        m.type_mask,
        m.lat_int,
        m.lon_int,
        m.alt,
        _axes(m, "vx", "vy", "vz"),
        _axes(m, "afx", "afy", "afz"),
        m.yaw,
        m.yaw_rate,
    )
    _take(system, link, target)


def _attitude_target(system: System, link: Link, frame: Frame) -> None:
    """Pass the set-point of a SET_ATTITUDE_TARGET message to the flight stack."""
    m = frame.message()
    rates = _axes(m, "body_roll_rate", "body_pitch_rate", "body_yaw_rate")
    _take(system, link, AttitudeTarget(m.type_mask, m.q, rates, m.thrust))


def _takes_sticks(system: System, by: tuple[int, ...]) -> bool:
    """Return whether the parameter COM_RC_IN_MODE is one of ``by``, the values that admit these sticks; always True for
    ArduPilot."""
    parameters = system.stack.parameters
    return system.stack.heartbeat().autopilot == ARDUPILOT or int(parameters["COM_RC_IN_MODE"]) in by


def _manual(system: System, link: Link, frame: Frame) -> None:
    """Pass the sticks of MANUAL_CONTROL to the flight stack: x forwards, y and r right, -1000 to 1000; z 0 to 1000, 500
    centred."""
    m = frame.message()
    if _takes_sticks(system, (1, 2, 3)):
        forward, right, up, turn = (math.nan if axis == _NO_AXIS else axis / 1e3 for axis in (m.x, m.y, m.z, m.r))
        system.stack.sticks(right, forward, 2.0 * up - 1.0, turn)


def _override(system: System, link: Link, frame: Frame) -> None:
    """Pass the sticks of RC_CHANNELS_OVERRIDE to the flight stack: roll, pitch, throttle, yaw [us], 1500 centred; low
    pitch is forwards."""
    m = frame.message()
    if _takes_sticks(system, (0, 2, 3)):
        raw = (m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw)
        roll, pitch, up, turn = (math.nan if pulse in _NO_PULSE else (pulse - 1500.0) / 500.0 for pulse in raw)
        system.stack.sticks(roll, -pitch, up, turn)


def _follow(system: System, link: Link, frame: Frame) -> None:
    """Pass the target position of a FOLLOW_TARGET message to the flight stack, for its follow-me mode."""
    m = frame.message()
    system.stack.follow_target(FollowTarget(m.lat * 1e-7, m.lon * 1e-7, m.alt, m.vel))


def _actuators(system: System, link: Link, frame: Frame) -> None:
    """Tell the client, once, that SET_ACTUATOR_CONTROL_TARGET is not supported."""
    system.tell_once("actuators", Text(Severity.WARNING, "SET_ACTUATOR_CONTROL_TARGET is not flown"))


# ---- all else ----


def _heartbeat(system: System, link: Link, frame: Frame) -> None:
    """Pass a ground station's HEARTBEAT to the flight stack, whose data-link failsafe watches for it."""
    if frame.message().type == GROUND_STATION:
        system.stack.heard_ground()


def _ping(system: System, link: Link, frame: Frame) -> None:
    """Answer a PING that is addressed to all systems."""
    message = frame.message()
    if message.target_system == 0:
        link.say(
            "PING",
            time_usec=message.time_usec,
            seq=message.seq,
            target_system=frame.system,
            target_component=frame.component,
        )


def _timesync(system: System, link: Link, frame: Frame) -> None:
    """Answer a TIMESYNC request with the simulated time [ns]."""
    message = frame.message()
    if message.tc1 == 0:
        link.say("TIMESYNC", tc1=int(system.view.seen.time * 1e9), ts1=message.ts1)


def _file(system: System, link: Link, frame: Frame) -> None:
    """Refuse a FILE_TRANSFER_PROTOCOL request with a NAK, so that clients do not wait."""
    message = frame.message()
    request = bytes(message.payload)
    sequence = (int.from_bytes(request[:2], "little") + 1) & 0xFFFF
    why = _NO_FILE if request[3] in _OPENS else _UNKNOWN
    reply = sequence.to_bytes(2, "little") + bytes([request[2], _NAK, 1, request[3], 0, 0, 0, 0, 0, 0, why])
    link.say(
        "FILE_TRANSFER_PROTOCOL",
        target_system=frame.system,
        target_component=frame.component,
        payload=list(reply.ljust(251, b"\0")),
    )


def _logs(system: System, link: Link, frame: Frame) -> None:
    """Answer LOG_REQUEST_LIST with an empty LOG_ENTRY: the vehicle has no onboard logs."""
    link.say("LOG_ENTRY")


def _partner(frame: Frame) -> tuple[int, int]:
    """Return (system id, component id) of the sender of a frame."""
    return frame.system, frame.component


def _set_current(system: System, link: Link, frame: Frame) -> None:
    """Make a mission item the current one, as MISSION_SET_CURRENT asks, and send MISSION_CURRENT."""
    system.stack.set_current(frame.message().seq)
    payload = ENCODERS[LAYOUTS["MISSION_CURRENT"].number](system.view)
    assert payload is not None
    link.put(LAYOUTS["MISSION_CURRENT"].number, payload)
    link.flush()


_HANDLERS: dict[str, Handler] = {
    "HEARTBEAT": _heartbeat,
    "COMMAND_LONG": _command_long,
    "COMMAND_INT": _command_int,
    "SET_MODE": _set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": _local_target,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_target,
    "SET_ATTITUDE_TARGET": _attitude_target,
    "SET_ACTUATOR_CONTROL_TARGET": _actuators,
    "MANUAL_CONTROL": _manual,
    "RC_CHANNELS_OVERRIDE": _override,
    "FOLLOW_TARGET": _follow,
    "PARAM_REQUEST_LIST": lambda system, link, frame: table.send_all(system, link),
    "PARAM_REQUEST_READ": table.send_one,
    "PARAM_SET": table.set_one,
    "MISSION_COUNT": lambda system, link, frame: system.transfers.begin(link, _partner(frame), frame.message()),
    "MISSION_ITEM": lambda system, link, frame: system.transfers.item(link, _partner(frame), frame.message()),
    "MISSION_ITEM_INT": lambda system, link, frame: system.transfers.item(link, _partner(frame), frame.message()),
    "MISSION_REQUEST_LIST": lambda system, link, frame: system.transfers.count(link, _partner(frame), frame.message()),
    "MISSION_REQUEST_INT": lambda system, link, frame: system.transfers.send(
        link, _partner(frame), frame.message(), True
    ),
    "MISSION_REQUEST": lambda system, link, frame: system.transfers.send(link, _partner(frame), frame.message(), False),
    "MISSION_CLEAR_ALL": lambda system, link, frame: system.transfers.clear(link, _partner(frame), frame.message()),
    "MISSION_ACK": lambda system, link, frame: system.transfers.heard_ack(_partner(frame), frame.message()),
    "MISSION_SET_CURRENT": _set_current,
    "MISSION_REQUEST_PARTIAL_LIST": lambda system, link, frame: system.transfers.refuse(
        link, _partner(frame), frame.message()
    ),
    "MISSION_WRITE_PARTIAL_LIST": lambda system, link, frame: system.transfers.refuse(
        link, _partner(frame), frame.message()
    ),
    "REQUEST_DATA_STREAM": requests.data_stream,
    "PING": _ping,
    "TIMESYNC": _timesync,
    "FILE_TRANSFER_PROTOCOL": _file,
    "LOG_REQUEST_LIST": _logs,
}
# Messages of clients that are taken.
HEARD = frozenset(_HANDLERS)
