"""The timeline of a replay, by its wishes and in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from evidence._view_browser import Watched
from tests.apps.conftest import DURATION, Flight

from qrsim.runs import open_run
from qrsim.runs.layout import Event
from qrsim.view.browser import INSTALL, find_browser
from qrsim.view.clock import SPEEDS, Clock
from qrsim.view.page import Page
from qrsim.view.recording import Recording
from qrsim.view.replay import Replay
from qrsim.view.server import address, start_server
from qrsim.view.timeline import marks


@pytest.fixture
def replay(flown: Flight) -> Any:
    recording, server = Recording(open_run(flown.folder)), start_server(0)
    clock = Clock(playing=False, speeds=SPEEDS[:-1])
    page = Page(server, recording.cast, recording.world, recording.heading, clock)
    yield Replay(recording, page, clock)
    server.stop()


def eventually(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)


def test_wishes(replay: Any):
    wish, clock = replay._timeline.wish, replay.clock
    wish({"time": 4.0})
    assert replay.page.scene.frame.time == pytest.approx(4.0)
    wish({"time": 1e9})
    assert replay.time == pytest.approx(DURATION)
    wish({"play": True, "faster": 1})
    assert (clock.playing, clock.speed) == (True, 2.0)
    wish({"faster": -1, "play": False})
    assert (clock.playing, clock.speed) == (False, 1.0)
    for nonsense in (None, [], {"time": "now"}, {"time": float("nan")}, {"play": 3, "faster": 7}):
        wish(nonsense)
    assert (replay.time, clock.playing, clock.speed) == (pytest.approx(DURATION), False, 1.0)


def test_marks_are_what_is_rare():
    def event(kind: str, number: int) -> Event:
        return Event(float(number), number, "v", kind, None, None, f"{kind} {number}")

    found = marks([event("waypoint_reached", 1), event("collision", 2), event("wind_changed", 3)])
    assert found == [(2.0, "collision 2"), (3.0, "wind_changed 3")]
    assert len(marks([event("collision", number) for number in range(5000)])) <= 300


@pytest.mark.long
@pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}")
def test_keys_and_the_mouse_in_a_browser(replay: Any):
    clock = replay.clock
    with Watched(800, 600) as browser:
        browser.look(address(replay.page.server))
        eventually(lambda: bool(browser.evaluate("!!document.getElementById('qrsim-timeline')")))
        whole = "document.getElementById('qrsim-timeline').getBoundingClientRect().width"
        eventually(lambda: browser.evaluate(whole) == 800)

        def press(key: str) -> None:
            browser.evaluate(f"window.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")

        press("5")
        eventually(lambda: replay.time == pytest.approx(0.5 * DURATION))
        press("1")
        eventually(lambda: replay.time == pytest.approx(0.1 * DURATION))
        press(" ")
        eventually(lambda: clock.playing)
        press("ArrowUp")
        eventually(lambda: clock.speed == 2.0)
        # The bar of time is the second child; its length depends on the fonts of the texts beside it.
        left, width = browser.evaluate(
            "(b => [b.left, b.width])(document.querySelector('#qrsim-timeline > div').getBoundingClientRect())"
        )
        assert width > 300
        browser.click(left + 0.5 * width, browser.evaluate("innerHeight") - 17.0)
        eventually(lambda: 0.45 * DURATION < replay.time < 0.55 * DURATION)
        assert "2 x" in browser.evaluate("document.getElementById('qrsim-timeline').innerText")
        # A number that is typed in the panel replaces the one before, and is not overwritten between its digits.
        press(" ")
        eventually(lambda: not clock.playing)
        field = (
            "(r => [r.left + r.width / 2, r.top + r.height / 2])(document.querySelector('.mantine-NumberInput-input')"
        )
        for typed in ("7.5", "2.52"):
            browser.click(*browser.evaluate(f"{field}.getBoundingClientRect())"))
            for letter in typed:
                browser.call("Input.dispatchKeyEvent", type="char", text=letter)
            for kind in ("keyDown", "keyUp"):
                browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", windowsVirtualKeyCode=13)
            eventually(lambda: replay.time == pytest.approx(float(typed)))  # noqa: B023


def test_while_the_bar_is_dragged_paths_wait(replay: Any):
    """They are most of what a jump sends."""
    wish, paths = replay._timeline.wish, replay.page.scene.paths[0]
    wish({"time": 5.0})
    assert not paths._changed
    for time_s in (2.0, 8.0):
        wish({"time": time_s, "drag": True})
    assert replay.page.scene.frame.time == pytest.approx(8.0)
    assert paths._changed
    wish({"time": 8.0})
    assert not paths._changed
