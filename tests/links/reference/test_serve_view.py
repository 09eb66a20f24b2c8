"""A served simulation with a page: what clients fly is drawn, and a wind that is changed is recorded."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from wires import HERE, TASK, running

from qrsim.links.reference.client import Client
from qrsim.links.reference.tasks import Tasks
from qrsim.runs import open_run
from qrsim.scenarios.live_requests import wind
from qrsim.scenarios.scenario import load_scenario
from qrsim.view.live import LiveView

HOLD = [[*HERE, 0.0]]


def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is the case."""
    end = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.02)


def test_what_a_client_flies_is_drawn(tmp_path: Path):
    tasks = Tasks(load_scenario(TASK, ["world.wind={type: log_shear, speed_20ft: 1.0, wind_from_deg: 0.0}"]))
    view = LiveView(0)

    def shown() -> float:
        scene = None if view._page is None else view._page.scene
        return -1.0 if scene is None or scene.frame is None else scene.frame.time

    with contextlib.closing(view), running(tasks, view=view, record=tmp_path) as serving:
        with Client(port=serving.port, timeout=300.0) as client:
            client.init(TASK)
            client.step_waypoint(1.0, HOLD)
            eventually(lambda: shown() == pytest.approx(1.0))
            view.ask(wind(6.0, 180.0))
            time.sleep(0.05)
            client.step_waypoint(0.5, HOLD)
            time.sleep(0.05)
            client.step_waypoint(0.5, HOLD)
            eventually(lambda: shown() == pytest.approx(2.0))
            time.sleep(0.05)
            client.restart()
            eventually(lambda: shown() == 0.0)
        # The page stays when its client has gone, and shows what the next one flies.
        with Client(port=serving.port, timeout=300.0) as client:
            client.init(TASK)
            client.step_waypoint(0.2, HOLD)
            eventually(lambda: shown() == pytest.approx(0.2))
            assert view._page is not None
            assert "session 2" in view._page.heading
    first = open_run(sorted(tmp_path.iterdir())[0]).episodes[0]
    changed = [event for event in first.events if event.kind == "wind_changed"]
    assert [(event.tick, event.value) for event in changed] == [(75, 6.0), (75, 180.0)]
    assert first["wind"]["mean_ned.x"][-1, 0] > 4.0
