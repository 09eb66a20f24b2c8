"""All kinds of vehicles as systems: their types, and missions of rovers and fixed wings."""

import math

import pytest

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Frame, Reader
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.stacks import stack_of
from qrsim.links.mavlink.streams import Streams
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import load_scenario

# Four kinds of vehicles are compiled.
pytestmark = pytest.mark.long
NAN = math.nan
TOLD = dict.fromkeys(("HEARTBEAT", "EXTENDED_SYS_STATE", "VFR_HUD", "LOCAL_POSITION_NED"), 50.0)
# In the order of the scenario: four X500, a hexacopter, a fixed wing, two rovers. The station is no system.
TYPES = [2, 2, 2, 2, 13, 1, 10, 10]
WING, ROVER = 6, 7


class Heard(dict):
    """The messages of each system, which are read once somebody looks at them."""

    def __init__(self, sent):
        super().__init__()
        self._sent = sent

    def __missing__(self, number):
        found, last = {"STATUSTEXT": ""}, {}
        for data in self._sent[number]:
            for read in Reader().datagram(data):
                if read.layout.name == "STATUSTEXT":
                    found["STATUSTEXT"] += read.message().text.rstrip(b"\0").decode()
                else:
                    last[read.layout.name] = read
        self[number] = found | {name: read.message() for name, read in last.items()}
        return self[number]


class Team:
    """A scenario, and what each of its vehicles sends."""

    def __init__(self, flavour="px4", scenario="mixed_team"):
        self.world = FlownWorld(prepared(load_scenario(scenario)), stack_of(flavour), seed=2)
        self.sent = {system.number: [] for system in self.world.systems}
        for system in self.world.systems:
            streams = Streams(TOLD, self.world.simulation.world.time_step)
            system.links.append(Link(system.number, streams, self.sent[system.number].append))

    def run(self, ticks=1):
        """Return of each system the last message of each name; of STATUSTEXT all."""
        self.forget()
        return self.on(ticks)

    def forget(self):
        for sent in self.sent.values():
            sent.clear()

    def on(self, ticks):
        for _ in range(ticks):
            self.world.tick(0.0)
        return Heard({number: list(sent) for number, sent in self.sent.items()})

    def ask(self, system, name, **values):
        layout = LAYOUTS[name]
        data = Frame(layout, layout.payload(target_system=system, target_component=1, **values), 0, 245, 190, 2)
        self.forget()
        for each in self.world.systems:
            handle(each, each.links[0], data)
        return self.on(1)[system]

    def command(self, system, number, *params):
        values = {f"param{i}": value for i, value in enumerate((*params, *[NAN] * (7 - len(params))), 1)}
        return self.ask(system, "COMMAND_LONG", command=number, **values)


@pytest.fixture(scope="module")
def team():
    return Team()


def test_every_vehicle_is_a_system_of_its_type(team):
    found = team.run(50)
    assert [found[number]["HEARTBEAT"].type for number in range(1, 9)] == TYPES
    # MAV_LANDED_STATE: 1 on the ground, 2 in the air.
    assert [found[number]["EXTENDED_SYS_STATE"].landed_state for number in range(1, 9)] == [1, 1, 1, 1, 1, 2, 1, 1]
    # Who is in the air is armed; all hold: main mode 4, sub mode 3.
    assert [found[number]["HEARTBEAT"].base_mode & 128 for number in range(1, 9)] == [0, 0, 0, 0, 0, 128, 0, 0]
    assert {found[number]["HEARTBEAT"].custom_mode for number in range(1, 9)} == {4 << 16 | 3 << 24}


def test_a_wing_goes_by_its_guidance_and_rovers_stand(team):
    before = team.world.simulation.truth.position_ned.copy()
    found = team.run(200)
    hud = found[WING]["VFR_HUD"]
    # The Aerosonde cruises at 25 m/s of airspeed; in this wind its speed over ground is another one.
    assert hud.airspeed == pytest.approx(25.0, abs=2.5)
    assert abs(hud.groundspeed - hud.airspeed) > 1.0
    after = team.world.simulation.truth.position_ned
    assert math.dist(after[WING - 1], before[WING - 1]) > 50.0
    assert math.dist(after[ROVER - 1], before[ROVER - 1]) < 0.05
    assert found[ROVER]["VFR_HUD"].airspeed == found[ROVER]["VFR_HUD"].groundspeed


def place(team, north, east):
    latitude, longitude, _ = team.world.systems[ROVER - 1].stack.place((north, east, 0.0))
    return {"x": round(latitude * 1e7), "y": round(longitude * 1e7)}


def test_a_rover_drives_a_mission_and_stands_at_its_end(team):
    # From (20, -50) 12 m east, then 12 m north.
    team.ask(ROVER, "MISSION_COUNT", count=2, mission_type=0)
    for seq, (north, east) in enumerate(((20.0, -38.0), (32.0, -38.0))):
        found = team.ask(
            ROVER, "MISSION_ITEM_INT", seq=seq, frame=6, command=16, param4=NAN, **place(team, north, east)
        )
    assert found["MISSION_ACK"].type == 0
    assert team.command(ROVER, 300)["COMMAND_ACK"].result == 0
    found = team.run(100)[ROVER]
    assert found["HEARTBEAT"].base_mode & 128
    assert found["HEARTBEAT"].custom_mode == 4 << 16 | 4 << 24
    speeds, points, reached = [], [], []
    path = team.world.systems[ROVER - 1].stack.craft.path
    for _ in range(60):
        found = team.run(25)[ROVER]
        speeds.append(math.hypot(*team.world.simulation.truth.velocity_ned[ROVER - 1, :2]))
        points.append(math.hypot(*path.velocity[:2]))
        reached += [found["MISSION_ITEM_REACHED"].seq] if "MISSION_ITEM_REACHED" in found else []
    # The point that it follows has the speed of the scenario's controller.
    assert max(points) == pytest.approx(2.5, abs=0.05)
    assert 2.0 < max(speeds) < 4.0
    assert reached == [0, 1]
    assert found["HEARTBEAT"].custom_mode == 4 << 16 | 3 << 24
    assert team.world.simulation.reasons[ROVER - 1] == ""
    # Within the 2 m of NAV_ACC_RAD, the way of braking and the error of its estimate.
    assert team.world.simulation.truth.position_ned[ROVER - 1, :2] == pytest.approx([32.0, -38.0], abs=4.0)
    assert speeds[-1] < 0.5
    assert team.command(ROVER, 20)["COMMAND_ACK"].result == 0
    # Home is where it was armed, 17 m away.
    found = team.run(1000)[ROVER]
    assert found["HEARTBEAT"].custom_mode == 4 << 16 | 3 << 24
    assert team.world.simulation.truth.position_ned[ROVER - 1, :2] == pytest.approx([20.0, -50.0], abs=4.0)
    # Disarmed while it drives, it stops.
    assert team.command(ROVER, 300)["COMMAND_ACK"].result == 0
    team.run(200)
    assert math.hypot(*team.world.simulation.truth.velocity_ned[ROVER - 1, :2]) > 0.5
    assert team.command(ROVER, 400, 0.0)["COMMAND_ACK"].result == 0
    team.run(200)
    assert math.hypot(*team.world.simulation.truth.velocity_ned[ROVER - 1, :2]) < 0.1


def test_what_a_rover_cannot_do_is_answered_with_the_reason(team):
    for number in (21, 22):
        found = team.command(ROVER, number)
        assert (found["COMMAND_ACK"].result, found["STATUSTEXT"]) == (2, f"Command {number} denied: a rover cannot")
    found = team.command(ROVER, 176, 1.0, 4.0, 6.0)
    assert (found["COMMAND_ACK"].result, found["STATUSTEXT"]) == (2, "Mode denied: a rover has no land")
    team.ask(ROVER, "MISSION_COUNT", count=1, mission_type=0)
    found = team.ask(ROVER, "MISSION_ITEM_INT", seq=0, frame=6, command=22, z=5.0, **place(team, 0.0, 0.0))
    # MAV_MISSION_UNSUPPORTED: a take-off.
    assert found["MISSION_ACK"].type == 3
    found = team.ask(ROVER, "SET_ATTITUDE_TARGET", type_mask=0x7, q=(1.0, 0.0, 0.0, 0.0), thrust=0.5)
    assert found["STATUSTEXT"] == "Set-point refused: a rover has no attitude to fly"


def test_a_rover_drives_by_setpoints_and_repositions(team):
    def send(seconds, **values):
        for _ in range(round(seconds * 10.0)):
            team.ask(ROVER, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, **values)
            team.on(4)

    state = team.world.simulation
    # Its local frame began at (20, -50).
    send(0.2, type_mask=0xDF8, x=10.0, y=5.0)
    assert team.command(ROVER, 176, 1.0, 6.0)["COMMAND_ACK"].result == 0
    assert team.command(ROVER, 400, 1.0)["COMMAND_ACK"].result == 0
    send(25.0, type_mask=0xDF8, x=10.0, y=5.0)
    assert team.run(5)[ROVER]["HEARTBEAT"].custom_mode == 6 << 16
    # It stops where it seems to be there, some metres off by its receiver.
    assert state.truth.position_ned[ROVER - 1, :2] == pytest.approx([30.0, -45.0], abs=4.0)
    assert math.hypot(*state.truth.velocity_ned[ROVER - 1, :2]) < 0.2
    # East, at 1.5 m/s.
    send(10.0, type_mask=0xDC7, vy=1.5)
    assert state.truth.velocity_ned[ROVER - 1, :2] == pytest.approx([0.0, 1.5], abs=0.4)
    # Without set-points it holds.
    assert team.run(150)[ROVER]["HEARTBEAT"].custom_mode == 4 << 16 | 3 << 24
    assert math.hypot(*state.truth.velocity_ned[ROVER - 1, :2]) < 0.2
    there = place(team, 20.0, -50.0)
    found = team.ask(ROVER, "COMMAND_INT", command=192, frame=6, param1=-1.0, param2=1.0, param4=NAN, z=0.0, **there)
    assert found["COMMAND_ACK"].result == 0
    team.run(1500)
    assert state.truth.position_ned[ROVER - 1, :2] == pytest.approx([20.0, -50.0], abs=4.0)
    assert state.reasons[ROVER - 1] == ""


def test_what_a_wing_cannot_obey_is_answered_with_the_reason(team):
    # MAV_RESULT: 1 temporarily rejected, 2 denied, 3 unsupported.
    for number in (21, 22):
        found = team.command(WING, number)
        assert (found["COMMAND_ACK"].command, found["COMMAND_ACK"].result) == (number, 2)
        assert found["STATUSTEXT"].endswith("there is no runway in this version")
    # Disarm in the air; a mission where there is none.
    for number, *params in ((400, 0.0), (300,)):
        assert team.command(WING, number, *params)["COMMAND_ACK"].result == 1
    for number, *params in ((400, 1.0), (410,)):
        assert team.command(WING, number, *params)["COMMAND_ACK"].result == 0
    # Of cameras nobody knows anything.
    assert team.command(WING, 2000)["COMMAND_ACK"].result == 3
    found = team.ask(WING, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0xDF8)
    assert found["STATUSTEXT"] == "Set-point denied: a fixed wing flies missions and circles"
    assert team.run(5)[WING]["HEARTBEAT"].base_mode & 128


def test_a_wing_flies_a_mission_and_circles(team):
    plan = (
        {"command": 178, "frame": 2, "param1": 0.0, "param2": 27.0, "param3": -1.0},
        {"command": 16, "frame": 6, "z": 60.0, **place(team, 0.0, 60.0)},
        {"command": 19, "frame": 6, "z": 60.0, "param1": 30.0, "param3": 135.0, **place(team, 20.0, 0.0)},
    )
    team.ask(WING, "MISSION_COUNT", count=len(plan), mission_type=0)
    for seq, item in enumerate(plan):
        found = team.ask(WING, "MISSION_ITEM_INT", seq=seq, **item)
    assert found["MISSION_ACK"].type == 0
    assert team.command(WING, 300)["COMMAND_ACK"].result == 0
    reached, away, heights, speeds = {}, [], [], []
    for second in range(80):
        found = team.run(50)[WING]
        if "MISSION_ITEM_REACHED" in found:
            reached[found["MISSION_ITEM_REACHED"].seq] = second
        north, east, down = team.world.simulation.truth.position_ned[WING - 1]
        away.append(math.hypot(north - 20.0, east))
        heights.append(-down)
        speeds.append(found["VFR_HUD"].airspeed)
    # Round the last place for 30 s from when it is near the circle; then for ever, with the scenario's 145 m.
    assert 29 <= reached[2] - reached[1] <= 45
    assert max(abs(each - 145.0) for each in away[-15:]) < 10.0
    assert sum(heights[-30:]) / 30.0 == pytest.approx(60.0, abs=2.0)
    assert sum(speeds[-30:]) / 30.0 == pytest.approx(27.0, abs=1.0)
    assert found["HEARTBEAT"].custom_mode == 4 << 16 | 3 << 24
    assert team.world.simulation.reasons[WING - 1] == ""


def test_the_hexacopter_is_flown(team):
    # Receivers are to have had fixes for some seconds.
    for _ in range(round(12.0 / team.world.simulation.world.time_step)):
        team.world.tick(0.0)
    assert team.command(5, 400, 1.0)["COMMAND_ACK"].result == 0
    assert team.command(5, 22)["COMMAND_ACK"].result == 0
    team.run(400)
    assert team.world.simulation.truth.position_ned[4, 2] < -1.5
    assert team.world.simulation.reasons[:8] == [""] * 8


def test_numbers_of_modes_of_ardupilot():
    facts = Team("ardupilot")
    # LOITER of Plane is 12; HOLD of Rover 4; LOITER of Copter 5.
    found = facts.run(5)
    assert [found[number]["HEARTBEAT"].custom_mode for number in (1, WING, ROVER)] == [5, 12, 4]


def test_an_octocopter_tells_its_type_and_takes_off():
    fleet = {
        "vehicle": {"type": "multirotor", "geometry": "octo_x", "arm": 0.4},
        "controller": {"type": "cascade", "feed": "truth"},
        "sensors": {"gnss": {"type": "gnss_receiver"}},
        "vehicles": [{"position_ned": [0.0, 0.0, -1.0]}],
    }
    content = {"name": "octo", "duration": 60.0, "fleets": {"a": fleet}}
    octo = Team(scenario=content)
    found = octo.run(150)[1]
    # MAV_TYPE_OCTOROTOR.
    assert found["HEARTBEAT"].type == 14
    assert octo.command(1, 400, 1.0)["COMMAND_ACK"].result == 0
    assert octo.command(1, 22)["COMMAND_ACK"].result == 0
    octo.run(400)
    # MIS_TAKEOFF_ALT is 2.5 m.
    assert octo.world.simulation.truth.position_ned[0, 2] == pytest.approx(-2.5, abs=0.5)
    assert octo.run(1)[1]["EXTENDED_SYS_STATE"].landed_state == 2
