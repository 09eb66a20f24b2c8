"""Live pages and replays in real browsers: the end of a run, keys, two browsers, other origins, memory."""

from __future__ import annotations

import resource
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.apps.conftest import DURATION, Flight, flying

from qrsim.runs import open_run
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.clock import SPEEDS, Clock
from qrsim.view.page import Page
from qrsim.view.recording import Recording
from qrsim.view.replay import Replay
from qrsim.view.server import address, start_server

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
PATIENCE_S = 90.0
KEYS = {" ": "Space", "ArrowLeft": "ArrowLeft", "ArrowRight": "ArrowRight", "ArrowUp": "ArrowUp"}


def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)


def text(browser: Browser) -> str:
    """Return what a page says."""
    return str(browser.evaluate("document.body.innerText"))


def press(browser: Browser, key: str, shift: bool = False) -> None:
    """Press a key as a keyboard does."""
    code = KEYS.get(key, f"Digit{key}" if key.isdigit() else key)
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, modifiers=8 if shift else 0)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(800, 600) as found:
        yield found


@pytest.fixture(scope="module")
def replay(flown: Flight, browser: Browser) -> Iterator[Replay]:
    """A replay that somebody looks at; a page takes seconds to load."""
    recording, server = Recording(open_run(flown.folder)), start_server(0)
    clock = Clock(playing=False, speeds=SPEEDS[:-1])
    found = Replay(recording, Page(server, recording.cast, recording.world, recording.heading, clock), clock)
    stop = threading.Event()
    playing = threading.Thread(target=found.run, args=(stop,))
    playing.start()
    browser.open(f"{address(server)}/?fixedDpr=1")
    eventually(lambda: bool(browser.evaluate("!!window.qrsimTime && !!document.getElementById('qrsim-timeline')")))
    eventually(lambda: "5 of 5 vehicles fly" in text(browser))
    yield found
    stop.set()
    clock.close()
    playing.join(10.0)
    server.stop()


def test_the_page_says_that_the_flight_has_ended_and_replays_it(tmp_path: Path, browser: Browser):
    with flying(tmp_path / "run", 3.0, Clock(1.0)) as (view, flight):
        browser.open(f"{view.address}/?fixedDpr=1")
        eventually(lambda: "2 of 2 vehicles fly" in text(browser))
        assert not browser.evaluate("!!document.getElementById('qrsim-timeline')")
        flight.join(60.0)
        view.replay(Recording(open_run(tmp_path / "run")))
        eventually(lambda: "The flight has ended, at 3 s. This is its replay." in text(browser))
        eventually(lambda: bool(browser.evaluate("!!window.qrsimTime")))
        replayed, clock = view._page, view.clock
        assert replayed is not None
        assert clock is not None
        # The same browser plays it again, from the begin.
        press(browser, " ")
        eventually(lambda: replayed.scene.frame is not None and 0.0 < replayed.scene.frame.time < 2.5)
        assert clock.playing
        eventually(lambda: not clock.playing)
        # The clock stops before the last frame is drawn.
        eventually(lambda: replayed.scene.frame is not None and replayed.scene.frame.time == pytest.approx(3.0))
        browser.open("about:blank")


def test_keys_go_through_a_replay(replay: Replay, browser: Browser):
    for tenth in range(1, 10):
        press(browser, str(tenth))
        eventually(lambda: replay.time == pytest.approx(0.1 * tenth * DURATION))  # noqa: B023
        eventually(lambda: f"t = {0.1 * tenth * DURATION:.2f} s (paused)" in text(browser))  # noqa: B023
    # Five seconds back and forth, and at most to the ends; with Shift a minute.
    for key, shift, time_s in (
        ("ArrowLeft", False, 4.0),
        ("ArrowRight", False, 9.0),
        ("ArrowRight", False, 10.0),
        ("ArrowLeft", True, 0.0),
        ("ArrowRight", True, 10.0),
        ("5", False, 5.0),
    ):
        press(browser, key, shift)
        eventually(lambda: replay.time == pytest.approx(time_s))  # noqa: B023
        eventually(lambda: f"t = {time_s:.2f} s (paused)" in text(browser))  # noqa: B023
    for key, speed in (("ArrowUp", 2.0), ("ArrowUp", 5.0), ("ArrowDown", 2.0), ("ArrowDown", 1.0), ("ArrowDown", 0.5)):
        press(browser, key)
        eventually(lambda: replay.clock.speed == speed)  # noqa: B023
    press(browser, " ")
    eventually(lambda: replay.clock.playing)
    eventually(lambda: replay.time > 5.5)
    press(browser, " ")
    eventually(lambda: not replay.clock.playing)


def test_the_mouse_drags_along_the_timeline(replay: Replay, browser: Browser):
    track = "document.querySelector('#qrsim-timeline > div').getBoundingClientRect()"
    left, width = browser.evaluate(f"{track}.left"), browser.evaluate(f"{track}.width")
    height = browser.evaluate(f"{track}.top + 0.5 * {track}.height")

    def mouse(kind: str, share: float) -> None:
        place = {"x": left + share * width, "y": height}
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **place)

    mouse("mousePressed", 0.2)
    eventually(lambda: replay.time == pytest.approx(2.0, abs=0.1))
    mouse("mouseMoved", 0.6)
    eventually(lambda: replay.time == pytest.approx(6.0, abs=0.1))
    mouse("mouseReleased", 0.75)
    eventually(lambda: replay.time == pytest.approx(7.5, abs=0.1))


def test_two_browsers_see_the_same_time_each_from_its_own_place(replay: Replay, browser: Browser):
    server = replay.page.server
    eventually(lambda: len(server.get_clients()) == 1)
    first = next(iter(server.get_clients().values()))
    with Browser(640, 480) as other:
        other.open(f"{address(server)}/?fixedDpr=1")
        eventually(lambda: "5 of 5 vehicles fly" in text(other))
        eventually(lambda: len(server.get_clients()) == 2)
        second = next(client for number, client in server.get_clients().items() if number != first.client_id)
        press(other, "3")
        for each in (browser, other):
            eventually(lambda: "t = 3.00 s (paused)" in text(each))  # noqa: B023
        eventually(lambda: bool(second.camera.image_width))
        before = np.array(first.camera.position)
        # Turned with the mouse in one of them.
        for kind, x in (("mousePressed", 200), ("mouseMoved", 240), ("mouseMoved", 300), ("mouseReleased", 300)):
            other.call("Input.dispatchMouseEvent", type=kind, x=x, y=260, button="left", buttons=1, clickCount=1)
            time.sleep(0.1)
        eventually(lambda: not np.allclose(second.camera.position, before, rtol=0.02))
        np.testing.assert_allclose(first.camera.position, before, rtol=1e-3)
    # One that goes is no matter for the other.
    eventually(lambda: len(server.get_clients()) == 1)
    press(browser, "6")
    eventually(lambda: "t = 6.00 s (paused)" in text(browser))


def test_a_page_of_another_origin_cannot_connect(replay: Replay, tmp_path: Path, browser: Browser):
    """By the scripts of a file, of a page without an origin, and of the page itself."""
    server = replay.page.server
    port = server.get_port()
    (tmp_path / "evil.html").write_text("<!doctype html><title>evil</title>", encoding="utf-8")

    def answer(path: str, *protocols: str) -> Any:
        return browser.evaluate(
            f"new Promise(done => {{const s = new WebSocket('ws://127.0.0.1:{port}{path}', {list(protocols)});"
            "s.onopen = () => done('open'); s.onerror = () => done('refused')})"
        )

    import viser

    protocol = f"viser-v{viser.__version__}"
    assert answer("/timeline") == "open"
    assert answer("", protocol) == "open"
    for page in ((tmp_path / "evil.html").as_uri(), "data:text/html,<title>evil</title>"):
        browser.open(page)
        eventually(lambda: browser.evaluate("document.title") == "evil")
        assert answer("/timeline") == "refused"
        assert answer("", protocol) == "refused"


@pytest.mark.nightly
def test_memory_stays_over_a_long_live_run(tmp_path: Path, browser: Browser):
    """900 s at fifty times the wall clock: of the browser's scripts after a collection, and of this process."""

    def heap() -> float:
        browser.call("HeapProfiler.collectGarbage")
        return float(browser.evaluate("performance.memory.usedJSHeapSize"))

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text("utf-8").split()[1]) * resource.getpagesize()

    with flying(tmp_path / "run", 900.0, Clock(50.0)) as (view, flight):
        browser.open(f"{view.address}/?fixedDpr=1")
        eventually(lambda: "2 of 2 vehicles fly" in text(browser))

        def flown() -> float:
            frame = None if view._page is None else view._page.scene.frame
            return 0.0 if frame is None else frame.time

        # Paths are as long as they get after a minute, and buffers of the log as large after some flushes.
        eventually(lambda: flown() > 300.0)
        before = heap(), min(resident() for _ in range(20))
        eventually(lambda: flown() > 850.0 or not flight.is_alive())
        after = heap(), min(resident() for _ in range(20))
    assert after[0] < 1.25 * before[0]
    assert after[1] < 1.1 * before[1]
