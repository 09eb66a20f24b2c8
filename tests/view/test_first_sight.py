"""What a page looks like at first, in a browser: camera, labels, small screens, theme, browsers of their own."""

from __future__ import annotations

import io
import itertools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from evidence.view import patrol
from PIL import Image

from qrsim.scenarios.scenario import load_scenario
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.frame import Frame, axes_of, cast_of
from qrsim.view.page import Page
from qrsim.view.server import address, start_server

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
PATIENCE_S = 120.0
NORTH = "left the area to the north, x = 200.1 m"


def eventually(condition: Callable[[], Any]) -> Any:
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.2)
    return found


class Shown:
    """The default scenario with so many vehicles at their starts, and a page of it."""

    def __init__(self, count: int, reasons: dict[int, str] | None = None, routes: bool = False):
        world = load_scenario(patrol(count)).world()
        starts = [fleet.start.position_ned for fleet in world.fleets]
        places = np.concatenate([np.stack(np.broadcast_arrays(*axes_of(own).T), axis=1) for own in starts])
        assert len(places) == count
        nothing, wind = np.zeros_like(places), np.tile([3.0, 4.0, 0.0], (count, 1))
        valid = np.ones(count, bool)
        valid[list(reasons or {})] = False
        self.server = start_server(0)
        cast = cast_of(world, places) if routes else replace(cast_of(world, places), routes=())
        self.page = Page(self.server, cast, world, f"patrol of {count}, seed 1", None)
        self.frame = Frame(1.0, places, nothing, places, places + 1.0, wind, nothing, valid, reasons or {})
        self.page.draw(self.frame, everything=True)

    def move(self, vehicle: int, by: tuple[float, float, float]) -> None:
        """Draw with one vehicle elsewhere."""
        places = self.frame.position_ned.copy()
        places[vehicle] += by
        self.frame = replace(self.frame, position_ned=places)
        self.page.draw(self.frame, everything=True)


@pytest.fixture
def show(browser: Browser) -> Iterator[Callable[..., Shown]]:
    made: list[Shown] = []

    def make(*words: Any) -> Shown:
        made.append(Shown(*words))
        return made[-1]

    yield make
    # A page draws as long as it is open.
    browser.open("about:blank")
    for shown in made:
        shown.server.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(1280, 800) as found:
        yield found


def look(browser: Browser, shown: Shown, width: int = 1280, height: int = 800) -> None:
    """Open a page at a size and wait until it has its camera."""
    browser.call(
        "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
    )
    browser.open("about:blank")
    browser.open(f"{address(shown.server)}/?fixedDpr=1")
    eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed"))
    browser.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())")
    settled(browser)


def pixels(browser: Browser) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(int)


def settled(browser: Browser, other: np.ndarray | None = None) -> np.ndarray:
    """Return the picture once it is another one than before, and no longer changes."""
    if other is not None:
        eventually(lambda: not np.array_equal(pixels(browser), other))
    end, before = time.monotonic() + PATIENCE_S, pixels(browser)
    while True:
        time.sleep(0.5)
        now = pixels(browser)
        if np.array_equal(now, before):
            return now
        assert time.monotonic() < end, "the picture never settled"
        before = now


def rectangles(browser: Browser, selector: str) -> np.ndarray:
    """Return left, top, right, bottom of what is shown (K, 4)."""
    source = (
        f"JSON.stringify([...document.querySelectorAll('{selector}')].filter(e => e.offsetWidth)"
        ".map(e => e.getBoundingClientRect()).map(r => [r.left, r.top, r.right, r.bottom]))"
    )
    return np.array(json.loads(browser.evaluate(source))).reshape(-1, 4)


@pytest.mark.parametrize("count", [5, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 50, 1000))])
def test_all_vehicles_are_seen_at_first(count: int, show: Callable[..., Shown], browser: Browser):
    """Their box, in pixels that change with the vehicles, fills 30 to 90 % of what panels leave free."""
    shown = show(count)
    for title in shown.page.scene.layers:
        shown.page.scene.show(title, title in ("vehicles", "ground and north"))
    look(browser, shown)
    found = json.loads(browser.evaluate("JSON.stringify(window.qrsim.box())"))
    legend = rectangles(browser, "div.qrsim-legend")[0]
    # What is drawn over the scene changes too.
    browser.evaluate(
        "document.head.insertAdjacentHTML('beforeend', '<style>#qrsim-overlay {opacity: 0 !important}</style>')"
    )
    with_them = settled(browser)
    shown.page.scene.show("vehicles", False)
    without = settled(browser, with_them)
    rows, columns = np.nonzero(np.abs(with_them - without).sum(axis=2) > 60)
    box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    left, top, right, bottom = found["free"]
    # The panel, docked to the right, and the legend are not part of it.
    assert right <= 1280 - 300
    assert left >= legend[2] - 1.0
    assert (box[:2] >= [left, top]).all()
    assert (box[2:] <= [right, bottom]).all()
    part = max((box[2] - box[0]) / (right - left), (box[3] - box[1]) / (bottom - top))
    assert 0.3 <= part <= 0.9
    # What the page says of it is what is seen.
    assert part == pytest.approx(found["share"], abs=0.08)


def test_the_route_of_one_vehicle_is_seen_at_first(show: Callable[..., Shown], browser: Browser):
    """Route and vehicle fill what panels leave free, and the arrow that points north covers neither."""
    shown = show(1, None, True)
    for title in shown.page.scene.layers:
        shown.page.scene.show(title, title == "routes")
    look(browser, shown)
    found = json.loads(browser.evaluate("JSON.stringify(window.qrsim.box())"))
    assert 0.3 <= found["share"] <= 0.9
    browser.evaluate(
        "document.head.insertAdjacentHTML('beforeend', '<style>#qrsim-overlay {opacity: 0 !important}</style>')"
    )
    with_it = settled(browser)
    shown.page.scene.show("routes", False)
    rows, columns = np.nonzero(np.abs(with_it - settled(browser, with_it)).sum(axis=2) > 60)
    left, top, right, bottom = found["free"]
    assert columns.min() >= left
    assert columns.max() < right
    assert rows.min() >= top
    assert rows.max() < bottom
    assert max(np.ptp(columns) / (right - left), np.ptp(rows) / (bottom - top)) > 0.3


def test_labels_do_not_overlap(show: Callable[..., Shown], browser: Browser):
    """Twenty vehicles, of which three are at one place, have stopped and say why."""
    shown = show(20, {3: NORTH, 7: NORTH, 12: "came too close to another vehicle, 0.48 m"})
    places = shown.frame.position_ned
    for vehicle in (7, 12):
        shown.move(vehicle, tuple(places[3] - places[vehicle]))
    look(browser, shown)
    boxes = rectangles(browser, ".qrsim-label")
    assert len(boxes) >= 15
    own = rectangles(browser, ".qrsim-legend, .qrsim-tools, div.qrsim-scale")
    for one, other in itertools.combinations(np.concatenate([boxes, own]), 2):
        assert not ((one[:2] < other[2:]).all() and (other[:2] < one[2:]).all()), (one, other)
    texts = browser.evaluate("[...document.querySelectorAll('.qrsim-stopped')].map(e => e.innerText).join('|')")
    assert (
        texts.count("left the area to the north, x = 200.1 m".replace(" = ", "\u00a0=\u00a0").replace(" m", "\u00a0m"))
        == 2
    )
    assert "came too close" in texts


def test_a_small_screen_is_usable(show: Callable[..., Shown], browser: Browser):
    """At 390 pixels nothing is cut off, and the panel is out of the way until it is asked for."""
    shown = show(5, {3: NORTH})
    look(browser, shown, 390, 844)
    wide = "document.documentElement.scrollWidth"
    assert browser.evaluate(wide) == 390
    found = json.loads(browser.evaluate("JSON.stringify(window.qrsim.box())"))
    assert 0.3 <= found["share"] <= 0.9
    assert found["free"][3] - found["free"][1] > 600
    for box in rectangles(browser, ".qrsim-label, .qrsim-tools button, div.qrsim-scale"):
        assert box[0] >= 0.0
        assert box[2] <= 390.0
    browser.evaluate("document.querySelector(\"[style*='height: 3.5em'][style*='cursor: pointer']\").click()")
    sheet = ".mantine-Paper-root[style*=\\'min-height: 3.5em\\']"
    eventually(lambda: np.ptp(rectangles(browser, sheet)[0, 1::2]) > 300)
    left, top, right, bottom = rectangles(browser, sheet)[0]
    assert (left, right, bottom) == (0.0, 390.0, 844.0)
    assert top > 0.3 * 844
    assert "Layers" in browser.evaluate("document.body.innerText")


@pytest.mark.nightly
def test_dark_and_light(show: Callable[..., Shown], browser: Browser):
    """The whole page, and the choice outlives a reload."""
    shown = show(1)
    look(browser, shown)
    light = settled(browser)
    press = "[...document.querySelectorAll('.qrsim-tools button')].find(b => b.innerText == 'Dark').click()"
    browser.evaluate(press)
    dark = settled(browser, light)
    for part in (np.s_[60:300, :800], np.s_[620:780, 300:800], np.s_[760:800, 1000:1270]):
        assert light[part].mean() > 180
        assert dark[part].mean() < 90
    look(browser, shown)
    assert settled(browser)[60:300, :800].mean() < 90
    browser.evaluate(press.replace("Dark", "Light"))
    assert browser.evaluate("window.qrsim.state.theme") == "light"


@pytest.mark.nightly
def test_each_browser_has_its_own_camera_choice_and_follows(show: Callable[..., Shown], browser: Browser):
    shown = show(5)
    eye = "JSON.stringify(window.__viserMutable.camera.position.toArray())"
    with Browser(700, 500) as other:
        look(browser, shown)
        look(other, shown, 700, 500)
        eventually(lambda: len(shown.page.viewers) == 2)
        before = json.loads(other.evaluate(eye))
        first, second = (shown.page.viewers[number] for number in sorted(shown.page.viewers))
        first.choose(2)
        first.follow(True)
        second.choose(4)
        eventually(lambda: browser.evaluate("window.qrsim.state.followed") == 2)
        eventually(lambda: other.evaluate("window.qrsim.state.chosen") == 4)
        assert browser.evaluate("window.qrsim.state.chosen") == 2
        assert other.evaluate("window.qrsim.state.followed") is None
        settled(browser)
        was = json.loads(browser.evaluate(eye))
        shown.move(2, (30.0, 0.0, 0.0))
        # As far as the vehicle; the other browser's camera stays.
        eventually(lambda: not np.allclose(json.loads(browser.evaluate(eye)), was, atol=1.0))
        moved = lambda: np.linalg.norm(np.array(json.loads(browser.evaluate(eye))) - was)  # noqa: E731
        eventually(lambda: moved() == pytest.approx(30.0, abs=0.1))
        np.testing.assert_allclose(json.loads(other.evaluate(eye)), before, atol=1e-3)
        chosen = "document.querySelector('.qrsim-chosen')?.innerText"
        names = shown.page.scene.cast.names
        assert (browser.evaluate(chosen), other.evaluate(chosen)) == (names[2], names[4])


def test_the_page_says_what_it_shows(show: Callable[..., Shown], browser: Browser):
    """Title, legend with units, and a scale bar that is as long as it says."""
    shown = show(5)
    look(browser, shown)
    assert browser.evaluate("document.title") == "qrsim - patrol of 5"
    legend = browser.evaluate("document.querySelector('.qrsim-legend').innerText")
    assert "0 to 12 m/s" in legend
    assert "grid of 10 m" in legend
    assert "x their size" in legend
    assert "stopped" not in legend
    shown.page.draw(replace(shown.frame, reasons={3: NORTH}), everything=True)
    eventually(lambda: "stopped" in browser.evaluate("document.querySelector('.qrsim-legend').innerText"))
    shown.page.scene.resize(shown.page.scene.stage.cast.true_span)
    eventually(lambda: "true size" in browser.evaluate("document.querySelector('.qrsim-legend').innerText"))
    # Two places as far apart as the bar says, across the view at what the camera looks at.
    bar = rectangles(browser, "div.qrsim-scale div")[0]
    metres = browser.evaluate(
        "(() => { const m = window.__viserMutable, V = m.camera.position.constructor;"
        "const at = m.cameraControl.getTarget(new V());"
        "const right = new V(1, 0, 0).applyQuaternion(m.camera.quaternion), box = m.canvas.getBoundingClientRect();"
        "return 2 / (at.clone().add(right).project(m.camera).x - at.clone().project(m.camera).x) / box.width; })()"
    )
    said = browser.evaluate("document.querySelector('div.qrsim-scale').innerText").split()
    assert said[1] == "m"
    assert (bar[2] - bar[0]) * metres == pytest.approx(float(said[0]), rel=0.02)


def test_what_others_wrote_is_shown_and_not_run(show: Callable[..., Shown], browser: Browser):
    """Names and reasons come from run folders, which may be somebody else's."""
    texts = [
        "<img src=x onerror='window.beacon = 1'>",
        "<script>window.beacon = 1</script>",
        "{window.beacon = 1}",
        "[x](javascript:window.beacon=1)",
    ]
    shown = show(5, dict(enumerate(texts)))
    written = " ".join(texts)
    shown.page.heading, shown.page.note = f"{written}, seed 1", written
    shown.page.draw(shown.frame, everything=True)
    look(browser, shown)
    for text in texts:
        eventually(lambda text=text: browser.evaluate("document.body.innerText").count(text) >= 3)
    assert browser.evaluate("window.beacon ?? 0") == 0
    assert browser.evaluate("document.querySelectorAll('img[src=x], a[href^=javascript]').length") == 0
