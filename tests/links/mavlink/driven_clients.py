"""Others' MAVLink clients, each in an environment of its own, and a running ``qrsim mavlink`` for them."""

from __future__ import annotations

import fcntl
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
FACTOR = 5.0
# What the examples print of a whole flight, in this order.
STEPS = (
    "took off",
    "there",
    "mission flown",
    "at the position of the set-point",
    "flies by velocity",
    "landed",
    "disarmed",
)
# What the example of other modes prints.
MODES = (
    "fence uploaded",
    "rises by attitude",
    "on the circle",
    "orbits",
    "in follow-me",
    "follows",
    "steered",
    "landed by sticks",
)
REQUIREMENTS = {
    "mavsdk2": ("mavsdk==2.8.4",),
    "mavsdk3": ("mavsdk==3.17.4",),
    "mavsdk4": ("mavsdk==4.1.0",),
    # MAVSDK 4 by the interface of version 3.
    "mavsdk4_grpc": ("mavsdk-grpc==4.0.5",),
    "dronekit": ("dronekit2==3.0.0",),
    "mavproxy": ("MAVProxy==1.8.75", "setuptools<81"),
}


class NotThereError(Exception):
    """A client cannot be fetched here."""


class Field:
    """A running ``qrsim mavlink``, of the scenario mavlink_field."""

    def __init__(self, *options: str, factor: float = FACTOR):
        words = [sys.executable, "-m", "qrsim.cli", "mavlink", "--realtime", f"{factor:g}", "--tcp", *options]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        self.lines: list[str] = []
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            if line.startswith("TCP: "):
                break
        found = re.search(r"programs: UDP (\d+)", "\n".join(self.lines))
        assert found, self.lines
        self.port = int(found[1])
        self.tcp = int(self.lines[-1].split()[1])

    def end(self) -> str:
        """Stop it, and return all that it has printed."""
        self.process.send_signal(signal.SIGTERM)
        rest, _ = self.process.communicate(timeout=30)
        assert self.process.returncode == 143
        return "\n".join([*self.lines, rest])


def environment(name: str) -> str:
    """Return the Python of a client's environment, made once; raises NotThereError."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = cache / "qrsim-tests" / f"{name}-{sys.version_info.major}.{sys.version_info.minor}"
    folder.mkdir(parents=True, exist_ok=True)
    # Several tests may want the same one at once.
    with (folder.parent / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            _fill(folder, REQUIREMENTS[name])
            (folder / "complete").touch()
    return str(folder / "bin" / "python")


def _fill(folder: Path, requirements: Sequence[str]) -> None:
    """Make an environment with some packages; raises NotThereError."""
    subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True, timeout=300)
    words = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode and ("ConnectionError" in done.stderr or "No matching distribution" in done.stderr):
        raise NotThereError(f"{requirements[0]}: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr


def fly(python: str, script: str, *arguments: str) -> list[str]:
    """Run an example, and return the steps that it has printed."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [python, str(EXAMPLES / script), *arguments],
        capture_output=True,
        text=True,
        timeout=240,
        env=clean,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if line in STEPS + MODES]
