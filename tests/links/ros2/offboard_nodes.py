"""Offboard nodes on the DDS library alone: types of the published definitions, services as rmw_cyclonedds has them.

``python offboard_nodes.py px4|mavros DOMAIN NAMESPACE`` flies one vehicle up, east and down, and prints what it hears.
Nothing of qrsim is imported.
"""

from __future__ import annotations

import itertools
import sys
import time
from typing import Any

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.idl.annotations import final
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 40.0
# Fields of the published definitions: std_msgs, geometry_msgs, mavros_msgs 2.12, px4_msgs release/1.15.
DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec, uint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/msg/Time stamp, string frame_id",
    "geometry_msgs/msg/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/msg/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/msg/Point position, geometry_msgs/msg/Quaternion orientation",
    "geometry_msgs/msg/PoseStamped": "std_msgs/msg/Header header, geometry_msgs/msg/Pose pose",
    "mavros_msgs/msg/State": "std_msgs/msg/Header header, bool connected, bool armed, bool guided, bool manual_input, "
    "string mode, uint8 system_status",
    "mavros_msgs/srv/CommandBool_Request": "uint64 guid, int64 seq, bool value",
    "mavros_msgs/srv/CommandBool_Response": "uint64 guid, int64 seq, bool success, uint8 result",
    "mavros_msgs/srv/SetMode_Request": "uint64 guid, int64 seq, uint8 base_mode, string custom_mode",
    "mavros_msgs/srv/SetMode_Response": "uint64 guid, int64 seq, bool mode_sent",
    "px4_msgs/msg/OffboardControlMode": "uint64 timestamp, bool position, bool velocity, bool acceleration, "
    "bool attitude, bool body_rate, bool thrust_and_torque, bool direct_actuator",
    "px4_msgs/msg/TrajectorySetpoint": "uint64 timestamp, float32[3] position, float32[3] velocity, "
    "float32[3] acceleration, float32[3] jerk, float32 yaw, float32 yawspeed",
    "px4_msgs/msg/VehicleCommand": "uint64 timestamp, float32 param1, float32 param2, float32 param3, float32 param4, "
    "float64 param5, float64 param6, float32 param7, uint32 command, uint8 target_system, uint8 target_component, "
    "uint8 source_system, uint16 source_component, uint8 confirmation, bool from_external",
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp, uint64 timestamp_sample, uint8 pose_frame, float32[3] position, "
    "float32[4] q, uint8 velocity_frame, float32[3] velocity, float32[3] angular_velocity, "
    "float32[3] position_variance, float32[3] orientation_variance, float32[3] velocity_variance, "
    "uint8 reset_counter, int8 quality",
    "px4_msgs/msg/VehicleControlMode": "uint64 timestamp, bool flag_armed, "
    "bool flag_multicopter_position_control_enabled, bool flag_control_manual_enabled, bool flag_control_auto_enabled, "
    "bool flag_control_offboard_enabled, bool flag_control_position_enabled, bool flag_control_velocity_enabled, "
    "bool flag_control_altitude_enabled, bool flag_control_climb_rate_enabled, bool flag_control_acceleration_enabled, "
    "bool flag_control_attitude_enabled, bool flag_control_rates_enabled, bool flag_control_allocation_enabled, "
    "bool flag_control_termination_enabled, uint8 source_id",
}
BASE = {
    "bool": bool, "string": str, "uint8": idl.uint8, "int8": idl.int8, "uint16": idl.uint16, "int32": idl.int32,
    "uint32": idl.uint32, "int64": idl.int64, "uint64": idl.uint64, "float32": idl.float32, "float64": idl.float64,
}  # fmt: skip
MADE: dict[str, Any] = {}


def type_of(name: str) -> Any:
    """Return the DDS type of a message."""
    if name not in MADE:
        fields = {}
        for field in DEFINITIONS[name].split(", "):
            kind, own = field.split()
            kind, _, size = kind.partition("[")
            base = BASE[kind] if kind in BASE else type_of(kind)
            fields[own] = idl.array[base, int(size[:-1])] if size else base
        package, group, last = name.split("/")
        MADE[name] = final(make_idl_struct(f"{last}_", f"{package}::{group}::dds_::{last}_", fields))
    return MADE[name]


def message(name: str, **values: Any) -> Any:
    """Return a message, whose other fields are zero."""
    found = {}
    for field in DEFINITIONS[name].split(", "):
        kind, own = field.split()
        kind, _, size = kind.partition("[")
        zero = message(kind) if kind in DEFINITIONS else {"string": "", "bool": False}.get(kind, 0)
        found[own] = values.get(own, [zero] * int(size[:-1]) if size else zero)
    return type_of(name)(**found)


class Node:
    """Publishers, subscribers and clients of services."""

    def __init__(self, domain: int):
        self._participant = DomainParticipant(domain)
        self._numbers = itertools.count(1)

    def _qos(self, reliable: bool, latched: bool) -> Any:
        return Qos(
            Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
            Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
            Policy.History.KeepLast(10),
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        )

    def _topic(self, name: str, kind: str) -> Any:
        return Topic(self._participant, name, type_of(kind))

    def publisher(self, name: str, kind: str, reliable: bool = True, latched: bool = False) -> Any:
        return DataWriter(self._participant, self._topic(f"rt{name}", kind), qos=self._qos(reliable, latched))

    def subscriber(self, name: str, kind: str, reliable: bool = False, latched: bool = False) -> Any:
        return DataReader(self._participant, self._topic(f"rt{name}", kind), qos=self._qos(reliable, latched))

    def call(self, name: str, kind: str, **values: Any) -> Any:
        """Call a service, and return its response."""
        qos = self._qos(True, False)
        writer = DataWriter(self._participant, self._topic(f"rq{name}Request", f"{kind}_Request"), qos=qos)
        reader = DataReader(self._participant, self._topic(f"rr{name}Reply", f"{kind}_Response"), qos=qos)
        until(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications())
        time.sleep(0.2)
        own = next(self._numbers)
        writer.write(message(f"{kind}_Request", guid=77, seq=own, **values))
        return until(lambda: [each for each in latest(reader, 10) if (each.guid, each.seq) == (77, own)])[0]


def latest(reader: Any, count: int = 1) -> list[Any]:
    return [each for each in reader.take(count) if not isinstance(each, InvalidSample)]


def until(done: Any, each: Any = lambda: None) -> Any:
    """Wait until something is so, and return it; ``each`` is called 20 times a second."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if found := done():
            return found
        each()
        time.sleep(0.05)
    raise SystemExit("it did not come")


def px4(node: Node, space: str, system: int) -> None:
    """Fly as px4_ros_com's offboard_control does, by its qualities of service, with a leg to the east."""
    kinds = "px4_msgs/msg/"
    modes, points, commands = (
        node.publisher(f"{space}/fmu/in/{name}", f"{kinds}{kind}", reliable=False, latched=True)
        for name, kind in (
            ("offboard_control_mode", "OffboardControlMode"),
            ("trajectory_setpoint", "TrajectorySetpoint"),
            ("vehicle_command", "VehicleCommand"),
        )
    )
    odometry = node.subscriber(f"{space}/fmu/out/vehicle_odometry", f"{kinds}VehicleOdometry", latched=True)
    control = node.subscriber(f"{space}/fmu/out/vehicle_control_mode", f"{kinds}VehicleControlMode", latched=True)
    seen: dict[str, Any] = {}

    def look() -> None:
        for name, reader in (("odometry", odometry), ("control", control)):
            for found in latest(reader, 10):
                seen[name] = found

    def command(number: int, *params: float) -> None:
        numbers = {f"param{i}": float(value) for i, value in enumerate(params, 1)}
        commands.write(message(f"{kinds}VehicleCommand", command=number, target_system=system, **numbers))

    def alive() -> None:
        modes.write(message(f"{kinds}OffboardControlMode", position=True))
        look()

    def place(x: float, y: float, z: float) -> None:
        alive()
        points.write(message(f"{kinds}TrajectorySetpoint", position=[x, y, z], yaw=0.0))

    def at(x: float, y: float, z: float) -> bool:
        found = seen["odometry"].position
        return max(abs(a - b) for a, b in zip(found, (x, y, z), strict=True)) < 0.4

    until(lambda: "odometry" in seen and "control" in seen, alive)
    for _ in range(15):
        alive()
        time.sleep(0.05)
    command(176, 1, 6)
    command(400, 1)
    until(lambda: seen["control"].flag_control_offboard_enabled and seen["control"].flag_armed, alive)
    print("offboard, armed")
    for goal in ((0.0, 0.0, -3.0), (0.0, 5.0, -3.0)):
        until(lambda goal=goal: at(*goal), lambda goal=goal: place(*goal))
        print("at", *goal)
    command(21)
    until(lambda: not seen["control"].flag_armed, look)
    print("landed")


def mavros(node: Node, space: str) -> None:
    """Fly as the tutorial of PX4 for mavros does, with a leg to the east, and land by its mode."""
    states = node.subscriber(f"{space}/mavros/state", "mavros_msgs/msg/State", reliable=True, latched=True)
    poses = node.subscriber(f"{space}/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped")
    points = node.publisher(f"{space}/mavros/setpoint_position/local", "geometry_msgs/msg/PoseStamped")
    seen: dict[str, Any] = {}

    def look() -> None:
        for name, reader in (("state", states), ("pose", poses)):
            for found in latest(reader, 10):
                seen[name] = found

    def place(x: float, y: float, z: float) -> None:
        look()
        pose = message("geometry_msgs/msg/PoseStamped")
        pose.pose.position = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
        points.write(pose)

    def at(x: float, y: float, z: float) -> bool:
        found = seen["pose"].pose.position
        return max(abs(found.x - x), abs(found.y - y), abs(found.z - z)) < 0.4

    until(lambda: "state" in seen and "pose" in seen and seen["state"].connected, look)
    for _ in range(20):
        place(0.0, 0.0, 3.0)
        time.sleep(0.05)
    while seen["state"].mode != "OFFBOARD":
        place(0.0, 0.0, 3.0)
        sent = node.call(f"{space}/mavros/set_mode", "mavros_msgs/srv/SetMode", custom_mode="OFFBOARD").mode_sent
        print("mode sent", sent)
        end = time.monotonic() + 1.0
        while time.monotonic() < end and seen["state"].mode != "OFFBOARD":
            place(0.0, 0.0, 3.0)
            time.sleep(0.05)
    while not seen["state"].armed:
        place(0.0, 0.0, 3.0)
        response = node.call(f"{space}/mavros/cmd/arming", "mavros_msgs/srv/CommandBool", value=True)
        print("arming", response.success, response.result)
        until(lambda: seen["state"].armed, lambda: place(0.0, 0.0, 3.0))
    print("offboard, armed")
    for goal in ((0.0, 0.0, 3.0), (5.0, 0.0, 3.0)):
        until(lambda goal=goal: at(*goal), lambda goal=goal: place(*goal))
        print("at", *goal)
    node.call(f"{space}/mavros/set_mode", "mavros_msgs/srv/SetMode", custom_mode="AUTO.LAND")
    until(lambda: not seen["state"].armed, look)
    print("landed")


if __name__ == "__main__":
    api, number, namespace = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    if api == "px4":
        px4(Node(number), namespace, 2 if namespace else 1)
    else:
        mavros(Node(number), namespace)
