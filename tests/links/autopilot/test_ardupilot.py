"""ArduPilot's JSON interface, against a stand-in that follows its description to the byte, with loops of its own.

Source of all layouts: ArduPilot, libraries/SITL/examples/JSON/readme.md; of the motors: AP_MotorsMatrix.cpp.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
import time
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot import servo_link
from qrsim.links.autopilot.ardupilot import servos, speeds
from qrsim.links.autopilot.json_flight import JsonFlight, motor_order, prepared
from qrsim.links.autopilot.servo_link import ServoLink
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation

RATE = 400.0
# Arms of frame X, degrees clockwise from the nose, and +1 for a motor whose torque turns the nose clockwise.
QUAD = ((45, 1), (-135, 1), (-45, -1), (135, -1))
HEXA = ((90, -1), (-90, 1), (-30, -1), (150, 1), (30, 1), (-150, -1))


def packet(frame: int, pulses: list[int], rate: int = 400, magic: int = 18458) -> bytes:
    channels = 16 if magic == 18458 else 32
    head = magic.to_bytes(2, "little") + rate.to_bytes(2, "little") + frame.to_bytes(4, "little")
    return head + b"".join(pulse.to_bytes(2, "little") for pulse in (pulses + [0] * channels)[:channels])


class StandIn(threading.Thread):
    """Takes off at 1 s, holds ``height`` over its start, and says what it has seen; in lock-step by its packets."""

    def __init__(self, port: int, frame: Any = QUAD, height: float = 3.0, hover: float = 0.75, steps: int = 10**9):
        super().__init__(daemon=True)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(60.0)
        self._frame, self._height, self._hover, self._steps = frame, height, hover, steps
        self._climb = 0.0
        self.seen: list[dict[str, Any]] = []
        self.double_every = 0

    def run(self) -> None:
        pulses: list[int] = [1000] * len(self._frame)
        try:
            for frame in range(self._steps):
                sent = packet(frame, pulses)
                self._socket.send(sent)
                if self.double_every and frame % self.double_every == 0:
                    self._socket.send(sent)
                    first, again = self._socket.recv(4096), self._socket.recv(4096)
                    assert first == again, "a step that comes again is answered again"
                    said = again
                else:
                    said = self._socket.recv(4096)
                assert said[:1] == said[-1:] == b"\n"
                self.seen.append(json.loads(said))
                pulses = self._fly(self.seen[-1])
        except OSError:
            return
        finally:
            self._socket.close()

    def _fly(self, now: dict[str, Any]) -> list[int]:
        if now["timestamp"] < 1.0:
            return [1000] * len(self._frame)
        (north, east, down), (vn, ve, vd) = now["position"], now["velocity"]
        roll, pitch, yaw = now["attitude"]
        p, q, r = now["imu"]["gyro"]
        off = self._height + down
        self._climb = min(max(self._climb + off / RATE, -1.0), 1.0)
        lift = self._hover + 0.12 * off + 0.1 * self._climb + 0.18 * vd
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, right = -0.8 * north - 1.2 * vn, -0.8 * east - 1.2 * ve
        lean = -0.1 * (cos * ahead + sin * right), 0.1 * (cos * right - sin * ahead)
        wanted_pitch, wanted_roll = (min(max(value, -0.25), 0.25) for value in lean)
        turn_p, turn_q, turn_r = 0.12 * (6.0 * (wanted_roll - roll) - p), 0.12 * (6.0 * (wanted_pitch - pitch) - q), 0.0
        turn_r = 0.1 * (-yaw - r)
        found = []
        for arm, spin in self._frame:
            forward, side = math.cos(math.radians(arm)), math.sin(math.radians(arm))
            share = lift - turn_p * side + turn_q * forward + turn_r * spin
            found.append(round(1000 + 1000 * min(max(share, 0.05), 1.0)))
        return found


def flight_of(
    name: Any, port: int, fleets: tuple[str, ...] = (), wait: float = 20.0, said: Any = None, lost: Any = None
) -> Any:
    scenario, flown = prepared(load_scenario(name), fleets, "x500", RATE)
    simulation = Simulation(scenario.world(), seed=3, name=scenario.name, site=scenario.site)
    simulation.reset()
    return JsonFlight(simulation, flown, port, wait, (said if said is not None else []).append, lost)


def one(model: str = "x500", feed: str = "truth") -> dict[str, Any]:
    return {
        "name": "one",
        "extends": "hover",
        "duration": 60.0,
        "fleets": {
            "pelicans": {
                "vehicle": {"type": "multirotor", "model": model},
                "controller": {"type": "cascade", "feed": feed},
            }
        },
    }


def own(geometry: str, rotors: int) -> dict[str, Any]:
    found = one()
    numbers = {"mass": 2.0, "arm": 0.25, "hover_throttle": 0.5, "thrust_to_weight": 2.0, "attitude_bandwidth": 8.0}
    own = {**numbers, "rotors": rotors, "geometry": geometry}
    found["fleets"]["pelicans"]["vehicle"] = {"type": "multirotor", "own": own}
    return found


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        found = free.getsockname()[1]
    return min(found, 64_000)


def test_packets_have_the_bytes_of_the_description() -> None:
    """uint16 magic, uint16 frame_rate, uint32 frame_count, uint16 pwm[16] or [32], little endian."""
    found = servos(bytes.fromhex("1a48 9001 05000000") + struct.pack("<16H", *range(1000, 1016)))
    assert found is not None
    assert (found.rate, found.frame, found.pulses) == (400, 5, tuple(range(1000, 1016)))
    many = servos(bytes.fromhex("8173 b004 00000100") + struct.pack("<32H", *range(32)))
    assert many is not None
    assert (many.rate, many.frame, many.pulses[-1]) == (1200, 65536, 31)
    whole = packet(1, [1500])
    assert len(whole) == 40
    for wrong in (b"", b"\x1a", whole[:-1], whole + b"\0", b"\0\0" + whole[2:], packet(1, [1500], magic=29569)[:40]):
        assert servos(wrong) is None
    assert speeds((0, 1000, 1500, 2000, 2200), 5) == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_motors_are_where_and_turn_as_those_of_frame_x() -> None:
    for scenario, frame in ((one(), QUAD), (own("hexa_x", 6), HEXA)):
        world = prepared(load_scenario(scenario), (), "x500", RATE)[0].world()
        vehicle: Any = world.fleets[0].vehicle
        for rotor, number in zip(vehicle.rotors, motor_order(world.fleets[0]), strict=True):
            arm, torque = frame[number]
            bearing = math.degrees(math.atan2(rotor.position[1], rotor.position[0]))
            assert abs((bearing - arm + 180.0) % 360.0 - 180.0) < 12.0
            # A rotor that turns counter-clockwise turns the vehicle clockwise.
            assert rotor.direction == -torque


@pytest.mark.long
def test_a_stand_in_takes_off_and_holds_its_height(port: int) -> None:
    said: list[str] = []
    pilot = StandIn(port, steps=round(8.0 * RATE))
    with flight_of(one(), port, said=said) as flight:
        pilot.start()
        history = flight.record(round(8.0 * RATE))
    pilot.join(10.0)
    pose = flight.simulation.world.fleets[0].vehicle.pose(history.state.fleets[0].vehicle)
    height = -np.asarray(pose.position_ned.z)[:, 0]
    # On the ground until its motors turn; then 3 m above where it stood, pushed off by the wind as far as it leans.
    assert np.ptp(height[: round(0.9 * RATE)]) < 0.01
    assert height[-1] - height[0] == pytest.approx(3.0, abs=0.15)
    assert abs(np.asarray(pose.position_ned.x)[-1, 0] - np.asarray(pose.position_ned.x)[0, 0]) < 1.5
    first, last = pilot.seen[10], pilot.seen[-1]
    # At rest the accelerometer of an FRD body says minus gravity.
    assert first["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -9.81], abs=0.05)
    assert first["position"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert last["timestamp"] == pytest.approx(8.0)
    assert -last["position"][2] == pytest.approx(float(height[-1] - height[0]), abs=1e-3)
    assert any("asks for 400 steps a second" in line for line in said)
    assert (flight.links[0].lost, flight.links[0].repeated, flight.links[0].foreign) == (0, 0, 0)


@pytest.mark.long
def test_two_fly_at_once_and_the_same_twice(port: int) -> None:
    def flown() -> list[Any]:
        team = one()
        team["fleets"]["pelicans"]["vehicles"] = [{"position_ned": [north, 0.0, -5.0]} for north in (0.0, 8.0)]
        ticks = round(1.5 * RATE)
        pilots = [StandIn(each, steps=ticks) for each in (port, port + 10)]
        with flight_of(team, port) as flight:
            for pilot in pilots:
                pilot.start()
            flight.advance(ticks)
            assert not any(flight.simulation.reasons)
        for pilot in pilots:
            pilot.join(10.0)
        return [pilot.seen for pilot in pilots]

    first, again = flown(), flown()
    assert first == again
    for seen in first:
        # In the air after 0.5 s of its motors.
        assert 0.03 < -seen[-1]["position"][2] < 3.0


@pytest.mark.long
def test_a_step_that_comes_again_is_answered_again_and_lost_ones_are_counted(port: int) -> None:
    said: list[str] = []
    with flight_of(one(), port, said=said) as flight, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.connect(("127.0.0.1", port))
        peer.settimeout(5.0)

        def step(frame: int) -> dict[str, Any]:
            peer.send(packet(frame, [1000] * 4))
            flight.advance()
            found: dict[str, Any] = json.loads(peer.recv(4096))
            return found

        times = [step(frame)["timestamp"] for frame in (0, 1)]
        peer.send(packet(1, [1000] * 4))
        times.append(step(5)["timestamp"])
        assert json.loads(peer.recv(4096))["timestamp"] == 0.0075
        link = flight.links[0]
        assert (link.repeated, link.lost) == (1, 3)
        assert times == pytest.approx([0.0025, 0.005, 0.005], abs=1e-6)
        # Begun anew: the vehicle goes on.
        peer.send(packet(0, [1000] * 4))
        flight.advance()
        assert json.loads(peer.recv(4096))["timestamp"] == pytest.approx(0.01)
        assert link.restarts == 1
        assert any("ArduPilot has restarted" in line for line in said)


@pytest.mark.long
def test_a_restarted_ardupilot_flies_its_vehicle_from_another_port(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """SITL binds no port, so its packets come from another one; frames count from 0 (SIM_JSON.cpp)."""
    said: list[str] = []

    def step(peer: socket.socket, frame: int) -> float:
        peer.sendto(packet(frame, [1000] * 4), ("127.0.0.1", port))
        flight.advance()
        return float(json.loads(peer.recv(4096))["timestamp"])

    with ExitStack() as close:
        flight = close.enter_context(flight_of(one(), port, said=said))
        first, second, third = (close.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(3))
        for peer in (first, second, third):
            peer.settimeout(5.0)
        times = [step(first, 0), step(first, 1000), step(second, 0), step(second, 1000)]
        # Where it was lost that one restarted, another is heard once the first is silent.
        monkeypatch.setattr(servo_link, "SILENCE_S", 0.1)
        time.sleep(0.15)
        times.append(step(third, 500))
        assert times == pytest.approx([0.0025, 0.005, 0.0075, 0.01, 0.0125])
        link = flight.links[0]
        assert (link.restarts, link.foreign) == (2, 0)
        assert f"ArduPilot has restarted, at 127.0.0.1:{second.getsockname()[1]}; the vehicle goes on" in said[1]


@pytest.mark.long
def test_packets_of_others_are_passed_over(port: int) -> None:
    said: list[str] = []
    with flight_of(one(), port, said=said) as flight, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.connect(("127.0.0.1", port))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(b"hello", ("127.0.0.1", port))
            peer.send(packet(0, [1000] * 4))
            flight.advance()
            other.sendto(packet(50, [2000] * 4), ("127.0.0.1", port))
            peer.send(packet(1, [1000] * 4))
            flight.advance()
        assert flight.links[0].foreign == 2
    assert sum("is not of its ArduPilot" in line for line in said) == 1


@pytest.mark.long
def test_nobody_there_and_somebody_gone_are_one_line(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(servo_link, "SILENCE_S", 0.1)
    monkeypatch.setattr(servo_link, "_POLL_S", 0.1)
    with flight_of(one(), port, wait=0.3, said=said) as flight:
        with pytest.raises(
            RunError, match=rf"pelicans0?.*: no ArduPilot has come to UDP port {port} in 0.3 s; start it"
        ):
            flight.advance()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.sendto(packet(0, [1000] * 4), ("127.0.0.1", port))
            flight.advance()
        with pytest.raises(RunError, match=r"its ArduPilot has been silent for 0\.3 s, since step 0, and no other"):
            flight.advance()
    assert said[-1].endswith("its ArduPilot is silent; waiting 0.3 s for it to start again")
    with flight_of(one(), port, wait=0.1, lost=said.append) as flight:
        flight.advance(2)
        assert flight.simulation.tick == 2
    assert said[-1].endswith("; its motors stop, and the others fly on")


def test_a_port_that_is_taken_is_said(port: int) -> None:
    link = ServoLink("a", port, 1.0, lambda line: None)
    try:
        with pytest.raises(UsageError, match=rf"UDP port {port} for b is taken .*; choose another --port"):
            ServoLink("b", port, 1.0, lambda line: None)
    finally:
        link.close()


def test_ports_beyond_the_last_are_refused() -> None:
    # Five vehicles: 65500 + 4 * 10.
    with pytest.raises(UsageError, match="--port 65500: the last vehicle would have UDP 65540, at most 65535 is"):
        flight_of("mavlink_field", 65_500)


def test_what_it_cannot_fly_is_refused() -> None:
    with pytest.raises(UsageError, match="a fixed_wing is flown by no ArduPilot here"):
        prepared(load_scenario("mixed_team"), ("planes",), "x500", RATE)
    # The hexacopter of this model has its rotors where ArduPilot has them, and turning the other way.
    for scenario, rotors in ((own("quad_plus", 4), 4), (one("hexa4"), 6)):
        world = prepared(load_scenario(scenario), (), "x500", RATE)[0].world()
        with pytest.raises(UsageError, match=f"its {rotors} rotors are no frame X of ArduPilot's"):
            motor_order(world.fleets[0])
