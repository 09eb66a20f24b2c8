"""What PX4 publishes of one vehicle over its uXRCE-DDS bridge: NED and FRD axes, times in microseconds.

Source: PX4 1.15, src/modules/uxrce_dds_client/dds_topics.yaml (topics) and utilities.hpp (qualities of service: best
effort, kept for late readers), and the message definitions of px4_msgs, release/1.15.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from qrsim.links.mavlink.stack.codes import Landed, Sensor
from qrsim.links.mavlink.stack.contracts import NAN, Triple
from qrsim.links.mavlink.stack.flight_stack import CRITICAL, TERMINATION
from qrsim.links.mavlink.system import System
from qrsim.links.mavlink.view import View
from qrsim.links.ros2.apis import forms as f
from qrsim.links.ros2.apis.contracts import Make, Told
from qrsim.links.ros2.apis.modes import TERMINATED, nav_state
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared import sight as s

PACKAGES = ("px4_msgs",)
# Of topics whose rate is limited by ``--rate`` alone [Hz].
MOST = 1e9
Fields = dict[str, float | list[float] | tuple[float, ...]]
_OFFBOARD = 14
# VehicleStatus: ARMING_STATE_*, VEHICLE_TYPE_* by MAV_TYPE (1 aeroplane, 10 rover).
_DISARMED, _IS_ARMED = 1, 2
_TYPES = {1: 2, 10: 3}
# Frames of VehicleOdometry; TimesyncStatus.SOURCE_PROTOCOL_DDS; VehicleLocalPosition.DIST_BOTTOM_SENSOR_RANGE.
_NED, _DDS, _RANGE = 1, 2, 1
# States in which the autopilot flies by itself: mission, loiter, return, take-off, landing.
_AUTOMATIC = (3, 4, 5, 17, 18)


class Status:
    """The changes of a vehicle's state, for the times that VehicleStatus has.

    Attributes:
        armed, took_off, mode: times of arming, take-off and the present mode [us]; 0 while there was none.
    """

    def __init__(self) -> None:
        self.armed = self.took_off = self.mode = 0
        self._was: tuple[bool, int, bool] = (False, -1, False)

    def look(self, view: View) -> None:
        """Note the times at which arming, take-off and flight mode last changed; call it at every tick."""
        beat, now = view.stack.heartbeat(), view.boot_us
        state = view.stack.armed, beat.custom_mode, beat.landed is not Landed.ON_GROUND
        if state[0] != self._was[0]:
            self.armed = now if state[0] else 0
        if state[1] != self._was[1]:
            self.mode = now
        if state[2] != self._was[2]:
            self.took_off = now if state[2] else 0
        self._was = state


def state_of(view: View) -> int:
    """Return the vehicle's NAVIGATION_STATE, PX4's number of the flight mode."""
    beat = view.stack.heartbeat()
    return TERMINATED if beat.system_status == TERMINATION else nav_state(beat.custom_mode)


def published(types: Types, system: System, space: str, period: float) -> Iterator[Told]:
    """Yield the topics that PX4's uXRCE-DDS client publishes for one vehicle, each with its encoder; ``space``: prefix.

    Args:
        types: of the distribution, with PACKAGES.
        system: the vehicle.
        space: what is before the names of topics, such as "/px4_1/fmu/".
        period: of the readings of its gyroscope and accelerometer [s].
    """
    status = Status()

    def told(
        name: str,
        kind: str,
        rate: float,
        fields: Callable[[View], Fields | None],
        key: Callable[[View], object] | None = None,
        **constants: object,
    ) -> Told:
        """Return a published topic from name, px4_msgs type, rate [Hz], function of its fields and, if sent on changes,
        ``key``."""
        return Told(
            Topic(f"{space}out/{name}", f"px4_msgs/msg/{kind}", "fmu"),
            rate,
            _encoder(types, kind, fields, constants),
            key,
        )

    def changes(view: View) -> object:
        """Return the values whose change makes the status messages due."""
        beat = view.stack.heartbeat()
        return beat.base_mode, beat.custom_mode, beat.system_status, beat.landed

    def vehicle_status(view: View) -> Fields:
        """Return the fields of the vehicle's VehicleStatus message."""
        status.look(view)
        beat, state, armed = view.stack.heartbeat(), state_of(view), view.stack.armed
        return {
            "armed_time": status.armed,
            "takeoff_time": status.took_off,
            "nav_state_timestamp": status.mode,
            "arming_state": _IS_ARMED if armed else _DISARMED,
            "nav_state": state,
            "nav_state_user_intention": state,
            "failsafe": beat.system_status == CRITICAL,
            "pre_flight_checks_pass": armed or not view.stack.health().reasons,
        }

    kind = system.stack.heartbeat().mav_type
    yield told(
        "vehicle_status",
        "VehicleStatus",
        2.0,
        vehicle_status,
        changes,
        vehicle_type=_TYPES.get(kind, 1),
        system_type=kind,
        system_id=system.number,
        component_id=1,
        power_input_valid=True,
        safety_off=True,
        gcs_connection_lost=True,
    )
    yield told("vehicle_control_mode", "VehicleControlMode", 2.0, _control_mode, changes)
    yield told("vehicle_land_detected", "VehicleLandDetected", 1.0, _land_detected, changes)
    yield told(
        "home_position",
        "HomePosition",
        0.5,
        _home_position,
        lambda view: view.stack.home,
        valid_alt=True,
        valid_hpos=True,
        valid_lpos=True,
    )
    origin = _Origin()
    yield told("vehicle_local_position", "VehicleLocalPosition", MOST, lambda view: _local_position(view, origin))
    yield told("vehicle_global_position", "VehicleGlobalPosition", MOST, _global_position)
    yield told("vehicle_attitude", "VehicleAttitude", MOST, _attitude)
    yield told("vehicle_odometry", "VehicleOdometry", MOST, _odometry, pose_frame=_NED, velocity_frame=_NED)
    step = round(1e6 * period)
    yield told(
        "sensor_combined",
        "SensorCombined",
        MOST,
        _sensor_combined,
        gyro_integral_dt=step,
        accelerometer_integral_dt=step,
    )
    yield told("vehicle_gps_position", "SensorGps", 0.0, _gnss_fix, lambda view: view.fix_time)
    yield told("battery_status", "BatteryStatus", 1.0, _battery_status, connected=True, current_a=-1.0)
    yield told(
        "timesync_status", "TimesyncStatus", 1.0, lambda view: {"remote_timestamp": view.boot_us}, source_protocol=_DDS
    )


def _encoder(
    types: Types, kind: str, fields: Callable[[View], Fields | None], constants: dict[str, Any]
) -> Callable[[View], bytes | None]:
    """Return the encoder of px4_msgs/``kind`` from a function of its fields; it fills in the timestamps and
    ``constants``."""
    made: list[Make] = []
    name = f"px4_msgs/msg/{kind}"
    times = [field for field, _ in types.fields(name) if field in ("timestamp", "timestamp_sample")]
    now: list[float] = []

    def make(view: View) -> bytes | None:
        """Return the encoded message of a vehicle, None where its fields are unknown."""
        found = fields(view)
        if found is None:
            return None
        now.clear()
        now.extend([view.boot_us] * len(times))
        for value in found.values():
            if isinstance(value, list | tuple):
                now.extend(value)
            else:
                now.append(value)
        if not made:
            made.append(f.form(types, name, (*times, *found), lambda _: now, **constants))
        return made[0](view)

    return make


def _control_mode(view: View) -> Fields:
    """Return the fields of VehicleControlMode: whether armed, offboard and automatic, and which control loops run."""
    state, armed = state_of(view), view.stack.armed
    offboard, automatic = state == _OFFBOARD, state in _AUTOMATIC
    flies = offboard or automatic
    levels = ("position", "velocity", "altitude", "climb_rate", "attitude", "rates", "allocation")
    return {
        "flag_armed": armed,
        "flag_control_offboard_enabled": offboard,
        "flag_control_auto_enabled": automatic,
        "flag_multicopter_position_control_enabled": flies,
        "flag_control_termination_enabled": state == TERMINATED,
        **{f"flag_control_{level}_enabled": flies for level in levels},
    }


def _land_detected(view: View) -> Fields:
    """Return the fields of VehicleLandDetected: whether the vehicle is on the ground and whether it moves."""
    landed = view.stack.heartbeat().landed is Landed.ON_GROUND
    names = ("ground_contact", "maybe_landed", "landed", "at_rest", "close_to_ground_or_skipped_check")
    north, east, down = view.seen.velocity_ned
    moving: Fields = {"vertical_movement": abs(down) > 0.3, "horizontal_movement": math.hypot(north, east) > 1.0}
    return moving | dict.fromkeys(names, float(landed))


def _home_position(view: View) -> Fields | None:
    """Return the fields of HomePosition, None before home is set."""
    home = view.stack.home
    if home is None:
        return None
    x, y, z = view.local(home.position_ned)
    return {"lat": home.latitude, "lon": home.longitude, "alt": home.altitude, "x": x, "y": y, "z": z, "yaw": home.yaw}


def _accuracies(view: View) -> tuple[float, float]:
    """Return the horizontal and vertical standard deviation [m] of the estimate's position, else of the GNSS
    receiver's."""
    north, east, down = view.row[s.STD_POSITION : s.STD_POSITION + 3]
    if north == north:
        return math.hypot(north, east), down
    return view.seen.horizontal_accuracy, view.seen.vertical_accuracy


class _Origin:
    """Where the local frame of a vehicle begins on the Earth, which takes a while to compute."""

    def __init__(self) -> None:
        self._place: Triple = (NAN, NAN, NAN)
        self._origin: Triple | None = None

    def of(self, view: View) -> Triple:
        """Return latitude, longitude [deg] and altitude above mean sea level [m] of the vehicle's local origin."""
        if view.stack.origin != self._origin:
            self._origin = view.stack.origin
            self._place = view.stack.place(self._origin)
        return self._place


def _local_position(view: View, origin: _Origin) -> Fields | None:
    """Return the fields of VehicleLocalPosition, None where the estimate is invalid."""
    seen = view.seen
    if not seen.valid:
        return None
    x, y, z = view.local(seen.position_ned)
    vx, vy, vz = seen.velocity_ned
    latitude, longitude, altitude = origin.of(view)
    below = view.row[s.RANGE]
    seen_below = math.isfinite(below)
    eph, epv = _accuracies(view)
    north, east, down = view.row[s.STD_VELOCITY : s.STD_VELOCITY + 3]
    valid = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid", "xy_global", "z_global", "heading_good_for_control")
    return {
        **dict.fromkeys(valid, True),
        "x": x,
        "y": y,
        "z": z,
        "vx": vx,
        "vy": vy,
        "vz": vz,
        "z_deriv": vz,
        "heading": seen.attitude[2],
        "unaided_heading": seen.attitude[2],
        "ref_lat": latitude,
        "ref_lon": longitude,
        "ref_alt": altitude,
        "dist_bottom": below if seen_below else NAN,
        "dist_bottom_valid": seen_below,
        "dist_bottom_sensor_bitfield": _RANGE if seen_below else 0,
        "eph": eph,
        "epv": epv,
        "evh": math.hypot(north, east),
        "evv": down,
        "vxy_max": NAN,
        "vz_max": NAN,
        "hagl_min": NAN,
        "hagl_max": NAN,
    }


def _global_position(view: View) -> Fields | None:
    """Return the fields of VehicleGlobalPosition, None where the estimate is invalid."""
    seen = view.seen
    if not seen.valid:
        return None
    eph, epv = _accuracies(view)
    return {
        "lat": seen.latitude,
        "lon": seen.longitude,
        "alt": seen.altitude,
        "alt_ellipsoid": view.height,
        "eph": eph,
        "epv": epv,
        "terrain_alt": NAN,
    }


def _quaternion(view: View) -> list[float]:
    """Return the vehicle's estimated attitude as a list w, x, y, z."""
    return view.row[s.QUATERNION : s.QUATERNION + 4]


def _attitude(view: View) -> Fields | None:
    """Return the fields of VehicleAttitude, None where the estimate is invalid."""
    return {"q": _quaternion(view)} if view.seen.valid else None


def _odometry(view: View) -> Fields | None:
    """Return the fields of VehicleOdometry with its variances, None where the estimate is invalid."""
    seen, row = view.seen, view.row
    if not seen.valid:
        return None
    return {
        "position": view.local(seen.position_ned),
        "q": _quaternion(view),
        "velocity": seen.velocity_ned,
        "angular_velocity": seen.rates,
        "position_variance": _variances(row, s.STD_POSITION),
        "orientation_variance": _variances(row, s.STD_ATTITUDE),
        "velocity_variance": _variances(row, s.STD_VELOCITY),
    }


def _variances(row: list[float], first: int) -> list[float]:
    """Return the squares of three standard deviations in ``row``, from column ``first`` on."""
    return [std * std for std in row[first : first + 3]]


def _sensor_combined(view: View) -> Fields | None:
    """Return the fields of SensorCombined, None without an IMU."""
    if not view.seen.present & (Sensor.GYRO | Sensor.ACCELEROMETER):
        return None
    return {"gyro_rad": view.row[s.RATES : s.RATES + 3], "accelerometer_m_s2": view.row[s.FORCE : s.FORCE + 3]}


def _gnss_fix(view: View) -> Fields | None:
    """Return the fields of SensorGps, None before the first fix."""
    row, seen = view.row, view.seen
    if row[s.FIX_PLACE] != row[s.FIX_PLACE]:
        return None
    latitude, longitude, height = row[s.FIX_PLACE : s.FIX_PLACE + 3]
    north, east, down = row[s.FIX_VELOCITY : s.FIX_VELOCITY + 3]
    moving = north == north and east == east
    satellites = row[s.SATELLITES]
    return {
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "altitude_msl_m": view.fix_altitude,
        "altitude_ellipsoid_m": height,
        "s_variance_m_s": row[s.SPEED],
        "fix_type": seen.fix_type,
        "eph": seen.horizontal_accuracy,
        "epv": seen.vertical_accuracy,
        "hdop": row[s.HDOP],
        "vdop": row[s.VDOP],
        "vel_m_s": math.hypot(north, east),
        "vel_n_m_s": north,
        "vel_e_m_s": east,
        "vel_d_m_s": down,
        "cog_rad": math.atan2(east, north) if moving else NAN,
        "vel_ned_valid": moving,
        "time_utc_usec": round((view.unix + view.fix_time) * 1e6),
        "satellites_used": 0 if satellites != satellites else int(satellites),
        "heading": NAN,
    }


def _battery_status(view: View) -> Fields | None:
    """Return the fields of BatteryStatus, None where the charge is unknown."""
    charge, voltage = view.seen.charge, view.seen.voltage
    if charge != charge:
        return None
    names = ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR")
    return {
        "voltage_v": voltage,
        "voltage_filtered_v": voltage,
        "remaining": charge,
        "scale": 1.0,
        "time_remaining_s": NAN,
        "temperature": NAN,
        "warning": sum(charge <= view.stack.parameters[name] for name in names),
    }
