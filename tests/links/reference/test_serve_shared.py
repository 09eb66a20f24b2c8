"""One world for several clients: at a barrier, and by the wall clock."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from functools import partial

import numpy as np
import pytest
from shared_worlds import SEED, A, B, alone, goal, sharing, together
from wires import Wire, running

import qrsim
from qrsim.cli import main
from qrsim.errors import RunError, UsageError
from qrsim.links.contracts import Silence
from qrsim.links.reference.claiming import KINDS
from qrsim.links.reference.client import Client, Refused
from qrsim.links.reference.describing import description
from qrsim.links.reference.kinds import TYPES
from qrsim.links.reference.protocol import qrsim_pb2 as pb
from qrsim.links.reference.protocol.qrsim_pb2 import Message
from qrsim.links.reference.roles import Options
from qrsim.links.reference.server import Server
from qrsim.links.reference.shared_session import SharedSession
from qrsim.links.reference.sharing import Subscription
from qrsim.links.reference.tasks import Tasks
from qrsim.links.shared.replay import replay
from qrsim.runs import RunInfo, RunWriter, open_run
from qrsim.runs.compare import compare_runs
from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from small_worlds import bare_pair, pair

# ---- the barrier ----


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_clients_with_one_vehicle_each_fly_as_one_owner_whoever_comes_first(barrier, order):
    """Each step is 5 ticks, and is that of a simulation in this process in which all fly waypoints, to the bit."""
    _, connect = barrier
    clients = [connect(), connect()]
    clients[0].restart(SEED)
    here = Simulation(pair().world(), seed=SEED)
    here.reset()
    for client, name in zip(clients, (A, B), strict=True):
        client.claim(name)
    for k in range(8):
        orders = [{name: ("waypoint", goal(v, k))} for v, name in enumerate((A, B))]
        sensed = together(*(partial(clients[v].advance, orders[v], ticks=5, truth=True) for v in order))
        goals = np.array([goal(0, k), goal(1, k)])
        here.step(qrsim.WaypointSetpoint.of(goals[:, :3], goals[:, 3]), ticks=5)
        for v, found in zip(order, sensed, strict=True):
            assert (found.tick, list(found.vehicles)) == (5 * (k + 1), [(A, B)[v]])
            assert found.vehicles[(A, B)[v]].state.tobytes() == here.truth.state[v].tobytes()
            gnss = found.vehicles[(A, B)[v]].sensors["gnss"]
            np.testing.assert_array_equal(gnss["position_ned"], here.reading.gnss.position_ned[v])
            # Every 10 ticks of 0.02 s, delayed by one period.
            assert gnss["fresh"] == bool(here.reading.gnss.fresh[v])
            assert gnss["time"] == here.reading.gnss.time_of_reading[v]
    for client in clients:
        client.close()


def test_the_world_goes_to_the_least_of_the_ticks_and_tells_who_is_there(barrier):
    _, connect = barrier
    one, other = connect(), connect()
    with alone(one):
        one.claim(A)
        other.claim(B)

        def twice() -> list[int]:
            return [other.advance(ticks=ticks).tick for ticks in (1, 3)]

        far, near = together(lambda: one.advance(until_tick=4), twice)
        assert (far.tick, near) == (4, [1, 4])
    one.close()
    other.close()


def test_who_dies_is_not_waited_for_and_changes_nobody(barrier):
    _, connect = barrier
    found = []
    for dies in (True, False):
        one, other = connect(), connect()
        one.restart(SEED)
        one.claim(A)
        other.claim(B, on_silence="return")
        for k in range(4):
            together(
                partial(one.advance, {A: ("waypoint", goal(0, k))}, ticks=3),
                partial(other.advance, {B: ("velocity", [1.0, 0.0, 0.0, 0.0])}, ticks=3),
            )
        if dies:
            other.close()
            last = one.advance(ticks=12, truth=True)
            status = one.status().vehicles[B]
            assert (status.client, status.flies) == (0, "return")
        else:
            last = together(partial(one.advance, ticks=12, truth=True), partial(other.advance, ticks=12))[0]
        assert last.tick == 24
        found.append(last.vehicles[A].state.tobytes())
        one.close()
        other.close()
    assert found[0] == found[1]


def test_with_a_timeout_the_world_goes_on_and_counts_who_was_missed():
    with sharing(pace="barrier", barrier_timeout=0.05) as (_, connect):
        one, other = connect(), connect()
        one.claim(A)
        other.claim(B)
        for k in range(3):
            assert one.advance({A: ("waypoint", goal(0, k))}).tick == k + 1
        status = one.status()
        assert (status.vehicles[A].misses, status.vehicles[B].misses) == (0, 3)
        # Who comes late to a tick is told where the world is.
        assert other.advance(until_tick=2).tick == 3


# ---- the wall clock ----


def test_a_free_world_begins_with_the_first_claim_and_does_not_wait(free):
    server, connect = free
    one, other = connect(), connect()
    assert one.status().tick == 0
    claim = one.claim(A)
    assert (claim.pace, claim.factor, claim.time_step, claim.vehicles) == ("free", 1.0, 0.02, (A,))
    one.subscribe(rate=25.0, truth=True)
    other.subscribe(A, B)
    first = one.sensed(10.0)
    tick = one.command({A: ("waypoint", goal(0, 1))}, computed_from=first.tick)
    # It is flown from the tick after the one at which it arrives, and not computed from readings that are to come.
    assert tick >= first.tick + 1
    with pytest.raises(Refused, match=r"computed_from 999999: the world is at tick \d+"):
        one.command({A: ("waypoint", goal(0, 1))}, computed_from=999999)
    ticks = [one.sensed(10.0, newest=False).tick for _ in range(5)]
    assert np.diff(ticks).tolist() == [2] * 4
    status = one.status().vehicles[A]
    assert (status.client, status.flies, status.source_tick) == (claim.client, "command", first.tick)
    assert status.arrival_tick == tick - 1
    assert set(other.sensed(10.0).vehicles) == {A, B}
    # A controller that sleeps: nothing stands still, and after 0.5 s its vehicle holds.
    deadline = time.monotonic() + 20.0
    while one.status().vehicles[A].flies != "hold" and time.monotonic() < deadline:
        time.sleep(0.05)
    silent = one.status().vehicles[A]
    assert silent.silent_since == pytest.approx(0.02 * status.arrival_tick)
    assert silent.age >= 0.5
    assert any("it holds its place" in line for line in server.lines)
    assert [event["kind"] for event in one.events() if event["vehicle"] == A] == ["controller_silent"]
    with pytest.raises(Refused, match=r"RESTART: client \d+ flies 'vehicles_0' in this world"):
        other.restart()
    one.disconnect()
    assert other.status().vehicles[A].flies == "guidance"
    # Nobody else flies here now.
    assert other.restart(9).seed == 9
    other.pace(3.0)
    assert other.status().pacing["factor"] == 3.0
    with pytest.raises(Refused, match="real-time factor 0: a world that runs by itself needs one above 0"):
        other.pace(0.0)
    other.pace(1.0)


def test_a_free_run_is_flown_again_to_the_bit(tmp_path, capsys):
    with sharing(pace="free", realtime=20.0, record=tmp_path) as (_, connect):
        one, other = connect(), connect()
        one.claim(A)
        other.claim(B)
        one.subscribe()
        for k in range(20):
            seen = one.sensed(10.0)
            one.command({A: ("velocity_height", [0.5, 0.1 * k, -10.0, 0.0])}, computed_from=seen.tick)
            if k < 5:
                other.command({B: ("control", [0.0, 0.02 * k, 0.59, 0.0, 12.0])})
            elif k == 5:
                other.close()
        one.close()
        time.sleep(0.05)
    (folder,) = tmp_path.iterdir()
    recorded = open_run(folder)
    kinds, flies = recorded["orders"]["kind"], recorded["orders"]["flies"]
    assert set(kinds[:, 0]) >= {0, 1, 3}, "guidance, velocity_height, and at last the waypoint at which it holds"
    assert flies[-1].tolist() == [2, 2]
    assert {event.kind for event in recorded.events} >= {"controller_silent"}
    assert main(["replay", str(folder), "--out", str(tmp_path / "again")]) == 0
    ticks = recorded.info.ticks
    assert f"{ticks} ticks of 2 vehicles: the same to the bit" in capsys.readouterr().out
    again = open_run(tmp_path / "again")
    streams = ["truth", "measurements", "commands", "wind", "orders"]
    found = compare_runs(recorded, again, 0.0, streams)
    assert found.bit_identical
    assert again.info.ticks == ticks > 20
    # Another seed is another flight.
    file = recorded.folder / "run.json"
    file.write_text(file.read_text("utf-8").replace(f'"seed": {SEED}', '"seed": 6'), "utf-8")
    assert main(["replay", str(folder)]) == 1
    assert "truth" in capsys.readouterr().out
    with pytest.raises(UsageError, match="exists already"):
        replay(recorded, tmp_path / "again")


@pytest.mark.long
def test_what_is_injected_in_a_shared_world_is_replayed(tmp_path, capsys):
    content = pair(wind={"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 0.0}).spec.model_dump(mode="json")
    content["fleets"]["vehicles"]["injectable"] = {"sensors": ["gnss"]}
    tasks = Tasks(load_scenario(content, quiet=True))
    with running(tasks, seed=SEED, pace="barrier", record=tmp_path) as server, Client(port=server.port) as client:
        client.claim(A, B)
        simulation = server.server.sharing.session.simulation
        for k in range(6):
            client.advance({name: ("waypoint", goal(v, k)) for v, name in enumerate((A, B))}, ticks=7)
            # The world waits for the client.
            if k == 1:
                simulation.inject("gnss", "stuck", A, asked_by="tcp:1")
            if k == 2:
                simulation.set_wind(8.0, 90.0, asked_by="page")
            if k == 3:
                simulation.clear("gnss", asked_by="tcp:1")
    (folder,) = tmp_path.iterdir()
    recorded = open_run(folder)
    assert [(one["target"], one["kind"], one["tick"], one["asked_by"]) for one in recorded.injections] == [
        ("gnss", "stuck", 14, "tcp:1"),
        ("world", "wind", 21, "page"),
        ("gnss", "ok", 28, "tcp:1"),
    ]
    kinds = [event.kind for event in recorded.events if event.kind in ("injected", "wind_changed", "cleared")]
    assert kinds == ["injected", "wind_changed", "wind_changed", "cleared"]
    fix = recorded["measurements"]["gnss.position_ned.x"][:, 0]
    assert len(set(fix[15:29].tolist())) == 1
    assert main(["replay", str(folder), "--out", str(tmp_path / "again")]) == 0
    assert "42 ticks of 2 vehicles: the same to the bit" in capsys.readouterr().out
    assert open_run(tmp_path / "again").injections == recorded.injections
    # Without the file it is another flight, and another wind another too.
    file = recorded.folder / "injections.yaml"
    lines = file.read_text("utf-8").splitlines(keepends=True)
    for text in ("[]", "".join(lines[:2])):
        file.write_text(text, "utf-8")
        assert main(["replay", str(folder)]) == 1
    file.write_text("- {target: gnsss, kind: off, at: 1}", "utf-8")
    assert main(["replay", str(folder)]) == 2
    assert "injections.yaml: entry 1: there is no target 'gnsss'; did you mean 'gnss'?" in capsys.readouterr().err


def test_a_run_without_orders_is_not_replayed(tmp_path):
    info = RunInfo.collect(scenario="pair", seed=0, precision="float32", time_step=0.02, vehicles=[A, B])
    RunWriter.create(tmp_path / "run", info=info, scenario_yaml=pair().to_yaml(), columns={}).close()
    with pytest.raises(UsageError, match="it has no orders"):
        replay(open_run(tmp_path / "run"), tmp_path / "again")


class Reader:
    """A client as a world sees it, whose system holds so many bytes back."""

    def __init__(self, number: int, backlog: int):
        self.number, self.backlog = number, backlog
        self.frames: list[bytes] = []

    def send_frame(self, content: bytes) -> None:
        self.frames.append(content)


def test_a_stalled_reader_misses_readings_and_the_others_get_all(free):
    """What is sent to each at a tick: nothing to who has more than 64 KiB waiting, whatever it has subscribed to."""
    server, _ = free
    sharing = server.server.sharing
    assert sharing is not None
    quick, stalled = Reader(900, 1 << 16), Reader(901, (1 << 16) + 1)
    done = threading.Event()

    def look() -> None:
        for reader in (quick, stalled):
            sharing.subscribe(reader, Subscription((0, 1), 1, truth=False))
        sharing._publish()
        stalled.backlog = 0
        for wanted in sharing._subscriptions.values():
            wanted.last = -1000000
        sharing._publish()
        for reader in (quick, stalled):
            sharing.subscribe(reader, None)
        done.set()

    server.loop.call_soon_threadsafe(look)
    assert done.wait(10.0)
    missed = [Message.FromString(frame[5:]).sensed.missed for frame in quick.frames]
    assert missed == [0, 0]
    assert [Message.FromString(frame[5:]).sensed.missed for frame in stalled.frames] == [1]


@pytest.mark.long
def test_a_client_that_never_reads_costs_the_others_nothing(free):
    _, connect = free
    with Wire(free[0].port) as wire:
        wire.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        assert not wire.ask(
            Message(type=Message.SUBSCRIBE, subscribe=pb.Subscribe(vehicle=[A, B], truth=True))
        ).ack.error
        one = connect()
        one.restart(3)
        one.claim(A)
        one.pace(200.0)
        one.subscribe()
        deadline = time.monotonic() + 60.0
        missed = 0
        while not missed and time.monotonic() < deadline:
            seen = one.sensed(10.0)
            one.command({A: ("velocity", [0.0, 0.0, 0.0, 0.0])}, computed_from=seen.tick)
            missed = max(each.missed for each in free[0].server.sharing._subscriptions.values())
        assert missed > 0
        # The world and the other client go on.
        before = one.sensed(10.0).tick
        assert one.sensed(10.0).tick > before
        one.pace(1.0)
        one.close()


# ---- what is there ----


def test_the_world_is_described(barrier):
    _, connect = barrier
    one = connect()
    found = one.describe()
    assert (found["scenario"], found["time_step"], found["obstacles"]) == ("pair", 0.02, [])
    # The default site, at height 0.
    assert found["origin"] == pytest.approx([51.7119, -0.21052, 0.0])
    assert found["collision_distance"] == 2.0
    assert (found["area"]["type"], found["area"]["x_min"], found["area"]["units"]["x_min"]) == ("box", -40.0, "m")
    fleet = found["fleets"]["vehicles"]
    assert (fleet["vehicles"], fleet["model"]["type"], fleet["controller"]) == ([A, B], "pelican", "offboard")
    assert fleet["start"][1] == [0.0, 9.0, -12.0]
    assert fleet["radius"] == 1.0
    assert fleet["sensors"]["gnss"]["period"] == pytest.approx(0.2)
    assert fleet["limits"]["velocity"] == 15.0
    throttle = fleet["commands"]["control"][2]
    assert throttle == {"name": "throttle", "unit": "1", "low": 0.0, "high": 1.0}
    assert "velocity_height" in fleet["commands"]
    one.close()


@pytest.mark.long
def test_buildings_and_other_obstacles_are_described():
    corners, courtyard = [[20, 20], [30, 20], [30, 35], [20, 35]], [[24, 22], [26, 22], [26, 24]]
    solids = [
        {"type": "prism", "corners_ned": corners, "holes_ned": [courtyard], "z_min": -12.0},
        {"type": "cylinder", "x": -30, "y": 1, "radius": 2.0, "z_min": -15},
    ]
    scenario = bare_pair(obstacles=solids, wind={"type": "log_shear", "speed_20ft": 3.0, "wind_from_deg": 90.0})
    simulation = Simulation(scenario.world())
    simulation.reset()
    found = description(scenario, simulation)
    building, mast = ({each.name: list(each.value) for each in solid.quantity} for solid in found.obstacle)
    assert [solid.type for solid in found.obstacle] == ["prism", "cylinder"]
    assert building["corners_ned"] == [20.0, 20.0, 30.0, 20.0, 30.0, 35.0, 20.0, 35.0]
    assert building["holes_ned.0"] == [24.0, 22.0, 26.0, 22.0, 26.0, 24.0]
    assert (building["z_min"], mast["radius"]) == ([-12.0], [2.0])
    assert found.wind.type == "log_shear"
    assert {each.name: each.unit for each in found.wind.quantity}["speed_20ft"] == "m/s"


def test_the_client_has_every_kind_of_order():
    assert KINDS == TYPES


def test_nobody_gets_in_before_there_is_a_world(monkeypatch):
    begin, refused = SharedSession.begin, []

    def late(session: SharedSession) -> None:
        for host_port in sockets:
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(host_port, 5.0)
            refused.append(host_port)
        begin(session)

    with socket.create_server(("127.0.0.1", 0)) as free_one:
        sockets = [free_one.getsockname()[:2]]
    monkeypatch.setattr(SharedSession, "begin", late)
    # As the port that the helper asks for.
    monkeypatch.setattr("wires.Options", lambda port, **others: Options(port=sockets[0][1], **others))
    with sharing(pace="barrier") as (_, connect):
        assert refused == sockets
        assert connect().claim(A).vehicles == (A,)


def test_a_port_that_is_taken_while_the_world_is_made_is_named(monkeypatch):
    """Bound to it are both, and who listens first has it."""
    begin = SharedSession.begin
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
    taken: list[socket.socket] = []

    def meanwhile(session: SharedSession) -> None:
        taken.append(socket.create_server(("127.0.0.1", port)))
        begin(session)

    monkeypatch.setattr(SharedSession, "begin", meanwhile)
    server = Server(Options(port=port, pace="barrier"), Tasks(pair()))
    with pytest.raises(RunError, match=f"127.0.0.1:{port}: the port is in use"):
        asyncio.run(server.serve())
    taken[0].close()


def test_silence_of_the_operator_is_that_of_claims():
    with sharing(pace="barrier", silence=Silence("stop", 3.0)) as (_, connect):
        claim = connect().claim(A)
        assert (claim.on_silence, claim.hold) == ("stop", 3.0)
