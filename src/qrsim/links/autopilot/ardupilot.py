"""The JSON interface of ArduPilot's SITL, as its description has it: packets of servos in, lines of JSON out.

Source: ArduPilot, libraries/SITL/examples/JSON/readme.md. All numbers of a packet are little endian without padding.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from qrsim.links.autopilot.packets import Sensed

FEW, MANY = struct.Struct("<HHI16H"), struct.Struct("<HHI32H")
# By the first number of a packet: with 16 channels, and with 32 (SERVO_32_ENABLE).
LAYOUTS = {18458: FEW, 29569: MANY}
# Of a motor's pulse [us]: still, and at its largest speed.
LEAST_US, MOST_US = 1000.0, 2000.0


@dataclass(frozen=True)
class Servos:
    """What ArduPilot sends once a step.

    Attributes:
        rate: steps a second that it would like [Hz].
        frame: number of the step; from 0 on again after it has been started anew.
        pulses: of its 16 or 32 channels [us]; 0 for one that is not driven.
    """

    rate: int
    frame: int
    pulses: tuple[int, ...]


def servos(packet: bytes) -> Servos | None:
    """Decode ArduPilot's servo packet (rate, frame counter, PWM pulses [us]); return None for other packets."""
    if len(packet) < 2:
        return None
    layout = LAYOUTS.get(int.from_bytes(packet[:2], "little"))
    if layout is None or len(packet) != layout.size:
        return None
    _, rate, frame, *pulses = layout.unpack(packet)
    return Servos(rate, frame, tuple(pulses))


def speeds(pulses: Sequence[int], count: int) -> list[float]:
    """Convert PWM pulses [us] of motors 1 to ``count`` to speeds as fractions of the maximum; a channel without pulses
    (0 us) gives 0."""
    span = MOST_US - LEAST_US
    return [min(max((pulse - LEAST_US) / span, 0.0), 1.0) for pulse in pulses[:count]]


def answer(time: float, sensed: Sensed, position_ned: Sequence[float]) -> bytes:
    """Return the JSON line with the vehicle's state that ArduPilot's simulator interface expects after each servo
    packet.

    Args:
        time: since the start of the flight [s].
        sensed: rates, specific force, attitude and velocity of the vehicle.
        position_ned: from where it was at first [m].
    """
    said = {
        "timestamp": time,
        "imu": {"gyro": [*sensed.rates_body], "accel_body": [*sensed.specific_force]},
        "position": [*position_ned],
        "velocity": [*sensed.velocity_ned],
        "attitude": [*sensed.attitude],
    }
    return b"\n" + json.dumps(said, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"
