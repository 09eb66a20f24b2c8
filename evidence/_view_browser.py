"""The 3-D page in a real browser: first frame, scrubbing, many vehicles, an hour.

A browser without a graphics card spends its time on pixels, which says nothing about the page. So its calls that draw
are counted and left out here. Everything else is as usual: messages, scripts, layout, and uploads to the graphics card.
Costs are processor time of the page's main thread, because the wall clock depends on what else the machine does.
"""

from __future__ import annotations

import contextlib
import os
import pty
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil

from qrsim.runs import open_run
from qrsim.view.browser import Browser
from qrsim.view.clock import SPEEDS, Clock
from qrsim.view.live import LiveView
from qrsim.view.page import Page
from qrsim.view.replay import Replay
from qrsim.view.server import address, start_server
from qrsim.view.several import open_several

PATIENCE_S = 180.0
# Replaces what draws, and notes when the page first names what it loads, when it shows the scene, and its frames.
COUNTING = """
const drawn = window.qrsimDrawn = {frames: 0, calls: 0, corners: 0, loading: null, words: "", framed: null};
const call = (corners) => { drawn.calls += 1; drawn.corners += corners; };
Object.assign(WebGL2RenderingContext.prototype, {
  drawElements: (mode, count) => call(count), drawArrays: (mode, first, count) => call(count),
  drawElementsInstanced: (mode, count, type, offset, times) => call(count * times),
  drawArraysInstanced: (mode, first, count, times) => call(count * times),
});
const look = () => {
  const words = document.getElementById("qrsim-loading");
  if (words && drawn.loading === null) Object.assign(drawn, {loading: performance.now(), words: words.textContent});
  if (window.qrsim?.state?.framed) drawn.framed ??= performance.now();
  drawn.frames += 1;
  requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
CLI = "import sys; from qrsim import cli; sys.exit(cli.main(sys.argv[1:]))"


class Watched(Browser):
    """A browser that keeps the errors of its page.

    Attributes:
        errors: exceptions, and errors on the console.
    """

    def __init__(self, width: int = 1280, height: int = 800):
        super().__init__(width, height)
        self.errors: list[str] = []

    def __enter__(self) -> Watched:
        super().__enter__()
        for domain in ("Runtime", "Log", "Performance", "HeapProfiler"):
            self.call(f"{domain}.enable")
        return self

    def _note(self, method: str, parameters: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(parameters["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] == "error":
            self.errors.append(str(parameters["args"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(str(parameters["entry"]))
        super()._note(method, parameters)

    def heap(self) -> float:
        """Return the heap of the page's scripts after a collection [bytes]."""
        for _ in range(2):
            self.call("HeapProfiler.collectGarbage")
        metrics = self.call("Performance.getMetrics")["metrics"]
        return float(next(own["value"] for own in metrics if own["name"] == "JSHeapUsedSize"))

    def processor_s(self) -> float:
        """Return the processor time of the page's main thread [s]."""
        pages = [
            process
            for process in psutil.Process(self._process.pid).children(recursive=True)
            if "--type=renderer" in process.cmdline()
        ]
        own = [thread for page in pages for thread in page.threads() if thread.id == page.pid]
        return float(sum(thread.user_time + thread.system_time for thread in own))

    def look(self, url: str) -> dict[str, float]:
        """Open a page whose drawing is counted, and return when it names what it loads, and when it shows the scene.

        By the wall clock [ms] from the navigation on, and in processor time of the page's main thread [s].
        """
        self.call("Page.addScriptToEvaluateOnNewDocument", source=COUNTING)
        began, used = self.processor_s(), {}
        self.open(f"{url}/?fixedDpr=1")
        for name in ("loading", "framed"):
            eventually(lambda: self.evaluate(f"(window.qrsimDrawn?.{name} ?? window.qrsimDrawn?.framed) != null"))  # noqa: B023
            used[f"{name}_processor_s"] = self.processor_s() - began
        return {**self.evaluate("({...qrsimDrawn})"), **used}

    def spent(self, act: Callable[[], object]) -> dict[str, float]:
        """Act, and return processor time of the page's main thread [s], wall time [s], frames, calls and corners."""
        before, began, wall = self.evaluate("({...qrsimDrawn})"), self.processor_s(), time.perf_counter()
        act()
        wall, used = time.perf_counter() - wall, self.processor_s() - began
        after = self.evaluate("({...qrsimDrawn})")
        counts = {name: after[name] - before[name] for name in ("frames", "calls", "corners")}
        return {"processor_s": used, "wall_s": wall, **counts}


def eventually(condition: Callable[[], object]) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError("the page did not become what was waited for")
        time.sleep(0.02)


@contextlib.contextmanager
def replayed(*folders: Path) -> Iterator[Replay]:
    """Serve a replay of runs that plays when its clock does."""
    recording, _ = open_several(list(folders), open_run)
    server, clock = start_server(0), Clock(playing=False, speeds=SPEEDS[:-1])
    found = Replay(recording, Page(server, recording.cast, recording.world, recording.heading, clock), clock)
    stop = threading.Event()
    playing = threading.Thread(target=found.run, args=(stop,), daemon=True)
    playing.start()
    try:
        yield found
    finally:
        stop.set()
        clock.close()
        playing.join(10.0)
        server.stop()


def opening(*folders: Path) -> dict[str, float]:
    """Run ``qrsim view`` in a terminal, and return when its page names what it loads, and when it is whole."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", CLI, "view", *map(str, folders), "--port", "0"]
    with Watched() as browser, contextlib.ExitStack() as stack:
        process = subprocess.Popen(command, stdout=theirs, stderr=theirs, stdin=subprocess.DEVNULL)
        stack.callback(process.wait, 20.0)
        stack.callback(process.terminate)
        stack.callback(os.close, ours)
        stack.callback(os.close, theirs)
        printed = b""
        while b"http://" not in printed or not printed.endswith(b"\n"):
            printed += os.read(ours, 4096)
        seen = browser.look(next(word for word in printed.decode().split() if word.startswith("http://")))
        server = psutil.Process(process.pid).cpu_times()
        assert all(folder.name in str(seen["words"]) for folder in folders), seen["words"]
    return {
        "names_what_it_loads_s": round(1e-3 * seen["loading"], 2),
        "whole_s": round(1e-3 * seen["framed"], 2),
        "page_processor_until_it_names_s": round(seen["loading_processor_s"], 2),
        "page_processor_s": round(seen["framed_processor_s"], 2),
        "command_processor_s": round(server.user + server.system, 2),
    }


def scrubbing(folders: tuple[Path, ...], seeks: int) -> dict[str, float]:
    """Go to random times of runs over each other, and return what each costs page and server."""
    where = random.Random(1)
    with replayed(*folders) as replay, Watched() as browser:
        browser.look(address(replay.page.server))

        def scrub() -> None:
            for _ in range(seeks):
                replay.seek(where.random() * replay.recording.end, everything=False)
                browser.evaluate(DRAWN)

        scrub()
        began = time.process_time()
        found = browser.spent(scrub)
        server = time.process_time() - began
        errors = len(browser.errors)
    return {
        "page_ms_a_seek": round(1e3 * found["processor_s"] / seeks, 1),
        "server_ms_a_seek": round(1e3 * server / seeks, 1),
        "draw_calls_a_frame": round(found["calls"] / found["frames"], 1),
        "errors": errors,
    }


def playing(folder: Path, seconds: float) -> dict[str, float]:
    """Play a run in real time, and return what each frame costs the page."""
    with replayed(folder) as replay, Watched() as browser:
        browser.look(address(replay.page.server))

        def play() -> None:
            replay.clock.playing = True
            time.sleep(seconds)
            replay.clock.playing = False

        before = replay.page.drawn
        found = browser.spent(play)
        drawn, errors = replay.page.drawn - before, len(browser.errors)
    return {
        "frames_per_second": round(min(found["frames"], drawn) / found["wall_s"], 1),
        "page_ms_a_frame": round(1e3 * found["processor_s"] / min(found["frames"], drawn), 1),
        "draw_calls_a_frame": round(found["calls"] / found["frames"], 1),
        "triangles_a_frame": round(found["corners"] / 3.0 / found["frames"]),
        "errors": errors,
    }


def hour(view: LiveView, seconds: float) -> dict[str, float]:
    """Look at a live flight until its end; return the heap of the page's scripts after a sixth of it and at its end."""

    def flown() -> float:
        frame = None if view._page is None else view._page.scene.frame
        return 0.0 if frame is None else frame.time

    with Watched() as browser:
        browser.look(view.address)
        eventually(lambda: flown() > seconds / 6.0)
        first = browser.heap()
        eventually(lambda: flown() > 0.95 * seconds)
        last, errors = browser.heap(), len(browser.errors)
    return {
        "heap_after_a_sixth_megabytes": round(1e-6 * first, 1),
        "heap_at_end_megabytes": round(1e-6 * last, 1),
        "errors": errors,
    }
