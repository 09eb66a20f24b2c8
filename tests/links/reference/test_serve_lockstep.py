"""The reference protocol: replies byte for byte, and numbers as those of the object in this process."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from wires import DISCONNECT, HELLO, HERE, RESET, TASK, Wire, running, step

import qrsim
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import LARGEST_REQUEST, Deframer, frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message, Step
from qrsim.links.reference.readout import Readout, largest_fleet, state_size
from qrsim.links.reference.tasks import REFERENCE_TASKS, Tasks, offboard
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from small_worlds import quiet, simulate

SEED = 11
WAYPOINT, CONTROL, VELOCITY = [8.0, -7.0, -10.0, 0.4], [0.02, -0.03, 0.6, 0.1, 11.5], [0.5, -0.4, 0.2]
# Where every sensor stands in the measured vector (docs/reference/tcp_protocol.md).
MEASURED = {
    ("gnss", "position_ned"): [0, 1, 2],
    ("attitude", "attitude"): [3, 4, 5],
    ("gyroscope", "rates_body"): [9, 10, 11],
    ("accelerometer", "specific_force"): [13, 14, 15],
    ("barometer", "height"): [16],
    ("barometer", "height_rate"): [19],
}


@pytest.fixture(scope="module")
def here() -> Simulation:
    """The same task in this process."""
    simulation = qrsim.load(TASK, seed=SEED)
    simulation.reset()
    return simulation


def rows(found: pb.State) -> tuple[np.ndarray, np.ndarray]:
    return np.array([row.value for row in found.X]), np.array([row.value for row in found.eX])


def expected(simulation: Simulation) -> pb.State:
    """Return the STATE of a simulation with the ideal sensors of the task, made by protobuf."""
    measured = np.zeros((simulation.size, 20))
    for (sensor, field), columns in MEASURED.items():
        measured[:, columns] = getattr(getattr(simulation.reading, sensor), field).reshape(simulation.size, -1)
    measured[:, [17, 18]] = simulation.reading.gnss.velocity_ned[:, :2]
    return pb.State(
        t=simulation.time,
        X=[pb.Arrayd(value=row) for row in simulation.truth.state],
        eX=[pb.Arrayd(value=row) for row in measured],
    )


def payload(message: Message) -> bytes:
    return message.SerializeToString(deterministic=True)


def state_of(simulation: Simulation) -> bytes:
    return payload(Message(type=Message.STATE, state=expected(simulation)))


def test_lock_step_is_the_object_in_this_process_bit_for_bit(here):
    """Every byte of every reply, over steps of each kind and length, a reset, and states that are set."""
    acknowledged = payload(Message(type=Message.ACK, ack=pb.Ack(error=False)))
    with running(seed=SEED) as served, Wire(served.port) as wire:
        wire.send(Message(type=Message.INIT, init=pb.Init(task=TASK)))
        assert wire.payload() == state_of(here)
        info = pb.TaskInfo(timestep=0.02, numUAVs=1)
        assert wire.payload() == payload(Message(type=Message.TASKINFO, taskInfo=info))
        for kind, row, ticks in (
            (Step.WP, WAYPOINT, 1),
            (Step.WP, WAYPOINT, 7),
            (Step.VEL, VELOCITY, 10),
            (Step.CTRL, CONTROL, 1),
            (Step.VEL, VELOCITY, 1),
            (Step.WP, WAYPOINT, 333),
        ):
            wire.send(step(kind, row, dt=0.02 * ticks))
            here.step(command_of(here, kind, row), ticks=ticks)
            assert wire.payload() == state_of(here), (kind, ticks)
        assert here.truth.velocity_ned.any(), "it has moved"
        for seed, message in ((SEED + 1, RESET), (SEED + 2, Message(type=Message.RESET, reset=pb.Reset(value=False)))):
            wire.send(message)
            assert wire.payload() == acknowledged
            here.reset(seed)
            wire.send(step(Step.WP, WAYPOINT))
            here.step(command_of(here, Step.WP, WAYPOINT))
            assert wire.payload() == state_of(here)
        full = [7.0, -7.0, -8.0, 0.1, -0.1, 0.3, 1.0, 0.5, -0.2, 0.1, 0.2, -0.1, 15.0]
        for width in (3, 6, 12, 13):
            row = full[:width]
            wire.send(Message(type=Message.SETSTATE, setsState=pb.SetState(X=[pb.Arrayd(value=row)])))
            assert wire.payload() == acknowledged
            here.set_state([row])
            wire.send(step(Step.VEL, VELOCITY))
            here.step(command_of(here, Step.VEL, VELOCITY))
            assert wire.payload() == state_of(here), width
        wire.send(DISCONNECT)
        assert wire.payload() == acknowledged
        assert wire.closed()


def command_of(simulation: Simulation, kind: Step.Type, row: list[float]):
    if kind == Step.WP:
        return simulation.waypoint(row[:3], row[3])
    return [row] if kind == Step.CTRL else qrsim.VelocitySetpoint.of([row], 0.0)


def test_each_reply_is_one_write_with_its_length(serving):
    """What is there when the first byte is there is the whole message."""
    with Wire(serving.port) as wire:
        wire.init()
        for _ in range(200):
            wire.send(step())
            content = wire.socket.recv(10_000)
            assert len(content) == state_size(1) == 5 + content[1] + 256 * content[2]


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="this system has no TCP_QUICKACK")
def test_a_part_of_a_request_is_acknowledged_at_once_and_a_whole_one_by_its_reply(serving, wire):
    """A client with its system's defaults holds the second write back until the first is acknowledged."""
    wire.init()
    wire.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 0)
    [connection] = [found for found in serving.server._connections if found.session is not None]
    asked = []
    plain = connection._socket

    class Spied:
        def setsockopt(self, *words: int) -> None:
            asked.append(words)
            plain.setsockopt(*words)

    connection._socket = Spied()
    content = frame(payload(step()))
    for _ in range(5):
        wire.socket.sendall(content)
        assert wire.receive().type == Message.STATE
    assert asked == [], "the reply acknowledges"
    for cuts in ((5,), (3, 5), (20,)):
        before = len(asked)
        for number, part in enumerate(np.split(np.frombuffer(content, np.uint8), cuts)):
            wait_until(lambda expected=before + number: len(asked) == expected)
            wire.socket.sendall(part.tobytes())
        assert wire.receive().type == Message.STATE
        assert len(asked) == before + len(cuts)
    assert set(asked) == {(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)}


def wait_until(reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30.0
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def test_sixteen_outstanding_requests_are_answered_in_order(connect):
    wire, plain = connect(), connect()
    wire.init()
    wire.send(*[step(dt=0.02 * (1 + i % 3)) for i in range(16)], RESET, step())
    times = [wire.receive().state.t for _ in range(16)]
    np.testing.assert_allclose(times, np.cumsum([0.02 * (1 + i % 3) for i in range(16)]))
    assert wire.receive().type == Message.ACK
    assert wire.receive().state.t == pytest.approx(0.02)
    assert plain.refused(step()) == "there is no session on this connection: send INIT first"


def test_replies_to_requests_that_came_together_are_whole_messages_in_each_write(serving, wire):
    """Also where an error, another kind of request, a long STEP or one that is not understood comes between."""
    wire.init()
    # The first STEP of a kind is not short yet.
    for _ in range(3):
        wire.ask(step())
    [connection] = [found for found in serving.server._connections if found.session is not None]
    written: list[bytes] = []
    write = connection.transport.write
    connection.transport.write = lambda content: (written.append(content), write(content))
    mixed = [step(), step(dt=0.03), step(), RESET, step(), HELLO, step(dt=10.0), step(), Message(type=Message.NONE)]
    wire.send(*[step()] * 16, *mixed, *[step()] * 16)
    replies = [wire.receive() for _ in range(32 + len(mixed))]
    assert [reply.type for reply in replies[16:-16]] == [
        Message.STATE,
        Message.ACK,
        Message.STATE,
        Message.ACK,
        Message.STATE,
        Message.SERVER,
        Message.STATE,
        Message.STATE,
        Message.ACK,
    ]
    assert {reply.type for reply in replies[:16] + replies[-16:]} == {Message.STATE}
    counts = []
    for content in written:
        deframer = Deframer(LARGEST_REQUEST)
        deframer.feed(content)
        counts.append(sum(1 for _ in iter(deframer.next, None)))
        assert deframer.waiting == 0
    assert sum(counts) == len(replies)
    assert max(counts) > 1, "what came together is answered together"


def test_who_sends_many_requests_leaves_the_others_their_turn(serving, connect):
    busy, other = connect(), connect()
    busy.init()
    count = 10_000
    busy.send(*[step()] * count)
    assert other.ask(HELLO).type == Message.SERVER
    [session] = serving.server.sessions.values()
    assert session.simulation.tick < count
    for _ in range(count):
        busy.receive()
    assert session.simulation.tick == count


def test_a_fleet_without_a_sensor_has_nan_and_fleets_stand_one_after_the_other():
    simulation = simulate(quiet())
    simulation.step(ticks=3)
    content = Readout(simulation).frame()
    found = Message.FromString(content[5:])
    assert content == frame(payload(found)), "byte for byte what protobuf writes"
    state, measured = rows(found.state)
    np.testing.assert_array_equal(state, simulation.truth.state)
    alpha, bravo = simulation.reading["alpha"], simulation.reading["bravo"]
    np.testing.assert_array_equal(measured[:3, 0:3], alpha.gnss.position_ned)
    np.testing.assert_array_equal(measured[:3, 17:19], alpha.gnss.velocity_ned[:, :2])
    np.testing.assert_array_equal(measured[:3, 9:12], alpha.gyroscope.rates_body)
    np.testing.assert_array_equal(measured[:3, 16], alpha.barometer.height)
    np.testing.assert_array_equal(measured[3:, 16], bravo.height.height)
    np.testing.assert_array_equal(measured[3:, 19], bravo.height.height_rate)
    np.testing.assert_array_equal(measured[:, [6, 7, 8, 12]], 0.0)
    assert np.isnan(measured[:3, [3, 4, 5, 13, 14, 15]]).all()
    assert np.isnan(measured[3:, [0, 1, 2, 3, 4, 5, 9, 10, 11, 13, 14, 15, 17, 18]]).all()


def test_where_no_sensor_reports_an_attitude_the_estimators_counts():
    fleet: dict[str, Any] = {"sensors": {"attitude": None}, "estimator": {"type": "complementary"}}
    fleet["vehicles"] = [{"position_ned": [0.0, 0.0, -10.0], "yaw_rad": 0.7}]
    simulation = simulate({"extends": "hover_ideal", "name": "own", "fleets": {"pelicans": fleet}})
    simulation.step(ticks=5)
    believed = simulation.state.fleets[0].belief.estimate.attitude
    _, measured = rows(Message.FromString(Readout(simulation).frame()[5:]).state)
    np.testing.assert_array_equal(measured[:, 3:6], np.stack([believed.roll, believed.pitch, believed.yaw], axis=1))
    assert measured[0, 3:6] == pytest.approx([0.0, 0.0, 0.7], abs=0.05)


def test_a_reference_client_can_hold_thirty_six_vehicles():
    assert largest_fleet(10_000) == 36
    assert state_size(36) <= 10_000 < state_size(37)


def test_a_served_cascade_takes_all_commands_as_it_is():
    """Its gains have other units than those of the published loops."""
    assert offboard(load_scenario("patrol_plain")).spec == load_scenario("patrol_plain").spec


@pytest.mark.parametrize("name", ["keep_spot", "keep_velocity", "patrol_published"])
def test_a_served_scenario_takes_all_commands_and_keeps_its_gains(name):
    before, after = load_scenario(name).spec, offboard(load_scenario(name)).spec
    for fleet in before.fleets:
        old, new = before.fleets[fleet].controller, after.fleets[fleet].controller
        assert new.type == "offboard"
        kept, now = old.model_dump(exclude={"type"}), new.model_dump()
        assert {"tilt_limit", "feed"} <= set(kept)
        assert {name: now[name] for name in kept if name in now} == {k: v for k, v in kept.items() if k in now}
        assert before.fleets[fleet].guidance == after.fleets[fleet].guidance
    assert before.world == after.world


def test_with_reasons_a_state_has_one_for_each_vehicle_byte_for_byte():
    """Empty while it flies."""
    simulation = simulate(quiet())
    readout = Readout(simulation, reasons=True)
    content = readout.frame()
    found = Message.FromString(content[5:])
    assert list(found.state.reason) == [""] * 5
    assert content == frame(payload(found)), "byte for byte what protobuf writes"
    assert Message.FromString(Readout(simulation).frame()[5:]).state.reason == []
    cut = np.tile([0.0, 0.0, 0.59, 0.0, 12.0], (5, 1))
    cut[3, 2] = 0.0
    simulation.step(cut, ticks=200)
    content = readout.frame()
    found = Message.FromString(content[5:])
    assert list(found.state.reason) == simulation.reasons
    assert [reason != "" for reason in found.state.reason] == [False, False, False, True, False]
    assert content == frame(payload(found))


@pytest.mark.long
def test_every_built_in_scenario_has_every_sensor_of_the_measured_vector():
    for name in Tasks().names:
        for fleet in Tasks().offboard(name).spec.fleets.values():
            # Those of a task may have a camera or a concentration sensor too.
            has = set(fleet.sensors) | ({"attitude"} if fleet.estimator is not None else set())
            has |= {"gyroscope", "accelerometer"} if "imu" in has else set()
            if fleet.vehicle.type in ("pelican", "multirotor"):
                assert has >= {"gnss", "barometer", "attitude", "gyroscope", "accelerometer"}, name


@pytest.mark.long
def test_reference_names_are_our_scenarios_and_an_empty_name_is_the_operators_own():
    own = load_scenario({**quiet(), "name": "mine"})
    tasks = Tasks(own)
    for name, ours in REFERENCE_TASKS.items():
        assert tasks.offboard(name).spec == offboard(load_scenario(ours)).spec
    assert tasks.offboard("").spec == tasks.offboard("mine").spec == offboard(own).spec
    assert tasks.names[0] == "mine"


@pytest.mark.parametrize("asked", ["free_flight", "TaskComplacs"])
def test_all_names_of_the_operators_scenario_mean_it_as_he_changed_it(asked):
    """Also where a change is that of its name."""
    for changes, own in ((["time_step=0.01"], "free_flight"), (["time_step=0.01", "name=mine"], "mine")):
        tasks = Tasks(load_scenario("free_flight", changes), asked)
        for name in ("", own, "free_flight", "TaskComplacs"):
            assert tasks.offboard(name).spec.time_step == 0.01, name
            assert tasks.scenario(name).name == own
        assert tasks.offboard("TaskKeepSpot").spec.time_step == 0.02


def test_the_speed_of_heading_zero(connect):
    """VEL turns the vehicle to the north, as the reference does."""
    wire = connect()
    wire.init()
    turned = [*HERE, 0.0, 0.0, 1.0]
    wire.ask(Message(type=Message.SETSTATE, setsState=pb.SetState(X=[pb.Arrayd(value=turned)])))
    state, _ = rows(wire.ask(step(Step.VEL, [0.0, 0.0, 0.0], dt=4.0)).state)
    assert abs(state[0, 5]) < 0.1
