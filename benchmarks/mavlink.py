"""Vehicles as MAVLink systems in real time, with a client that reads in time: processor time of the server."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml

import _common
from qrsim.links.mavlink.dialect import LAYOUTS
from qrsim.links.mavlink.frames import frame

HEADINGS = {
    "what": "what",
    "vehicles": "vehicles",
    "ticks": "ticks",
    "late_percent": "late ticks [%]",
    "late_target": "target",
    "core": "CPU s/simulated s",
    "core_target": "target",
    "frames_per_second": "frames/s",
}
EVERY_S = 1e6
LAST_LINE = re.compile(r"([\d.]+) s simulated in ([\d.]+) s; (\d+) of (\d+) ticks late")
# Streams that a script turns down, to 1 Hz: what is left are heartbeats and states at 5 Hz and less.
FAST = ("ATTITUDE", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT", "HIGHRES_IMU", "LOCAL_POSITION_NED", "ODOMETRY")


def scenario(vehicles: int) -> dict[str, Any]:
    """Return a field with so many X500, 6 m apart."""
    from qrsim.scenarios.reading import read_scenario

    _, content = read_scenario("mavlink_field")
    content["fleets"]["field"]["vehicles"] = [
        {"position_ned": [6.0 * (i // 15), 6.0 * (i % 15), -0.2], "legs": [{"type": "land"}]} for i in range(vehicles)
    ]
    return dict(content)


def flown(vehicles: int, seconds: float, reduced: bool) -> dict[str, Any]:
    """Return the row of vehicles that take off and hover, with a receiver for each of their links."""
    import socket

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "field.yaml").write_text(yaml.safe_dump(scenario(vehicles)))
        words = [sys.executable, "-m", "qrsim.cli", "mavlink", str(folder / "field.yaml"), "--own-ports"]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        stack.callback(server.kill)
        assert server.stdout is not None
        base = 0
        for line in server.stdout:
            found = re.match(r"programs: UDP .* from (\d+)", line)
            base = int(found[1]) if found else base
            if line.startswith("ground station"):
                break
        client = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        client.bind(("127.0.0.1", 0))
        client.setblocking(False)
        time.sleep(2.0)
        for i in range(vehicles):
            _begin(client, base + i, i + 1, reduced)
        begun, cpu = time.monotonic(), _cpu_s(server.pid)
        frames = 0
        beat, beaten = frame(0, LAYOUTS["HEARTBEAT"].payload(type=6), 0, 245, 190), begun
        while time.monotonic() - begun < seconds:
            time.sleep(0.005)
            if time.monotonic() - beaten > 2.0:
                beaten = time.monotonic()
                for i in range(vehicles):
                    client.sendto(beat, ("127.0.0.1", base + i))
            try:
                while True:
                    data = client.recv(1 << 16)
                    frames += _frames(data)
            except BlockingIOError:
                pass
        used, wall = _cpu_s(server.pid) - cpu, time.monotonic() - begun
        server.send_signal(signal.SIGTERM)
        text, _ = server.communicate(timeout=30.0)
    last = LAST_LINE.search(text)
    assert last is not None, text
    late, ticks = int(last[3]), int(last[4])
    return {
        "what": f"hover for {seconds:g} s, {'fast streams at 1 Hz' if reduced else 'default rates'}",
        "vehicles": vehicles,
        "ticks": ticks,
        "late_percent": round(100.0 * late / ticks, 3),
        "late_target": 1.0,
        # A world that is late has simulated less than the wall clock says.
        "core": round(used / wall * float(last[2]) / float(last[1]), 3),
        "core_target": 1.0,
        "frames_per_second": round(frames / wall),
    }


def _begin(client: Any, port: int, system: int, reduced: bool) -> None:
    """Have a vehicle speak to this client, and take off."""
    commands: list[tuple[int, tuple[float, ...]]] = []
    if reduced:
        commands += [(511, (LAYOUTS[name].number, EVERY_S)) for name in FAST]
    commands += [(400, (1.0,)), (22, (0.0, 0.0, 0.0, *[float("nan")] * 4))]
    for number, params in commands:
        values = {f"param{i}": value for i, value in enumerate(params, 1)}
        payload = LAYOUTS["COMMAND_LONG"].payload(target_system=system, target_component=1, command=number, **values)
        client.sendto(frame(LAYOUTS["COMMAND_LONG"].number, payload, 0, 245, 190), ("127.0.0.1", port))


def _frames(data: bytes) -> int:
    """Return how many frames of version 2 a datagram has."""
    at = count = 0
    while at < len(data):
        at += 12 + data[at + 1]
        count += 1
    return count


def _cpu_s(process: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(
        __doc__.splitlines()[0], arguments, vehicles="how many, at default rates (default: three cases)"
    )
    on = _common.machine()
    cases = [(2, 2.0, False)] if chosen.quick else [(30, 60.0, False), (50, 60.0, False), (200, 60.0, True)]
    if chosen.vehicles:
        cases = [(_common.count_of(chosen.vehicles), 60.0, False)]
    results = [flown(*case) for case in cases]
    _common.publish(
        "mavlink", "Vehicles as MAVLink systems, in real time over loopback", on, results, HEADINGS, chosen.json
    )


if __name__ == "__main__":
    main()
