"""Best-effort publishers fly vehicles; qualities of service that do not match are reported as rclcpp does."""

import os
import time

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.participant import Participant
from qrsim.links.ros2.topics import CONTROL, Topic
from qrsim.links.ros2.typestore import Types

TYPES = Types("jazzy")
DOMAIN = 100 + (os.getpid() + 25) % 100
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
TWIST, IMU = "geometry_msgs/msg/Twist", "sensor_msgs/msg/Imu"


@pytest.fixture(scope="module")
def nodes():
    """Two nodes of the same domain: the simulator's and another one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", ALONE)
        yield Participant(TYPES, DOMAIN), Participant(TYPES, DOMAIN, "other")


def until(done, patience=10.0):
    """Wait until something is so, and return it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if found := done():
            return found
        time.sleep(0.01)
    raise AssertionError("it did not come")


@pytest.mark.parametrize("quality", ["sensor", "reliable"])
def test_commands_are_heard_of_both_kinds_of_publishers(nodes, quality):
    own, other = nodes
    topic = f"/{quality}/cmd_vel"
    reader = own.reader(Topic(topic, TWIST, "command"))
    writer = other.writer(Topic(topic, TWIST, quality))
    until(writer.entity.get_matched_subscriptions)
    twist = empty(TYPES, TWIST)
    twist.linear.x = 2.0
    writer.write(TYPES.encode(twist))
    assert until(reader.take)[0].linear.x == 2.0


def test_a_message_that_cannot_be_decoded_is_dropped(nodes):
    own, other = nodes
    topic = Topic("/garbage", "std_msgs/msg/String", "reliable")
    reader, writer = own.reader(topic), other.writer(topic)
    until(writer.entity.get_matched_subscriptions)
    writer.write(b"\0\1\0\0\5\0\0\0\xff\xff\xff\xff\0")
    writer.write(TYPES.encode(TYPES[topic.type]("sound")))
    assert [each.data for each in until(reader.take)] == ["sound"]


def test_qualities_that_do_not_match_are_reported_once(nodes):
    own, other = nodes
    own.reader(CONTROL)
    own.writer(Topic("/uav/imu/data", IMU, "sensor"))
    own.writer(Topic("/uav/odom", TWIST, "reliable"))
    for topic, quality in (("/uav/imu/data", "reliable"), ("/uav/imu/data", "reliable"), ("/uav/odom", "static")):
        other.reader(Topic(topic, IMU if "imu" in topic else TWIST, quality))
    other.writer(Topic(CONTROL.name, CONTROL.type, "sensor"))
    lines = []
    until(lambda: lines.extend(own.remarks()) or len(lines) == 3)
    time.sleep(0.1)
    lines += own.remarks()
    assert sorted(line.split("Last incompatible policy: ")[1].split()[0] for line in lines) == [
        "DURABILITY",
        "RELIABILITY",
        "RELIABILITY",
    ]
    assert any(line.startswith("/qrsim/control: new publisher discovered, offering incompatible") for line in lines)
    assert any(line.startswith("/uav/imu/data: new subscription discovered, requesting incom") for line in lines)
