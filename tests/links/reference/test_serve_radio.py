"""Messages over the radio as clients say and hear them: with an owner, in a shared world, in a task, and replayed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_worlds import SEED, A, B, together
from wires import Running, Wire, running

import qrsim
from qrsim.cli import main
from qrsim.errors import UsageError
from qrsim.interface.messages import checked_message
from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.radio import said, words_of
from qrsim.links.reference.tasks import Tasks
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.tasks import Play
from small_worlds import pair

# 60 bytes at 64 kb/s are 7.5 ms, so what is said at a tick of 20 ms is known at the next one.
RADIO: dict[str, Any] = {
    "preset": "sik_915",
    "beacon": False,
    "size": 3,
    "inbox": {"size": 2, "candidates": 1},
    "path_loss": {"waves": 1},
}


def talking() -> Any:
    return pair(radio=RADIO)


def saying(*words: tuple[str, list[float]], **more: Any) -> Message:
    found = [pb.Say.Words(vehicle=vehicle, value=numbers, **more) for vehicle, numbers in words]
    return Message(type=Message.SAY, say=pb.Say(words=found))


@contextlib.contextmanager
def served(**options: Any) -> Iterator[tuple[Running, Client, Client]]:
    with (
        running(Tasks(talking()), seed=SEED, **options) as found,
        Client(port=found.port) as one,
        Client(port=found.port) as other,
    ):
        yield found, one, other


@pytest.mark.parametrize(
    ("vehicle", "numbers", "to", "message"),
    [
        ("vehicle_0", [1.0], None, "say: vehicle: no vehicle is called 'vehicle_0'; did you mean 'vehicles_0'"),
        (A, [1.0], "x" * 99, f"say: to: no vehicle is called '{'x' * 60}'"),
        (A, [0.0] * 4, None, r"say: 'vehicles_0': 4 numbers are more than a message has, 3 \(world.radio.size\)"),
        (A, [0.0, float("nan")], None, "say: 'vehicles_0': a number is not finite"),
        (A, [1e39], None, "say: 'vehicles_0': a number is not finite, or larger than 3.403e\\+38"),
    ],
)
def test_what_cannot_be_said_is_refused_in_one_line(
    vehicle: str, numbers: list[float], to: str | None, message: str
) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        checked_message(talking().world(), (A, B), vehicle, numbers, to)
    assert "\n" not in str(caught.value)
    assert checked_message(talking().world(), (A, B), B, [2.0], A) == (1, [2.0, 0.0, 0.0], 0)


def test_messages_of_agents_are_checked_before_anything_is_flown() -> None:
    chase = {"name": "talk", "extends": "cats_and_mouse/1A", "world": {"radio": {"size": 2}}}
    scenario = load_scenario(chase)
    play = Play(scenario.task(), scenario.world(), scenario.steps)
    rows = [pb.Arrayd(value=[1.0, 2.0]), pb.Arrayd(), pb.Arrayd(value=[3.0, 4.0])]
    np.testing.assert_array_equal(said(play, pb.Act(say=rows)), [[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]])
    assert np.isnan(said(play, pb.Act())).all()
    with pytest.raises(UsageError, match="say: there are 2 messages; expected 3, one of each agent"):
        said(play, pb.Act(say=rows[:2]))
    with pytest.raises(UsageError, match="say of 'cat_1': 1 numbers; expected 2"):
        said(play, pb.Act(say=[rows[0], pb.Arrayd(value=[1.0]), rows[2]]))
    with pytest.raises(UsageError, match="say of 'cat_0': a number is not finite"):
        said(play, pb.Act(say=[pb.Arrayd(value=[1e39, 0.0]), rows[1], rows[2]]))
    with pytest.raises(UsageError, match="SAY: 'a' is given 2 messages; one is allowed"):
        words_of(saying(("a", [1.0]), ("a", [2.0])).say)


@pytest.mark.long
def test_an_owner_hears_what_a_simulation_in_this_process_hears() -> None:
    here = Simulation(talking().world(), seed=SEED)
    here.reset()
    goals = np.array([[3.0, 0.0, -11.0, 0.0], [3.0, 9.0, -11.0, 0.0]])
    with served() as (found, client, _):
        client.open("pair", seed=SEED)
        assert client.hello()["capabilities"][-1] == "radio"
        assert client.describe()["radio"]["size"] == 3
        assert client.inbox() == {A: (), B: ()}
        client.say({A: [1.5, -2.5]})
        client.say({B: [7.0]}, to=A)
        here.send(0, [1.5, -2.5])
        here.send(1, [7.0], to=0)
        client.step_waypoint(0.3, goals)
        here.step(qrsim.WaypointSetpoint.of(goals[:, :3], goals[:, 3]), ticks=15)
        for name, heard in client.inbox().items():
            (one,), (other,) = heard, here.inbox(name)
            assert (one.sender, one.sent, one.received, one.rssi) == (
                other.sender,
                other.sent,
                other.received,
                other.rssi,
            )
            assert one.payload.tolist() == other.payload.tolist()
        assert client.inbox()[B][0].payload.tolist() == [1.5, -2.5, 0.0]
        with pytest.raises(Refused, match="say: 'vehicles_0': 4 numbers are more than a message has, 3"):
            client.say({A: [0.0] * 4})
        with pytest.raises(UsageError, match="message of 'vehicles_0': expected numbers"):
            client.say({A: "hello"})
        with Wire(found.port) as wire:
            assert "INIT" in wire.refused(saying((A, [1.0])))


@pytest.mark.long
def test_clients_of_a_shared_world_talk_and_a_recording_says_it_again(tmp_path: Path) -> None:
    """Each hears the other; who says something for somebody else's vehicle is refused, and changes nothing."""
    folder = tmp_path / "served"
    with served(pace="barrier", record=folder) as (found, one, other):
        one.claim(A)
        other.claim(B)
        one.subscribe(A)
        for k in range(6):
            one.say({A: [float(k), 0.0, 0.5]})
            # Only the last one of a tick counts.
            other.say({B: [99.0]})
            other.say({B: [-1.0 - k]}, to=A)
            order = {A: ("waypoint", [3.0, 0.0, -11.0, 0.0])}
            mine, theirs = together(lambda order=order: one.advance(order, ticks=10), lambda: other.advance(ticks=10))
        heard = {message.sender: message for message in mine.vehicles[A].heard}
        assert heard[B].payload.tolist() == [-6.0, 0.0, 0.0]
        assert (heard[B].sent, heard[B].received) == (1.0, 1.02)
        assert theirs.vehicles[B].heard[0].payload.tolist() == [5.0, 0.0, 0.5]
        assert one.sensed().vehicles[A].heard[0].payload.tolist() == [-6.0, 0.0, 0.0]
        with Wire(found.port) as wire:
            assert "SAY: 'vehicles_1' is flown by client" in wire.refused(saying((B, [1.0])))
            assert "SAY: no vehicle is called 'vehicles_2'" in wire.refused(saying(("vehicles_2", [1.0])))
        with pytest.raises(Refused, match="4 numbers are more than a message has, 3"):
            one.say({A: [0.0] * 4})
        with pytest.raises(Refused, match="'vehicles_1' is flown by client"):
            one.say({A: [1.0], B: [1.0]})
        one.disconnect()
        other.disconnect()
    (episode,) = folder.glob("*/episode-0001")
    run = qrsim.open_run(episode)
    assert run["orders"]["said_tick"][-1].tolist() == [50, 50]
    assert run["orders"]["said_0"][-1].tolist() == [5.0, -6.0]
    assert main(["replay", str(episode), "--out", str(tmp_path / "again")]) == 0
    again = qrsim.open_run(tmp_path / "again")
    np.testing.assert_array_equal(again["measurements"]["radio.heard"], run["measurements"]["radio.heard"])
    assert run["measurements"]["radio.heard"][-1].tolist() == [6, 6]


@pytest.mark.long
def test_agents_talk_over_the_wire() -> None:
    text = "extends: cats_and_mouse/1A\nname: talk\nduration: 4.0\nworld: {radio: {preset: sphere, size: 2}}\n"
    with running(seed=SEED) as found, Client(port=found.port) as client:
        episode = client.play(scenario=text, seed=3)
        assert (episode.say_size, episode.agents) == (2, ("cat_0", "cat_1", "cat_2"))
        assert isinstance(episode.observation, dict)
        assert episode.observation["see"].shape == (3, 10)
        seen = client.act(np.zeros((3, 2)), say=[[1.0, 2.0], [], [5.0, 6.0]]).observation
        assert isinstance(seen, dict)
        heard = {int(who): row for who, row in zip(seen["sender"][1], seen["heard"][1], strict=True) if who >= 0}
        assert heard[0].tolist() == [1.0, 2.0]
        assert heard[2].tolist() == [5.0, 6.0]
        with pytest.raises(Refused, match="say of 'cat_0': 3 numbers; expected 2"):
            client.act(np.zeros((3, 2)), say=[[1.0, 2.0, 3.0], [], []])
        with pytest.raises(Refused, match="this session plays a task"):
            client.say({"cat_0": [1.0]})
