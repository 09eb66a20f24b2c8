"""Two runs over each other in a browser, with plots: one page that many facts are read from."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from evidence._view_browser import Watched
from tests.apps.conftest import Flight

from qrsim.runs import open_run
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.clock import SPEEDS, Clock
from qrsim.view.page import Page
from qrsim.view.replay import Replay
from qrsim.view.server import address, start_server
from qrsim.view.several import open_several

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}"),
]
HOSTILE = "<img src=x onerror=window.beacon=1>"
DOCK = "document.getElementById('qrsim-plots')"


def eventually(condition: Callable[[], Any]) -> Any:
    end = time.monotonic() + 120.0
    while not (found := condition()):
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.2)
    return found


@pytest.fixture(scope="module")
def replay(flown: Flight, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replay]:
    """The flight over a copy of it with a name that would run a script."""
    copy = Path(shutil.copytree(flown.folder, tmp_path_factory.mktemp("hostile") / f"b{HOSTILE}"))
    run = copy / "run.json"
    run.write_text(run.read_text("utf-8").replace('"outdoor_patrol"', f'"{HOSTILE}"', 1), "utf-8")
    recording, _ = open_several([flown.folder, copy], open_run)
    server, clock = start_server(0), Clock(playing=False, speeds=SPEEDS[:-1])
    page = Page(server, recording.cast, recording.world, recording.heading, clock)
    yield Replay(recording, page, clock)
    server.stop()


def search(browser: Browser, words: str) -> None:
    """Add the first quantity that fits some words."""
    browser.evaluate(
        f"{{const box = {DOCK}.querySelector('.bar input'); box.value = '{words}';"
        "box.dispatchEvent(new Event('input')); box.dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'}))}"
    )


def test_runs_and_plots_on_one_page(replay: Replay):
    with Watched(1280, 800) as browser:
        text: Callable[[str], str] = lambda selector: str(  # noqa: E731
            browser.evaluate(f"[...document.querySelectorAll('{selector}')].map(e => e.textContent).join('|')")
        )
        browser.open(f"{address(replay.page.server)}/?fixedDpr=1")
        eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed && !!window.qrsimPlots"))
        # Runs in the legend; distances, of two equal flights, in the legend and at the vehicles of the second.
        eventually(lambda: "0.00\u00a0m from A, at most 0.00\u00a0m" in text(".qrsim-legend"))
        assert "run A (run, seed 3)" in text(".qrsim-legend")
        eventually(lambda: re.findall(r"B pelicans_\d\u20020\.00\u00a0m", text(".qrsim-label")))
        # Plots begin with the heights of all vehicles; the line next to the pointer is named, with its value.
        browser.evaluate("window.dispatchEvent(new KeyboardEvent('keydown', {key: 'p', bubbles: true}))")
        eventually(lambda: browser.evaluate(f"{DOCK}.querySelectorAll('canvas').length") == 1)
        eventually(lambda: text("#qrsim-plots .line").count(" height") == 10)
        place = f"{DOCK}.querySelector('.u-over').getBoundingClientRect()"
        x, y = browser.evaluate(f"[{place}.left + {place}.width / 2, {place}.top + {place}.height / 2]")
        browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        eventually(lambda: re.fullmatch(r"[AB] pelicans_\d height [\d.]+, (4\.9|5\.0)\d s", text("#qrsim-plots .tip")))
        # A quantity that is searched for, by its meaning; a click on its extreme goes to its time.
        search(browser, "mean wind and gusts together")
        eventually(lambda: "wind_speed" in text("#qrsim-plots .line"))
        wind = f"[...{DOCK}.querySelectorAll('.line')].find(e => e.textContent.includes('wind_speed'))"
        peak = f"[...{wind}.querySelectorAll('button')].find(e => e.textContent.startsWith('max'))"
        at = float(re.findall(r"at ([\d.]+) s", str(browser.evaluate(f"{peak}.title")))[0])
        browser.evaluate(f"{peak}.click()")
        eventually(lambda: replay.time == pytest.approx(at, abs=0.02))
        # A click in the plot goes to the time under it.
        over = f"{DOCK}.querySelector('.u-over').getBoundingClientRect()"
        x, y = browser.evaluate(f"[{over}.left + {over}.width / 2, {over}.top + {over}.height / 2]")
        browser.click(x, y)
        eventually(lambda: replay.time == pytest.approx(5.0, abs=0.1))
        # Zoomed in, extremes are those of the span.
        browser.evaluate("window.qrsimPlots.zoom(1, 2)")
        eventually(
            lambda: all(
                1.0 <= float(t) <= 2.0 for t in re.findall(r"at ([\d.]+) s", str(browser.evaluate(f"{peak}.title")))
            )
        )
        # The time is the same, to the hundredth, in the bar, the panel and the table of both runs' vehicles.
        replay.seek(7.78)
        clock = "document.getElementById('qrsim-timeline').innerText"
        eventually(lambda: "00:07.78 / 00:10.00" in str(browser.evaluate(clock)))
        # A search for modes, which are no quantities, opens the table.
        search(browser, "mode")
        eventually(lambda: "t = 7.78 s, 10 vehicles" in text(".qrsim-table-bar"))
        eventually(lambda: "t = 7.78 s" in str(browser.evaluate("document.body.innerText")))
        assert "B pelicans_0" in text(".qrsim-table tbody")
        # A line is replaced in its place; a plot that is added is seen, and one that is removed is gone.
        names = "JSON.stringify(window.qrsimPlots.state.panels.map(panel => panel.names))"
        browser.evaluate(f"{DOCK}.querySelector('.line button.name').click()")
        search(browser, "derived.height")
        eventually(lambda: browser.evaluate(names) == '[["derived.height"]]')
        for quantity in ("derived.speed", "derived.estimate_error ", "derived.nearest"):
            browser.evaluate(f"[...{DOCK}.querySelectorAll('button')].find(e => e.textContent == 'New plot').click()")
            search(browser, quantity)
        scrolled = f"{DOCK}.querySelector('.panels').scrollTop"
        eventually(lambda: browser.evaluate(scrolled) > 100)
        # Where the plots were scrolled to, they stay while the time moves and another vehicle is chosen.
        browser.evaluate(f"{scrolled} = 70")
        replay.seek(3.0)
        replay.page.choose(4)
        eventually(lambda: "pelicans_4" in text("#qrsim-plots select option:checked"))
        eventually(lambda: browser.evaluate(scrolled) == 70)
        browser.evaluate(f"{DOCK}.querySelector('.panel .close').click()")
        eventually(lambda: '"derived.height"' not in browser.evaluate(names))
        # A filter counts, a section keeps its heading, and an empty list has none.
        eventually(lambda: "separation" in text("#qrsim-plots .events h5"))
        box = "document.querySelector('#qrsim-plots .events input')"
        heads = "[...document.querySelectorAll('#qrsim-plots .events h4, #qrsim-plots .events h5')]"
        seen = f"{heads}.filter(e => e.offsetHeight).map(e => e.textContent).join('|')"
        for words, wanted in (
            ("closest pairs", r"Highlights \(2 of \d+\)\|separation"),
            ("waypoint_reached pelicans_4", r"Events \(\d+ of \d+\)"),
            ("zzz", ""),
        ):
            browser.evaluate(f"{{{box}.value = '{words}'; {box}.oninput(); }}")
            assert re.fullmatch(wanted, str(browser.evaluate(seen)))
        browser.evaluate(f"{{{box}.value = ''; {box}.oninput(); }}")
        # The filter of the list of events stays in view.
        browser.evaluate(f"{DOCK}.querySelector('.events').scrollTop = 500")
        top = "document.querySelector('#qrsim-plots {}').getBoundingClientRect().top"
        assert browser.evaluate(f"{top.format('.events input')} - {top.format('.events')}") == pytest.approx(
            0.0, abs=1.0
        )
        # On a small screen nothing is cut off.
        browser.call("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
        eventually(lambda: browser.evaluate(f"{DOCK}.getBoundingClientRect().right") <= 390)
        assert browser.evaluate("document.documentElement.scrollWidth") == 390
        # What others wrote is shown and not run.
        eventually(lambda: HOSTILE in str(browser.evaluate("document.body.textContent")))
        assert browser.evaluate("window.beacon ?? 0") == 0
        assert browser.evaluate("document.querySelectorAll('img[src=x]').length") == 0
        assert browser.errors == []
