"""Fly three vehicles of 'qrsim ros2' from another program, by the DDS library alone: pip install cyclonedds.

Each goes 10 m east of where it is, then forward for 3 seconds at 2 m/s, and holds its place. No ROS is needed, nor
qrsim in this process; an rclpy node would use the same topics.

    qrsim ros2 &
    python examples/ros2_flight.py            # or: ... DOMAIN
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# As rclpy does by default: reliable, the last ten.
QOS = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
)
STEP_EAST_M, FORWARD_M_S, FORWARD_S, NEAR_M = 10.0, 2.0, 3.0, 1.5


# What ros2 interface show prints, with the names that ROS gives types in DDS.
@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """Simulated time."""

    sec: int32 = 0
    nanosec: uint32 = 0


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """Time and frame of a message."""

    stamp: Time
    frame_id: str = "map"


@final
@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """Place [m]: east, north, up in the map."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@final
@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    """Three numbers along x, y, z."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@final
@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """Attitude."""

    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@final
@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    """Place and attitude."""

    position: Point
    orientation: Quaternion


@final
@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    """Pose at a time."""

    header: Header
    pose: Pose


@final
@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    """Velocity [m/s] and rates of turn [rad/s]."""

    linear: Vector3
    angular: Vector3


class Vehicle:
    """One vehicle, by the topics of its namespace."""

    def __init__(self, participant: DomainParticipant, name: str):
        self.name, self.pose, self.goal = name, None, None
        self._poses = DataReader(participant, Topic(participant, f"rt/{name}/pose", PoseStamped), qos=QOS)
        goals = Topic(participant, f"rt/{name}/setpoint_position/local", PoseStamped)
        self._goals = DataWriter(participant, goals, qos=QOS)
        self._motions = DataWriter(participant, Topic(participant, f"rt/{name}/cmd_vel", Twist), qos=QOS)

    def look(self) -> bool:
        """Take the newest pose, and return whether there is one."""
        for sample in self._poses.take(20):
            # When a writer leaves there is a sample without data.
            if isinstance(sample, PoseStamped):
                self.pose = sample
        return self.pose is not None

    @property
    def time(self) -> float:
        """Simulated time of the pose [s]."""
        return self.pose.header.stamp.sec + 1e-9 * self.pose.header.stamp.nanosec

    def go_east(self) -> None:
        """Go to a place 10 m east, with the heading that it has."""
        here = self.pose.pose.position
        self.goal = Point(here.x + STEP_EAST_M, here.y, here.z)

    def fly_there(self) -> bool:
        """Send the goal, and return whether the vehicle is near it."""
        here, goal = self.pose.pose.position, self.goal
        self._goals.write(PoseStamped(Header(Time()), Pose(goal, self.pose.pose.orientation)))
        return max(abs(here.x - goal.x), abs(here.y - goal.y), abs(here.z - goal.z)) < NEAR_M

    def forward(self) -> None:
        """Ask for a velocity: x is forward, y is left, z is up."""
        self._motions.write(Twist(Vector3(FORWARD_M_S), Vector3()))


def discovered(participant: DomainParticipant, count: int, patience: float = 20.0) -> list[str]:
    """Return the namespaces of vehicles: who publishes a pose, by ROS's names and types."""
    reader = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    alive = ReadCondition(reader, ViewState.Any | SampleState.Any | InstanceState.Alive)
    names: set[str] = set()
    end = time.monotonic() + patience
    while time.monotonic() < end and len(names) < count:
        for topic in reader.take(100, condition=alive):
            if topic.type_name == "geometry_msgs::msg::dds_::PoseStamped_" and topic.topic_name.endswith("/pose"):
                names.add(topic.topic_name.removeprefix("rt/").removesuffix("/pose"))
        time.sleep(0.1)
    return sorted(names)[:count]


def until(vehicles: list[Vehicle], done, patience: float = 60.0) -> bool:
    """Repeat 20 times a second until something is done by all vehicles."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        # Of all, not up to the first one that is not done: each is to hear of its goal.
        states = [vehicle.look() and done(vehicle) for vehicle in vehicles]
        if all(states):
            return True
        time.sleep(0.05)
    return False


def main() -> int:
    """Fly."""
    asked = argparse.ArgumentParser(description="Fly three vehicles of qrsim ros2 10 m east, then forward.")
    asked.add_argument(
        "domain", nargs="?", type=int, default=int(os.environ.get("ROS_DOMAIN_ID", "0")), help="0 to 232"
    )
    participant = DomainParticipant(asked.parse_args().domain)
    vehicles = [Vehicle(participant, name) for name in discovered(participant, 3)]
    print("vehicles:", ", ".join(vehicle.name for vehicle in vehicles))
    if len(vehicles) < 3 or not until(vehicles, lambda vehicle: True):
        return 1
    for vehicle in vehicles:
        vehicle.go_east()
    if not until(vehicles, Vehicle.fly_there):
        return 1
    print("all are 10 m further east")
    begin = {vehicle.name: vehicle.time for vehicle in vehicles}
    places = {vehicle.name: vehicle.pose.pose.position for vehicle in vehicles}

    def moved(vehicle: Vehicle) -> bool:
        vehicle.forward()
        return vehicle.time - begin[vehicle.name] > FORWARD_S

    if not until(vehicles, moved):
        return 1
    for vehicle in vehicles:
        here, there = vehicle.pose.pose.position, places[vehicle.name]
        way = ((here.x - there.x) ** 2 + (here.y - there.y) ** 2) ** 0.5
        print(f"{vehicle.name}: {way:.1f} m forward")
    return 0


if __name__ == "__main__":
    sys.exit(main())
