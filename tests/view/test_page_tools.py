"""The tools of the page in a browser: colours, labels, measuring, views, hostile names; one page holds all of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.view.test_first_sight import Shown, eventually, look, rectangles

from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.paint import Paint

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
HOSTILE = "<img src=x onerror='window.beacon = 1'>"


class Watched(Browser):
    """A browser that keeps the errors of its console."""

    def __init__(self, *size: int):
        super().__init__(*size)
        self.errors: list[str] = []

    def _note(self, method: str, parameters: dict[str, Any]) -> None:
        super()._note(method, parameters)
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(parameters["exceptionDetails"])[:500])


@pytest.fixture(scope="module")
def browser() -> Iterator[Watched]:
    with Watched(1280, 800) as found:
        found.call("Runtime.enable")
        yield found


def test_tools_of_the_page(browser: Watched) -> None:
    shown = Shown(3)
    try:
        scene = shown.page.scene
        look(browser, shown)
        size = np.array([0.0, 5.0, 10.0])
        scene.colour(Paint(HOSTILE, "m/s", 0.0, 10.0, (True, False), lambda times: np.tile(size, (len(times), 1))))
        bar = "document.querySelector('.qrsim-bar').innerText"
        eventually(lambda: HOSTILE in browser.evaluate(bar))
        assert "\u2264 0" in browser.evaluate(bar)
        assert "10" in browser.evaluate(bar)
        # Labels have the lines that are told, as text.
        scene.overlay.states({0: [HOSTILE], 1: ["5.0 m/s"]})
        labels = "[...document.querySelectorAll('.qrsim-label')].map(e => e.innerText).join('|')"
        eventually(lambda: "5.0 m/s" in browser.evaluate(labels))
        assert HOSTILE in browser.evaluate(labels)
        assert browser.evaluate("window.beacon ?? 0") == 0
        # Below the vehicles there is the ground.
        box = "document.querySelector('canvas').getBoundingClientRect()"
        ground = f"JSON.stringify(window.qrsim.tools.groundAt(640, 600, {box}))"
        assert abs(json.loads(browser.evaluate(ground))[2]) < 1e-3
        press = "[...document.querySelectorAll('.qrsim-tools button')].find(b => b.innerText == 'Measure').click()"
        browser.evaluate(press)
        for x, y in ((300.0, 700.0), (500.0, 650.0)):
            browser.click(x, y)
        words = "document.querySelector('.qrsim-measured').innerText"
        eventually(lambda: "level" in browser.evaluate(words))
        assert "bearing" in browser.evaluate(words)
        browser.evaluate(press)
        # Chase: 4 spans behind the vehicle, which looks north, and 1.4 above it.
        scene.choose(1)
        browser.evaluate("window.qrsim.choose(1); window.qrsim.tools.go('Chase')")
        eye = "JSON.stringify(window.__viserMutable.camera.position.clone().applyMatrix4(" + (
            "window.__viserMutable.nodeRefFromName['/world'].matrixWorld.clone().invert()).toArray())"
        )
        wanted = shown.frame.position_ned[1] + scene.stage.span * np.array([-4.0, 0.0, -1.4])
        eventually(lambda: np.allclose(json.loads(browser.evaluate(eye)), wanted, atol=0.5))
        # Stored views that are damaged are ignored, and a view that is saved is offered again.
        browser.evaluate("localStorage.setItem('qrsim-views patrol of 3', '[{\"eye\": [1, \"x\"]}, 7]')")
        browser.evaluate("window.qrsim.tools.go('save')")
        views = "[...document.querySelectorAll('.qrsim-views option')].map(o => o.innerText).join('|')"
        assert (
            browser.evaluate(views)
            == "View|Overview|Top|Follow|Chase|Onboard|Saved 1|Save this view|Forget saved views"
        )
        browser.evaluate("window.qrsim.tools.go('forget')")
        assert "Saved" not in browser.evaluate(views)
        # On a phone the tools stay inside.
        shown.page.draw(replace(shown.frame, time=2.0), everything=True)
        look(browser, shown, 390, 844)
        for left, _, right, _ in rectangles(browser, ".qrsim-tools button, .qrsim-tools select, .qrsim-bar"):
            assert left >= 0.0
            assert right <= 390.0
        assert browser.errors == []
    finally:
        shown.server.stop()
