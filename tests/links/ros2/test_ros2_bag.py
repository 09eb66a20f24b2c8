"""``qrsim export --format rosbag2``: bags that others read, with the numbers of the run."""

import json
import math
from functools import cache

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim import cli
from qrsim.runs import open_run

SCENARIO = """
name: pair
duration: 3
site: {latitude_deg: 51.7, longitude_deg: -0.2, height: 40}
world: {wind: {type: log_shear, speed_20ft: 3.0, wind_from_deg: 270}}
fleets:
  uav:
    controller: {type: cascade, feed: truth}
    battery: {type: lithium_polymer}
    sensors: {imu: {type: imu, period: 0.04}, gnss: {type: gnss}, late: {type: barometer, delay: 1.0, period: 0.1}}
    vehicles: [{position_ned: [0, 0, -20], waypoints_ned: [[60, 30, -20]]}, {position_ned: [5, 40, -20]}]
"""


@cache
def store(distro: str = "jazzy"):
    """The messages of a distribution, which take a while to import."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[f"ROS2_{distro.upper()}"])


def reader_of(bag):
    from rosbags.rosbag2 import Reader

    return Reader(bag)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The run, and the folder of its bag."""
    folder = tmp_path_factory.mktemp("bag")
    (folder / "pair.yaml").write_text(SCENARIO)
    assert cli.main(["run", str(folder / "pair.yaml"), "--out", str(folder / "run"), "--no-figure"]) == 0
    assert cli.main(["export", str(folder / "run"), "--format", "rosbag2", "--json"]) == 0
    return open_run(folder / "run"), folder / "run" / "export" / "run.rosbag2"


@pytest.fixture(scope="module")
def messages(exported):
    """By topic, times [ns] and messages."""
    found = {}
    with reader_of(exported[1]) as reader:
        for connection, time, cdr in reader.messages():
            message = store().deserialize_cdr(cdr, connection.msgtype)
            assert bytes(store().serialize_cdr(message, connection.msgtype)) == bytes(cdr)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def stamp(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_topics_are_those_of_a_live_world(messages):
    own = {name.removeprefix("/uav_0/") for name in messages if name.startswith("/uav_0/")}
    assert own == {
        "imu/data", "fix", "baro/height", "battery", "odom", "pose", "velocity", "ground_truth/odom",
        "ground_truth/wind", "setpoint_attitude/attitude", "setpoint_attitude/cmd_vel", "setpoint_attitude/thrust",
    }  # fmt: skip
    assert {name for name in messages if not name.startswith("/uav_")} == {"/tf", "/tf_static"}


def test_the_truth_of_the_bag_is_that_of_the_run(exported, messages):
    truth = exported[0]["truth"]
    found = messages["/uav_1/ground_truth/odom"]
    assert [time for time, _ in found] == [20_000_000 * tick for tick in range(151)]
    for tick in (0, 70, 150):
        message = found[tick][1]
        place = message.pose.pose.position
        north, east, down = (float(truth[f"position_ned.{axis}"][tick, 1]) for axis in "xyz")
        assert (place.x, place.y, place.z) == pytest.approx((east, north, -down))
        forward, right, below = (float(truth[f"velocity_body.{axis}"][tick, 1]) for axis in "xyz")
        speed = message.twist.twist.linear
        assert (speed.x, speed.y, speed.z) == pytest.approx((forward, -right, -below), abs=1e-6)
        assert message.child_frame_id == "uav_1/base_link"
        # Its controller is fed with the truth.
        assert messages["/uav_1/odom"][tick][1].pose.pose == message.pose.pose


def test_readings_of_the_bag_are_those_of_the_run(exported, messages):
    measured = exported[0]["measurements"]
    found = messages["/uav_0/imu/data"]
    # Every second tick.
    assert [time for time, _ in found] == [40_000_000 * tick for tick in range(76)]
    for number in (0, 40, 75):
        force = found[number][1].linear_acceleration
        x, y, z = (float(measured[f"imu.specific_force.{axis}"][2 * number, 0]) for axis in "xyz")
        assert (force.x, force.y, force.z) == pytest.approx((x, -y, -z))
    heights = messages["/uav_0/baro/height"]
    recorded = measured["late.height"][:, 0]
    assert len(heights) == 1 + np.count_nonzero(np.diff(recorded))
    assert heights[-1][1].data == pytest.approx(float(recorded[-1]))


def test_fixes_of_the_bag_are_those_of_the_run(exported, messages):
    measured = exported[0]["measurements"]
    fixes = messages["/uav_0/fix"]
    assert len(fixes) >= 10
    time, fix = fixes[-1]
    tick = round(time / 20e6)
    assert stamp(fix) < time * 1e-9
    # A degree of latitude is 111.2 km there, at a height of 40 m and more.
    north = float(measured["gnss.position_ned.x"][tick, 0])
    assert (fix.latitude - 51.7) * 111_250.0 == pytest.approx(north, abs=0.05)
    assert fix.altitude == pytest.approx(40.0 - float(measured["gnss.position_ned.z"][tick, 0]), abs=0.01)


def test_battery_of_the_bag(exported, messages):
    charges = exported[0]["commands"]["battery"]
    assert [time for time, _ in messages["/uav_0/battery"]] == [500_000_000 * i for i in range(7)]
    message = messages["/uav_0/battery"][4][1]
    assert message.percentage == pytest.approx(float(charges[100, 0]))
    assert math.isnan(message.voltage)


def test_set_points_of_the_bag_are_the_commands_of_the_run(exported, messages):
    """A row of the run has the command of the step that ends with it, which was asked for at its beginning."""
    commands = exported[0]["commands"]
    aims, rates, thrusts = (messages[f"/uav_0/setpoint_attitude/{name}"] for name in ("attitude", "cmd_vel", "thrust"))
    for found in (aims, rates, thrusts):
        assert [time for time, _ in found] == [20_000_000 * tick for tick in range(150)]
    for tick in (1, 60, 150):
        pitch, roll, throttle, rate = (
            float(commands[name][tick, 0]) for name in ("pitch", "roll", "throttle", "yaw_rate")
        )
        x, y, z, w = (getattr(aims[tick - 1][1].pose.orientation, axis) for axis in "xyzw")
        # Of FLU in ENU: roll about the axis ahead as of FRD in NED, pitch about the one to the left, and not the right.
        assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(roll, abs=1e-6)
        assert -math.asin(2 * (w * y - z * x)) == pytest.approx(pitch, abs=1e-6)
        assert thrusts[tick - 1][1].data == pytest.approx(throttle)
        assert rates[tick - 1][1].twist.angular.z == pytest.approx(-rate)


@pytest.mark.parametrize("distro", ["humble", "kilted"])
def test_bags_of_other_distributions(distro, exported, tmp_path):
    out = tmp_path / distro
    words = ["--distro", distro, "--out", str(out)]
    assert cli.main(["export", str(exported[0].folder), "--format", "rosbag2", *words]) == 0
    assert f"version: {8 if distro == 'humble' else 9}" in (out / "metadata.yaml").read_text()
    types, count = store(distro), 0
    with reader_of(out) as reader:
        for connection, _, cdr in reader.messages():
            message = types.deserialize_cdr(cdr, connection.msgtype)
            assert bytes(types.serialize_cdr(message, connection.msgtype)) == bytes(cdr)
            count += 1
    assert count > 2000


def test_other_formats_are_of_no_distribution(exported, capsys):
    folder = str(exported[0].folder)
    assert cli.main(["export", folder, "--format", "csv", "--distro", "humble"]) == 2
    assert "--distro humble: only rosbag2 is of a distribution of ROS 2, not csv" in capsys.readouterr().err
    assert cli.main(["export", folder, "--format", "rosbag2", "--distro", "humbel", "--force"]) == 2
    assert "did you mean 'humble'?" in capsys.readouterr().err


def test_metadata_and_storage(exported):
    from mcap.reader import make_reader

    folder = exported[1]
    assert {path.name for path in folder.iterdir()} == {"metadata.yaml", "run.rosbag2.mcap"}
    text = (folder / "metadata.yaml").read_text()
    assert "version: 9" in text
    assert store().hash_rihs01("sensor_msgs/msg/Imu") in text
    with (folder / "run.rosbag2.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        channels = {channel.topic: channel for channel in reader.get_summary().channels.values()}
    assert channels["/uav_0/imu/data"].message_encoding == "cdr"
    assert "best_effort" in json.dumps(channels["/uav_0/imu/data"].metadata)


def test_another_library_reads_it(exported, messages):
    reading = pytest.importorskip("mcap_ros2.reader")
    count = 0
    for each in reading.read_ros2_messages(str(exported[1] / "run.rosbag2.mcap")):
        if each.channel.topic == "/uav_1/ground_truth/odom":
            mine = messages[each.channel.topic][count][1].pose.pose.position
            assert each.ros_msg.pose.pose.position.x == mine.x
            count += 1
    assert count == 151


def test_what_is_there_is_not_overwritten(exported, tmp_path, capsys):
    folder = str(exported[0].folder)
    assert cli.main(["export", folder, "--format", "rosbag2"]) == 2
    assert "exists; choose another --out, or --force" in capsys.readouterr().err
    (tmp_path / "mine").mkdir()
    assert cli.main(["export", folder, "--format", "rosbag2", "--force", "--out", str(tmp_path / "mine")]) == 2
    assert "is no bag, and is not overwritten" in capsys.readouterr().err
    out = str(tmp_path / "few")
    assert cli.main(["export", folder, "--format", "rosbag2", "--every", "50", "--out", out]) == 0
    assert "messages" in capsys.readouterr().out
    assert cli.main(["export", folder, "--format", "rosbag2", "--every", "50", "--out", out, "--force"]) == 0
    with reader_of(tmp_path / "few") as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts["/uav_0/odom"] == 4
    assert counts["/uav_0/imu/data"] == 4
