"""Faults and winds that clients ask for: with an owner, and in a world that they share."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shared_worlds import SEED, A, B, together
from wires import Running, Wire, running

from qrsim.cli import main
from qrsim.errors import UsageError
from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.injecting import request_of
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.tasks import Tasks
from qrsim.runs import open_run
from qrsim.scenarios.live_requests import Request
from small_worlds import pair

WIND = {"type": "log_shear", "speed_20ft": 0.0, "wind_from_deg": 0.0}
HOLD = [[3.0, 0.0, -10.0, 0.0], [3.0, 9.0, -12.0, 0.0]]


@contextlib.contextmanager
def served(**options: Any) -> Iterator[tuple[Running, Client, Client]]:
    with (
        running(Tasks(pair(wind=WIND), None, ["gnss", "body"]), seed=SEED, **options) as found,
        Client(port=found.port) as one,
        Client(port=found.port) as other,
    ):
        yield found, one, other


def test_a_message_is_a_request() -> None:
    asked = pb.Inject(target="gnss", kind="drift", vehicle=[A], field="position_ned", at=2.0, duration=3.0)
    asked.number.add(name="rate", value=0.5)
    numbers = {"field": "position_ned", "rate": 0.5}
    assert request_of(asked) == Request("gnss", "drift", (A,), 2.0, 3.0, numbers)
    assert request_of(pb.Inject(target="gnss", kind="off")) == Request("gnss", "off")
    asked.number.add(name="rate", value=0.6)
    with pytest.raises(UsageError, match="INJECT: rate is given twice"):
        request_of(asked)


def test_only_sensors_that_a_scenario_has_are_injectable() -> None:
    with pytest.raises(UsageError, match="--injectable gnsss: there is no such sensor; did you mean 'gnss'"):
        Tasks(pair(), None, ["gnsss"])
    # Other tasks than the operator's may fail as far as they have the sensor.
    tasks = Tasks(pair(), None, ["gnss", "all"])
    spec = tasks.offboard("keep_spot").spec.fleets
    assert all(fleet.injectable is not None for fleet in spec.values())
    assert Tasks(pair()).offboard("").spec.fleets["vehicles"].injectable is None


@pytest.mark.long
def test_an_owner_lets_a_receiver_fail_and_the_wind_blow() -> None:
    with served() as (found, client, other):
        with Wire(found.port) as wire:
            inject = Message(type=Message.INJECT, inject=pb.Inject(target="gnss", kind="off"))
            assert "INIT" in wire.refused(inject)
            assert wire.refused(Message(type=Message.INJECT)) == "INJECT: the message has no 'inject'"
        client.open("pair", seed=SEED)
        assert "inject" in client.hello()["capabilities"]
        client.step_waypoint(0.1, HOLD)
        assert client.inject("gnss", "off", A, duration=0.5) == f"Injected: gnss off of {A} for 0.5 s"
        client.inject("gnss", "wrong", [B], at=0.2, field="position_ned.z", bias=5.0)
        state = client.step_waypoint(0.3, HOLD)
        assert client.readings()[A]["gnss"]["reason"] != ""
        assert np.isnan(state.measured[0, :3]).all()
        assert state.measured[1, 2] - state.state[1, 2] == pytest.approx(5.0, abs=0.05)
        state = client.step_waypoint(0.4, HOLD)
        assert not np.isnan(state.measured[0, :3]).any()
        assert client.clear("gnss") == "Cleared: gnss"
        state = client.step_waypoint(0.1, HOLD)
        assert state.measured[1, 2] - state.state[1, 2] == pytest.approx(0.0, abs=0.05)
        # Up by 5 m/s^2 for 0.1 s; a vector is sent axis by axis.
        said = client.inject("body", "push", B, duration=0.1, acceleration_ned=[0.0, 0.0, -5.0])
        assert said == f"Injected: body push of {B} for 0.1 s"
        before = state
        state = client.step_waypoint(0.1, HOLD)
        # State 9 is the speed down in body axes.
        assert state.state[1, 8] - before.state[1, 8] == pytest.approx(-0.5, abs=0.15)
        assert client.set_wind(6.0, 270.0) == "Wind: 6 m/s at 20 ft from 270 degrees"
        for wrong, message in (
            (lambda: client.inject("gns", "off"), "target: there is no 'gns'; did you mean 'gnss'"),
            (lambda: client.inject("barometer", "off"), "give the command --injectable"),
            (lambda: client.inject("gnss", "off", "vehicles_7"), "vehicles: no vehicle is called 'vehicles_7'"),
            (lambda: client.inject("gnss", "drift", field="position_ned"), "rate: missing; kind 'drift' needs it"),
            (lambda: client.inject("gnss", "off", at=0.1), "at: 0.1 s is past; it is 1 s now"),
            (lambda: client.inject("body", "push", acceleration_nde=[1, 0, 0]), "did you mean 'acceleration_ned.x'"),
            (lambda: client.inject("gnss", "off", at=float("nan")), "at: nan; allowed: a time"),
            (lambda: client.inject("world", "wind", speed_20ft=6.0), "wind_from_deg: missing"),
        ):
            with pytest.raises(Refused, match=message):
                wrong()
        with pytest.raises(UsageError, match="rate: 'fast'; expected a number"):
            client.inject("gnss", "drift", rate="fast")
        with pytest.raises(UsageError, match=r"acceleration_ned: \[1, 2\]; expected a number"):
            client.inject("body", "push", acceleration_ned=[1, 2])
        with pytest.raises(Refused, match="INIT"):
            other.clear()


@pytest.mark.long
def test_clients_of_a_shared_world_let_their_own_vehicles_fail() -> None:
    with served(pace="barrier") as (_, one, other):
        with pytest.raises(Refused, match="INJECT: this client has claimed no vehicle; CLAIM first"):
            one.inject("gnss", "off")
        one.claim(A)
        other.claim(B)
        with pytest.raises(Refused, match=f"INJECT: '{B}' is flown by client"):
            one.inject("gnss", "off", [A, B])
        with pytest.raises(Refused, match="the wind is that of all clients; its operator has to allow it"):
            one.set_wind(3.0, 0.0)
        assert one.inject("gnss", "off") == f"Injected: gnss off of {A}"
        mine, theirs = together(lambda: one.advance(ticks=5), lambda: other.advance(ticks=5))
        assert mine.vehicles[A].sensors["gnss"]["reason"] != ""
        assert theirs.vehicles[B].sensors["gnss"]["reason"] == ""
        # What another client has caused is not one's own to end.
        assert other.clear() == f"Cleared: all of {B}"
        mine, _ = together(lambda: one.advance(ticks=5), lambda: other.advance(ticks=5))
        assert mine.vehicles[A].sensors["gnss"]["reason"] != ""
        one.clear()
        mine, _ = together(lambda: one.advance(ticks=5), lambda: other.advance(ticks=5))
        assert mine.vehicles[A].sensors["gnss"]["reason"] == ""


@pytest.mark.long
def test_what_clients_inject_is_recorded_and_replayed(tmp_path: Path) -> None:
    with served(pace="barrier", allow_inject=True, record=tmp_path / "served") as (_, one, other):
        one.claim()
        one.advance({A: ("waypoint", HOLD[0]), B: ("waypoint", HOLD[1])}, ticks=20)
        one.inject("gnss", "drift", A, field="position_ned", rate=0.5)
        one.inject("body", "push", B, duration=0.2, acceleration_ned=[3.0, 0.0, 0.0])
        one.set_wind(6.0, 270.0)
        one.advance(ticks=20)
        one.clear()
        one.advance(ticks=20)
        one.disconnect()
        other.disconnect()
    (episode,) = (tmp_path / "served").glob("*/episode-0001")
    run = open_run(episode)
    kinds = ("injected", "injected", "wind_changed", "wind_changed", "cleared")
    found = [(event.tick, event.kind) for event in run.events if event.kind in kinds]
    assert found == list(zip((20, 20, 20, 20, 40), kinds, strict=True))
    assert "asked_by: 'tcp:1'" in (episode / "injections.yaml").read_text("utf-8")
    assert main(["replay", str(episode), "--out", str(tmp_path / "again")]) == 0
    again = open_run(tmp_path / "again")
    for stream in ("truth", "measurements", "wind"):
        assert again.table(stream).equals(run.table(stream)), stream


@pytest.mark.long
def test_the_operator_allows_the_wind_of_a_shared_world() -> None:
    with served(pace="barrier", allow_inject=True) as (found, one, _):
        one.set_wind(4.0, 180.0)
        assert found.server.sharing is not None
        wind: Any = found.server.sharing.session.simulation.world.wind
        assert float(wind.speed_20ft) == 4.0
