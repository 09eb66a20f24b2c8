"""``qrsim serve``: options that are refused before anything is served, and what it says."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import pytest

from qrsim.apps.serve import Serve, _prepare
from qrsim.links.printing import Log
from qrsim.links.reference.client import Client
from qrsim.links.reference.server import Options
from qrsim.links.reference.tasks import Tasks
from qrsim.scenarios.scenario import load_scenario


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "70000"], "--port 70000: expected 0 to 65535"),
        (["--host", "0.0.0.0"], "--allow-remote"),
        (["--host", "192.0.2.1"], "other machines could connect"),
        (["--realtime", "0"], "--realtime 0: expected a positive number"),
        (["--realtime", "1e9"], "allowed: 0.001 to 1000"),
        (["--max-clients", "0"], "--max-clients 0"),
        (["--seed", "-1"], "--seed -1"),
        (["--idle-timeout", "-1"], "--idle-timeout -1: expected a number of seconds, or 0 for never"),
        (["--idle-timeout", "nan"], "--idle-timeout nan"),
        (["--episodes", "sam"], "--episodes sam: expected new or same; did you mean 'same'?"),
        (["TaskComplac"], "did you mean 'TaskComplacs'?"),
        (["keep_spott"], "did you mean 'keep_spot'?"),
        (["--set", "duration=3"], "there is no SCENARIO to change"),
        (["hover", "--pace", "fre"], "--pace fre: expected owner, barrier or free; did you mean 'free'?"),
        (["--pace", "free"], "--pace free: name the SCENARIO that the clients share"),
        (["hover", "--pace", "barrier", "--sessions"], "--pace barrier: its clients share one world"),
        (["hover", "--pace", "free", "--timeout", "1"], "--timeout: it is for --pace barrier"),
        (["hover", "--pace", "barrier", "--timeout", "-1"], "--timeout -1: expected a number of seconds"),
        (["hover", "--on-silence", "hodl"], "--on-silence 'hodl': expected hold or return or stop"),
        (["hover", "--hold", "-2"], "hold -2 s: expected a number of seconds, or 0 for never"),
    ],
)
def test_wrong_options_are_refused(words, said, refused):
    refused(["serve", *words], said)


def test_a_port_in_use_is_named(refused):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused(["serve", "--port", str(port)], f"127.0.0.1:{port}: the port is in use", code=1)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.9.9.9", "::1", "localhost"])
def test_this_machine_alone_needs_no_permission(host, capsys):
    Serve(host=host)._options()
    assert capsys.readouterr().err == ""


def test_other_machines_need_a_flag_and_are_warned_of(capsys):
    Serve(host="0.0.0.0", allow_remote=True)._options()
    assert "warning: every machine that can reach 0.0.0.0" in capsys.readouterr().err


def test_a_fleet_too_large_for_reference_clients_is_warned_of(monkeypatch, capsys):
    """Whoever has fewer than 10 000 bytes to spare is told how many vehicles fit."""
    monkeypatch.setattr("qrsim.links.reference.protocol.framing.LARGEST_FOR_REFERENCE_CLIENT", 250)
    _prepare(Tasks(load_scenario("free_flight")), Options())
    said = "the STATE of this fleet of 1 is 293 bytes; clients of the reference simulator take 250, that is 0 vehicles"
    assert said in capsys.readouterr().err


@pytest.mark.long
def test_the_operators_scenario_in_real_time_until_the_process_is_told_to_end():
    words = [sys.executable, "-m", "qrsim.cli", "serve", "free_flight", "--port", "0", "--realtime", "4"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        with Client(port=port) as client:
            assert client.init("").state.shape == (1, 13)
            assert client.step_velocity(0.1, [[0.0, 0.0, 0.0]]).time == pytest.approx(0.1)
            assert client.pace()["factor"] == 4.0
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) == 0
        assert process.stderr.read() == ""
        said = process.stdout.read().splitlines()
    assert said[0] == "session 1 begins: free_flight, 1 vehicle, seed 0"
    assert said[1].startswith("session 1 ended: 1 steps, 0.1 s, ")


def test_a_reader_of_the_log_that_stalls_holds_nobody_up():
    """More lines than a pipe holds, and nobody reads them."""
    read, write = os.pipe()
    log = Log(write)
    for _ in range(3000):
        log.say("x" * 100)
    os.close(read)
    log.close()
    os.close(write)
    assert not log._thread.is_alive(), "it ends with its reader"
