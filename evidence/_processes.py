"""Programs and benchmarks in processes of their own, and the memory of processes."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import psutil

from evidence import ROOT

BENCHMARKS = ROOT / "benchmarks"


def program(text: str, *words: Any) -> dict[str, Any]:
    """Return what a Python program prints as JSON."""
    # A file, because the processes that it starts import it.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "program.py"
        path.write_text(text, encoding="utf-8")
        found = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        command = [sys.executable, str(path), *map(str, words)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": found})
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def printed(name: str, *words: str, **environment: str) -> list[dict[str, Any]]:
    """Return the rows that a benchmark prints."""
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), "--json", *words]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, **environment})
    rows: list[dict[str, Any]] = json.loads(done.stdout)["results"]
    return rows


def benchmark(name: str) -> Any:
    """Return the module of a benchmark; benchmarks are no package."""
    if str(BENCHMARKS) not in sys.path:
        sys.path.append(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def resident_bytes(pid: int | None = None) -> int:
    """Return the resident set of a process, by default this one."""
    return int(psutil.Process(pid).memory_info().rss)


def reset_peak() -> None:
    """Let `peak_bytes` count from here on, where the system can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def peak_bytes() -> int:
    """Return the largest resident set of this process so far, or since it was reset (Linux).

    Not from getrusage: that remembers what the parent had when it started this process.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
