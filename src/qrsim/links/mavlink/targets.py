"""Payloads of the messages that say what a vehicle flies by, where its frame begins, and what it speaks."""

from __future__ import annotations

import math

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.stack.codes import ARDUPILOT, PX4
from qrsim.links.mavlink.view import View

# MAV_FRAME of local NED, and of latitude and longitude with altitudes above mean sea level.
_LOCAL_NED, _GLOBAL_INT = 1, 5
# Left out of a set-point: a yaw rate; of a velocity also position and acceleration; of an attitude its rates.
_PATH, _VELOCITY, _NO_RATES = 0x800, 0x9C7, 0x7
# Versions of MAVLink, in hundredths, as PX4 states them.
_VERSION, _OLDEST, _NEWEST = 200, 100, 200
# MAV_PROTOCOL_CAPABILITY: floats and integers of missions and commands, bytewise parameters, set-points local, global
# and of attitude, MAVLink 2, fence, rally; termination. No files.
CAPABILITIES = 0x1 | 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x100 | 0x800 | 0x2000 | 0x4000 | 0x8000
# How integer parameters travel: as their bytes, or, of ArduPilot, as a float of the same value.
BYTEWISE, CAST = 0x10, 0x20000
ARDUPILOT_VERSION = 4 << 24 | 5 << 16 | 0 << 8 | 255
# A PX4 of 1.15.0, whose modes and parameters these are, as a released version.
FLIGHT_VERSION = 1 << 24 | 15 << 16 | 0 << 8 | 255
_STRUCT = {name: layout.struct.pack for name, layout in LAYOUTS.items()}
Payload = bytes | None


def _motion(v: View) -> tuple[int, tuple[float, ...]] | None:
    """Return the order's type mask, and position, velocity, acceleration NED and heading; None for other orders."""
    order = v.order
    if order is None or order.kind not in ("path", "velocity"):
        return None
    if order.kind == "path":
        return _PATH, order.numbers
    north, east, down, yaw = order.numbers
    return _VELOCITY, (0.0, 0.0, 0.0, north, east, down, 0.0, 0.0, 0.0, yaw)


def position_target_local_ned(v: View) -> Payload:
    """Return the payload of POSITION_TARGET_LOCAL_NED with the path or velocity that is flown."""
    found = _motion(v)
    if found is None:
        return None
    mask, numbers = found
    place = v.local((numbers[0], numbers[1], numbers[2])) if mask == _PATH else numbers[:3]
    return _STRUCT["POSITION_TARGET_LOCAL_NED"](v.boot_ms, *place, *numbers[3:], 0.0, mask, _LOCAL_NED)


def position_target_global_int(v: View) -> Payload:
    """Return the payload of POSITION_TARGET_GLOBAL_INT with the path that is flown; place 0 for a velocity."""
    found = _motion(v)
    if found is None:
        return None
    mask, numbers = found
    place = (0, 0, 0.0)
    if mask == _PATH:
        latitude, longitude, altitude = v.stack.place((numbers[0], numbers[1], numbers[2]))
        place = (round(latitude * 1e7), round(longitude * 1e7), altitude)
    return _STRUCT["POSITION_TARGET_GLOBAL_INT"](v.boot_ms, *place, *numbers[3:], 0.0, mask, _GLOBAL_INT)


def attitude_target(v: View) -> Payload:
    """Return the payload of ATTITUDE_TARGET with the attitude and thrust that are flown."""
    order = v.order
    if order is None or order.kind != "attitude":
        return None
    roll, pitch, yaw, throttle = order.numbers
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(0.5 * x), math.cos(0.5 * x)) for x in (roll, pitch, yaw))
    quaternion = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return LAYOUTS["ATTITUDE_TARGET"].payload(
        time_boot_ms=v.boot_ms, type_mask=_NO_RATES, q=quaternion, thrust=v.stack.thrust_of(throttle)
    )


def current_mode(v: View) -> Payload:
    """Return the payload of PX4's CURRENT_MODE with the mode that is flown and the requested mode."""
    if v.stack.heartbeat().autopilot != PX4:
        return None
    flown, intended = v.stack.current_modes()
    return LAYOUTS["CURRENT_MODE"].payload(
        standard_mode=flown.standard, custom_mode=flown.custom_mode, intended_custom_mode=intended.custom_mode
    )


def available_modes_monitor(v: View) -> Payload:
    """Return the payload of AVAILABLE_MODES_MONITOR, whose counter never changes."""
    return LAYOUTS["AVAILABLE_MODES_MONITOR"].payload(seq=0)


def available_modes(v: View, index: int) -> list[bytes]:
    """Return the AVAILABLE_MODES payloads: of all modes for index 0, else of the mode with this index, from 1."""
    modes = v.stack.modes()
    return [
        LAYOUTS["AVAILABLE_MODES"].payload(
            number_modes=len(modes),
            mode_index=number,
            standard_mode=mode.standard,
            custom_mode=mode.custom_mode,
            properties=mode.properties,
            mode_name=mode.name.encode(),
        )
        for number, mode in enumerate(modes, 1)
        if index in (0, number)
    ]


def orbit_execution_status(v: View) -> Payload:
    """Return the payload of ORBIT_EXECUTION_STATUS; None unless an orbit is flown."""
    orbit = v.stack.orbiting()
    if orbit is None:
        return None
    latitude, longitude, altitude = v.stack.place(orbit.centre)
    return LAYOUTS["ORBIT_EXECUTION_STATUS"].payload(
        time_usec=v.boot_us,
        radius=orbit.radius,
        frame=_GLOBAL_INT,
        x=round(latitude * 1e7),
        y=round(longitude * 1e7),
        z=altitude,
    )


def gps_global_origin(v: View) -> Payload:
    """Return the payload of GPS_GLOBAL_ORIGIN with the origin of the vehicle's local frame."""
    latitude, longitude, altitude = v.stack.place(v.stack.origin)
    return LAYOUTS["GPS_GLOBAL_ORIGIN"].payload(
        latitude=round(latitude * 1e7),
        longitude=round(longitude * 1e7),
        altitude=round(altitude * 1e3),
        time_usec=v.boot_us,
    )


def autopilot_version(v: View) -> Payload:
    """Return the payload of AUTOPILOT_VERSION; its uid is the system id."""
    cast = v.stack.heartbeat().autopilot == ARDUPILOT
    return LAYOUTS["AUTOPILOT_VERSION"].payload(
        capabilities=CAPABILITIES & ~BYTEWISE | CAST if cast else CAPABILITIES,
        flight_sw_version=ARDUPILOT_VERSION if cast else FLIGHT_VERSION,
        uid=int(v.stack.parameters["MAV_SYS_ID"]),
    )


def protocol_version(v: View) -> Payload:
    """Return the payload of PROTOCOL_VERSION: version 2 is sent, and 1 is read too."""
    return LAYOUTS["PROTOCOL_VERSION"].payload(version=_VERSION, min_version=_OLDEST, max_version=_NEWEST)
