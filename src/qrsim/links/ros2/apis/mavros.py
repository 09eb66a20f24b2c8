"""What mavros publishes of one vehicle: topics, types, rates, frames and qualities of service as mavros 2 has them.

Source: mavros, src/plugins and launch/px4_config.yaml of its branch ros2; rates are those of the MAVLink streams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from qrsim.core.arrays import NumpyArray
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.stack.codes import Sensor
from qrsim.links.mavlink.stack.modes import ARMED_FLAG
from qrsim.links.mavlink.telemetry import ENCODERS
from qrsim.links.mavlink.view import View
from qrsim.links.ros2.apis import forms as f
from qrsim.links.ros2.apis.contracts import EACH, Make, Told
from qrsim.links.ros2.apis.modes import name_of
from qrsim.links.ros2.apis.texts import Texts
from qrsim.links.ros2.blank import stamped
from qrsim.links.ros2.topics import Quality, Topic
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared import sight as s

PACKAGES = ("mavros_msgs", "geographic_msgs", "std_srvs")
MAP, BASE = "map", "base_link"
# MAV_MODE_FLAG: remote control, guided.
_MANUAL, _GUIDED = 64, 8
_NAN = math.nan
# launch/px4_config.yaml of mavros: standard deviations of Imu [rad], [rad/s], [m/s^2].
_ORIENTATION_STD, _RATES_STD, _FORCE_STD = 1.0, 0.0003490659, 0.0003
# sensor_msgs: NavSatStatus.SERVICE_GPS, STATUS_NO_FIX; NavSatFix.COVARIANCE_TYPE_*.
_GPS, _NO_FIX, _UNKNOWN, _DIAGONAL = 1, -1, 0, 2


def _diagonal(std: float) -> NumpyArray:
    """Return a covariance matrix (9,), row by row, with the variance ``std``^2 for each of three axes and no
    correlation."""
    return np.diag([std * std] * 3).reshape(9)


def _axis_paths(path: str, names: str = "xyz") -> tuple[str, ...]:
    """Return the field paths of a vector's components in a ROS message, such as "position.x"."""
    return tuple(f"{path}.{axis}" for axis in names)


def published(types: Types, space: str, texts: Texts) -> Iterator[Told]:
    """Yield the ROS topics that mavros publishes for one vehicle, each with its encoder; ``space``: topic prefix.

    Args:
        types: of the distribution, with PACKAGES.
        space: what is before the names of topics, such as "/uav1/mavros/".
        texts: that the vehicle sends.
    """

    def told(
        name: str, kind: str, quality: Quality, rate: float, make: Make, key: Callable[[View], object] | None = None
    ) -> Told:
        """Return a published topic from name, message type, QoS, rate [Hz], encoder and, for one sent on changes,
        ``key``."""
        return Told(Topic(space + name, kind, quality), rate, make, key)

    def state(view: View) -> bytes:
        """Return the encoded mavros_msgs/State message of a vehicle."""
        beat = view.stack.heartbeat()
        message = stamped(types, "mavros_msgs/msg/State", view.seen.time)
        message.connected, message.armed = True, bool(beat.base_mode & ARMED_FLAG)
        message.guided, message.manual_input = bool(beat.base_mode & _GUIDED), bool(beat.base_mode & _MANUAL)
        message.mode, message.system_status = name_of(beat.custom_mode), beat.system_status
        return types.encode(message)

    def changes(view: View) -> object:
        """Return the values whose change makes the State message due."""
        beat = view.stack.heartbeat()
        return beat.base_mode, beat.custom_mode, beat.system_status

    yield told("state", "mavros_msgs/msg/State", "static", 1.0, state, changes)
    kind = "mavros_msgs/msg/ExtendedState"
    landed = f.form(types, kind, ("landed_state",), lambda view: (int(view.stack.heartbeat().landed),))
    yield told("extended_state", kind, "static", 5.0, landed, lambda view: view.stack.heartbeat().landed)
    yield told("statustext/recv", "mavros_msgs/msg/StatusText", "sensor", EACH, _status_text(types, texts))
    yield told(
        "home_position/home",
        "mavros_msgs/msg/HomePosition",
        "static",
        0.5,
        f.form(
            types,
            "mavros_msgs/msg/HomePosition",
            (
                "geo.latitude",
                "geo.longitude",
                "geo.altitude",
                *_axis_paths("position"),
                *_axis_paths("orientation", "xyzw"),
            ),
            _home_position,
        ),
        lambda view: view.stack.home,
    )
    yield from _local_topics(types, told)
    yield from _global_topics(types, told)
    yield from _sensor_topics(types, told)


def _status_text(types: Types, texts: Texts) -> Make:
    """Return the encoder of mavros StatusText messages, which takes one text from the queue at each call."""

    def make(view: View) -> bytes | None:
        """Return the oldest queued text as an encoded StatusText message, None if there is none."""
        if not texts.waiting:
            return None
        severity, text = texts.waiting.popleft()
        message = stamped(types, "mavros_msgs/msg/StatusText", view.seen.time)
        message.severity, message.text = severity, text
        return types.encode(message)

    return make


def _home_position(view: View) -> tuple[float, ...] | None:
    """Return home: latitude, longitude [deg], height [m], local ENU position [m], attitude (x, y, z, w); None without a
    home."""
    home = view.stack.home
    if home is None:
        return None
    # As mavros turns it: from NED to ENU, but not from FRD to FLU.
    cosine, sine = f.HALF_ROOT * math.cos(0.5 * home.yaw), f.HALF_ROOT * math.sin(0.5 * home.yaw)
    turn = (cosine + sine, cosine - sine, 0.0, 0.0)
    # Messages of ROS have heights above the ellipsoid, to which mavros converts.
    height = home.altitude + view.geoid.undulation(*home.position_ned[:2])
    return home.latitude, home.longitude, height, *f.enu(view.local(home.position_ned)), *turn


Maker = Callable[..., Told]


def _local_topics(types: Types, told: Maker) -> Iterator[Told]:
    """Yield mavros's topics of pose, velocity and odometry in the local frame; ``told`` makes a topic."""

    def pose(view: View) -> tuple[float, ...] | None:
        """Return position ENU [m] and attitude quaternion (x, y, z, w); None where the estimate is invalid."""
        if not view.seen.valid:
            return None
        return *f.enu(view.local(view.seen.position_ned)), *f.orientation(view)

    def twist(view: View) -> tuple[float, ...] | None:
        """Return linear velocity [m/s] and body rates [rad/s] in FLU body axes; None where the estimate is invalid."""
        if not view.seen.valid:
            return None
        return *f.turned_back(f.orientation(view), f.enu(view.seen.velocity_ned)), *f.flu(view.seen.rates)

    def level_twist(view: View) -> tuple[float, ...] | None:
        """Return linear velocity [m/s] and body rates [rad/s] in ENU axes; None where the estimate is invalid."""
        if not view.seen.valid:
            return None
        return *f.enu(view.seen.velocity_ned), *f.turned(f.orientation(view), f.flu(view.seen.rates))

    def both(view: View) -> tuple[float, ...] | None:
        """Return the numbers of ``pose`` and ``twist`` together, None where the estimate is invalid."""
        place, motion = pose(view), twist(view)
        return None if place is None or motion is None else (*place, *motion)

    place, turns = _axis_paths("pose.position"), _axis_paths("pose.orientation", "xyzw")
    motion = (*_axis_paths("twist.linear"), *_axis_paths("twist.angular"))
    kind = "geometry_msgs/msg/PoseStamped"
    yield told("local_position/pose", kind, "sensor", 30.0, f.form(types, kind, (*place, *turns), pose, MAP))
    kind = "geometry_msgs/msg/TwistStamped"
    yield told("local_position/velocity_body", kind, "sensor", 30.0, f.form(types, kind, motion, twist, BASE))
    yield told("local_position/velocity_local", kind, "sensor", 30.0, f.form(types, kind, motion, level_twist, BASE))
    kind = "nav_msgs/msg/Odometry"
    paths = (*(f"pose.{path}" for path in (*place, *turns)), *(f"twist.{path}" for path in motion))
    yield told("local_position/odom", kind, "sensor", 30.0, f.form(types, kind, paths, both, MAP, child_frame_id=BASE))


def _global_topics(types: Types, told: Maker) -> Iterator[Told]:
    """Yield mavros's topics of geodetic position, GNSS fix, altitude and heading; ``told`` makes a topic."""

    def covariance(view: View) -> tuple[float, ...]:
        """Return the variances [m^2] of east, north, up position and NavSatFix's covariance type."""
        level, up = view.seen.horizontal_accuracy, view.seen.vertical_accuracy
        if level != level or up != up:
            return -1.0, 0.0, 0.0, _UNKNOWN
        return level * level, level * level, up * up, _DIAGONAL

    def place(view: View) -> tuple[float, ...] | None:
        """Return fix status, latitude, longitude [deg], height [m] and covariance of the estimated position; None where
        it is invalid."""
        seen = view.seen
        if not seen.valid:
            return None
        status = 0 if seen.fix_type >= 3 else _NO_FIX
        return status, seen.latitude, seen.longitude, view.height, *covariance(view)

    def fix(view: View) -> tuple[float, ...] | None:
        """Return fix status, latitude, longitude [deg], height [m] and covariance of the GNSS receiver's fix; None
        without one."""
        where = view.row[s.FIX_PLACE : s.FIX_PLACE + 3]
        if view.seen.fix_type < 3 or where[0] != where[0]:
            return None
        return 0, *where, *covariance(view)

    kind = "sensor_msgs/msg/NavSatFix"
    paths = (
        "status.status",
        "latitude",
        "longitude",
        "altitude",
        "position_covariance[0]",
        "position_covariance[4]",
        "position_covariance[8]",
        "position_covariance_type",
    )
    yield told(
        "global_position/global", kind, "sensor", 50.0, f.form(types, kind, paths, place, BASE, status__service=_GPS)
    )
    raw = f.form(types, kind, paths, fix, BASE, status__service=_GPS)
    yield told("global_position/raw/fix", kind, "sensor", 0.0, raw, lambda view: view.fix_time)
    kind = "std_msgs/msg/Float64"

    def height(view: View) -> tuple[float, ...] | None:
        """Return the height above home [m] as a tuple; None where it is unknown."""
        return (view.seen.altitude - view.home_altitude,) if view.seen.valid else None

    def compass(view: View) -> tuple[float, ...] | None:
        """Return the heading [degrees], 0 to 360, as a tuple; None where it is unknown."""
        return (math.degrees(view.seen.attitude[2]) % 360.0,) if view.seen.valid else None

    yield told("global_position/rel_alt", kind, "sensor", 50.0, f.form(types, kind, ("data",), height))
    yield told("global_position/compass_hdg", kind, "sensor", 50.0, f.form(types, kind, ("data",), compass))
    kind = "mavros_msgs/msg/Altitude"
    names = ("monotonic", "amsl", "local", "relative", "terrain", "bottom_clearance")
    altitude = _mavlink_numbers("ALTITUDE", slice(1, 7))
    yield told("altitude", kind, "sensor", 10.0, f.form(types, kind, names, altitude, MAP))
    kind = "mavros_msgs/msg/VfrHud"
    names = ("airspeed", "groundspeed", "altitude", "climb", "heading", "throttle")
    yield told("vfr_hud", kind, "sensor", 10.0, f.form(types, kind, names, _hud_numbers))


def _mavlink_numbers(name: str, part: slice) -> f.Numbers:
    """Return a function from a vehicle to some fields (``part``, in wire order) of its MAVLink message ``name``."""
    layout = LAYOUTS[name]

    def numbers(view: View) -> tuple[float, ...] | None:
        """Return the fields of the vehicle's MAVLink message, None if the vehicle does not send it."""
        payload = ENCODERS[layout.number](view)
        return None if payload is None else layout.struct.unpack(payload)[part]

    return numbers


def _hud_numbers(view: View) -> tuple[float, ...] | None:
    """Return the fields of the vehicle's VFR_HUD, with the throttle from 0 to 1 in place of percent."""
    numbers = _mavlink_numbers("VFR_HUD", slice(6))(view)
    if numbers is None:
        return None
    *others, percent = numbers
    return *others, 0.01 * percent


def _sensor_topics(types: Types, told: Maker) -> Iterator[Told]:
    """Yield mavros's topics of IMU, magnetometer, barometer and battery; ``told`` makes a topic."""

    def inertial(view: View) -> tuple[float, ...] | None:
        """Return attitude (x, y, z, w), body rates [rad/s] and specific force [m/s^2] in FLU axes; None without an
        IMU."""
        if not view.seen.valid or not view.seen.present & (Sensor.GYRO | Sensor.ACCELEROMETER):
            return None
        force = view.row[s.FORCE : s.FORCE + 3]
        return *f.orientation(view), *f.flu(view.seen.rates), *f.flu([x if x == x else 0.0 for x in force])

    kind = "sensor_msgs/msg/Imu"
    paths = (*_axis_paths("orientation", "xyzw"), *_axis_paths("angular_velocity"), *_axis_paths("linear_acceleration"))
    spreads = {
        f"{name}_covariance": _diagonal(std)
        for name, std in (
            ("orientation", _ORIENTATION_STD),
            ("angular_velocity", _RATES_STD),
            ("linear_acceleration", _FORCE_STD),
        )
    }
    yield told("imu/data", kind, "sensor", 50.0, f.form(types, kind, paths, inertial, BASE, **spreads))

    def battery(view: View) -> tuple[float, ...] | None:
        """Return the battery's voltage [V] and charge, 0 to 1; None where the charge is unknown."""
        charge = view.seen.charge
        return None if charge != charge else (view.seen.voltage, charge)

    kind = "sensor_msgs/msg/BatteryState"
    yield told(
        "battery",
        kind,
        "sensor",
        2.0,
        f.form(
            types,
            kind,
            ("voltage", "percentage"),
            battery,
            temperature=_NAN,
            current=_NAN,
            charge=_NAN,
            capacity=_NAN,
            design_capacity=_NAN,
            power_supply_status=2,
            power_supply_technology=3,
            present=True,
        ),
    )
