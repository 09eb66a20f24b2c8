"""Messages that clients ask for: streams, modes, versions and the hash of parameters."""

import struct

import pytest
from test_mavlink_dialogue import DT, NAN, ORIGIN, Wire

from qrsim.links.mavlink.streams import GROUND, Streams


@pytest.fixture
def wire():
    return Wire()


def test_intervals_of_messages(wire):
    (ack,) = wire.command(511, 105.0, 100_000.0)
    assert ack.result == 2  # no inertial sensor here
    assert [answer.result for answer in wire.command(511, 999.0, 1e5)] == [2]
    assert [answer.result for answer in wire.command(511, 32.0, 100_000.0)] == [0]
    ack, interval = wire.command(510, 32.0)
    assert (interval.message_id, interval.interval_us) == (32, 100_000)
    wire.take()
    wire.run(100)
    assert len(wire.take("LOCAL_POSITION_NED")) == 20
    wire.command(511, 32.0, -1.0)
    wire.run(100)
    assert wire.take("LOCAL_POSITION_NED") == []
    wire.command(511, 32.0, 0.0)
    wire.run(100)
    assert 59 <= len(wire.take("LOCAL_POSITION_NED")) <= 61


def test_streams_that_a_client_asked_for_end_with_it(wire):
    wire.command(511, 32.0, 100_000.0)
    wire.run(1, wall=wire.link.heard + 9.0)
    assert wire.command(510, 32.0)[1].interval_us == 100_000
    wire.run(1, wall=wire.link.heard + 11.0)
    assert wire.command(510, 32.0)[1].interval_us == 33_333


def test_rates_of_an_onboard_link_and_of_a_ground_station():
    wire = Wire()
    wire.take()
    wire.run(500)
    counts = {}
    for message in wire.take():
        counts[message.layout.name] = counts.get(message.layout.name, 0) + 1
    # In 10 s; ATTITUDE is asked for at 100 Hz and goes out once a tick.
    wanted = {
        "ATTITUDE": 500,
        "ATTITUDE_QUATERNION": 500,
        "GLOBAL_POSITION_INT": 500,
        "LOCAL_POSITION_NED": 300,
        "VFR_HUD": 100,
        "EXTENDED_SYS_STATE": 50,
        "SYS_STATUS": 50,
        "HEARTBEAT": 10,
    }
    assert {name: counts[name] for name in wanted} == pytest.approx(wanted, abs=1)
    ground = Wire(rates=GROUND)
    ground.take()
    ground.run(500)
    assert len(ground.take("VFR_HUD")) == pytest.approx(40, abs=1)


def test_faster_than_the_wall_clock_a_message_goes_out_100_times_a_second():
    streams = Streams({"ATTITUDE": 100}, DT, factor=20.0)
    # A second of wall time is 1000 ticks.
    assert sum(30 in streams.due(tick, False) for tick in range(1000)) == pytest.approx(100, abs=1)
    streams = Streams({"ATTITUDE": 100}, DT, factor=20.0, by_simulated_time=True)
    assert sum(30 in streams.due(tick, False) for tick in range(1000)) == 1000


def test_a_message_on_request(wire):
    ack, version = wire.command(512, 148.0)
    assert (ack.result, version.layout.name) == (0, "AUTOPILOT_VERSION")
    # Missions and commands of integers, parameters bytewise, set-points, MAVLink 2, fence; and no files.
    wanted = 0x4 | 0x8 | 0x10 | 0x40 | 0x80 | 0x2000 | 0x4000
    assert (version.capabilities & wanted, version.capabilities & 0x20) == (wanted, 0)
    assert [answer.result for answer in wire.command(512, 33333.0)] == [3]
    assert [answer.result for answer in wire.command(512, NAN)] == [3]


def test_the_origin_and_the_protocol_on_request(wire):
    ack, origin = wire.command(512, 49.0)
    assert (ack.result, origin.layout.name) == (0, "GPS_GLOBAL_ORIGIN")
    assert (origin.latitude, origin.longitude, origin.altitude) == ORIGIN
    # PX4 does not look at param1.
    for ack, version in (wire.command(519, 1.0), wire.command(519, 0.0), wire.command(512, 300.0)):
        assert (ack.result, version.layout.name) == (0, "PROTOCOL_VERSION")
        assert (version.version, version.min_version, version.max_version) == (200, 100, 200)
    ack, version = wire.command(520, 0.0)
    assert (ack.result, version.layout.name) == (0, "AUTOPILOT_VERSION")
    # ArduPilot knows 519 no more, and wants 1 for 520.
    copter = Wire(flavour="ardupilot")
    results = [copter.command(*asked)[0].result for asked in ((519, 1.0), (520, 0.0), (520, 1.0))]
    assert results == [3, 4, 0]


def modes_of(wire, *index):
    ack, *modes = wire.command(512, 435.0, *index)
    return ack.result, [
        (one.mode_index, one.number_modes, one.custom_mode, one.standard_mode, one.properties, one.mode_name.decode())
        for one in modes
    ]


def test_modes_of_px4_are_told_and_the_one_that_is_flown(wire):
    # MAV_STANDARD_MODE 4 altitude hold, 1 position hold, 2 orbit, 8 take-off, 6 mission, 5 safe recovery, 7 land; those
    # have no name. MAV_MODE_PROPERTY 1 advanced, 2 not to be selected.
    wanted = [
        (0x00020000, 4, 0, ""),
        (0x00030000, 1, 0, ""),
        (0x00060000, 0, 1, "Offboard"),
        (0x00070000, 0, 1, "Stabilized"),
        (0x01030000, 2, 3, ""),
        (0x02040000, 8, 0, ""),
        (0x03040000, 0, 0, "Hold"),
        (0x04040000, 6, 0, ""),
        (0x05040000, 5, 0, ""),
        (0x06040000, 7, 0, ""),
        (0x08040000, 0, 1, "Follow Target"),
    ]
    listed = [(number, len(wanted), *one) for number, one in enumerate(wanted, 1)]
    assert modes_of(wire, 0.0) == modes_of(wire) == (0, listed)
    assert modes_of(wire, 7.0) == (0, [listed[6]])
    assert modes_of(wire, 12.0) == modes_of(wire, -1.0) == (2, [])
    assert wire.command(512, 437.0)[1].seq == 0
    ack, now = wire.command(512, 436.0)
    assert (ack.result, now.custom_mode, now.intended_custom_mode, now.standard_mode) == (0, 0x03040000, 0x03040000, 0)
    assert [answer.result for answer in wire.command(262, 7.0)] == [0]
    wire.run(1)
    found = wire.take("CURRENT_MODE")
    assert [(now.custom_mode, now.standard_mode) for now in found] == [(0x06040000, 7)]
    # Cruise, which a multicopter has not; an orbit begins by its command.
    assert [wire.command(262, number)[0].result for number in (3.0, 2.0, 0.0, 99.0)] == [4, 4, 4, 4]


def test_a_failsafe_leaves_the_mode_that_was_asked_for(wire):
    stack = wire.system.stack
    assert wire.command(400, 1.0)[0].result == 0
    stack.parameters.set("NAV_DLL_ACT", 3)
    stack.parameters.set("COM_DISARM_PRFLT", -1.0)
    wire.ask("HEARTBEAT", type=6)
    wire.run(600)
    _, now = wire.command(512, 436.0)
    assert (now.custom_mode, now.intended_custom_mode) == (0x06040000, 0x03040000)


def test_modes_of_ardupilot_have_names():
    names = ["STABILIZE", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "LAND", "POSHOLD", "BRAKE",
             "GUIDED_NOGPS"]  # fmt: skip
    numbers = [0, 2, 3, 4, 5, 6, 7, 9, 16, 17, 20]
    wire = Wire(flavour="ardupilot")
    _, modes = modes_of(wire, 0.0)
    assert modes == [
        (i, 11, number, 0, 0, name) for i, (number, name) in enumerate(zip(numbers, names, strict=True), 1)
    ]
    # It has no CURRENT_MODE.
    assert [answer.result for answer in wire.command(512, 436.0)] == [3]


def test_groups_of_streams_of_ardupilot(wire):
    # MAV_DATA_STREAM_EXTRA1 is ATTITUDE; all of them are off, and a vehicle of PX4 does not listen.
    copter = Wire(flavour="ardupilot")
    for each, interval in ((copter, 250_000), (wire, 20_000)):
        each.ask(
            "REQUEST_DATA_STREAM",
            target_system=1,
            target_component=1,
            req_stream_id=10,
            req_message_rate=4,
            start_stop=1,
        )
        assert each.command(510, 30.0)[1].interval_us == interval
    copter.ask("REQUEST_DATA_STREAM", target_system=1, target_component=1, req_stream_id=0, start_stop=0)
    assert [copter.command(510, number)[1].interval_us for number in (30.0, 33.0, 1.0)] == [-1, -1, -1]
    assert copter.command(510, 0.0)[1].interval_us == 1_000_000


def test_the_hash_of_all_parameters(wire):
    asked = {"target_system": 1, "param_id": b"_HASH_CHECK"}
    (value,) = wire.ask("PARAM_REQUEST_READ", param_index=-1, **asked)
    # PX4's param_hash_check: the sum of 32 bits of Ethernet from 0 on and not inverted, of names and four bytes each.
    state = 0
    for parameter in wire.system.stack.parameters:
        number = wire.system.stack.parameters[parameter.name]
        raw = struct.pack("<i", int(number)) if parameter.type == 6 else struct.pack("<f", number)
        for byte in parameter.name.encode() + raw:
            state ^= byte
            for _ in range(8):
                state = state >> 1 ^ (0xEDB88320 if state & 1 else 0)
    assert struct.pack("<f", value.param_value) == struct.pack("<I", state)
    assert (value.param_type, value.param_index, value.param_id) == (5, 65535, b"_HASH_CHECK")
    # To set it stops a list, and is not answered.
    assert wire.ask("PARAM_SET", param_value=0.0, param_type=5, **asked) == []
    wire.system.stack.parameters.set("GF_ACTION", 1)
    assert wire.ask("PARAM_REQUEST_READ", param_index=-1, **asked)[0].param_value != value.param_value
    (error,) = Wire(flavour="ardupilot").ask("PARAM_REQUEST_READ", param_index=-1, **asked)
    assert error.layout.name == "PARAM_ERROR"
