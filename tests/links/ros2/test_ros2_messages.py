"""Messages of ROS 2: names, hashes and bytes, against rosbags and what ROS itself generates."""

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.errors import UsageError
from qrsim.links.ros2.template import Template
from qrsim.links.ros2.typestore import Types, dds_name

TYPES = Types("jazzy")


def test_names_in_dds():
    assert dds_name("sensor_msgs/msg/Imu") == "sensor_msgs::msg::dds_::Imu_"
    sample = TYPES.sample("sensor_msgs/msg/Imu")
    assert sample.__idl_typename__ == "sensor_msgs::msg::dds_::Imu_"


def test_hashes():
    # The type_hash of std_msgs/msg/String.json, as rosidl_generator_type_description installs it.
    known = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert TYPES.hash("std_msgs/msg/String") == known
    assert Types("humble").hash("std_msgs/msg/String") == ""


def test_a_distribution_that_is_none():
    with pytest.raises(UsageError, match=r"distribution 'jazy': expected humble, .*'jazzy'"):
        Types("jazy")


def test_bytes_of_a_message_by_hand():
    time = TYPES["builtin_interfaces/msg/Time"]
    clock = TYPES["rosgraph_msgs/msg/Clock"](time(258, 3))
    assert TYPES.encode(clock).hex() == "00010000" + "02010000" + "03000000"


def _filled(template: Template, name: str, rng: np.random.Generator) -> bytes:
    """Put a number at every place, and return what rosbags writes of a message with the same numbers."""
    paths, values = [], []
    for path, (_, code, count) in template.places.items():
        paths.append(path)
        low = rng.integers(0, 2 if code == "?" else 100, count)
        values += low.tolist() if code not in "fd" else (low + 0.5).tolist()
    template.putter(*paths)(*values)
    message = TYPES.decode(bytes(template.cdr), name)
    return TYPES.encode(message)


def _example(name: str, rng: np.random.Generator, text: str) -> object:
    """Return a message of a type with some numbers and texts."""
    from rosbags.interfaces import Nodetype

    def made(description: object) -> object:
        kind, content = description  # type: ignore[misc]
        if kind == Nodetype.NAME:
            return _example(content, rng, text)
        if kind == Nodetype.BASE:
            if content[0] == "string":
                return text
            return float(rng.integers(100)) if "float" in content[0] else int(rng.integers(2))
        element, count = content
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            kinds = {"char": "uint8", "byte": "uint8"}
            return rng.integers(0, 2, count or 3).astype(kinds.get(element[1][0], element[1][0]))
        return [made(element) for _ in range(count or 2)]

    return TYPES[name](**{field: made(description) for field, description in TYPES.fields(name)})


NAMES = (
    "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField",
    "sensor_msgs/msg/FluidPressure", "sensor_msgs/msg/Range", "sensor_msgs/msg/BatteryState", "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Vector3Stamped",
    "std_msgs/msg/String", "std_msgs/msg/UInt8MultiArray", "tf2_msgs/msg/TFMessage", "rosgraph_msgs/msg/Clock",
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("text", ["", "map", "uav1/base_link"])
def test_numbers_are_put_where_rosbags_puts_them(name: str, text: str):
    rng = np.random.default_rng(3)
    message = _example(name, rng, text)
    template = Template(TYPES, message)
    before = bytes(template.cdr)
    for path, (offset, code, count) in template.places.items():
        found = message
        for part in path.split("."):
            found = found[int(part)] if part.isdigit() else getattr(found, part)  # type: ignore[index]
        put = template.putter(path)
        put(*np.atleast_1d(found).tolist())
        assert bytes(template.cdr) == before, (path, offset, code, count)
    assert _filled(template, name, rng) == bytes(template.cdr)
    assert name in ("std_msgs/msg/String",) or bytes(template.cdr) != before


def test_several_numbers_at_once_are_the_numbers_one_by_one():
    rng = np.random.default_rng(4)
    one, other = (
        Template(TYPES, _example("sensor_msgs/msg/NavSatFix", np.random.default_rng(4), "uav1/gnss")) for _ in range(2)
    )
    paths = ["header.stamp.sec", "header.stamp.nanosec", "latitude", "longitude", "position_covariance"]
    values = [7, 8, *rng.normal(size=11).tolist()]
    one.putter(*paths)(*values)
    first = 0
    for path in paths:
        count = one.places[path][2]
        other.putter(path)(*values[first : first + count])
        first += count
    assert one.cdr == other.cdr
    with pytest.raises(ValueError, match="2 numbers; expected 13"):
        one.putter(*paths)(1, 2)


def test_a_path_that_is_none():
    template = Template(TYPES, TYPES["rosgraph_msgs/msg/Clock"](TYPES["builtin_interfaces/msg/Time"](0, 0)))
    with pytest.raises(KeyError):
        template.putter("clock.seconds")
