"""Bags of ROS 2, by rosbags: the topics of mavros, of ``qrsim ros2`` and of ``qrsim export --format rosbag2``.

Poses and velocities are of REP-103: east, north, up, and forward, left, up of the body; here they become north, east,
down, and forward, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from qrsim import extras
from qrsim.errors import LogError, RunError, UsageError, did_you_mean
from qrsim.studies.flight_logs.preparing import prepare
from qrsim.studies.flight_logs.signals import FlightLog, Floats, Track

if TYPE_CHECKING:
    from qrsim.links.ros2 import Message

MOST_SHOWN = 12
# Of mavros, which bags of SQLite do not describe.
_MAVROS = {
    "mavros_msgs/msg/AttitudeTarget": """std_msgs/Header header
uint8 type_mask
geometry_msgs/Quaternion orientation
geometry_msgs/Vector3 body_rate
float32 thrust
""",
    "mavros_msgs/msg/Thrust": """std_msgs/Header header
float32 thrust
""",
}
_YAW_RATE, _THRUST, _ATTITUDE = 4, 64, 128


@dataclass
class Samples:
    """Messages of one topic.

    Attributes:
        received: when each was recorded [s].
        stamped: when each was true, by its header [s]; NaN without one.
        rows: numbers of each.
    """

    received: list[float] = field(default_factory=list)
    stamped: list[float] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)


def _quaternion(given: Message) -> tuple[float, ...]:
    """Return x, y, z, w of a ROS quaternion message."""
    return given.x, given.y, given.z, given.w


def _vector(given: Message) -> tuple[float, ...]:
    """Return x, y, z of a ROS vector message."""
    return given.x, given.y, given.z


def _odometry_values(message: Message) -> tuple[float, ...]:
    """Return attitude, velocity and rates of a ROS Odometry message; NaN for unknown rates."""
    motion = message.twist.twist
    # A variance of -1 says that the rates are not known.
    known = message.twist.covariance[21] != -1.0
    rates = _vector(motion.angular) if known else (math.nan,) * 3
    return (*_quaternion(message.pose.pose.orientation), *_vector(motion.linear), *rates)


def _imu_values(message: Message) -> tuple[float, ...]:
    """Return attitude and rates of a ROS Imu message; NaN for an unknown attitude."""
    # By sensor_msgs/Imu -1 there says that the orientation is not known.
    known = message.orientation_covariance[0] != -1.0
    orientation = _quaternion(message.orientation) if known else (math.nan,) * 4
    return (*orientation, *_vector(message.angular_velocity))


def _target_values(message: Message) -> tuple[float, ...]:
    """Return attitude, yaw rate and thrust of a MAVROS set-point message; NaN for fields to be ignored."""
    ignored = message.type_mask
    attitude = (math.nan,) * 4 if ignored & _ATTITUDE else _quaternion(message.orientation)
    rate = math.nan if ignored & _YAW_RATE else message.body_rate.z
    return (*attitude, rate, math.nan if ignored & _THRUST else message.thrust)


@dataclass(frozen=True)
class Source:
    """A topic that is read.

    Attributes:
        topic: after the vehicle's namespace.
        types: of the message.
        numbers: of a message.
    """

    topic: str
    types: tuple[str, ...]
    numbers: Callable[[Message], tuple[float, ...]]


_POSE, _TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
# The only one without a header.
_PLAIN = "std_msgs/msg/Float32"
_AIM = "mavros_msgs/msg/AttitudeTarget"
SOURCES = tuple(
    Source(topic, types, numbers)
    for topics, types, numbers in (
        (("odom", "local_position/odom"), ("nav_msgs/msg/Odometry",), _odometry_values),
        (("imu/data",), ("sensor_msgs/msg/Imu",), _imu_values),
        (("pose", "local_position/pose"), (_POSE,), lambda message: _quaternion(message.pose.orientation)),
        (("velocity", "local_position/velocity_local"), (_TWIST,), lambda message: _vector(message.twist.linear)),
        (("battery",), ("sensor_msgs/msg/BatteryState",), lambda message: (message.voltage,)),
        (("setpoint_raw/target_attitude", "setpoint_raw/attitude"), (_AIM,), _target_values),
        (("setpoint_attitude/attitude",), (_POSE,), lambda message: _quaternion(message.pose.orientation)),
        (("setpoint_attitude/cmd_vel",), (_TWIST,), lambda message: (message.twist.angular.z,)),
        (("setpoint_attitude/thrust",), (_PLAIN,), lambda message: (message.data,)),
        (("setpoint_attitude/thrust",), ("mavros_msgs/msg/Thrust",), lambda message: (message.thrust,)),
    )
    for topic in topics
)
# One of each has to be there.
NEEDED = {
    "attitude": ("odom", "local_position/odom", "pose", "local_position/pose", "imu/data"),
    "attitude asked for": ("setpoint_raw/target_attitude", "setpoint_raw/attitude", "setpoint_attitude/attitude"),
}


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS 2 bag: a folder, or a file with a bag's suffix."""
    return path.is_dir() or path.suffix in (".mcap", ".db3")


def read_bag(path: Path, vehicle: str | None = None) -> FlightLog:
    """Read the flight of one vehicle from a ROS 2 bag.

    Args:
        path: its folder, or a file of it.
        vehicle: namespace of its topics, such as "uav1" or "uav1/mavros"; None: the only one that has what is needed.

    Raises:
        UsageError: no bag, no vehicle of that name, several, or not the topics that are needed.
        RunError: rosbags is not installed, or the bag is damaged.
    """
    extras.require("ros2", "reading a bag of ROS 2", "rosbags")
    from rosbags.highlevel import AnyReader

    _check_is_bag(path)
    try:
        with AnyReader([path], default_typestore=_default_types()) as reader:
            topics = {each.topic: each.msgtype for each in reader.connections}
            namespace = _chosen_namespace(path, topics, vehicle)
            sources = {
                topic: source for topic, kind in topics.items() if (source := _source_of(topic, kind, namespace))
            }
            wanted = [each for each in reader.connections if each.topic in sources]
            found: dict[str, Samples] = {}
            for connection, nanoseconds, raw in reader.messages(connections=wanted):
                message, source = reader.deserialize(raw, connection.msgtype), sources[connection.topic]
                samples = found.setdefault(source.topic, Samples())
                samples.received.append(nanoseconds * 1e-9)
                samples.stamped.append(_stamp_s(message))
                samples.rows.append(source.numbers(message))
    except UsageError:
        raise
    except Exception as error:  # rosbags raises whatever its parsing runs into
        raise RunError(f"{path}: a bag that cannot be read: {error or type(error).__name__}") from None
    notes = [f"vehicle {namespace or '/'}: topics {', '.join(sorted(found))}"]
    tracks = _tracks(found, notes)
    return prepare(path, "bag of ROS 2", tracks, notes)


def _check_is_bag(path: Path) -> None:
    """Raise an error for a folder without metadata.yaml; its text says how to make the file."""
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return
    if (path / "run.json").is_file():
        raise UsageError(f"{path}: a run of qrsim; qrsim export {path} --format rosbag2 makes a bag of it")
    raise LogError(
        f"{path}: a folder without metadata.yaml is no bag of ROS 2; name its .mcap or .db3 file, or 'ros2 bag reindex'"
        " makes one"
    )


def _default_types() -> object:
    """Return the ROS message types for bags that do not contain their own definitions."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _MAVROS.items():
        store.register(get_types_from_msg(text, name))
    return store


def _stamp_s(message: Message) -> float:
    """Return the header stamp of a ROS message [s]; NaN for types without one."""
    if message.__msgtype__ == _PLAIN:
        return math.nan
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def _source_of(topic: str, kind: str, namespace: str) -> Source | None:
    """Return the entry of SOURCES that reads a topic of a type ``kind`` in a namespace; None for other topics."""
    prefix = f"/{namespace}/" if namespace else "/"
    if not topic.startswith(prefix):
        return None
    rest = topic.removeprefix(prefix)
    return next((each for each in SOURCES if each.topic == rest and kind in each.types), None)


def _topics_by_namespace(topics: Mapping[str, str]) -> dict[str, set[str]]:
    """Return namespace -> its topics that can be read; ``topics`` maps topic to message type."""
    found: dict[str, set[str]] = {}
    for topic, kind in topics.items():
        for source in SOURCES:
            if kind in source.types and f"/{topic.lstrip('/')}".endswith(f"/{source.topic}"):
                found.setdefault(topic.removesuffix(source.topic).strip("/"), set()).add(source.topic)
    return found


def _chosen_namespace(path: Path, topics: Mapping[str, str], vehicle: str | None) -> str:
    """Return the namespace of the vehicle to read; raises an error if it is ambiguous."""
    there = _topics_by_namespace(topics)
    whole = [name for name, own in there.items() if not _missing_signals(own)]
    if vehicle is not None:
        name = vehicle.strip("/")
        if name not in there:
            raise UsageError(f"{path}: no vehicle '{vehicle}'{did_you_mean(name, there)}")
        if name not in whole:
            raise UsageError(
                f"{path}: vehicle '{vehicle}' has no topic of its {_describe_needed(_missing_signals(there[name]))}"
            )
        return name
    if len(whole) > 1:
        raise UsageError(
            f"{path}: a bag of several vehicles, {_short_list(sorted(whole))}; --namespace NAME chooses one"
        )
    if not whole:
        lacking = min((_missing_signals(own) for own in there.values()), key=len, default=list(NEEDED))
        shown = _short_list([f"{topic} ({kind})" for topic, kind in sorted(topics.items())]) or "none"
        raise LogError(f"{path}: no topic of a vehicle's {_describe_needed(lacking)}; there: {shown}")
    return whole[0]


def _missing_signals(own: set[str]) -> list[str]:
    """Return the names of needed signals that none of a vehicle's topics provides."""
    return [what for what, topics in NEEDED.items() if not own & set(topics)]


def _describe_needed(lacking: list[str]) -> str:
    """Return in words which topics could provide the lacking signals."""
    return "; ".join(f"{what}, one of {', '.join(NEEDED[what])}" for what in lacking)


def _short_list(names: list[str]) -> str:
    """Return up to MOST_SHOWN names as text, and the number of the others."""
    more = len(names) - MOST_SHOWN
    return ", ".join(names[:MOST_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _tracks(found: Mapping[str, Samples], notes: list[str]) -> dict[str, Track]:
    """Return signal name -> track, each from the first topic of SOURCES that has numbers for it."""
    late = _recording_delay(found)
    tracks: dict[str, Track] = {}

    def add(names: tuple[str, ...], topic: str, columns: Floats) -> None:
        """Add columns (T, k) of a topic as tracks of the named signals, if at least two rows are finite."""
        # Of a topic that says nothing of it, nothing.
        if np.isfinite(columns).all(axis=1).sum() >= 2:
            times = _sample_times(found[topic], late)
            for name, column in zip(names, columns.T, strict=True):
                tracks.setdefault(name, Track(times, column))

    for source in SOURCES:
        topic = source.topic
        if topic not in found:
            continue
        rows = np.array(found[topic].rows, np.float64)
        if topic in ("odom", "local_position/odom"):
            attitude = rotation(rows[:, :4])
            add(("roll", "pitch", "yaw"), topic, euler(attitude))
            velocity = np.einsum("nij,nj->ni", attitude, rows[:, 4:7] * _FLIP)
            add(("velocity_north", "velocity_east", "velocity_down"), topic, velocity)
            if "imu/data" not in found:
                add(("roll_rate", "pitch_rate", "yaw_rate"), topic, rows[:, 7:10] * _FLIP)
        elif topic == "imu/data":
            add(("roll", "pitch", "yaw"), topic, euler(rotation(rows[:, :4])))
            add(("roll_rate", "pitch_rate", "yaw_rate"), topic, rows[:, 4:7] * _FLIP)
        elif topic in ("pose", "local_position/pose"):
            add(("roll", "pitch", "yaw"), topic, euler(rotation(rows)))
        elif topic in ("velocity", "local_position/velocity_local"):
            add(("velocity_north", "velocity_east", "velocity_down"), topic, rows[:, [1, 0, 2]] * [1.0, 1.0, -1.0])
        elif topic == "battery":
            add(("battery",), topic, rows)
        elif topic.startswith("setpoint_raw"):
            add(("roll_command", "pitch_command"), topic, euler(rotation(rows[:, :4]))[:, :2])
            add(("yaw_rate_command",), topic, -rows[:, 4:5])
            add(("throttle",), topic, rows[:, 5:6])
        elif topic == "setpoint_attitude/attitude":
            add(("roll_command", "pitch_command"), topic, euler(rotation(rows))[:, :2])
        elif topic == "setpoint_attitude/cmd_vel":
            add(("yaw_rate_command",), topic, -rows)
        else:
            add(("throttle",), topic, rows)
    if late:
        notes.append(f"messages without a stamp are taken to be from {late:.3g} s before they were recorded")
    return tracks


def _recording_delay(found: Mapping[str, Samples]) -> float:
    """Return the median delay [s] from a message's stamp to its recording; meaningless for simulated stamps."""
    gaps = [
        np.median(np.array(samples.received) - np.array(samples.stamped))
        for samples in found.values()
        if np.isfinite(samples.stamped).all() and any(samples.stamped)
    ]
    return float(np.median(gaps)) if gaps else 0.0


def _sample_times(samples: Samples, late: float) -> Floats:
    """Return the times (T,) [s] of messages: their stamps, or times of recording minus the delay ``late``."""
    stamped = np.array(samples.stamped)
    return stamped if np.isfinite(stamped).all() and stamped.any() else np.array(samples.received) - late


# Forward, left, up to forward, right, down.
_FLIP = np.array([1.0, -1.0, -1.0])
# East, north, up to north, east, down.
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def rotation(quaternion: Floats) -> Floats:
    """Convert ROS quaternions x, y, z, w (n, 4) FLU to ENU to matrices (n, 3, 3) FRD to NED; NaN for zeros."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    matrix = np.moveaxis(np.array(rows), -1, 0)
    turned: Floats = _SWAP @ matrix * _FLIP
    return turned


def euler(matrix: Floats) -> Floats:
    """Return roll, pitch and yaw (n, 3) [rad] of rotation matrices (n, 3, 3) from FRD to NED."""
    return np.stack(
        [
            np.arctan2(matrix[:, 2, 1], matrix[:, 2, 2]),
            -np.arcsin(np.clip(matrix[:, 2, 0], -1.0, 1.0)),
            np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0]),
        ],
        axis=1,
    )
