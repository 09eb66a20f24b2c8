"""A server: how fast it is, and under malformed input: one reply to each request, nobody disturbed, nothing leaked."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from typing import Any

from tests.wrong_input.requests import TASK, kind, mutated, valid

from evidence._processes import printed, resident_bytes
from qrsim.links.reference.client import Client
from qrsim.links.reference.protocol.framing import frame
from qrsim.links.reference.protocol.qrsim_pb2 import Message

DOC = "round trips, real time and streams of a server, and a server under malformed and truncated requests"
SEED = 20261120
FULL, SMALL = 100_000, 500
# Requests on one connection; every tenth connection sends bytes without frames and is cut off.
PER_CONNECTION = 50
# Bins of the benchmark's histogram that are within a millisecond.
NEAR_US = ((-1000, -500), (-500, -200), (-200, 200), (200, 500), (500, 1000))


def reply(connection: socket.socket) -> Message | None:
    """Receive a message; None where the server has closed the connection."""
    head = connection.recv(5, socket.MSG_WAITALL)
    if len(head) < 5:
        return None
    return Message.FromString(connection.recv(int.from_bytes(head[1:], "little"), socket.MSG_WAITALL))


def attack(port: int, chance: random.Random, requests: list[bytes], counted: dict[str, int]) -> None:
    """Use one connection up."""
    counted["connections"] += 1
    with socket.create_connection(("127.0.0.1", port), 60.0) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if counted["connections"] % 10 == 0:
            connection.sendall(chance.randbytes(chance.randint(1, 300)))
            counted["cut_off"] += 1
            return
        for i in range(PER_CONNECTION):
            # Every third connection has a session, so that what is nearly right is tried on one.
            payload = requests[0] if i == 0 and counted["connections"] % 3 == 0 else mutated(chance, requests)
            connection.sendall(frame(payload))
            counted["frames"] += 1
            found = reply(connection)
            if found is None:
                counted["unanswered"] += 1
                return
            counted["errors" if found.type == Message.ACK and found.ack.error else "fine"] += 1
            asked = kind(payload)
            if found.type == Message.STATE and asked == Message.INIT:
                reply(connection)  # the TASKINFO
            elif found.type == Message.ACK and asked in (Message.INIT, Message.DISCONNECT):
                return  # a refused INIT and a DISCONNECT end the connection


def malformed(wanted: int) -> dict[str, Any]:
    """Send so many requests; return what came back, what it took, and whether another client noticed."""
    chance, requests = random.Random(SEED), valid()
    counted = dict.fromkeys(("connections", "frames", "fine", "errors", "unanswered", "cut_off"), 0)
    command = [sys.executable, "-m", "qrsim.cli", "serve", "--port", "0", "--sessions"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stderr is not None
        port = int(server.stdout.readline().rpartition(":")[2])
        with Client(port=port) as other:
            other.init(TASK)
            before, steps, slowest = 0, 0, 0.0
            begun = time.perf_counter()
            while counted["frames"] < wanted:
                attack(port, chance, requests, counted)
                if not before and counted["frames"] >= wanted // 4:
                    before = resident_bytes(server.pid)
                asked = time.perf_counter()
                steps += 1
                state = other.step_waypoint(0.02, [[6.0, -8.0, -9.0, 0.0]])
                slowest = max(slowest, time.perf_counter() - asked)
                assert abs(state.time - 0.02 * steps) < 1e-6
            seconds = time.perf_counter() - begun
            after = resident_bytes(server.pid)
        alive = server.poll() is None
        server.terminate()
        _, complaints = server.communicate(timeout=60.0)
    return {
        **counted,
        "seconds": round(seconds, 1),
        "server_alive": int(alive),
        "lines_on_stderr": complaints.count("\n"),
        "memory_after_a_quarter_bytes": before,
        "memory_at_the_end_bytes": after,
        "steps_of_another_client": steps,
        "slowest_of_them_s": round(slowest, 3),
    }


def rates(full: bool) -> dict[str, Any]:
    """Return what the benchmark of serving prints, by what was measured."""
    rows = printed("serve", *(() if full else ("--quick",)))
    names = ("lock_step", "outstanding", "written_twice", "readings", "long_steps", "real_time", "watched")
    numbers = ("median_us", "p95_us", "per_second", "of_one_write", "late")
    found = {
        name: {key: row[key] for key in numbers if row.get(key) is not None}
        for name, row in zip(names, rows, strict=False)
    }
    if full:
        late = found["real_time"]["late"]
        near = sum(late[f"from_{low}_to_{high}_us"] for low, high in NEAR_US)
        found["real_time"]["within_1_ms_percent"] = 100.0 * near / sum(late.values())
    return found


def run(full: bool) -> dict[str, Any]:
    """Return all of it; the small form only sees that it works."""
    load = os.getloadavg()[0]
    return {**rates(full), "malformed": malformed(FULL if full else SMALL), "load_average": load}
