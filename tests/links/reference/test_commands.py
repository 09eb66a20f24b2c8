"""Commands of STEPs: what is known without being parsed is what parsing says."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
import yaml
from wires import TASK, Running, step

import qrsim
from qrsim.control import SETPOINTS
from qrsim.core.tree import walk
from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.commands import WIDTHS, Commands
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step

CHANCE = np.random.default_rng(5)
NUMBERS = [1e300, -1e-300, np.nan, -np.inf, -0.0, 0.1, 16777217.0]


def commands(size: int) -> Commands:
    return Commands([f"pelicans_{i}" for i in range(size)], np.dtype(np.float32))


def request(kind: Step.Type, size: int, dt: float = 0.04) -> bytes:
    """Return a STEP with numbers of all sizes."""
    rows = CHANCE.choice([*NUMBERS, *CHANCE.normal(size=20)], (size, WIDTHS[kind]))
    return step(kind, *rows.tolist(), dt=dt).SerializeToString()


def learn(made: Commands, payload: bytes) -> None:
    message = Message.FromString(payload)
    made.of(message.step)
    made.learn(payload, message.step, 2)


def numbers(command: Any) -> list[np.ndarray]:
    return [np.array(leaf) for leaf in jax.tree.leaves(command)]


@pytest.mark.parametrize("size", [1, 2, 40])
@pytest.mark.parametrize("kind", Step.Type.values())
def test_a_known_step_has_the_numbers_of_a_parsed_one(kind, size):
    made, parsed = commands(size), commands(size)
    learn(made, request(kind, size))
    assert made.known(request(kind, size)) is None, "one is not enough"
    learn(made, request(kind, size))
    for _ in range(20):
        payload = request(kind, size)
        found = made.known(payload)
        assert found is not None
        assert found[1] == 2
        expected = parsed.of(Message.FromString(payload).step)
        assert type(found[0]) is type(expected)
        for mine, theirs in zip(numbers(found[0]), numbers(expected), strict=True):
            np.testing.assert_array_equal(mine.view(np.int32), theirs.view(np.int32))


def test_what_is_not_the_same_but_for_its_numbers_is_parsed():
    made = commands(2)
    for _ in range(2):
        learn(made, request(Step.WP, 2))
    payload = request(Step.WP, 2)
    assert made.known(payload) is not None
    assert made.known(request(Step.WP, 2, dt=0.02)) is None
    assert made.known(payload[:-1]) is None
    assert made.known(request(Step.VEL, 2)) is None
    # Every byte that is not part of a number.
    first = payload.index(bytes([0x1A, 34, 0x0A, 32]))
    for at in [*range(first + 4), *range(first + 36, first + 40)]:
        changed = bytearray(payload)
        changed[at] ^= 1
        assert made.known(bytes(changed)) is None, at


def test_a_step_that_is_written_in_another_way_is_always_parsed():
    plain = step(Step.VEL, [1.0, 2.0, 3.0]).SerializeToString()
    body = plain[4:]
    others = [
        plain[2:] + plain[:2],  # the kind of message comes last
        b"\x08\x05\x32" + bytes([len(body)]) + body[9:11] + body[:9] + body[11:],  # the kind of step before the time
        plain[:3] + bytes([len(body) + 2]) + body + b"\x78\x01",  # with a field that nobody knows
        Message(type=Message.STEP, step=Message.FromString(plain).step, ack=pb.Ack(error=False)).SerializeToString(),
    ]
    for payload in others:
        made = commands(1)
        assert list(Message.FromString(payload).step.cmd[0].value) == [1.0, 2.0, 3.0]
        for _ in range(3):
            learn(made, payload)
        assert made.known(payload) is None


@pytest.mark.parametrize(
    ("kind", "name", "numbers_of", "fields"),
    [
        (Step.VEL_YAW, "velocity", 4, ["velocity_ned.x", "velocity_ned.y", "velocity_ned.z", "yaw"]),
        (Step.VEL_HEIGHT, "velocity_height", 4, ["velocity_north", "velocity_east", "z", "yaw"]),
        (Step.ATT_HEIGHT, "attitude_height", 4, ["roll", "pitch", "z", "yaw"]),
        (Step.ATT, "attitude", 4, ["roll", "pitch", "yaw", "throttle"]),
        (
            Step.PATH, "path", 10,
            ["position_ned.x", "position_ned.y", "position_ned.z", "velocity_ned.x", "velocity_ned.y", "velocity_ned.z",
             "acceleration_ned.x", "acceleration_ned.y", "acceleration_ned.z", "yaw"],
        ),
        (
            Step.TRACK, "track", 9,
            ["begin_ned.x", "begin_ned.y", "begin_ned.z", "position_ned.x", "position_ned.y", "position_ned.z",
             "radius", "speed", "stops"],
        ),
    ],
)  # fmt: skip
def test_each_number_of_a_setpoint_is_where_its_name_says(kind, name, numbers_of, fields):
    rows = [[0.5 + i for i in range(numbers_of)], [-0.5 - i for i in range(numbers_of)]]
    found = commands(2).of(Message.FromString(step(kind, *rows).SerializeToString()).step)
    assert type(found) is SETPOINTS[name]
    said = {path: leaf.tolist() for path, leaf, _ in walk(found)}
    assert said == {field: [0.5 + i, -0.5 - i] for i, field in enumerate(fields)}


@pytest.mark.long
def test_a_rover_is_driven_along_a_line_and_round_a_circle(serving: Running):
    rover = {
        "vehicle": {"type": "rover"},
        "controller": {"type": "rover", "feed": "truth"},
        "vehicles": [{"position_ned": [0.0, 3.0, 0.0]}],
    }
    scenario = {"name": "cars", "duration": 60.0, "fleets": {"cars": rover}}
    with Client(port=serving.port) as client:
        client.open(scenario=yaml.safe_dump(scenario), seed=4)
        line = client.step_setpoint(12.0, "track", [[0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 2.5, 1.0]])
        assert line.state[0][:2] == pytest.approx([20.0, 0.0], abs=0.6)
        circle = client.step_setpoint(20.0, "track", [[20.0, 10.0, 0.0, 20.0, 10.0, 0.0, 10.0, 2.5, 0.0]])
        assert np.hypot(circle.state[0][0] - 20.0, circle.state[0][1] - 10.0) == pytest.approx(10.0, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "row", "setpoint"),
    [
        ("velocity", [0.5, -0.5, 0.1, 0.3], qrsim.VelocitySetpoint.of([[0.5, -0.5, 0.1]], 0.3)),
        ("velocity_height", [0.5, -0.5, -9.5, 0.3], qrsim.VelocityHeightSetpoint.of([[0.5, -0.5]], -9.5, 0.3)),
        ("attitude_height", [0.02, -0.01, -9.5, 0.3], qrsim.AttitudeHeightSetpoint.of([0.02], -0.01, -9.5, 0.3)),
        ("attitude", [0.02, -0.01, 0.3, 0.6], qrsim.AttitudeSetpoint.of([0.02], -0.01, 0.3, 0.6)),
    ],
)
def test_a_served_setpoint_is_that_of_the_simulation(kind, row, setpoint, serving: Running):
    with Client(port=serving.port) as client:
        session = client.open(TASK, seed=4)
        state = client.step_setpoint(0.4, kind, [row])
        with pytest.raises(Refused, match="a PathSetpoint is not for OffboardController"):
            client.step_setpoint(0.02, "path", [[0.0] * 10])
        with pytest.raises(Refused, match="3 numbers; expected 4"):
            client.step_setpoint(0.02, kind, [row[:3]])
    here = qrsim.load(TASK, seed=session.seed)
    here.reset()
    here.step(setpoint, ticks=20)
    assert state.state[0].tolist() == here.truth.state[0].tolist()
