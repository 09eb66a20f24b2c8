"""PX4's simulator interface, against a stand-in that follows its sources and flies by the messages alone."""

from __future__ import annotations

import math
import random
import re
import time
from typing import Any

import numpy as np
import pytest
from px4_flown import PAIR, RATE, START_USEC, Flown
from px4_stand_in import Px4StandIn
from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import px4_link
from qrsim.links.autopilot.px4_feed import Px4Feed
from qrsim.links.autopilot.px4_flight import Px4Flight, prepared
from qrsim.links.autopilot.px4_messages import Fix, hil_gps
from qrsim.models.site import Site
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation


@pytest.mark.long
def test_it_boots_after_any_number_of_frames_and_all_sensors_are_sent() -> None:
    flown = Flown(truth=True)
    first, second = flown.fly(1.0, boot=[0, 53])
    assert sum("PX4 answers" in line for line in flown.said) == 2
    assert first.kinds == {"HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION", "DISTANCE_SENSOR", "HIL_OPTICAL_FLOW"}
    assert (first.count, second.count) == (250, 250)
    assert all(link.oddities == "" for link in flown.flight.links)
    # Rates of the sensors: barometer 50 Hz, magnetometer 10 Hz (0.1 s is 25 frames), GNSS 5 Hz.
    parser = common.MAVLink(None)
    messages = parser.parse_buffer(first.received)
    sensors = [each for each in messages if each.get_type() == "HIL_SENSOR"]
    assert [each.time_usec for each in sensors[:3]] == [1_000_000, 1_004_000, 1_008_000]
    assert sum(each.fields_updated & 0x1A00 == 0x1A00 for each in sensors) == 50
    assert sum(each.fields_updated & 0x01C0 == 0x01C0 for each in sensors) == 10
    assert sum(each.fields_updated & 0x003F == 0x003F for each in sensors) == 250
    fixes = [each for each in messages if each.get_type() == "HIL_GPS"]
    assert 4 <= len(fixes) <= 5
    assert [each.lat for each in fixes] == pytest.approx([473977420] * len(fixes), abs=1000)
    assert [each.lon for each in fixes] == pytest.approx([85455940] * len(fixes), abs=1500)
    assert [each.alt for each in fixes] == pytest.approx([488_200] * len(fixes), abs=15_000)
    # A fix is true one period before it is reported.
    assert [each.time_usec - START_USEC for each in fixes] == [200_000 * k for k in range(len(fixes))]
    # The standard atmosphere at 488.2 m, and the field of the World Magnetic Model, nose to the north.
    (air, *_) = [each for each in sensors if each.fields_updated & 0x1A00]
    assert air.abs_pressure == pytest.approx(955.96, abs=0.2)
    assert air.temperature == pytest.approx(11.83, abs=0.05)
    assert air.pressure_alt == pytest.approx(488.2, abs=1.5)
    (field, *_) = [each for each in sensors if each.fields_updated & 0x01C0]
    assert (field.xmag, field.ymag, field.zmag) == pytest.approx((0.215, 0.013, 0.432), abs=0.08)
    (range_down, *_) = [each for each in messages if each.get_type() == "DISTANCE_SENSOR"]
    assert (range_down.min_distance, range_down.orientation, range_down.signal_quality) == (10, 25, 100)
    assert range_down.current_distance == pytest.approx(20, abs=8)
    flows = [each for each in messages if each.get_type() == "HIL_OPTICAL_FLOW"]
    assert (len(flows), flows[0].integration_time_us) == (50, 20_000)
    # At rest: minus gravity, the field of the site in gauss, and the truth at the ground.
    last = sensors[-1]
    assert last.zacc == pytest.approx(-9.81, abs=0.5)
    true = [each for each in messages if each.get_type() == "HIL_STATE_QUATERNION"][-1]
    assert true.attitude_quaternion[0] == pytest.approx(1.0, abs=1e-3)
    assert true.alt == pytest.approx(488_200, abs=60)
    assert abs(true.zacc) < 50
    # HIL_SENSOR is the last message of each frame.
    assert messages[-1].get_type() == "HIL_SENSOR"


@pytest.mark.long
def test_a_stand_in_takes_off_on_noisy_sensors_and_holds_its_place() -> None:
    flown = Flown()
    flown.fly(8.0, split=[False, True], garbage_every=[0, 7])
    assert not any(flown.simulation.reasons)
    start = -np.asarray(flown.simulation.world.fleets[0].start.position_ned.z)
    assert [high - low for high, low in zip(flown.heights, start.tolist(), strict=True)] == pytest.approx(
        [3.0, 3.0], abs=0.3
    )
    place = np.asarray(flown.simulation.truth.position_ned)
    assert np.hypot(place[:, 0], place[:, 1] - [0.0, 8.0]).max() < 2.0
    assert all(link.unanswered == 0 for link in flown.flight.links)


@pytest.mark.long
def test_two_fly_twice_and_all_bytes_and_states_are_equal() -> None:
    def flight() -> tuple[list[bytes], np.ndarray]:
        flown = Flown()
        pilots = flown.fly(3.0, boot=[4, 20])
        assert min(flown.heights) > 0.5
        return [pilot.received for pilot in pilots], flown.state

    (first, state), (again, same) = flight(), flight()
    assert first == again
    assert np.array_equal(state, same, equal_nan=True)


@pytest.mark.long
def test_dropped_answers_are_counted_and_the_last_ones_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "ANSWER_S", 0.1)
    flown = Flown()
    pilots = flown.fly(4.0, drop_every=[100, 0], stale_every=[0, 250])
    assert [link.unanswered for link in flown.flight.links] == [pilots[0].dropped, 3] == [9, 3]
    assert min(flown.heights) > 1.5


def valid_frames(data: bytes) -> int:
    """Count the CONTROLS frames of MAVLink 2 in data, but for one at its end."""
    found = 0
    extra = bytes([common.MAVLink_hil_actuator_controls_message.crc_extra])
    for begin in [at.start() for at in re.finditer(b"\xfd.", data, re.DOTALL)]:
        end = begin + 10 + data[begin + 1]
        if end + 2 < len(data):
            found += x25crc(data[begin + 1 : end] + extra).crc == int.from_bytes(data[end : end + 2], "little")
    return found


@pytest.mark.long
def test_harmed_frames_beside_an_honest_flight_change_no_bit() -> None:
    def harming(seed: int) -> Any:
        rng = random.Random(seed)

        def harm(packed: bytes) -> bytes:
            found = b""
            for _ in range(50):
                # A check of 16 bits sees any change of two neighbouring bytes.
                wrong, at = bytearray(packed), rng.randrange(len(packed) - 1)
                wrong[at] ^= rng.randint(1, 255)
                wrong[at + 1] ^= rng.randrange(256)
                found += wrong[: rng.choice((len(wrong), rng.randint(1, len(wrong))))]
            # The start of one frame with the next as its end passes its check once in 65 536: drawn again.
            return harm(packed) if valid_frames(found + packed) else found

        return harm

    honest, harmed = Flown(), Flown()
    honest.fly(4.0)
    harmed.fly(4.0, harm=[harming(1), harming(2)])
    assert [link.unanswered for link in harmed.flight.links] == [0, 0]
    # 50 before each of 996 answers of two.
    assert sum(link.harmed for link in harmed.flight.links) > 10_000
    assert np.array_equal(honest.state, harmed.state, equal_nan=True)


def test_the_end_of_one_px4_ends_its_vehicles_flight_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4_link, "RECONNECT_S", 0.3)
    flown = Flown()
    outputs = [0.82] * 4
    flown.fly(0.6, frames=[100, None], outputs=[outputs, outputs])
    assert flown.said[-2:] == [
        "field_0: PX4 has ended or closed the connection; its motors stop",
        f"field_0: no other PX4 has connected to TCP {flown.port} in 0.3 s; its motors stop, and the others fly on",
    ]
    assert flown.flight.lost == ["field_0"]
    speeds = np.array(flown.simulation.state.fleets[0].vehicle.rotor_speed)
    assert (speeds[:, 0] < 0.05 * speeds[:, 1]).all()
    assert flown.simulation.tick == 150


def test_another_px4_takes_over_where_the_first_ended() -> None:
    flown = Flown()
    again = Px4StandIn(flown.port, 0, boot=2)

    class Successor(Px4StandIn):
        def run(self) -> None:
            super().run()
            again.start()

    pilots = [Successor(flown.port, 0, frames=60), Px4StandIn(flown.port + 1, 1)]
    for pilot in pilots:
        pilot.start()
    with flown.flight:
        flown.flight.advance(150)
    again.join(10.0)
    assert (again.problem, flown.flight.lost, flown.flight.links[0].restarts) == ("", [], 1)
    # Its clock begins at the simulation's.
    first = common.MAVLink(None).parse_buffer(again.received)
    begin = next(each.time_usec for each in first if each.get_type() == "HIL_SENSOR")
    assert 1_000_000 + 4000 * 60 <= begin <= 1_000_000 + 4000 * 62
    assert sum("another PX4 connects" in line for line in flown.said) == 1


def test_a_px4_that_never_answers_ends_after_the_wait() -> None:
    flown = Flown(wait=0.6)
    begin = time.perf_counter()
    flown.fly(1.0, boot=[4, None])
    assert time.perf_counter() - begin > 0.6
    (line,) = [line for line in flown.said if "field_1: the program connected" in line]
    assert f"to TCP {flown.port + 1} has sent no HIL_ACTUATOR_CONTROLS in 0.6 s" in line
    assert flown.flight.lost == ["field_1"]
    assert flown.simulation.tick == 250


def test_without_any_px4_the_flight_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    flown = Flown(wait=0.2)
    with flown.flight, pytest.raises(RunError) as raised:
        flown.flight.advance(5)
    line = f"field_0: no PX4 has connected to TCP {flown.port} in 0.2 s; in an empty folder: PX4_SIM_MODEL=none_iris "
    assert str(raised.value) == f"{line}BUILD/bin/px4 -i 0 -d BUILD/etc; further vehicles up to -i 1"
    assert flown.said == []
    monkeypatch.setattr(px4_link, "RECONNECT_S", 0.1)
    flown = Flown(wait=0.5)
    pilot = Px4StandIn(flown.port + 1, 1, frames=30)
    pilot.start()
    with flown.flight, pytest.raises(RunError, match="no PX4 is left to fly a vehicle"):
        flown.flight.advance(100)
    assert f"field_0: no PX4 has connected to TCP {flown.port} in 0.5 s; in an empty folder: " in flown.said[0]


def test_ports_beyond_the_last_are_refused() -> None:
    scenario, fleets = prepared(load_scenario(PAIR, quiet=True), (), "x500", RATE)
    with pytest.raises(UsageError, match="--port 65535: the last vehicle would have TCP 65536, at most 65535"):
        Px4Flight(Simulation(scenario.world()), fleets, START_USEC, 65_535)


def test_a_start_before_1970_is_refused() -> None:
    nothing: Any = None
    with pytest.raises(UsageError, match="start_time: is before 1970-01-01"):
        Px4Feed(nothing, nothing, nothing, -1)


def test_a_fix_comes_back_from_its_message() -> None:
    site = Site.from_degrees(48.0, 11.0, 500.0)
    there = np.array([1234.567, -2345.678, -150.0])
    latitude, longitude, height = (float(part) for part in np.ravel(site.ned_to_geodetic(there[None])))
    fix = Fix(3, math.degrees(latitude), math.degrees(longitude), height, 1.0, 1.5, (1.234, -2.345, 0.456), 12)
    numbers = common.MAVLink_hil_gps_message.unpacker.unpack(hil_gps(1, fix))
    stamp, lat, lon, alt, eph, epv, vel, *velocity = numbers[:10]
    back = site.geodetic_to_ned(math.radians(lat * 1e-7), math.radians(lon * 1e-7), alt * 1e-3)
    assert np.hypot(*(back - there)[:2]) < 0.012
    assert abs(back[2] - there[2]) < 0.001
    assert [speed * 0.01 for speed in velocity] == pytest.approx([1.234, -2.345, 0.456], abs=0.005)
    assert (stamp, eph, epv, vel) == (1, 100, 150, 265)


@pytest.mark.long
def test_injected_faults_are_in_what_px4_gets() -> None:
    sensors = ["gnss", "gyroscope", "barometer", "magnetometer"]
    flown = Flown({**PAIR, "fleets": {"field": {**PAIR["fleets"]["field"], "injectable": {"sensors": sensors}}}})
    # From 1 s on; a PX4 that answers at once has its first frame at 0 s.
    sim = flown.simulation
    sim.inject("gnss", "off", vehicles="field_0", at=1.0)
    sim.inject("magnetometer", "off", vehicles="field_0", at=1.0)
    sim.inject("barometer", "wrong", vehicles="field_0", at=1.0, field="height", bias=10.0)
    sim.inject("gyroscope", "stuck", vehicles="field_1", at=1.0)
    first, second = flown.fly(2.0)
    found = [common.MAVLink(None).parse_buffer(pilot.received) for pilot in (first, second)]
    fixes, fixes_of_second = (
        [(each.fix_type, each.satellites_visible) for each in own if each.get_type() == "HIL_GPS"] for own in found
    )
    # A fix of 5 Hz: the last one before 1 s is the fifth.
    assert [kind for kind, _ in fixes] == [3, 3, 3, 3, 0, 0, 0, 0, 0][: len(fixes)]
    assert {kind for kind, _ in fixes_of_second} == {3}
    own, other = ([each for each in messages if each.get_type() == "HIL_SENSOR"] for messages in found)
    late = [each for each in own if each.time_usec > 2_020_000]
    assert not any(each.fields_updated & 0x01C0 for each in late)
    assert any(each.fields_updated & 0x01C0 for each in other[-100:])
    # Pressure in hPa, which falls by 11.4 Pa/m at 488 m.
    before = [each.abs_pressure for each in own if each.fields_updated & 0x1A00 and each.time_usec < 2_000_000]
    after = [each.abs_pressure for each in late if each.fields_updated & 0x1A00]
    assert np.mean(after[:5]) - np.mean(before[-5:]) == pytest.approx(-1.14, abs=0.15)
    held = [each for each in other if each.time_usec > 2_008_000]
    assert len({each.xgyro for each in held}) == 1
    assert len({each.zacc for each in held}) > 100
