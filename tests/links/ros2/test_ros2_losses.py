"""No sample is lost to a reliable reader that keeps up."""

import os
import subprocess
import sys
import time

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.links.ros2.participant import Participant
from qrsim.links.ros2.topics import CONTROL, Topic
from qrsim.links.ros2.typestore import Types

TYPES = Types("jazzy")
DOMAIN = 100 + (os.getpid() + 50) % 100
VEHICLES, TICKS_AT_ONCE, SAMPLES = 30, 8, 100_000
KINDS = {
    "odom": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "velocity": "geometry_msgs/msg/TwistStamped",
}
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)
PLACES = ", ".join(f"{{position_ned: [{20 * (i % 6)}, {20 * (i // 6)}, -20]}}" for i in range(VEHICLES))
SCENARIO = f"""
name: many
duration: 600
fleets: {{uav: {{controller: {{type: cascade, feed: truth}}, vehicles: [{PLACES}]}}}}
"""


@pytest.mark.nightly
def test_a_hundred_thousand_samples_arrive(tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", ALONE)
    (tmp_path / "many.yaml").write_text(SCENARIO)
    code = "import sys; from qrsim.cli import main; sys.exit(main())"
    words = ["ros2", str(tmp_path / "many.yaml"), "--domain", str(DOMAIN), "--paused"]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        participant = Participant(TYPES, DOMAIN, "counter")
        topics = [Topic(f"/uav_{i}/{own}", KINDS[own], "reliable") for i in range(VEHICLES) for own in KINDS]
        readers = [participant.reader(topic) for topic in topics]
        control = participant.writer(CONTROL)
        end = time.monotonic() + 60.0
        while not all(reader.entity.get_matched_publications() for reader in readers) or not (
            control.entity.get_matched_subscriptions()
        ):
            assert time.monotonic() < end
            time.sleep(0.05)
        counts, last = 0, {}
        rounds = -(-SAMPLES // (len(readers) * TICKS_AT_ONCE))
        for _ in range(rounds):
            say = TYPES["std_msgs/msg/String"](f"step {TICKS_AT_ONCE}")
            control.write(TYPES.encode(say))
            missing, end = len(readers) * TICKS_AT_ONCE, time.monotonic() + 20.0
            while missing:
                assert time.monotonic() < end, f"{missing} of {len(readers) * TICKS_AT_ONCE} are missing"
                for topic, reader in zip(topics, readers, strict=True):
                    for message in reader.take():
                        tick = round((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec) / 0.02)
                        assert tick == last.get(topic, tick - 1) + 1
                        last[topic] = tick
                        missing -= 1
                        counts += 1
        assert counts >= SAMPLES
    finally:
        process.terminate()
        process.wait(20.0)
