"""Packets of Betaflight's SITL, little endian without padding (its target.h), and its words for why it does not arm."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

STATE = struct.Struct("<18d")
STICKS = struct.Struct("<d16H")
MOTORS = struct.Struct("<4f")
STATUS_EX = 150
# Bit i of MSP_STATUS_EX's flags, in the words of its command line (fc/runtime_config.c of firmware 4.6).
REASONS = (
    "NOGYRO", "FAILSAFE", "RXLOSS", "NOT_DISARMED", "BOXFAILSAFE", "RUNAWAY", "CRASH", "THROTTLE", "ANGLE",
    "BOOTGRACE", "NOPREARM", "LOAD", "CALIB", "CLI", "CMS", "BST", "MSP", "PARALYZE", "GPS", "RESCUE_SW",
    "DSHOT_TELEM", "REBOOT_REQD", "DSHOT_BBANG", "NO_ACC_CAL", "MOTOR_PROTO", "FLIP_SWITCH", "ALT_HOLD_SW",
    "POS_HOLD_SW", "ARM_SWITCH",
)  # fmt: skip
# Of the standard atmosphere: at 0 m [Pa], its lapse [1/m] and exponent.
PRESSURE_PA, LAPSE, EXPONENT = 101325.0, 2.25577e-5, 5.25588


@dataclass(frozen=True)
class Sensed:
    """What the firmware is told of its vehicle.

    Attributes:
        rates_body: p, q, r [rad/s], FRD.
        specific_force: [m/s^2], FRD; at rest (0, 0, -9.81).
        attitude: roll, pitch, yaw [rad].
        velocity_ned: [m/s].
        place: latitude, longitude [deg], altitude above mean sea level [m].
        pressure: [Pa].
    """

    rates_body: Sequence[float] = (0.0, 0.0, 0.0)
    specific_force: Sequence[float] = (0.0, 0.0, -9.80665)
    attitude: Sequence[float] = (0.0, 0.0, 0.0)
    velocity_ned: Sequence[float] = (0.0, 0.0, 0.0)
    place: Sequence[float] = (0.0, 0.0, 0.0)
    pressure: float = PRESSURE_PA


def pressure_at(height: float) -> float:
    """Return the pressure [Pa] of the standard atmosphere at a height [m]."""
    return PRESSURE_PA * max(1.0 - LAPSE * height, 0.0) ** EXPONENT


def state_packet(time: float, sensed: Sensed) -> bytes:
    """Encode sensor readings at ``time`` [s] as the state packet that Betaflight's simulator build (SITL) reads.

    The firmware changes the signs of q and r, and of all of the acceleration. It computes roll, pitch and yaw from the
    quaternion as from one of FRD to NED, and turns the sign of pitch (imuComputeRotationMatrix of its simulator).
    """
    p, q, r = sensed.rates_body
    x, y, z = sensed.specific_force
    north, east, down = sensed.velocity_ned
    latitude, longitude, height = sensed.place
    roll, pitch, yaw = (0.5 * angle for angle in sensed.attitude)
    cr, sr, cp, sp, cy, sy = *_cos_sin(roll), *_cos_sin(pitch), *_cos_sin(yaw)
    quaternion = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return STATE.pack(
        time, p, q, r, -x, y, z, *quaternion, east, north, -down, longitude, latitude, height, sensed.pressure
    )


def _cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle [rad]."""
    return math.cos(angle), math.sin(angle)


def sticks_packet(time: float, channels: Sequence[int]) -> bytes:
    """Encode up to 16 stick channels, 1000 to 2000 (roll, pitch, throttle, yaw, switches), as Betaflight's packet for
    ``time`` [s]."""
    return STICKS.pack(time, *channels, *([1500] * (16 - len(channels))))


def msp_request(command: int) -> bytes:
    """Return a MultiWii Serial Protocol (MSP, version 1) request, without payload, for a command number."""
    return b"$M<" + bytes([0, command, command])


def msp_content(received: bytes) -> bytes | None:
    """Return the payload of the first complete MSP reply in received bytes; None if there is none yet."""
    begin = received.find(b"$M>")
    if begin < 0 or len(received) < begin + 6 or len(received) < begin + 6 + received[begin + 3]:
        return None
    return received[begin + 5 : begin + 5 + received[begin + 3]]


def arming_reasons(content: bytes) -> list[str]:
    """Return the reasons why Betaflight does not arm, decoded from the payload of MSP_STATUS_EX.

    After 15 bytes there is a count of bytes of modes, these, a count of flags and 32 bits of them.
    """
    place = 16 + content[15]
    count, flags = struct.unpack_from("<BI", content, place)
    return [REASONS[bit] if bit < len(REASONS) else f"flag {bit}" for bit in range(count) if flags >> bit & 1]
