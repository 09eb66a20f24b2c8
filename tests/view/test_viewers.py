"""What each browser has for itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from tests.apps.test_view_life import CAMERA
from tests.view.fetching import fetching

from qrsim.models.sensors.faults import KINDS
from qrsim.scenarios.live_requests import Request
from qrsim.view.clock import Clock
from qrsim.view.failing import FailingControls, Target
from qrsim.view.frame import Cast, Frame
from qrsim.view.page import Page
from qrsim.view.server import address, start_server

PLACES = np.array([[0.0, 0.0, -10.0], [30.0, 0.0, -10.0], [0.0, 40.0, -20.0]])


def eventually(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.01)


@pytest.fixture
def page() -> Iterator[Page]:
    server = start_server(0)
    found = Page(server, Cast(("a", "b", "c"), np.zeros(3, int), PLACES), None, "test, seed 1", None)
    found.plotted = lambda vehicle, quantity: (np.arange(5.0), np.full(5, float(vehicle)), np.zeros(5))
    found.add_plots(["gnss.position_ned.x", "barometer.height", "barometer.height_rate"])
    nothing = np.zeros_like(PLACES)
    found.draw(Frame(0.0, PLACES, nothing, PLACES, PLACES, nothing, nothing, np.ones(3, bool)), everything=True)
    yield found
    server.stop()


def test_each_browser_has_its_own_choice_and_plots(page: Page):
    with fetching(address(page.server)) as one, fetching(address(page.server)) as other:
        for browser in (one, other):
            browser.send(CAMERA)
        eventually(lambda: len(page.viewers) == 2)
        first, second = (page.viewers[number] for number in sorted(page.viewers))
        assert [plot.visible for _, plot in first.plots] == [False, False]
        assert not first.follows.visible
        first.choose(2)
        first.follow(True)
        assert page.chosen == {2}
        assert [plot.visible for _, plot in first.plots] == [True, True]
        assert [plot.visible for _, plot in second.plots] == [False, False]
        np.testing.assert_array_equal(first.plots[0][1].data[1], np.full(5, 2.0))
        # In the vehicle's colour.
        assert first.plots[0][1].series[1]["stroke"] == "#0c9261"
        second.choose(0)
        assert (first.who.value, second.who.value) == ("c", "a")
        assert (first.choice.follow, second.choice.follow) == (True, False)
        assert page.scene.stage.chosen == {0, 2}
        first.choose(None)
        assert not first.plots[0][1].visible
        assert page.chosen == {0}
    eventually(lambda: not page.viewers)
    assert page.chosen == frozenset()


def test_what_can_fail_of_the_chosen_vehicle(page: Page):
    """Target, kind and numbers to begin with; a vehicle that has nothing has no controls."""
    gnss, barometer = (
        Target("gnss", KINDS, ("position_ned.x", "position_ned.y")),
        Target("barometer", KINDS, ("height",)),
    )
    targets = [
        [gnss, barometer, Target("rotor 0", ("off", "weak", "stuck"), is_part=True)],
        [Target("battery", ("drop", "weak"), is_part=True)],
        [],
    ]
    asked: list[Request] = []
    said: list[str] = []
    page.failing = lambda gui: FailingControls(gui, targets, page.scene.cast.names, asked.append, said.append)
    with fetching(address(page.server)) as browser:
        browser.send(CAMERA)
        eventually(lambda: bool(page.viewers))
        [viewer] = page.viewers.values()
        controls = viewer.failing
        assert controls is not None
        assert not controls.inject.visible
        controls.ask_inject()
        assert asked == []
        viewer.choose(0)
        assert controls.inject.visible
        assert (controls.target.options, controls.kind.value) == (("gnss", "barometer", "rotor 0"), "off")
        controls.target.value = "barometer"
        controls.kind.value = "drift"
        assert controls.numbers.value == "field=height rate=0.5"
        controls.seconds.value = 12.0
        controls.ask_inject()
        controls.ask_clear()
        controls.target.value = "rotor 0"
        assert controls.kind.options == ("off", "weak", "stuck")
        controls.kind.value = "weak"
        controls.seconds.value = 0.0
        controls.ask_inject()
        controls.numbers.value = "health 0.5"
        controls.ask_inject()
        viewer.choose(1)
        assert (controls.target.value, controls.kind.options) == ("battery", ("drop", "weak"))
        viewer.choose(2)
        assert not controls.inject.visible
    assert asked == [
        Request("barometer", "drift", ("a",), None, 12.0, {"field": "height", "rate": 0.5}),
        Request("barometer", "ok", ("a",)),
        Request("rotor 0", "weak", ("a",), None, None, {"health": 0.7}),
    ]
    assert said == ["Not injected: 'health': expected NAME=VALUE, such as bias=2"]


def test_later_browsers_see_what_was_chosen_for_all(page: Page):
    page.choose(1)
    page.follow()
    with fetching(address(page.server)) as browser:
        browser.send(CAMERA)
        eventually(lambda: bool(page.viewers))
        [viewer] = page.viewers.values()
        assert (viewer.who.value, viewer.follows.value, viewer.plots[0][1].visible) == ("b", True, True)


def test_a_page_in_place_of_another_keeps_the_choices(page: Page):
    with fetching(address(page.server)) as browser:
        browser.send(CAMERA)
        eventually(lambda: bool(page.viewers))
        next(iter(page.viewers.values())).choose(2)
        page.close()
        page.server.gui.reset()
        page.server.scene.reset()
        after = Page(page.server, page.scene.cast, None, "test, seed 1", None)
        after.adopt(page)
        eventually(lambda: after.chosen == {2})
        assert [viewer.who.value for viewer in after.viewers.values()] == ["c"]
        assert page._come not in page.server._client_connect_cb


def test_a_frame_that_comes_as_the_page_is_paused_is_said(page: Page):
    clock = Clock()
    page.clock = clock
    frame = page.scene.frame
    assert frame is not None
    page.draw(replace(frame, time=1.0))
    clock.playing = False
    page.draw(replace(frame, time=2.0))
    assert "t = 2.00 s** (paused)" in page._status.content
