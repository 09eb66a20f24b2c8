"""The tools of the page in a browser: colours, labels, measuring, views, hostile names; one page holds all of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.view.test_first_sight import Shown, eventually, look, rectangles

from qrsim.view import shapes
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.paint import Paint

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
KEY = "window.dispatchEvent(new KeyboardEvent('keydown', {key: 't', bubbles: true}))"
# Where a place NED is on the canvas.
PIXEL = """(ned => {
  const m = window.__viserMutable, at = new m.camera.position.constructor(...ned);
  const { x, y } = at.applyMatrix4(m.nodeRefFromName["/world"].matrixWorld).project(m.camera);
  return [(x + 1) * m.canvas.clientWidth / 2, (1 - y) * m.canvas.clientHeight / 2];
})"""
INSIDE = ".qrsim-tools button, .qrsim-tools select, .qrsim-bar, .qrsim-table"
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


def ask(browser: Watched, source: str) -> Any:
    """Return the value of an expression in the page."""
    return json.loads(browser.evaluate(f"JSON.stringify({source})"))


def map_from_the_top(browser: Watched, shown: Shown) -> None:
    """North is up, lengths are right at all heights, and a building of 20 x 20 x 15 m has its roof and its corners."""
    scene = shown.page.scene
    unit = shapes.box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    middle, size = np.array([[30.0, -10.0, -7.5]]), np.array([[20.0, 20.0, 15.0]])
    scene.layers["obstacles"].several("boxes", unit, middle, shapes.linear((150, 140, 130)), size)
    browser.evaluate("window.qrsim.tools.go('Top')")

    def pixel(*ned: float) -> np.ndarray:
        return np.array(ask(browser, f"{PIXEL}({[float(value) for value in ned]})"))

    # Once it is drawn from there, what is over each other is at one pixel.
    eventually(lambda: np.abs(pixel(100, 0, 0) - pixel(100, 0, -10)).max() < 1.0)
    origin, north, east, high = pixel(0, 0, 0), pixel(100, 0, 0), pixel(0, 100, 0), pixel(100, 0, -60)
    per_metre = (origin[1] - north[1]) / 100.0
    assert abs(north[0] - origin[0]) < 0.1
    np.testing.assert_allclose(east - origin, [100.0 * per_metre, 0.0], atol=0.1)
    np.testing.assert_allclose(high, north, atol=0.02 * 100.0 * per_metre)
    bar = "document.querySelector('div.qrsim-scale')"
    metres, unit_name = browser.evaluate(f"{bar}.querySelector('span').innerText").split()
    width = float(browser.evaluate(f"{bar}.querySelector('div').style.width").removesuffix("px"))
    assert unit_name == "m"
    assert width == pytest.approx(float(metres) * per_metre, rel=0.02)
    # What is under a pixel of it.
    box = "document.querySelector('canvas').getBoundingClientRect()"
    for ned, off, wanted in (((32, -12, -15), 0, "roof"), ((40, 0, -15), 3, "corner"), ((0, -40, 0), 0, "ground")):
        x, y = pixel(*ned)
        found = ask(browser, f"window.qrsim.tools.placeAt({x + off}, {y}, {box})")
        assert found["what"] == wanted
        np.testing.assert_allclose(found["ned"], ned, atol=0.01)
    # A vehicle that is seen is meant; one of a hidden layer is not, and neither is one under a roof.
    x, y = pixel(*shown.frame.position_ned[0])
    pick = f"Object.keys(window.qrsim.tools.pick({x}, {y}, {box}))"
    assert ask(browser, pick) == ["vehicle"]
    scene.show("vehicles", False)
    eventually(lambda: "what" in ask(browser, pick))
    scene.show("vehicles", True)
    eventually(lambda: "what" not in ask(browser, pick))
    over = np.array([[*shown.frame.position_ned[0, :2], -100.0]])
    scene.layers["obstacles"].several("boxes", unit, over, shapes.linear((150, 140, 130)), np.full((1, 3), 20.0))
    eventually(lambda: ask(browser, f"window.qrsim.tools.pick({x}, {y}, {box}).what ?? 0") == "roof")


def table_of_all(browser: Watched, shown: Shown) -> None:
    """Opened by its key, sorted by a heading, it shows who has stopped, as text; a click on a row selects."""
    shown.frame = replace(shown.frame, time=2.5, reasons={1: HOSTILE})
    shown.page.draw(shown.frame, everything=True)
    browser.evaluate(KEY)
    first = "document.querySelector('.qrsim-table tbody tr:nth-child(2)').innerText"
    eventually(lambda: (browser.evaluate(f"{first} ?? ''") or "").startswith("pelicans_0"))
    north, east, down = shown.frame.position_ned[0]
    numbers = browser.evaluate(first).replace("\u2212", "-").split("\t")[1:4]
    assert numbers == [f"{value:.1f}" for value in (north, east, -down)]
    browser.evaluate("document.querySelector('.qrsim-table thead th:last-child button').click()")
    eventually(lambda: f"stopped at about 2.5 s: {HOSTILE}" in browser.evaluate(first))
    assert "3 vehicles, 1 stopped" in browser.evaluate("document.querySelector('.qrsim-table-bar').innerText")
    browser.evaluate("document.querySelector('.qrsim-table tbody tr:nth-child(2)').click()")
    eventually(lambda: shown.page.chosen == {1})
    assert browser.evaluate("window.beacon ?? 0") == 0
    browser.evaluate(KEY)
    assert browser.evaluate("document.querySelector('.qrsim-table').offsetHeight") == 0
    shown.frame = replace(shown.frame, reasons={})


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
        # A label is the vehicle, and not the ground behind it.
        label = "[...document.querySelectorAll('.qrsim-label')].find(e => e.offsetWidth)"
        place = f"(r => [r.left + r.width / 2, r.top + r.height / 2])({label}.getBoundingClientRect())"
        name = browser.evaluate(f"{label}.querySelector('b').innerText")
        browser.click(*browser.evaluate(place))
        eventually(lambda: browser.evaluate(words) == f"{name}: click the second place or vehicle")
        browser.evaluate(press)
        map_from_the_top(browser, shown)
        table_of_all(browser, shown)
        # Chase: 4 spans behind the vehicle, which looks north, and 1.4 above it.
        scene.choose(1)
        browser.evaluate("window.qrsim.choose(1); window.qrsim.tools.go('Chase')")
        assert browser.evaluate("window.__viserMutable.camera.fov") > 30.0
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
        browser.evaluate(KEY)
        eventually(lambda: "3 vehicles" in browser.evaluate("document.querySelector('.qrsim-table').innerText"))
        # The table is wider than the screen, and scrolls in it.
        assert browser.evaluate("(e => e.scrollWidth > e.clientWidth)(document.querySelector('.qrsim-table-rows'))")
        for left, _, right, _ in rectangles(
            browser, ".qrsim-tools button, .qrsim-tools select, .qrsim-bar, .qrsim-table"
        ):
            assert left >= 0.0
            assert right <= 390.0
        assert browser.errors == []
    finally:
        shown.server.stop()
