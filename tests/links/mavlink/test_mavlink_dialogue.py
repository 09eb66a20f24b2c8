"""The protocols of the wire with a flight stack and no world: commands, parameters, plans, streams."""

import itertools
import math
import random
import struct

import numpy as np
import pytest

from qrsim.links.contracts import Order
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.frames import Frame, Reader, frame
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.stack.codes import Severity
from qrsim.links.mavlink.stack.contracts import Facts, Seen, Text
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.stack.modes import Mode
from qrsim.links.mavlink.streams import ONBOARD, Streams
from qrsim.links.mavlink.system import System
from qrsim.links.shared import sight
from qrsim.models.site import Site

DT = 0.02
NAN = math.nan
CLIENT = (245, 190)
# Latitude, longitude [1e-7 deg] and altitude above the sea [mm] of the default site, which is on the ellipsoid.
ORIGIN = (517119000, -2105200, -46288)


class Wire:
    """A vehicle that stands on the ground, and what it sends."""

    def __init__(self, number=1, rates=ONBOARD, flavour="px4"):
        self.lines: list[str] = []
        stack = FlightStack(Facts("a", system=number, time_step=DT), Site(), flavour=flavour)
        self.system = System(stack, "a", number, log=self.lines.append)
        self.sent: list[bytes] = []
        self.link = Link(number, Streams(rates, DT), self.sent.append)
        self.system.links.append(self.link)
        self.seen, self.tick = Seen(present=0x2B, healthy=0x2B, latitude=51.7, longitude=-0.2, altitude=40.0), 0
        self.run(100)

    def run(self, ticks, wall=0.0):
        for _ in range(ticks):
            self.tick += 1
            self.seen.time = self.tick * DT
            order = self.system.stack.tick(self.seen)
            view = self.system.view
            view.seen, view.order = self.seen, order or view.order
            self.system.publish(self.tick, wall)

    def take(self, *names):
        """Return the messages that were sent since the last call, of some names or all."""
        reader = Reader()
        found = [read.message() for data in self.sent for read in reader.datagram(data)]
        self.raw = list(self.sent)
        assert reader.damaged == 0
        self.sent.clear()
        return [message for message in found if not names or message.layout.name in names]

    def ask(self, name, sender=CLIENT, **values):
        """Send a message of a client, and return what comes back at once."""
        self.take()
        layout = LAYOUTS[name]
        handle(self.system, self.link, Frame(layout, layout.payload(**values), 0, *sender, 2))
        return self.take()

    def command(self, number, *params, target=(1, 1), **more):
        names = (f"param{i}" for i in range(1, 8))
        values = dict(zip(names, (*params, *[NAN] * (7 - len(params))), strict=True))
        return self.ask("COMMAND_LONG", target_system=target[0], target_component=target[1], command=number, **values)


@pytest.fixture
def wire():
    return Wire()


def test_every_command_has_exactly_one_answer(wire):
    draw = random.Random(3)
    for number in range(3001):
        # 246 starts the vehicle again, 400 with these numbers kills it; they are commands as all others.
        answers = wire.command(number, *(draw.choice([NAN, 0.0, 1.0, -1.0, 1e30, math.inf]) for _ in range(7)))
        acks = [answer for answer in answers if answer.layout.name == "COMMAND_ACK"]
        assert len(acks) == 1, number
        assert (acks[0].command, acks[0].target_system, acks[0].target_component) == (number, *CLIENT)
        assert 0 <= acks[0].result <= 6


def test_a_command_as_integers_and_one_that_is_not_known(wire):
    (ack,) = wire.ask("COMMAND_INT", target_system=1, target_component=1, command=35, frame=6, x=1, y=2, z=3.0)
    assert (ack.command, ack.result) == (35, 3)
    assert [answer.result for answer in wire.command(400, 1.0)] == [0]


@pytest.mark.parametrize(("target", "answers"), [((1, 1), 1), ((0, 0), 1), ((1, 0), 1), ((2, 1), 0), ((1, 100), 0)])
def test_only_what_is_for_this_vehicle_is_answered(wire, target, answers):
    assert len(wire.command(400, 1.0, target=target)) == answers
    assert wire.system.stack.armed is (answers == 1)


def test_the_fence_is_told_at_a_breach_and_when_asked(wire):
    ack, status = wire.command(512, 162.0)
    assert (ack.result, status.breach_status, status.breach_count, status.breach_type) == (0, 0, 0, 0)
    assert [answer.result for answer in wire.command(400, 1.0)] == [0]
    wire.system.stack.parameters.set("GF_MAX_VER_DIST", 5.0)
    wire.seen.on_ground, wire.seen.position_ned = False, (0.0, 0.0, -6.0)
    wire.take()
    wire.run(20)
    (status,) = wire.take("FENCE_STATUS")
    # 2 is FENCE_BREACH_MAXALT; what prevents it is unknown, 0.
    assert (status.breach_status, status.breach_count, status.breach_type, status.breach_mitigation) == (1, 1, 2, 0)
    assert 2000 <= status.breach_time <= 2200
    wire.seen.position_ned = (0.0, 0.0, -4.0)
    wire.run(20)
    (status,) = wire.take("FENCE_STATUS")
    assert (status.breach_status, status.breach_count, status.breach_type) == (0, 1, 2)
    assert [answer.result for answer in wire.command(511, 162.0, 1e6)] == [0]


def test_targets_are_those_that_are_flown(wire):
    # They are sent as soon as there are any: what does not fly by an attitude has none to send on request.
    assert [answer.result for answer in wire.command(511, 83.0, 1e5)] == [0]
    wire.system.view.order = Order("a", "attitude", (0.0, 0.0, math.pi / 2, 0.6))
    ack, target = wire.command(512, 83.0)
    assert (ack.result, target.type_mask) == (0, 0x07)
    assert target.q == pytest.approx((math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), abs=1e-6)
    assert target.thrust == pytest.approx(0.6)
    assert [answer.result for answer in wire.command(512, 87.0)] == [3]
    wire.system.view.order = Order("a", "velocity", (1.0, -2.0, 0.5, 0.25))
    _, target = wire.command(512, 87.0)
    assert (target.coordinate_frame, target.type_mask) == (5, 0x9C7)
    assert (target.vx, target.vy, target.vz, target.yaw) == (1.0, -2.0, 0.5, 0.25)
    # An arc of a meridian at 51.7 degrees is 111 260 m for a degree (WGS-84): 111.26 m are 0.001 degrees.
    wire.system.view.order = Order("a", "path", (111.26, 0.0, -10.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.5))
    _, target = wire.command(512, 87.0)
    assert target.type_mask == 0x800
    assert target.lat_int - ORIGIN[0] == pytest.approx(10_000, abs=20)
    assert target.lon_int == pytest.approx(ORIGIN[1], abs=1)
    assert target.alt == pytest.approx(ORIGIN[2] / 1e3 + 10.0, abs=0.01)
    assert (target.vx, target.vy, target.vz, target.yaw) == (1.0, 2.0, 3.0, 0.5)


def test_sticks_and_targets_of_follow_me_are_taken(wire):
    heard = []
    wire.system.stack.sticks = lambda *values: heard.append(values)
    wire.system.stack.follow_target = lambda target: heard.append(target)
    # z is 0 to 1000 with 500 in the middle; 32767 is an axis that is not told. Another system's are not taken.
    wire.ask("MANUAL_CONTROL", target=1, x=500, y=-1000, z=750, r=0x7FFF)
    wire.ask("MANUAL_CONTROL", target=2, x=1000, z=500)
    roll, pitch, throttle, yaw = heard.pop()
    assert (roll, pitch, throttle) == (-1.0, 0.5, 0.5)
    assert math.isnan(yaw)
    # RC is not taken but where COM_RC_IN_MODE says so: PX4's simulation has 1, the joystick.
    pulses = {"chan1_raw": 2000, "chan2_raw": 1000, "chan3_raw": 1500, "chan4_raw": 0xFFFF}
    wire.ask("RC_CHANNELS_OVERRIDE", target_system=1, target_component=1, **pulses)
    assert heard == []
    wire.system.stack.parameters.set("COM_RC_IN_MODE", 2)
    wire.ask("RC_CHANNELS_OVERRIDE", target_system=1, target_component=1, **pulses)
    roll, pitch, throttle, yaw = heard.pop()
    assert (roll, pitch, throttle) == (1.0, 1.0, 0.0)
    assert math.isnan(yaw)
    wire.ask("FOLLOW_TARGET", lat=473977420, lon=85455940, alt=480.0, vel=(1.0, 2.0, -0.5))
    (target,) = heard
    assert (target.latitude, target.longitude) == pytest.approx((47.397742, 8.545594))
    assert (target.altitude, target.velocity) == (480.0, (1.0, 2.0, -0.5))


def test_an_orbit_is_told_while_it_is_flown(wire):
    assert [answer.result for answer in wire.command(511, 360.0, 5e5)] == [0]
    assert [answer.result for answer in wire.command(512, 360.0)] == [3]
    stack = wire.system.stack
    stack.orbit.ask(stack.craft, (111.26, 0.0, -10.0), -20.0)
    stack.mode = Mode.ORBIT
    ack, status = wire.command(512, 360.0)
    assert (ack.result, status.radius, status.frame) == (0, -20.0, 5)
    assert (status.x - ORIGIN[0], status.y) == (pytest.approx(10_000, abs=20), pytest.approx(ORIGIN[1], abs=1))
    assert status.z == pytest.approx(ORIGIN[2] / 1e3 + 10.0, abs=0.01)


def test_wind_and_distance_are_sent_where_they_are_known(wire):
    view = wire.system.view
    assert [answer.result for number in (231.0, 132.0) for answer in wire.command(512, number)] == [3, 3]
    numbers = np.full(sight.WIDTH, NAN)
    numbers[[sight.WIND_NORTH, sight.WIND_EAST, sight.RANGE]] = 4.0, -3.0, 12.34
    view.look(numbers)
    ack, wind = wire.command(512, 231.0)
    assert (ack.result, wind.wind_x, wind.wind_y, wind.wind_z, wind.wind_alt) == (0, 4.0, -3.0, 0.0, 40.0)
    # Centimetres, and MAV_SENSOR_ROTATION_PITCH_270 is down.
    ack, distance = wire.command(512, 132.0)
    assert (ack.result, distance.current_distance, distance.orientation) == (0, 1234, 25)


def test_parameters_are_listed_and_set(wire):
    values = wire.ask("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    # PX4 begins with the hash of all.
    assert values.pop(0).param_id == b"_HASH_CHECK"
    count = values[0].param_count
    assert [value.param_index for value in values] == list(range(count))
    by_name = {value.param_id: value for value in values}
    # An integer travels as its bytes: 4001 looks like 5.6e-42.
    assert struct.pack("<f", by_name[b"SYS_AUTOSTART"].param_value) == struct.pack("<i", 4001)
    assert by_name[b"SYS_AUTOSTART"].param_type == 6
    assert by_name[b"RTL_RETURN_ALT"].param_value == 60.0
    (value,) = wire.ask("PARAM_SET", target_system=1, param_id=b"RTL_RETURN_ALT", param_value=31.5, param_type=9)
    assert (value.param_value, wire.system.stack.parameters["RTL_RETURN_ALT"]) == (31.5, 31.5)
    (value,) = wire.ask("PARAM_SET", target_system=1, param_id=b"RTL_RETURN_ALT", param_value=1e9, param_type=9)
    assert value.param_value == 150.0
    (value,) = wire.ask("PARAM_SET", target_system=1, param_id=b"RTL_RETURN_ALT", param_value=NAN, param_type=9)
    assert value.param_value == 150.0
    (value,) = wire.ask("PARAM_REQUEST_READ", target_system=1, param_id=b"RTL_RETURN_ALT", param_index=-1)
    assert value.param_value == 150.0
    (value,) = wire.ask("PARAM_REQUEST_READ", target_system=1, param_index=0)
    assert value.param_id == values[0].param_id


def test_an_integer_parameter_that_is_no_number_as_a_float(wire):
    # The bytes of -1 are those of a float that is no number.
    raw = struct.pack("<iBB16sB", -1, 1, 1, b"GF_ACTION", 6)
    layout = LAYOUTS["PARAM_SET"]
    wire.take()
    handle(wire.system, wire.link, Frame(layout, raw, 0, *CLIENT, 2))
    assert wire.system.stack.parameters["GF_ACTION"] == 0
    wire.system.stack.parameters.values["GF_ACTION"] = -1.0
    wire.sent.clear()
    wire.ask("PARAM_REQUEST_READ", target_system=1, param_id=b"GF_ACTION", param_index=-1)
    assert wire.raw[-1][10:14] == b"\xff\xff\xff\xff"


def test_parameters_of_ardupilot_are_floats():
    wire = Wire(flavour="ardupilot")
    (value,) = wire.ask("PARAM_SET", target_system=1, param_id=b"GF_ACTION", param_value=3.0, param_type=6)
    assert (value.param_value, value.param_type, wire.system.stack.parameters["GF_ACTION"]) == (3.0, 6, 3)
    _, version = wire.command(512, 148.0)
    # Parameters are cast, not bytewise.
    assert (version.capabilities & 0x20000, version.capabilities & 0x10) == (0x20000, 0)
    (beat,) = (message for message in wire.command(512, 0.0) if message.layout.name == "HEARTBEAT")
    assert (beat.autopilot, beat.type) == (3, 2)


def test_parameters_that_cannot_be_set(wire):
    (error,) = wire.ask("PARAM_SET", target_system=1, param_id=b"NO_SUCH", param_value=1.0, param_type=9)
    assert (error.layout.name, error.error, error.param_id) == ("PARAM_ERROR", 1, b"NO_SUCH")
    (error,) = wire.ask("PARAM_REQUEST_READ", target_system=1, param_id=b"NO_SUCH", param_index=-1)
    assert error.error == 1
    three = struct.unpack("<f", struct.pack("<i", 3))[0]
    error, value = wire.ask("PARAM_SET", target_system=1, param_id=b"MAV_SYS_ID", param_value=three, param_type=6)
    assert (error.error, struct.pack("<f", value.param_value)) == (5, struct.pack("<i", 1))
    (value,) = wire.ask("PARAM_SET", target_system=1, param_id=b"GF_ACTION", param_value=3.0, param_type=9)
    assert struct.pack("<f", value.param_value) == struct.pack("<i", 2)


ITEMS = [
    {"command": 22, "frame": 6, "x": 517000000, "y": -2000000, "z": 10.0},
    {"command": 16, "frame": 6, "x": 517001000, "y": -2000000, "z": 12.5, "param2": 1.0, "param4": NAN},
    {"command": 20, "frame": 2},
]


def upload(wire, items, kind=0):
    """Upload items as a client does, and return the result."""
    answers = wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=len(items), mission_type=kind)
    for _ in range(2 * len(items) + 1):
        if answers[-1].layout.name == "MISSION_ACK":
            return answers[-1].type
        assert answers[-1].layout.name == "MISSION_REQUEST_INT"
        seq = answers[-1].seq
        answers = wire.ask("MISSION_ITEM_INT", target_system=1, target_component=1, seq=seq, mission_type=kind,
                           autocontinue=1, **items[seq])  # fmt: skip
    raise AssertionError("no end")


def download(wire, kind=0):
    (count,) = wire.ask("MISSION_REQUEST_LIST", target_system=1, target_component=1, mission_type=kind)
    return [
        wire.ask("MISSION_REQUEST_INT", target_system=1, target_component=1, seq=seq, mission_type=kind)[0]
        for seq in range(count.count)
    ]


def test_a_mission_goes_up_and_comes_down(wire):
    assert upload(wire, ITEMS) == 0
    found = download(wire)
    assert [(item.command, item.frame, item.x, item.y, item.z) for item in found] == [
        (22, 6, 517000000, -2000000, 10.0), (16, 6, 517001000, -2000000, 12.5), (20, 2, 0, 0, 0.0)
    ]  # fmt: skip
    assert (found[1].param2, math.isnan(found[1].param4)) == (1.0, True)
    (item,) = wire.ask("MISSION_REQUEST", target_system=1, target_component=1, seq=1)
    assert (item.layout.name, item.x) == ("MISSION_ITEM", pytest.approx(51.7001, abs=4e-6))
    (ack,) = wire.ask("MISSION_REQUEST_INT", target_system=1, target_component=1, seq=3)
    assert ack.type == 13
    (current,) = wire.ask("MISSION_SET_CURRENT", target_system=1, target_component=1, seq=1)
    assert (current.seq, current.total) == (1, 3)
    (ack,) = wire.ask("MISSION_CLEAR_ALL", target_system=1, target_component=1)
    assert (ack.type, download(wire)) == (0, [])


def test_a_mission_of_floats(wire):
    wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=1)
    (ack,) = wire.ask(
        "MISSION_ITEM", target_system=1, target_component=1, seq=0, frame=3, command=16, x=51.7, y=-0.2, z=9.0
    )
    assert ack.type == 0
    (item,) = download(wire)
    assert (item.x, item.y) == (pytest.approx(517000000, abs=40), pytest.approx(-2000000, abs=1))


@pytest.mark.parametrize("sent", range(3))
def test_an_upload_that_breaks_off_leaves_the_mission_of_before(wire, sent):
    assert upload(wire, ITEMS) == 0
    other = [{"command": 16, "frame": 6, "x": 517002000, "y": -2000000, "z": 5.0}] * 3
    wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=3)
    for seq in range(sent):
        wire.ask("MISSION_ITEM_INT", target_system=1, target_component=1, seq=seq, **other[seq])
    # Every quarter of a second it is asked for again, ten times.
    wall, asked, acks = wire.system.transfers.upload.asked, [], []
    for _ in range(200):
        wall += 0.1
        wire.run(1, wall)
        if wire.system.transfers.upload is not None:
            wire.system.transfers.upload.asked = min(wire.system.transfers.upload.asked, wall)
        found = wire.take("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK")
        asked += [message.layout.name for message in found if message.layout.name != "MISSION_ACK"]
        acks += [message.type for message in found if message.layout.name == "MISSION_ACK"]
    # Every third time it is asked in the older dialect. MAV_MISSION_OPERATION_CANCELLED.
    by_floats = [name == "MISSION_REQUEST" for name in asked]
    assert by_floats == [False, True, False, False, True, False, False, True, False, False]
    assert acks == [15]
    assert wire.lines[-1].endswith(f"Mission upload timed out at item {sent} of 3; the one of before stays")
    assert [item.command for item in download(wire)] == [22, 16, 20]


def test_uploads_that_are_refused(wire):
    assert upload(wire, [{"command": 9999, "frame": 6, "x": 517000000, "y": -2000000, "z": 9.0}]) == 3
    assert upload(wire, [{"command": 16, "frame": 99, "x": 517000000, "y": -2000000, "z": 9.0}]) == 2
    assert download(wire) == []
    (ack,) = wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=60000)
    assert ack.type == 4
    (ack,) = wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=1, mission_type=77)
    assert ack.type == 3
    wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=2)
    (ack,) = wire.ask("MISSION_COUNT", sender=(246, 1), target_system=1, target_component=1, count=2)
    assert ack.type == 14
    # Another item than was asked for: it is asked for once more.
    (again,) = wire.ask("MISSION_ITEM_INT", target_system=1, target_component=1, seq=1, **ITEMS[1])
    assert (again.layout.name, again.seq) == ("MISSION_REQUEST_INT", 0)


def a_place(seq, name, **more):
    """Return the fields of an item that is a place, in one of the two dialects."""
    place = {"x": 51.7, "y": -0.2} if name == "MISSION_ITEM" else {"x": 517000000, "y": -2000000}
    return {"target_system": 1, "target_component": 1, "seq": seq, "frame": 3, "command": 16, "z": 9.0, **place, **more}


def test_a_client_is_asked_in_the_dialect_that_it_speaks(wire):
    (first,) = wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=3)
    assert first.layout.name == "MISSION_REQUEST_INT"
    # MAV_MISSION_UNSUPPORTED: it wants the other one, as PX4's clients say.
    (first,) = wire.ask("MISSION_ACK", target_system=1, target_component=1, type=3)
    assert (first.layout.name, first.seq) == ("MISSION_REQUEST", 0)
    (second,) = wire.ask("MISSION_ITEM", **a_place(0, "MISSION_ITEM"))
    assert (second.layout.name, second.seq) == ("MISSION_REQUEST", 1)
    # The same in the other dialect is passed over, and the next one in it is taken.
    assert wire.ask("MISSION_ITEM_INT", **a_place(0, "MISSION_ITEM_INT")) == []
    (third,) = wire.ask("MISSION_ITEM_INT", **a_place(1, "MISSION_ITEM_INT"))
    assert (third.layout.name, third.seq) == ("MISSION_REQUEST_INT", 2)
    # Another client's item is denied; that of nobody's upload is an error, but for the last one once more.
    (ack,) = wire.ask("MISSION_ITEM", sender=(246, 1), **a_place(2, "MISSION_ITEM"))
    assert ack.type == 14
    for name in ("MISSION_ITEM", "MISSION_ITEM_INT"):
        (ack,) = wire.ask(name, **a_place(2, name))
        assert ack.type == 0
    for sender, seq in ((CLIENT, 1), ((246, 1), 2)):
        (ack,) = wire.ask("MISSION_ITEM", sender=sender, **a_place(seq, "MISSION_ITEM"))
        assert (ack.type, ack.target_system) == (1, sender[0])
    assert [item.x for item in download(wire)] == [pytest.approx(517000000, abs=10)] * 3


def test_uploads_to_ardupilot_and_its_item_0():
    wire = Wire(flavour="ardupilot")
    assert wire.take("EKF_STATUS_REPORT")[0].flags == 0x33F
    # Home can be read without a mission.
    assert wire.ask("MISSION_REQUEST_LIST", target_system=1, target_component=1)[0].count == 0
    (home,) = wire.ask("MISSION_REQUEST", target_system=1, target_component=1, seq=0)
    assert (home.layout.name, home.command, home.frame, home.z) == ("MISSION_ITEM", 16, 0, 40.0)
    assert (home.x, home.y) == pytest.approx((51.7, -0.2), abs=1e-5)
    (first,) = wire.ask("MISSION_COUNT", target_system=1, target_component=1, count=2)
    (second,) = wire.ask("MISSION_ITEM_INT", **a_place(0, "MISSION_ITEM_INT", x=1, y=1))
    assert [asked.layout.name for asked in (first, second)] == ["MISSION_REQUEST"] * 2
    assert wire.ask("MISSION_ITEM", **a_place(1, "MISSION_ITEM"))[0].type == 0
    # Whatever was uploaded as home, home it is.
    assert [item.x for item in download(wire)] == [517000000, pytest.approx(517000000, abs=10)]


def test_a_guided_waypoint_of_ardupilot():
    """MISSION_ITEM with current = 2 is flown to at once in GUIDED, and answered in any case."""
    wire = Wire(flavour="ardupilot")
    # 22 m north of the site.
    there = a_place(0, "MISSION_ITEM", x=51.7121, y=-0.21052, current=2)
    # MAV_MISSION_ERROR outside GUIDED; a change of the altitude alone is accepted, and does nothing, as Copter's.
    assert [message.type for message in wire.ask("MISSION_ITEM", **there)] == [1]
    wire.ask("SET_MODE", target_system=1, base_mode=1, custom_mode=4)
    assert [message.type for message in wire.ask("MISSION_ITEM", **there)] == [1]
    assert [message.type for message in wire.ask("MISSION_ITEM", **there | {"current": 3})] == [0]
    wire.run(1)
    assert "Reposition rejected: not armed" in wire.lines[-2]
    assert "Change of altitude ignored" in wire.lines[-1]
    assert [answer.result for answer in wire.command(400, 1.0)] == [0]
    wire.seen.on_ground, wire.seen.position_ned = False, (0.0, 0.0, -9.0)
    wire.run(10)
    assert [message.type for message in wire.ask("MISSION_ITEM", **there)] == [0]
    wire.run(100)
    assert wire.system.view.order.kind == "path"
    assert wire.system.view.order.numbers[3] > 1.0
    assert abs(wire.system.view.order.numbers[4]) < 0.1
    assert wire.system.stack.heartbeat().custom_mode == 4


def test_fence_and_rally_are_plans_of_their_own(wire):
    corners = [(517000000, -2000000), (517010000, -2000000), (517010000, -1990000)]
    fence = [{"command": 5001, "frame": 5, "param1": 3.0, "x": x, "y": y} for x, y in corners]
    assert upload(wire, fence, kind=1) == 0
    assert upload(wire, [{"command": 5100, "frame": 6, "x": 517001000, "y": -2000000, "z": 20.0}], kind=2) == 0
    assert [(item.command, item.mission_type) for item in download(wire, 1)] == [(5001, 1)] * 3
    assert [(item.command, item.mission_type) for item in download(wire, 2)] == [(5100, 2)]
    assert download(wire, 0) == []
    (ack,) = wire.ask("MISSION_CLEAR_ALL", target_system=1, target_component=1, mission_type=255)
    assert (ack.type, ack.mission_type) == (0, 255)
    assert [download(wire, kind) for kind in range(3)] == [[], [], []]


def test_time_pings_files_and_logs(wire):
    wire.run(50)
    now = wire.seen.time
    (reply,) = wire.ask("TIMESYNC", tc1=0, ts1=123456789)
    assert (reply.tc1, reply.ts1) == (pytest.approx(now * 1e9, abs=1.0), 123456789)
    assert wire.ask("TIMESYNC", tc1=5, ts1=6) == []
    (reply,) = wire.ask("PING", time_usec=77, seq=4)
    assert (reply.time_usec, reply.seq, reply.target_system, reply.target_component) == (77, 4, *CLIENT)
    # OpenFileRO, 4, of a file that is not there: NAK, 129, with why: 10.
    opened = [5, 0, 3, 4] + [0] * 247
    (reply,) = wire.ask("FILE_TRANSFER_PROTOCOL", target_system=1, target_component=1, payload=opened)
    assert tuple(reply.payload[:6]) == (6, 0, 3, 129, 1, 4)
    assert reply.payload[12] == 10
    (reply,) = wire.ask("LOG_REQUEST_LIST", target_system=1, target_component=1)
    assert reply.num_logs == 0


def test_long_texts_go_out_in_pieces(wire):
    wire.take()
    text = "x" * 50 + "y" * 50
    wire.system.text(Text(Severity.WARNING, text))
    wire.run(1)
    found = wire.take("STATUSTEXT")
    assert [(piece.text, piece.chunk_seq) for piece in found] == [(b"x" * 50, 0), (b"y" * 50, 1), (b"", 2)]
    assert len({piece.id for piece in found}) == 1
    assert found[0].id > 0
    assert wire.lines[-1].endswith(text)
    wire.system.text(Text(Severity.INFO, "short"))
    wire.run(1)
    assert [(piece.text, piece.id) for piece in wire.take("STATUSTEXT")] == [(b"short", 0)]


def test_frames_are_counted_by_link(wire):
    wire.take()
    numbers = []
    wire.run(30)
    for data in wire.sent:
        numbers += [read.sequence for read in Reader().datagram(data)]
    assert [(b - a) % 256 for a, b in itertools.pairwise(numbers)] == [1] * (len(numbers) - 1)


def test_mutated_frames_disturb_nothing(wire):
    """Frames of all kinds with changed bytes and right checks: no exception, and the vehicle stays on the ground."""
    draw = random.Random(11)
    reader = Reader()
    for _ in range(4000):
        layout = draw.choice(list(LAYOUTS.values()))
        payload = bytearray(draw.randbytes(layout.struct.size))
        for data in (frame(layout.number, bytes(payload), 0, 245, 190), bytes(payload)):
            for read in reader.datagram(data):
                handle(wire.system, wire.link, read)
    wire.run(10)
    for message in wire.take("HEARTBEAT"):
        assert message.autopilot == 12
