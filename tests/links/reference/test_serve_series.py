"""One episode after the other: their seeds, flying them again, and their recordings; and owners who fall idle."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from wires import HELLO, HERE, RESET, TASK, Wire, running, step

import qrsim
from qrsim.cli import main
from qrsim.errors import UsageError
from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.seeds import Seeds
from qrsim.links.reference.sensors import SensorReadout, sensor_of, sensor_readings
from qrsim.models.sensors.camera import CameraReading
from qrsim.runs import open_run
from small_worlds import quiet, simulate

SEED = 40
HOLD = [*HERE, 0.0]


def flown(wire: Wire) -> bytes:
    """Fly a second, and return the state at its end."""
    wire.send(step(dt=1.0))
    return wire.payload()


def test_each_init_and_reset_is_the_next_episode_and_any_is_flown_again_by_its_seed():
    ends = []
    with running(seed=SEED) as served:
        for _ in range(2):
            with Wire(served.port) as wire:
                wire.init()
                ends.append(flown(wire))
                for _ in range(2):
                    assert wire.ask(RESET).type == Message.ACK
                    ends.append(flown(wire))
        assert len(set(ends)) == 6
        again = qrsim.load(TASK)
        for number, end in enumerate(ends):
            again.reset(SEED + number)
            again.step(again.waypoint(HERE), ticks=50)
            state = Message.FromString(end).state
            assert list(state.X[0].value) == again.truth.state[0].tolist()
        with Client(port=served.port) as client:
            session = client.open(TASK, seed=SEED + 2)
            np.testing.assert_array_equal(client.step_waypoint(1.0, [HOLD]).state[0], state_of(ends[2]))
            assert client.restart().seed == session.seed + 1
            np.testing.assert_array_equal(client.step_waypoint(1.0, [HOLD]).state[0], state_of(ends[3]))
    printed = [line for line in served.lines if "seed" in line]
    assert printed[:3] == [
        f"session 1 begins: {TASK}, 1 vehicle, seed 40",
        "session 1, episode 2: seed 41",
        "session 1, episode 3: seed 42",
    ]
    assert printed[3] == f"session 2 begins: {TASK}, 1 vehicle, seed 43"


def state_of(payload: bytes) -> list[float]:
    return list(Message.FromString(payload).state.X[0].value)


def test_where_the_operator_wants_it_every_episode_is_the_same():
    ends = set()
    with running(seed=SEED, episodes="same") as served:
        for _ in range(2):
            with Wire(served.port) as wire:
                wire.init()
                ends.add(flown(wire))
                wire.ask(RESET)
                ends.add(flown(wire))
        assert len(ends) == 1
        with Client(port=served.port) as client:
            assert client.open(TASK, seed=7).seed == client.restart().seed == 7
            assert client.restart(8).seed == client.restart().seed == 8
            first = client.play("keep_spot")
            again = client.play()
            assert (first.seed, first.number) == (again.seed, again.number) == (SEED, 0)
            np.testing.assert_array_equal(first.observation, again.observation)


def test_sessions_of_their_own_have_episodes_of_their_own():
    with running(seed=SEED, sessions=True) as served, Client(port=served.port) as one, Client(port=served.port) as two:
        assert [client.open(TASK).seed for client in (one, two)] == [40, 41]
        assert [client.restart().seed for client in (two, one, two)] == [42, 43, 44]
        assert one.play("keep_spot").seed == 45


def test_seeds_stay_seeds():
    seeds = Seeds(2**63 - 1)
    assert [seeds.next(), seeds.next()] == [2**63 - 1, 0]


# ---- recordings ----


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a session of three episodes, of which each was flown by a tick more."""
    folder = tmp_path_factory.mktemp("recorded")
    with running(record=folder, seed=SEED) as served, Wire(served.port) as wire:
        wire.init()
        for ticks in (1, 2, 3):
            wire.ask(step(dt=0.02 * ticks))
            if ticks < 3:
                wire.ask(RESET)
    [found] = folder.iterdir()
    return found


def test_a_session_is_one_folder_of_run_folders(recorded):
    listed = json.loads((recorded / "episodes.json").read_text("utf-8"))
    assert [(item["folder"], item["seed"]) for item in listed["episodes"]] == [
        ("episode-0001", 40),
        ("episode-0002", 41),
        ("episode-0003", 42),
    ]
    episodes = qrsim.open_run(recorded).episodes
    assert [(run.info.seed, run["truth"].tick.tolist(), run.info.state) for run in episodes] == [
        (40, [0, 1], "finished"),
        (41, [0, 1, 2], "finished"),
        (42, [0, 1, 2, 3], "finished"),
    ]
    alone = qrsim.open_run(recorded / "episode-0002")
    assert [run.folder for run in alone.episodes] == [alone.folder]
    for read in (lambda run: run["truth"], lambda run: run.info, lambda run: run.streams, list):
        with pytest.raises(UsageError, match=r"holds 3 episodes, each a run folder: take one of .*episode-0001"):
            read(open_run(recorded))
    with pytest.raises(UsageError, match="runs inside it: "):
        open_run(recorded.parent)


def test_commands_read_an_episode_and_say_which_there_are(recorded, capsys, tmp_path):
    assert main(["plot", str(recorded / "episode-0003"), "--list"]) == 0
    for words in (
        ["plot", str(recorded)],
        ["export", str(recorded), "--format", "csv", "--out", str(tmp_path / "out")],
        ["compare", str(recorded), str(recorded / "episode-0001")],
    ):
        capsys.readouterr()
        assert main(words) == 2
        assert "holds 3 episodes" in capsys.readouterr().err
    assert main(["compare", str(recorded / "episode-0001"), str(recorded / "episode-0002")]) in (0, 1)


def test_an_episode_of_a_recording_is_run_again(recorded, tmp_path, capsys):
    """By its seed on the command line; at the start both have the same noise."""
    out = tmp_path / "again"
    second = qrsim.open_run(recorded).episodes[1]
    scenario = second.folder / "scenario.yaml"
    words = ["run", str(scenario), "--seed", str(second.info.seed), "--duration", "0.04", "--out", str(out)]
    assert main(words) == 0, capsys.readouterr().err
    again = qrsim.open_run(out)
    for stream in ("truth", "measurements"):
        for name, values in second[stream].arrays().items():
            np.testing.assert_array_equal(values[0], again[stream][name][0], f"{stream} {name}")


# ---- what sensors say ----


def test_readings_are_what_protobuf_writes_byte_for_byte():
    for simulation in (simulate(quiet()), qrsim.load(TASK, seed=4)):
        simulation.reset()
        readout = SensorReadout(simulation)
        for _ in range(2):
            simulation.step(ticks=7)
            message = Message(type=Message.READINGS, readings=sensor_readings(simulation))
            assert readout.frame() == frame(message.SerializeToString(deterministic=True))


def test_readings_that_are_missing_are_left_to_protobuf():
    simulation = simulate(quiet())
    readout = SensorReadout(simulation)
    assert readout.frame() is not None
    cut = np.tile([0.0, 0.0, 0.59, 0.0, 12.0], (5, 1))
    cut[3, 2] = 0.0
    simulation.step(cut, ticks=200)
    assert readout.frame() is None
    assert [vehicle.valid for vehicle in sensor_readings(simulation).vehicle].count(False) == 1
    assert sensor_of("camera", CameraReading(None, None, None), simulation.site) is None, "its pictures are seldom new"


# ---- owners who fall idle ----


@pytest.mark.long
def test_an_owner_who_asks_for_nothing_loses_his_session_and_is_told_so():
    with running(idle_timeout=1.0) as served, Wire(served.port) as owner, Wire(served.port) as other:
        owner.init()
        watcher = Client(port=served.port)
        states = watcher.watch(timeout=20.0)
        for _ in range(8):
            assert owner.ask(step()).type == Message.STATE, "who asks for something keeps it"
            time.sleep(0.2)
        state = owner.ask(Message(type=Message.GET_READINGS, get_readings=pb.GetReadings()))
        assert state.type == Message.READINGS
        deadline = time.monotonic() + 20.0
        while served.server.sessions:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert other.init().type == Message.STATE
        said = owner.refused(step())
        assert said.startswith("session 1 has ended, because its owner asked for nothing for 1 s (--idle-timeout)")
        assert owner.ask(HELLO).type == Message.SERVER, "the connection stays"
        assert other.ask(step()).type == Message.STATE
        times = [next(states).time for _ in range(5)]
        assert times[0] == pytest.approx(0.02)
        watcher.close()
        other.socket.close()
        assert owner.init().type == Message.STATE
        assert owner.ask(step()).type == Message.STATE
    assert any(line.startswith("session 1 ended, because its owner asked for nothing") for line in served.lines)


def test_a_client_in_python_is_told_too():
    with running(idle_timeout=0.1) as served, Client(port=served.port) as client:
        client.play("keep_spot")
        deadline = time.monotonic() + 20.0
        while served.server.sessions:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        with pytest.raises(Refused, match=r"asked for nothing for 0\.1 s"):
            client.act([[0.0, 0.0, 0.2, 0.0, 1.0]])
        with pytest.raises(Refused, match=r"asked for nothing for 0\.1 s"):
            client.readings()
