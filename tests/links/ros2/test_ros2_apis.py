"""Vehicles asked by the topics and services of mavros and of PX4's uXRCE-DDS bridge, without a middleware."""

import math
from random import Random

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.errors import UsageError
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.world import FlownWorld
from qrsim.links.ros2.apis.flown import PACKAGES, Flown, spaces_of
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.typestore import Types
from qrsim.scenarios.scenario import load_scenario

TYPES = Types("jazzy", [package for packages in PACKAGES.values() for package in packages])
# Of the structure of the world in tests/links/mavlink/test_mavlink_world.py, so that it is compiled once.
CONTENT = {
    "name": "two", "duration": 60.0,
    "site": {"latitude_deg": 51.7, "longitude_deg": -0.2, "height": 40.0},
    "world": {"wind": {"type": "log_shear", "speed_20ft": 1.0, "wind_from_deg": 270}},
    "fleets": {
        "pair": {
            "controller": {"type": "waypoint", "feed": "truth"},
            "battery": {"type": "lithium_polymer"},
            "sensors": {
                "gnss": {"type": "gnss_receiver"}, "barometer": {"type": "barometer"},
                "gyroscope": {"type": "gyroscope"}, "accelerometer": {"type": "accelerometer"},
            },
            "vehicles": [{"position_ned": [20, 10, -20]}, {"position_ned": [20, 30, -20]}],
        },
    },
}  # fmt: skip
OFFBOARD, TAKES_OFF, LOITER, LANDS = 14, 17, 4, 18
# Height of EGM96 above the ellipsoid at the site [m].
GEOID = 46.261
ACCEPTED, REJECTED = 0, 1


class Air:
    """A world whose vehicles are asked over an API, and what they have published last."""

    def __init__(self, world, api):
        self.flown = Flown(TYPES, world, api, None, rate=50.0)
        self.flown.reset(3)
        self.said = {}
        self._take = {heard.topic.name: heard for heard in self.flown.heard}
        self._answer = {each.name: each for each in self.flown.answered}

    def run(self, seconds, each=lambda: None):
        """Fly; ``each`` is called ten times a second."""
        for tick in range(round(seconds * 50)):
            if tick % 5 == 0:
                each()
            self.flown.advance()
            for number, cdr in self.flown.due():
                topic = self.flown.topics[number]
                message = TYPES.decode(cdr, topic.type)
                assert TYPES.encode(message) == cdr, topic.name
                self.said.setdefault(topic.name, []).append(message)

    def last(self, name):
        return self.said[name][-1]

    def send(self, name, **values):
        """Publish a message with some fields, "__" for the dot in their paths."""
        topic = self._take[name].topic
        self._take[name].take(filled(topic.type, values))

    def call(self, name, **values):
        """Call a service, and return the response, as it goes over the wire."""
        own = self._answer[name]
        response = own.answer(filled(f"{own.type}_Request", values))
        return TYPES.decode(TYPES.encode(response), f"{own.type}_Response")


def filled(kind, values):
    message = empty(TYPES, kind)
    for path, value in values.items():
        *parents, last = path.split("__")
        owner = message
        for parent in parents:
            owner = getattr(owner, parent)
        kind_of = type(getattr(owner, last))
        setattr(owner, last, np.array(value, getattr(owner, last).dtype) if kind_of is np.ndarray else value)
    return TYPES.decode(TYPES.encode(message), kind)


@pytest.fixture(scope="module")
def world():
    return FlownWorld(prepared(load_scenario(CONTENT)), stack_of("px4"), seed=3)


@pytest.fixture
def px4(world):
    return Air(world, "px4")


@pytest.fixture
def mavros(world):
    return Air(world, "mavros")


# ---- px4 ----


def alive(air, space="/fmu/", **levels):
    air.send(f"{space}in/offboard_control_mode", **(levels or {"position": True}))


def vehicle_command(number, system=1, **params):
    return filled("px4_msgs/msg/VehicleCommand", {"command": number, "target_system": system, **params})


def command(air, number, *params, system=1, space="/fmu/"):
    """Send a command, and return the result of its acknowledgement."""
    values = {f"param{i}": value for i, value in enumerate(params, 1)}
    name = f"{space}in/vehicle_command"
    air.send(name, command=number, target_system=system, target_component=1, source_system=1, **values)
    air.said.pop(f"{space}out/vehicle_command_ack", None)
    air.run(0.02)
    acks = air.said.get(f"{space}out/vehicle_command_ack", [])
    assert len(acks) <= 1
    return (acks[0].command, acks[0].result) if acks else None


def engage(air):
    """Arm in OFFBOARD, as offboard nodes do: the mode is alive for a second, without a set-point."""
    air.run(1.2, lambda: alive(air))
    assert command(air, 176, 1.0, 6.0) == (176, ACCEPTED)
    assert command(air, 400, 1.0) == (400, ACCEPTED)


@pytest.mark.long
def test_an_offboard_node_of_px4_takes_off_flies_and_lands(px4):
    """The order of px4_ros_com's offboard_control: set-points begin once the vehicle is in OFFBOARD."""
    engage(px4)
    status = px4.last("/fmu/out/vehicle_status")
    assert (status.arming_state, status.nav_state, status.system_id, status.vehicle_type) == (2, OFFBOARD, 1, 1)

    def hold():
        alive(px4)
        px4.send("/fmu/in/trajectory_setpoint", position=[0.0, 0.0, -5.0], yaw=1.57079)

    px4.run(9.0, hold)
    local = px4.last("/fmu/out/vehicle_local_position")
    # Its frame begins where it stands.
    assert [local.x, local.y, local.z] == pytest.approx([0.0, 0.0, -5.0], abs=0.15)
    assert local.heading == pytest.approx(1.57079, abs=0.05)
    assert (local.ref_lat, local.ref_lon) == pytest.approx((51.70018, -0.199855), abs=1e-5)
    # The ground is 40 m above the ellipsoid.
    place, fix = px4.last("/fmu/out/vehicle_global_position"), px4.last("/fmu/out/vehicle_gps_position")
    home = px4.last("/fmu/out/home_position")
    assert (place.alt, place.alt_ellipsoid) == pytest.approx((45.0 - GEOID, 45.0), abs=0.5)
    assert place.alt_ellipsoid - place.alt == pytest.approx(GEOID, abs=2e-3)
    assert fix.altitude_ellipsoid_m - fix.altitude_msl_m == pytest.approx(GEOID, abs=2e-3)
    assert (local.ref_alt, home.alt) == pytest.approx((40.0 - GEOID, 40.0 - GEOID), abs=0.5)
    odometry = px4.last("/fmu/out/vehicle_odometry")
    # A quarter turn about down, of FRD axes in NED (w, x, y, z).
    assert odometry.q.tolist() == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], abs=0.03)
    sensors = px4.last("/fmu/out/sensor_combined")
    assert sensors.accelerometer_m_s2.tolist() == pytest.approx([0.0, 0.0, -9.81], abs=0.8)
    assert px4.last("/fmu/out/vehicle_land_detected").landed is False
    # The other one stands where it stood.
    assert px4.last("/px4_1/fmu/out/vehicle_status").arming_state == 1
    assert command(px4, 21) == (21, ACCEPTED)
    px4.run(15.0)
    status = px4.last("/fmu/out/vehicle_status")
    assert (status.arming_state, px4.last("/fmu/out/vehicle_land_detected").landed) == (1, True)


def test_velocities_count_where_the_mode_says_so(px4):
    """In NED, with positions that are no numbers; the flags leave out what is above their level."""
    engage(px4)

    def move(velocity):
        alive(px4, velocity=True)
        # A position that does not count.
        px4.send("/fmu/in/trajectory_setpoint", position=[99.0, 99.0, -99.0], velocity=velocity, yaw=math.nan)

    px4.run(4.0, lambda: move([0.0, 0.0, -1.0]))
    px4.run(4.0, lambda: move([2.0, -1.0, 0.0]))
    local = px4.last("/fmu/out/vehicle_local_position")
    assert [local.vx, local.vy, local.vz] == pytest.approx([2.0, -1.0, 0.0], abs=0.2)


def test_offboard_needs_a_mode_that_is_alive(px4):
    """COM_OF_LOSS_T is 1 s: set-points alone do not count; then the vehicle holds its place."""
    px4.run(1.5, lambda: px4.send("/fmu/in/trajectory_setpoint", position=[0.0, 0.0, -5.0]))
    assert command(px4, 176, 1.0, 6.0) == (176, REJECTED)
    engage(px4)

    def climb():
        px4.send("/fmu/in/trajectory_setpoint", position=[0.0, 0.0, -5.0], yaw=0.0)

    px4.run(3.0, lambda: (alive(px4), climb()))
    px4.run(0.8, climb)
    assert px4.last("/fmu/out/vehicle_status").nav_state == OFFBOARD
    px4.run(0.6, climb)
    status = px4.last("/fmu/out/vehicle_status")
    assert (status.nav_state, status.failsafe) == (LOITER, True)


def test_attitudes_and_rates_are_flown(px4):
    engage(px4)

    def lean():
        alive(px4, attitude=True)
        # 0.2 rad to the right, and a little more than the weight.
        q = [math.cos(0.1), math.sin(0.1), 0.0, 0.0]
        px4.send("/fmu/in/vehicle_attitude_setpoint", q_d=q, thrust_body=[0.0, 0.0, -0.8])

    px4.run(2.0, lambda: (alive(px4, attitude=True), px4.send(
        "/fmu/in/vehicle_attitude_setpoint", q_d=[1.0, 0.0, 0.0, 0.0], thrust_body=[0.0, 0.0, -0.8],
    )))  # fmt: skip
    px4.run(1.0, lean)
    w, x, _, _ = px4.last("/fmu/out/vehicle_attitude").q.tolist()
    assert 2.0 * math.atan2(x, w) == pytest.approx(0.2, abs=0.06)
    px4.run(0.6, lambda: (alive(px4, body_rate=True), px4.send(
        "/fmu/in/vehicle_rates_setpoint", roll=-0.5, thrust_body=[0.0, 0.0, -0.8],
    )))  # fmt: skip
    w, x, _, _ = px4.last("/fmu/out/vehicle_attitude").q.tolist()
    assert 2.0 * math.atan2(x, w) < 0.05


def test_commands_are_for_the_system_that_they_name(px4):
    px4.run(1.2)
    assert command(px4, 400, 1.0, system=2) is None
    assert command(px4, 400, 1.0, system=2, space="/px4_1/fmu/") == (400, ACCEPTED)
    assert command(px4, 100001, float(TAKES_OFF), system=2, space="/px4_1/fmu/") == (100001, ACCEPTED)
    px4.run(1.0)
    states = [px4.last(f"{space}out/vehicle_status").nav_state for space in ("/fmu/", "/px4_1/fmu/")]
    assert states == [LOITER, TAKES_OFF]
    response = px4.call("/px4_1/fmu/vehicle_command", request=vehicle_command(400, system=2, param1=0.0))
    # It flies, so it is not disarmed.
    assert (response.reply.command, response.reply.result) == (400, REJECTED)
    # Nonsense is refused.
    for params in ((math.nan,), (99.0,)):
        assert command(px4, 100001, *params)[1] != ACCEPTED


# ---- mavros ----


def mode(air, name, space="/pair_0/mavros/"):
    return air.call(f"{space}set_mode", custom_mode=name).mode_sent


def arm(air, space="/pair_0/mavros/"):
    response = air.call(f"{space}cmd/arming", value=True)
    return response.success, response.result


def take_off(air):
    """Arm in OFFBOARD and climb to 4 m."""
    air.run(1.0, lambda: place(air, 0.0, 0.0, 4.0))
    assert mode(air, "OFFBOARD")
    assert arm(air) == (True, 0)
    air.run(6.0, lambda: place(air, 0.0, 0.0, 4.0))


def place(air, x, y, z, yaw=math.pi / 2):
    """Ask for a place in ENU; by default it looks to the north."""
    turn = {"pose__orientation__z": math.sin(yaw / 2), "pose__orientation__w": math.cos(yaw / 2)}
    position = {f"pose__position__{axis}": value for axis, value in zip("xyz", (x, y, z), strict=True)}
    air.send("/pair_0/mavros/setpoint_position/local", **position, **turn)


@pytest.mark.long
def test_an_offboard_node_of_mavros_takes_off_flies_and_lands(mavros):
    """The order of PX4's tutorial for mavros: OFFBOARD is refused without a stream of set-points."""
    mavros.run(1.2)
    state = mavros.last("/pair_0/mavros/state")
    assert (state.connected, state.armed, state.mode, state.system_status) == (True, False, "AUTO.LOITER", 3)
    # Known, so it is sent; but it is not taken.
    assert mode(mavros, "OFFBOARD")
    assert not mode(mavros, "NONSENSE")
    mavros.run(0.2)
    assert mavros.last("/pair_0/mavros/state").mode == "AUTO.LOITER"
    assert mavros.last("/pair_0/mavros/statustext/recv").text == "Offboard rejected: no set-points"
    take_off(mavros)
    mavros.run(8.0, lambda: place(mavros, 3.0, -2.0, 4.0, yaw=0.0))
    state = mavros.last("/pair_0/mavros/state")
    assert (state.armed, state.mode, state.guided, state.manual_input) == (True, "OFFBOARD", True, False)
    pose = mavros.last("/pair_0/mavros/local_position/pose")
    assert (pose.header.frame_id, mavros.last("/pair_0/mavros/extended_state").landed_state) == ("map", 2)
    at = pose.pose.position
    assert [at.x, at.y, at.z] == pytest.approx([3.0, -2.0, 4.0], abs=0.15)
    # It looks to the east, so its axes are those of ENU.
    turn = pose.pose.orientation
    assert [turn.x, turn.y, turn.z, abs(turn.w)] == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=0.03)
    assert mavros.last("/pair_0/mavros/global_position/compass_hdg").data == pytest.approx(90.0, abs=3.0)
    assert mavros.last("/pair_0/mavros/altitude").relative == pytest.approx(4.0, abs=0.2)
    inertial = mavros.last("/pair_0/mavros/imu/data")
    assert inertial.linear_acceleration.z == pytest.approx(9.81, abs=0.4)
    # As mavros converts: heights of NavSatFix and HomePosition are above the ellipsoid, amsl is above the sea.
    level = mavros.last("/pair_0/mavros/global_position/global").altitude
    assert level == pytest.approx(44.0, abs=0.5)
    for name, field in (("altitude", "amsl"), ("vfr_hud", "altitude")):
        assert getattr(mavros.last(f"/pair_0/mavros/{name}"), field) == pytest.approx(level - GEOID, abs=0.2)
    assert mavros.last("/pair_0/mavros/global_position/raw/fix").altitude == pytest.approx(level, abs=15.0)
    home = mavros.last("/pair_0/mavros/home_position/home")
    assert home.geo.altitude == pytest.approx(40.0, abs=0.6)
    assert (home.geo.latitude, home.geo.longitude) == pytest.approx((51.70018, -0.199855), abs=1e-5)
    response = mavros.call("/pair_0/mavros/cmd/land")
    assert (response.success, response.result) == (True, 0)
    mavros.run(15.0)
    state = mavros.last("/pair_0/mavros/state")
    assert (state.armed, mavros.last("/pair_0/mavros/extended_state").landed_state) == (False, 1)
    assert mavros.last("/pair_1/mavros/state").armed is False


def test_velocities_of_mavros_are_east_north_up(mavros):
    take_off(mavros)
    name = "/pair_0/mavros/setpoint_velocity/cmd_vel_unstamped"
    mavros.run(4.0, lambda: mavros.send(name, linear__x=2.0, linear__y=-1.0, angular__z=0.3))
    twist = mavros.last("/pair_0/mavros/local_position/velocity_local").twist
    assert [twist.linear.x, twist.linear.y, twist.linear.z] == pytest.approx([2.0, -1.0, 0.0], abs=0.2)
    # Anticlockwise from above.
    assert twist.angular.z == pytest.approx(0.3, abs=0.1)


def test_raw_set_points_of_mavros(mavros):
    """PositionTarget in both kinds of frames, with velocities; AttitudeTarget with an attitude."""
    take_off(mavros)
    # Positions, accelerations and the rate of yaw are ignored. It looks 1 rad to the left of the east.
    mask, name = 7 | 7 << 6 | 1 << 11, "/pair_0/mavros/setpoint_raw/local"
    mavros.run(4.0, lambda: mavros.send(name, coordinate_frame=1, type_mask=mask, velocity__x=1.5, yaw=1.0))
    twist = mavros.last("/pair_0/mavros/local_position/velocity_local").twist.linear
    assert [twist.x, twist.y] == pytest.approx([1.5, 0.0], abs=0.2)
    assert mavros.last("/pair_0/mavros/global_position/compass_hdg").data == pytest.approx(90.0 - 57.3, abs=4.0)
    # Forward and left of the vehicle, whose yaw is kept.
    mask |= 1 << 10
    mavros.run(4.0, lambda: mavros.send(name, coordinate_frame=8, type_mask=mask, velocity__y=1.0))
    twist = mavros.last("/pair_0/mavros/local_position/velocity_body").twist.linear
    assert [twist.x, twist.y] == pytest.approx([0.0, 1.0], abs=0.2)
    turn = {"orientation__y": math.sin(0.1), "orientation__w": math.cos(0.1)}
    name = "/pair_0/mavros/setpoint_raw/attitude"
    mavros.run(1.0, lambda: mavros.send(name, type_mask=7, thrust=0.75, **turn))
    q = mavros.last("/pair_0/mavros/local_position/pose").pose.orientation
    # Nose down by 0.2 rad: the pitch of FLU axes.
    assert math.asin(2.0 * (q.w * q.y - q.z * q.x)) == pytest.approx(0.2, abs=0.06)


def test_commands_of_mavros(mavros):
    mavros.run(1.5)
    response = mavros.call("/pair_0/mavros/cmd/command", command=400, param1=1.0)
    assert (response.success, response.result) == (True, 0)
    response = mavros.call("/pair_0/mavros/cmd/command", command=31000)
    assert (response.success, response.result) == (False, 3)
    assert mavros.call("/pair_0/mavros/home_position/req_update").success
    # By COMMAND_LONG an altitude is above mean sea level, which is GEOID above the ellipsoid.
    assert mavros.call("/pair_0/mavros/cmd/takeoff", altitude=43.0 - GEOID).success
    mavros.run(6.0)
    assert mavros.last("/pair_0/mavros/local_position/pose").pose.position.z == pytest.approx(3.0, abs=0.5)


# ---- both ----


def wild(kind, random):
    """Return a message of a type with numbers of all sizes, infinite ones and none."""
    message = empty(TYPES, kind)

    def fill(owner, name):
        for field, (_, content) in TYPES.fields(name):
            value = getattr(owner, field)
            if hasattr(value, "__msgtype__"):
                fill(value, value.__msgtype__)
            elif isinstance(value, np.ndarray):
                value[:] = [random.choice(NUMBERS) for _ in value]
            elif isinstance(value, str):
                setattr(owner, field, random.choice(["", "OFFBOARD", "AUTO.LAND", "9" * 10, "\u00e9" * 300]))
            elif isinstance(value, bool):
                setattr(owner, field, random.random() < 0.5)
            elif isinstance(value, float):
                setattr(owner, field, random.choice(NUMBERS))
            else:
                bits = int(content[0].lstrip("uint"))
                top = 2 ** (bits - 1) - 1
                setattr(owner, field, random.choice([0, 1, 8, 22, 176, 192, 400, top]) & top)

    fill(message, kind)
    return TYPES.decode(TYPES.encode(message), kind)


NUMBERS = [0.0, 1.0, -1.0, 0.7, -40.0, 1e4, -1e30, 3e38, math.nan, math.inf, -math.inf]


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
@pytest.mark.parametrize("api", ["px4", "mavros"])
def test_wild_messages_end_nothing(world, api):
    air, random = Air(world, api), Random(7)
    air.run(1.2)
    for _ in range(25):
        for heard in air.flown.heard:
            heard.take(wild(heard.topic.type, random))
        for each in air.flown.answered:
            TYPES.encode(each.answer(wild(f"{each.type}_Request", random)))
        air.run(0.04)


# ---- names and types ----


def test_namespaces():
    names = ["uav-1", "uav-2", "uav-3"]
    assert spaces_of("px4", names, None) == ["/fmu/", "/px4_1/fmu/", "/px4_2/fmu/"]
    assert spaces_of("mavros", names, None) == ["/uav_1/mavros/", "/uav_2/mavros/", "/uav_3/mavros/"]
    assert spaces_of("mavros", names[:1], None) == ["/mavros/"]
    assert spaces_of("mavros", names, "uav{i}") == ["/uav0/mavros/", "/uav1/mavros/", "/uav2/mavros/"]
    assert spaces_of("px4", names[:2], "team/{name}_{n}") == ["/team/uav_1_1/fmu/", "/team/uav_2_2/fmu/"]
    for pattern, said in (
        ("uav", "3 vehicles need {name}, {i} or {n}"), ("uav{k}", "expected a text with {name}, {i} or {n}"),
        ("{i}uav", "'0uav' is no name in ROS"), ("uav{", "expected a text"), ("{i.real}", "is no name in ROS"),
        ("a//b{i}", "is no name in ROS"),
    ):  # fmt: skip
        with pytest.raises(UsageError) as raised:
            spaces_of("mavros", names, pattern)
        assert said in str(raised.value), pattern


def test_hashes_of_services_are_those_of_rosidl():
    """Of std_srvs/srv/Trigger and, in rmw_zenoh's design.md, of example_interfaces/srv/AddTwoInts."""
    store = Types("jazzy", ["std_srvs"])
    for part, text in (("Request", "int64 a\nint64 b\n"), ("Response", "int64 sum\n")):
        from rosbags.typesys import get_types_from_msg

        (own,) = get_types_from_msg(text, f"example_interfaces/msg/AddTwoInts_{part}").values()
        store.store.register({f"example_interfaces/srv/AddTwoInts_{part}": own})
    expected = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert store.service_hash("example_interfaces/srv/AddTwoInts") == expected
    assert Types("humble", ["std_srvs"]).service_hash("std_srvs/srv/Trigger") == ""


@pytest.mark.parametrize("api", ["px4", "mavros"])
def test_over_a_link_that_is_off_nothing_is_published_taken_or_answered(world, api):
    air = Air(world, api)
    air.run(0.5)
    first, second = (
        (f"{space}fmu/" for space in ("/", "/px4_1/")) if api == "px4" else ("/pair_0/mavros/", "/pair_1/mavros/")
    )
    assert any(name.startswith(first) for name in air.said), sorted(air.said)
    air.flown.world.simulation.inject("link", "off", world.systems[0].name, duration=1.0)
    air.run(0.04)
    air.said.clear()
    air.run(0.5)
    assert not any(name.startswith(first) for name in air.said)
    assert any(name.startswith(second) for name in air.said), sorted(air.said)
    armed = world.systems[0].stack.armed
    service = f"{first}vehicle_command" if api == "px4" else f"{first}cmd/arming"
    kind = "px4_msgs/srv/VehicleCommand_Request" if api == "px4" else "mavros_msgs/srv/CommandBool_Request"
    assert air._answer[service].answer(filled(kind, {})) is None
    assert world.systems[0].stack.armed == armed
    air.run(1.0)
    assert any(name.startswith(first) for name in air.said)
