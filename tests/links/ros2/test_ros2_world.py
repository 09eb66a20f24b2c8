"""What vehicles publish is what they sense and believe, in the axes and units of ROS."""

import json
import math

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.links.ros2.blank import stamp_of
from qrsim.links.ros2.messages import Messages
from qrsim.links.ros2.names import namespaces
from qrsim.links.ros2.typestore import Types
from qrsim.links.shared.around import Around
from qrsim.links.shared.sight import Sight
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

TYPES = Types("jazzy")
CONTENT = {
    "name": "pair",
    "duration": 60.0,
    "site": {"latitude_deg": 51.7, "longitude_deg": -0.2, "height": 40.0},
    "world": {
        "wind": {"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 270},
        "beacons": [{"name": "mast", "position_ned": [5, 0, -10]}, {"name": "gate", "position_ned": [5, 43, -16]}],
        "obstacles": [{"type": "cylinder", "x": 15, "y": 40, "radius": 1, "z_min": -60}],
    },
    "fleets": {
        "uav": {
            "controller": {"type": "cascade", "feed": "truth"},
            "battery": {"type": "lithium_polymer"},
            "sensors": {
                "gnss": {"type": "gnss", "preset": "m8n"},
                "imu": {"type": "imu", "gyroscope_noise": 0.001, "accelerometer_noise": 0.002},
                "magnetometer": {"type": "magnetometer", "noise": 0.05},
                "altimeter": {"type": "pressure_altimeter", "noise_std": 3.0},
                "below": {
                    "type": "rangefinder",
                    "noise_std": 0.1,
                    "noise_per_range": 0.01,
                    "range_min": 0.5,
                    "range_max": 60.0,
                    "mount_position_body": [0.2, 0.1, 0.05],
                },
                "lidar": {"type": "ideal_scan", "rays": 9, "field_of_view_rad": 2.0 * math.pi},
                "uwb": {"type": "ideal_ranging"},
                "others": {"type": "ideal_neighbours", "slots": 2},
                "flow": {"type": "ideal_optical_flow"},
                "pitot": {"type": "ideal_airspeed"},
            },
            "vehicles": [
                {"position_ned": [0, 0, -20], "yaw_deg": 30, "waypoints_ned": [[60, 30, -20]]},
                {"position_ned": [5, 40, -20]},
            ],
        }
    },
}


@pytest.fixture(scope="module")
def flown():
    """Some seconds of flight: for each tick what was published by topic, and what the sensors said."""
    scenario = load_scenario(CONTENT)
    simulation = Simulation(scenario.world(), seed=2, site=scenario.site)
    simulation.reset()
    messages = Messages(TYPES, simulation, truth=True)
    found = []
    for _ in range(60):
        simulation.advance()
        said = {messages.topics[i].name: cdr for i, cdr in messages.due(["guidance", "hold"])}
        truth = simulation.truth
        seen = {
            "reading": simulation.reading["uav"],
            "position": truth.position_ned.copy(),
            "time": simulation.time,
            "velocity": truth.velocity_ned.copy(),
            "attitude": np.asarray(truth.attitude).copy(),
            "body": truth.velocity_body.copy(),
            "wind": np.asarray(truth.wind_ned).copy(),
        }
        found.append((said, seen))
    return messages, found, scenario.site


def decoded(messages: Messages, said: dict[str, bytes], name: str):
    kind = next(topic.type for topic in messages.topics if topic.name == name)
    message = TYPES.decode(said[name], kind)
    assert TYPES.encode(message) == said[name]
    return message


def three(vector) -> list[float]:
    return [vector.x, vector.y, vector.z]


def test_every_message_is_what_rosbags_writes(flown):
    messages, found, _ = flown
    kinds = {topic.name: topic.type for topic in messages.topics}
    published = set()
    for said, _ in found:
        for name, cdr in said.items():
            assert TYPES.encode(TYPES.decode(cdr, kinds[name])) == cdr, name
            published.add(name)
    assert published == set(kinds)
    own = {name.removeprefix("/uav_0/") for name in kinds if name.startswith("/uav_0/")}
    assert own == {
        "fix", "imu/data", "mag", "baro", "baro/height", "range", "battery", "odom", "pose", "velocity", "state",
        "ground_truth/odom", "ground_truth/wind", "scan", "ranging/beacon_0", "ranging/beacon_1", "ranging/uav_1",
        "neighbours", "optical_flow/flow", "optical_flow/rotation", "airspeed", "airspeed/pressure",
    }  # fmt: skip


def test_inertial_readings_are_forward_left_up(flown):
    messages, found, _ = flown
    said, seen = found[40]
    imu = decoded(messages, said, "/uav_0/imu/data")
    rates, force = seen["reading"].imu.rates_body, seen["reading"].imu.specific_force
    signs = np.array([1.0, -1.0, -1.0])
    assert three(imu.angular_velocity) == pytest.approx(signs * rates[0], rel=1e-6)
    assert three(imu.linear_acceleration) == pytest.approx(signs * force[0], rel=1e-6)
    # It flies, so the specific force is up.
    assert imu.linear_acceleration.z > 5.0
    # White noise of 0.001 rad/s^0.5 and of 0.002 m/s^1.5, as the mean of 0.02 s.
    assert imu.angular_velocity_covariance.tolist() == pytest.approx([5e-5, 0, 0, 0, 5e-5, 0, 0, 0, 5e-5])
    assert imu.linear_acceleration_covariance.tolist() == pytest.approx([2e-4, 0, 0, 0, 2e-4, 0, 0, 0, 2e-4])
    assert imu.header.frame_id == "uav_0/base_link"
    assert imu.header.stamp.sec + 1e-9 * imu.header.stamp.nanosec == pytest.approx(0.82)


def test_the_magnetic_field_is_in_tesla(flown):
    messages, found, _ = flown
    said, seen = next((said, seen) for said, seen in found[30:] if "/uav_1/mag" in said)
    field = decoded(messages, said, "/uav_1/mag")
    x, y, z = 1e-6 * np.asarray(seen["reading"].magnetometer.field_body, np.float64)[1]
    assert three(field.magnetic_field) == pytest.approx([x, -y, -z], rel=1e-5)
    # In Britain it points down, by some 45 uT.
    assert -6e-5 < field.magnetic_field.z < -3e-5


def test_pressure_and_range(flown):
    messages, found, _ = flown
    said, seen = next((said, seen) for said, seen in found[30:] if {"/uav_0/baro", "/uav_0/range"} <= set(said))
    pressure = decoded(messages, said, "/uav_0/baro")
    assert pressure.fluid_pressure == pytest.approx(float(seen["reading"].altimeter.pressure[0]))
    assert pressure.variance == pytest.approx(9.0)
    distance = decoded(messages, said, "/uav_0/range")
    metres = float(seen["reading"].below.range[0])
    assert distance.range == pytest.approx(metres)
    assert (distance.min_range, distance.max_range, distance.radiation_type) == (0.5, 60.0, 1)
    assert distance.variance == pytest.approx((0.1 + 0.01 * metres) ** 2, rel=1e-6)
    assert distance.header.frame_id == "uav_0/range"


def test_scans_ranges_and_neighbours_are_of_the_sensor_s_axes(flown):
    """The second vehicle hovers and looks to the north, 10 m south of the axis of a cylinder of radius 1 m."""
    messages, found, _ = flown
    said, seen = next((said, seen) for said, seen in found[30:] if "/uav_1/scan" in said)
    scan = decoded(messages, said, "/uav_1/scan")
    assert scan.ranges[4] == pytest.approx(9.0, abs=0.3)
    assert np.isinf(np.delete(scan.ranges, 4)).all()
    # Nine rays of 40 degrees, the first one to the right.
    assert math.degrees(scan.angle_min) == pytest.approx(-160.0)
    assert math.degrees(scan.angle_increment) == pytest.approx(40.0)
    assert (scan.header.frame_id, scan.range_max) == ("uav_1/scan", 100.0)
    # From (5, 40, -20) to (5, 43, -16).
    assert decoded(messages, said, "/uav_1/ranging/beacon_1").range == pytest.approx(5.0, abs=0.3)
    (pose,) = decoded(messages, said, "/uav_1/neighbours").poses
    # To the west of it, which is to its left.
    assert three(pose.position) == pytest.approx([1, -1, -1] * seen["reading"].others.position[1, 0], rel=1e-5)
    assert pose.position.y == pytest.approx(40.0, abs=2.0)
    transforms = TYPES.decode(messages.static, "tf2_msgs/msg/TFMessage").transforms
    place = next(each for each in transforms if each.child_frame_id == "beacon_1").transform.translation
    assert three(place) == pytest.approx([43.0, 5.0, 16.0])


def test_what_is_around_a_vehicle_is_for_all_links(flown):
    """The same readings, for messages of other links (shared/around.py)."""
    simulation = flown[0]._simulation
    around, reading = Around(simulation, Sight(simulation)), simulation.reading["uav"]
    lidar, own, ranges = around.scan(1)
    assert (type(lidar).__name__, own, around.flow_period(1)) == ("IdealScan", 1, flow_of(simulation).period)
    np.testing.assert_array_equal(ranges, reading.lidar.range[1])
    found = around.neighbours(1)
    np.testing.assert_allclose(found.position, reading.others.position[1, :1])
    assert found.vehicle.tolist() == [0]
    # It does not measure how fast they move.
    assert np.isnan(found.velocity).all()


def flow_of(simulation):
    fleet = simulation.world.fleets[0]
    return fleet.sensors[fleet.sensor_names.index("flow")]


def test_air_and_flow_are_published(flown):
    messages, found, _ = flown
    names = {"/uav_0/airspeed", "/uav_0/airspeed/pressure", "/uav_0/optical_flow/flow"}
    said, seen = next((said, seen) for said, seen in found[30:] if names <= set(said))
    speed = decoded(messages, said, "/uav_0/airspeed").data
    assert speed == pytest.approx(float(seen["reading"].pitot.true_airspeed[0]))
    # Of the standard atmosphere: half its density of 1.22 kg/m^3 at 60 m, times the speed squared.
    assert decoded(messages, said, "/uav_0/airspeed/pressure").fluid_pressure == pytest.approx(
        0.61 * speed**2, rel=0.02
    )
    flow = decoded(messages, said, "/uav_0/optical_flow/flow").vector
    reading = seen["reading"].flow
    assert three(flow) == pytest.approx([float(reading.flow_x[0]), -float(reading.flow_y[0]), 0.0], rel=1e-5)
    turn = decoded(messages, said, "/uav_0/optical_flow/rotation").vector
    assert three(turn) == pytest.approx(np.array([1.0, -1.0, -1.0]) * np.asarray(reading.delta_angle)[0], rel=1e-5)


def test_a_fix_is_published_when_it_arrives_and_stamped_when_it_was_true(flown):
    messages, found, site = flown
    arrived = [(said, seen) for said, seen in found if "/uav_0/fix" in said]
    assert len(arrived) in range(5, 13)
    said, seen = arrived[-1]
    fix, reading = decoded(messages, said, "/uav_0/fix"), seen["reading"].gnss
    ned = np.asarray(reading.position_ned, np.float64)[0]
    latitude, longitude, height = (float(number) for number in site.ned_to_geodetic(ned))
    assert (fix.latitude, fix.longitude) == pytest.approx((math.degrees(latitude), math.degrees(longitude)), abs=1e-12)
    assert fix.altitude == pytest.approx(height)
    horizontal = float(reading.horizontal_accuracy[0]) ** 2 / 2.0
    vertical = float(reading.vertical_accuracy[0]) ** 2
    assert fix.position_covariance.tolist() == pytest.approx([horizontal, 0, 0, 0, horizontal, 0, 0, 0, vertical])
    assert (fix.position_covariance_type, fix.header.frame_id) == (2, "uav_0/gnss")
    assert fix.header.stamp.sec + 1e-9 * fix.header.stamp.nanosec < seen["time"]


def test_odometry_and_its_frames(flown):
    messages, found, _ = flown
    said = found[-1][0]
    # Fed with the truth, a controller flies a tick by what was true at its beginning.
    for name, seen in (("odom", found[-2][1]), ("ground_truth/odom", found[-1][1])):
        odometry = decoded(messages, said, f"/uav_0/{name}")
        stamp = odometry.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(seen["time"], abs=1e-9)
        north, east, down = seen["position"][0]
        assert three(odometry.pose.pose.position) == pytest.approx([east, north, -down], abs=1e-4)
        forward, right, below = seen["body"][0]
        assert three(odometry.twist.twist.linear) == pytest.approx([forward, -right, -below], abs=1e-4)
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "uav_0/base_link")
        yaw = float(seen["attitude"][0, 2])
        q = odometry.pose.pose.orientation
        heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        assert math.remainder(heading - (math.pi / 2 - yaw), 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    velocity = decoded(messages, said, "/uav_0/velocity")
    north, east, down = found[-2][1]["velocity"][0]
    assert three(velocity.twist.linear) == pytest.approx([east, north, -down], abs=1e-4)
    wind = decoded(messages, said, "/uav_0/ground_truth/wind")
    # It blows from the west.
    assert wind.vector.x == pytest.approx(float(found[-1][1]["wind"][0, 1]), rel=1e-5)
    assert wind.vector.x > 2.0


def test_transforms_and_the_clock(flown):
    messages, found, _ = flown
    said, _ = found[10]
    transforms = decoded(messages, said, "/tf").transforms
    assert [each.child_frame_id for each in transforms] == ["uav_0/base_link", "uav_1/base_link"]
    assert three(transforms[1].transform.translation) == pytest.approx([40.0, 5.0, 20.0], abs=0.3)
    clock = decoded(messages, said, "/clock").clock
    assert (clock.sec, clock.nanosec) == (0, 220_000_000)
    static = TYPES.decode(messages.static, "tf2_msgs/msg/TFMessage").transforms
    below = next(each for each in static if each.child_frame_id == "uav_0/range")
    assert three(below.transform.translation) == pytest.approx([0.2, -0.1, -0.05])
    # Its x axis is the beam, down: a quarter turn about left.
    q = below.transform.rotation
    assert (q.x, q.y, q.z, q.w) == pytest.approx((0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)))


def test_the_map_is_where_the_site_is_on_the_earth(flown):
    """Against pymap3d, whose axes are at the origin of the scenario."""
    import pymap3d
    from scipy.spatial.transform import Rotation

    on_earth = TYPES.decode(flown[0].static, "tf2_msgs/msg/TFMessage").transforms[0]
    assert (on_earth.header.frame_id, on_earth.child_frame_id) == ("earth", "map")
    assert three(on_earth.transform.translation) == pytest.approx(pymap3d.geodetic2ecef(51.7, -0.2, 40.0), abs=1e-6)
    q = on_earth.transform.rotation
    expected = np.array(pymap3d.enu2uvw(*np.eye(3), 51.7, -0.2))
    np.testing.assert_allclose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), expected, atol=1e-9)


def test_estimates_are_published_at_the_rate_that_is_asked(flown):
    """At 10 Hz of 50 ticks a second; the IMU and the clock at their own pace."""
    scenario = load_scenario(CONTENT)
    simulation = Simulation(scenario.world(), seed=2, site=scenario.site)
    simulation.reset()
    messages, counts = Messages(TYPES, simulation, truth=True, rate=10.0), {}
    for _ in range(100):
        simulation.advance()
        for topic, _ in messages.due(["guidance"] * 2):
            name = messages.topics[topic].name
            counts[name] = counts.get(name, 0) + 1
    assert counts["/clock"] == counts["/uav_0/imu/data"] == 100
    names = ("/tf", "/uav_0/odom", "/uav_1/pose", "/uav_0/velocity", "/uav_0/ground_truth/odom")
    assert [counts[name] for name in names] == [20] * 5
    # Twice a second.
    assert counts["/uav_0/battery"] == 4


@pytest.mark.long
@pytest.mark.parametrize(("height", "expected"), [(-0.2, -math.inf), (-100.0, math.inf)])
def test_ranges_that_are_not_measured_are_infinite(height, expected):
    """By REP-117: nearer than range_min, and nothing within range_max."""
    content = json.loads(json.dumps(CONTENT))
    content["fleets"]["uav"]["vehicles"] = [{"position_ned": [0, 0, height]}]
    simulation = Simulation(load_scenario(content).world(), seed=2)
    simulation.reset()
    messages = Messages(TYPES, simulation)
    simulation.advance()
    said = {messages.topics[i].name: cdr for i, cdr in messages.due(["guidance"])}
    message = decoded(messages, said, "/uav_0/range")
    assert message.range == expected
    # Of a range of nothing.
    assert message.variance == pytest.approx(0.1**2, rel=1e-6)


def test_no_two_poses_have_the_same_time(flown):
    messages, found, _ = flown
    times = []
    for said, _ in found:
        stamp = decoded(messages, said, "/uav_0/pose").header.stamp
        times.append(stamp.sec + 1e-9 * stamp.nanosec)
    assert times == pytest.approx([0.02 * tick for tick in range(60)])


@pytest.mark.long
def test_rviz_is_set_up_for_what_is_published():
    """Every topic of clients/ros2/rviz, by the type of its display, and no more reliable than it is sent."""
    from pathlib import Path

    import yaml

    file = Path(__file__).parents[3] / "clients" / "ros2" / "rviz" / "qrsim.rviz"
    manager = yaml.safe_load(file.read_text(encoding="utf-8"))["Visualization Manager"]
    scenario = load_scenario("outdoor_patrol")
    simulation = Simulation(scenario.world(), seed=0, site=scenario.site)
    simulation.reset()
    known = {topic.name: topic for topic in Messages(TYPES, simulation).topics}
    shown = [each for each in manager["Displays"] if "Topic" in each]
    assert [each["Name"] for each in shown] == [f"pelicans_{i}" for i in range(5)]
    for each in shown:
        assert each["Class"] == "rviz_default_plugins/Odometry"
        topic = known[each["Topic"]["Value"]]
        assert (topic.type, topic.quality) == ("nav_msgs/msg/Odometry", "reliable")
        assert each["Topic"]["Reliability Policy"] == "Reliable"
    assert manager["Global Options"]["Fixed Frame"] == "map"
    assert any(each["Class"] == "rviz_default_plugins/TF" for each in manager["Displays"])


def test_before_the_first_tick_there_is_the_clock_alone(flown):
    simulation = Simulation(load_scenario(CONTENT).world(), seed=2)
    simulation.reset()
    messages = Messages(TYPES, simulation)
    names = {messages.topics[topic].name for topic, _ in messages.due(["guidance"] * 2)}
    assert names == {"/clock", "/uav_0/state", "/uav_1/state"}


def test_battery_and_state(flown):
    messages, found, _ = flown
    ticks = [i + 1 for i, (said, _) in enumerate(found) if "/uav_0/battery" in said]
    assert ticks == [25, 50]
    battery = decoded(messages, found[24][0], "/uav_0/battery")
    assert 0.99 < battery.percentage <= 1.0
    assert 9.6 < battery.voltage < 12.0
    assert math.isnan(battery.current)
    told = [i + 1 for i, (said, _) in enumerate(found) if "/uav_1/state" in said]
    assert told == [1, 51]
    state = decoded(messages, found[0][0], "/uav_1/state")
    assert json.loads(state.data) == {"valid": True, "reason": "", "mode": "hold"}


def test_times_and_names():
    assert stamp_of(1.02) == (1, 20_000_000)
    assert stamp_of(0.9999999999) == (1, 0)
    assert namespaces(["uav-1", "uav 1", "7up", "_hidden", "a__b"]) == ["uav_1", "uav_1_2", "v7up", "v_hidden", "a_b"]
