"""Pictures of cameras on the ground."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from qrsim.scenarios.scenario import load_scenario
from qrsim.simulation.simulation import Simulation
from qrsim.view import shapes
from qrsim.view.cameras import INSTANCES, Cameras
from qrsim.view.frame import cast_of, frame_of
from qrsim.view.scene import Scene
from qrsim.view.server import start_server


@pytest.fixture(scope="module")
def flown() -> Simulation:
    simulation = Simulation(load_scenario("search_and_rescue/2D").world(), seed=1)
    simulation.reset()
    simulation.advance(ticks=60)
    return simulation


@pytest.fixture
def scene(flown: Simulation) -> Iterator[Scene]:
    server = start_server(0)
    yield Scene(server, cast_of(flown.world, flown.truth.position_ned), flown.world)
    server.stop()


def drawn(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (K, 3) and colours (K, 3) of the windows that are drawn."""
    layer = scene.layers["camera pictures"]
    assert isinstance(layer, Cameras)
    handle = layer._windows
    assert len(handle.batched_positions) % INSTANCES == 0
    there = handle.batched_scales[:, 0] > 0.0
    return handle.batched_positions[there], handle.batched_colors[there]


@pytest.mark.long
def test_windows_lie_where_the_camera_looks_and_say_what_the_classifier_says(scene: Scene, flown: Simulation):
    frame = frame_of(flown.state, flown.time, flown.world)
    scene.draw(frame)
    camera = flown.reading.camera
    count = int(np.isfinite(camera.ratio).sum())
    everywhere, _ = drawn(scene)
    assert len(everywhere) == count > 0
    scene.choose(1)
    positions, colours = drawn(scene)
    ratio = camera.ratio[1][np.isfinite(camera.ratio[1])]
    assert len(positions) == len(ratio) < count
    np.testing.assert_array_equal(colours, shapes.linear(shapes.ratio_colours(ratio, 10.0)))
    # About 0.5 m each, below the vehicle, which has hardly moved.
    below = positions[:, :2].mean(axis=0) - frame.position_ned[1, :2]
    assert np.abs(below).max() < 0.3 * -frame.position_ned[1, 2]
    assert (positions[:, 2] < -scene.stage.lift).all(), "above the plates of the ground's cover"


@pytest.mark.long
def test_a_vehicle_that_has_stopped_has_no_picture(scene: Scene, flown: Simulation):
    scene.draw(frame_of(flown.state, flown.time, flown.world))
    assert len(drawn(scene)[0])
    state = flown.state
    reading = state.fleets[0].readings[flown.world.fleets[0].sensor_names.index("camera")]
    reading.picture[:] = np.nan
    scene.draw(frame_of(state, flown.time, flown.world), everything=True)
    assert not len(drawn(scene)[0])


def test_colours_of_ratios():
    found = shapes.ratio_colours(np.array([-99.0, -10.0, 0.0, 10.0]), 10.0).astype(int)
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0][2] > found[0][0] + 100, "against: blue"
    assert found[3][0] > found[3][2] + 100, "for: yellow"
    assert np.ptp(found[2]) == 0
