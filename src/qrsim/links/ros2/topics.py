"""Topics of vehicles: what is published as which type, how often, and what its numbers are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from qrsim.links.ros2 import numbers as n
from qrsim.links.ros2.names import MAP, base_link, gnss_link, range_link
from qrsim.links.shared import sight as s

# How writers and readers deal with loss and with those who come late.
Quality = Literal["sensor", "reliable", "clock", "static", "command", "fmu", "request", "service"]
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
# Where a message is about in a vehicle's frames.
Frame = Literal["map", "base_link", "gnss", "range"]


@dataclass(frozen=True)
class Kind:
    """A topic of every vehicle that has what it takes.

    Attributes:
        topic: after the vehicle's namespace.
        type: of the message.
        quality: of service.
        frame: of its header.
        puts: dotted path of numbers and the columns (numbers.py) that are put there; paths that the type of a
            distribution does not have are left out.
        needs: columns without whose numbers nothing is published.
        sensor: column (shared/sight.py) whose sensor sets the pace; None: every tick.
        every: seconds between messages where no sensor sets the pace; 0: each tick.
        child: whether it names base_link as its child frame.
    """

    topic: str
    type: str
    quality: Quality
    frame: Frame
    puts: tuple[tuple[str, tuple[int, ...]], ...]
    needs: tuple[int, ...]
    sensor: int | None = None
    every: float = 0.0
    child: bool = False


def _three_columns(first: int) -> tuple[int, ...]:
    """Return three consecutive column numbers, ``first`` and the next two."""
    return first, first + 1, first + 2


def _vector_fields(path: str, first: int) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return (field path, column numbers) of x, y and z of a vector, which are in columns ``first`` to ``first +
    2``."""
    return tuple((f"{path}.{axis}", (column,)) for axis, column in zip("xyz", _three_columns(first), strict=True))


def _quaternion_fields(path: str, first: int) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return (field path, column numbers) of x, y, z and w of a quaternion, in columns ``first`` to ``first + 3``."""
    return (*_vector_fields(path, first), (f"{path}.w", (first + 3,)))


def _diagonal_fields(path: str, size: int, columns: tuple[int, ...]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return (field path, (column,)) for each diagonal element of a covariance (size, size), from the given columns."""
    return tuple((f"{path}[{i * (size + 1)}]", (column,)) for i, column in enumerate(columns))


_POSE_VARIANCES = _three_columns(n.POSITION_VARIANCE) + _three_columns(n.TURN_VARIANCE)
_TWIST_VARIANCES = _three_columns(n.VELOCITY_VARIANCE) + _three_columns(n.ODOM_RATES_VARIANCE)
_ODOM = (
    *_vector_fields("pose.pose.position", n.POSITION),
    *_quaternion_fields("pose.pose.orientation", n.ORIENTATION),
    *_diagonal_fields("pose.covariance", 6, _POSE_VARIANCES),
    *_vector_fields("twist.twist.linear", n.BODY_VELOCITY),
    *_vector_fields("twist.twist.angular", n.ODOM_RATES),
    *_diagonal_fields("twist.covariance", 6, _TWIST_VARIANCES),
)
_KNOWN_POSE = (n.POSITION, n.ORIENTATION)
FIX = Kind(
    "fix",
    "sensor_msgs/msg/NavSatFix",
    "sensor",
    "gnss",
    (
        ("latitude", (n.PLACE,)),
        ("longitude", (n.PLACE + 1,)),
        ("altitude", (n.PLACE + 2,)),
        *_diagonal_fields("position_covariance", 3, _three_columns(n.PLACE_VARIANCE)),
    ),
    (n.PLACE,),
    s.FIX_POSITION,
)
IMU = Kind(
    "imu/data",
    "sensor_msgs/msg/Imu",
    "sensor",
    "base_link",
    (
        *_quaternion_fields("orientation", n.IMU_ORIENTATION),
        *_diagonal_fields("orientation_covariance", 3, _three_columns(n.IMU_VARIANCE)),
        *_vector_fields("angular_velocity", n.RATES),
        *_vector_fields("linear_acceleration", n.FORCE),
    ),
    (),
    s.RATES,
)
MAG = Kind(
    "mag",
    "sensor_msgs/msg/MagneticField",
    "sensor",
    "base_link",
    _vector_fields("magnetic_field", n.FIELD),
    (n.FIELD,),
    s.FIELD,
)
BARO = Kind(
    "baro",
    "sensor_msgs/msg/FluidPressure",
    "sensor",
    "base_link",
    (("fluid_pressure", (n.PRESSURE,)),),
    (n.PRESSURE,),
    s.PRESSURE,
)
HEIGHT = Kind("baro/height", "std_msgs/msg/Float64", "sensor", "map", (("data", (n.HEIGHT,)),), (n.HEIGHT,), s.HEIGHT)
RANGE = Kind(
    "range",
    "sensor_msgs/msg/Range",
    "sensor",
    "range",
    (("range", (n.RANGE,)), ("variance", (n.RANGE_VARIANCE,))),
    (n.RANGE,),
    s.RANGE,
)
AIRSPEED = Kind(
    "airspeed", "std_msgs/msg/Float64", "sensor", "base_link", (("data", (n.AIRSPEED,)),), (n.AIRSPEED,), s.AIRSPEED
)
DIFFERENTIAL = Kind(
    "airspeed/pressure",
    "sensor_msgs/msg/FluidPressure",
    "sensor",
    "base_link",
    (("fluid_pressure", (n.DIFFERENTIAL,)),),
    (n.DIFFERENTIAL,),
    s.DIFFERENTIAL,
)
FLOW = Kind(
    "optical_flow/flow",
    "geometry_msgs/msg/Vector3Stamped",
    "sensor",
    "base_link",
    _vector_fields("vector", n.FLOW),
    (n.FLOW,),
    s.FLOW,
)
FLOW_TURN = Kind(
    "optical_flow/rotation",
    "geometry_msgs/msg/Vector3Stamped",
    "sensor",
    "base_link",
    _vector_fields("vector", n.FLOW_TURN),
    (n.FLOW_TURN,),
    s.FLOW_TURN,
)
BATTERY = Kind(
    "battery",
    "sensor_msgs/msg/BatteryState",
    "reliable",
    "base_link",
    (("voltage", (n.VOLTAGE,)), ("percentage", (n.CHARGE,))),
    (n.CHARGE,),
    every=0.5,
)
ODOM = Kind("odom", "nav_msgs/msg/Odometry", "reliable", "map", _ODOM, _KNOWN_POSE, child=True)
POSE = Kind(
    "pose",
    "geometry_msgs/msg/PoseStamped",
    "reliable",
    "map",
    (*_vector_fields("pose.position", n.POSITION), *_quaternion_fields("pose.orientation", n.ORIENTATION)),
    _KNOWN_POSE,
)
VELOCITY = Kind(
    "velocity",
    "geometry_msgs/msg/TwistStamped",
    "reliable",
    "map",
    (*_vector_fields("twist.linear", n.VELOCITY), *_vector_fields("twist.angular", n.MAP_RATES)),
    (n.VELOCITY, n.MAP_RATES),
)
WIND = Kind("wind", "geometry_msgs/msg/Vector3Stamped", "reliable", "map", _vector_fields("vector", n.WIND), (n.WIND,))
# From the estimates and the readings, in the order in which they go out.
KINDS = (
    FIX, IMU, MAG, BARO, HEIGHT, RANGE, AIRSPEED, DIFFERENTIAL, FLOW, FLOW_TURN, BATTERY, ODOM, POSE, VELOCITY, WIND,
)  # fmt: skip
# From the truth.
TRUE_KINDS = (
    Kind("ground_truth/odom", "nav_msgs/msg/Odometry", "reliable", "map", _ODOM, _KNOWN_POSE, child=True),
    Kind(
        "ground_truth/wind",
        "geometry_msgs/msg/Vector3Stamped",
        "reliable",
        "map",
        _vector_fields("vector", n.WIND),
        (n.WIND,),
    ),
)
# What its controller asks a quadrotor for, of recorded runs only: a live world takes these topics as commands.
ASKED_KINDS = (
    Kind(
        "setpoint_attitude/attitude",
        "geometry_msgs/msg/PoseStamped",
        "reliable",
        "map",
        _quaternion_fields("pose.orientation", n.ASKED_ORIENTATION),
        (n.ASKED_ORIENTATION,),
    ),
    Kind(
        "setpoint_attitude/cmd_vel",
        "geometry_msgs/msg/TwistStamped",
        "reliable",
        "base_link",
        (("twist.angular.z", (n.ASKED_YAW_RATE,)),),
        (n.ASKED_YAW_RATE,),
    ),
    Kind(
        "setpoint_attitude/thrust",
        "std_msgs/msg/Float32",
        "reliable",
        "base_link",
        (("data", (n.ASKED_THROTTLE,)),),
        (n.ASKED_THROTTLE,),
    ),
)
STATE, STATE_TYPE = "state", "std_msgs/msg/String"


def frame_of(kind: Kind, namespace: str) -> str:
    """Return the frame_id of a vehicle's messages on a kind of topic."""
    if kind.frame == "map":
        return MAP
    return {"base_link": base_link, "gnss": gnss_link, "range": range_link}[kind.frame](namespace)


@dataclass(frozen=True)
class Topic:
    """A topic by its name in ROS, such as "/uav1/imu/data"."""

    name: str
    type: str
    quality: Quality


CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", "clock")
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", "reliable")
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", "static")
CONTROL = Topic("/qrsim/control", "std_msgs/msg/String", "reliable")
STATUS = Topic("/qrsim/status", "std_msgs/msg/String", "reliable")
