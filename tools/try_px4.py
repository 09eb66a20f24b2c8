"""Fly one vehicle by MAVLink as a script of PX4's users does, and print a table of expected and actual results.

``tools/try_px4.sh`` starts it. Without a build (``python tools/try_px4.py - FOLDER``) ``qrsim mavlink`` flies in place
of PX4, which tries the script itself.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

SCENARIO = """\
extends: mavlink_field
name: px4_trial
duration: 600.0
fleets:
  field:
    vehicles:
      - {position_ned: [0.0, 0.0, -0.2]}
"""
HEIGHT, SIDE, NEAR = 5.0, 10.0, 1.5
# MAV_CMD, and the mask of an armed vehicle in a heartbeat.
ARM, TAKE_OFF, LAND, REPOSITION, ARMED = 400, 22, 21, 192, 128
NAN = float("nan")


class Trial:
    """A connection to the vehicle, and the rows of the report."""

    def __init__(self) -> None:
        from pymavlink import mavutil

        self.link: Any = mavutil.mavlink_connection("udpin:127.0.0.1:14540", source_system=255)
        self.rows: list[tuple[str, str, str, bool]] = []
        self.texts: list[str] = []
        self.last: dict[str, Any] = {}

    def hear(self, kind: str, seconds: float, wanted: Any = lambda message: True) -> Any:
        """Return the first message of a kind that is wanted, or None after a time [s] of the wall clock."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            message = self.link.recv_match(blocking=True, timeout=0.5)
            if message is None:
                continue
            name = message.get_type()
            self.last[name] = message
            if name == "STATUSTEXT":
                self.texts.append(message.text)
            if name == kind and wanted(message):
                return message
        return None

    def ask(self, command: int, *numbers: float) -> Any:
        """Send a command, and return its result; None without an answer."""
        self.link.mav.command_long_send(1, 1, command, 0, *numbers, *[NAN] * (7 - len(numbers)))
        ack = self.hear("COMMAND_ACK", 3.0, lambda message: message.command == command)
        return None if ack is None else ack.result

    def note(self, what: str, expected: str, found: object, good: bool) -> bool:
        """Add a row to the report, print it, and return whether it is as expected."""
        self.rows.append((what, expected, str(found), good))
        print(f"{'ok  ' if good else 'DIFF'} {what}: expected {expected}, got {found}", flush=True)
        return good

    def height(self) -> float:
        """Return the height above the start as the vehicle reports it [m]."""
        place = self.hear("GLOBAL_POSITION_INT", 3.0)
        return NAN if place is None else place.relative_alt * 1e-3

    def fly(self) -> bool:
        """Fly all steps; return False where one makes the next ones pointless."""
        begin = time.monotonic()
        found = self.hear("HEARTBEAT", 60.0, lambda message: message.autopilot == 12)
        if not self.note(
            "heartbeat on UDP 14540", "within 60 s", f"{time.monotonic() - begin:.1f} s", found is not None
        ):
            return False
        self.note("MAV_SYS_ID", "1", found.get_srcSystem(), found.get_srcSystem() == 1)
        begin, result = time.monotonic(), None
        while result != 0 and time.monotonic() - begin < 60.0:
            time.sleep(1.0)
            result = self.ask(ARM, 1.0)
        took = f"result {result} after {time.monotonic() - begin:.1f} s"
        if not self.note("arming", "accepted within 60 s, the first try or a few later", took, result == 0):
            return False
        place = self.hear("GLOBAL_POSITION_INT", 3.0)
        north, east, level = place.lat, place.lon, place.alt * 1e-3 - place.relative_alt * 1e-3
        result = self.ask(TAKE_OFF, 0.0, 0.0, 0.0, NAN, NAN, NAN, level + HEIGHT)
        self.note("take-off", "accepted", f"result {result}", result == 0)
        reached = self.hear("GLOBAL_POSITION_INT", 40.0, lambda m: m.relative_alt * 1e-3 > HEIGHT - 0.7)
        height = self.height()
        if not self.note(f"height {HEIGHT:g} m", "within 0.7 m in 40 s", f"{height:.2f} m", reached is not None):
            return False
        time.sleep(3.0)
        for corner, (x, y) in enumerate(((1, 0), (1, 1), (0, 1), (0, 0)), 1):
            self._corner(corner, north, east, x * SIDE, y * SIDE, level + HEIGHT)
        result = self.ask(LAND, 0.0, 0.0, 0.0, NAN, NAN, NAN, 0.0)
        self.note("landing", "accepted", f"result {result}", result == 0)
        down = self.hear("HEARTBEAT", 60.0, lambda m: m.autopilot == 12 and not m.base_mode & ARMED)
        self.note("disarmed on the ground", "within 60 s", f"{self.height():.2f} m high", down is not None)
        return True

    def _corner(self, number: int, north: int, east: int, x: float, y: float, level: float) -> None:
        lat = north + round(math.degrees(x / 6.371e6) * 1e7)
        lon = east + round(math.degrees(y / (6.371e6 * math.cos(math.radians(north * 1e-7)))) * 1e7)
        self.link.mav.command_int_send(1, 1, 0, REPOSITION, 0, 0, -1.0, 1.0, 0.0, NAN, lat, lon, level)
        self.hear("COMMAND_ACK", 3.0, lambda message: message.command == REPOSITION)

        def away(m: Any) -> float:
            down = math.radians((m.lat - lat) * 1e-7) * 6.371e6
            side = math.radians((m.lon - lon) * 1e-7) * 6.371e6 * math.cos(math.radians(lat * 1e-7))
            return math.hypot(down, side)

        reached = self.hear("GLOBAL_POSITION_INT", 30.0, lambda m: away(m) < NEAR)
        left = away(self.last["GLOBAL_POSITION_INT"])
        self.note(f"corner {number} of the square", f"within {NEAR:g} m in 30 s", f"{left:.2f} m", reached is not None)
        time.sleep(2.0)


def compared(trial: Trial, run: Path) -> None:
    """Compare the run's truth with what was flown."""
    import numpy as np

    from qrsim.runs import open_run

    truth = open_run(run)["truth"]
    place = np.asarray([truth[f"position_ned.{axis}"] for axis in "xyz"], np.float64).reshape(3, -1)
    climbed, far = place[2][0] - place[2].min(), np.hypot(place[0] - place[0][0], place[1] - place[1][0]).max()
    trial.note("true height", f"{HEIGHT:g} m within 1 m", f"{climbed:.2f} m", abs(climbed - HEIGHT) < 1.0)
    corner = math.hypot(SIDE, SIDE)
    trial.note("true corner", f"{corner:.1f} m away within 2.5 m", f"{far:.2f} m", abs(far - corner) < 2.5)
    trial.note(
        "true end", "on the ground", f"{place[2][0] - place[2][-1]:.2f} m up", abs(place[2][0] - place[2][-1]) < 0.3
    )


def main() -> int:
    """Fly, print, write report.txt; return 0 if all was as expected."""
    build, folder = sys.argv[1], Path(sys.argv[2])
    if folder.exists():
        print(f"{folder} exists; name another folder", file=sys.stderr)
        return 2
    folder.mkdir(parents=True)
    scenario, run, log = folder / "px4_trial.yaml", folder / "run", folder / "qrsim.log"
    scenario.write_text(SCENARIO)
    words = ["autopilot", "px4", str(scenario), "--px4", build, "--truth", "--duration", "150", "--out", str(run)]
    if build == "-":
        words = ["mavlink", str(scenario)]
    program = "import sys; from qrsim.cli import main; sys.exit(main(sys.argv[1:]))"
    trial = Trial()
    with open(log, "wb") as written:
        simulator = subprocess.Popen([sys.executable, "-c", program, *words], stdout=written, stderr=written)
        try:
            whole = trial.fly()
            if whole and build != "-":
                print("waiting for the end of the run ...", flush=True)
            else:
                simulator.send_signal(signal.SIGINT)
            code = simulator.wait(300.0)
        finally:
            if simulator.poll() is None:
                simulator.kill()
    if whole and build != "-":
        trial.note("exit code of qrsim", "0", code, code == 0)
        said = [
            line for line in log.read_text("utf-8", "replace").splitlines() if "unanswered" in line or "damaged" in line
        ]
        trial.note("frames unanswered or damaged", "none", "; ".join(said) or "none", not said)
        if run.exists():
            compared(trial, run)
    odd = [row for row in trial.rows if not row[3]]
    lines = [f"{'ok  ' if row[3] else 'DIFF'} {row[0]} | expected {row[1]} | got {row[2]}" for row in trial.rows]
    lines += ["", "what the vehicle said:", *trial.texts, "", "what qrsim said:", log.read_text("utf-8", "replace")]
    (folder / "report.txt").write_text("\n".join(lines))
    print(f"{len(odd)} of {len(trial.rows)} differ; {folder / 'report.txt'} has all, to be sent with an issue")
    return 1 if odd else 0


if __name__ == "__main__":
    sys.exit(main())
