"""Vehicles as a node of ROS 2 in real time, with another process that hears every topic: late ticks, processor time."""

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

HEADINGS = {
    "what": "what",
    "vehicles": "vehicles",
    "topics": "topics",
    "rate_hz": "ticks [Hz]",
    "ticks": "ticks",
    "late_percent": "late ticks [%]",
    "core": "CPU s/simulated s",
    "core_target": "target",
    "messages_per_second": "messages/s heard",
}
LAST_LINE = re.compile(r"([\d.]+) s simulated in ([\d.]+) s; (\d+) of (\d+) ticks late")
# On this machine alone.
ALONE = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces></General>'
    "</Domain></CycloneDDS>"
)


def scenario(vehicles: int, rate: float) -> dict[str, Any]:
    """Return the patrol with so many vehicles, and so many ticks a second."""
    from qrsim.scenarios.reading import read_scenario

    _, content = read_scenario("outdoor_patrol")
    content["time_step"] = 1.0 / rate
    places = [{"position_ned": [12.0 * (i // 10) - 60.0, 12.0 * (i % 10) - 60.0, -25.0]} for i in range(vehicles)]
    fleet = content["fleets"]["pelicans"]
    fleet["vehicles"] = places
    if rate > 50.0:
        fleet["sensors"]["imu"]["period"] = 1.0 / rate
    return dict(content)


def flown(vehicles: int, rate: float, seconds: float) -> dict[str, Any]:
    """Return the row of so many vehicles in the air."""
    from qrsim.links.ros2.participant import Participant
    from qrsim.links.ros2.topics import CLOCK, KINDS, TF, Topic
    from qrsim.links.ros2.typestore import Types

    domain = 100 + os.getpid() % 100
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "many.yaml").write_text(yaml.safe_dump(scenario(vehicles, rate)))
        words = [sys.executable, "-m", "qrsim.cli", "ros2", str(folder / "many.yaml"), "--domain", str(domain)]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        stack.callback(server.kill)
        assert server.stdout is not None
        topics = 0
        for line in server.stdout:
            if found := re.match(r"domain \d+, (\d+) topics", line):
                topics = int(found[1])
                break
        listener = Participant(Types(), domain, "listener")
        own = [Topic(f"/pelicans_{i}/{kind.topic}", kind.type, kind.quality) for i in range(vehicles) for kind in KINDS]
        readers = [listener.reader(topic).entity for topic in (CLOCK, TF, *own)]
        time.sleep(2.0)
        begun, cpu, heard = time.monotonic(), _cpu_s(server.pid), 0
        while time.monotonic() - begun < seconds:
            time.sleep(0.005)
            heard += sum(len(reader.take(100)) for reader in readers)
        used, wall = _cpu_s(server.pid) - cpu, time.monotonic() - begun
        server.send_signal(signal.SIGTERM)
        text, _ = server.communicate(timeout=30.0)
    last = LAST_LINE.search(text)
    assert last is not None, text
    late, ticks = int(last[3]), int(last[4])
    return {
        "what": f"patrol for {seconds:g} s",
        "vehicles": vehicles,
        "topics": topics,
        "rate_hz": rate,
        "ticks": ticks,
        "late_percent": round(100.0 * late / ticks, 3),
        # A world that is late has simulated less than the wall clock says.
        "core": round(used / wall * float(last[2]) / float(last[1]), 3),
        "core_target": 1.0,
        "messages_per_second": round(heard / wall),
    }


def _cpu_s(process: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    os.environ.setdefault("CYCLONEDDS_URI", ALONE)
    chosen = _common.options(__doc__.splitlines()[0], arguments, vehicles="how many, at 50 Hz (default: four cases)")
    on = _common.machine()
    cases = (
        [(2, 50.0, 2.0)] if chosen.quick else [(20, 50.0, 20.0), (30, 50.0, 20.0), (20, 200.0, 20.0), (100, 50.0, 20.0)]
    )
    if chosen.vehicles:
        cases = [(_common.count_of(chosen.vehicles), 50.0, 20.0)]
    results = [flown(*case) for case in cases]
    _common.publish(
        "ros2", "Vehicles as a node of ROS 2, in real time over loopback", on, results, HEADINGS, chosen.json
    )


if __name__ == "__main__":
    main()
