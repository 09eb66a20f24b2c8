"""Others' clients, each in an environment of its own, fly a vehicle of ``qrsim mavlink`` in 6 m/s of wind."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.links.mavlink import driven_clients as clients
from tests.links.mavlink.driven_clients import MODES, STEPS, Field, fly

pytestmark = pytest.mark.long


@pytest.fixture
def field():
    found = Field()
    yield found
    if found.process.poll() is None:
        found.process.kill()
        found.process.wait()


def test_two_that_want_an_environment_at_once_make_it_once(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    began = []

    def fill(folder, requirements):
        began.append(requirements)
        time.sleep(0.3)

    monkeypatch.setattr(clients, "_fill", fill)
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(clients.environment, ["mavproxy", "mavproxy"])
    assert one == other
    assert began == [("MAVProxy==1.8.75", "setuptools<81")]


def environment(name: str) -> str:
    """Return the Python of a client's environment; skip where it cannot be fetched."""
    try:
        return clients.environment(name)
    except clients.NotThereError as error:
        pytest.skip(str(error))


def check_log(text: str) -> None:
    """The vehicle was armed, has landed and was disarmed; nothing else happened, and no other one moved."""
    said = re.findall(r"'(field_\d)': (.*)", text)
    assert {name for name, _ in said} == {"field_0"}
    words = [line for _, line in said]
    assert words == [
        "Armed by external command",
        "Takeoff detected",
        "Mission finished, loitering",
        "Landing detected",
        "Disarmed by landing",
    ]
    assert "bug" not in text


def test_pymavlink(field):
    assert fly(sys.executable, "pymavlink_flight.py", f"udpin:127.0.0.1:{field.port}") == list(STEPS)
    check_log(field.end())


@pytest.mark.nightly
def test_pymavlink_by_tcp(field):
    assert fly(sys.executable, "pymavlink_flight.py", f"tcp:127.0.0.1:{field.tcp}") == list(STEPS)
    check_log(field.end())


@pytest.mark.nightly
def test_mavsdk_3(field):
    python = environment("mavsdk3")
    assert fly(python, "mavsdk_flight.py", f"udpin://127.0.0.1:{field.port}", "50069") == list(STEPS)
    check_log(field.end())


@pytest.mark.nightly
def test_mavsdk_3_in_other_modes():
    """A fence with a circle of radius 0, attitudes, an orbit, follow-me and sticks, in real time."""
    python, field = environment("mavsdk3"), Field(factor=1.0)
    try:
        assert fly(python, "mavsdk_modes.py", f"udpin://127.0.0.1:{field.port}", "50070") == list(MODES)
        said = re.findall(r"'field_0': (.*)", field.end())
    finally:
        field.process.kill()
    assert said == ["Armed by external command", "Landing detected", "Disarmed by landing"]


@pytest.mark.nightly
def test_mavsdk_4(field):
    python = environment("mavsdk4")
    assert fly(python, "mavsdk4_flight.py", f"udpin://127.0.0.1:{field.port}") == list(STEPS)
    check_log(field.end())


@pytest.mark.nightly
def test_dronekit():
    """DroneKit speaks the older dialect of missions, and flies to places by MISSION_ITEM."""
    python = environment("dronekit")
    field = Field("--flavour", "ardupilot")
    try:
        assert fly(python, "dronekit_flight.py", f"udpin:127.0.0.1:{field.port}") == list(STEPS)
    finally:
        text = field.end()
    check_log(text)


@pytest.mark.nightly
def test_mavproxy(field, tmp_path):
    """MAVProxy reads the parameters, arms, takes off, flies a mission from a file, and comes back."""
    python = environment("mavproxy")
    mission = tmp_path / "mission.txt"
    rows = [
        (0, 0, 16, 47.397742, 8.545594, 488.0),
        (1, 3, 22, 0.0, 0.0, 8.0),
        (2, 3, 16, 47.3979, 8.5456, 9.0),
        (3, 3, 16, 47.3979, 8.5458, 10.0),
        (4, 3, 16, 47.3978, 8.5458, 9.0),
        (5, 3, 20, 0.0, 0.0, 0.0),
    ]
    text = "\n".join(
        f"{n}\t{n == 0:d}\t{frame}\t{command}\t0\t0\t0\t0\t{x}\t{y}\t{z}\t1" for n, frame, command, x, y, z in rows
    )
    mission.write_text(f"QGC WPL 110\n{text}\n")
    words = [
        python,
        str(Path(python).parent / "mavproxy.py"),
        f"--master=udpin:127.0.0.1:{field.port}",
    ]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    proxy = subprocess.Popen(
        words,
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=clean | {"HOME": str(tmp_path), "PYTHONUNBUFFERED": "1"},
    )
    assert proxy.stdin is not None
    try:
        for pause, line in (
            (8.0, "param show RTL_RETURN_ALT"),
            (1.0, "param set RTL_RETURN_ALT 15"),
            (1.0, f"wp load {mission}"),
            (4.0, "arm throttle"),
            (0.5, "long MISSION_START 0 5 0 0 0 0 0"),
        ):
            time.sleep(pause)
            proxy.stdin.write(f"{line}\n")
            proxy.stdin.flush()
        time.sleep(25.0)
    finally:
        proxy.kill()
    said, _ = proxy.communicate(timeout=20)
    text = field.end()
    assert "RTL_RETURN_ALT   60.0" in said
    assert "Received " in said
    assert "Got MISSION_ACK: TYPE_MISSION: ACCEPTED" in said
    assert "waypoint 4" in said
    words_of = [line for name, line in re.findall(r"'(field_\d)': (.*)", text) if name == "field_0"]
    assert words_of[0] == "Armed by external command", (said, text)
    assert words_of[-1] == "Disarmed by landing", (said, text)
