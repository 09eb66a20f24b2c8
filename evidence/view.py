"""What the 3-D page reaches, in parts.

``minute``: a thousand vehicles live, with a browser that stays and one that leaves and returns; then as fast as they
can, without a page and with one that one browser or two look at (benchmarks/view.py): medians of runs in turns, and
their spread. ``reach``: frames and bytes of few and of many vehicles with two browsers, and how old a frame is behind a
link of 1 Mbit/s. ``hours``: memory of a live page over two hours at fifty times the wall clock. ``export``: two hours
as one page: processor time and the peak of memory while it is written, and its size. ``browser``: what a page costs a
real browser (evidence/_view_browser.py): opening two long runs, scrubbing them, many vehicles, an hour.

The default scenario with more vehicles (benchmarks/_common.py), recorded. Other browsers are processes that fetch
what a browser fetches (benchmarks/_view_client.py). Memory is that of the simulating process, or of the exporting one.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import qrsim
from evidence import _view_browser
from evidence._processes import BENCHMARKS, benchmark, resident_bytes
from qrsim.runs.recorder import fly
from qrsim.view.clock import Clock
from qrsim.view.live import LiveView

DOC = "the 3-D page: frames, bytes, lag, memory and slowdown of live pages; exports of two hours; a real browser"
SEED = 20261121
FULL, SMALL = (1000, 60.0), (20, 3.0)
# Pairs of runs, and vehicles and seconds of each.
FULL_RUNS, SMALL_RUNS = (1000, 60.0, 5), (2, 2.0, 1)
PARTS = ("minute", "reach", "hours", "export", "browser")
# Vehicles, seconds of flight, and seconds behind a slow link.
FULL_REACH, SMALL_REACH = ((5, 1000), 60.0, 30.0), ((2,), 2.0, 2.0)
SLOW_BITS_PER_SECOND = 1e6
# Vehicles, seconds of simulated time, and times the wall clock.
FULL_HOURS, SMALL_HOURS = (5, 7200.0, 50.0), (2, 20.0, 10.0)
# Vehicles, and seconds of a flight that is long and of one that is short.
FULL_EXPORT, SMALL_EXPORT = ((5, 50), 7200.0, 60.0), ((2,), 4.0, 2.0)
# Vehicles and seconds of two runs, how often they are opened, how often their time is set; of one with many vehicles;
# of a long live flight, with its speed.
FULL_BROWSER, SMALL_BROWSER = (
    ((50, 600.0), 3, 200, (1000, 20.0), (5, 3600.0, 50.0)),
    ((2, 2.0), 1, 5, (20, 3.0), (2, 600.0, 50.0)),
)
EXPORT = """
import resource, sys
from qrsim import cli
code = cli.main(["view", sys.argv[1], "--export", sys.argv[2]])
used = resource.getrusage(resource.RUSAGE_SELF)
# Not ru_maxrss, which begins with what the process had that started this one.
lines = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(code, used.ru_utime + used.ru_stime, lines["VmHWM"].split()[0])
"""
# Part of the flight during which memory is looked at.
LOOK = 0.08


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
        found.append(resident_bytes())
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


def minute(full: bool) -> dict[str, Any]:
    """Return what was drawn, fetched and kept in memory, and the slowdown."""
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


def live(
    count: int, duration: float, speed: float, browsers: int, bits_per_second: float | None = None
) -> dict[str, float]:
    """Fly with a page, recorded, and return its frames, what each browser fetched, lag and memory."""
    scenario = qrsim.load_scenario(patrol(count), [f"duration={duration}"], quiet=True)
    view, found = LiveView(0, Clock(speed)), {}  # type: ignore[var-annotated]

    def look() -> None:
        for name, part in (("memory_after_a_third", 1.0 / 3.0), ("memory_at_end", 0.97 - LOOK)):
            while view._page is None or view._page.scene.frame is None or view._page.scene.frame.time < part * duration:
                time.sleep(0.02)
            found[f"{name}_megabytes"] = round(1e-6 * memory(LOOK * duration / speed), 1)

    looking = threading.Thread(target=look, daemon=True)
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        to = view.address
        if bits_per_second is not None:
            to = stack.enter_context(benchmark("_slow_link").slow_link(to, bits_per_second))
        got = stack.enter_context(benchmark("view").clients(to, browsers))
        looking.start()
        pace = fly(scenario, Path(folder) / "run", seed=SEED, precision="float32", view=view)
        looking.join()
        drawn = 0 if view._page is None else view._page.drawn
        view.close()
    found["frames_per_second"] = round(drawn / pace.wall_s, 2)
    found["megabytes_per_second_each"] = round(sum(1e-6 * b["bytes"] / b["seconds"] for b in got) / browsers, 4)
    found["oldest_frame_s"] = round(max((b["lag_s"] or 0.0 for b in got), default=0.0), 3)
    return found


def reach(full: bool) -> dict[str, Any]:
    """Return frames and bytes with two browsers, and how old a frame is behind a slow link, by number of vehicles."""
    counts, seconds, slow_seconds = FULL_REACH if full else SMALL_REACH
    names = ("frames_per_second", "megabytes_per_second_each")
    found: dict[str, Any] = {}
    for count in counts:
        fast, slow = live(count, seconds, 1.0, 2), live(count, slow_seconds, 1.0, 1, SLOW_BITS_PER_SECOND)
        found[f"vehicles_{count}"] = {name: fast[name] for name in names} | {
            "slow_link_oldest_frame_s": slow["oldest_frame_s"],
        }
    return {"reach": found}


def hours(full: bool) -> dict[str, Any]:
    """Return the memory of a live page over a long flight."""
    count, seconds, speed = FULL_HOURS if full else SMALL_HOURS
    found: dict[str, Any] = {"vehicles": count, "simulated_s": seconds, "speed": speed}
    found |= live(count, seconds, speed, 1)
    growth = found["memory_at_end_megabytes"] / found["memory_after_a_third_megabytes"] - 1.0
    return {"hours": found | {"memory_growth_percent": round(100.0 * growth, 2)}}


def export(full: bool) -> dict[str, Any]:
    """Return processor time, peak memory and size of exported pages, of a short flight and of long ones."""
    counts, seconds, short = FULL_EXPORT if full else SMALL_EXPORT
    found: dict[str, Any] = {"simulated_s": seconds, "short": exported(counts[0], short)}
    return {"export": found | {f"vehicles_{count}": exported(count, seconds) for count in counts}}


def exported(count: int, seconds: float) -> dict[str, float]:
    """Fly, export in a process of its own, and return its processor time, its peak memory and the size of the page."""
    scenario = qrsim.load_scenario(patrol(count), [f"duration={seconds}"], quiet=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fly(scenario, folder / "run", seed=SEED, precision="float32")
        command = [sys.executable, "-c", EXPORT, str(folder / "run"), str(folder / "page")]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
        size = (folder / "page" / "index.html").stat().st_size
    assert said[-3] == "0"
    return {
        "processor_s": round(float(said[-2]), 1),
        "peak_megabytes": round(1024e-6 * float(said[-1]), 1),
        "page_megabytes": round(1e-6 * size, 2),
    }


def browser(full: bool) -> dict[str, Any]:
    """Return the browser's costs of opening and scrubbing two runs, of many vehicles, and of an hour's live flight."""
    (count, seconds), opened, seeks, (many, short), (few, long, speed) = FULL_BROWSER if full else SMALL_BROWSER

    def flown(count: int, seconds: float, path: Path, seed: int = SEED, view: LiveView | None = None) -> Path:
        scenario = qrsim.load_scenario(patrol(count), [f"duration={seconds}"], quiet=True)
        fly(scenario, path, seed=seed, precision="float32", view=view)
        return path

    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        two = flown(count, seconds, folder / "first"), flown(count, seconds, folder / "second", SEED + 1)
        openings = [_view_browser.opening(*two) for _ in range(opened)]
        found["opening"] = {name: min(each[name] for each in openings) for name in openings[0]}
        found["scrubbing"] = {"vehicles": 2 * count, "simulated_s": seconds, **_view_browser.scrubbing(two, seeks)}
        found["many"] = {"vehicles": many, **_view_browser.playing(flown(many, short, folder / "many"), short - 1.0)}
        view = LiveView(0, Clock(speed))
        looking = threading.Thread(target=lambda: found.update(hour=_view_browser.hour(view, long)))
        looking.start()
        flown(few, long, folder / "hour", view=view)
        looking.join()
        view.close()
    found["hour"] |= {"vehicles": few, "simulated_s": long}
    return {"browser": found}


def run(full: bool, parts: tuple[str, ...] = PARTS) -> dict[str, Any]:
    """Return the results of the parts."""
    found: dict[str, Any] = {}
    for part in parts:
        found |= {"minute": minute, "reach": reach, "hours": hours, "export": export, "browser": browser}[part](full)
    return found
