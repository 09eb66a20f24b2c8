"""Others' scripts: the public examples of MAVSDK, DroneKit, pymavlink and MAVProxy, on five vehicles at once."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from evidence import _mavlink_clients as clients

DOC = "what others' public scripts do, each on five vehicles at once and three times in a row"
SCRIPTS = Path(__file__).resolve().parent / "_foreign"
VEHICLES, ROUNDS = 5, 3
# Simulated seconds a second, and how long a script may take [s, wall clock].
FACTOR, PATIENCE_S = 3.0, 240.0
MAVSDK = (
    "takeoff_and_land", "goto", "mission", "mission_raw", "offboard_position", "offboard_velocity", "offboard_body",
    "offboard_attitude", "offboard_position_velocity", "offboard_from_csv", "do_orbit", "follow_me", "geofence",
    "failure_injection", "telemetry", "params", "manual_control",
)  # fmt: skip
DRONEKIT = (
    "simple_goto", "mission_basic", "guided_set_speed_yaw", "set_attitude_target", "vehicle_state", "follow_me",
    "channel_overrides",
)  # fmt: skip


class Suite(NamedTuple):
    """The scripts of a client.

    Attributes:
        file: that has them.
        scripts: their names.
        flavour: of the vehicles that they fly.
        address: of a vehicle, before its port.
        server: whether each needs a port for a server of its own.
    """

    file: str
    scripts: tuple[str, ...]
    flavour: str = "px4"
    address: str = "udpin:127.0.0.1:"
    server: bool = False


_MAVSDK = Suite("mavsdk_scripts.py", MAVSDK, address="udpin://127.0.0.1:", server=True)
SUITES: dict[str, Suite] = {
    "mavsdk2": _MAVSDK,
    "mavsdk3": _MAVSDK,
    "mavsdk4_grpc": _MAVSDK,
    "dronekit": Suite("dronekit_scripts.py", DRONEKIT, "ardupilot"),
    "pymavlink": Suite("pymavlink_scripts.py", ("swarm",)),
    "pymavlink_guided": Suite("pymavlink_scripts.py", ("guided",), "ardupilot"),
    "mavproxy": Suite("mavproxy_scripts.py", ("px4",)),
    "mavproxy_copter": Suite("mavproxy_scripts.py", ("copter",), "ardupilot"),
}
PARTS = tuple(SUITES)


class Round(NamedTuple):
    """What came of a script that was flown on some vehicles at once.

    Attributes:
        flown: by how many.
        said: what those printed that did not fly it.
    """

    flown: int
    said: list[str]


def python_of(client: str) -> str:
    """Return the Python of a client; raises NotThereError."""
    name = client.partition("_guided")[0].partition("_copter")[0]
    return sys.executable if name == "pymavlink" else clients.environment(name)


def fly(client: str, script: str, vehicles: Sequence[int], rounds: int) -> tuple[list[Round], str]:
    """Fly a script by several vehicles at once, several times in a row; return that, and what the server printed."""
    suite, python = SUITES[client], python_of(client)
    field = clients.Field("--flavour", suite.flavour, factor=FACTOR)
    try:
        found = [_round(suite, python, script, field.port, vehicles, number) for number in range(rounds)]
    finally:
        text = field.end()
    return found, text


def _round(suite: Suite, python: str, script: str, port: int, vehicles: Sequence[int], number: int) -> Round:
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    running = []
    for vehicle in vehicles:
        server = [str(50080 + 10 * number + vehicle)] if suite.server else []
        words = [python, str(SCRIPTS / suite.file), script, f"{suite.address}{port + vehicle}", *server, str(vehicle)]
        running.append(
            subprocess.Popen(
                [*words, f"{FACTOR:g}"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=clean
            )
        )
    end, flown, said = time.monotonic() + PATIENCE_S, 0, []
    for vehicle, process in zip(vehicles, running, strict=True):
        try:
            text, _ = process.communicate(timeout=max(1.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            text, _ = process.communicate()
            text += "\nnot in time"
        if process.returncode == 0 and f"flown: {script}" in text:
            flown += 1
        else:
            said.append(f"{script} on vehicle {vehicle + 1}: {text[-2000:]}")
    return Round(flown, said)


def results(client: str, rounds: int = ROUNDS) -> dict[str, Any]:
    """Return for each script of a client how many flights of how many were whole."""
    found: dict[str, Any] = {}
    for script in SUITES[client].scripts:
        flown, text = fly(client, script, range(VEHICLES), rounds)
        found[script] = sum(each.flown for each in flown)
        for line in [said for each in flown for said in each.said]:
            print(line, flush=True)
        ended = text.count("Flight has ended")
        if ended:
            print(f"{client} {script}: {ended} flights have ended", flush=True)
        print(f"{client} {script}: {found[script]} of {rounds * VEHICLES}", flush=True)
    found["flights"] = rounds * VEHICLES * len(SUITES[client].scripts)
    found["whole"] = sum(found[script] for script in SUITES[client].scripts)
    return found


def run(full: bool, parts: Sequence[str] = PARTS) -> dict[str, Any]:
    """Return how many flights of each script were whole; the small form flies one round of what this Python has."""
    if full:
        return {client: results(client) for client in parts}
    with suppress(clients.NotThereError):
        return {"pymavlink": results("pymavlink", 1)}
    return {}
