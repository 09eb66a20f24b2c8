"""A page that is open for long: memory of browser and server over many seeks, and a browser that sleeps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
from evidence._processes import resident_bytes
from tests.apps.conftest import Flight

from qrsim.runs import open_run
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.clock import Clock
from qrsim.view.page import Page
from qrsim.view.recording import Recording
from qrsim.view.replay import Replay
from qrsim.view.server import address, start_server

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
PATIENCE_S = 120.0
# An hour in which somebody moves the time every few seconds.
SEEKS = 900
# The server ends a connection that has not answered for 20 s.
ASLEEP_S = 25.0


def eventually(condition: Callable[[], object]) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.1)


@pytest.fixture
def browser() -> Iterator[Browser]:
    with Browser(800, 600) as found:
        yield found


@pytest.fixture
def replay(flown: Flight, browser: Browser) -> Iterator[Replay]:
    """A replay of five vehicles that a browser shows, with plots open."""
    recording, server = Recording(open_run(flown.folder)), start_server(0)
    clock = Clock(playing=False)
    found = Replay(recording, Page(server, recording.cast, recording.world, recording.heading, clock), clock)
    browser.open(f"{address(server)}/?fixedDpr=1")
    eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed && !!window.qrsimPlots"))
    browser.evaluate("window.qrsimPlots.toggle(true)")
    yield found
    server.stop()


def shown(browser: Browser) -> str:
    """Return the time that the timeline shows, such as "00:02.5"."""
    return str(browser.evaluate("document.querySelector('#qrsim-timeline span').textContent")).split(" ")[0]


def heap(browser: Browser) -> float:
    """Return the heap of the page after a collection [bytes]."""
    for _ in range(2):
        browser.call("HeapProfiler.collectGarbage")
    metrics = browser.call("Performance.getMetrics")["metrics"]
    return float(next(own["value"] for own in metrics if own["name"] == "JSHeapUsedSize"))


def seek(replay: Replay, browser: Browser, count: int) -> None:
    """Go to many times, as fast as the browser follows, and end at 2.5 s."""
    for number in range(count):
        replay.seek(0.37 * number % 10.0, everything=number % 3 == 0)
        if number % 10 == 0:
            browser.evaluate("new Promise(done => setTimeout(done, 30))")
    replay.seek(2.5)
    eventually(lambda: shown(browser) == "00:02.5")


def test_memory_over_many_seeks(replay: Replay, browser: Browser) -> None:
    browser.call("Performance.enable")
    browser.call("HeapProfiler.enable")
    seek(replay, browser, SEEKS // 3)
    page, server = heap(browser), resident_bytes()
    seek(replay, browser, SEEKS)
    # A frame of five vehicles is some 10 kB; kept, these would be over 9 MB.
    assert heap(browser) - page < 3e6
    assert resident_bytes() - server < 20e6


def test_a_browser_that_sleeps_comes_back_to_the_present(replay: Replay, browser: Browser) -> None:
    seek(replay, browser, 30)
    buffer = replay.page.server._websock_server._broadcast_buffer
    waiting, memory = len(buffer.message_from_id), resident_bytes()
    browser.call("Page.setWebLifecycleState", state="frozen")
    end, number = time.monotonic() + ASLEEP_S, 0
    while time.monotonic() < end:
        number += 1
        replay.seek(0.37 * number % 10.0, everything=False)
        time.sleep(0.03)
    # Only the newest of each message waits: nothing of the frames in between.
    assert len(buffer.message_from_id) <= waiting + 20
    assert resident_bytes() - memory < 10e6
    replay.seek(7.5)
    browser.call("Page.setWebLifecycleState", state="active")
    browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
    eventually(lambda: shown(browser) == "00:07.5")
    eventually(lambda: "t = 7.50 s" in str(browser.evaluate("document.body.innerText")))
    # The page is whole again: vehicles, timeline, plots.
    eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed && window.qrsimPlots.state.open"))
    assert len(replay.page.server.get_clients()) == 1
