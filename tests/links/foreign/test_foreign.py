"""Others' scripts fly: what the public examples of MAVSDK, DroneKit, pymavlink and MAVProxy do.

Each flies on vehicles 1 to 5 at once, three times in a row, while the programs of all five load the machine.
Of MAVSDK, versions 2, 3 and 4 fly side by side, each time on other vehicles.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pytest
from tests.links.mavlink import driven_clients as clients

from qrsim.scenarios.scenario import load_scenario

HERE = Path(__file__).resolve().parent
VEHICLES, ROUNDS = range(5), 3
# Simulated seconds a second, and how long a round may take [s, wall clock].
FACTOR, PATIENCE_S = 3.0, 300.0
MAVSDK = ("mavsdk2", "mavsdk3", "mavsdk4_grpc")
# MAVSDK 2 has addresses of its own.
ADDRESSES = {"mavsdk2": "udp://:"}
# What MAVSDK 2 does with system 1 alone: to another one its upload of a fence fails before a message leaves it.
FIRST_ALONE = {("mavsdk2", "geofence")}


class Suite(NamedTuple):
    """Scripts of a client.

    Attributes:
        file: that has them.
        scripts: their names.
        clients: environments that fly them, on one vehicle after the other; "" is this Python.
        flavour: of the vehicles that they fly.
        options: more of ``qrsim mavlink``.
    """

    file: str
    scripts: tuple[str, ...]
    clients: tuple[str, ...] = ("",)
    flavour: str = "px4"
    options: tuple[str, ...] = ()


SUITES = (
    Suite(
        "mavsdk_scripts.py",
        (
            "takeoff_and_land", "goto", "mission", "mission_raw", "offboard_position", "offboard_velocity",
            "offboard_body", "offboard_attitude", "offboard_position_velocity", "offboard_from_csv", "do_orbit",
            "follow_me", "geofence", "failure_injection", "telemetry", "params", "manual_control",
        ),
        MAVSDK,
    ),
    Suite("mavsdk_scripts.py", ("no_failures", "failures"), MAVSDK, options=("--injectable", "all")),
    Suite(
        "dronekit_scripts.py",
        (
            "simple_goto", "mission_basic", "guided_set_speed_yaw", "set_attitude_target", "vehicle_state", "follow_me",
            "channel_overrides",
        ),
        ("dronekit",), "ardupilot",
    ),
    Suite("pymavlink_scripts.py", ("swarm",)),
    Suite("pymavlink_scripts.py", ("guided",), flavour="ardupilot"),
    Suite("mavproxy_scripts.py", ("px4",), ("mavproxy",)),
    Suite("mavproxy_scripts.py", ("copter",), ("mavproxy",), "ardupilot"),
)  # fmt: skip
CASES = [
    pytest.param(suite, script, id=f"{suite.file.partition('_')[0]}-{script}")
    for suite in SUITES
    for script in suite.scripts
]


def python_of(client: str) -> str:
    """Return the Python of a client; skip where it cannot be fetched."""
    try:
        return clients.environment(client) if client else sys.executable
    except clients.NotThereError as error:
        pytest.skip(str(error))


def fly(
    suite: Suite, script: str, port: int, number: int, vehicles: Sequence[int] = VEHICLES, factor: float = FACTOR
) -> list[str]:
    """Fly a script on vehicles at once, the first of them at a port; return what those said who did not."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    running = []
    for vehicle in vehicles:
        client = suite.clients[(vehicle + number) % len(suite.clients)]
        if (client, script) in FIRST_ALONE and vehicle:
            client = suite.clients[-1]
        scheme = "udpin:127.0.0.1:" if client not in MAVSDK else ADDRESSES.get(client, "udpin://127.0.0.1:")
        words = [python_of(client), str(HERE / suite.file), script, f"{scheme}{port + vehicle}"]
        # A server of MAVSDK has a port of its own.
        words += [str(50080 + 10 * number + vehicle)] if client in MAVSDK else []
        process = subprocess.Popen(
            [*words, str(vehicle), f"{factor:g}"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=clean,
            start_new_session=True,
        )
        running.append((f"round {number + 1}, vehicle {vehicle + 1}, {client or 'pymavlink'}", process))
    end, said = time.monotonic() + PATIENCE_S, []
    for who, process in running:
        try:
            text, _ = process.communicate(timeout=max(1.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            _end(process)
            text = process.communicate()[0] + "\nnot in time"
        _end(process)
        if process.returncode or f"flown: {script}" not in text:
            said.append(f"{who}: {text[-2000:]}")
    return said


def _end(process: subprocess.Popen[str]) -> None:
    """End a process with all that it has started, of MAVSDK a server."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def flown(suite: Suite, script: str, rounds: int) -> tuple[list[str], str]:
    """Fly a script by all vehicles, several times in a row; return what failed, and what the server printed."""
    for client in suite.clients:
        python_of(client)
    field = clients.Field(str(HERE / "wide_field.yaml"), "--flavour", suite.flavour, *suite.options, factor=FACTOR)
    try:
        said = [line for number in range(rounds) for line in fly(suite, script, field.port, number)]
    finally:
        text = field.end()
    return said, text


@pytest.mark.nightly
@pytest.mark.parametrize(("suite", "script"), CASES)
def test_a_script_of_others_flies(suite, script):
    said, text = flown(suite, script, ROUNDS)
    assert said == [], text
    assert re.findall("Flight has ended.*|Run has ended.*|bug.*", text) == []


@pytest.mark.nightly
@pytest.mark.parametrize("client", MAVSDK)
def test_two_of_one_field_fly_the_offboard_example_at_once(client):
    """Both are sent to the same places, each of its own frame: side by side, 8 m apart, in real time."""
    python_of(client)
    suite, field = SUITES[0]._replace(clients=(client,)), clients.Field(factor=1.0)
    try:
        said = fly(suite, "offboard_position", field.port, 0, (0, 2), 1.0)
    finally:
        text = field.end()
    assert said == [], text
    assert "Flight has ended" not in text


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [
        # Of goto, mission_raw, and mission, do_orbit and follow_me of MAVSDK-Python.
        (47.399386, 8.535245),
        (47.40271757, 8.54285027),
        (47.39803986, 8.54557254),
        (47.39803622, 8.54501464),
        (47.39782562, 8.54500928),
    ],
)
def test_places_of_public_examples_are_in_the_area_of_mavlink_field(latitude, longitude):
    area = load_scenario("mavlink_field").world().area
    # Metres a degree at 47.4 degrees of latitude (WGS-84).
    north, east = (latitude - 47.397742) * 111_180.0, (longitude - 8.545594) * 75_441.0
    assert float(area.x_min) + 100.0 < north < float(area.x_max) - 100.0
    assert float(area.y_min) + 100.0 < east < float(area.y_max) - 100.0
