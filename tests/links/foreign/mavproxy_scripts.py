"""Sessions of MAVProxy, driven by its prompt: ``python mavproxy_scripts.py SCRIPT ADDRESS [VEHICLE [FACTOR]]``.

``copter`` is the usual session with ArduPilot's flavour, ``px4`` one with PX4's. Run it by the Python of MAVProxy.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

LATITUDE, LONGITUDE = 47.397742, 8.545594
# What is waited for by the wall clock, beyond what the flight takes [s].
PATIENCE = 60.0


class Session:
    """A running MAVProxy."""

    def __init__(self, address: str, folder: str) -> None:
        words = [sys.executable, str(Path(sys.executable).parent / "mavproxy.py"), f"--master={address}"]
        self._log = Path(folder) / "said"
        with self._log.open("wb") as log:
            self._proxy = subprocess.Popen(
                words,
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | {"HOME": folder, "PYTHONUNBUFFERED": "1"},
            )
        self._seen = 0

    def type(self, line: str) -> None:
        """Type a line at the prompt."""
        assert self._proxy.stdin is not None
        self._proxy.stdin.write(f"{line}\n".encode())
        self._proxy.stdin.flush()

    def wait(self, words: Sequence[str], seconds: float = PATIENCE) -> None:
        """Wait until one of some words is said after what was waited for before."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            said = self._log.read_text(encoding="utf-8", errors="replace")
            found = [said.find(word, self._seen) for word in words]
            if max(found) >= 0:
                self._seen = max(found)
                return
            if self._proxy.poll() is not None:
                break
            time.sleep(0.05)
        raise SystemExit(f"MAVProxy did not say {' or '.join(words)}:\n{self._log.read_text(errors='replace')}")

    def wait_height(self, least: float, seconds: float = PATIENCE) -> None:
        """Wait until the vehicle is at least so high over home [m]."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.type("status GLOBAL_POSITION_INT")
            time.sleep(0.5)
            found = re.findall(r"relative_alt : (-?\d+)", self._log.read_text(encoding="utf-8", errors="replace"))
            if found and int(found[-1]) > 1000.0 * least:
                return
        raise SystemExit(f"not at {least} m:\n{self._log.read_text(errors='replace')}")

    def end(self) -> None:
        """End it."""
        self._proxy.kill()
        self._proxy.wait()


def mission_file(folder: str, up: float, home: bool) -> Path:
    """Write a mission of a take-off, three places and a return; home comes first for ArduPilot alone."""
    places = [(22, 0.0, 0.0), (16, 2e-4, 0.0), (16, 2e-4, 2e-4), (16, 0.0, 2e-4), (20, 0.0, 0.0)]
    rows = [f"0\t1\t0\t16\t0\t0\t0\t0\t{LATITUDE}\t{LONGITUDE}\t488\t1"] if home else []
    for number, (command, north, east) in enumerate(places, len(rows)):
        x, y = (LATITUDE + north, LONGITUDE + east) if command == 16 else (0.0, 0.0)
        rows.append(f"{number}\t{number == 0:d}\t3\t{command}\t0\t0\t0\t0\t{x}\t{y}\t{up}\t1")
    path = Path(folder) / "mission.txt"
    path.write_text("QGC WPL 110\n" + "\n".join(rows) + "\n")
    return path


def copter(session: Session, folder: str, vehicle: int) -> None:
    """Take off in GUIDED, go to a place, fly a mission in AUTO, and come home, with ArduPilot's flavour."""
    up = 10 + 6 * vehicle
    session.wait(["Received "])
    session.type("param set SIM_WIND_SPD 7")
    time.sleep(2.0)
    session.type("param fetch SIM_WIND_SPD")
    session.wait(["SIM_WIND_SPD = 7.0"])
    session.type(f"param set RTL_RETURN_ALT {up}")
    session.type(f"wp load {mission_file(folder, up, home=True)}")
    session.wait(["MISSION_ACK", "Loaded"])
    session.wait(["ACCEPTED"])
    session.type("mode guided")
    session.wait(["Mode GUIDED", "GUIDED>"])
    session.type("arm throttle")
    session.wait(["ARMED"])
    session.type("takeoff 8")
    session.wait_height(7.0)
    session.type(f"guided {LATITUDE + 1e-4} {LONGITUDE} {up}")
    session.wait_height(up - 1.0)
    session.type("mode auto")
    session.wait(["Mode AUTO", "AUTO>"])
    session.wait(["waypoint 4"])
    session.wait(["DISARMED"], 120.0)


def px4(session: Session, folder: str, vehicle: int) -> None:
    """Set a parameter, load a mission, arm, start it, and be disarmed at home, with PX4's flavour."""
    session.wait(["Received "])
    session.type(f"param set RTL_RETURN_ALT {10 + 6 * vehicle}")
    session.type(f"wp load {mission_file(folder, 10 + 6 * vehicle, home=False)}")
    session.wait(["MISSION_ACK", "Loaded"])
    session.wait(["ACCEPTED"])
    session.type("arm throttle")
    session.wait(["ARMED"])
    session.type("long MISSION_START 0 4 0 0 0 0 0")
    session.wait(["waypoint 3"])
    session.wait(["DISARMED"], 120.0)


if __name__ == "__main__":
    script, address, *more = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        session = Session(address, folder)
        try:
            {"copter": copter, "px4": px4}[script](session, folder, int(more[0]) if more else 0)
        finally:
            session.end()
    print(f"flown: {script}", flush=True)
