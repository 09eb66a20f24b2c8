"""PX4's simulator interface, against a stand-in that follows its sources and flies by the messages alone."""

from __future__ import annotations

import math
import random
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from px4_stand_in import Px4StandIn, free_ports
from pymavlink.dialects.v20 import common

from qrsim.core.tree import replace
from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import px4_link
from qrsim.links.autopilot.fleet import prepared as in_the_air
from qrsim.links.autopilot.lockstep import FlownFleet, LockstepFlight
from qrsim.links.autopilot.losses import Losses
from qrsim.links.autopilot.px4_flight import Px4Flight, motor_order, prepared
from qrsim.links.autopilot.px4_messages import Fix, hil_gps
from qrsim.links.autopilot.px4_parameters import parameters
from qrsim.models.site import Site
from qrsim.models.vehicles.multirotor.geometry import Rotor
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

RATE = 250.0
# Of the scenarios below: 2026-06-21, 10:00 UTC.
START_USEC = 1_782_036_000_000_000
# Two vehicles with all sensors that PX4 takes.
PAIR: dict[str, Any] = {
    "name": "pair",
    "extends": "mavlink_field",
    "fleets": {"field": {"vehicles": [{"position_ned": [0.0, east, -0.2]} for east in (0.0, 8.0)]}},
}


class Flown:
    """A flight of the pair, and what it says."""

    def __init__(self, content: Any = PAIR, seed: int = 3, **options: Any):
        scenario, fleets = prepared(load_scenario(content, quiet=True), (), "x500", RATE)
        self.simulation = Simulation(scenario.world(), seed=seed, name=scenario.name, site=scenario.site)
        self.simulation.reset()
        self.said: list[str] = []
        self.port = free_ports(self.simulation.size)
        options = {"wait": 20.0, "say": self.said.append, **options}
        self.flight = Px4Flight(self.simulation, fleets, START_USEC, self.port, **options)

    def fly(self, seconds: float, **options: Any) -> list[Px4StandIn]:
        """Fly with a stand-in for each vehicle; an option may be a list of one for each."""
        pilots = []
        for i in range(self.simulation.size):
            own = {name: value[i] if isinstance(value, list) else value for name, value in options.items()}
            pilots.append(Px4StandIn(self.port + i, i, **own))
            pilots[-1].start()
        with self.flight:
            self.flight.advance(round(seconds * RATE))
        for pilot in pilots:
            pilot.stop.set()
            pilot.join(10.0)
            assert pilot.problem == ""
        return pilots

    @property
    def state(self) -> np.ndarray:
        return np.asarray(self.simulation.packed[1][0]).copy()

    @property
    def heights(self) -> list[float]:
        return (-np.asarray(self.simulation.truth.position_ned)[:, 2]).tolist()


def test_it_boots_after_any_number_of_frames_and_all_sensors_are_sent() -> None:
    flown = Flown(truth=True)
    first, second = flown.fly(1.0, boot=[0, 53])
    assert sum("PX4 answers" in line for line in flown.said) == 2
    assert first.kinds == {"HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION"}
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
    begin = time.perf_counter()
    pilots = flown.fly(4.0, drop_every=[100, 0], stale_every=[0, 250])
    assert [link.unanswered for link in flown.flight.links] == [pilots[0].dropped, 3] == [9, 3]
    assert time.perf_counter() - begin < 4.0 + 12 * 0.2 + 6.0
    assert min(flown.heights) > 1.5


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
            return found

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
    assert 0.6 < time.perf_counter() - begin < 4.0
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


def own(geometry: str, rotors: int, count: int | None = None) -> dict[str, Any]:
    numbers = {"mass": 2.0, "arm": 0.25, "hover_throttle": 0.5, "thrust_to_weight": 2.0, "attitude_bandwidth": 8.0}
    vehicle = {"type": "multirotor", "own": {**numbers, "rotors": rotors, "geometry": geometry}, "model": None}
    places = [{"position_ned": [0.0, 20.0 * i, -50.0]} for i in range(count or rotors)]
    fleet = {"vehicle": vehicle, "vehicles": places}
    return {"name": "geometry", "extends": "mavlink_field", "world": {"wind": {"type": "calm"}, "turbulence": {
        "type": "still"}}, "fleets": {"field": fleet}}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize(("geometry", "rotors", "kind"), [("hexa_x", 6, 13), ("octo_x", 8, 14)])
def test_the_geometry_that_px4_is_told_is_that_of_the_vehicle(geometry: str, rotors: int, kind: int) -> None:
    """Vehicle i has motor i 10 % faster than the others: it turns as a PX4 with these parameters expects."""
    scenario, _ = in_the_air(load_scenario(own(geometry, rotors), quiet=True), (), "x500", RATE, "PX4")
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    (fleet,) = simulation.world.fleets

    class Faster(FlownFleet):
        def speeds(self, number: int) -> list[float]:
            return [0.7 * (1.1 if motor == number else 1.0) for motor in range(rotors)]

    flown = Faster(simulation, fleet, motor_order(fleet), Losses(None))
    flight = LockstepFlight(simulation)
    flight.fleets.append(flown)
    flight.advance(12)
    told = parameters(fleet, flown.order, flown.sight, 0)
    rates = np.asarray(simulation.truth.rates_body)
    for motor in range(rotors):
        x, y, turn = (told[f"CA_ROTOR{motor}_{name}"] for name in ("PX", "PY", "KM"))
        # A motor on the right lifts the right side; one in front the nose; KM > 0 turns counter-clockwise from above,
        # and the vehicle clockwise.
        for rate, expected in zip(rates[motor], (-y, x, turn), strict=True):
            assert abs(expected) < 0.01 * abs(x + y) or rate * expected > 0.0, (motor, rates[motor], (x, y, turn))
    # A zero counts as not set, and the airframe's own place would hold.
    assert all(abs(told[f"CA_ROTOR{motor}_{axis}"]) >= 1e-4 for motor in range(rotors) for axis in ("PX", "PY"))
    assert (told["CA_ROTOR_COUNT"], told["MAV_TYPE"], told[f"PWM_MAIN_FUNC{rotors}"]) == (rotors, kind, 100 + rotors)


@pytest.mark.long
@pytest.mark.parametrize(("geometry", "rotors"), [("hexa_x", 6), ("quad_plus", 4)])
def test_other_vehicles_fly_by_what_px4_is_told_of_them(geometry: str, rotors: int) -> None:
    flown = Flown(own(geometry, rotors, 1))
    (told,) = flown.flight.parameters()
    names = ("PX", "PY", "KM")
    motors = [tuple(told[f"CA_ROTOR{motor}_{name}"] for name in names) for motor in range(rotors)]
    assert not flown.flight.fleets[0].is_iris
    low = flown.heights[0]
    flown.fly(6.0, rotors=[motors], hover=told["MPC_THR_HOVER"])
    assert flown.heights[0] - low == pytest.approx(3.0, abs=0.4)
    assert np.abs(np.asarray(flown.simulation.truth.attitude)[0]).max() < 0.2


def test_the_x500_has_the_motors_of_the_iris_and_its_own_geometry() -> None:
    flown = Flown()
    (fleet,) = flown.flight.fleets
    assert fleet.is_iris
    found = flown.flight.parameters()[1]
    flown.flight.close()
    # PX4-gazebo-models, x500: rotors at 0.174 m, motor 1 front right and counter-clockwise, 2 rear left, 3 front left.
    assert [found[f"CA_ROTOR{motor}_PX"] for motor in range(4)] == [0.174, -0.174, 0.174, -0.174]
    assert [found[f"CA_ROTOR{motor}_PY"] for motor in range(4)] == [0.174, -0.174, -0.174, 0.174]
    assert [found[f"CA_ROTOR{motor}_KM"] for motor in range(4)] == pytest.approx([0.016, 0.016, -0.016, -0.016])
    assert [found[f"PWM_MAIN_FUNC{motor}"] for motor in (1, 2, 3, 4)] == [101, 102, 103, 104]
    # 2.0643 kg, 9.81 m/s^2, four rotors of 8.54858e-6 N s^2 at 1000 rad/s, in air of 1.167 kg/m^3 at 488 m.
    assert found["MPC_THR_HOVER"] == pytest.approx(20.251 / (34.194 * 1.1681 / 1.225), rel=0.01)
    # A fix is reported after one period of 0.2 s.
    assert (found["SENS_GPS0_DELAY"], found["EKF2_DELAY_MAX"], found["THR_MDL_FAC"]) == (200, 250, 1.0)
    assert (found["EKF2_MULTI_IMU"], found["EKF2_MULTI_MAG"], found["MAV_TYPE"]) == (1, 1, 2)
    assert not {"SYS_HAS_MAG", "SYS_HAS_BARO"} & set(found)


def world_of(content: Any) -> Any:
    """Return the only fleet of a scenario, not compiled."""
    return prepared(load_scenario(content, quiet=True), (), "x500", RATE)[0].world().fleets[0]


def test_hover_thrust_and_torques_stay_within_what_px4_takes() -> None:
    bare = SimpleNamespace(sensors={})
    content = own("quad_x", 4, 1)
    numbers = content["fleets"]["field"]["vehicle"]["own"]
    for ratio, throttle, expected in ((2.0, 0.5, 0.5), (20.0, 0.1, 0.1), (1.2, 0.9, 0.8)):
        numbers |= {"thrust_to_weight": ratio, "hover_throttle": throttle}
        told = parameters(world_of(content), (0, 1, 2, 3), bare, 0)
        # The air at 488 m is 4.6 % thinner than that of the data sheet.
        assert told["MPC_THR_HOVER"] == pytest.approx(
            min(expected / 0.9535, 0.8) if ratio == 2.0 else expected, rel=0.01
        )
    x500 = replace(world_of(PAIR).vehicle, torque_ratio=0.05)
    fleet = SimpleNamespace(vehicle=x500)
    # 0.05 is what PX4 is built with, and the airframe's -0.05 would hold for motors 3 and 4.
    told = parameters(fleet, (0, 1, 2, 3), bare, 0)
    assert sorted(told[f"CA_ROTOR{motor}_KM"] for motor in range(4)) == [-0.05, -0.05, 0.0501, 0.0501]


def test_more_rotors_than_px4_has_motors_are_refused() -> None:
    rotors = [Rotor((math.cos(i), math.sin(i), 0.0), 1) for i in range(13)]
    with pytest.raises(UsageError, match="fleet 'many': 13 rotors, and PX4 has at most 12 motors"):
        motor_order(SimpleNamespace(name="many", vehicle=SimpleNamespace(rotors=rotors)))


def test_what_it_cannot_fly_is_refused() -> None:
    with pytest.raises(UsageError, match="a fixed_wing is flown by no PX4 here"):
        prepared(load_scenario("mixed_team"), ("planes",), "x500", RATE)
    with pytest.raises(UsageError, match="a rover is flown by no PX4 here"):
        prepared(load_scenario("mixed_team"), ("rovers",), "x500", RATE)


def test_periods_that_are_no_whole_number_of_ticks_become_one() -> None:
    content = {**PAIR, "fleets": {"field": {**PAIR["fleets"]["field"], "sensors": {"magnetometer": {
        "type": "magnetometer", "period": 0.01}}}}, "time_step": 0.01}  # fmt: skip
    fleet = world_of(content)
    assert {type(sensor).__name__: sensor.period for sensor in fleet.sensors}["Magnetometer"] == 0.008


@pytest.mark.long
def test_sensors_that_px4_needs_are_asked_for_by_name() -> None:
    """A fleet that is fed with the truth still needs sensors: PX4 takes equal readings for a failure."""
    field = {
        "vehicle": {"type": "multirotor", "model": "x500"},
        "controller": {"type": "cascade", "feed": "truth"},
        "vehicles": [{"position_ned": [0.0, 0.0, -0.2]}],
    }
    content: dict[str, Any] = {"name": "bare", "duration": 10.0}
    with pytest.raises(UsageError, match="fleet 'pelicans' has no gyroscope, and an autopilot needs one: add a sensor"):
        Flown({**content, "fleets": {"pelicans": {**field, "sensors": {"gnss": {"type": "gnss_receiver"}}}}})
    imu = {"imu": {"type": "imu"}}
    with pytest.raises(
        UsageError, match=r"no GNSS receiver, .*; --set 'fleets\.pelicans\.sensors\.gnss={type: gnss_rec"
    ):
        Flown({**content, "fleets": {"pelicans": {**field, "sensors": imu}}})
    imu = {"imu": {"type": "ideal_imu"}, "gnss": {"type": "gnss_receiver"}}
    with (
        pytest.warns(UserWarning, match="no magnetometer, and PX4 knows no heading"),
        pytest.warns(UserWarning, match=r"ideal sensors \(imu\) repeat themselves at rest"),
    ):
        flown = Flown({**content, "fleets": {"pelicans": {**field, "sensors": imu}}})
    told = flown.flight.parameters()[0]
    flown.flight.close()
    assert [told[name] for name in ("SYS_HAS_MAG", "SYS_HAS_BARO", "EKF2_HGT_REF")] == [0, 0, 1]
