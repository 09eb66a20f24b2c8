"""Sweeps in processes of their own, which are killed on the way, and clusters on loopback."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil

# A study small enough to be flown in a test.
SMALL: dict[str, Any] = {
    "name": "small",
    "scenario": "hover_ideal",
    "set": {
        "duration": 1.0,
        "world.wind": {"type": "log_shear", "speed_20ft": 1.0, "wind_from_deg": 90.0},
        "fleets.pelicans.vehicle.process_noise": 1.0,
    },
    "vary": {
        "world.wind.speed_20ft": {"values": [0.0, 2.0, 4.0], "name": "wind", "unit": "m/s"},
        "fleets.pelicans.vehicle.mass": {"low": 1.5, "high": 1.8, "count": 4, "name": "mass"},
    },
    "seeds": 5,
    "metrics": ["tracking_error_rms_m", "wind_max_m_s"],
    "failure": {"metric": "tracking_error_max_m", "above": 0.05},
    "batch": 5,
}
WAIT_S = 300.0


def sweep(store: Path, words: list[str], *more: str) -> subprocess.Popen[bytes]:
    """Start ``qrsim sweep`` in a process of its own."""
    line = [sys.executable, "-m", "qrsim.cli", "sweep", *words, *more, "--out", str(store)]
    return subprocess.Popen(line, stdout=subprocess.DEVNULL)


def finish(process: subprocess.Popen[bytes]) -> None:
    """Wait until a command has ended well."""
    if process.wait(WAIT_S):
        raise RuntimeError(f"qrsim sweep ended with {process.returncode}")


def until(what: Callable[[], Any]) -> Any:
    """Wait until something is true, and return it."""
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        found = what()
        if found:
            return found
        time.sleep(0.02)
    raise RuntimeError(f"nothing happened in {WAIT_S:g} s")


def written(store: Path) -> int:
    """Return how many batches of a store are written."""
    return sum(path.is_file() and path.suffix != ".partial" for path in (store / "flown" / "c").rglob("*"))


def kill_process(store: Path, words: list[str], after: int) -> int:
    """Kill a sweep in its middle and give the command again; return how many batches the kill left."""
    process = sweep(store, words, "--workers", "1")
    until(lambda: written(store) >= after)
    family = psutil.Process(process.pid).children(recursive=True)
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = written(store)
    # Its workers notice, and nobody is left behind.
    until(lambda: not any(one.is_running() and one.status() != psutil.STATUS_ZOMBIE for one in family))
    finish(sweep(store, words, "--workers", "2"))
    return left


def kill_worker(store: Path, words: list[str], after: int) -> int:
    """Kill one of two workers in the middle of a sweep; return how many batches were written then."""
    process = sweep(store, words, "--workers", "2")
    until(lambda: written(store) >= after)
    workers = [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]
    workers[0].send_signal(signal.SIGKILL)
    left = written(store)
    finish(process)
    return left


@contextlib.contextmanager
def dask(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Dask program while the context lasts."""
    line = [sys.executable, "-m", "dask", *words, "--no-dashboard"]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        own = psutil.Process(process.pid)
        for one in [*own.children(recursive=True), own]:
            with contextlib.suppress(psutil.NoSuchProcess):
                one.kill()
        process.wait()


@contextlib.contextmanager
def scheduler(folder: Path) -> Iterator[str]:
    """Run a Dask scheduler on loopback, and yield its address."""
    file = folder / "scheduler.json"
    with dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file), "--no-show") as process:

        def address() -> str:
            if process.poll() is not None:
                raise RuntimeError("the scheduler ended")
            with contextlib.suppress(FileNotFoundError, json.JSONDecodeError):
                return str(json.loads(file.read_text(encoding="utf-8"))["address"])
            return ""

        yield until(address)


def opened(store: Path) -> Any:
    """Return the Dataset of a store, in memory."""
    import xarray as xr

    return xr.open_zarr(store, consolidated=False, chunks=None).load()


def same(one: Any, other: Any) -> bool:
    """Return whether two Datasets are the same to the bit, attributes included."""
    return bool(
        one.identical(other)
        and all(np.asarray(one[name]).tobytes() == np.asarray(other[name]).tobytes() for name in one.variables)
    )
