"""The sky over a chosen vehicle: what browsers are told of it, and when."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.apps.test_view_film import elements, unpacked
from tests.apps.test_view_life import CAMERA
from tests.view.fetching import fetching
from tests.view.test_viewers import eventually, page  # noqa: F401

import qrsim
from qrsim.models.gnss.constellations import NominalConstellations
from qrsim.runs import open_run
from qrsim.view import film
from qrsim.view.browser import INSTALL, Browser, find_browser
from qrsim.view.page import Page
from qrsim.view.plots import Plots
from qrsim.view.recording import Recording
from qrsim.view.sky import columns_of, of_satellites, satellites, sky_of_state

DURATION, EAST, LOW = 4.0, np.pi / 2, np.radians(30.0)


def test_what_is_drawn_of_a_reading() -> None:
    """A satellite in the east, one below the horizon, a free slot, and one of GLONASS that is hidden in the south."""
    numbers = NominalConstellations("GR").satellite_ids.astype(float)
    said = {
        "satellite": np.array([numbers[0], numbers[1], -1.0, numbers[24]]),
        "azimuth": np.array([EAST, 0.0, 0.0, 2.0 * EAST]),
        "elevation": np.array([LOW, -0.1, 0.0, 2.0 * LOW]),
        "cn0": np.array([44.6, 0.0, 0.0, 0.0]),
        "satellite_state": np.array([1.0, 0.0, 0.0, 3.0]),
    }
    assert satellites(said) == [("G-A1", 90, 30, 45, 1), ("R-A1", 180, 60, 0, 3)]


def test_single_satellites_are_not_plotted() -> None:
    assert of_satellites("gnss.cn0.0")
    assert of_satellites("gnss.satellite_state.33")
    assert not of_satellites("gnss.satellites")
    assert not of_satellites("gnss.position_ned.x")
    names = [
        f"b.{field}.{k}" for field in ("cn0", "satellite", "satellite_state", "azimuth", "elevation") for k in (0, 1)
    ]
    assert columns_of(["a.height", *names])[1]["azimuth"] == "b.azimuth.1"
    assert len(columns_of(names)) == 2
    assert columns_of(["a.height"]) == []


def test_a_browser_is_told_what_is_new_of_whom_it_has_chosen(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    skies = {0: [], 1: [("G05", 90, 30, 45, 1)], 2: [("G05", 90, 30, 44, 1)]}
    told: list[Any] = []
    page.sky = lambda vehicle: skies[vehicle]
    monkeypatch.setattr(page.scene.overlay, "sky", lambda content, browser: told.append(content))
    with fetching(address_of(page)) as browser:
        browser.send(CAMERA)
        eventually(lambda: len(page.viewers) == 1)
        (viewer,) = page.viewers.values()
        assert told == []
        viewer.choose(1)
        for _ in range(10):
            viewer.send_sky()
        assert told == [{"vehicle": "b", "satellites": [("G05", 90, 30, 45, 1)]}]
        viewer.choose(2)
        viewer.choose(0)
        assert [None if content is None else content["vehicle"] for content in told] == ["b", "c", None]
        viewer.send_sky()
        assert len(told) == 3


def address_of(page: Page) -> str:  # noqa: F811
    from qrsim.view.server import address

    return address(page.server)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two vehicles, one of which is jammed from 2 s on."""
    path = tmp_path_factory.mktemp("sky") / "run"
    content = {
        "name": "sky",
        "duration": DURATION,
        "world": {"interference": [{"kind": "disc", "position_ned": [0.0, 200.0, 0.0], "radius": 50.0, "start": 2.0}]},
        "fleets": {
            "a": {
                "sensors": {"gnss": {"type": "gnss", "per_satellite": True, "delay": 0}},
                "controller": {"type": "waypoint", "feed": "truth"},
                "vehicles": [{"position_ned": [0.0, 200.0 * i, -10.0]} for i in range(2)],
            }
        },
    }
    qrsim.fly(qrsim.load_scenario(content), path, seed=1, precision="float32")
    return path


@pytest.mark.long
def test_a_recording_a_page_and_a_state_say_the_same(folder: Path) -> None:
    recording = Recording(open_run(folder))
    assert not any("cn0" in name for name in Plots(recording).quantities)
    clear, jammed = recording.sky(0, 3.0), recording.sky(1, 3.0)
    assert 25 < len(clear) < 50
    assert {state for *_, state in recording.sky(1, 1.0)} <= {0, 1}
    # Below the mask, of 10 degrees, nothing is tracked that could be lost.
    assert {state for _, _, elevation, _, state in jammed if elevation > 11} == {4}
    assert {state for _, _, elevation, _, state in clear if elevation > 11} == {1}
    assert sum(state == 1 for *_, state in clear) == float(open_run(folder)["measurements"]["gnss.satellites"][150, 0])

    simulation = qrsim.load(open_run(folder).scenario, seed=1, precision="float32")
    simulation.reset()
    for _ in range(150):
        simulation.step()
    assert [sky_of_state(simulation.state, 0, vehicle) for vehicle in range(2)] == [clear, jammed]

    found = elements(film.film(recording))
    about = json.loads(found["about"])
    row, times = about["sky"]["times"].index(3.0), len(about["sky"]["times"])
    assert times == 5
    sky = {name: values.reshape(-1, times)[:, row] for name, values in unpacked(found["sky-1"]).items()}
    shown = [
        (
            about["sky"]["names"][str(int(number))],
            *(int(sky[name][k]) for name in ("azimuth", "elevation", "cn0")),
            int(sky["satellite_state"][k]),
        )
        for k, number in enumerate(sky["satellite"].tolist())
        if number >= 0 and sky["elevation"][k] >= 0
    ]
    assert shown == jammed


@pytest.mark.long
@pytest.mark.skipif(find_browser() is None, reason=f"no browser; {INSTALL}")
def test_a_page_without_a_server_draws_it(folder: Path, tmp_path: Path) -> None:
    path = film.export(Recording(open_run(folder)), tmp_path / "page")
    with Browser(1000, 800) as browser:
        browser.open(path.as_uri())
        eventually(lambda: browser.evaluate("window.qrsimFilm?.ready === true && !!window.qrsim"))
        sky = "document.querySelector('.qrsim-sky')"
        assert browser.evaluate(f"{sky}.hidden")
        choose = "(() => { const box = document.getElementById('qrsim-vehicle'); box.value = %d; box.onchange(); })()"
        browser.evaluate(choose % 2)
        eventually(lambda: not browser.evaluate(f"{sky}.hidden"))
        assert "tracked" in browser.evaluate(f"{sky}.textContent")
        assert "jammed" not in browser.evaluate(f"{sky}.textContent")
        browser.evaluate("window.qrsimFilm.wish({time: 3})")
        eventually(lambda: "0 tracked" in browser.evaluate(f"{sky}.textContent"))
        assert "jammed" in browser.evaluate(f"{sky}.textContent")
        browser.evaluate(choose % 0)
        eventually(lambda: browser.evaluate(f"{sky}.hidden"))
