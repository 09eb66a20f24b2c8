"""Payloads of what a vehicle perceives around it: obstacles, other vehicles, and flow over the ground."""

from __future__ import annotations

import math

import numpy as np

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.view import View
from qrsim.links.shared import sight as s
from qrsim.links.shared.turning import turned
from qrsim.models.sensors.scan import FARTHEST, Scan, ray_angles

_MOST_RAYS, _UNUSED, _LASER, _BODY_FRD = 72, 0xFFFF, 0, 12
# ADSB_FLAGS: coordinates, altitude, heading, velocity, callsign, and of a simulation; ADSB_EMITTER_TYPE_UAV.
_PLACE, _ALTITUDE, _HEADING, _VELOCITY, _CALLSIGN, _SIMULATED, _UAV = 1, 2, 4, 8, 16, 64, 14
_GEOMETRIC, _LONGEST_NAME = 1, 8


def obstacle_distance(v: View) -> bytes | None:
    """Return the payload of OBSTACLE_DISTANCE from a lidar, up to 72 sectors in body axes; None without one."""
    found = None if v.around is None or v.seen.stopped else v.around.scan(v.number)
    if found is None:
        return None
    sensor, own, ranges = found
    nearest, farthest = 0.0, FARTHEST
    if isinstance(sensor, Scan):
        nearest, farthest = (float(np.broadcast_to(x, own + 1)[own]) for x in (sensor.range_min, sensor.range_max))
    # Rays that share a sector: the nearest counts.
    each = -(-sensor.rays // _MOST_RAYS)
    padded = np.full(-(-sensor.rays // each) * each, np.inf)
    padded[: len(ranges)] = np.where(np.isfinite(ranges), ranges, np.inf)
    sectors = padded.reshape(-1, each).min(axis=1)
    limit = min(round(100.0 * farthest), _UNUSED - 2)
    # Nothing within reach is 1 cm beyond it.
    distances = np.minimum(np.round(100.0 * sectors), limit + 1).astype(int).tolist()
    step = math.degrees(sensor.field_of_view_rad) / sensor.rays
    first = math.degrees(float(ray_angles(sensor.rays, sensor.field_of_view_rad)[0])) + 0.5 * (each - 1) * step
    return LAYOUTS["OBSTACLE_DISTANCE"].payload(
        time_usec=v.boot_us,
        sensor_type=_LASER,
        distances=distances + [_UNUSED] * (_MOST_RAYS - len(distances)),
        increment=min(round(each * step), 255),
        min_distance=round(100.0 * nearest),
        max_distance=limit,
        increment_f=each * step,
        angle_offset=first,
        frame=_BODY_FRD,
    )


def optical_flow_rad(v: View) -> bytes | None:
    """Return the payload of OPTICAL_FLOW_RAD, with quality 0 if there is no flow; None without a sensor."""
    row, period = v.row, 0.0 if v.around is None else v.around.flow_period(v.number)
    if not period or row[s.FLOW_TURN] != row[s.FLOW_TURN]:
        return None
    there = row[s.FLOW] == row[s.FLOW]
    x, y = (row[s.FLOW], row[s.FLOW + 1]) if there else (0.0, 0.0)
    turn, distance = row[s.FLOW_TURN : s.FLOW_TURN + 3], row[s.RANGE]
    return LAYOUTS["OPTICAL_FLOW_RAD"].payload(
        time_usec=v.boot_us,
        integration_time_us=round(1e6 * period),
        integrated_x=x,
        integrated_y=y,
        integrated_xgyro=turn[0],
        integrated_ygyro=turn[1],
        integrated_zgyro=turn[2],
        quality=round(255.0 * row[s.FLOW_QUALITY]) if there else 0,
        distance=distance if math.isfinite(distance) else -1.0,
    )


def adsb_vehicle(v: View) -> bytes | None:
    """Return the payload of ADSB_VEHICLE of one visible vehicle, the next at each call; None if none is visible."""
    found = None if v.around is None or not v.seen.valid or v.seen.stopped else v.around.neighbours(v.number)
    if found is None or not len(found.position):
        return None
    v.turn = (v.turn + 1) % len(found.position)
    seen, number = v.seen, int(found.vehicle[v.turn])
    north, east, down = _ned(v, found.position[v.turn])
    here = seen.position_ned
    latitude, longitude, altitude = v.stack.place((here[0] + north, here[1] + east, here[2] + down))
    flags = _PLACE | _ALTITUDE | _SIMULATED | (_CALLSIGN if number >= 0 else 0)
    moves = found.velocity[v.turn]
    vn, ve, vd = 0.0, 0.0, 0.0
    if math.isfinite(float(moves.sum())):
        flags |= _VELOCITY | _HEADING
        vn, ve, vd = (own + other for own, other in zip(seen.velocity_ned, _ned(v, moves), strict=True))
    return LAYOUTS["ADSB_VEHICLE"].payload(
        # Of who is not known, by its place in the reading.
        ICAO_address=number + 1 if number >= 0 else 0xFFF000 + v.turn,
        lat=round(latitude * 1e7),
        lon=round(longitude * 1e7),
        altitude_type=_GEOMETRIC,
        altitude=round(altitude * 1e3),
        heading=round(math.degrees(math.atan2(ve, vn)) * 100.0) % 36000,
        hor_velocity=min(round(100.0 * math.hypot(vn, ve)), 65535),
        ver_velocity=max(-32768, min(round(-100.0 * vd), 32767)),
        callsign=f"V{number + 1}".encode()[:_LONGEST_NAME] if number >= 0 else b"",
        emitter_type=_UAV,
        flags=flags,
    )


def _ned(v: View, frd: np.ndarray) -> tuple[float, float, float]:
    """Rotate a vector from body axes (FRD) to NED by the estimated attitude."""
    w, x, y, z = v.row[s.QUATERNION : s.QUATERNION + 4]
    north, east, down = turned(np.array([x, y, z, w]), np.asarray(frd, np.float64)).tolist()
    return north, east, down
