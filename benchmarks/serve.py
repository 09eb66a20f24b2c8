"""How fast a served simulation is: round trips over loopback, long steps, real time, many vehicles to a watcher."""

from __future__ import annotations

import contextlib
import itertools
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import _common

HEADINGS = {
    "what": "what",
    "count": "count",
    "median_us": "median [us]",
    "p95_us": "95 % [us]",
    "per_second": "per second",
    "of_one_write": "of one write",
    "target": "target",
}
OUTSTANDING = 16
# A client that writes length and message apart, with its system's defaults, against one that writes them together:
# blocks of each in turn, so that both see the same machine.
BLOCKS, LEAST_OF_ONE_WRITE = 20, 0.67
TICKS = 1000
# Of the histogram of real time.
EDGES_US = (-20_000, -5000, -2000, -1000, -500, -200, 200, 500, 1000, 2000, 5000, 20_000)


@contextlib.contextmanager
def served(content: dict[str, Any], *words: str) -> Iterator[int]:
    """Serve a scenario in a process of its own; yield its port."""
    import yaml

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        path.write_text(yaml.safe_dump(content), "utf-8")
        command = [sys.executable, "-m", "qrsim.cli", "serve", str(path), "--port", "0", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            assert process.stdout is not None
            try:
                yield int(process.stdout.readline().rpartition(":")[2])
            finally:
                process.terminate()


def request(size: int, dt: float) -> bytes:
    """Return a STEP of all vehicles, at a velocity of zero, with its length message."""
    from qrsim.links.reference.protocol.framing import frame
    from qrsim.links.reference.protocol.qrsim_pb2 import Arrayd, Message, Step

    step = Step(dt=dt, type=Step.VEL, cmd=[Arrayd(value=[0.0, 0.0, 0.0])] * size)
    return frame(Message(type=Message.STEP, step=step).SerializeToString())


def connected(port: int, task: str) -> tuple[socket.socket, int, bytes]:
    """Start a task; return the connection, how many bytes a STATE has, and a STEP of one tick."""
    from qrsim.links.reference.client import Client

    client = Client(port=port)
    client.init(task)
    connection, client._socket = client._socket, None
    assert connection is not None
    step = request(client.size, client.time_step)
    for _ in range(200):
        connection.sendall(step)
        head = connection.recv(5, socket.MSG_WAITALL)
        connection.recv(int.from_bytes(head[1:], "little"), socket.MSG_WAITALL)
    return connection, 5 + int.from_bytes(head[1:], "little"), step


def round_trips(port: int, task: str, count: int, outstanding: int) -> list[float]:
    """Return how long each reply took [us], with so many requests on their way."""
    connection, size, step = connected(port, task)
    sent: list[float] = []
    taken: list[float] = []
    with connection:
        for _ in range(outstanding):
            sent.append(time.perf_counter())
            connection.sendall(step)
        while len(taken) < count:
            connection.recv(size, socket.MSG_WAITALL)
            now = time.perf_counter()
            taken.append(1e6 * (now - sent[len(taken)]))
            sent.append(now)
            connection.sendall(step)
    return [*taken, 1e6 * (now - sent[0])]


def written_twice(port: int, task: str, count: int) -> dict[str, Any]:
    """Return the row of a client that writes each request in two writes, with its rate against that of one write."""
    connection, size, step = connected(port, task)
    # As sockets are where nobody changes them.
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 0)
    one: list[float] = []
    two: list[float] = []
    with connection:
        for block in range(2 * BLOCKS):
            parts, taken = ((step,), one) if block % 2 else ((step[:5], step[5:]), two)
            for _ in range(max(1, count // BLOCKS)):
                begun = time.perf_counter()
                for part in parts:
                    connection.sendall(part)
                connection.recv(size, socket.MSG_WAITALL)
                taken.append(1e6 * (time.perf_counter() - begun))
    rate, best = (1e6 * len(taken) / sum(taken) for taken in (two, one))
    found = row("STEP of one tick, written twice without TCP_NODELAY", two, rate, round(LEAST_OF_ONE_WRITE * best, 1))
    return {**found, "of_one_write": round(rate / best, 3)}


def readings(port: int, task: str, count: int) -> dict[str, Any]:
    """Return the row of a client that asks what all sensors say."""
    from qrsim.links.reference.protocol.framing import frame
    from qrsim.links.reference.protocol.qrsim_pb2 import GetReadings, Message

    connection, _, _ = connected(port, task)
    question = frame(Message(type=Message.GET_READINGS, get_readings=GetReadings()).SerializeToString())
    taken = []
    with connection:
        for _ in range(count):
            begun = time.perf_counter()
            connection.sendall(question)
            head = connection.recv(5, socket.MSG_WAITALL)
            connection.recv(int.from_bytes(head[1:], "little"), socket.MSG_WAITALL)
            taken.append(1e6 * (time.perf_counter() - begun))
    return row("GET_READINGS, 1 on the way", taken, 1e6 * len(taken) / sum(taken), None)


def row(what: str, taken: Sequence[float], per_second: float, target: float | None) -> dict[str, Any]:
    """Return a row of the table."""
    import numpy as np

    median, p95 = np.percentile(taken, [50, 95])
    return {
        "what": what,
        "count": len(taken),
        "median_us": round(float(median), 1),
        "p95_us": round(float(p95), 1),
        "per_second": round(per_second, 1),
        "of_one_write": None,
        "target": target,
    }


def one_vehicle(quick: bool) -> list[dict[str, Any]]:
    """Round trips with one vehicle of ``patrol_published``, and long steps."""
    from qrsim.links.reference.client import Client

    count, rows = (50, []) if quick else (20_000, [])
    content = _common.patrol(1)
    with served(content) as port:
        for outstanding, target in ((1, 3000.0), (OUTSTANDING, 8000.0)):
            *taken, whole = round_trips(port, content["name"], count, outstanding)
            what = f"STEP of one tick, {outstanding} on the way"
            rows.append(row(what, taken, 1e6 * len(taken) / whole, target))
        rows += [task(port, content["name"], count) for task in (written_twice, readings)]
        with Client(port=port) as client:
            client.init(content["name"])
            taken = []
            for _ in range(3 if quick else 100):
                begun = time.perf_counter()
                client.step_velocity(TICKS * client.time_step, [[0.0, 0.0, 0.0]])
                taken.append(1e6 * (time.perf_counter() - begun))
        ticks = TICKS * len(taken[1:]) / (1e-6 * sum(taken[1:]))
        rows.append(row(f"STEP of {TICKS} ticks (rate: ticks)", taken[1:], ticks, 200_000.0))
    return rows


def real_time(seconds: float, vehicles: int) -> dict[str, Any]:
    """Fly in real time; return the row, and in it a histogram of how far intervals of replies were from the time step.

    The counts in it are by numbers of microseconds; intervals beyond the first and the last are counted with those.
    """
    import numpy as np

    content = _common.patrol(vehicles)
    with served(content, "--realtime", "1") as port:
        connection, size, step = connected(port, content["name"])
        count = round(seconds / content["time_step"])
        came = []
        with connection:
            for _ in range(count):
                connection.sendall(step)
                connection.recv(size, socket.MSG_WAITALL)
                came.append(time.perf_counter())
    taken = 1e6 * np.diff(came)
    factor = content["time_step"] * (count - 1) / (came[-1] - came[0])
    found = row(f"real time, {vehicles} vehicles, {seconds:g} s (rate: factor)", taken, 0.0, 1.0)
    found["per_second"] = round(factor, 4)
    late = taken - 1e6 * content["time_step"]
    counts, _ = np.histogram(np.clip(late, EDGES_US[0], EDGES_US[-1]), EDGES_US)
    names = [f"from_{low}_to_{high}_us" for low, high in itertools.pairwise(EDGES_US)]
    return {**found, "late": dict(zip(names, counts.tolist(), strict=True))}


def streamed(vehicles: int, seconds: float) -> dict[str, Any]:
    """Let a client fly many vehicles as fast as 50 Hz, and a watcher receive every state."""
    from qrsim.links.reference.client import Client

    content = _common.patrol(vehicles)
    with served(content, "--realtime", "1") as port, Client(port=port) as watcher:
        came: list[float] = []

        def watch() -> None:
            with contextlib.suppress(Exception):  # the end of the stream
                for _ in watcher.watch(timeout=3.0):
                    came.append(time.perf_counter())

        watching = threading.Thread(target=watch)
        connection, size, step = connected(port, content["name"])
        watching.start()
        time.sleep(0.2)
        with connection:
            for _ in range(round(seconds * 50)):
                connection.sendall(step)
                connection.recv(size, socket.MSG_WAITALL)
        watching.join()
    taken = [1e6 * (after - before) for before, after in itertools.pairwise(came)]
    rate = len(taken) / (came[-1] - came[0])
    return row(f"states of {vehicles} vehicles to a watcher", taken, rate, 50.0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    results = one_vehicle(chosen.quick)
    if not chosen.quick:
        results += [real_time(60.0, 100), streamed(1000, 10.0)]
    title = "Serving: one vehicle of ``patrol_published`` unless said, everything on, over loopback"
    _common.publish("serve", title, on, results, HEADINGS, chosen.json)
    for found in results:
        if "late" in found and not chosen.json:
            print("real time, interval between two replies minus the time step:")
            for span, count in found["late"].items():
                print(f"  {span:24}  {count}")


if __name__ == "__main__":
    main()
