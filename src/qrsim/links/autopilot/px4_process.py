"""PX4's SITL firmware as processes that are started and ended here."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from qrsim.errors import RunError, UsageError, shortened
from qrsim.links.autopilot.px4_flight import Px4Flight
from qrsim.links.autopilot.px4_parameters import MODEL, Number, environment

AIRFRAMES = "etc/init.d-posix/airframes"
END_S, LAST_LINES, LONGEST_LINE, LAST_BYTES = 2.0, 5, 200, 16384


class Build:
    """A build folder of PX4.

    Args:
        folder: such as PX4-Autopilot/build/px4_sitl_default.

    Raises:
        UsageError: it lacks the firmware, the module that connects to a simulator, or the airframe.
    """

    def __init__(self, folder: Path):
        # Unlike Path.expanduser, it leaves the home of an unknown user as it is.
        self.folder = Path(os.path.expanduser(folder)).absolute()
        self.program = self.folder / "bin" / "px4"
        found = self.folder / "build" / "px4_sitl_default"
        hint = f"; did you mean '{folder / 'build' / 'px4_sitl_default'}'?" if found.is_dir() else ""
        if not self.folder.is_dir():
            raise UsageError(f"--px4 {folder}: there is no such folder; it is PX4's build/px4_sitl_default")
        if not self.program.is_file() or not os.access(self.program, os.X_OK):
            raise UsageError(f"--px4 {folder}: has no program bin/px4; make px4_sitl_default builds it{hint}")
        module = self.folder / "bin" / "px4-simulator_mavlink"
        if not (module.is_symlink() or module.exists()):
            raise UsageError(f"--px4 {folder}: this build has no module simulator_mavlink (bin/px4-simulator_mavlink)")
        if not list((self.folder / AIRFRAMES).glob(f"*_{MODEL}")):
            raise UsageError(f"--px4 {folder}: has no airframe *_{MODEL} in {AIRFRAMES}")


class Process:
    """A running PX4 in a folder of its own, so that no parameters of earlier runs are there.

    Args:
        build: where it is.
        instance: its number (-i).
        environment: variables for it, besides those of this process.
        folder: new; it keeps PX4's output (px4.log), its parameters and its ULogs (log/).

    Raises:
        UsageError: the folder exists.
        RunError: it does not start.
    """

    def __init__(self, build: Build, instance: int, environment: Mapping[str, str], folder: Path):
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise UsageError(
                f"folder {folder} for PX4's logs exists and is never overwritten; choose another --out"
            ) from None
        except OSError as error:
            raise RunError(f"{folder}: {error.strerror or error}") from None
        self._log = folder / "px4.log"
        self._until: float | None = None
        words = [str(build.program), "-i", str(instance), "-d", str(build.folder / "etc")]
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("PX4_")}
        try:
            with open(self._log, "wb") as log:
                self._process = subprocess.Popen(
                    words,
                    cwd=folder,
                    env={**inherited, **environment},
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )
        except OSError as error:
            raise RunError(f"{build.program}: {error.strerror or error}") from None

    def ended(self) -> str:
        """Return how the PX4 process ended, with its last output lines, as one line; "" while it runs."""
        # The connection is closed a moment before the process has ended.
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(0.05)
        code = self._process.poll()
        if code is None:
            return ""
        names = {each.value: each.name for each in signal.Signals}
        how = f"was killed by {names.get(-code, -code)}" if code < 0 else f"has ended with code {code}"
        lines = [shortened(line, LONGEST_LINE) for line in self._last_lines() if line.strip()]
        return f"PX4 {how}" + (f"; its last lines: {' | '.join(lines[-LAST_LINES:])}" if lines else "")

    def _last_lines(self) -> list[str]:
        """Return the last lines of PX4's output, read from the end of a file that may have gigabytes."""
        with open(self._log, "rb") as log:
            log.seek(max(0, os.fstat(log.fileno()).st_size - LAST_BYTES))
            return log.read(LAST_BYTES).decode("utf-8", "replace").splitlines()

    def ask(self) -> None:
        """Send SIGTERM to the PX4 process once, without waiting for it to end."""
        if self._until is None:
            self._until = time.monotonic() + END_S
            self._signal_group(signal.SIGTERM)

    def close(self) -> None:
        """Send SIGTERM, wait, and kill the PX4 process and its children if they have not ended."""
        self.ask()
        assert self._until is not None
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(0.0, self._until - time.monotonic()))
        # Its clock has stopped, so a step of its shutdown that waits for time never ends.
        self._signal_group(signal.SIGKILL)
        self._process.wait()

    def _signal_group(self, number: signal.Signals) -> None:
        """Send a signal to the PX4 process and its children."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, number)

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def started(build: Build, flight: Px4Flight, own: Mapping[str, Number], logs: Path) -> None:
    """Start a PX4 process for each vehicle of ``flight``, with the user's parameters ``own``; closing the flight ends
    them.

    Args:
        build: of PX4.
        flight: not begun.
        own: parameters of the user's, after those of the vehicles.
        logs: folder with one for each vehicle, by name.

    Raises:
        RunError: one does not start.
    """
    processes: list[Process] = []

    def ask_all() -> None:
        """Send SIGTERM to all PX4 processes."""
        for process in processes:
            process.ask()

    for link, found in zip(flight.links, flight.parameters(), strict=True):
        begun = Process(build, link.instance, environment({**found, **own}), logs / link.name)
        process = flight.closing.enter_context(begun)
        link.ended = process.ended
        processes.append(process)
        # Closed in the opposite order, so all are asked before the first is waited for.
        flight.closing.callback(ask_all)
