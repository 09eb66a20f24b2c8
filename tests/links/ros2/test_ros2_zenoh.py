"""``qrsim ros2 --transport zenoh``: another process that has zenoh alone sees the topics, and flies."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from typing import Any

import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")
pytest.importorskip("zenoh", reason="python -m pip install 'qrsim[zenoh]'")

from qrsim import cli
from qrsim.links.ros2.topics import Topic
from qrsim.links.ros2.typestore import Types
from qrsim.links.ros2.zenoh_node import ZenohNode, attachment

SCENARIO = """
name: pair
duration: 600
fleets:
  uav:
    controller: {type: cascade, feed: truth}
    sensors: {imu: {type: imu}}
    vehicles: [{position_ned: [0, 0, -20]}, {position_ned: [20, 0, -20]}]
"""
IMU = "sensor_msgs::msg::dds_::Imu_"


@cache
def store() -> Any:
    """The messages of ROS 2, which take a while to import."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def until(done: Any, patience: float = 20.0) -> Any:
    """Wait until something is so, and return it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if found := done():
            return found
        time.sleep(0.02)
    raise AssertionError("it did not come")


@pytest.fixture
def port() -> int:
    with socket.socket() as each:
        each.bind(("127.0.0.1", 0))
        return int(each.getsockname()[1])


@contextmanager
def router(port: int) -> Iterator[Any]:
    """Be what rmw_zenohd is."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as opened:
        yield opened


@pytest.fixture
def session(port: int) -> Iterator[Any]:
    with router(port) as opened:
        yield opened


@pytest.mark.long
def test_a_process_with_zenoh_alone_sees_the_topics_and_flies(session: Any, port: int, tmp_path: Any) -> None:
    (tmp_path / "pair.yaml").write_text(SCENARIO)
    seen: dict[str, Any] = {}
    tokens: set[str] = set()
    kept = [
        session.declare_subscriber("7/**", lambda sample: seen.__setitem__(str(sample.key_expr), sample)),
        session.liveliness().declare_subscriber("@ros2_lv/7/**", lambda sample: tokens.add(str(sample.key_expr))),
    ]
    code = "import sys; from qrsim.cli import main; sys.exit(main())"
    words = ["ros2", str(tmp_path / "pair.yaml"), "--domain", "7", "--transport", "zenoh", "--truth"]
    words += ["--router", f"tcp/127.0.0.1:{port}"]
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE, text=True)
    try:
        key = f"7/uav_0/imu/data/{IMU}/{store().hash_rihs01('sensor_msgs/msg/Imu')}"
        sample = until(lambda: seen.get(key), 60.0)
        message = store().deserialize_cdr(sample.payload.to_bytes(), "sensor_msgs/msg/Imu")
        # At rest, but for the noise of the sensor and the first moves.
        assert message.linear_acceleration.z == pytest.approx(9.81, abs=3.0)
        assert message.header.frame_id == "uav_0/base_link"
        given = sample.attachment.to_bytes()
        # What zenoh writes for text and whole numbers, in that order, and 16 bytes.
        number = int.from_bytes(given[16:24], "little")
        assert given[:16] == b"\x0fsequence_number"
        assert given[24:41] == b"\x10source_timestamp"
        assert abs(int.from_bytes(given[41:49], "little") * 1e-9 - time.time()) < 60.0
        assert given[49:60] == b"\x0asource_gid"
        assert (given[60], len(given)) == (16, 77)
        assert until(lambda: int.from_bytes(seen[key].attachment.to_bytes()[16:24], "little") > number)
        # The node, its publishers and its subscribers.
        assert any(token.split("/")[5:] == ["NN", "%", "%", "qrsim"] for token in tokens)
        told = {token.split("/")[9]: token.split("/")[10:] for token in tokens if token.split("/")[5] == "MP"}
        assert told["%uav_0%imu%data"] == [IMU, store().hash_rihs01("sensor_msgs/msg/Imu"), "2::,5:,:,:,,"]
        assert told["%tf_static"][-1] == ":1:,1:,:,:,,"
        assert told["%uav_1%odom"][-1] == "::,10:,:,:,,"
        heard = {token.split("/")[9] for token in tokens if token.split("/")[5] == "MS"}
        assert {"%uav_0%cmd_vel", "%qrsim%control"} <= heard
        twist = store().types["geometry_msgs/msg/Twist"]
        vector = store().types["geometry_msgs/msg/Vector3"]
        asked = store().serialize_cdr(twist(vector(2.0, 0.0, 0.0), vector(0.0, 0.0, 0.0)), "geometry_msgs/msg/Twist")
        kind = f"geometry_msgs::msg::dds_::Twist_/{store().hash_rihs01('geometry_msgs/msg/Twist')}"
        odom = next(each for each in seen if each.startswith("7/uav_1/ground_truth/odom/"))

        def fast() -> bool:
            session.put(f"7/uav_1/cmd_vel/{kind}", bytes(asked))
            found = store().deserialize_cdr(seen[odom].payload.to_bytes(), "nav_msgs/msg/Odometry")
            return bool(found.twist.twist.linear.x > 1.7)

        until(fast)
        assert kept
    finally:
        process.terminate()
        out, _ = process.communicate(timeout=20.0)
    assert f"jazzy, zenoh by tcp/127.0.0.1:{port}" in out


def test_latched_topics_reach_who_comes_late_and_other_types_are_told(session: Any, port: int) -> None:
    types, router = Types(), f"tcp/127.0.0.1:{port}"
    first = ZenohNode(types, 3, "first", router=router)
    static = Topic("/tf_static", "std_msgs/msg/String", "static")
    first.writer(static).write(types.encode(types["std_msgs/msg/String"]("kept")))
    first.reader(Topic("/asked", "std_msgs/msg/Float32", "command"))
    time.sleep(0.5)
    late = ZenohNode(types, 3, "late", router=router)
    reader = late.reader(static)
    assert [message.data for message in until(reader.take)] == ["kept"]
    late.writer(Topic("/asked", "std_msgs/msg/String", "command"))
    assert until(first.remarks) == ["/asked: another node writes it as std_msgs/msg/String, which is not read"]
    late.close()
    first.close()


def test_services_answer_queries_with_their_attachment(session: Any, port: int) -> None:
    """Key, payload and attachment as rmw_zenoh's clients have them; the response carries the same attachment."""
    types = Types("jazzy", ["std_srvs"])
    node = ZenohNode(types, 3, "services", router=f"tcp/127.0.0.1:{port}")
    service = node.service("/uav/ask", "std_srvs/srv/Trigger")
    own = attachment(9, 5) + bytes(17)
    key = f"3/uav/ask/std_srvs::srv::dds_::Trigger_/{types.service_hash('std_srvs/srv/Trigger')}"
    end = time.monotonic() + 10.0
    found: list[Any] = []
    asked: list[int] = []
    while not found and time.monotonic() < end:
        replies = session.get(key, payload=b"\0\1\0\0\0", attachment=own, timeout=2.0)
        # The first queries may come before the router knows of the service.
        with contextlib.suppress(AssertionError):
            for request, message in until(service.take, 0.5):
                asked.append(message.structure_needs_at_least_one_member)
                service.reply(request, types["std_srvs/srv/Trigger_Response"](True, "there"))
        found = [reply.ok for reply in replies]
    assert asked == [0]
    assert found[0].attachment.to_bytes() == own
    response = types.decode(found[0].payload.to_bytes(), "std_srvs/srv/Trigger_Response")
    assert (response.success, response.message) == (True, "there")
    node.close()


def test_attachments_are_in_the_serialisation_of_zenoh() -> None:
    import zenoh

    parts: list[Any] = ["sequence_number", zenoh.ext.Int64(5), "source_timestamp", zenoh.ext.Int64(-7)]
    assert attachment(5, -7) == b"".join(zenoh.ext.z_serialize(part).to_bytes() for part in parts)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--transport", "zenho"], "--transport zenho: expected dds or zenoh; did you mean 'zenoh'?"),
        (["--transport", "zenoh", "--router", "there"], "--router there: expected an endpoint of zenoh, such as"),
        (["--pace", "barier"], "--pace barier: expected free, fast, barrier; did you mean 'barrier'?"),
        (["--pace", "fast", "--realtime", "2"], "--realtime 2: only --pace free goes by the wall clock, not fast"),
        (["--rate", "0"], "--rate 0: expected 0.1 to 1000 Hz"),
    ],
)
def test_what_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["ros2", "hover_ideal", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("running", [True, False])
def test_a_router_that_does_not_answer_is_told(running: bool, port: int, capfd: pytest.CaptureFixture[str]) -> None:
    words = ["ros2", "hover_ideal", "--transport", "zenoh", "--router", f"tcp/127.0.0.1:{port}", "--duration", "0.04"]
    with router(port) if running else nullcontext():
        assert cli.main([*words, "--domain", "11"]) == 0
    said = f"no zenoh router answers at tcp/127.0.0.1:{port} (rmw_zenohd); no node receives messages until one does"
    told = capfd.readouterr().out
    assert (said in told) is not running
    assert f"zenoh by tcp/127.0.0.1:{port}" in told
