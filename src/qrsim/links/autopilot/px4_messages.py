"""Messages of PX4's simulator interface as bytes, without a socket.

Sources: PX4-Autopilot, src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp for units and meaning, which in
HIL_GPS (cm of accuracy) and HIL_STATE_QUATERNION (mm/s^2) differ from the message set's; mavlink.io for layouts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from qrsim.links.mavlink.dialect import LAYOUTS

SENSOR, GPS, FLOW, DISTANCE, TRUTH, CONTROLS, COMMAND_LONG, HEARTBEAT = (
    LAYOUTS[name].number
    for name in (
        "HIL_SENSOR",
        "HIL_GPS",
        "HIL_OPTICAL_FLOW",
        "DISTANCE_SENSOR",
        "HIL_STATE_QUATERNION",
        "HIL_ACTUATOR_CONTROLS",
        "COMMAND_LONG",
        "HEARTBEAT",
    )
)
_PACK = {name: LAYOUTS[name].struct.pack for name in LAYOUTS}
_CONTROLS = LAYOUTS["HIL_ACTUATOR_CONTROLS"].struct
# Groups of HIL_SENSOR.fields_updated. PX4 takes a group with all of its bits only (SimulatorMavlink.hpp).
ACCEL_BITS, GYRO_BITS, MAG_BITS, BARO_BITS, AIRSPEED_BITS = 0x0007, 0x0038, 0x01C0, 0x1A00, 0x0400
# PX4 converts both to int16 without a check, at 2048 per g and 2000 deg/s per 32768.
MOST_FORCE, MOST_RATE = 32767 / 2048 * 9.80665, math.radians(2000.0) * 32767 / 32768
ARMED, LOCKSTEP, OUTPUTS = 0x80, 0x01, 16
# Below this speed over the ground a receiver gives no course [m/s].
SLOWEST_COURSE = 0.3
# MAV_SENSOR_ROTATION of the axes of the body, of which PX4 takes PITCH_180 for backward.
ROTATIONS = {"forward": 0, "right": 2, "backward": 12, "left": 6, "up": 24, "down": 25}


@dataclass(frozen=True)
class Controls:
    """Outputs of PX4.

    Attributes:
        time_usec: PX4's clock, the time of the sensors that they follow from [us].
        outputs: 16 numbers, 0 to 1 for motors and -1 to 1 for servos; all 0 unless armed.
        armed: whether motors may turn.
        lockstep: whether this build waits for the simulator's clock.
    """

    time_usec: int = 0
    outputs: tuple[float, ...] = (0.0,) * OUTPUTS
    armed: bool = False
    lockstep: bool = True


def controls(payload: bytes) -> Controls:
    """Decode the payload of HIL_ACTUATOR_CONTROLS; trailing zeros may be missing, as in MAVLink 2."""
    time_usec, flags, *outputs, mode = _CONTROLS.unpack(payload[: _CONTROLS.size].ljust(_CONTROLS.size, b"\0"))
    return Controls(time_usec, tuple(outputs), bool(mode & ARMED), bool(flags & LOCKSTEP))


def speeds(wanted: Controls, count: int) -> tuple[list[float], int]:
    """Convert PX4's outputs (``wanted``) to speeds of motors 1 to ``count``, 0 to 1; also return how many were not
    within -1 to 1.

    A motor stops while PX4 is disarmed, and where its output is NaN.
    """
    if not wanted.armed:
        return [0.0] * count, 0
    odd = sum(not -1.0 <= output <= 1.0 for output in wanted.outputs[:count])
    return [min(max(output, 0.0), 1.0) if output == output else 0.0 for output in wanted.outputs[:count]], odd


def hil_sensor(
    time_usec: int,
    rates: Sequence[float] | None = None,
    force: Sequence[float] | None = None,
    field: Sequence[float] | None = None,
    air: Sequence[float] | None = None,
    differential: float | None = None,
    id: int = 0,
) -> bytes:
    """Return the payload of HIL_SENSOR for the sensors with new readings; sensors that are None are marked as not
    updated.

    Args:
        time_usec: boot clock [us], above 0.
        rates: p, q, r [rad/s], FRD.
        force: specific force [m/s^2], FRD.
        field: magnetic field [uT], FRD.
        air: static pressure [Pa], temperature [K], pressure altitude [m].
        differential: pressure of the pitot tube [Pa].
        id: 0 is the IMU that moves PX4's clock.
    """
    bits = 0
    numbers = [0.0] * 13
    if force is not None:
        bits |= ACCEL_BITS
        numbers[:3] = [min(max(axis, -MOST_FORCE), MOST_FORCE) for axis in force]
    if rates is not None:
        bits |= GYRO_BITS
        numbers[3:6] = [min(max(axis, -MOST_RATE), MOST_RATE) for axis in rates]
    if field is not None:
        bits |= MAG_BITS
        numbers[6:9] = [0.01 * axis for axis in field]  # gauss
    if air is not None:
        bits |= BARO_BITS
        numbers[9], numbers[11], numbers[12] = 0.01 * air[0], air[2], air[1] - 273.15  # hPa, m, deg C
    if differential is not None:
        bits |= AIRSPEED_BITS
        numbers[10] = 0.01 * differential
    return _PACK["HIL_SENSOR"](time_usec, *numbers, bits, id)


@dataclass(frozen=True)
class Fix:
    """A report of a GNSS receiver.

    Attributes:
        type: 0 or 1 for none, 2, 3 and above as GPS_FIX_TYPE has them.
        latitude, longitude: [deg].
        altitude: above mean sea level [m].
        horizontal, vertical: accuracies [m].
        velocity_ned: [m/s].
        satellites: number used.
    """

    type: int
    latitude: float
    longitude: float
    altitude: float
    horizontal: float
    vertical: float
    velocity_ned: Sequence[float]
    satellites: int


def hil_gps(unix_usec: int, fix: Fix | None, id: int = 0) -> bytes:
    """Return the payload of HIL_GPS at a time [us since 1970, UTC]; ``fix`` is None for a receiver without a fix."""
    if fix is None or fix.type < 2:
        return _PACK["HIL_GPS"](unix_usec, 0, 0, 0, 65535, 65535, 0, 0, 0, 0, 65535, 0, 0, id, 0)
    north, east, down = fix.velocity_ned
    ground = math.hypot(north, east)
    course = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000 if ground >= SLOWEST_COURSE else 65535
    return _PACK["HIL_GPS"](
        unix_usec,
        round(fix.latitude * 1e7),
        round((fix.longitude + 180.0) % 360.0 * 1e7) - 1_800_000_000,
        round(fix.altitude * 1e3),
        _clipped_integer(fix.horizontal * 100.0, 1, 65534),
        _clipped_integer(fix.vertical * 100.0, 1, 65534),
        _clipped_integer(ground * 100.0, 0, 65534),
        *(_clipped_integer(axis * 100.0, -32767, 32767) for axis in (north, east, down)),
        course,
        fix.type,
        min(max(fix.satellites, 0), 254),
        id,
        0,
    )


def distance_sensor(time_usec: int, distance: float, low: float, high: float, axis: str = "down") -> bytes:
    """Return the payload of DISTANCE_SENSOR for a laser rangefinder; a distance [m] of NaN is sent with signal quality
    1, the worst.

    Args:
        time_usec: boot clock [us].
        distance, low, high: measured, and the limits of the sensor [m].
        axis: of the body along which it looks.
    """
    known = distance == distance
    centimetres = [_clipped_integer(metres * 100.0, 0, 65535) for metres in (low, high, distance if known else high)]
    return _PACK["DISTANCE_SENSOR"](
        time_usec // 1000 & 0xFFFFFFFF, *centimetres, 0, 0, ROTATIONS[axis], 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        100 if known else 1,
    )  # fmt: skip


def optical_flow(
    time_usec: int, period_usec: int, flow: Sequence[float], turned: Sequence[float], quality: float, distance: float
) -> bytes:
    """Return the payload of HIL_OPTICAL_FLOW at a time [us]: flow and rotation [rad] over a period [us]; unknown flow
    (NaN) has quality 0.

    Args:
        time_usec, period_usec: boot clock, and time since the last reading [us].
        flow: angles about x and y in that time [rad].
        turned: rotation about all axes in that time [rad].
        quality: 0 to 1.
        distance: to the ground [m]; NaN: unknown.
    """
    known = flow[0] == flow[0] and flow[1] == flow[1]
    return _PACK["HIL_OPTICAL_FLOW"](
        time_usec, period_usec, *(flow if known else (0.0, 0.0)), *turned, 0,
        distance if distance == distance else -1.0, 0, 0, _clipped_integer(quality * 255.0, 0, 255) if known else 0,
    )  # fmt: skip


def true_state(
    time_usec: int,
    quaternion: Sequence[float],
    rates: Sequence[float],
    place: Sequence[float],
    velocity_ned: Sequence[float],
    airspeed: float,
    acceleration_ned: Sequence[float],
) -> bytes:
    """Return the payload of HIL_STATE_QUATERNION, the true state for PX4's logs.

    Args:
        time_usec: boot clock [us].
        quaternion: w, x, y, z, from FRD to NED.
        rates: p, q, r [rad/s].
        place: latitude, longitude [deg], altitude above mean sea level [m].
        velocity_ned: [m/s].
        airspeed: true [m/s].
        acceleration_ned: coordinate acceleration [m/s^2], which PX4 reads in NED and mm/s^2.
    """
    speed = _clipped_integer(airspeed * 100.0, 0, 65535)
    return _PACK["HIL_STATE_QUATERNION"](
        time_usec, *quaternion, *rates, round(place[0] * 1e7), round(place[1] * 1e7), round(place[2] * 1e3),
        *(_clipped_integer(axis * 100.0, -32768, 32767) for axis in velocity_ned), speed, speed,
        *(_clipped_integer(axis * 1000.0, -32768, 32767) for axis in acceleration_ned),
    )  # fmt: skip


def _clipped_integer(value: float, low: int, high: int) -> int:
    """Return a number rounded and clipped to [low, high]; ``high`` for NaN and infinity."""
    return round(min(max(value, low), high)) if math.isfinite(value) else high
