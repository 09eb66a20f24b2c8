"""A page that is open for long: memory of browser and server over many seeks, and browsers that sleep."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from evidence._processes import resident_bytes
from evidence._view_browser import Watched
from tests.apps.conftest import Flight, flying

from qrsim.runs import open_run
from qrsim.view.browser import INSTALL, find_browser
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
def browser() -> Iterator[Watched]:
    with Watched(800, 600) as found:
        yield found


@pytest.fixture
def replay(flown: Flight, browser: Watched) -> Iterator[Replay]:
    """A replay of five vehicles that a browser shows, with plots open."""
    recording, server = Recording(open_run(flown.folder)), start_server(0)
    clock = Clock(playing=False)
    found = Replay(recording, Page(server, recording.cast, recording.world, recording.heading, clock), clock)
    browser.look(address(server))
    eventually(lambda: browser.evaluate("!!window.qrsimPlots"))
    browser.evaluate("window.qrsimPlots.toggle(true)")
    yield found
    server.stop()


def shown(browser: Watched) -> str:
    """Return the time that the timeline shows, such as "00:02.50"."""
    return str(browser.evaluate("document.querySelector('#qrsim-timeline span').textContent")).split(" ")[0]


def written(browser: Watched) -> float:
    """Return the time that the panel shows [s]; NaN before it is there."""
    found = re.search(r"t = ([\d.]+) s", str(browser.evaluate("document.body.innerText")))
    return float(found[1]) if found else float("nan")


def seek(replay: Replay, browser: Watched, count: int) -> None:
    """Go to many times, as fast as the browser follows, and end at 2.5 s."""
    for number in range(count):
        replay.seek(0.37 * number % 10.0, everything=number % 3 == 0)
        if number % 10 == 0:
            browser.evaluate("new Promise(done => setTimeout(done, 30))")
    replay.seek(2.5)
    eventually(lambda: shown(browser) == "00:02.50")


def test_memory_over_many_seeks(replay: Replay, browser: Watched) -> None:
    seek(replay, browser, SEEKS // 3)
    page, server = browser.heap(), resident_bytes()
    seek(replay, browser, SEEKS)
    # A frame of five vehicles is some 10 kB; kept, these would be over 9 MB.
    assert browser.heap() - page < 3e6
    assert resident_bytes() - server < 20e6
    assert browser.errors == []


def test_a_browser_that_sleeps_comes_back_to_the_present(replay: Replay, browser: Watched) -> None:
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
    eventually(lambda: shown(browser) == "00:07.50")
    eventually(lambda: "t = 7.50 s" in str(browser.evaluate("document.body.innerText")))
    # The page is whole again: vehicles, timeline, plots.
    eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed && window.qrsimPlots.state.open"))
    assert len(replay.page.server.get_clients()) == 1


def test_a_browser_that_sleeps_through_a_live_flight_comes_back_to_the_present(
    tmp_path: Path, browser: Watched
) -> None:
    """Some twenty minutes of flight, in which the server ends its connection."""
    with flying(tmp_path / "run", 3600.0, Clock(50.0)) as (view, _):
        browser.look(view.address)

        def flown() -> float:
            frame = None if view._page is None else view._page.scene.frame
            return 0.0 if frame is None else frame.time

        # Paths are as long as they get after a minute, and buffers of the log as large after some flushes.
        eventually(lambda: flown() > 300.0)
        buffer = view._server._websock_server._broadcast_buffer
        waiting, memory, before = len(buffer.message_from_id), resident_bytes(), flown()
        browser.call("Page.setWebLifecycleState", state="frozen")
        time.sleep(ASLEEP_S)
        assert flown() - before > 300.0
        # Only the newest of each message waits.
        assert len(buffer.message_from_id) <= waiting + 20
        assert resident_bytes() - memory < 30e6
        browser.call("Page.setWebLifecycleState", state="active")
        browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
        # Soon it shows what is drawn now, and goes on with the flight.
        for _ in range(2):
            eventually(lambda: abs(written(browser) - flown()) < 100.0)
            now = flown()
            eventually(lambda: flown() > now + 20.0)  # noqa: B023
        assert len(view._server.get_clients()) == 1
        # That a frozen page loses its connections, the browser itself says.
        assert [error for error in browser.errors if "Back-Forward Cache" not in error] == []
