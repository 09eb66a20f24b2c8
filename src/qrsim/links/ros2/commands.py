"""What other nodes ask of a vehicle, as it is asked: in the axes of the vehicle's controllers, but not yet flown."""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from qrsim.errors import UsageError
from qrsim.links.ros2 import Message
from qrsim.links.ros2.frames import angles_ned_frd
from qrsim.links.ros2.names import MAP
from qrsim.links.ros2.topics import Topic

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
POSE_STAMPED, FLOAT = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float32"
CMD_VEL, VELOCITY = "cmd_vel", "setpoint_velocity/cmd_vel"
POSITION, ATTITUDE, THRUST = "setpoint_position/local", "setpoint_attitude/attitude", "setpoint_attitude/thrust"
# Topic, type, and kind of order that the vehicle must take.
TAKEN = (
    (CMD_VEL, TWIST, "velocity"),
    (CMD_VEL, TWIST_STAMPED, "velocity"),
    (VELOCITY, TWIST_STAMPED, "velocity"),
    (POSITION, POSE_STAMPED, "waypoint"),
    (ATTITUDE, POSE_STAMPED, "attitude"),
    (THRUST, FLOAT, "attitude"),
)


@dataclass(frozen=True)
class Motion:
    """A velocity and a rate of turn.

    Attributes:
        velocity: NED [m/s], or forward, right and down of the heading.
        yaw_rate: clockwise from above [rad/s].
        of_heading: whether the velocity is that of the heading.
    """

    velocity: tuple[float, float, float]
    yaw_rate: float
    of_heading: bool


@dataclass(frozen=True)
class Place:
    """A place to go to: NED [m], heading from north [rad]; None: as it is now."""

    position_ned: tuple[float, float, float]
    yaw: float | None


@dataclass(frozen=True)
class Tilt:
    """An attitude: roll, pitch, yaw [rad] of FRD axes in NED."""

    angles: tuple[float, float, float]


@dataclass(frozen=True)
class Thrust:
    """A throttle, from 0 to 1."""

    throttle: float


Wish = Motion | Place | Tilt | Thrust


def topics_of(namespace: str, kinds: Container[str]) -> list[tuple[str, Topic]]:
    """Return (name after the namespace, topic) of each command topic for a vehicle that takes orders of these
    ``kinds``."""
    return [(own, Topic(f"/{namespace}/{own}", kind, "command")) for own, kind, order in TAKEN if order in kinds]


def wish_of(own: str, message: Message) -> Wish:
    """Convert a message on the command topic ``own`` to the request that it makes; raises UsageError for an invalid
    one.

    Args:
        own: name of its topic after the namespace.
        message: of rosbags.

    Raises:
        UsageError: a number is not finite or out of its range, or the frame is not the map.
    """
    if own in (CMD_VEL, VELOCITY):
        twist = message if message.__msgtype__ == TWIST else message.twist
        if own == VELOCITY:
            _check_frame(own, message.header.frame_id)
        return _motion_of(own, twist)
    if own == THRUST:
        throttle = _finite(own, "data", message.data)
        if not 0.0 <= throttle <= 1.0:
            raise UsageError(f"{own}: data is {throttle:g}; expected 0 to 1")
        return Thrust(throttle)
    _check_frame(own, message.header.frame_id)
    angles = _angles(own, message.pose.orientation)
    if own == ATTITUDE:
        if angles is None:
            raise UsageError(f"{own}: the orientation is 0, 0, 0, 0")
        return Tilt(angles)
    east, north, up = _vector(own, "pose.position", message.pose.position)
    return Place((north, east, -up), None if angles is None else angles[2])


def _motion_of(own: str, twist: Message) -> Motion:
    """Convert a Twist on topic ``own`` to a velocity, FRD or NED [m/s], and a yaw rate [rad/s]."""
    x, y, z = _vector(own, "linear", twist.linear)
    rate = -_vector(own, "angular", twist.angular)[2]
    return Motion((x, -y, -z), rate, True) if own == CMD_VEL else Motion((y, x, -z), rate, False)


def _angles(own: str, quaternion: object) -> tuple[float, float, float] | None:
    """Return roll, pitch, yaw [rad], FRD to NED, of a quaternion in a message on topic ``own``; None for all zeros."""
    numbers = [_finite(own, f"orientation.{axis}", value) for axis, value in _axes(quaternion, "xyzw")]
    if math.hypot(*numbers) < 1e-6:
        return None
    roll, pitch, yaw = angles_ned_frd(np.array(numbers)).tolist()
    return roll, pitch, yaw


def _vector(own: str, name: str, vector: object) -> tuple[float, float, float]:
    """Return x, y, z of a message's vector; raises UsageError, naming topic and field, if one is not finite."""
    x, y, z = (_finite(own, f"{name}.{axis}", value) for axis, value in _axes(vector, "xyz"))
    return x, y, z


def _axes(record: object, names: str) -> list[tuple[str, float]]:
    """Return (name, value) of a message's one-letter fields, such as "x", "y" and "z" for ``names`` "xyz"."""
    return [(axis, float(getattr(record, axis))) for axis in names]


def _finite(own: str, name: str, value: float) -> float:
    """Return a number unchanged; raises UsageError, naming topic and field, if it is not finite."""
    if not math.isfinite(value):
        raise UsageError(f"{own}: {name} is {value:g}, which is not finite")
    return float(value)


def _check_frame(own: str, frame: str) -> None:
    """Raise UsageError, naming the topic, unless a message's frame_id is "map" or empty."""
    if frame not in ("", MAP):
        raise UsageError(f"{own}: frame '{frame[:60]}'; expected '{MAP}', or none")
