"""What the 3-D page costs: updates and bytes a second without browsers and with two, and how it slows a simulation."""

from __future__ import annotations

import contextlib
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import _common
from _slow_link import slow_link

HEADINGS = {
    "what": "what",
    "vehicles": "vehicles",
    "clients": "clients",
    "per_second": "updates/s",
    "cpu_ms": "CPU [ms/update]",
    "client_bytes_per_second": "bytes/s, each",
    "missed": "missed",
    "lag_s": "lag [s]",
    "lowest": "lowest",
    "highest": "highest",
}
CLIENT = Path(__file__).with_name("_view_client.py")
FRAMES_HZ = 30.0
SLOW_BITS_PER_SECOND = 1e6


@contextlib.contextmanager
def clients(address: str, count: int) -> Iterator[list[dict[str, Any]]]:
    """Let processes fetch a page as browsers do; what they got is in the list afterwards."""
    found: list[dict[str, Any]] = []
    command = [sys.executable, str(CLIENT), address]
    processes = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(count)
    ]
    try:
        yield found
    finally:
        found.extend(json.loads(process.communicate("")[0]) for process in processes)


def simulation(count: int) -> Any:
    """Return a simulation of the default scenario with so many vehicles, reset."""
    import qrsim

    found = qrsim.Simulation(qrsim.load_scenario(_common.patrol(count), quiet=True).world(), seed=1)
    found.reset()
    return found


def updates(
    count: int, browsers: int, seconds: float, pace: float | None, bits_per_second: float | None = None
) -> dict[str, Any]:
    """Draw frames that all differ, at a pace [Hz] or as fast as can be, for browsers behind a link or none."""
    from qrsim.view.frame import cast_of, frame_of
    from qrsim.view.page import Page
    from qrsim.view.server import address, start_server

    flown = simulation(count)
    first = frame_of(flown.state, 0.0, flown.world)
    flown.record(1)
    second = frame_of(flown.state, flown.time, flown.world)
    server = start_server(0)
    page = Page(server, cast_of(flown.world, first.position_ned), flown.world, "benchmark", None)
    page.draw(first, everything=True)
    with contextlib.ExitStack() as stack:
        to = address(server)
        if bits_per_second is not None:
            to = stack.enter_context(slow_link(to, bits_per_second))
        got = stack.enter_context(clients(to, browsers))
        deadline = time.perf_counter() + 30.0
        while len(page._delivery._buffer.generator_cursors) < browsers and time.perf_counter() < deadline:
            time.sleep(0.05)
        begun, cpu, drawn = time.perf_counter(), time.process_time(), 0
        while (now := time.perf_counter() - begun) < seconds:
            if pace is not None and now * pace < drawn:
                time.sleep(drawn / pace - now)
            page.draw(replace(second if drawn % 2 else first, time=first.time + drawn / FRAMES_HZ))
            drawn += 1
        elapsed, spent = time.perf_counter() - begun, time.process_time() - cpu
    server.stop()
    fetched = sum(client["bytes"] / client["seconds"] for client in got)
    return {
        "what": ("as fast as can be" if pace is None else f"{pace:g} Hz")
        + (f", {1e-6 * bits_per_second:g} Mbit/s" if bits_per_second else ""),
        "vehicles": count,
        "clients": browsers,
        "per_second": drawn / elapsed,
        "cpu_ms": 1e3 * spent / drawn,
        "client_bytes_per_second": fetched / browsers if browsers else None,
        "missed": page._delivery.missed,
        "lag_s": max((client["lag_s"] for client in got if client["lag_s"] is not None), default=None),
        "lowest": None,
        "highest": None,
    }


def factor(count: int, duration: float, browsers: int | None) -> tuple[float, float]:
    """Return simulated seconds per second of a recorded run, and frames drawn per second; None: without a page."""
    import qrsim
    from qrsim.runs.recorder import fly
    from qrsim.view.clock import Clock
    from qrsim.view.live import LiveView

    scenario = qrsim.load_scenario(_common.patrol(count), [f"duration={duration}"], quiet=True)
    view = None if browsers is None else LiveView(0, Clock(float("inf")))
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        if view is not None:
            stack.callback(view.close)
            stack.enter_context(clients(view.address, browsers or 0))
        pace = fly(scenario, Path(folder) / "run", seed=1, precision="float32", view=view)
        drawn = 0 if view is None or view._page is None else view._page.drawn
    return pace.real_time_factor, drawn / pace.wall_s


def slowdown(count: int, duration: float, repeats: int) -> list[dict[str, Any]]:
    """Fly without a page, and with one that one browser or two look at, in turns; return medians and spread."""
    factor(count, 1.0, None)
    speeds: dict[int, list[float]] = {0: [], 1: [], 2: []}
    frames: dict[int, list[float]] = {0: [], 1: [], 2: []}
    for _ in range(repeats):
        for browsers in speeds:
            speed, drawn = factor(count, duration, browsers or None)
            speeds[browsers].append(speed)
            frames[browsers].append(drawn)
    named = [("run, times real time" if not n else "run with page", n, found) for n, found in speeds.items()]
    named += [("its frames", n, found) for n, found in frames.items() if n]
    return [
        {
            "what": what,
            "vehicles": count,
            "clients": browsers,
            "cpu_ms": None,
            "client_bytes_per_second": None,
            "missed": None,
            "lag_s": None,
            "per_second": statistics.median(found),
            "lowest": min(found),
            "highest": max(found),
        }
        for what, browsers, found in named
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    chosen = _common.options(__doc__ or "", arguments)
    on = _common.machine()
    sizes, seconds = ((2,), 0.5) if chosen.quick else ((1, 5, 50, 51, 1000, 10_000), 10.0)
    results = [
        updates(count, browsers, seconds, pace) for count in sizes for browsers in (0, 2) for pace in (FRAMES_HZ, None)
    ]
    results += [
        updates(count, 1, seconds if chosen.quick else 20.0, FRAMES_HZ, SLOW_BITS_PER_SECOND)
        for count in (sizes if chosen.quick else (5, 1000))
    ]
    results += slowdown(2, 2.0, 1) if chosen.quick else slowdown(1000, 60.0, 5)
    title = "The 3-D page, server side; every frame differs from the last"
    _common.publish("view", title, on, results, HEADINGS, chosen.json)
    if not chosen.json:
        runs = {row["clients"]: row["per_second"] for row in results if row["what"].startswith("run")}
        for browsers in (1, 2):
            slower = 1.0 - runs[browsers] / runs[0]
            print(f"with a page and {browsers} browser(s) the run is {100.0 * slower:.1f} % slower (medians)")


if __name__ == "__main__":
    main()
