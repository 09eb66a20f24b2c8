"""The page in a browser: what is drawn, seen in pixels; time stops, is scrubbed; nothing is asked of other machines."""

from __future__ import annotations

import html
import io
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image
from tests.apps.conftest import DURATION, Flight

import qrsim
from qrsim import cli
from qrsim.runs import open_run
from qrsim.runs.colours import VEHICLES
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
WIDTH, HEIGHT = 800, 600
PATIENCE_S = 90.0
# Of the picture's middle; the panel is beside it.
VIEW = (slice(60, 540), slice(0, 480))


def pixels(picture: bytes) -> np.ndarray:
    """Return a PNG as (rows, columns, 3)."""
    return np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)


def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.1)


def changes(browser: Browser, before: np.ndarray, most: float = PATIENCE_S) -> bool:
    """Return whether more than a few pixels of the view change within a time [s]."""
    end = time.monotonic() + most
    while time.monotonic() < end:
        now = pixels(browser.picture())
        if (np.abs(now - before).sum(axis=2) > 60)[VIEW].sum() > 100:
            return True
        time.sleep(0.2)
    return False


def settled(browser: Browser) -> np.ndarray:
    """Return the picture once it no longer changes, and is not empty."""
    end, before = time.monotonic() + PATIENCE_S, pixels(browser.picture())
    while time.monotonic() < end:
        time.sleep(0.7)
        now = pixels(browser.picture())
        if np.array_equal(now[VIEW], before[VIEW]) and len(np.unique(now[VIEW].reshape(-1, 3), axis=0)) > 50:
            return now
        before = now
    raise AssertionError("the picture never settled")


class Watched:
    """A replay of the default scenario, and a browser that looks at it."""

    def __init__(self, folder: Path, browser: Browser):
        recording = Recording(open_run(folder))
        self.browser, self.server = browser, start_server(0)
        self.clock = Clock(playing=False, speeds=SPEEDS[:-1])
        self.page = Page(self.server, recording.cast, recording.world, recording.heading, self.clock)
        self.replay = Replay(recording, self.page, self.clock)
        self._stop = threading.Event()
        self._playing = threading.Thread(target=self.replay.run, args=(self._stop,))
        self._playing.start()
        browser.open(f"{address(self.server)}/?fixedDpr=1")
        eventually(lambda: browser.evaluate("document.querySelectorAll('button').length") > 3)
        eventually(lambda: bool(self.server.get_clients()))
        # The browser says that it has no graphics card.
        browser.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())")
        # What is asked of the camera before it is where pages begin would be undone.
        eventually(lambda: browser.evaluate("!!window.qrsim?.state.framed"))
        settled(browser)

    def clients(self) -> list[Any]:
        """Return the browsers that look."""
        return list(self.server.get_clients().values())

    def close(self) -> None:
        self._stop.set()
        self.clock.close()
        self._playing.join(10.0)
        self.server.stop()

    def press(self, button: str) -> None:
        """Press a button of the panel."""
        self.browser.evaluate(f"[...document.querySelectorAll('button')].find(b => b.innerText == '{button}').click()")

    def text(self) -> str:
        """Return what the panel says."""
        return str(self.browser.evaluate("document.body.innerText"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(WIDTH, HEIGHT) as found:
        yield found


@pytest.fixture(scope="module")
def watched(flown: Flight, browser: Browser) -> Iterator[Watched]:
    found = Watched(flown.folder, browser)
    yield found
    found.close()


def test_vehicles_are_drawn(watched: Watched):
    """Seen in pixels: with and without the vehicles, and in the colour of one."""
    scene = watched.page.scene
    # Close to the first vehicle, which fills the middle then.
    watched.page.choose(0)
    watched.page.follow()
    scene.resize(20.0)
    for title in scene.layers:
        scene.show(title, title in ("vehicles", "ground and north"))
    with_them = settled(watched.browser)
    blue = (with_them[..., 2] > with_them[..., 0] + 80)[VIEW]
    assert blue.sum() > 100, "no vehicle in the first one's colour, blue"
    scene.show("vehicles", False)
    assert changes(watched.browser, with_them)
    without = settled(watched.browser)
    assert (without[..., 2] > without[..., 0] + 80)[VIEW].sum() < 0.1 * blue.sum()
    scene.show("vehicles", True)


def test_a_click_on_a_vehicle_shows_its_values(watched: Watched):
    """Of the vehicle in the middle, at one of its pixels."""
    scene = watched.page.scene
    watched.page.choose(3)
    watched.page.follow()
    watched.replay.seek(DURATION)
    settled(watched.browser)
    watched.page.choose(None)
    scene.show("vehicles", False)
    without = settled(watched.browser)
    scene.show("vehicles", True)
    assert changes(watched.browser, without)
    with_it = settled(watched.browser)
    # It was followed, so it is in the middle of the canvas.
    box = "window.__viserMutable.canvas.getBoundingClientRect()"
    middle = watched.browser.evaluate(f"[{box}.width / 2, {box}.height / 2]")
    places = itertools.cycle(inside(np.abs(with_it - without).sum(axis=2) > 60, middle)[:12:3])

    def clicked() -> bool:
        watched.page.choose(None)
        watched.browser.click(*next(places))
        end = time.monotonic() + 5.0
        while not watched.page.chosen and time.monotonic() < end:
            time.sleep(0.05)
        return watched.page.chosen == {3}

    eventually(clicked)
    eventually(lambda: watched.page.scene.cast.names[3] in panel_values(watched.browser))
    watched.browser.evaluate("window.qrsimPlots.toggle(true)")
    eventually(lambda: words_of_plots(watched.browser, "#qrsim-plots select option:checked") == "pelicans_3")
    eventually(lambda: "height" in words_of_plots(watched.browser, "#qrsim-plots .lines"))
    watched.browser.evaluate("window.qrsimPlots.toggle(false)")
    watched.page.choose(None)


def inside(changed: np.ndarray, middle: list[float]) -> list[tuple[float, float]]:
    """Return the changed pixels (x, y) of the view whose neighbours have changed, those next to the middle first."""
    seen = np.zeros_like(changed)
    seen[VIEW] = changed[VIEW]
    edges = [np.roll(seen, by, axis) for axis in (0, 1) for by in (-1, 1)]
    rows, columns = np.nonzero(seen & np.all(edges, axis=0))
    nearest = np.argsort((columns - middle[0]) ** 2 + (rows - middle[1]) ** 2)
    return [(float(columns[k]), float(rows[k])) for k in nearest]


def panel_values(browser: Browser) -> list[str]:
    """Return what the inputs of the panel hold."""
    return list(browser.evaluate("[...document.querySelectorAll('input')].map(i => i.value)"))


def words_of_plots(browser: Browser, selector: str) -> str:
    """Return the words of a part of the plots; "": it is not there."""
    return str(browser.evaluate(f"document.querySelector('{selector}')?.textContent ?? ''"))


def test_time_goes_on_and_stops(watched: Watched):
    watched.press("play")
    eventually(lambda: watched.replay.time > 0.5)
    watched.press("pause")
    eventually(lambda: not watched.clock.playing)
    eventually(lambda: f"t = {watched.replay.time:.2f} s (paused)" in watched.text())
    stopped = watched.replay.time
    time.sleep(1.0)
    assert watched.replay.time == stopped < DURATION
    eventually(lambda: f"t = {stopped:.2f} s (paused)" in watched.text())
    watched.press("step")
    eventually(lambda: f"t = {stopped + 0.02:.2f} s (paused)" in watched.text())


def test_a_slider_goes_through_time(watched: Watched):
    before = settled(watched.browser)
    slider = f"e => e.getAttribute('aria-valuemax') == '{DURATION:g}'"
    watched.browser.evaluate(f"[...document.querySelectorAll('[role=slider]')].find({slider}).focus()")
    for kind in ("keyDown", "keyUp"):
        watched.browser.call("Input.dispatchKeyEvent", type=kind, key="End", code="End", windowsVirtualKeyCode=35)
    eventually(lambda: watched.replay.time == pytest.approx(DURATION))
    eventually(lambda: f"t = {DURATION:.2f} s" in watched.text())
    assert changes(watched.browser, before)


def test_nothing_is_asked_of_other_machines(watched: Watched):
    hosts = {(urlsplit(url).scheme, urlsplit(url).hostname) for url in watched.browser.requested}
    # That the worker's connection is here shows that nothing was overlooked.
    assert ("ws", "127.0.0.1") in hosts
    assert {host for scheme, host in hosts if scheme not in ("data", "blob")} == {"127.0.0.1"}


@pytest.fixture
def page(flown: Flight, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """An exported page."""
    folder = tmp_path / "page"
    with pytest.MonkeyPatch.context() as patch:
        # In three parts, of which a browser unpacks one at a time.
        patch.setattr("qrsim.view.film.FRAMES_OF_A_PART", 80)
        assert cli.main(["view", str(flown.folder), "--export", str(folder)]) == 0
    assert capsys.readouterr().out.split() == [str(folder / "index.html")]
    return folder / "index.html"


def opened(browser: Browser, path: Path) -> None:
    """Open an exported page, and wait until it plays."""
    browser.open(path.as_uri())
    eventually(lambda: bool(browser.evaluate("!!window.qrsimFilm?.ready")))
    browser.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())")


def press_key(browser: Browser, key: str) -> None:
    browser.evaluate(f"window.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}', bubbles: true}}))")


def drawn_bodies(browser: Browser) -> np.ndarray:
    """Return the positions that the bodies of a page have."""
    node = "window.__viserSceneTree.getState()['/world/vehicles/bodies'].message.props.batched_positions"
    return np.array(browser.evaluate(f"Array.from({node})")).reshape(5, 3)


def test_an_export_plays_without_a_server(page: Path, flown: Flight, browser: Browser):
    """Keys, marks and scrubbing, forwards and backwards, through all of its parts."""
    truth = open_run(flown.folder)["truth"]
    true = np.stack([truth[f"position_ned.{axis}"] for axis in "xyz"], axis=-1)
    asked = len(browser.requested)
    opened(browser, page)
    assert browser.evaluate("document.title") == "qrsim - outdoor_patrol"
    for key, time_s in (("5", 5.0), ("9", 9.0), ("2", 2.0), ("ArrowRight", 7.0), ("ArrowLeft", 2.0), ("1", 1.0)):
        press_key(browser, key)
        eventually(lambda: f"t = {time_s:.2f} s (paused)" in str(browser.evaluate("document.body.innerText")))  # noqa: B023
        eventually(lambda: np.allclose(drawn_bodies(browser), true[round(time_s / 0.02)], atol=1e-4))  # noqa: B023
    press_key(browser, "ArrowUp")
    press_key(browser, " ")
    eventually(lambda: browser.evaluate("qrsimFilm.state.time") > 3.0)
    assert "2 x" in browser.evaluate("document.getElementById('qrsim-timeline').innerText")
    # It stops at its end, and begins again.
    eventually(lambda: browser.evaluate("!qrsimFilm.state.playing && qrsimFilm.state.time") == DURATION)
    press_key(browser, " ")
    eventually(lambda: 0.0 < browser.evaluate("qrsimFilm.state.time") < 5.0)
    press_key(browser, " ")
    schemes = {urlsplit(url).scheme for url in browser.requested[asked:]}
    assert "file" in schemes
    assert schemes <= {"file", "data", "blob"}


def test_an_export_has_heading_layers_and_plots(page: Path, browser: Browser):
    opened(browser, page)
    text = str(browser.evaluate("document.getElementById('qrsim-panel').innerText"))
    assert "outdoor_patrol, seed 3, 5 vehicles" in text
    assert "5 of 5 vehicles fly" in text
    press_key(browser, "8")
    browser.evaluate("{const box = document.getElementById('qrsim-vehicle'); box.value = 4; box.onchange()}")
    browser.evaluate("document.querySelector('#qrsim-panel details').open = true")
    browser.evaluate("window.qrsimPlots.toggle(true)")
    eventually(lambda: words_of_plots(browser, "#qrsim-plots select option:checked") == "pelicans_3")
    eventually(lambda: "height" in words_of_plots(browser, "#qrsim-plots .lines"))
    browser.evaluate("window.qrsimPlots.toggle(false)")
    press_key(browser, "8")
    eventually(lambda: "t = 8.00 s" in str(browser.evaluate("document.body.innerText")))
    shown = settled(browser)
    row = "[...document.querySelectorAll('#qrsim-panel label')].find(row => row.textContent.trim() == '{}')"
    for layer in ("vehicles", "ground and north"):
        browser.evaluate(f"{row.format(layer)}.querySelector('input').click()")
    assert changes(browser, shown)
    # A jump shows no layer that was hidden.
    press_key(browser, "2")
    eventually(lambda: "t = 2.00 s" in str(browser.evaluate("document.body.innerText")))
    assert browser.evaluate("window.__viserSceneTree.getState()['/world/vehicles'].visibility") is False


def test_a_notebook_shows_the_page_in_a_frame(flown: Flight, tmp_path: Path, browser: Browser):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("qrsim.view.film.FASTEST_HZ", 2.0)
        found = qrsim.show(flown.folder, height=500)
    path = tmp_path / "cell.html"
    path.write_text(f"<!doctype html><title>cell</title><body>{found._repr_html_()}</body>", encoding="utf-8")
    browser.open(path.as_uri())
    frame = "document.querySelector('iframe')"
    eventually(lambda: bool(browser.evaluate(f"!!{frame}?.contentWindow.qrsimFilm?.ready")))
    assert browser.evaluate(f"{frame}.getBoundingClientRect().height") == 502
    browser.evaluate(f"{frame}.contentWindow.qrsimFilm.wish({{time: 4}})")
    text = f"{frame}.contentDocument.getElementById('qrsim-panel').innerText"
    eventually(lambda: "t = 4.00 s (paused)" in str(browser.evaluate(text)))


# What notebooks put around the output of a cell: nothing but a page; a policy such as that of VS Code's notebooks; and
# a frame that may run scripts, but has no origin and no storage, which is stricter than that of Colab.
POLICY = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src https: data:"
AROUND = {
    "policy": f'<meta http-equiv="Content-Security-Policy" content="{POLICY}"><body>{{cell}}',
    "sandbox": '<body><iframe sandbox="allow-scripts" width="100%" height="560" srcdoc="{escaped}"></iframe>',
}


@pytest.mark.parametrize("place", AROUND)
def test_a_notebook_elsewhere_shows_it_too(place: str, flown: Flight, tmp_path: Path, browser: Browser):
    """As the output of a cell that a kernel has run; drawn without a request to any server."""
    source = (
        f"import qrsim.view.film as film, qrsim\nfilm.FASTEST_HZ = 1.0\nqrsim.show({str(flown.folder)!r}, height=500)"
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    if place == "policy":
        NotebookClient(notebook, timeout=120).execute()
        cell = notebook.cells[0].outputs[-1]["data"]["text/html"]
    else:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("qrsim.view.film.FASTEST_HZ", 1.0)
            cell = qrsim.show(flown.folder, height=500)._repr_html_()
    path = tmp_path / "cell.html"
    text = "<!doctype html><title>cell</title>" + AROUND[place].format(cell=cell, escaped=html.escape(cell, quote=True))
    path.write_text(text, encoding="utf-8")
    before = len(browser.requested)
    browser.open(path.as_uri())

    def dots() -> bool:
        """Return whether the labels of all vehicles are there, by the dots in their colours."""
        shown = pixels(browser.picture())
        return all((shown == colour).all(axis=2).sum() > 20 for colour in VEHICLES[:5])

    eventually(dots)
    assert all(url.startswith(("file:", "data:", "about:", "blob:")) for url in browser.requested[before:])


def test_a_screenshot_shows_the_scene(flown: Flight, tmp_path: Path, capsys):
    path = tmp_path / "shot.png"
    assert cli.main(["view", str(flown.folder), "--screenshot", str(path), "--at", "8"]) == 0
    assert capsys.readouterr().out == f"{path}\n"
    picture = pixels(path.read_bytes())
    assert picture.shape == (800, 1280, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("qrsim.view.picture.photograph", lambda server, caption, size: b"")
        (tmp_path / "taken.png").mkdir()
        assert cli.main(["view", str(flown.folder), "--screenshot", str(tmp_path / "taken.png")]) == 1
    assert f"--screenshot {tmp_path / 'taken.png'}: Is a directory" in capsys.readouterr().err
    # The paths of five vehicles, in colours that nothing else has.
    for colour in ((55, 114, 247), (231, 139, 1), (12, 146, 97), (91, 56, 178), (90, 168, 242)):
        assert (np.abs(picture - colour).max(axis=2) < 6).sum() > 60, colour


def test_a_screenshot_has_the_camera_the_size_and_the_layers_asked_for(flown: Flight, tmp_path: Path):
    """The first vehicle from above, then without its layer."""
    words = ["view", str(flown.folder), "--at", "5", "--size", "640x480", "--camera", "pelicans_0:above"]
    found = []
    for layers in ("vehicles", "--layers=-vehicles"):
        path = tmp_path / f"{layers}.png"
        chosen = [layers] if layers.startswith("-") else ["--layers", layers]
        assert cli.main([*words, *chosen, "--screenshot", str(path)]) == 0
        found.append(pixels(path.read_bytes()))
    with_it, without = found
    assert with_it.shape == without.shape == (480, 640, 3)
    # In the middle, beneath the title: a vehicle before the sky in one, the ground without it in the other.
    middle = (slice(120, 360), slice(200, 440))
    sky = [(p.min(axis=2) > 195) & (p[..., 2] >= p[..., 1]) for p in (with_it[middle], without[middle])]
    assert 0.5 < sky[0].mean() < 0.985
    assert sky[1].mean() < 0.2
