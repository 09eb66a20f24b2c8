"""All kinds of vehicles as systems: their types, and rovers and fixed wings by their scenario's guidance."""

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
    # Those that go by the scenario are armed and in AUTO.MISSION: main mode 4, sub mode 4.
    assert [found[number]["HEARTBEAT"].base_mode & 128 for number in range(1, 9)] == [0, 0, 0, 0, 0, 128, 128, 128]
    assert found[WING]["HEARTBEAT"].custom_mode == found[ROVER]["HEARTBEAT"].custom_mode == 4 << 16 | 4 << 24


def test_rovers_and_wings_go_by_their_guidance(team):
    before = {number: team.run(25)[number]["LOCAL_POSITION_NED"] for number in (WING, ROVER)}
    found = team.run(200)
    hud = found[WING]["VFR_HUD"]
    # The Aerosonde cruises at 25 m/s of airspeed; in this wind its speed over ground is another one.
    assert hud.airspeed == pytest.approx(25.0, abs=2.5)
    assert abs(hud.groundspeed - hud.airspeed) > 1.0
    # The rover drives east at 2.5 m/s; its airspeed is the speed over ground.
    rover = found[ROVER]["VFR_HUD"]
    assert found[ROVER]["LOCAL_POSITION_NED"].y > before[ROVER].y + 5.0
    assert rover.airspeed == rover.groundspeed
    assert math.isclose(rover.groundspeed, 2.5, abs_tol=0.5)


@pytest.mark.parametrize("system", [WING, ROVER])
def test_what_they_cannot_obey_is_answered_with_the_reason(team, system):
    # MAV_RESULT: 0 accepted, 2 denied, 3 unsupported. Return, land, take off, set mode (hold), reposition, disarm.
    asked = ((20,), (21,), (22,), (176, 1.0, 4.0, 3.0), (192,), (400, 0.0), (300,), (178, 0.0, 3.0), (185, 1.0))
    for number, *params in asked:
        found = team.command(system, number, *params)
        assert (found["COMMAND_ACK"].command, found["COMMAND_ACK"].result) == (number, 2)
        assert "denied: goes by its scenario's guidance" in found["STATUSTEXT"]
    # To arm who is armed, the mode that it is in, where home is.
    for number, *params in ((400, 1.0), (176, 1.0, 4.0, 4.0), (410,), (179, 1.0)):
        assert team.command(system, number, *params)["COMMAND_ACK"].result == 0
    # Of cameras nobody knows anything.
    assert team.command(system, 2000)["COMMAND_ACK"].result == 3
    assert team.run(5)[system]["HEARTBEAT"].base_mode & 128


def test_a_mission_for_a_vehicle_that_takes_none_is_denied(team):
    found = team.ask(ROVER, "MISSION_COUNT", count=1, mission_type=0)
    assert found["MISSION_REQUEST_INT"].seq == 0
    found = team.ask(ROVER, "MISSION_ITEM_INT", seq=0, frame=6, command=16, x=517000000, y=-2000000, mission_type=0)
    # MAV_MISSION_DENIED.
    assert found["MISSION_ACK"].type == 14
    assert found["STATUSTEXT"] == "Mission denied: goes by its scenario's guidance"
    found = team.ask(ROVER, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0xDF8)
    assert found["STATUSTEXT"] == "Set-point denied: goes by its scenario's guidance"


def test_the_hexacopter_is_flown(team):
    team.command(5, 400, 1.0)
    assert team.command(5, 22)["COMMAND_ACK"].result == 0
    team.run(400)
    assert team.world.simulation.truth.position_ned[4, 2] < -1.5
    assert team.world.simulation.reasons[:8] == [""] * 8


def test_numbers_of_modes_of_ardupilot():
    facts = Team("ardupilot")
    # AUTO of Plane and Rover is 10; LOITER of Copter 5.
    found = facts.run(5)
    assert [found[number]["HEARTBEAT"].custom_mode for number in (1, WING, ROVER)] == [5, 10, 10]
