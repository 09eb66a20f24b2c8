"""A fleet behind real sockets: pymavlink flies one of many, sends what it should not, and does not read."""

from __future__ import annotations

import asyncio
import collections
import math
import os
import random
import socket
import struct
import threading
import time
from contextlib import suppress

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil

from qrsim.links.mavlink import ports
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.fleet import prepared
from qrsim.links.mavlink.frames import Reader, frame
from qrsim.links.mavlink.server import MOST_STALE, Server, Wire
from qrsim.links.mavlink.stack.flight_stack import FlightStack
from qrsim.links.mavlink.world import FlownWorld
from qrsim.scenarios.scenario import load_scenario

# Sockets in the short tier: test_mavlink_world.py.
pytestmark = pytest.mark.long
M = mavutil.mavlink
NAN = math.nan
VEHICLES, FACTOR, PATIENCE_S = 21, 5.0, 20.0
# MAV_RESULT.
ACCEPTED, LATER, DENIED, UNSUPPORTED, FAILED = range(5)
CONTENT = {
    "name": "many",
    "duration": 600.0,
    "site": {"latitude_deg": 47.4, "longitude_deg": 8.5, "height_amsl": 400.0},
    "world": {
        "area": {"type": "box", "x_min": -100, "x_max": 100, "y_min": -100, "y_max": 200, "z_min": -100, "z_max": 0}
    },
    "fleets": {
        "row": {
            "controller": {"type": "cascade", "feed": "truth"},
            "sensors": {"gnss": {"type": "gnss_receiver"}},
            "vehicles": [{"position_ned": [0, 5 * i, 0]} for i in range(VEHICLES)],
        },
    },
}


class Served:
    """A server in a thread of its own, as ``qrsim mavlink --tcp`` runs it."""

    def __init__(self, flavour="px4", vehicles=VEHICLES, factor=FACTOR):
        fleet = CONTENT["fleets"]["row"]
        content = CONTENT | {"fleets": {"row": fleet | {"vehicles": fleet["vehicles"][:vehicles]}}}

        def stack(facts, site):
            return FlightStack(facts, site, flavour=flavour)

        self.lines: list[str] = []
        self.world = FlownWorld(prepared(load_scenario(content)), stack, factor=factor, log=self.lines.append)
        self.ports = ports.opened(vehicles, ports.HERE, True, False)
        self.server = Server(self.world, self.ports, Wire(factor), self.lines.append)
        self._loop = asyncio.new_event_loop()
        self._task = self._loop.create_task(self.server.serve())
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self.until(lambda: self.world.simulation.tick > 0)

    def _run(self):
        with suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._task)

    def end(self):
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(PATIENCE_S)
        self.ports.close()

    def client(self, vehicle):
        return Client(f"udpout:{ports.HERE}:{self.ports.onboard + vehicle}", vehicle + 1)

    def said(self, vehicle, words):
        """Wait for a line of the log that begins so; return how many there are."""
        found = lambda: sum(f"'row_{vehicle}': {words}" in line for line in self.lines)  # noqa: E731
        self.until(found)
        return found()

    def until(self, holds):
        end = time.monotonic() + PATIENCE_S
        while not holds():
            assert time.monotonic() < end, self.lines
            time.sleep(0.02)


class Client:
    """A program with pymavlink."""

    def __init__(self, address, system):
        self.system = system
        self.link = mavutil.mavlink_connection(address, source_system=245)
        self.mav = self.link.mav
        if address.startswith("udpout"):
            self.mav.heartbeat_send(M.MAV_TYPE_ONBOARD_CONTROLLER, M.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def until(self, kind, holds=lambda message: True, repeat=lambda: None):
        end, again = time.monotonic() + PATIENCE_S, 0.0
        while time.monotonic() < end:
            if time.monotonic() - again > 0.05:
                again = time.monotonic()
                repeat()
            found = self.link.recv_match(type=kind, blocking=True, timeout=0.02)
            if found is not None and found.get_srcSystem() == self.system and holds(found):
                return found
        raise AssertionError(f"no such {kind}")

    def command(self, number, *params):
        """Send a command; return its result."""
        self.mav.command_long_send(self.system, 1, number, 0, *params, *[NAN] * (7 - len(params)))
        return self.until("COMMAND_ACK", lambda ack: ack.command == number).result

    def answers(self):
        """Return what has come until a PING comes back: all that was sent before is answered."""
        self.mav.ping_send(0, 77, 0, 0)
        found = []
        while not (found and found[-1].get_type() == "PING"):
            message = self.link.recv_match(blocking=True, timeout=PATIENCE_S)
            assert message is not None
            found.append(message)
        return found

    def fly(self, height):
        """Arm, and take off to a height [m] over the site."""
        self.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
        assert self.command(400, 1) == ACCEPTED
        assert self.command(22, NAN, NAN, NAN, NAN, NAN, NAN, 400.0 + height) == ACCEPTED
        self.until("HEARTBEAT", lambda beat: beat.custom_mode == 4 << 16 | 3 << 24)


@pytest.fixture(scope="module")
def served():
    found = Served()
    yield found
    found.end()


def test_of_many_on_one_port_one_is_flown(served):
    # From the tenth vehicle on all speak to one port, whose client sends each frame to all of them.
    client = Client(f"udpin:{ports.HERE}:{served.ports.peers[-1]}", 15)
    heard = set()
    while len(heard) < 12:
        heard.add(client.link.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S).get_srcSystem())
    assert heard == set(range(10, 22))
    client.fly(4.0)
    heights = -served.world.simulation.truth.position_ned[:, 2]
    assert heights[14] == pytest.approx(4.0, abs=0.6)
    assert max(abs(height) for row, height in enumerate(heights) if row != 14) < 0.05
    assert [system.number for system in served.world.systems if system.stack.armed] == [15]
    assert served.said(14, "Armed by external command") == 1


def test_every_command_has_one_answer_by_udp_and_what_is_refused_a_line_in_the_log(served):
    # Of vehicle 3, on the ground and disarmed.
    acks = collections.Counter()
    results = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect((ports.HERE, served.ports.onboard + 3))
        sock.settimeout(PATIENCE_S)
        layout, reader = LAYOUTS["COMMAND_LONG"], Reader()
        unset = {f"param{i}": NAN for i in range(1, 8)}
        for number in range(3001):
            payload = layout.payload(target_system=4, target_component=1, command=number, **unset)
            sock.send(frame(layout.number, payload, number & 255, 245, 190))
            if number % 50 and number != 3000:
                continue
            while len(acks) <= number:
                for read in reader.datagram(sock.recv(1 << 16)):
                    if read.layout.name == "COMMAND_ACK":
                        acks[read.message().command] += 1
                        results[read.message().command] = read.message().result
    assert acks == dict.fromkeys(range(3001), 1)
    others = {number: result for number, result in results.items() if result != UNSUPPORTED}
    assert others == {
        20: ACCEPTED, 21: ACCEPTED, 22: ACCEPTED, 178: ACCEPTED, 185: ACCEPTED, 246: ACCEPTED, 410: ACCEPTED,
        510: ACCEPTED, 300: LATER, 34: LATER, 179: DENIED, 192: DENIED, 224: DENIED, 400: DENIED, 511: DENIED,
        262: FAILED, 519: ACCEPTED, 520: ACCEPTED,
    }  # fmt: skip
    assert served.said(3, "command 33 of system 245: unsupported") == 1
    assert served.said(3, "command 192 of system 245: denied") == 1
    assert served.said(3, "Mission rejected: no mission") == 1
    again = served.client(3)
    assert again.command(33) == UNSUPPORTED
    assert served.said(3, "command 33 ") == 1
    assert again.command(176, 1, 4, 3) == ACCEPTED


def test_harmed_frames_and_those_for_others_are_passed_over_and_replayed_ones_are_answered(served):
    client = served.client(4)
    arm = M.MAVLink_command_long_message(5, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    raw = arm.pack(client.mav)
    other = M.MAVLink_command_long_message(6, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(client.mav)
    camera = M.MAVLink_command_long_message(5, 100, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(client.mav)
    harmed = raw[:-1] + bytes([raw[-1] ^ 1])
    for data in (harmed, other, camera, raw[:-3], b"\xfd" * 300, b"\xfe\xff", b""):
        client.link.port.sendto(data, client.link.destination_addr)
    assert [m for m in client.answers() if m.get_type() == "COMMAND_ACK"] == []
    assert not any(served.world.systems[number].stack.armed for number in (4, 5))
    client.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
    # Behind noise, and three times: one answer each, and armed once.
    for data in (b"\xfd\x01noise", b"noise" + raw, raw, raw):
        client.link.port.sendto(data, client.link.destination_addr)
    results = [m.result for m in client.answers() if m.get_type() == "COMMAND_ACK"]
    assert results == [ACCEPTED] * 3
    assert served.said(4, "Armed by external command") == 1
    assert client.command(400, 0) == ACCEPTED


@pytest.mark.parametrize(("vehicle", "frame_of", "alt"), [(5, 5, 406.0), (6, 6, 6.0), (7, 11, 6.0)])
def test_global_set_points_are_flown_in_their_frames(served, vehicle, frame_of, alt):
    client = served.client(vehicle)
    client.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
    # A degree of latitude is 111 178 m here (WGS-84): 4 m north, 6 m up.
    north = round((47.4 + 4.0 / 111178.0) * 1e7)
    east = served.world.systems[vehicle].stack.place((0.0, 5.0 * vehicle, 0.0))[1]

    def send(altitude=alt, mask=0xDF8):
        client.mav.set_position_target_global_int_send(
            0, vehicle + 1, 1, frame_of, mask, north, round(east * 1e7), altitude, 0, 0, 0, 0, 0, 0, 0, 0
        )

    # Without a set-point, or with one without a height, there is no OFFBOARD.
    assert client.command(176, 1, 6) == LATER
    send(altitude=NAN)
    assert client.command(176, 1, 6) == LATER
    assert served.said(vehicle, "Set-point refused: ") == 1
    send()
    assert client.command(176, 1, 6) == ACCEPTED
    assert client.command(400, 1) == ACCEPTED
    client.until("LOCAL_POSITION_NED", lambda here: abs(here.x - 4.0) < 0.3 and abs(here.z + 6.0) < 0.3, send)
    assert served.world.simulation.truth.position_ned[vehicle] == pytest.approx([4.0, 5.0 * vehicle, -6.0], abs=0.5)
    # Refused ones are no sign of life: what was flown is held, as COM_OBL_RC_ACT says.
    client.until("HEARTBEAT", lambda beat: beat.custom_mode == 4 << 16 | 3 << 24, lambda: send(altitude=NAN))
    assert served.said(vehicle, "Failsafe: no offboard set-points") == 1


def test_two_that_are_sent_to_one_local_place_fly_side_by_side(served):
    """Each from where it stood, as MAVSDK's example flies two; the program of one starts again meanwhile."""
    clients = [served.client(vehicle) for vehicle in (17, 18)]

    def send(client):
        client.mav.set_position_target_local_ned_send(
            0, client.system, 1, 1, 0xDF8, 3.0, 6.0, -5.0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def send_all():
        for client in clients:
            send(client)

    for client in clients:
        client.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
        send_all()
        assert client.command(176, 1, 6) == ACCEPTED
        assert client.command(400, 1) == ACCEPTED
    # Another port, and another system id.
    clients[1] = Client(f"udpout:{ports.HERE}:{served.ports.onboard + 18}", 19)
    clients[1].mav.srcSystem = 200
    there = lambda now: math.dist((now.x, now.y, now.z), (3.0, 6.0, -5.0)) < 0.3  # noqa: E731
    for client in clients:
        client.until("LOCAL_POSITION_NED", there, send_all)
    truth = served.world.simulation.truth.position_ned
    assert truth[17] == pytest.approx([3.0, 91.0, -5.0], abs=0.5)
    assert truth[18] == pytest.approx([3.0, 96.0, -5.0], abs=0.5)
    send_all()
    assert clients[1].command(21) == ACCEPTED


def test_an_attitude_with_thrust_is_flown(served):
    client = served.client(8)
    client.mav.param_request_read_send(9, 1, b"MPC_THR_HOVER", -1)
    hover = client.until("PARAM_VALUE", lambda value: value.param_id == "MPC_THR_HOVER").param_value
    client.fly(6.0)
    level, lean = [1.0, 0.0, 0.0, 0.0], [math.cos(-0.1), 0.0, math.sin(-0.1), 0.0]

    def send(q, thrust, mask=7):
        client.mav.set_attitude_target_send(0, 9, 1, mask, q, 0, 0, 0, thrust)

    for q, thrust in (([NAN] * 4, 0.5), ([0.0] * 4, 0.5), (level, NAN), (level, 1.5)):
        send(q, thrust)
    assert client.command(176, 1, 6) == LATER
    assert served.said(8, "Set-point refused: quaternion is none") == 1
    send(level, hover)
    assert client.command(176, 1, 6) == ACCEPTED
    # Nose down by 0.2 rad, with the thrust that carries the weight: ahead, and about as high.
    client.until("LOCAL_POSITION_NED", lambda here: here.vx > 1.0, lambda: send(lean, hover / math.cos(0.2)))
    assert client.until("ATTITUDE").pitch == pytest.approx(-0.2, abs=0.05)
    assert client.until("LOCAL_POSITION_NED").z == pytest.approx(-6.0, abs=1.5)
    assert client.command(21) == ACCEPTED


def upload(client, kind, items):
    """Upload a plan of (command, frame, param1, latitude, longitude, height); return MAV_MISSION_RESULT."""
    client.mav.mission_count_send(client.system, 1, len(items), kind)
    while True:
        asked = client.until(["MISSION_REQUEST_INT", "MISSION_ACK"])
        if asked.get_type() == "MISSION_ACK":
            return asked.type
        number, frame_of, first, latitude, longitude, height = items[asked.seq]
        client.mav.mission_item_int_send(
            client.system, 1, asked.seq, frame_of, number, 0, 1, first, 0, 0, NAN, round(latitude * 1e7),
            round(longitude * 1e7), height, kind,
        )  # fmt: skip


def test_a_mission_outside_the_fence_and_an_arming_outside_it(served):
    client = served.client(9)
    client.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
    # 47.41 degrees is 1.1 km north of an area of 100 m.
    assert upload(client, 0, [(22, 6, 0.0, 47.4, 8.5, 5.0), (16, 6, 0.0, 47.41, 8.5, 5.0)]) == 0
    assert client.command(300) == LATER
    assert served.said(9, "Mission rejected: item 1 is outside the fence")
    assert client.command(400, 1) == ACCEPTED
    assert client.command(400, 0) == ACCEPTED
    # A circle of 20 m far away: it stands outside, and is not healthy.
    assert upload(client, 1, [(5003, 5, 20.0, 47.4005, 8.5, 0.0)]) == 0
    assert client.command(400, 1) == LATER
    assert served.said(9, "Preflight Fail: ")
    client.until("SYS_STATUS", lambda s: not s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)


def test_who_does_not_read_costs_the_others_nothing(served):
    stalled = socket.socket()
    stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    # Its requests go out one by one.
    stalled.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stalled.connect((ports.HERE, served.ports.tcp))
    served.until(lambda: len(served.server.clients) == 1)
    (connection,) = served.server.clients
    waits = lambda: connection._transport.get_write_buffer_size()  # noqa: E731
    client, request = served.client(10), LAYOUTS["PARAM_REQUEST_LIST"]
    ask = frame(request.number, request.payload(target_system=0, target_component=1), 0, 245, 190)
    while waits() < MOST_STALE:
        stalled.sendall(ask)
        client.answers()
    # Streams are left out from there on.
    before, tick = waits(), served.world.simulation.tick
    served.until(lambda: served.world.simulation.tick > tick + 100)
    assert waits() < before + 30_000
    # Who asks on and on and reads no answer is given up.
    for _ in range(200):
        try:
            stalled.sendall(20 * ask)
            client.answers()
        except OSError:
            break
    stalled.close()
    served.until(lambda: not served.server.clients)
    assert served.lines.count("a client by TCP does not read, and is given up") == 1
    assert client.command(520, 1) == ACCEPTED


def test_who_speaks_no_mavlink_or_hangs_up_costs_the_others_nothing(served, caplog):
    nonsense = random.Random(1).randbytes(1 << 14)
    with socket.create_connection((ports.HERE, served.ports.tcp)) as other:
        for _ in range(1000):
            try:
                other.sendall(nonsense)
            except OSError:
                break
    served.until(lambda: not served.server.clients)
    assert served.lines.count("a client by TCP sends no MAVLink, and is given up") == 1
    # A frame now and then is enough.
    beat = frame(0, LAYOUTS["HEARTBEAT"].payload(type=6), 0, 245, 190)
    with socket.create_connection((ports.HERE, served.ports.tcp)) as noisy:
        for _ in range(10):
            noisy.sendall(nonsense + bytes(300) + beat)
        served.until(lambda: len(served.server.clients) == 1)
        (connection,) = served.server.clients
        served.until(lambda: connection._reader.skipped > 100_000)
        assert len(served.server.clients) == 1
    clients = [socket.create_connection((ports.HERE, served.ports.tcp)) for _ in range(20)]
    served.until(lambda: len(served.server.clients) == 20)
    for each in clients:
        # Without a farewell: a reset.
        each.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        each.close()
    served.until(lambda: not served.server.clients)
    assert [record.message for record in caplog.records] == []
    assert served.client(11).command(520, 1) == ACCEPTED


def test_a_client_of_ardupilot():
    served = Served("ardupilot", 1, 10.0)
    try:
        client = served.client(0)
        client.until("SYS_STATUS", lambda s: s.onboard_control_sensors_health & M.MAV_SYS_STATUS_PREARM_CHECK)
        beat = client.until("HEARTBEAT")
        assert (beat.autopilot, mavutil.mode_mapping_acm[beat.custom_mode]) == (3, "LOITER")
        assert client.command(400, 1) == ACCEPTED
        # As Copter: a take-off in GUIDED only.
        assert client.command(22, 0, 0, 0, 0, 0, 0, 5) == FAILED
        client.mav.set_mode_send(1, 1, 4)
        assert client.until("COMMAND_ACK").result == ACCEPTED
        assert client.command(400, 1) == ACCEPTED
        assert client.command(22, 0, 0, 0, 0, 0, 0, 5) == ACCEPTED
        client.until("GLOBAL_POSITION_INT", lambda here: here.relative_alt > 4500)
        north = round((47.4 + 6.0 / 111178.0) * 1e7)
        # Said once, as programs for ArduPilot do.
        client.mav.set_position_target_global_int_send(0, 1, 1, 6, 0xDF8, north, 85000000, 7.0, 0, 0, 0, 0, 0, 0, 0, 0)
        client.until("LOCAL_POSITION_NED", lambda here: abs(here.x - 6.0) < 0.3 and abs(here.z + 7.0) < 0.3)
        assert mavutil.mode_mapping_acm[client.until("HEARTBEAT").custom_mode] == "GUIDED"
        client.mav.param_set_send(1, 1, b"RTL_RETURN_ALT", 8.0, 9)
        client.mav.set_mode_send(1, 1, 6)
        assert client.until("COMMAND_ACK").result == ACCEPTED
        client.until("HEARTBEAT", lambda beat: not beat.base_mode & M.MAV_MODE_FLAG_SAFETY_ARMED)
        assert served.world.simulation.truth.position_ned[0] == pytest.approx([0.0, 0.0, 0.0], abs=0.5)
    finally:
        served.end()
