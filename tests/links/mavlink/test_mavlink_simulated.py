"""Faults and wind by ArduPilot's parameters SIM_..."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from tests.links.mavlink.test_mavlink_failures import Field

from qrsim.core.tree import replace
from qrsim.links.mavlink.dialogue import handle
from qrsim.links.mavlink.frames import Reader
from qrsim.links.mavlink.link import Link
from qrsim.links.mavlink.simulated import motor_order
from qrsim.links.mavlink.stack.parameters import Outcome
from qrsim.links.mavlink.stack.sim_parameters import SIM_TABLE
from qrsim.links.mavlink.streams import Streams
from qrsim.links.shared.motor_frames import FRAMES
from qrsim.scenarios.scenario import load_scenario

SET, REFUSED, CLAMPED, UNKNOWN = Outcome.SET, Outcome.REFUSED, Outcome.CLAMPED, Outcome.UNKNOWN


@pytest.fixture(scope="module")
def field() -> Field:
    return Field("all", flavour="ardupilot")


def put(field: Field, number: int, *pairs: tuple[str, float]) -> list[Outcome]:
    """Set parameters SIM_... of a vehicle, and fly a tick."""
    parameters: Any = field.world.systems[number].stack.parameters
    found = [parameters.set(f"SIM_{name}", value) for name, value in pairs]
    field.run(0.02)
    return found


def faults(field: Field, number: int) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return target -> kind and numbers of a vehicle's faults."""
    name = f"field_{number}"
    return {
        one.target: (one.kind, dict(one.numbers)) for one in field.world.simulation.injected if name in one.vehicles
    }


@pytest.mark.long
def test_each_parameter_becomes_a_fault_and_0_ends_it(field: Field) -> None:
    drift = {"position_ned.x": 1.0, "position_ned.y": 0.0, "position_ned.z": -0.5}
    for pairs, target, kind, numbers in (
        ([("GPS1_ENABLE", 0.0)], "gnss", "off", {}),
        ([("GPS_DISABLE", 1.0)], "gnss", "off", {}),
        ([("GPS1_NUMSATS", 3.0)], "gnss", "off", {}),
        ([("GPS1_JAM", 1.0)], "gnss", "garbage", {"field": "position_ned", "range": 200.0}),
        ([("GPS1_GLTV_X", 1.0), ("GPS1_GLTV_Z", -0.5)], "gnss", "drift", {"rate": drift}),
        ([("BARO_DISABLE", 1.0)], "barometer", "off", {}),
        ([("BARO_FREEZE", 1.0)], "barometer", "stuck", {}),
        ([("BARO_DELAY", 200.0)], "barometer", "delayed", {"by": 0.2}),
        ([("BARO_DRIFT", 0.5)], "barometer", "drift", {"field": "height", "rate": 0.5}),
        ([("BARO_GLITCH", -4.0)], "barometer", "wrong", {"field": "height", "bias": -4.0}),
        ([("BARO_RND", 0.2)], "barometer", "noisy", {"field": "height", "std": 0.2}),
        ([("MAG1_FAIL", 1.0)], "magnetometer", "off", {}),
        ([("MAG1_FAIL", 2.0)], "magnetometer", "stuck", {}),
        (
            [("MAG1_OFS_Y", 50.0)], "magnetometer", "wrong",
            {"bias": {"field_body.x": 0.0, "field_body.y": -5.0, "field_body.z": 0.0}},
        ),
        (
            [("GYR1_BIAS_Z", 0.1)], "gyroscope", "wrong",
            {"bias": {"rates_body.x": 0.0, "rates_body.y": 0.0, "rates_body.z": 0.1}},
        ),
        (
            [("ACC1_BIAS_X", 0.4)], "accelerometer", "wrong",
            {"bias": {"specific_force.x": 0.4, "specific_force.y": 0.0, "specific_force.z": 0.0}},
        ),
    ):  # fmt: skip
        assert put(field, 4, *pairs) == [SET] * len(pairs)
        found = faults(field, 4)
        assert list(found) == [target], pairs
        assert found[target] == (kind, numbers), pairs
        assert {one.asked_by for one in field.world.simulation.injected} == {"mavlink:5"}
        defaults = {"GPS1_ENABLE": 1.0, "GPS1_NUMSATS": 10.0}
        put(field, 4, *[(name, defaults.get(name, 0.0)) for name, _ in pairs])
        assert faults(field, 4) == {}, pairs


@pytest.mark.long
def test_of_several_faults_of_a_sensor_the_graver_one_acts(field: Field) -> None:
    put(field, 3, ("BARO_GLITCH", 3.0), ("BARO_DRIFT", 1.0), ("BARO_DISABLE", 1.0))
    assert faults(field, 3)["barometer"] == ("off", {})
    put(field, 3, ("BARO_DISABLE", 0.0))
    assert faults(field, 3)["barometer"][0] == "drift"
    put(field, 3, ("BARO_DRIFT", 0.0))
    assert faults(field, 3)["barometer"] == ("wrong", {"field": "height", "bias": 3.0})
    put(field, 3, ("BARO_GLITCH", 0.0), ("GPS1_NUMSATS", 4.0))
    assert faults(field, 3) == {}


@pytest.mark.long
def test_a_glitch_in_degrees_is_what_the_receiver_reports(field: Field) -> None:
    field.run(1.0)
    views = [system.view for system in field.world.systems]
    before = [(view.seen.latitude, view.seen.longitude) for view in views]
    fix = lambda view: np.asarray(field.world.simulation.reading.gnss.position_ned)[0]  # noqa: E731
    own = fix(views[0])
    put(field, 0, ("GPS1_GLTCH_X", 0.001), ("GPS1_GLTCH_Y", -0.002), ("GPS1_GLTCH_Z", 5.0))
    field.run(0.5)
    moved = fix(views[0]) - own
    # On WGS-84 at 47.4 degrees a degree of latitude is 111.18 km, one of longitude 75.46 km.
    assert moved == pytest.approx([111.2, -150.9, -5.0], abs=1.0)
    put(field, 0, ("GPS1_GLTCH_X", 0.0), ("GPS1_GLTCH_Y", 0.0), ("GPS1_GLTCH_Z", 0.0))
    assert before[1][0] == pytest.approx(views[1].seen.latitude, abs=1e-5)


@pytest.mark.long
def test_engines_and_battery(field: Field) -> None:
    # Bit 0 is motor 1 of ArduPilot's X, in front on the right; bit 1 motor 2, rear left.
    assert put(field, 1, ("ENGINE_MUL", 0.6), ("ENGINE_FAIL", 3.0)) == [SET, SET]
    found = faults(field, 1)
    rotors = field.world.simulation.world.fleets[0].vehicle.rotors
    places = [rotors[int(target.split()[1])].position for target in found]
    assert [(place[0] > 0.0, place[1] > 0.0) for place in places] == [(True, True), (False, False)]
    assert set(map(str, found.values())) == {"('weak', {'health': 0.6})"}
    put(field, 1, ("ENGINE_FAIL", 0.0))
    assert faults(field, 1) == {}
    assert put(field, 1, ("ENGINE_FAIL", 16.0)) == [REFUSED]
    assert field.said[-1] == "SIM_ENGINE_FAIL: 16: the vehicle has 4 motors; allowed: 0 to 15"
    values: Any = field.world.systems[1].stack.parameters
    # Four cells of 4.103 V.
    assert values["SIM_BATT_VOLTAGE"] == pytest.approx(16.41, abs=0.01)
    put(field, 1, ("BATT_VOLTAGE", 15.2))
    charge = float(field.world.simulation.state.fleets[0].battery.charge[1])
    # 3.8 V a cell: 3.685 + 0.2156 s - 0.1178 s^2 + 0.3201 s^3 at s = 0.486.
    assert charge == pytest.approx(0.486, abs=0.02)


@pytest.mark.long
def test_a_shove_lasts_for_its_time_in_body_axes(field: Field) -> None:
    values: Any = field.world.systems[3].stack.parameters
    assert put(field, 3, ("SHOVE_X", 1.0), ("SHOVE_Z", -20.0)) == [SET, SET]
    assert faults(field, 3) == {}
    assert put(field, 3, ("SHOVE_TIME", 100.0)) == [SET]
    assert faults(field, 3) == {"body": ("push", {"acceleration_body": [1.0, 0.0, -20.0]})}
    assert values["SIM_SHOVE_TIME"] == 100.0
    field.run(0.08)
    # It stood on the ground, and rises by (20 - 9.81) m/s^2 for 0.1 s.
    up = [-float(speed) for speed in field.world.simulation.truth.velocity_ned[:, 2]]
    assert up[3] == pytest.approx(1.02, abs=0.1)
    assert up[2] == pytest.approx(0.0, abs=0.02)
    field.run(0.04)
    assert faults(field, 3) == {}
    assert values["SIM_SHOVE_TIME"] == 0.0
    # 0 ends it early, and a restart has none.
    put(field, 3, ("SHOVE_TIME", 5000.0))
    put(field, 3, ("SHOVE_TIME", 0.0))
    assert faults(field, 3) == {}
    put(field, 3, ("SHOVE_Z", 0.0), ("SHOVE_TIME", 5000.0))
    field.world.systems[3].reboots = True
    field.run(0.1)
    assert values["SIM_SHOVE_TIME"] == 0.0
    assert faults(field, 3) == {}


@pytest.mark.long
def test_a_reboot_keeps_what_parameters_say(field: Field) -> None:
    put(field, 2, ("BARO_FREEZE", 1.0))
    field.world.systems[2].reboots = True
    field.run(0.1)
    assert faults(field, 2) == {"barometer": ("stuck", {})}
    put(field, 2, ("BARO_FREEZE", 0.0))
    assert faults(field, 2) == {}


@pytest.mark.long
def test_the_wind_follows_its_parameters(field: Field) -> None:
    simulation = field.world.simulation
    wind = lambda: float(simulation.world.wind.speed_20ft)  # type: ignore[attr-defined] # noqa: E731
    values: Any = field.world.systems[0].stack.parameters
    # That of mavlink_field.
    assert (values["SIM_WIND_SPD"], values["SIM_WIND_DIR"]) == pytest.approx((6.0, 240.0), abs=1e-3)
    assert put(field, 0, ("WIND_TC", 5.0), ("WIND_SPD", 8.0), ("WIND_DIR", 10.0)) == [SET, SET, SET]
    field.run(5.0 / 6.2832)
    # After 0.8 s, which are four steps of 0.2 s with a time constant of 5 s / 2 pi, and perhaps a fifth.
    steps = [6.0 + 2.0 * (1.0 - np.exp(-0.2 * count * 2.0 * np.pi / 5.0)) for count in (4, 5)]
    assert min(abs(wind() - step) for step in steps) < 2e-3
    field.run(25.0 - 1.0)
    assert wind() == pytest.approx(8.0, abs=0.01)
    assert float(simulation.world.wind.wind_from_rad) % (2.0 * np.pi) == pytest.approx(np.radians(10.0), abs=1e-3)  # type: ignore[attr-defined]
    other: Any = field.world.systems[3].stack.parameters
    assert other["SIM_WIND_SPD"] == 8.0
    # A time constant below 0.1 s is 0.1 s: after one step of 0.2 s all but e^-12.6 of the change.
    put(field, 0, ("WIND_TC", 0.0), ("WIND_SPD", 9.0))
    assert wind() == pytest.approx(9.0, abs=1e-4)
    assert wind() != 9.0
    put(field, 0, ("WIND_SPD", 8.0))
    field.run(1.0)
    assert put(field, 0, ("WIND_SPD", 900.0)) == [REFUSED]
    assert field.said[-1].startswith("SIM_WIND_SPD: 900 m/s; allowed: 0 to ")
    assert values["SIM_WIND_SPD"] == 8.0
    field.world.reset(6)
    field.run(10.0)
    assert wind() == pytest.approx(8.0, abs=0.01)


@pytest.mark.long
def test_a_client_sets_parameters_as_mavproxy_does(field: Field) -> None:
    """By PARAM_SET of pymavlink: each is answered by the value that holds now."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    client, system, sent = mavlink.MAVLink(None, 255, 230), field.world.systems[1], list[bytes]()
    link = Link(2, Streams({}, 0.02), sent.append)
    system.links.append(link)
    for name, value, holds in (
        (b"SIM_WIND_SPD", 7.0, 7.0),
        (b"SIM_SONAR_OFFSET", 1.0, 0.0),
        (b"SIM_BARO_GLITCH", 2.5, 2.5),
    ):
        message = client.param_set_encode(2, 1, name, value, mavlink.MAV_PARAM_TYPE_REAL32)
        (frame,) = Reader().datagram(message.pack(client))
        handle(system, link, frame)
        (answer,) = client.parse_buffer(b"".join(sent)) or ()
        sent.clear()
        assert (answer.param_id.encode(), answer.param_value, answer.param_type) == (name, holds, 9)
    system.links.clear()
    assert faults(field, 1)["barometer"] == ("wrong", {"field": "height", "bias": 2.5})
    put(field, 1, ("BARO_GLITCH", 0.0))


@pytest.mark.long
def test_what_is_not_injectable_is_refused_and_what_changes_nothing_is_not() -> None:
    field = Field("barometer", flavour="ardupilot")
    assert put(field, 0, ("GPS1_ENABLE", 0.0), ("GPS1_ENABLE", 1.0), ("BARO_DISABLE", 1.0)) == [REFUSED, SET, SET]
    assert "SIM_GPS1_ENABLE: not injectable: gps; start qrsim mavlink with --injectable all" in field.said
    assert put(field, 0, ("BARO_DELAY", 100.0), ("SONAR_OFFSET", 1.0), ("NO_SUCH", 1.0)) == [SET, REFUSED, UNKNOWN]
    assert put(field, 0, ("SHOVE_TIME", 100.0)) == [REFUSED]
    assert "SIM_SHOVE_TIME: not injectable: body; start qrsim mavlink with --injectable all" in field.said
    # The delay waits behind the switch; that of a barometer without delay_max cannot be.
    assert put(field, 0, ("BARO_DISABLE", 0.0)) == [REFUSED]
    assert "by: 0.1 s; allowed: at most 0 s" in field.said[-1]
    assert put(field, 0, ("BARO_RND", float("nan")), ("BARO_RND", -1.0)) == [Outcome.NOT_FINITE, CLAMPED]
    px4: Any = Field("barometer").world.systems[0].stack.parameters
    assert "SIM_WIND_SPD" not in px4


def test_motors_are_those_of_ardupilot() -> None:
    assert {count: tuple(angle for angle, _ in frame) for count, frame in FRAMES.items()} == {
        4: (45.0, -135.0, -45.0, 135.0),
        6: (90.0, -90.0, -30.0, 150.0, 30.0, -150.0),
        8: (22.5, -157.5, 67.5, 157.5, -22.5, -112.5, -67.5, 112.5),
    }
    fleet: Any = load_scenario("mavlink_field").world().fleets[0]
    # The rotors of an x500: front right, rear right, rear left, front left.
    assert motor_order(fleet) == [0, 2, 3, 1]
    # In the reverse order, with the arms turned from those of the frame: 15 degrees are near enough, 25 are not.
    for turned, order in ((0.0, [3, 1, 0, 2]), (15.0, [3, 1, 0, 2]), (25.0, [0, 1, 2, 3])):
        rotors = []
        for rotor in reversed(fleet.vehicle.rotors):
            x, y, z = rotor.position
            c, s = math.cos(math.radians(turned)), math.sin(math.radians(turned))
            rotors.append(dataclasses.replace(rotor, position=(c * x - s * y, s * x + c * y, z)))
        other = replace(fleet, vehicle=replace(fleet.vehicle, rotors=tuple(rotors)))
        assert motor_order(other) == order


def test_parameters_are_floats_with_names_of_16_letters_in_their_order() -> None:
    assert {parameter.type for parameter in SIM_TABLE} == {9}
    names = [parameter.name for parameter in SIM_TABLE]
    assert names == sorted(names)
    assert max(map(len, names)) <= 16
