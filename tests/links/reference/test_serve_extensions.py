"""What goes beyond the reference protocol: watching, sessions, seeds, scenarios, readings, events, pace, recording."""

from __future__ import annotations

import contextlib
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from wires import HERE, TASK, Running, running

import qrsim
from qrsim.errors import ScenarioError, UsageError
from qrsim.links.pacing import LONGEST_DELAY_S, Pacer
from qrsim.links.reference import server as server_module
from qrsim.links.reference.client import Client, ConnectionFailed, InvalidState, Refused
from qrsim.links.reference.seeds import Seeds
from qrsim.links.reference.session import MOST_EVENTS, Session, SessionOptions
from qrsim.links.reference.tasks import MOST_VEHICLES, offboard, uploaded
from qrsim.runs import open_run
from qrsim.scenarios.scenario import load_scenario

HOLD = [*HERE, 0.0]
OWN = f"""
extends: {TASK}
name: of_my_own
fleets:
  pelicans:
    vehicles:
      - {{name: scout, position_ned: [1.0, 2.0, -9.0]}}
"""


@pytest.fixture
def clients(serving: Running):
    """Return a function that makes clients of the shared server."""
    with contextlib.ExitStack() as stack:
        yield lambda: stack.enter_context(Client(port=serving.port))


def test_the_server_says_what_it_is(clients):
    found = clients().hello()
    assert found["version"] == qrsim.__version__
    assert {"seed", "scenario", "readings", "watch"} <= set(found["capabilities"])
    assert {"keep_spot", "TaskKeepSpot"} <= set(found["tasks"])
    assert found["sessions"] == []


def test_a_seed_is_an_episode(clients):
    client = clients()
    ends = {}
    for seed in (3, 4):
        session = client.open(TASK, seed=seed)
        assert (session.seed, session.vehicles, session.time_step) == (seed, ("pelicans_0",), 0.02)
        ends[seed] = client.step_waypoint(1.0, [HOLD]).state
    assert (ends[3] != ends[4]).any(), "there is process noise"
    assert client.restart(3).state.time == 0.0
    np.testing.assert_array_equal(client.step_waypoint(1.0, [HOLD]).state, ends[3])
    client.reset()
    np.testing.assert_array_equal(client.step_waypoint(1.0, [HOLD]).state, ends[4], "the one after 3")


def test_a_refused_open_leaves_the_connection_as_it_was(clients):
    client = clients()
    client.open(TASK)
    client.step_waypoint(0.02, [HOLD])
    for wrong in ({"task": "nowhere"}, {"scenario": "name: [x"}, {"task": TASK, "realtime": -1.0}):
        with pytest.raises(Refused):
            client.open(**wrong)
    assert client.step_waypoint(0.02, [HOLD]).time == pytest.approx(0.04)


def test_a_client_flies_a_scenario_of_its_own(clients):
    client = clients()
    session = client.open(scenario=OWN)
    assert (session.scenario, session.vehicles) == ("of_my_own", ("scout",))
    np.testing.assert_array_equal(session.state.state[0, :3], [1.0, 2.0, -9.0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("fleets: {}", "fleets: "),
        ("- 1", "expected keys and values"),
        ("extends: /etc/passwd", "extends: expected the name of a built-in scenario"),
        ("extends: ./other.yaml", "extends: expected the name of a built-in scenario"),
        ("extends: hover_ideal\nworld: {sky: {orbits: {type: sp3, file: /etc/passwd}}}", "world.sky.orbits.file: "),
        ("extends: hover_ideal\nworld: {area: {type: fence, file: x.kml}}", "can name no files"),
        ("extends: plume_mapping/3A\ntask: {locations: 1001}", "task.locations: 1001; allowed in a scenario that a"),
        ("extends: search_and_rescue/2A\nfleets: {a: {sensors: {camera: {most_rows: 1000000000}}}}", "most_rows: 1000"),
        ("a: &a [1, 1]\nb: [*a, *a]", "line 2: '*' is not allowed"),
        ("[" * 100_000, "nested too deeply"),
        ("- " * 50_000, "nested deeper than 64 levels"),
        ("#" * 300_000, "300000 bytes; allowed: up to 262144"),
        ("fleets: {a: {vehicles: [" + "{}," * (MOST_VEHICLES + 1) + "]}}", f"{MOST_VEHICLES + 1} vehicles; allowed"),
        ("fleets: {" + ",".join(f"f{i}: {{}}" for i in range(9)) + "}", "fleets: 9; allowed: up to 8"),
    ],
)
def test_a_scenario_that_is_sent_can_do_no_harm(text, said):
    with pytest.raises(UsageError) as caught:
        uploaded(text)
    assert said in str(caught.value)


def test_faults_of_a_scenario_that_is_sent_are_all_told(clients):
    with pytest.raises(Refused) as caught:
        clients().open(scenario="extends: hover_ideal\nworld: {wind: {type: clam}}\nduration: -1")
    assert "world.wind" in str(caught.value)
    assert "duration" in str(caught.value)


def test_readings_have_names_values_and_reasons(clients):
    client = clients()
    client.hello()
    client.open(TASK, events=True)
    state = client.step_waypoint(0.2, [HOLD])
    assert state.reasons == ("",)
    found = client.readings()["pelicans_0"]
    np.testing.assert_array_equal(found["gnss"]["position_ned"], state.measured[0, 0:3])
    assert found["barometer"]["height"] == state.measured[0, 16]
    assert all(sensor["reason"] == "" for sensor in found.values())
    state = client.step_velocity(8.0, [[0.0, 0.0, -3.0]])
    assert len(state.reasons) == 1
    [event] = [event for event in client.events() if event["kind"] != "waypoint_reached"]
    assert (event["vehicle"], event["kind"]) == ("pelicans_0", "out_of_area")
    assert 0.2 < event["time"] < 8.2, "when it happened, not when the STEP ended"
    assert client.events() == []
    assert state.reasons[0] in client.readings()["pelicans_0"]["gnss"]["reason"]


def test_events_must_be_asked_for(clients):
    client = clients()
    client.init(TASK)
    with pytest.raises(Refused, match="collects no events"):
        client.events()


def test_events_that_nobody_reads_are_counted(monkeypatch):
    monkeypatch.setattr("qrsim.links.reference.session.MOST_EVENTS", 2)
    assert MOST_EVENTS > 1000
    session = Session(1, SessionOptions(load_scenario(TASK), Seeds(0), events=True))
    session._events.extend({"time": float(i), "kind": "k", "vehicle": "pelicans_0"} for i in range(5))
    session.begin()
    found = session.events()
    assert ([event.t for event in found.event], found.lost) == ([3.0, 4.0], 3)
    session.end()


def test_watchers_see_what_the_client_sees(clients):
    owner, watcher, seldom = clients(), clients(), clients()
    owner.init(TASK)
    every, tenth = watcher.watch(timeout=20.0), seldom.watch(period=0.2, timeout=20.0)
    seen: dict[str, list] = {"every": [], "tenth": []}

    def look(name, states, count):
        seen[name] += [next(states) for _ in range(count)]

    threads = [
        threading.Thread(target=look, args=arguments) for arguments in (("every", every, 30), ("tenth", tenth, 3))
    ]
    for thread in threads:
        thread.start()
    own = [owner.step_waypoint(0.02, [[*HERE[:2], -10.0, 0.0]]) for _ in range(30)]
    for thread in threads:
        thread.join(20.0)
    for mine, theirs in zip(own, seen["every"], strict=True):
        assert mine.time == theirs.time
        np.testing.assert_array_equal(mine.state, theirs.state)
        np.testing.assert_array_equal(mine.measured, theirs.measured)
    np.testing.assert_allclose(np.diff([state.time for state in seen["tenth"]]), 0.2)


def test_a_watcher_changes_nothing(clients):
    owner, watcher = clients(), clients()
    owner.init(TASK)
    states = watcher.watch(timeout=20.0)
    owner.step_waypoint(0.02, [HOLD])
    assert next(states).time == pytest.approx(0.02)
    with pytest.raises(Refused, match="no session on this connection"):
        watcher.step_waypoint(0.02, [HOLD])
    with pytest.raises(Refused, match="a session of its own"):
        owner.watch()


def test_a_watcher_that_does_not_read_misses_states_and_slows_nobody(serving, clients, monkeypatch):
    monkeypatch.setattr(server_module, "MOST_WAITING", 2000)
    owner, watcher = clients(), clients()
    owner.open(TASK)
    assert watcher._socket is not None
    watcher._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    for connection in serving.server._connections:
        connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    watcher.watch()
    count = 0
    while not (watching := list(serving.server._watching.values())) or not watching[0].missed:
        owner.step_waypoint(0.02, [HOLD])
        count += 1
        assert count < 5000
    assert max(connection.backlog for connection in serving.server._connections) < 10_000


def test_sessions_are_isolated_and_can_be_watched():
    """Two clients, each with a world: one's long step and reset are nothing to the other."""
    with running(sessions=True) as served, Client(port=served.port) as one, Client(port=served.port) as two:
        assert [client.open(TASK, seed=5).number for client in (one, two)] == [1, 2]
        one.step_velocity(0.02, [[0.0, 0.0, 0.0]])
        slow = threading.Thread(target=lambda: [one.step_waypoint(4000.0, [HOLD]) for _ in range(10)])
        slow.start()
        alone = [two.step_waypoint(0.02, [HOLD]) for _ in range(20)]
        assert slow.is_alive(), "the other session is in its long step meanwhile"
        with Client(port=served.port) as third:
            assert third.hello()["sessions"] == [1, 2]
            with pytest.raises(Refused, match="2 sessions run; name one"):
                third.watch()
            with pytest.raises(Refused, match="there is no session 9; running: 1, 2"):
                third.watch(9)
        slow.join(60.0)
        two.restart(5)
        again = [two.step_waypoint(0.02, [HOLD]) for _ in range(20)]
        np.testing.assert_array_equal([state.state for state in again], [state.state for state in alone])


def test_a_recorded_session_is_a_run_folder_for_each_episode(tmp_path: Path):
    with running(record=tmp_path, seed=6) as served, Client(port=served.port) as client:
        client.init(TASK)
        states = [client.step_waypoint(dt, [[6.0, -8.0, -10.0, 0.0]]) for dt in (0.02, 1.0, 0.5)]
        client.reset()
        client.step_velocity(0.1, [[0.0, 0.0, 0.0]])
        client.disconnect()
    [folder] = tmp_path.iterdir()
    first, second = open_run(folder).episodes
    assert [episode.folder.name for episode in (first, second)] == ["episode-0001", "episode-0002"]
    assert (second.info.seed, second.info.state) == (7, "finished")
    assert (first.info.state, first.info.seed, first.info.scenario) == ("finished", 6, TASK)
    np.testing.assert_array_equal(first["truth"].tick, np.arange(77))
    assert len(second["truth"].tick) == 6
    for state in states:
        row = round(state.time / 0.02)
        found = [first["truth"][f"position_ned.{axis}"][row, 0] for axis in "xyz"]
        np.testing.assert_array_equal(state.state[0, :3], found)
    assert load_scenario(str(first.folder / "scenario.yaml")).spec == offboard(load_scenario(TASK)).spec


# ---- pace ----


class Clock:
    """A clock that a test sets."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_replies_wait_for_the_wall_clock_without_drift():
    clock = Clock()
    pacer = Pacer(2.0, 0.0, clock)
    for i in range(1, 501):
        clock.now += 0.003  # the step takes this long
        wait = pacer.wait_s(0.02 * i)
        assert wait == pytest.approx(100.0 + 0.01 * i - clock.now, abs=1e-9)
        clock.now += wait + 0.0005  # and the timer is late by this
    assert clock.now == pytest.approx(100.0 + 5.0 + 0.0005)
    report = pacer.report()
    assert (report.steps, report.overruns, report.worst_delay) == (500, 0, 0.0)
    assert report.simulated == pytest.approx(10.0)


def test_late_steps_are_counted_and_caught_up():
    clock = Clock()
    pacer = Pacer(1.0, 0.0, clock)
    clock.now += 0.05
    assert pacer.wait_s(0.02) == 0.0
    assert pacer.wait_s(0.04) == 0.0
    assert pacer.wait_s(0.06) == pytest.approx(0.01)
    report = pacer.report()
    assert report.overruns == 2
    assert report.worst_delay == pytest.approx(0.03)


def test_after_a_pause_of_the_client_the_clock_starts_anew():
    clock = Clock()
    pacer = Pacer(1.0, 0.0, clock)
    clock.now += 10.0 + LONGEST_DELAY_S
    assert pacer.wait_s(0.02) == 0.0
    assert pacer.wait_s(0.04) == pytest.approx(0.02)
    pacer.restarted()
    assert pacer.wait_s(0.02) == pytest.approx(0.02)
    assert pacer.report().simulated == pytest.approx(0.06)


@pytest.mark.parametrize("factor", [float("nan"), -1.0, 1e9, 1e-9, float("inf")])
def test_a_pace_that_makes_no_sense_is_refused(factor):
    with pytest.raises(UsageError, match=re.escape("allowed: 0.001 to 1000, or 0")):
        Pacer(factor, 0.0)


def test_in_real_time_a_reply_is_not_early(clients):
    """The clock of the server is anchored before the first step, so no sum of steps can be faster than it."""
    client = clients()
    client.open(TASK, realtime=2.0)
    begun = time.perf_counter()
    for _ in range(10):
        client.step_waypoint(0.1, [HOLD])
    assert time.perf_counter() - begun > 0.5 - 0.1
    report = client.pace(0.0)
    assert (report["factor"], report["steps"]) == (2.0, 10)
    assert client.pace()["factor"] == 0.0


# ---- the client ----


def test_the_client_says_what_is_wrong(clients):
    client = clients()
    client.init(TASK)
    with pytest.raises(UsageError, match=r"command: expected numbers of shape \(vehicles, 4\), found \(1, 3\)"):
        client.step_waypoint(0.02, [HERE])
    with pytest.raises(UsageError, match="state: expected numbers"):
        client.set_state("here")
    with pytest.raises(UsageError, match="seed: -1"):
        client.restart(-1)
    with pytest.raises(InvalidState, match="invalid uav state"):
        client.step_velocity(8.0, [[0.0, 0.0, -3.0]])
    client.set_state([HERE])
    assert client.step_waypoint(0.02, [HOLD]).time == pytest.approx(8.02)
    client.disconnect()
    with pytest.raises(ConnectionFailed, match="this client is closed"):
        client.reset()


def test_a_server_that_is_not_there_or_no_server():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(ConnectionFailed, match=re.escape("no answer within 0.1 s")):
            Client(port=port, timeout=0.1).hello()
        client = Client(port=port, timeout=5.0)
        silent.accept()[0].close()  # the first client's
        peer, _ = silent.accept()
        peer.sendall(b"HTTP/1.1 400 Bad Request\r\n")
        with pytest.raises(ConnectionFailed, match="this is no qrsim server: framing"):
            client.hello()
        peer.close()
    with pytest.raises(ConnectionFailed, match="nobody listens there"):
        Client(port=port)


def test_the_client_needs_nothing_that_computes():
    """It starts where JAX is not installed."""
    code = (
        "import sys, qrsim.links.reference.client;"
        " print([name for name in ('jax', 'scipy', 'pydantic') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_the_scenario_error_of_a_server_keeps_its_lines():
    with pytest.raises(ScenarioError) as caught:
        uploaded("extends: hover_ideal\nname: x\nduration: -1\ntime_step: 9")
    assert len(caught.value.problems) == 2
