"""Requests for messages: once, at intervals, and ArduPilot's groups of streams."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from qrsim.links.mavlink.dialect import LAYOUTS, NUMBERS
from qrsim.links.mavlink.frames import Frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import ARDUPILOT, Result
from qrsim.links.mavlink.stack.contracts import Ack, Command
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.targets import available_modes
from qrsim.links.mavlink.telemetry import ENCODERS, sendable

# MAV_CMD.
GET_INTERVAL, SET_INTERVAL, REQUEST_MESSAGE, REQUEST_PROTOCOL, REQUEST_VERSION = 510, 511, 512, 519, 520
_MODES = NUMBERS["AVAILABLE_MODES"]
# Messages of the MAV_DATA_STREAMs of ArduPilot's Copter that there are here; 0 stands for all.
GROUPS: dict[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_PRESSURE"),
    2: ("SYS_STATUS", "MISSION_CURRENT", "GPS_RAW_INT", "FENCE_STATUS", "POSITION_TARGET_GLOBAL_INT"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
    12: ("SYSTEM_TIME", "BATTERY_STATUS", "DISTANCE_SENSOR", "EKF_STATUS_REPORT"),
}
# An ack, and the messages that follow it.
Answer = tuple[Ack, Sequence[tuple[int, bytes]]]


def answer(system: System, link: Link, command: Command) -> Answer | None:
    """Execute a command that requests a message or sets its interval, and return the acknowledgement; None for other
    commands."""
    own = COMMANDS.get(command.id)
    return None if own is None else own(system, link, command)


def data_stream(system: System, link: Link, frame: Frame) -> None:
    """Set message rates as ArduPilot does for REQUEST_DATA_STREAM; ignored with PX4."""
    request = frame.message()
    if system.stack.heartbeat().autopilot != ARDUPILOT or request.start_stop not in (0, 1):
        return
    rate = request.req_message_rate if request.start_stop else 0
    group = request.req_stream_id
    for name in sum(GROUPS.values(), ()) if group == 0 else GROUPS.get(group, ()):
        if sendable(NUMBERS[name], system.view):
            link.streams.set(NUMBERS[name], 1e6 / rate if rate else -1.0, system.tick)


def _number(value: float) -> int:
    """Convert a command parameter, a float, to a message number; -1 if it is not one."""
    return int(value) if math.isfinite(value) and abs(value) < 2**24 else -1


def _set_interval(system: System, link: Link, command: Command) -> Answer:
    """Set the interval of a message on this link, as MAV_CMD_SET_MESSAGE_INTERVAL asks; return the acknowledgement."""
    number, interval = _number(command.params[0]), command.params[1]
    if not sendable(number, system.view) or not math.isfinite(interval):
        return Ack(Result.DENIED), ()
    link.streams.set(number, interval, system.tick)
    return Ack(Result.ACCEPTED), ()


def _get_interval(system: System, link: Link, command: Command) -> Answer:
    """Answer MAV_CMD_GET_MESSAGE_INTERVAL: an acknowledgement and a MESSAGE_INTERVAL message."""
    number = _number(command.params[0])
    interval = link.streams.interval_us(number) if number in ENCODERS else 0
    payload = LAYOUTS["MESSAGE_INTERVAL"].payload(message_id=max(number, 0) & 0xFFFF, interval_us=interval)
    return Ack(Result.ACCEPTED), ((NUMBERS["MESSAGE_INTERVAL"], payload),)


def _request(system: System, link: Link, command: Command) -> Answer:
    """Answer MAV_CMD_REQUEST_MESSAGE: an acknowledgement and the requested message."""
    number = _number(command.params[0])
    if number == _MODES:
        # Of one mode by its number from 1 on, or of all.
        index = command.params[1]
        payloads = available_modes(system.view, 0 if math.isnan(index) else _number(index))
        return Ack(Result.ACCEPTED if payloads else Result.DENIED), [(_MODES, payload) for payload in payloads]
    return _send(system, number)


def _send(system: System, number: int) -> Answer:
    """Return the answer with message ``number``; UNSUPPORTED if the vehicle cannot send it."""
    payload = ENCODERS[number](system.view) if number in ENCODERS else None
    return (Ack(Result.UNSUPPORTED), ()) if payload is None else (Ack(Result.ACCEPTED), ((number, payload),))


def _request_version(system: System, link: Link, command: Command) -> Answer:
    """Answer REQUEST_AUTOPILOT_CAPABILITIES as PX4 or ArduPilot does: with AUTOPILOT_VERSION, or by a refusal."""
    # PX4's MavlinkReceiver does not look at the parameter, ArduPilot wants 1.
    if system.stack.heartbeat().autopilot == ARDUPILOT and command.params[0] != 1.0:
        return Ack(Result.FAILED), ()
    return _send(system, NUMBERS["AUTOPILOT_VERSION"])


def _request_protocol(system: System, link: Link, command: Command) -> Answer:
    """Answer REQUEST_PROTOCOL_VERSION; with ArduPilot it is unsupported."""
    if system.stack.heartbeat().autopilot == ARDUPILOT:
        return Ack(Result.UNSUPPORTED), ()
    return _send(system, NUMBERS["PROTOCOL_VERSION"])


COMMANDS: dict[int, Callable[[System, Link, Command], Answer]] = {
    SET_INTERVAL: _set_interval,
    GET_INTERVAL: _get_interval,
    REQUEST_MESSAGE: _request,
    REQUEST_VERSION: _request_version,
    REQUEST_PROTOCOL: _request_protocol,
}
