"""Whom a ray from the camera means, and what is hidden of many."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from qrsim.models.vehicles.contracts import Outline
from qrsim.view.frame import Cast, Frame
from qrsim.view.scene import Scene
from qrsim.view.server import start_server

PLACES = np.array([[0.0, 0.0, -10.0], [30.0, 0.0, -10.0], [0.0, 40.0, -20.0]])


def cast(places: np.ndarray) -> Cast:
    return Cast(tuple(f"v{i}" for i in range(len(places))), np.zeros(len(places), int), places)


def frame(places: np.ndarray) -> Frame:
    nothing = np.zeros_like(places)
    return Frame(0.0, places, nothing, places, places, nothing, nothing, np.ones(len(places), bool))


@pytest.fixture
def scene() -> Iterator[Scene]:
    server = start_server(0)
    yield Scene(server, cast(PLACES), None)
    server.stop()


def test_a_ray_means_the_vehicle_it_passes_nearest(scene: Scene):
    assert scene.nearest((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) is None, "nothing is drawn yet"
    scene.draw(frame(PLACES))
    camera = np.array([-50.0, -20.0, -60.0])
    for i, place in enumerate(PLACES):
        aim = place + np.array([0.5, -0.5, 0.3]) - camera
        assert scene.nearest(camera, aim / np.linalg.norm(aim)) == i
    # What is behind the camera is not meant, though it is nearest to the line.
    behind = PLACES[0] + [0.0, 10.0, 0.0]
    assert scene.nearest(behind, (0.0, 1.0, 0.0)) == 2


def test_a_browser_that_is_behind_is_sent_one_thing_at_a_time(scene: Scene, monkeypatch):
    """Beside the vehicles, which it gets always; what waits comes later, and all of it where there is no lag."""
    now, drawn = 0.0, []
    monkeypatch.setattr("qrsim.view.scene.time.perf_counter", lambda: now)
    for title, layer in scene.layers.items():
        layer.root.visible = True
        monkeypatch.setattr(layer, "draw", lambda frame, title=title: drawn[-1].append(title))
    slow = {title for title, layer in scene.layers.items() if layer.every > 1.0}
    assert len(slow) >= 5
    drawn.append([])
    scene.draw(frame(PLACES), everything=True)
    assert slow < set(drawn.pop())

    def fly(frames: int) -> None:
        nonlocal now
        for _ in range(frames):
            now += 1.0 / 30.0
            drawn.append([])
            scene.draw(frame(PLACES))

    fly(60)
    assert max(len(slow.intersection(found)) for found in drawn) > 1
    drawn.clear()
    scene.lag_s = lambda: 0.4
    fly(1000)
    assert all("vehicles" in found for found in drawn)
    beside = [k for k, found in enumerate(drawn) if slow.intersection(found)]
    assert all(len(slow.intersection(drawn[k])) == 1 for k in beside)
    # 1.25 lags of 0.4 s are 15 frames.
    assert min(np.diff(beside)) >= 15
    assert slow == slow.intersection(*[{title for found in drawn for title in found}]), "none is forgotten"


def test_of_many_vehicles_only_what_can_be_told_apart_is_shown_at_first():
    server = start_server(0)
    places = np.stack([np.arange(201.0) * 20.0, np.zeros(201), np.full(201, -10.0)], axis=1)
    try:
        hidden = [title for title, layer in Scene(server, cast(places), None).layers.items() if not layer.root.visible]
    finally:
        server.stop()
    assert hidden == ["estimated paths", "GNSS positions", "states in labels"]


def test_each_kind_of_vehicle_is_drawn_as_what_it_is():
    """Two quadrotors, a mast, and one with rotors of its own; each is clicked by its number."""
    places = np.array([[0.0, 0.0, -10.0], [30.0, 0.0, 0.0], [0.0, 40.0, -20.0], [60.0, 0.0, -10.0]])
    hexa = Outline(tuple((0.3 * math.cos(a), 0.3 * math.sin(a), 0.0) for a in np.arange(6) * math.pi / 3), 0.1)
    seen = Cast(("a", "mast", "hexa", "b"), np.array([0, 1, 2, 0]), places, outlines=(None, Outline(), hexa))
    server = start_server(0)
    try:
        scene = Scene(server, seen, None)
        scene.draw(replace(frame(places), valid=np.array([True, True, False, True])))
        batches = scene.vehicles.bodies.batches
        assert [members.tolist() for members, _ in batches] == [[0, 3], [1], [2]]
        for members, handle in batches:
            np.testing.assert_array_equal(handle.batched_positions, places[members].astype(np.float32))
        # Red is who has stopped; in the linear numbers that viser hands on.
        np.testing.assert_array_equal(batches[2][1].batched_colors[0], [142, 2, 1])
        assert (batches[0][1].batched_colors != [142, 2, 1]).any()
        clicked = []
        scene.vehicles.on_click(lambda vehicle, event: clicked.append(vehicle))
        for (_, handle), index in zip(batches, (1, 0, None), strict=True):
            handle._impl.click_cb[-1].callback(SimpleNamespace(instance_index=index))
    finally:
        server.stop()
    assert clicked == [3, 1, None]


def test_two_runs_may_have_several_kinds_of_vehicles():
    """A quadrotor of the first run; a rover and a quadrotor of the second, which are drawn as its ghosts."""
    rover = Outline(kind="car", size=1.0)
    both = replace(
        cast(PLACES),
        fleets=np.array([0, 1, 2]),
        outlines=(None, rover, None),
        run_of=np.array([0, 1, 1]),
        runs=("A", "B"),
    )
    server = start_server(0)
    found = Scene(server, both, None).vehicles.bodies.batches
    assert [(members.tolist(), handle.batched_opacities.tolist()) for members, handle in found] == [
        ([0, 2], [1.0, pytest.approx(0.6)]),
        ([1], [pytest.approx(0.6)]),
    ]
    server.stop()
