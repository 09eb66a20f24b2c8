"""A ground station and a script that fly one vehicle, and what a client is told that goes on with a wreck."""

from __future__ import annotations

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

pytestmark = pytest.mark.long
NAN = math.nan
# System and component of a ground station, and of a program.
STATION, SCRIPT = (255, 190), (245, 190)
ACCEPTED, REJECTED, DENIED = 0, 1, 2
LAND, OFFBOARD = 4 << 16 | 6 << 24, 6 << 16
TOLD = {"HEARTBEAT": 1.0}


class Shared:
    """The first vehicle of mavlink_field, with a link of each of two clients."""

    def __init__(self):
        self.world = FlownWorld(prepared(load_scenario("mavlink_field")), stack_of(), seed=7)
        self.system = self.world.systems[0]
        self.links, self.sent = {}, {STATION: [], SCRIPT: []}
        for who, sent in self.sent.items():
            self.links[who] = Link(1, Streams(TOLD, 0.02), sent.append)
            self.system.links.append(self.links[who])
        self.run(2.0)

    def run(self, seconds, each=None):
        for tick in range(round(seconds / 0.02)):
            if each is not None and tick % 5 == 0:
                each()
            self.world.tick(0.0)

    def take(self, who, *names):
        found = [read.message() for data in self.sent[who] for read in Reader().datagram(data)]
        self.sent[who].clear()
        return [message for message in found if message.layout.name in names]

    def ask(self, who, name, **values):
        layout = LAYOUTS[name]
        if any(field.name == "target_system" for field in layout.fields):
            values |= {"target_system": 1, "target_component": 1}
        handle(self.system, self.links[who], Frame(layout, layout.payload(**values), 0, *who, 2))

    def command(self, who, number, *params):
        """Give a command; return its results on the client's own link, and whom they are for."""
        for sent in self.sent.values():
            sent.clear()
        params = (*params, *[NAN] * (7 - len(params)))
        self.ask(who, "COMMAND_LONG", command=number, **{f"param{i}": value for i, value in enumerate(params, 1)})
        other = SCRIPT if who == STATION else STATION
        assert self.take(other, "COMMAND_ACK") == []
        (ack,) = self.take(who, "COMMAND_ACK")
        assert (ack.command, ack.target_system, ack.target_component) == (number, *who)
        return ack.result

    def point(self, north, down):
        self.ask(SCRIPT, "SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=1, type_mask=0xDF8, x=north, z=down)

    def texts(self, who):
        return [message.text.rstrip(b"\0").decode() for message in self.take(who, "STATUSTEXT")]


@pytest.fixture(scope="module")
def shared():
    return Shared()


def test_a_station_takes_over_from_a_script_which_goes_on_and_each_is_answered_alone(shared):
    point = lambda: shared.point(4.0, -6.0)  # noqa: E731
    point()
    assert shared.command(SCRIPT, 176, 1, 6) == ACCEPTED
    assert shared.command(STATION, 400, 1) == ACCEPTED
    shared.run(10.0, point)
    assert shared.world.simulation.truth.position_ned[0] == pytest.approx([4.0, 0.0, -6.0], abs=1.5)
    # The station lands it; set-points of the script are heard, and not flown any more.
    assert shared.command(STATION, 21) == ACCEPTED
    shared.run(2.0, point)
    for who in (STATION, SCRIPT):
        assert shared.take(who, "HEARTBEAT")[-1].custom_mode == LAND
    # The script may take it back, and the station again.
    assert shared.command(SCRIPT, 176, 1, 6) == ACCEPTED
    shared.run(1.0, point)
    assert shared.take(STATION, "HEARTBEAT")[-1].custom_mode == OFFBOARD
    assert shared.command(SCRIPT, 400, 0) == REJECTED
    assert shared.command(STATION, 21) == ACCEPTED
    shared.run(20.0, point)
    assert not shared.system.stack.armed
    # Texts are for both.
    assert shared.texts(SCRIPT)[-2:] == shared.texts(STATION)[-2:] == ["Landing detected", "Disarmed by landing"]
    assert shared.world.simulation.reasons == [""] * 5


def test_uploads_of_two_are_kept_apart(shared):
    shared.ask(SCRIPT, "MISSION_COUNT", count=2)
    shared.ask(STATION, "MISSION_COUNT", count=1)
    (denied,) = shared.take(STATION, "MISSION_ACK")
    # MAV_MISSION_DENIED, and the upload goes on.
    assert (denied.type, denied.target_system) == (14, 255)
    for seq in (0, 1):
        shared.ask(SCRIPT, "MISSION_ITEM_INT", seq=seq, frame=6, command=22, z=5.0, param4=NAN)
    (accepted,) = shared.take(SCRIPT, "MISSION_ACK")
    assert (accepted.type, accepted.target_system) == (0, 245)
    assert shared.take(STATION, "MISSION_ACK") == []


def test_whoever_goes_on_with_a_wreck_is_told_so(shared):
    assert shared.command(SCRIPT, 400, 1) == ACCEPTED
    assert shared.command(SCRIPT, 22, NAN, NAN, NAN, NAN, NAN, NAN, 488.0 + 8.0) == ACCEPTED
    shared.run(8.0)
    assert shared.command(STATION, 400, 0, 21196) == ACCEPTED
    shared.run(3.0)
    assert shared.world.simulation.reasons[0].startswith("crashed: impact_speed = ")
    for number in (20, 21, 22, 34, 192, 300, 400):
        params = (1.0,) if number == 400 else (-1.0, 1.0) if number == 192 else ()
        assert shared.command(SCRIPT, number, *params) == REJECTED, number
        shared.run(0.02)
        assert "crashed: impact_speed" in "".join(shared.texts(SCRIPT)), number
    for _ in range(20):
        shared.point(0.0, -5.0)
    shared.run(0.02)
    text = "".join(shared.texts(SCRIPT))
    # Said once.
    assert text.startswith("Set-point refused: flight has ended: crashed: impact_speed = ")
    assert text.count("Set-point refused") == 1
