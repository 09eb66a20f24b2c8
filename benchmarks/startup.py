"""How long a user waits: whole processes, from the shell and back.

The time to the first tick is from the start of the process ``qrsim run`` until its first tick is done; the rest of
the process writes the log of one tick and prints its summary.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import _common

# The command as it is installed, which ends quicker than ``python -m qrsim.cli``.
QRSIM = str(Path(sys.executable).with_name("qrsim"))
COLD_TARGET_S, WARM_TARGET_S = 10.0, 3.0
HEADINGS = {
    "what": "process",
    "runs": "runs",
    "wall_s": "wall [s]",
    "wall_max_s": "slowest [s]",
    "cpu_s": "CPU [s]",
    "target_s": "target [s]",
}


def timed(command: Sequence[str], environment: Mapping[str, str]) -> tuple[float, float]:
    """Run a command and return the wall and CPU seconds it took; raises CalledProcessError where it fails."""
    return run_timed(command, environment)[:2]


def run_timed(command: Sequence[str], environment: Mapping[str, str]) -> tuple[float, float, str]:
    """Return also what the command printed."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    done = subprocess.run(command, check=True, env=dict(environment), stdout=subprocess.PIPE, text=True)
    wall = time.perf_counter() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def row(what: str, times: Sequence[tuple[float, float]], target: float | None = None) -> dict[str, Any]:
    """Return a row of the table: medians over the runs, and the slowest."""
    walls, cpus = [wall for wall, _ in times], [cpu for _, cpu in times]
    return {
        "what": what,
        "runs": len(times),
        "wall_s": round(statistics.median(walls), 3),
        "wall_max_s": round(max(walls), 3),
        "cpu_s": round(statistics.median(cpus), 3),
        "target_s": target,
    }


Times = list[tuple[float, float]]


def flights(folder: Path, runs: int, scenario: str, cache: Path | None) -> tuple[Times, Times]:
    """Time ``qrsim run`` of one tick: to the first tick (with the CPU time of the whole), and as a whole.

    Args:
        folder: for the run folders and the caches.
        runs: how many.
        scenario: its name.
        cache: the compilation cache of all runs; None gives each an empty one.
    """
    first_ticks, wholes = [], []
    for _ in range(runs):
        number = len(list(folder.iterdir()))
        place = cache or folder / f"cache-{number}"
        place.mkdir(exist_ok=True)
        environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
        # The user's cache, on Linux.
        environment["XDG_CACHE_HOME"] = str(place)
        # Of a run too short for its sensors, which is meant.
        environment["PYTHONWARNINGS"] = "ignore::UserWarning"
        words = ["run", scenario, "--duration", "0.02", "--no-figure", "--json", "--out", str(folder / f"run-{number}")]
        begun = time.time()
        wall, cpu, printed = run_timed([QRSIM, *words], environment)
        first_ticks.append((json.loads(printed)["first_tick_unix_s"] - begun, cpu))
        wholes.append((wall, cpu))
    return first_ticks, wholes


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    scenario, cold, warm, small = ("hover", 1, 1, 1) if chosen.quick else ("outdoor_patrol", 3, 5, 7)
    on = _common.machine()
    results = [
        row(
            "python -c 'import qrsim'",
            [timed([sys.executable, "-c", "import qrsim"], os.environ) for _ in range(small)],
        ),
        row("qrsim --help", [timed([QRSIM, "--help"], os.environ) for _ in range(small)]),
    ]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        first_tick, whole = flights(folder, cold, scenario, None)
        results.append(row("qrsim run to the first tick, empty cache", first_tick, COLD_TARGET_S))
        results.append(row("the whole of it", whole))
        filled = next(folder.glob("cache-*"))
        first_tick, whole = flights(folder, warm, scenario, filled)
        results.append(row("qrsim run to the first tick, filled cache", first_tick, WARM_TARGET_S))
        results.append(row("the whole of it", whole))
    title = f"Start-up, medians; 'qrsim run {scenario}' of one tick, without a figure; CPU of the whole process"
    _common.publish("startup", title, on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
