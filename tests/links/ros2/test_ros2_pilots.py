"""What other nodes ask of a vehicle: velocities, places, attitudes; silence and nonsense."""

import math

import numpy as np
import pytest

pytest.importorskip("cyclonedds")
pytest.importorskip("rosbags")

from qrsim.errors import UsageError
from qrsim.links.ros2.blank import empty
from qrsim.links.ros2.commands import Motion, Place, Thrust, Tilt, topics_of, wish_of
from qrsim.links.ros2.pilots import Pilots
from qrsim.links.ros2.server import Options, Server
from qrsim.links.ros2.typestore import Types
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

TYPES = Types("jazzy")
CONTENT = {
    "name": "pair",
    "duration": 60.0,
    "fleets": {
        "uav": {
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [
                {"position_ned": [0, 0, -20], "yaw_deg": 90},
                {"position_ned": [0, 40, -20], "waypoints_ned": [[30, 40, -20]]},
            ],
        },
    },
}


def twist(linear=(0.0, 0.0, 0.0), turn=0.0, stamped=False):
    message = empty(TYPES, "geometry_msgs/msg/TwistStamped" if stamped else "geometry_msgs/msg/Twist")
    inner = message.twist if stamped else message
    inner.linear.x, inner.linear.y, inner.linear.z = linear
    inner.angular.z = turn
    return message


def pose(position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0), frame="map"):
    message = empty(TYPES, "geometry_msgs/msg/PoseStamped")
    message.header.frame_id = frame
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = position
    turn.x, turn.y, turn.z, turn.w = orientation
    return message


def thrust(value):
    message = empty(TYPES, "std_msgs/msg/Float32")
    message.data = value
    return message


def test_what_messages_ask():
    assert wish_of("cmd_vel", twist((1.0, 2.0, 3.0), 0.5)) == Motion((1.0, -2.0, -3.0), -0.5, True)
    assert wish_of("cmd_vel", twist((1.0, 2.0, 3.0), 0.5, True)) == Motion((1.0, -2.0, -3.0), -0.5, True)
    asked = wish_of("setpoint_velocity/cmd_vel", twist((1.0, 2.0, 3.0), 0.5, True))
    assert asked == Motion((2.0, 1.0, -3.0), -0.5, False)
    place = wish_of("setpoint_position/local", pose((1.0, 2.0, 3.0)))
    # Facing east, which is x of the map.
    assert place == Place((2.0, 1.0, -3.0), pytest.approx(math.pi / 2))
    assert wish_of("setpoint_position/local", pose(orientation=(0.0, 0.0, 0.0, 0.0), frame="")).yaw is None
    tilt = wish_of("setpoint_attitude/attitude", pose(orientation=(0.0, math.sin(0.1), 0.0, math.cos(0.1))))
    # A turn by 0.2 about left puts the nose down.
    assert tilt == Tilt(pytest.approx((0.0, -0.2, math.pi / 2), abs=1e-12))
    assert wish_of("setpoint_attitude/thrust", thrust(0.5)) == Thrust(0.5)


@pytest.mark.parametrize(
    ("own", "message", "why"),
    [
        ("cmd_vel", twist((1.0, math.nan, 0.0)), "cmd_vel: linear.y is nan, which is not finite"),
        ("cmd_vel", twist(turn=math.inf), "cmd_vel: angular.z is inf, which is not finite"),
        ("setpoint_position/local", pose((0.0, 0.0, math.nan)), "pose.position.z is nan"),
        ("setpoint_position/local", pose(frame="odom"), "frame 'odom'; expected 'map', or none"),
        ("setpoint_position/local", pose(orientation=(0.0, 0.0, math.nan, 1.0)), "orientation.z is nan"),
        ("setpoint_attitude/attitude", pose(orientation=(0.0, 0.0, 0.0, 0.0)), "the orientation is 0, 0, 0, 0"),
        ("setpoint_attitude/thrust", thrust(1.01), "data is 1.01; expected 0 to 1"),
    ],
)
def test_what_cannot_be_asked(own, message, why):
    with pytest.raises(UsageError, match=why):
        wish_of(own, message)


def test_topics_are_those_of_the_orders_that_a_vehicle_takes():
    assert [topic.name for _, topic in topics_of("plane", {"waypoint", "control"})] == [
        "/plane/setpoint_position/local"
    ]
    assert {topic.name for _, topic in topics_of("uav1", {"waypoint", "velocity", "attitude"})} == {
        "/uav1/cmd_vel",
        "/uav1/setpoint_velocity/cmd_vel",
        "/uav1/setpoint_position/local",
        "/uav1/setpoint_attitude/attitude",
        "/uav1/setpoint_attitude/thrust",
    }


class Air:
    """The pair, and what is said of it."""

    def __init__(self, simulation, hold=0.5, factor=1.0):
        simulation.reset()
        self.simulation, self.said = simulation, []
        self.pilots = Pilots(simulation, hold, factor, self.said.append)

    def fly(self, seconds, row=None, wish=None):
        """Fly on, with a wish repeated at every tick."""
        for _ in range(round(seconds / 0.02)):
            if wish is not None:
                self.pilots.ask(row, wish)
            self.simulation.advance(self.pilots.actions())

    @property
    def truth(self):
        return self.simulation.truth


@pytest.fixture(scope="module")
def simulation():
    return Simulation(load_scenario(CONTENT).world("float64"), seed=0)


@pytest.mark.long
def test_forward_is_where_the_vehicle_heads(simulation):
    air = Air(simulation)
    air.fly(6.0, 0, Motion((2.0, 0.0, 0.0), 0.0, True))
    # It faces east.
    assert np.asarray(air.truth.velocity_ned)[0].tolist() == pytest.approx([0.0, 2.0, 0.0], abs=0.15)
    assert air.pilots.modes == ["velocity", "guidance"]
    # The other one has gone by its guidance.
    assert air.truth.position_ned[1, 0] > 5.0
    air = Air(simulation)
    air.fly(6.0, 0, Motion((2.0, 1.0, -0.5), 0.0, False))
    assert np.asarray(air.truth.velocity_ned)[0].tolist() == pytest.approx([2.0, 1.0, -0.5], abs=0.15)


@pytest.mark.long
def test_a_rate_of_turn_turns(simulation):
    air = Air(simulation)
    # Clockwise by 0.3 rad/s, from east.
    air.fly(4.0, 0, Motion((0.0, 0.0, 0.0), 0.3, True))
    early = float(air.truth.attitude[0, 2])
    air.fly(2.0, 0, Motion((0.0, 0.0, 0.0), 0.3, True))
    assert math.remainder(float(air.truth.attitude[0, 2]) - early, 2 * math.pi) == pytest.approx(0.6, abs=0.06)


def test_a_place_is_held_for_good(simulation):
    air = Air(simulation)
    air.pilots.ask(0, Place((4.0, -3.0, -22.0), None))
    air.fly(15.0)
    assert air.truth.position_ned[0].tolist() == pytest.approx([4.0, -3.0, -22.0], abs=0.3)
    # With the heading that it had.
    assert float(air.truth.attitude[0, 2]) == pytest.approx(math.pi / 2, abs=0.05)
    assert (air.pilots.modes[0], air.said) == ("position", [])


def test_after_silence_it_holds_its_place(simulation):
    air = Air(simulation, hold=0.5)
    air.fly(3.0, 0, Motion((2.0, 0.0, 0.0), 0.0, True))
    air.fly(0.48)
    assert air.pilots.modes[0] == "velocity"
    air.fly(0.04)
    assert air.pilots.modes[0] == "hold"
    assert air.said == ["t = 3.48 s, 'uav_0': nothing is heard for 0.5 s; it holds its place"]
    there = air.truth.position_ned[0].copy()
    air.fly(8.0)
    assert np.linalg.norm(air.truth.position_ned[0] - there) < 2.5
    assert np.linalg.norm(air.truth.velocity_ned[0]) < 0.1
    air.fly(1.0, 0, Motion((2.0, 0.0, 0.0), 0.0, True))
    assert air.pilots.modes[0] == "velocity"


def test_silence_is_of_the_wall_clock_where_the_world_is_faster(simulation):
    air = Air(simulation, hold=0.1, factor=4.0)
    air.fly(0.2, 0, Motion((1.0, 0.0, 0.0), 0.0, True))
    air.fly(0.38)
    assert air.pilots.modes[0] == "velocity"
    air.fly(0.04)
    assert air.pilots.modes[0] == "hold"


def test_who_flies_by_velocities_is_waited_for_until_he_is_silent(simulation, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    simulation.reset()
    said = []
    pilots = Pilots(simulation, 0.5, 1.0, said.append, by_wall=True)
    assert not pilots.waited_for
    pilots.ask(0, Motion((1.0, 0.0, 0.0), 0.0, True))
    assert not pilots.waited_for
    simulation.advance(pilots.actions())
    assert pilots.waited_for
    pilots.ask(0, Motion((1.0, 0.0, 0.0), 0.0, True))
    assert not pilots.waited_for
    # However many ticks there are in the meantime.
    for _ in range(100):
        simulation.advance(pilots.actions())
    assert pilots.modes[0] == "velocity"
    clock[0] += 0.49
    assert pilots.waited_for
    clock[0] += 0.02
    assert not pilots.waited_for
    simulation.advance(pilots.actions())
    assert (pilots.modes[0], said[0]) == ("hold", "t = 2.02 s, 'uav_0': nothing is heard for 0.5 s; it holds its place")


def test_orders_that_stay_are_flown_like_those_that_are_handed_over(simulation):
    found = []
    for hands_over in (True, False):
        simulation.reset()
        pilots = Pilots(simulation, 0.5, 1.0, lambda line: None)
        for tick in range(30):
            if tick in (5, 6, 20):
                pilots.ask(0, Place((float(tick), 2.0, -20.0), None))
            if tick == 12:
                # A tick of something else in between.
                simulation.advance()
            if hands_over:
                simulation.advance(pilots.actions())
            else:
                pilots.advance()
        found.append(simulation.truth.state.tobytes())
    assert found[0] == found[1]


def test_nonsense_holds_the_vehicle_and_is_said_once(simulation):
    air = Air(simulation)
    air.fly(1.0, 0, Motion((2.0, 0.0, 0.0), 0.0, True))
    for _ in range(3):
        air.pilots.refuse(0, "cmd_vel: linear.x is nan, which is not finite")
    assert air.said == ["t = 1 s, 'uav_0': cmd_vel: linear.x is nan, which is not finite; it holds its place"]
    air.fly(0.1)
    assert air.pilots.modes == ["hold", "guidance"]


def test_an_attitude_needs_a_thrust(simulation):
    air = Air(simulation)
    air.fly(0.2, 0, Tilt((0.0, -0.1, 0.0)))
    assert air.pilots.modes[0] == "guidance"
    air.pilots.ask(0, Thrust(0.55))
    # North, with the nose down.
    air.fly(1.0, 0, Tilt((0.0, -0.1, math.pi / 2)))
    assert air.pilots.modes[0] == "attitude"
    assert float(air.truth.velocity_ned[0, 1]) > 0.2


def test_an_episode_begins_with_guidance(simulation):
    air = Air(simulation)
    air.fly(1.0, 0, Motion((2.0, 0.0, 0.0), 0.0, True))
    air.simulation.reset()
    air.pilots.restart()
    assert air.pilots.modes == ["guidance", "guidance"]
    assert air.pilots.latches.codes.tolist() == [0, 0]


class Wire:
    """A node without a middleware: what was written by topic, and what is to be read."""

    def __init__(self):
        self.written, self.waiting = {}, {}

    def writer(self, topic):
        return Channel(self, topic.name)

    reader = writer

    def announce(self):
        pass

    def has_news(self):
        return True

    def remarks(self):
        return []


class Channel:
    def __init__(self, wire, name):
        self._wire, self._name, self.lost = wire, name, 0

    def write(self, cdr):
        self._wire.written[self._name] = self._wire.written.get(self._name, 0) + 1

    def take(self):
        return self._wire.waiting.pop(self._name, [])


@pytest.mark.long
def test_a_vehicle_whose_link_is_off_neither_hears_nor_is_heard():
    wire, simulation = Wire(), Simulation(load_scenario(CONTENT).world(), seed=1)
    server = Server(simulation, TYPES, Options(pace="fast"), lambda line: None, wire)
    simulation.inject("link", "off", "uav_0", duration=0.5)
    for _ in range(20):
        for name in ("uav_0", "uav_1"):
            wire.waiting[f"/{name}/cmd_vel"] = [twist((1.0, 0.0, 0.0))]
        server.listen()
        server.tick()
    assert not any(name.startswith("/uav_0/") for name in wire.written)
    assert wire.written["/uav_1/odom"] == wire.written["/clock"] == 20
    # Nobody has flown the first; the second goes by what it was asked.
    assert server._pilots.modes[0] == "guidance"
    assert server._pilots.modes[1] != "guidance"
    for _ in range(10):
        server.tick()
    assert wire.written["/uav_0/odom"] == 6
    # What was asked meanwhile is lost.
    server.listen()
    assert server._pilots.modes[0] == "guidance"
