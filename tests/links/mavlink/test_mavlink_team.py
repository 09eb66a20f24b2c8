"""All kinds of vehicles as systems: their types, and missions of rovers, fixed wings by their guidance."""

import math

import pytest

from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Frame, Reader
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.own_guidance import stack_of
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


class Team:
    """The scenario mixed_team, and what each of its vehicles sends."""

    def __init__(self, flavour="px4"):
        self.world = FlownWorld(prepared(load_scenario("mixed_team")), stack_of(flavour), seed=2)
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
        return {number: self.read(number) for number in self.sent}

    def read(self, number):
        found = {"STATUSTEXT": ""}
        for data in self.sent[number]:
            for read in Reader().datagram(data):
                if read.layout.name == "STATUSTEXT":
                    found["STATUSTEXT"] += read.message().text.rstrip(b"\0").decode()
                else:
                    found[read.layout.name] = read.message()
        return found

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
    # Who goes by the scenario is armed and in AUTO.MISSION: main mode 4, sub mode 4; the others hold, sub mode 3.
    assert [found[number]["HEARTBEAT"].base_mode & 128 for number in range(1, 9)] == [0, 0, 0, 0, 0, 128, 0, 0]
    assert found[WING]["HEARTBEAT"].custom_mode == 4 << 16 | 4 << 24
    assert found[ROVER]["HEARTBEAT"].custom_mode == 4 << 16 | 3 << 24


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
    for number in (21, 22, 192):
        found = team.command(ROVER, number)
        assert (found["COMMAND_ACK"].result, found["STATUSTEXT"]) == (2, f"Command {number} denied: a rover cannot")
    found = team.command(ROVER, 176, 1.0, 6.0)
    assert (found["COMMAND_ACK"].result, found["STATUSTEXT"]) == (2, "Mode denied: a rover has no offboard")
    team.ask(ROVER, "MISSION_COUNT", count=1, mission_type=0)
    found = team.ask(ROVER, "MISSION_ITEM_INT", seq=0, frame=6, command=22, z=5.0, **place(team, 0.0, 0.0))
    # MAV_MISSION_UNSUPPORTED: a take-off.
    assert found["MISSION_ACK"].type == 3
    found = team.ask(ROVER, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0xDF8)
    assert found["STATUSTEXT"] == "Set-point denied: a rover drives missions"


def test_what_a_wing_cannot_obey_is_answered_with_the_reason(team):
    # MAV_RESULT: 0 accepted, 2 denied, 3 unsupported. Return, land, take off, set mode (hold), reposition, disarm.
    asked = ((20,), (21,), (22,), (176, 1.0, 4.0, 3.0), (192,), (400, 0.0), (300,), (178, 0.0, 3.0), (185, 1.0))
    for number, *params in asked:
        found = team.command(WING, number, *params)
        assert (found["COMMAND_ACK"].command, found["COMMAND_ACK"].result) == (number, 2)
        assert "denied: goes by its scenario's guidance" in found["STATUSTEXT"]
    # To arm who is armed, the mode that it is in, where home is.
    for number, *params in ((400, 1.0), (176, 1.0, 4.0, 4.0), (410,), (179, 1.0)):
        assert team.command(WING, number, *params)["COMMAND_ACK"].result == 0
    # Of cameras nobody knows anything.
    assert team.command(WING, 2000)["COMMAND_ACK"].result == 3
    assert team.run(5)[WING]["HEARTBEAT"].base_mode & 128


def test_a_mission_for_a_vehicle_that_takes_none_is_denied(team):
    found = team.ask(WING, "MISSION_COUNT", count=1, mission_type=0)
    assert found["MISSION_REQUEST_INT"].seq == 0
    found = team.ask(WING, "MISSION_ITEM_INT", seq=0, frame=6, command=16, x=517000000, y=-2000000, mission_type=0)
    # MAV_MISSION_DENIED.
    assert found["MISSION_ACK"].type == 14
    assert found["STATUSTEXT"] == "Mission denied: goes by its scenario's guidance"
    found = team.ask(WING, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0xDF8)
    assert found["STATUSTEXT"] == "Set-point denied: goes by its scenario's guidance"


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
    # AUTO of Plane is 10; HOLD of Rover 4; LOITER of Copter 5.
    found = facts.run(5)
    assert [found[number]["HEARTBEAT"].custom_mode for number in (1, WING, ROVER)] == [5, 10, 4]
