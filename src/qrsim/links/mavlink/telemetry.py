"""Payloads of the messages that vehicles send of themselves, from estimates and readings."""

from __future__ import annotations

import math
from collections.abc import Callable

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.stack.codes import ARDUPILOT, Sensor
from qrsim.links.mavlink.stack.contracts import NAN
from qrsim.links.mavlink.surroundings import adsb_vehicle, obstacle_distance, optical_flow_rad
from qrsim.links.mavlink.targets import (
    attitude_target,
    autopilot_version,
    available_modes_monitor,
    current_mode,
    gps_global_origin,
    orbit_execution_status,
    position_target_global_int,
    position_target_local_ned,
    protocol_version,
)
from qrsim.links.mavlink.view import View
from qrsim.links.shared import sight as s

# MAVLink 2.
PROTOCOL = 3
GRAVITY = 9.80665
# ESTIMATOR_STATUS: attitude, both velocities, horizontal positions relative and absolute, vertical one; uninitialized.
_ESTIMATES, _NO_ESTIMATE = 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x20 | 0x100 | 0x200, 0x400
# MAV_ODOM and MAV_ESTIMATOR_TYPE of a filter with GNSS; frames local NED and body FRD.
LOCAL_NED, BODY_FRD, GPS_INS = 1, 12, 5
_UINT16, _INT16, _GPS = 0xFFFF, 0x7FFF, int(Sensor.GPS)

_STRUCT = {name: layout.struct.pack for name, layout in LAYOUTS.items()}


Payload = bytes | None


def bounded(value: float, scale: float, low: int, high: int) -> int:
    """Return ``value * scale`` rounded and clipped to [low, high]; 0 for NaN."""
    if value != value:
        return 0
    return int(min(max(round(value * scale), low), high))


def _short(value: float, scale: float) -> int:
    """Return ``value * scale`` rounded and clipped to the range of an int16; 0 for NaN."""
    return bounded(value, scale, -32768, 32767)


def _unsigned(value: float, scale: float, unknown: int = _UINT16, most: int = 65534) -> int:
    """Return ``value * scale`` rounded and clipped to [0, most]; ``unknown`` for NaN."""
    return unknown if value != value else int(min(max(round(value * scale), 0), most))


def heartbeat(v: View) -> Payload:
    """Return the payload of HEARTBEAT."""
    beat = v.stack.heartbeat()
    return _STRUCT["HEARTBEAT"](
        beat.custom_mode, beat.mav_type, beat.autopilot, beat.base_mode, beat.system_status, PROTOCOL
    )


def sys_status(v: View) -> Payload:
    """Return the payload of SYS_STATUS."""
    health, seen = v.stack.health(), v.seen
    voltage = _unsigned(seen.voltage, 1e3)
    remaining = -1 if seen.charge != seen.charge else bounded(seen.charge, 100.0, 0, 100)
    present, enabled = seen.present | health.present, seen.present | health.enabled
    healthy = seen.healthy | health.healthy
    return _STRUCT["SYS_STATUS"](present, enabled, healthy, v.load, voltage, -1, 0, 0, 0, 0, 0, 0, remaining, 0, 0, 0)


def system_time(v: View) -> Payload:
    """Return the payload of SYSTEM_TIME, with the date and time of the scenario."""
    return _STRUCT["SYSTEM_TIME"](int((v.unix + v.seen.time) * 1e6), v.boot_ms)


def gps_raw_int(v: View) -> Payload:
    """Return the payload of GPS_RAW_INT, with the receiver's reported accuracies."""
    row = v.row
    if not v.seen.present & _GPS:
        return None
    fix = v.seen.fix_type
    place, height = (0, 0, 0), 0
    if fix >= 3 and row[s.FIX_PLACE] == row[s.FIX_PLACE]:
        place = (round(row[s.FIX_PLACE] * 1e7), round(row[s.FIX_PLACE + 1] * 1e7), round(v.fix_altitude * 1e3))
        height = round(row[s.FIX_PLACE + 2] * 1e3)
    north, east = row[s.FIX_VELOCITY], row[s.FIX_VELOCITY + 1]
    moving = north == north and east == east
    speed = math.hypot(north, east) if moving else NAN
    course = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000 if moving else _UINT16
    satellites = row[s.SATELLITES]
    return _STRUCT["GPS_RAW_INT"](
        int(v.fix_time * 1e6 + 0.5), *place, _unsigned(row[s.HDOP], 100.0), _unsigned(row[s.VDOP], 100.0),
        _unsigned(speed, 100.0), course, fix, 255 if satellites != satellites else min(int(satellites), 254), height,
        _accuracy(row[s.HORIZONTAL]), _accuracy(row[s.VERTICAL]), _accuracy(row[s.SPEED]), 0, 0,
    )  # fmt: skip


def _accuracy(value: float) -> int:
    """Return an accuracy [m or m/s] in thousandths, 0 for NaN."""
    return 0 if value != value else int(min(round(value * 1e3), 0xFFFFFFFF))


def attitude(v: View) -> Payload:
    """Return the payload of ATTITUDE."""
    if not v.seen.valid:
        return None
    return _STRUCT["ATTITUDE"](v.boot_ms, *v.seen.attitude, *v.seen.rates)


def attitude_quaternion(v: View) -> Payload:
    """Return the payload of ATTITUDE_QUATERNION."""
    if not v.seen.valid:
        return None
    return _STRUCT["ATTITUDE_QUATERNION"](
        v.boot_ms, *v.row[s.QUATERNION : s.QUATERNION + 4], *v.seen.rates, 0.0, 0.0, 0.0, 0.0
    )


def local_position_ned(v: View) -> Payload:
    """Return the payload of LOCAL_POSITION_NED, from the origin of the vehicle's local frame."""
    if not v.seen.valid:
        return None
    return _STRUCT["LOCAL_POSITION_NED"](v.boot_ms, *v.local(v.seen.position_ned), *v.seen.velocity_ned)


def global_position_int(v: View) -> Payload:
    """Return the payload of GLOBAL_POSITION_INT."""
    seen = v.seen
    if not seen.valid:
        return None
    north, east, down = seen.velocity_ned
    heading = round(math.degrees(seen.attitude[2]) * 100.0) % 36000
    return _STRUCT["GLOBAL_POSITION_INT"](
        v.boot_ms,
        round(seen.latitude * 1e7),
        round(seen.longitude * 1e7),
        round(seen.altitude * 1e3),
        round((seen.altitude - v.home_altitude) * 1e3),
        _short(north, 100.0),
        _short(east, 100.0),
        _short(down, 100.0),
        heading,
    )


def vfr_hud(v: View) -> Payload:
    """Return the payload of VFR_HUD; without an airspeed sensor its airspeed is the ground speed."""
    seen = v.seen
    if not seen.valid:
        return None
    north, east, down = seen.velocity_ned
    ground = math.hypot(north, east)
    airspeed = v.row[s.AIRSPEED]
    heading = round(math.degrees(seen.attitude[2])) % 360
    return _STRUCT["VFR_HUD"](
        airspeed if airspeed == airspeed else ground, ground, seen.altitude, -down, heading, throttle(v)
    )


def throttle(v: View) -> int:
    """Return the commanded thrust [%]; the hover thrust while a path or velocity is flown."""
    if v.order is None or not v.stack.armed:
        return 0
    if v.order.kind == "track":
        # What an aeroplane's throttle is, its controller knows alone.
        return 0
    if v.order.kind == "attitude":
        return bounded(v.stack.thrust_of(v.order.numbers[3]), 100.0, 0, 100)
    return bounded(v.stack.parameters["MPC_THR_HOVER"], 100.0, 0, 100)


def altitude(v: View) -> Payload:
    """Return the payload of ALTITUDE, with the height above home as height above terrain."""
    seen = v.seen
    if not seen.valid:
        return None
    relative = seen.altitude - v.home_altitude
    return _STRUCT["ALTITUDE"](
        v.boot_us, seen.altitude, seen.altitude, -v.local(seen.position_ned)[2], relative, NAN, v.row[s.RANGE]
    )


def highres_imu(v: View) -> Payload:
    """Return the payload of HIGHRES_IMU; ``fields_updated`` marks the sensors that the vehicle has."""
    row = v.row
    updated = 0
    for bits, column in ((0x7, s.FORCE), (0x38, s.RATES), (0x1C0, s.FIELD)):
        updated |= bits if row[column] == row[column] else 0
    for bit, column in ((0x200, s.PRESSURE), (0x400, s.DIFFERENTIAL), (0x800, s.HEIGHT), (0x1000, s.TEMPERATURE)):
        updated |= bit if row[column] == row[column] else 0
    if not updated & 0x3F:
        return None
    # Microtesla are 0.01 gauss, pascals 0.01 mbar.
    numbers = (
        *row[s.FORCE : s.FORCE + 3],
        *row[s.RATES : s.RATES + 3],
        0.01 * row[s.FIELD],
        0.01 * row[s.FIELD + 1],
        0.01 * row[s.FIELD + 2],
        0.01 * row[s.PRESSURE],
        0.01 * row[s.DIFFERENTIAL],
        row[s.HEIGHT],
        row[s.TEMPERATURE] - 273.15,
    )
    return _STRUCT["HIGHRES_IMU"](v.boot_us, *[x if x == x else 0.0 for x in numbers], updated, 0)


def _imu_numbers(row: list[float]) -> tuple[int, ...] | None:
    """Return acceleration [milli-g], rates [mrad/s] and field [mgauss] as SCALED_IMU has them; None without an IMU."""
    force, rates, field = (row[at : at + 3] for at in (s.FORCE, s.RATES, s.FIELD))
    if force[0] != force[0] and rates[0] != rates[0]:
        return None
    return (
        *(_short(x, 1e3 / GRAVITY) for x in force),
        *(_short(x, 1e3) for x in rates),
        *(_short(x, 10.0) for x in field),
    )


def scaled_imu(v: View) -> Payload:
    """Return the payload of SCALED_IMU; None without an IMU."""
    numbers = _imu_numbers(v.row)
    return None if numbers is None else _STRUCT["SCALED_IMU"](v.boot_ms, *numbers, 0)


def raw_imu(v: View) -> Payload:
    """Return the payload of RAW_IMU, in the units of SCALED_IMU; None without an IMU."""
    numbers = _imu_numbers(v.row)
    return None if numbers is None else _STRUCT["RAW_IMU"](v.boot_us, *numbers, 0, 0)


def scaled_pressure(v: View) -> Payload:
    """Return the payload of SCALED_PRESSURE; None without a barometer that reads a pressure."""
    pressure, differential, temperature = (v.row[at] for at in (s.PRESSURE, s.DIFFERENTIAL, s.TEMPERATURE))
    if pressure != pressure:
        return None
    return _STRUCT["SCALED_PRESSURE"](
        v.boot_ms,
        0.01 * pressure,
        0.0 if differential != differential else 0.01 * differential,
        _short(temperature - 273.15, 100.0),
        0,
    )


def distance_sensor(v: View) -> Payload:
    """Return the payload of DISTANCE_SENSOR; None without a rangefinder that points down."""
    distance = v.row[s.RANGE]
    if distance != distance:
        return None
    return _STRUCT["DISTANCE_SENSOR"](
        v.boot_ms, 0, _UINT16, _unsigned(distance, 100.0), 0, 0, 25, 255, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    )


def odometry(v: View) -> Payload:
    """Return the payload of ODOMETRY: position NED, velocity in body axes, and the estimator's variances if known."""
    seen, row = v.seen, v.row
    if not seen.valid:
        return None
    w, x, y, z = row[s.QUATERNION : s.QUATERNION + 4]
    north, east, down = seen.velocity_ned
    # Velocity turned into body axes by the conjugate of the quaternion.
    tx, ty, tz = 2.0 * (z * east - y * down), 2.0 * (x * down - z * north), 2.0 * (y * north - x * east)
    forward = north + w * tx + z * ty - y * tz
    right = east + w * ty + x * tz - z * tx
    below = down + w * tz + y * tx - x * ty
    pose = _variances(row[s.STD_POSITION : s.STD_POSITION + 3], row[s.STD_ATTITUDE : s.STD_ATTITUDE + 3])
    speed = _variances(row[s.STD_VELOCITY : s.STD_VELOCITY + 3], [NAN, NAN, NAN])
    return _STRUCT["ODOMETRY"](
        v.boot_us, *v.local(seen.position_ned), w, x, y, z, forward, right, below, *seen.rates, *pose, *speed,
        LOCAL_NED, BODY_FRD, 0, GPS_INS, 0,
    )  # fmt: skip


# Where the diagonal is in the 21 numbers of an upper triangle of 6 x 6.
DIAGONAL = (0, 6, 11, 15, 18, 20)


def _variances(first: list[float], second: list[float]) -> list[float]:
    """Return the upper triangle (21,) of a diagonal covariance from two lists of standard deviations."""
    found = [0.0] * 21
    for at, std in zip(DIAGONAL, (*first, *second), strict=True):
        found[at] = std * std
    return found


def battery_status(v: View) -> Payload:
    """Return the payload of BATTERY_STATUS; None for a battery that does not drain."""
    seen = v.seen
    if seen.charge != seen.charge:
        return None
    # MAV_BATTERY_CHARGE_STATE by the thresholds of the stack: 1 ok, 2 low, 3 critical, 4 emergency.
    names = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
    state = 1 + sum(seen.charge <= v.stack.parameters[name] for name in names)
    voltages = [_unsigned(seen.voltage, 1e3)] + [_UINT16] * 9
    # Type 1 is lithium polymer.
    return _STRUCT["BATTERY_STATUS"](
        -1, -1, _INT16, *voltages, -1, 0, 0, 1, bounded(seen.charge, 100.0, 0, 100), 0, state, 0, 0, 0, 0, 0, 0
    )


def estimator_status(v: View) -> Payload:
    """Return the payload of ESTIMATOR_STATUS: flags, and the estimator's accuracies if known."""
    row = v.row
    north, east, down = row[s.STD_POSITION : s.STD_POSITION + 3]
    flags = _ESTIMATES if v.seen.valid else 0
    return _STRUCT["ESTIMATOR_STATUS"](v.boot_us, NAN, NAN, NAN, NAN, NAN, NAN, math.hypot(north, east), down, flags)


def ekf_status_report(v: View) -> Payload:
    """Return the payload of ArduPilot's EKF_STATUS_REPORT, with the flags of ESTIMATOR_STATUS; variances are 0."""
    if v.stack.heartbeat().autopilot != ARDUPILOT:
        return None
    return LAYOUTS["EKF_STATUS_REPORT"].payload(flags=_ESTIMATES if v.seen.valid else _NO_ESTIMATE)


def wind_cov(v: View) -> Payload:
    """Return the payload of WIND_COV; None for an estimator that does not estimate the wind."""
    north, east = v.row[s.WIND_NORTH], v.row[s.WIND_EAST]
    if north != north:
        return None
    return _STRUCT["WIND_COV"](v.boot_us, north, east, 0.0, NAN, NAN, v.seen.altitude, NAN, NAN)


def home_position(v: View) -> Payload:
    """Return the payload of HOME_POSITION; None before there is a home."""
    home = v.stack.home
    if home is None:
        return None
    half = 0.5 * home.yaw
    return _STRUCT["HOME_POSITION"](
        round(home.latitude * 1e7), round(home.longitude * 1e7), round(home.altitude * 1e3),
        *v.local(home.position_ned), math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0, v.boot_us,
    )  # fmt: skip


def extended_sys_state(v: View) -> Payload:
    """Return the payload of EXTENDED_SYS_STATE."""
    return _STRUCT["EXTENDED_SYS_STATE"](0, int(v.stack.heartbeat().landed))


def fence_status(v: View) -> Payload:
    """Return the payload of FENCE_STATUS, without its breach mitigation."""
    status = v.stack.fence()
    milliseconds = int(status.time * 1e3 + 0.5) & 0xFFFFFFFF
    return _STRUCT["FENCE_STATUS"](milliseconds, min(status.count, _UINT16), status.breached, status.breach, 0)


def mission_current(v: View) -> Payload:
    """Return the payload of MISSION_CURRENT."""
    status = v.stack.mission()
    return _STRUCT["MISSION_CURRENT"](status.seq, status.total, int(status.state), 1 if status.in_mode else 2)


def hil_state_quaternion(v: View) -> Payload:
    """Return the payload of HIL_STATE_QUATERNION with the true state; None unless the server sends truth."""
    if v.truth is None:
        return None
    quaternion, rates, (latitude, longitude, above) = v.truth[:4], v.truth[4:7], v.truth[7:10]
    velocity, airspeed, force = v.truth[10:13], v.truth[13], v.truth[14:17]
    speed = _unsigned(airspeed, 100.0)
    return _STRUCT["HIL_STATE_QUATERNION"](
        v.boot_us, *quaternion, *rates, round(latitude * 1e7), round(longitude * 1e7), round(above * 1e3),
        *(_short(x, 100.0) for x in velocity), speed, speed, *(_short(x, 1e3 / GRAVITY) for x in force),
    )  # fmt: skip


Encoder = Callable[[View], Payload]
ENCODERS: dict[int, Encoder] = {
    LAYOUTS[function.__name__.upper()].number: function
    for function in (
        heartbeat, sys_status, system_time, gps_raw_int, attitude, attitude_quaternion, local_position_ned,
        global_position_int, vfr_hud, altitude, highres_imu, scaled_imu, raw_imu, scaled_pressure, distance_sensor,
        odometry, battery_status, estimator_status, wind_cov, home_position, extended_sys_state, mission_current,
        fence_status, position_target_local_ned, autopilot_version, hil_state_quaternion, attitude_target,
        position_target_global_int, gps_global_origin, protocol_version, orbit_execution_status, current_mode,
        available_modes_monitor, obstacle_distance, optical_flow_rad, adsb_vehicle, ekf_status_report,
    )
}  # fmt: skip


def sendable(number: int, view: View) -> bool:
    """Return whether the vehicle can send the message with this number, now or later in the flight."""
    if number not in ENCODERS:
        return False
    later: tuple[object, ...] = (
        home_position,
        position_target_local_ned,
        position_target_global_int,
        attitude_target,
        orbit_execution_status,
    )
    encoder = ENCODERS[number]
    return encoder in later or encoder(view) is not None
