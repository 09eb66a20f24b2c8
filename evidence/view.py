"""A thousand vehicles live on the 3-D page, with a browser that stays and one that leaves and returns.

The default scenario with more vehicles (benchmarks/_common.py), recorded, at the speed of the wall clock. Browsers are
processes that fetch what a browser fetches (benchmarks/_view_client.py). Memory is that of the simulating process.

Then the same scenario as fast as it can, recorded, without a page and with one that one browser or two look at
(benchmarks/view.py): medians of runs in turns, and how they spread.
"""

from __future__ import annotations

import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import qrsim
from qrsim.runs.recorder import fly
from qrsim.view.clock import Clock
from qrsim.view.live import LiveView

DOC = "1000 vehicles live on the 3-D page for a minute: frames, bytes, memory, a browser that returns; slowdown"
SEED = 20261121
FULL, SMALL = (1000, 60.0), (20, 3.0)
# Pairs of runs, and vehicles and seconds of each.
FULL_RUNS, SMALL_RUNS = (1000, 60.0, 5), (2, 2.0, 1)
# Part of the flight during which memory is looked at.
LOOK = 0.08
BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def benchmark(name: str) -> Any:
    """Return one of the benchmarks, which are no package."""
    if str(BENCHMARKS) not in sys.path:
        sys.path.append(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def patrol(count: int) -> dict[str, Any]:
    """Return the default scenario with so many vehicles."""
    found: dict[str, Any] = benchmark("_common").patrol(count)
    return found


def slowdown(count: int, seconds: float, repeats: int) -> dict[str, Any]:
    """Return how much slower a run is with a page open, in percent, and how fast it is without [times real time]."""
    rows = benchmark("view").slowdown(count, seconds, repeats)
    runs = {row["clients"]: row for row in rows if row["what"].startswith("run")}
    frames = {row["clients"]: row for row in rows if row["what"] == "its frames"}
    alone = runs[0]["per_second"]
    found: dict[str, Any] = {"factor": round(alone, 2), "factor_lowest": round(runs[0]["lowest"], 2)}
    found["factor_highest"] = round(runs[0]["highest"], 2)
    for browsers, word in ((1, "one"), (2, "two")):
        for key, name in (("per_second", "percent"), ("highest", "percent_least"), ("lowest", "percent_most")):
            found[f"with_{word}_{name}"] = round(100.0 * (1.0 - runs[browsers][key] / alone), 1)
        found[f"with_{word}_frames_per_second"] = round(frames[browsers]["per_second"], 1)
    return found


class Browser:
    """A process that fetches a page."""

    def __init__(self, address: str):
        command = [sys.executable, str(BENCHMARKS / "_view_client.py"), address]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def leave(self) -> dict[str, Any]:
        """Go, and return what was fetched."""
        found: dict[str, Any] = json.loads(self._process.communicate("", timeout=60.0)[0])
        return found


def memory(seconds: float) -> int:
    """Return the least memory of this process in some seconds [bytes]: what waits to be written comes and goes."""
    found, end = [], time.monotonic() + seconds
    while not found or time.monotonic() < end:
        found.append(int(Path("/proc/self/statm").read_text("utf-8").split()[1]) * resource.getpagesize())
        time.sleep(0.02)
    return min(found)


def watch(view: LiveView, duration: float, found: dict[str, Any]) -> None:
    """Be two browsers, one of which is away in the middle third; note memory at a third and at the end."""

    def until(part: float) -> None:
        while view._page is None or view._page.scene.frame is None or view._page.scene.frame.time < part * duration:
            time.sleep(0.02)

    stays, leaves = Browser(view.address), Browser(view.address)
    until(1.0 / 3.0)
    found["left"] = leaves.leave()
    found["memory"] = memory(LOOK * duration)
    until(2.0 / 3.0)
    returns = Browser(view.address)
    until(0.97 - LOOK)
    found["memory_at_end"] = memory(LOOK * duration)
    found["returned"], found["stayed"] = returns.leave(), stays.leave()


def run(full: bool) -> dict[str, Any]:
    """Return what was drawn, fetched and kept in memory."""
    count, duration = FULL if full else SMALL
    scenario = qrsim.load_scenario(patrol(count), [f"duration={duration}"], quiet=True)
    view, found = LiveView(0, Clock()), {}  # type: ignore[var-annotated]
    watching = threading.Thread(target=watch, args=(view, duration, found))
    with tempfile.TemporaryDirectory() as folder:
        watching.start()
        pace = fly(scenario, Path(folder) / "run", seed=SEED, precision="float32", view=view)
        watching.join()
    page = view._page
    assert page is not None
    view.close()
    stayed, returned = found["stayed"], found["returned"]
    return {
        "vehicles": count,
        "simulated_s": pace.simulated_s,
        "wall_s": round(pace.wall_s, 2),
        "frames_drawn": page.drawn,
        "frames_per_second": round(page.drawn / pace.wall_s, 2),
        "frames_dropped": view._overtaken + page._delivery.missed,
        "fetched_megabytes_per_second": round(1e-6 * stayed["bytes"] / stayed["seconds"], 3),
        "memory_after_a_third_megabytes": round(1e-6 * found["memory"], 1),
        "memory_at_end_megabytes": round(1e-6 * found["memory_at_end"], 1),
        "memory_growth_percent": round(100.0 * (found["memory_at_end"] / found["memory"] - 1.0), 2),
        "whole_scene_after_return_s": round(returned["whole_s"], 3),
        "slowdown": slowdown(*(FULL_RUNS if full else SMALL_RUNS)),
    }
