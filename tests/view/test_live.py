"""Simulations with a page, and with browsers that fetch what is drawn, too slowly or not at all."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.small_worlds import bare_pair, pair
from tests.view.fetching import fetching

from qrsim.links.shared.injectable import with_injectable
from qrsim.runs import open_run
from qrsim.runs.recorder import fly
from qrsim.scenarios.live_requests import Request
from qrsim.scenarios.live_requests import wind as blowing
from qrsim.scenarios.scenario import Scenario
from qrsim.simulation.simulation import Simulation
from qrsim.view.clock import Clock
from qrsim.view.live import LiveView
from qrsim.view.server import free_port
from qrsim.view.timeline import marks

WIND = {"wind": {"type": "log_shear", "speed_20ft": 2.0, "wind_from_deg": 270.0}}


@pytest.fixture
def view() -> Iterator[LiveView]:
    """A page of a simulation that flies as fast as it can."""
    page = LiveView(0, Clock(float("inf")))
    yield page
    page.close()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return bare_pair(**WIND, duration=4.0)


def eventually(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.01)


def shown(view: LiveView) -> float:
    """Return the time that is drawn [s]."""
    assert view._page is not None
    return -1.0 if view._page.scene.frame is None else view._page.scene.frame.time


def test_the_last_state_of_a_run_is_drawn(view: LiveView, scenario: Scenario, tmp_path: Path):
    fly(scenario, tmp_path / "run", seed=1, precision="float32", view=view)
    eventually(lambda: shown(view) == scenario.duration)
    frame = view._page.scene.frame  # type: ignore[union-attr]
    truth = open_run(tmp_path / "run")["truth"]
    np.testing.assert_array_equal(frame.position_ned[:, 0], truth["position_ned.x"][-1])
    drawn = view._page.scene.vehicles.bodies.batches[0][1].batched_positions  # type: ignore[union-attr]
    np.testing.assert_array_equal(drawn, frame.position_ned.astype(np.float32))


def test_a_page_changes_nothing_in_a_run(view: LiveView, scenario: Scenario, tmp_path: Path):
    fly(scenario, tmp_path / "seen", seed=1, precision="float32", view=view)
    fly(scenario, tmp_path / "unseen", seed=1, precision="float32")
    seen, unseen = (open_run(tmp_path / name) for name in ("seen", "unseen"))
    for stream in ("truth", "wind", "events"):
        assert seen.table(stream).equals(unseen.table(stream))


def test_a_wind_that_is_changed_blows_and_is_recorded(view: LiveView, scenario: Scenario, tmp_path: Path):
    view.ask(blowing(8.0, 180.0))
    fly(scenario, tmp_path / "run", seed=1, precision="float32", view=view)
    run = open_run(tmp_path / "run")
    changed = [event for event in run.events if event.kind == "wind_changed"]
    assert [(e.field, e.value) for e in changed] == [
        ("world.wind.speed_20ft", 8.0),
        ("world.wind.wind_from_deg", 180.0),
    ]
    wind, ticks = run["wind"], run["wind"].tick
    before, after = ticks <= changed[0].tick, ticks > changed[0].tick
    assert (wind["mean_ned.x"][after] > 5.0).all()
    assert (np.abs(wind["mean_ned.x"][before]) < 1e-3).all()
    assert (wind["mean_ned.y"][before][1:] > 1.0).all()


@pytest.mark.long
def test_a_fault_that_is_injected_acts_and_is_recorded(view: LiveView, tmp_path: Path):
    failing = with_injectable(pair(duration=4.0), ["gnss"])
    for request in (
        Request("gnss", "off", ("vehicles_1",), duration=2.0),
        Request("gnss", "of", ("vehicles_1",)),
        Request("gnss", "wrong", ("vehicles_0",), numbers={"field": "position_ned.x", "bias": 7.0}),
        Request("gnss", "ok", ("vehicles_0",)),
    ):
        view.ask(request)
    fly(failing, tmp_path / "run", seed=1, precision="float32", view=view)
    assert view._page is not None
    run = open_run(tmp_path / "run")
    said = [(event.kind, event.vehicle, event.field) for event in run.events if event.kind in ("injected", "cleared")]
    assert said == [
        ("injected", "vehicles_1", "gnss"),
        ("injected", "vehicles_0", "gnss.position_ned.x"),
        ("cleared", "vehicles_0", "gnss"),
    ]
    first = next(event for event in run.events if event.kind == "injected")
    assert re.fullmatch(r"vehicles_1: gnss off injected at 0\.\d\d s until 2\.\d\d s, asked by page", first.message)
    # Two seconds without a position, in the readings of the vehicle alone.
    north = run["measurements"]["gnss.position_ned.x"]
    lost = np.isnan(north[:, 1])
    assert 90 <= lost.sum() <= 110
    assert not np.isnan(north[:, 0]).any()
    # They are marks of the timeline, and no reason to stop.
    assert "vehicles_1: gnss off injected" in "".join(words for _, words in marks(run.events))


def test_the_panel_offers_the_wind_that_blows():
    from qrsim.view.steering import wind_of

    wind = wind_of(bare_pair(wind={**WIND["wind"], "wind_from_deg": 225.0}, duration=4.0).world())
    assert wind is not None
    assert (wind.speed, wind.from_deg) == (2.0, 225.0)


@pytest.mark.long
def test_a_browser_that_fetches_nothing_keeps_nobody_waiting(scenario: Scenario):
    """Its frames are dropped and counted; another browser gets the newest."""
    page = LiveView(0, Clock(float("inf")))
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    page.begin(simulation, "test")
    with contextlib.closing(page), fetching(page.address), fetching(page.address) as quick:
        # The first one never reads: what is on its way to it fills the system's buffers, then nothing goes.
        stop = threading.Event()

        def read() -> None:
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    quick.recv(0.1)

        reader = threading.Thread(target=read)
        reader.start()
        assert page._page is not None
        delivery, slowest = page._page._delivery, 0.0
        end = time.monotonic() + 60.0
        # What each frame weighs is made large, so that the buffers are soon full.
        page._page.scene.paths[0].every = 1
        page._page.scene.paths[0]._nodes[0].points = np.zeros((400_000, 2, 3), np.float32)
        while delivery.missed < 5:
            assert time.monotonic() < end, "no frame was dropped"
            history = simulation.record(1)
            begun = time.perf_counter()
            page.offer(history)
            slowest = max(slowest, time.perf_counter() - begun)
            time.sleep(0.02)
            page._page.scene.paths[0]._nodes[0].points = np.full((400_000, 2, 3), simulation.tick, np.float32)
        eventually(lambda: shown(page) == pytest.approx(simulation.time))
        stop.set()
        reader.join()
    # A frame would take the slow browser forever; this is what a busy machine may need.
    assert slowest < 1.0


def test_time_stops_and_steps(scenario: Scenario):
    clock = Clock(playing=False)
    page = LiveView(0, clock)
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    page.begin(simulation, "test")

    def flight() -> None:
        while simulation.tick < 100:
            page.offer(simulation.record(page.wait(50)))

    flying = threading.Thread(target=flight)
    flying.start()
    with contextlib.closing(page):
        for tick in (1, 2):
            clock.step()
            eventually(lambda tick=tick: shown(page) == pytest.approx(tick * 0.02))  # type: ignore[misc]
        assert simulation.tick == 2
        clock.speed, clock.playing = 50.0, True
        flying.join(30.0)
    assert simulation.tick >= 100


def test_a_second_page_gets_another_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port(port) > port
        page = LiveView(port)
        try:
            assert page.address.startswith("http://127.0.0.1:")
            assert page.address != f"http://127.0.0.1:{port}"
            # Nobody listens to other machines.
            with socket.socket() as other:
                other.settimeout(1.0)
                assert other.connect_ex(("127.0.0.2", int(page.address.rpartition(":")[2]))) != 0
        finally:
            page.close()


def test_pages_show_the_next_world_after_another(scenario: Scenario):
    page = LiveView(0)
    with contextlib.closing(page):
        for name in ("first", "second"):
            simulation = Simulation(scenario.world(), seed=1)
            simulation.reset()
            page.begin(simulation, name)
            assert shown(page) <= 0.0
            page.offer(simulation.record(3))
            eventually(lambda: shown(page) == pytest.approx(0.06))
            assert page._page is not None
            assert page._page.heading == name


@pytest.mark.long
def test_states_that_come_together_are_drawn_one_after_the_other(view: LiveView, scenario: Scenario):
    """In the time that they took to come."""
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    view.begin(simulation, "test")
    assert view._page is not None
    drawn, draw = [], view._page.draw
    view._page.draw = lambda frame, everything: (drawn.append(frame.time), draw(frame, everything))  # type: ignore
    for _ in range(2):
        view.offer(simulation.record(50))
        eventually(lambda: bool(drawn) and drawn[-1] == pytest.approx(simulation.time))
        # The next ones take so long.
        time.sleep(1.0)
    later = [moment for moment in drawn if moment > 1.001]
    assert len(later) >= 3, "the last one alone was drawn"
    assert later == sorted(later)


@pytest.mark.long
def test_paths_are_coloured_by_a_quantity_that_is_kept_from_then_on(view: LiveView, scenario: Scenario):
    simulation = Simulation(scenario.world(), seed=1)
    simulation.reset()
    view.begin(simulation, "test")
    page = view._page
    assert page is not None
    page._colour.value = "height"
    view.offer(simulation.record(50))
    eventually(lambda: page.scene.stage.paint is not None and page.scene.stage.paint.title == "height")
    eventually(lambda: bool(np.isfinite(page.scene.stage.paint.values(np.array([1.0]))).all()))  # type: ignore[union-attr]
    assert page.scene.stage.paint is not None
    height = -simulation.truth.position_ned[:, 2]
    np.testing.assert_allclose(page.scene.stage.paint.values(np.array([1.0]))[0], height, atol=0.2)
    page._colour.value = "(vehicle)"
    view.offer(simulation.record(50))
    eventually(lambda: shown(view) == pytest.approx(2.0))
    assert page.scene.stage.paint is None


@pytest.mark.long
def test_readings_are_plotted_against_the_truth(view: LiveView):
    from tests.small_worlds import noisy_pair

    simulation = Simulation(noisy_pair().world(), seed=1)
    simulation.reset()
    view.begin(simulation, "test")
    assert view._page is not None
    view._page.choose(1)
    for _ in range(5):
        view.offer(simulation.record(10))
        eventually(lambda: shown(view) == pytest.approx(simulation.time))
    time_s, measured, true = view._plotted(1, "barometer.height")
    assert time_s[-1] == pytest.approx(simulation.time)
    assert true[-1] == pytest.approx(-simulation.truth.position_ned[1, 2], rel=1e-5)
    assert measured[-1] == pytest.approx(simulation.reading.barometer.height[1], rel=1e-5)
