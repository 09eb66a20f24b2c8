"""Vehicle-steps and simulated seconds per second of other simulators, each beside this package in the same run.

Each peer lives in an environment of its own in the user's cache directory; ``--install`` makes those that are missing.
A row says what the peer computed: none of them does all that this package does here ("everything" of throughput.py).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import venv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _common

FOLDER = Path(__file__).resolve().parent
REQUIREMENTS = {
    "crazyflow": "crazyflow==0.4.0",
    "rotorpy": "rotorpy==3.0.0",
    "pyflyt": "PyFlyt==0.29.0",
    "gtsam": "gtsam==4.3.0",
}
PATIENCE_S = 300.0
HEADINGS = {
    "simulator": "simulator",
    "computed": "computed",
    "vehicles": "vehicles",
    "processes": "proc.",
    "step_s": "step [s]",
    "per_wall_second": "steps/s (wall)",
    "per_cpu_second": "steps/s (CPU)",
    "simulated_per_second": "simulated s/s",
    "ours_to_theirs_steps": "steps: ours/theirs",
    "ours_to_theirs_seconds": "simulated: ours/theirs",
    "note": "note",
}


@dataclass(frozen=True)
class Peer:
    """One row.

    Attributes:
        name: key of REQUIREMENTS; the script is ``_peer_<name>.py``.
        kind: the script's first argument.
        computed: what it computes, in words.
        vehicles: in all processes together.
        processes: each pinned to a core of its own where there are several.
        extra: of the peer's distribution, needed by this kind.
        module: whose presence shows that it is installed.
    """

    name: str
    kind: str
    computed: str
    vehicles: int
    processes: int
    extra: str = ""
    module: str = ""

    @property
    def requirement(self) -> str:
        """What pip is asked for."""
        name, _, version = REQUIREMENTS[self.name].partition("==")
        return f"{name}{f'[{self.extra}]' if self.extra else ''}=={version}"


def peers(many: int) -> list[Peer]:
    """Return all rows, with ``many`` vehicles where a peer flies many."""
    cores = os.cpu_count() or 1
    free = "Euler, held attitude; no wind, sensors, noise"
    crazyflow = [
        Peer("crazyflow", kind, f"{kind}, {free}", many, processes, module="crazyflow")
        for kind in ("first_principles", "so_rpy")
        for processes in sorted({1, cores})
    ]
    single = "SE3 controller, RK45, constant wind, IMU, motion capture"
    batched = "PyTorch, RK4, held motor speeds; no wind, sensors"
    return [
        *crazyflow,
        Peer("rotorpy", "single", single, 1, 1, module="rotorpy"),
        Peer("rotorpy", "batched", batched, many, 1, extra="batched", module="torchdiffeq"),
    ]


def environment(name: str) -> Path:
    """Return the folder of a peer's environment; QRSIM_PEERS names another parent than the user's cache."""
    from platformdirs import user_cache_path

    parent = os.environ.get("QRSIM_PEERS")
    return (Path(parent) if parent else user_cache_path("qrsim") / "peers") / name


def python_of(folder: Path) -> Path:
    """Return the Python of an environment."""
    return folder / "Scripts" / "python.exe" if os.name == "nt" else folder / "bin" / "python"


def installed(peer: Peer) -> bool:
    """Return whether the peer's environment has what the row needs."""
    python = python_of(environment(peer.name))
    if not python.exists():
        return False
    code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({peer.module!r}) is None)"
    return subprocess.run([python, "-c", code], capture_output=True, check=False).returncode == 0


def install(name: str) -> None:
    """Make the environment of a peer.

    Raises:
        SystemExit: pip failed.
    """
    folder = environment(name)
    print(f"peers: installing {REQUIREMENTS[name]} into {folder}", file=sys.stderr)
    if not python_of(folder).exists():
        venv.create(folder, with_pip=True)
    command = [str(python_of(folder)), "-m", "pip", "install", "--quiet", REQUIREMENTS[name]]
    if subprocess.run(command, stdout=sys.stderr, check=False).returncode:
        sys.exit(f"peers: this failed: {' '.join(command)}")


def how_to_install(peer: Peer) -> str:
    """Return the command that installs what a row needs."""
    if peer.extra:
        return f"{python_of(environment(peer.name))} -m pip install '{peer.requirement}'"
    return "python benchmarks/peers.py --install"


def fly(peer: Peer, seconds: float) -> dict[str, Any]:
    """Return the row of a peer, with a note in place of numbers where there are none."""
    blank: dict[str, Any] = dict.fromkeys(HEADINGS)
    blank |= {"simulator": REQUIREMENTS[peer.name], "computed": peer.computed, "vehicles": peer.vehicles}
    blank |= {"processes": peer.processes, "note": ""}
    if not installed(peer):
        return blank | {"note": f"not installed: {how_to_install(peer)}"}
    try:
        found = _fly_together(peer, seconds)
    except (subprocess.TimeoutExpired, RuntimeError) as error:
        return blank | {"note": f"did not run: {error}"}
    if not all(part["finite"] for part in found):
        return blank | {"note": "did not run: its states became infinite"}
    wall = sum(part["steps"] / part["wall"] for part in found)
    cpu = sum(part["steps"] for part in found) / sum(part["cpu"] for part in found)
    return blank | _rates(wall, cpu, found[0]["step_s"])


def _rates(per_wall_second: float, per_cpu_second: float, step_s: float) -> dict[str, Any]:
    return {
        "step_s": step_s,
        "per_wall_second": round(per_wall_second),
        "per_cpu_second": round(per_cpu_second),
        "simulated_per_second": per_wall_second * step_s,
    }


def _fly_together(peer: Peer, seconds: float) -> list[dict[str, Any]]:
    """Start all processes of a peer, let them fly at the same time, and return what each printed.

    Raises:
        RuntimeError: one ended without a result; the last line of its errors is the message.
        subprocess.TimeoutExpired: one takes too long.
    """
    share = peer.vehicles // peer.processes
    return run_together(peer.name, [f"_peer_{peer.name}.py", peer.kind, str(share)], peer.processes, seconds)


def run_together(name: str, words: list[str], processes: int, seconds: float) -> list[dict[str, Any]]:
    """Start a script in a peer's environment several times, and return what each printed; see ``_fly_together``.

    Args:
        name: key of REQUIREMENTS.
        words: the script's name and its arguments, after which come the seconds.
        processes: how many, each on a core of its own where there are several.
        seconds: of wall time, after all are ready.

    Raises: see ``_fly_together``.
    """
    command = [str(python_of(environment(name))), str(FOLDER / words[0]), *words[1:], str(seconds)]
    pinned = processes > 1 and hasattr(os, "sched_setaffinity")
    # Each process would otherwise see, and use, all cores; this package's own settings are none of its business.
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "QRSIM", "JAX"))}
    # In a folder of its own, because MuJoCo leaves a log where it runs.
    settings: dict[str, Any] = {"stdin": -1, "stdout": -1, "stderr": -1, "text": True, "env": clean}
    settings["cwd"] = environment(name)
    started = [subprocess.Popen(command, **settings) for _ in range(processes)]
    try:
        for core, process in enumerate(started):
            if pinned:
                os.sched_setaffinity(process.pid, {core})
        for process in started:
            assert process.stdout is not None
            process.stdout.readline()  # "ready", or nothing where it ended
        found = []
        for process in started:
            assert process.stdin is not None
            try:
                process.stdin.write("go\n")
                process.stdin.flush()
            except BrokenPipeError:
                pass
        for process in started:
            printed, errors = process.communicate(timeout=seconds + PATIENCE_S)
            if process.returncode:
                raise RuntimeError((errors.strip().splitlines() or [f"exit status {process.returncode}"])[-1])
            found.append(json.loads(printed.splitlines()[-1]))
        return found
    finally:
        for process in started:
            process.kill()


def ours(worlds: int, count: int, seconds: float) -> dict[str, Any]:
    """Return the row of this package with everything on."""
    import throughput

    measured = throughput.measure(worlds, count, "everything", seconds, 3)
    blank: dict[str, Any] = dict.fromkeys(HEADINGS)
    return {
        **blank,
        "simulator": "qrsim",
        "computed": "Heun, full Dryden, all sensors with noise, GNSS, controllers, collisions",
        "vehicles": worlds * count,
        "processes": 1,
        "note": "",
        **_rates(measured["per_wall_second"], measured["per_cpu_second"], 0.02),
    }


def compared(theirs: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return a peer's row with the ratios to this package's row of as many vehicles."""
    if theirs["per_wall_second"] is None:
        return theirs
    return theirs | {
        "ours_to_theirs_steps": own["per_wall_second"] / theirs["per_wall_second"],
        "ours_to_theirs_seconds": own["simulated_per_second"] / theirs["simulated_per_second"],
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--install", action="store_true", help="make the environments that are missing, then measure")
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")
    parser.add_argument("--quick", action="store_true", help="the smallest form; its numbers mean nothing")
    chosen = parser.parse_args(arguments)
    worlds, count, seconds = (2, 2, 0.01) if chosen.quick else (512, 8, 3.0)
    wanted = peers(worlds * count)
    if chosen.install:
        for name in dict.fromkeys(peer.name for peer in wanted):
            if not all(installed(peer) for peer in wanted if peer.name == name and not peer.extra):
                install(name)
    on = _common.machine()
    own = {worlds * count: ours(worlds, count, seconds / 5.0), 1: ours(1, 1, seconds / 5.0)}
    results = [*own.values(), *(compared(fly(peer, seconds), own[peer.vehicles]) for peer in wanted)]
    _common.publish(
        "peers", "Peers: ours over theirs, for the same number of vehicles", on, results, HEADINGS, chosen.json
    )


if __name__ == "__main__":
    main()
