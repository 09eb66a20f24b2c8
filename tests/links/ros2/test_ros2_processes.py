"""``qrsim ros2`` and another process that has the DDS library alone: topics, bytes, flight, control."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.qos import Policy

from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.participant import Participant
from qrsim.links.ros2.topics import CONTROL, STATUS, Topic
from qrsim.links.ros2.typestore import Types, dds_name

pytestmark = pytest.mark.long
EXAMPLE = Path(__file__).parents[3] / "examples" / "ros2_flight.py"
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
TYPES = Types("jazzy")
# Of its own for every run, so that two at once do not meet.
DOMAIN = 100 + os.getpid() % 100
SCENARIO = """
name: trio
duration: 600
world: {wind: {type: log_shear, speed_20ft: 0.0, wind_from_deg: 0.0}}
fleets:
  uav:
    controller: {type: cascade, feed: truth}
    sensors: {imu: {type: imu}, gnss: {type: gnss}}
    vehicles: [{position_ned: [0, 0, -20]}, {position_ned: [20, 0, -20]}, {position_ned: [40, 0, -20]}]
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """The server, four times as fast as the wall clock, and its lines."""
    folder = tmp_path_factory.mktemp("ros2")
    (folder / "trio.yaml").write_text(SCENARIO)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", ALONE)
        code = "import sys; from qrsim.cli import main; sys.exit(main())"
        words = ["ros2", str(folder / "trio.yaml"), "--domain", str(DOMAIN), "--realtime", "4", "--truth"]
        words += ["--injectable", "gnss"]
        with (folder / "lines").open("w") as lines:
            process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=lines, stderr=lines)
        try:
            until(lambda: "topics" in (folder / "lines").read_text() or process.poll() is not None, 60.0)
            assert process.poll() is None, (folder / "lines").read_text()
            yield folder / "lines"
        finally:
            process.terminate()
            process.wait(20.0)


def until(done, patience=20.0):
    """Wait until something is so, and return it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if found := done():
            return found
        time.sleep(0.02)
    raise AssertionError("it did not come")


def status(reader):
    """Return the next status."""
    return json.loads(until(reader.take)[-1].data)


def barrier_flight(file, domain, pause):
    """Return places of a vehicle in 40 ticks, each of which waits for a node that takes so long [s] to ask for it."""
    code = "import sys; from qrsim.cli import main; sys.exit(main())"
    words = ["ros2", str(file), "--domain", str(domain), "--pace", "barrier", "--truth", "--paused", "--hold", "5"]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL)
    try:
        node = Participant(TYPES, domain, "pilot")
        writers = [node.writer(Topic(f"/uav_{i}/cmd_vel", "geometry_msgs/msg/Twist", "command")) for i in range(3)]
        truth = node.reader(Topic("/uav_2/ground_truth/odom", "nav_msgs/msg/Odometry", "reliable"))
        control, heard = node.writer(CONTROL), node.reader(STATUS)
        until(lambda: heard.take() or process.poll() is not None, 60.0)
        time.sleep(1.0)
        twist, flight = empty(TYPES, "geometry_msgs/msg/Twist"), []

        def ask(i):
            for row, writer in enumerate(writers):
                twist.linear.x = 0.5 * (row + 1) + 0.01 * i
                writer.write(TYPES.encode(twist))

        ask(0)
        time.sleep(0.3)
        control.write(TYPES.encode(TYPES["std_msgs/msg/String"]("resume")))
        for i in range(1, 41):
            place = until(truth.take)[-1].pose.pose.position
            flight.append((place.x, place.y, place.z))
            time.sleep(pause)
            ask(i)
        return flight
    finally:
        process.terminate()
        process.wait(20.0)


@pytest.mark.nightly
def test_at_a_barrier_each_tick_waits_for_who_is_flown(tmp_path, monkeypatch):
    """Three vehicles, twice: they fly the same to the last bit, however long the node takes."""
    monkeypatch.setenv("CYCLONEDDS_URI", ALONE)
    (tmp_path / "trio.yaml").write_text(SCENARIO)
    fast, slow = (barrier_flight(tmp_path / "trio.yaml", DOMAIN - 60 + i, pause) for i, pause in ((0, 0.0), (1, 0.003)))
    assert fast == slow
    assert fast[-1] != fast[0]


def test_topics_are_discovered_by_their_names_types_and_hashes(server):
    participant = Participant(TYPES, DOMAIN, "listener")
    heard = BuiltinDataReader(participant._participant, BuiltinTopicDcpsPublication)
    known = {}

    def all_there():
        for each in heard.take(200):
            known[each.topic_name] = each.type_name, each.qos
        return "ros_discovery_info" in known and "rt/uav_2/ground_truth/wind" in known and "rt/qrsim/status" in known

    until(all_there)
    for name, kind in (
        ("/uav_0/imu/data", "sensor_msgs/msg/Imu"),
        ("/uav_1/fix", "sensor_msgs/msg/NavSatFix"),
        ("/uav_2/odom", "nav_msgs/msg/Odometry"),
        ("/tf", "tf2_msgs/msg/TFMessage"),
        ("/clock", "rosgraph_msgs/msg/Clock"),
        ("/tf_static", "tf2_msgs/msg/TFMessage"),
    ):
        found, qos = known[f"rt{name}"]
        assert found == dds_name(kind)
        assert qos[Policy.Userdata].data == f"typehash={TYPES.store.hash_rihs01(kind)};".encode()
    assert known["rt/uav_0/imu/data"][1][Policy.Reliability] == Policy.Reliability.BestEffort
    assert known["rt/tf_static"][1][Policy.Durability] == Policy.Durability.TransientLocal
    # Who reads late is told all the same: of the node, and of transforms that stay.
    info = participant.reader(Topic("/tf_static", "tf2_msgs/msg/TFMessage", "static"))
    names = {each.child_frame_id for each in until(info.take)[0].transforms}
    assert names == {"map", "uav_0/gnss", "uav_1/gnss", "uav_2/gnss"}


def test_samples_off_the_wire_are_what_rosbags_writes(server):
    participant = Participant(TYPES, DOMAIN, "bytes")
    topics = {
        "/uav_0/imu/data": ("sensor_msgs/msg/Imu", "sensor"),
        "/uav_0/fix": ("sensor_msgs/msg/NavSatFix", "sensor"),
        "/uav_0/odom": ("nav_msgs/msg/Odometry", "reliable"),
        "/clock": ("rosgraph_msgs/msg/Clock", "clock"),
        "/uav_0/pose": ("geometry_msgs/msg/PoseStamped", "reliable"),
        "/tf": ("tf2_msgs/msg/TFMessage", "reliable"),
        "/uav_0/state": ("std_msgs/msg/String", "reliable"),
    }
    for name, (kind, quality) in topics.items():
        reader = participant.reader(Topic(name, kind, quality))
        cdr = until(lambda entity=reader.entity: [each.cdr for each in entity.take(1) if hasattr(each, "cdr")])[0]
        written = TYPES.encode(TYPES.decode(cdr, kind))
        # On the wire a sample is filled up to a multiple of four.
        assert bytes(cdr) == written + bytes(len(cdr) - len(written)), name
        assert len(cdr) - len(written) in range(4)
        assert cdr[:2] == b"\0\1"


def test_another_process_flies_three_vehicles(server):
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), str(DOMAIN)], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert lines[:2] == ["vehicles: uav_0, uav_1, uav_2", "all are 10 m further east"]
    for line in lines[2:]:
        # 2 m/s for 3 s, from rest.
        assert 3.0 < float(line.split()[1]) < 9.0, line
    assert len(lines) == 5


def test_faults_and_wind_by_the_topic_of_control(server):
    participant = Participant(TYPES, DOMAIN, "saboteur")
    reader, writer = participant.reader(STATUS), participant.writer(CONTROL)
    fixes = participant.reader(Topic("/uav_0/fix", "sensor_msgs/msg/NavSatFix", "sensor"))
    wind = participant.reader(Topic("/uav_1/ground_truth/wind", "geometry_msgs/msg/Vector3Stamped", "reliable"))

    def say(text):
        writer.write(TYPES.encode(TYPES["std_msgs/msg/String"](text)))

    assert status(reader)["injected"] == []
    until(lambda: writer.entity.get_matched_subscriptions())
    until(fixes.take)
    say("inject gnss off uav_0 for 200")
    (fault,) = until(lambda: status(reader)["injected"])
    assert (fault["target"], fault["kind"], fault["vehicles"]) == ("gnss", "off", ["uav_0"])
    assert fault["end"] - fault["start"] == pytest.approx(200.0)
    # What does not exist is not sent: two simulated seconds without a fix.
    fixes.take()
    time.sleep(0.5)
    assert not fixes.take()
    say("clear gnss /uav_0")
    until(lambda: status(reader)["injected"] == [])
    until(fixes.take)
    say("wind 6 270")
    # At 20 ft, and more above: from the west, so to the east.
    until(lambda: any(each.vector.x > 6.0 for each in wind.take()))
    say("inject gns off")
    say("inject imu off")
    text = "/qrsim/control inject: target: there is no 'gns'; did you mean 'gnss'?"
    until(lambda: text in server.read_text() and "'imu' is not injectable; write" in server.read_text())


def test_pause_step_and_reset(server):
    participant = Participant(TYPES, DOMAIN, "control")
    reader, writer = participant.reader(STATUS), participant.writer(CONTROL)

    def say(text):
        writer.write(TYPES.encode(TYPES["std_msgs/msg/String"](text)))

    assert not status(reader)["paused"]
    until(lambda: writer.entity.get_matched_subscriptions())
    say("pause")
    stands = until(lambda: (now := status(reader))["paused"] and now)
    assert status(reader)["tick"] == stands["tick"]
    say("step 25")
    until(lambda: status(reader)["tick"] == stands["tick"] + 25)
    say("reset 7")
    again = until(lambda: (now := status(reader))["tick"] == 0 and now)
    assert (again["seed"], again["time"], again["paused"]) == (7, 0.0, True)
    say("resume")
    until(lambda: status(reader)["tick"] > 10)
    say("stop")
    until(lambda: "/qrsim/control 'stop': expected pause, resume, reset, step" in server.read_text())


def test_nonsense_is_a_line_and_the_vehicle_holds(server):
    participant = Participant(TYPES, DOMAIN, "nonsense")
    states = participant.reader(Topic("/uav_0/state", "std_msgs/msg/String", "reliable"))
    topic = Topic("/uav_0/cmd_vel", "geometry_msgs/msg/Twist", "command")
    writer = participant.writer(topic)
    until(lambda: writer.entity.get_matched_subscriptions())
    twist = empty(TYPES, topic.type)
    twist.linear.x = float("nan")

    def refused() -> bool:
        # Commands are not repeated by the middleware, and a busy machine may miss one.
        writer.write(TYPES.encode(twist))
        return "cmd_vel: linear.x is nan, which is not finite; it holds its place" in server.read_text()

    until(refused)
    until(lambda: any(json.loads(each.data)["mode"] == "hold" for each in states.take()))
    other = participant.writer(Topic("/uav_1/cmd_vel", "geometry_msgs/msg/Vector3", "command"))
    assert other.lost == 0
    until(lambda: "/uav_1/cmd_vel: another node writes it as geometry_msgs/msg/Vector3" in server.read_text())
