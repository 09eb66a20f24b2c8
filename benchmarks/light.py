"""How light a plain run is: CPU seconds of whole processes over those of ``import jax``, run by turns.

What compiling a scenario takes is a run of one tick with an empty cache less the same run with a filled one.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import _common
from startup import QRSIM, run_timed

IMPORT_JAX = "python -c 'import jax'"
HEADINGS = {
    "what": "process",
    "runs": "runs",
    "cpu_s": "CPU [s]",
    "over_import_jax": "over import jax",
    "real_time_factor": "flight over real time",
}
# Name, and the scenario with its options.
RUNS = (
    ("qrsim run hover, no figure", ("hover", "--duration", "2", "--no-figure")),
    ("qrsim run hover", ("hover", "--duration", "2")),
    ("qrsim run mixed_team, no figure", ("mixed_team", "--duration", "90", "--no-figure")),
)
# Scenarios whose compilation is measured.
COMPILED = ("outdoor_patrol", "mixed_team")


def compile_seconds(scenario: str, rounds: int, folder: str) -> list[float]:
    """Return the CPU seconds that compiling a scenario takes, once a round."""
    found = []
    for number in range(rounds):
        here = Path(folder) / f"{scenario}-{number}"
        # Of a run too short for its sensors, which is meant.
        environment = {**os.environ, "QRSIM_CACHE_DIR": str(here / "cache"), "PYTHONWARNINGS": "ignore::UserWarning"}
        command = [QRSIM, "run", scenario, "--duration", "0.02", "--no-figure", "--json"]
        cold, warm = (run_timed([*command, "--out", str(here / name)], environment)[1] for name in ("cold", "warm"))
        found.append(cold - warm)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__.splitlines()[0], arguments)
    on = _common.machine()
    rounds, runs = (1, RUNS[:1]) if chosen.quick else (7, RUNS)
    commands = {IMPORT_JAX: [sys.executable, "-c", "import jax"]}
    commands |= {what: [QRSIM, "run", *words, "--json", "--out"] for what, words in runs}
    cpu: dict[str, list[float]] = {what: [] for what in commands}
    factors: dict[str, list[float]] = {what: [] for what in commands}
    with tempfile.TemporaryDirectory() as folder:
        # The first round fills the caches of programs, of Python and of fonts, and is not counted.
        for number in range(rounds + 1):
            for place, (what, command) in enumerate(commands.items()):
                out = [f"{folder}/{number}-{place}"] if place else []
                _, seconds, printed = run_timed([*command, *out], os.environ)
                if number:
                    cpu[what].append(seconds)
                    factors[what] += [json.loads(printed)["real_time_factor"]] if place else []
        for scenario in () if chosen.quick else COMPILED:
            cpu[f"compile {scenario}"] = compile_seconds(scenario, 3, folder)
    floor = statistics.median(cpu[IMPORT_JAX])
    results = [
        {
            "what": what,
            "runs": len(seconds),
            "cpu_s": round(statistics.median(seconds), 3),
            "over_import_jax": round(statistics.median(seconds) / floor, 2),
            "real_time_factor": round(statistics.median(factors[what])) if factors.get(what) else None,
        }
        for what, seconds in cpu.items()
    ]
    _common.publish("light", "A plain run with a filled cache, medians", on, results, HEADINGS, chosen.json)


if __name__ == "__main__":
    main()
